"""Depth controllers on vehicles in heave and pitch: what unequal thrusters do to them.

The numbers stand in docs/explanation/disturbances.md.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from orchestration.results import metrics
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.studies.score.closed_loop import ClosedLoop, tuned
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.run_metrics import failures
from orchestration.studies.vehicle import Vehicle
from plant_fmu.thruster import T200_FORCE, T200_VOLTAGE
from tests.shared_builds import slow_but

pytestmark = pytest.mark.usefixtures("scenario_fmus")
# 10 % less than the aft one; of another gain, the controller would be told
WEAK_FORE, WEAK_AFT = ({f"plant.thruster_efficiency[{i}]": 0.9} for i in (1, 2))
PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "disturbances.md"
LITTLE_DAMPING = {"plant.pitch_linear_damping": 0.005}  # a damping ratio of 0.04 in place of 0.16


def metrics_of(controller: str, settings: Mapping[str, float]) -> tuple[float, list[str]]:
    """Returns the RMSE [cm] of the nominal case with tuned gains on RovHeavePitchPlant, and why it failed."""
    protocol = read_protocol(vehicle=Vehicle.of("RovHeavePitchPlant", settings=settings))
    with ClosedLoop(tuned(protocol, controller), protocol) as loop:
        numbers = loop.metrics(protocol.nominal)
    return numbers["rmse"], failures(numbers, protocol)


@pytest.mark.parametrize(
    "controller",
    slow_but(("pid", "l1-pi"), ["pid", "l1-pi", "super-twisting", "l1", "sliding-mode", "adrc", "mrac"]),
)
def test_the_page_shows_what_a_weak_fore_thruster_costs(controller: str) -> None:
    """The sensor at the bow rises where both thrusters push down: with little damping fast laws oscillate."""
    cells = [read_protocol().controllers[controller].title]
    for settings in ({}, WEAK_FORE, WEAK_FORE | LITTLE_DAMPING):
        rmse, failed = metrics_of(controller, settings)
        cells.append(f"{rmse:.1f} !" if failed else f"{rmse:.2f}")
    assert f"| {' | '.join(cells)} |".lower() in PAGE.read_text(encoding="utf-8").lower()


@pytest.mark.parametrize("controller", ["pid", "l1"])
def test_a_weak_aft_thruster_costs_a_millimetre_whatever_the_damping(controller: str) -> None:
    equal, *weaker = (
        metrics_of(controller, settings)[0] for settings in ({}, WEAK_AFT, WEAK_AFT | LITTLE_DAMPING)
    )
    for rmse in weaker:
        assert rmse - equal == pytest.approx(0.1, abs=0.06)


def nominal(settings: Mapping[str, object]) -> dict[str, float]:
    """Returns the metrics of the nominal scenario of BlueRov2Plant with a PID controller at 1 rad/s."""
    gains = {"controller.kp": 96.5, "controller.ki": 32.2, "controller.kd": 63.5}
    given = {"plant": "BlueRov2Plant", "controller": "PidDepthController", **gains, **settings}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = scenario.load(scenario.find("nominal-extended"), settings=given)
    recording = simulate(loaded.system, loaded.experiment)
    return metrics.evaluate(recording, loaded.metrics)


LINE = {"controller.thruster_gain[1]": 6.65, "controller.thruster_gain[2]": 6.65}  # N/V of a pair: of 12 V


@pytest.mark.parametrize(
    ("settings", "rmse"),
    [
        ({}, 0.08),
        (LINE | {"controller.thruster_tabulated": False}, 0.66),
        ({"plant.sensor_noise": 0.002}, 0.10),
        ({"plant.sensor_noise": 0.02}, 0.54),
    ],
    ids=["inverse table", "line", "noise 2 mm", "noise 20 mm"],
)
def test_the_inverse_of_the_table_follows_the_trajectory_on_the_edge_of_the_dead_band(
    built: Mapping[str, Path], settings: dict[str, float], rmse: float
) -> None:
    """A linear allocation has the same force at 12 V."""
    assert built["PidDepthController"].is_file()
    assert nominal(settings)["rmse"] == pytest.approx(rmse, abs=0.005)


def test_a_score_tells_the_table_and_computes_the_force_by_it() -> None:
    """Both pairs of two thrusters have one voltage, whose sign is that of the force."""
    protocol = read_protocol(vehicle=Vehicle.of("BlueRov2Plant"))
    with ClosedLoop(tuned(protocol, "pid"), protocol) as loop:
        given = loop.experiment(protocol.nominal).parameters
        signals = loop.run(protocol.nominal)
        numbers = loop.metrics(protocol.nominal, names=["total_variation", "effort"])
    assert [given[f"controller.thruster_table_force[{i}]"] for i in range(1, 25)] == [*T200_FORCE]
    u, size = signals["u"], np.minimum(signals["voltage"], 12.0)
    down, up = (4.0 * np.interp(voltage, T200_VOLTAGE, T200_FORCE) for voltage in (size, -size))
    # rounding of 206 N
    np.testing.assert_allclose(u, np.where(u < 0.0, up, down), atol=1e-12)
    assert numbers["total_variation"] == pytest.approx(np.abs(np.diff(u)).sum(), rel=1e-9)
    assert numbers["effort"] > 0.0
