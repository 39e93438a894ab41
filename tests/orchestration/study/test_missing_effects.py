"""What must differ if the shipped gains are those of the paper: the first-order formulas and the sizes."""

from collections.abc import Iterator

import pytest

from orchestration.study.depth_loop_model import shipped_values
from orchestration.study.missing_effects import EFFECTS, change_of_rmse, needed, ramp_lag
from orchestration.study.vehicle_runs import VehicleRuns

BY_NAME = {effect.name: effect for effect in EFFECTS}


@pytest.fixture(scope="module")
def runs() -> Iterator[VehicleRuns]:
    with VehicleRuns() as loaded:
        yield loaded


def lag_bandwidth_and_stiffness(controller: str) -> tuple[float, float, float]:
    shipped = shipped_values(f"nominal-{controller}")
    k_z, k_v, w, k_p = (
        shipped[f"controller.{name}"]
        for name in ("depth_feedback_gain", "rate_feedback_gain", "filter_bandwidth", "proportional_gain")
    )
    return ramp_lag(k_z, k_v, w, shipped["controller.model_damping"], k_p), w, k_z + k_p


@pytest.mark.parametrize(("controller", "lag"), [("l1", 15.31), ("extended", 4.949)])
def test_the_lag_of_the_shipped_gains(controller: str, lag: float) -> None:
    """The metric `lag` of the shipped runs is 16.1 s and 4.99 s: it counts the start too."""
    assert lag_bandwidth_and_stiffness(controller)[0] == pytest.approx(lag, rel=1e-3)


@pytest.mark.parametrize(
    ("controller", "relative"),
    [("l1", 0.05), ("extended", 0.30)],  # the extension is still on its way to the ramp then
)
def test_the_first_order_change_is_that_of_the_runs(
    runs: VehicleRuns, controller: str, relative: float
) -> None:
    before, after = (runs.one(f"{case}-{controller}", {})["rmse"] for case in ("nominal", "buoyancy"))
    change = change_of_rmse(0.2, before, *lag_bandwidth_and_stiffness(controller))
    assert change == pytest.approx(after - before, rel=relative)


def test_an_effect_is_as_large_as_the_published_rmse_asks(runs: VehicleRuns) -> None:
    result = needed(runs, BY_NAME["added buoyancy"])
    assert result["reached"]
    assert result["buoyancy-l1 rmse"] == pytest.approx(13.8, abs=0.01)
    assert result["size"] > 1.0  # six times the 0.2 N that the vehicle was given


def test_an_effect_that_is_never_large_enough_is_given_with_its_largest(runs: VehicleRuns) -> None:
    result = needed(runs, BY_NAME["inertia"])
    assert not result["reached"]
    assert result["size"] == BY_NAME["inertia"].largest
    assert result["buoyancy-l1 rmse"] < 13.0


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_no_effect_is_the_shipped_scenario(runs: VehicleRuns, effect) -> None:
    with_none = {"plant.buoyancy_change": 0.2} | effect.sets(effect.none)
    assert runs.one("buoyancy-l1", with_none) == runs.one("buoyancy-l1", {})
