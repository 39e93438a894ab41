"""The cheap model of the depth loop: against the FMUs, an analytic lag, half the step, one run at a time."""

from collections.abc import Iterator

import numpy as np
import pytest

from controller_fmu.design import lyapunov_matrix
from orchestration.scenarios import identify, scenario
from orchestration.scenarios.read_layers import parameter_values
from orchestration.study.depth_loop_model import (
    DepthTask,
    adaptation_vector,
    depth_task,
    figures,
    shipped_values,
)
from orchestration.study.missing_effects import ramp_lag
from orchestration.study.vehicle_runs import VehicleRuns

IDENTIFIED = {
    name: float(str(value))
    for name, value in parameter_values(scenario.SHIPPED / "parameters" / "identified.toml").items()
}
K_Z, K_V, W, K_P, K_I = (IDENTIFIED[gain.name] for gain in identify.GAINS)
EXTENSION = {"controller.proportional_gain": K_P, "controller.integral_gain": K_I}
# adaptation at 0.3 rad/s, sigma_hat at its bound: what the shipped gains leave unused
SLOW = {
    "plant.inertia": 6.7,
    "plant.linear_damping": 3.35,
    "plant.quadratic_damping": 9.85,
    "controller.depth_feedback_gain": 3.85,
    "controller.rate_feedback_gain": 4.84,
    "controller.filter_bandwidth": 0.18,
    "controller.adaptation_gain": 3.53,
    "controller.sigma_bound": 0.52,
    "controller.theta_bound[1]": 7.4,
    "controller.proportional_gain": 6.69,
    "controller.integral_gain": 0.0102,
}


@pytest.fixture(scope="module")
def runs() -> Iterator[VehicleRuns]:
    with VehicleRuns() as loaded:
        yield loaded


def of_scenario(name: str, values: dict[str, float]) -> dict[str, float]:
    """The model's figures of a shipped scenario with these values."""
    given = values if name.endswith("extended") else {k: v for k, v in values.items() if k not in EXTENSION}
    given = given | {"plant.buoyancy_change": 0.2 if name.startswith("buoyancy") else 0.0}
    return {metric: column[0] for metric, column in figures(depth_task(), given).items()}


@pytest.mark.parametrize("name", ["nominal-l1", "nominal-extended", "buoyancy-l1", "buoyancy-extended"])
@pytest.mark.parametrize("values", [EXTENSION, SLOW], ids=["shipped", "slow"])
def test_the_model_agrees_with_the_fmus(runs: VehicleRuns, name: str, values: dict[str, float]) -> None:
    """Noise, observer and thruster lag are not in the model: they move an RMSE by 0.3 %, a time by 0.15 s."""
    ours, theirs = of_scenario(name, values), runs.one(name, values)
    assert ours["rmse"] == pytest.approx(theirs["rmse"], rel=3e-3)
    assert ours["settling_time"] == pytest.approx(theirs["settling_time"], abs=0.15)
    assert ours["overshoot"] == pytest.approx(theirs["overshoot"], abs=0.25)


def test_half_the_step_changes_the_figures_by_a_tenth_of_the_error_against_the_fmus() -> None:
    coarse, fine = (figures(depth_task(step=step), EXTENSION) for step in (0.2, 0.1))
    assert coarse["rmse"] == pytest.approx(fine["rmse"], rel=3e-4)
    assert coarse["settling_time"] == pytest.approx(fine["settling_time"], abs=0.02)


@pytest.mark.parametrize("k_p", [0.0, K_P])
@pytest.mark.parametrize("inertia", [5.5, 11.0])
def test_on_a_long_ramp_the_error_is_the_analytic_lag(k_p: float, inertia: float) -> None:
    """Whatever the vehicle. It has no buoyancy, and its first 30 s of 4000 s leave 1 %."""
    task = DepthTask(5e-4 * 0.1 * np.arange(2 * 20_000 + 1), step=0.2, target=1.0, band=0.1, window_end=10.0)
    values = {"controller.proportional_gain": k_p, "plant.inertia": inertia, "plant.net_weight": 0.0}
    error = figures(task, values)["rmse"][0] / 100.0
    assert error / 5e-4 == pytest.approx(ramp_lag(K_Z, K_V, W, 2.5, k_p), rel=0.01)


def test_many_runs_are_those_that_one_run_at_a_time_gives() -> None:
    """Also beyond a multiple of the runs that are computed side by side."""
    gains = np.linspace(1.0, 3.0, 19)
    together = figures(depth_task(), {"controller.depth_feedback_gain": gains})
    alone = [figures(depth_task(), {"controller.depth_feedback_gain": gain})["rmse"][0] for gain in gains]
    assert together["rmse"].tolist() == alone


def test_a_run_that_does_not_settle_has_no_settling_time() -> None:
    measured = figures(depth_task(), {"controller.depth_feedback_gain": 0.1})
    assert np.isnan(measured["settling_time"][0])
    assert measured["rmse"][0] > 20.0


def test_the_start_depth_counts() -> None:
    """From 0.1 m the vehicle is ahead of the ramp at first."""
    at_surface, below = (
        figures(depth_task(), {"plant.initial_depth": depth})["rmse"][0] for depth in (0.0, 0.1)
    )
    assert below < at_surface - 0.05


def test_the_adaptation_vector_solves_the_lyapunov_equation() -> None:
    a_m = np.array([[0.0, 1.0], [-K_Z / 5.5, -(2.5 + K_V) / 5.5]])
    expected = lyapunov_matrix(a_m, np.eye(2)) @ [0.0, 1.0 / 5.5]
    assert np.ravel(adaptation_vector(shipped_values())) == pytest.approx(expected)


@pytest.mark.parametrize(("name", "is_on"), [("nominal-l1", 0.0), ("nominal-extended", 1.0)])
def test_the_model_has_the_values_of_the_shipped_scenario(name: str, is_on: float) -> None:
    shipped = shipped_values(name)
    gains = {gain.name: shipped[gain.name] for gain in identify.GAINS}
    extension = {gain: is_on * value for gain, value in EXTENSION.items()}
    assert gains == IDENTIFIED | extension
    assert shipped["plant.inertia"] == shipped["controller.model_inertia"] == 5.5
    assert shipped_values(name.replace("nominal", "buoyancy"))["plant.buoyancy_change"] == 0.2
