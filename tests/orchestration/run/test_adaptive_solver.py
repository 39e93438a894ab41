"""Error control with an FMU whose own solver chooses its steps, as those that tools export do."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from orchestration.errors import FmuWarning, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.shared_builds import Build, slow_but

OUTPUTS = ("motor.current", "motor.speed", "drive.y[1]")
LOOP = (("motor.speed", "drive.u[1]"), ("drive.y[1]", "motor.voltage"))
FEEDBACK, START_V, DECAY = -2.0, 10.0, -5.0  # V/s per rad/s, V, 1/s: of the drive, x' = DECAY x + FEEDBACK w


def loop(motor: Build, linear: Build, solver_tolerance: float) -> System:
    able = {"saves_state": True, "interpolates_inputs": False}
    drive = linear(a=DECAY, b=(FEEDBACK,), initial_state=START_V, **able)
    return System({"motor": motor(solver_tolerance=solver_tolerance, **able), "drive": drive}, LOOP)


def exact(times: np.ndarray) -> np.ndarray:
    """Current, speed and voltage at the times, with the constants of motor.c."""

    def slopes(_: float, x: np.ndarray) -> list[float]:
        current, speed, voltage = x
        return [
            (voltage - current - 0.05 * speed) / 1e-3,
            (0.05 * current - 5e-3 * np.tanh(speed)) / 1e-4,
            DECAY * voltage + FEEDBACK * speed,
        ]

    span = float(times[0]), float(times[-1])
    return solve_ivp(slopes, span, [0.0, 0.0, START_V], "Radau", times, rtol=1e-10, atol=1e-12).y.T


def largest_error(run: Recording) -> float:
    """Relative to the largest value and 1, as the tolerance is."""
    ours, right = np.column_stack([run[name] for name in OUTPUTS]), exact(run.time)
    return float(np.max(np.abs(ours - right) / np.maximum(np.abs(right), 1.0)))


def run_with(motor: Build, linear: Build, solver_tolerance: float, tolerance: float) -> Recording:
    experiment = Experiment(0.05, 0.01, tolerance=tolerance, extrapolation=1)
    return simulate(loop(motor, linear, solver_tolerance), experiment)


# tolerance -> steps with a solver of 1e-2, and with one of 1e-10
STEPS = {1e-3: (70, 475), 1e-6: (684, 15231)}
_OF_ANOTHER_COMPILER = 0.05  # of the steps: a step more or less where its error is at the limit


@pytest.mark.parametrize("tolerance", STEPS)
def test_steps_get_no_shorter_for_the_error_of_the_solver(
    motor: Build, linear: Build, tolerance: float
) -> None:
    """A solver of 1e-2 leaves up to that in each of its steps, in long and in short communication steps."""
    with pytest.warns(
        FmuWarning, match=r"tolerance = .* may not be met: .* error of motor\.\w+ does not fall"
    ):
        run = run_with(motor, linear, 1e-2, tolerance)
    reached, steps = run.provenance["solver_error"], run.provenance["steps_between_points"]
    assert 0 < reached["steps"] <= steps
    assert steps == pytest.approx(STEPS[tolerance][0], rel=_OF_ANOTHER_COMPILER)
    assert reached["output"].startswith("motor.")
    assert largest_error(run) <= reached["estimated_error"]
    assert tolerance < reached["estimated_error"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("tolerance", slow_but((1e-3,), STEPS))
def test_an_exact_solver_meets_the_tolerance_in_as_many_steps_as_the_exchange_needs(
    motor: Build, linear: Build, tolerance: float
) -> None:
    run = run_with(motor, linear, 1e-10, tolerance)
    steps = run.provenance["steps_between_points"]
    assert steps == pytest.approx(STEPS[tolerance][1], rel=_OF_ANOTHER_COMPILER)
    assert "solver_error" not in run.provenance
    assert largest_error(run) <= tolerance


def test_a_tolerance_is_handed_to_the_fmus(motor: Build, linear: Build) -> None:
    """A motor whose solver takes it gives what one does that was built with it."""
    experiment = Experiment(0.05, 0.01)
    rough, fine = (simulate(loop(motor, linear, x), experiment) for x in (1e-2, 1e-6))
    given = simulate(loop(motor, linear, 1e-2), stop_time=0.05, step_size=0.01, fmu_tolerance=1e-6)
    assert np.array_equal(given.values, fine.values)
    assert not np.array_equal(given.values, rough.values)
    assert given.provenance["fmu_tolerance"] == 1e-6
    assert "fmu_tolerance" not in rough.provenance
    with pytest.raises(SystemDefinitionError, match=r"fmu_tolerance = 0\.0: expected more than 0, less"):
        Experiment(0.05, 0.01, fmu_tolerance=0.0)
