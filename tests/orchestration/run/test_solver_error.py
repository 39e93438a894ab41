"""Error control where an FMU's own solver leaves an error that no shorter step takes away."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import FmuError, FmuWarning, SimulationError
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.run.access import Snapshot
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.run.run import Run
from orchestration.run.step_control import StepControl
from orchestration.run.tolerance import step_together_and_split
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import LOOP, RESUMABLE, coupled, solution
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build

SOLVER_ERROR = 1e-4
INTERPOLATES = pytest.mark.parametrize("interpolates", [True, False], ids=["by the FMU", "at the middle"])


def inexact(linear: Build, **capabilities: Any) -> System:
    """`coupled`, each of whose FMUs leaves up to `SOLVER_ERROR` in every step longer than 1 us."""
    return coupled(linear, solver_error=SOLVER_ERROR, **RESUMABLE, **capabilities)


def numbers_of_steps(run: Recording) -> list[int]:
    return [run.provenance[name] for name in ("steps_between_points", "discarded_steps", "inexact_steps")]


def true_error(run: Recording) -> float:
    ours = np.column_stack([run["one.y[1]"], run["two.y[1]"]])
    return float(np.abs(ours - solution(run.time)).max())


def assert_same_steps(run: Recording, expected: Recording) -> None:
    """The same error of the solver was found, in the same numbers of steps."""
    assert run.provenance["solver_error"] == expected.provenance["solver_error"]
    assert numbers_of_steps(run) == numbers_of_steps(expected)


@INTERPOLATES
@pytest.mark.parametrize("extrapolation", [0, 1])
@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_steps_stay_as_long_as_the_error_does_not_fall(
    linear: Build, algorithm: Algorithm, extrapolation: int, interpolates: bool
) -> None:
    """A tolerance of 1e-4 in 0.5 s: without its solver's error the FMU takes up to 2000 steps.

    With it the shortest permitted error, of some 1e-9 s, would be far below: steps without end.
    """
    experiment = Experiment(0.5, 0.1, tolerance=1e-4, algorithm=algorithm, extrapolation=extrapolation)
    with pytest.warns(
        FmuWarning, match=r"tolerance = 0\.0001 may not be met: at t = .* s the error of .*\.y\[1\]"
    ) as warned:
        run = simulate(inexact(linear, interpolates_inputs=interpolates), experiment)
    reached = run.provenance["solver_error"]
    assert f"at t = {reached['from_time_s']:.9g} s" in str(warned[0].message)
    assert 0 < reached["steps"] <= run.provenance["steps_between_points"] < 100
    assert 1e-4 < true_error(run) <= reached["estimated_error"] < 100 * SOLVER_ERROR


@pytest.mark.filterwarnings("error")
def test_a_tolerance_above_the_solvers_error_is_met(linear: Build) -> None:
    """At 100 times the solver's error the exchange is what the steps are chosen for."""
    experiment = Experiment(0.5, 0.1, tolerance=100 * SOLVER_ERROR, extrapolation=1)
    run = simulate(inexact(linear, interpolates_inputs=True), experiment)
    assert "solver_error" not in run.provenance
    assert true_error(run) <= 100 * SOLVER_ERROR


@INTERPOLATES
@pytest.mark.parametrize("extrapolation", [0, 1])
@pytest.mark.filterwarnings("error")
def test_a_stiff_system_is_no_solvers_error(linear: Build, extrapolation: int, interpolates: bool) -> None:
    """x_1' = -500 x_1 + 500 x_2, x_2' = -x_2 + 0.5 x_1: from 0.5 s down to 2 ms the error hardly falls."""
    able: dict[str, Any] = {"saves_state": True, "interpolates_inputs": interpolates}
    fmus = {"one": linear(a=-500.0, b=(500.0,), **able), "two": linear(b=(0.5,), initial_state=0.0, **able)}
    run = simulate(System(fmus, LOOP), Experiment(0.5, 0.5, tolerance=1e-2, extrapolation=extrapolation))
    assert run.provenance["inexact_steps"] > 2
    assert "solver_error" not in run.provenance


@INTERPOLATES
@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_a_step_in_two_halves_without_an_exchange_is_the_same_to_an_exact_fmu(
    linear: Build, algorithm: Algorithm, interpolates: bool, tmp_path: Path
) -> None:
    """Stiff from 0.5 s on, where inputs have slopes; what was learned is in the checkpoint of 1 s."""
    able = RESUMABLE | {"interpolates_inputs": interpolates}
    fmus = {"one": linear(b=(1.0,), **able), "two": linear(b=(0.5,), initial_state=0.0, **able)}
    settings: dict[str, Any] = {"extrapolation": 1, "events": [Event(0.5, {"one.a": -500.0})]}
    experiment = Experiment(1.5, 0.5, tolerance=1e-3, algorithm=algorithm, **settings)
    checkpoints = Checkpoints(tmp_path / "checkpoint", every=1.0)
    simulate(System(fmus, LOOP), experiment, checkpoints=checkpoints)
    learned = read_checkpoint(checkpoints.path).step_control["known_solver_error"]
    assert any(learned)  # to rounding
    assert max(learned) < 1e-13


def simulate_warned(*arguments: Any, **settings: Any) -> Recording:
    """Returns the recording of a run that warns of its tolerance."""
    with pytest.warns(FmuWarning, match="may not be met"):
        return simulate(*arguments, **settings)


ROUGH = Experiment(0.5, 0.1, tolerance=1e-3)


def step_twice_from_each_point(run: Run) -> None:
    """Each step to 0.5 s is taken, taken back and taken again."""
    while run.time < 0.45:
        state = run.save()
        run.step()
        run.restore(state)
        run.step()


def test_steps_taken_back_do_not_count(linear: Build) -> None:
    complete = simulate_warned(inexact(linear), ROUGH)
    with Simulator(inexact(linear)) as simulator:
        run = simulator.start(ROUGH)
        with pytest.warns(FmuWarning, match="may not be met"):
            step_twice_from_each_point(run)
        assert_same_steps(run.recording(), complete)


def test_steps_before_an_interrupt_between_two_points_do_not_count(
    linear: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run continues from the point before them, with the step size and the errors of that point."""
    system, checkpoints = inexact(linear), Checkpoints(tmp_path / "checkpoint")
    complete = simulate_warned(system, ROUGH)
    tries = iter(range(20))
    step = StepControl.try_controlled_step

    def interrupted(control: StepControl, point: int, start: float, end: float) -> bool:
        if next(tries, None) is None and start > ROUGH.step_size * point + 1e-9:
            raise KeyboardInterrupt
        return step(control, point, start, end)

    with monkeypatch.context() as patch:
        patch.setattr(StepControl, "try_controlled_step", interrupted)
        with (
            pytest.warns(FmuWarning, match="may not be met"),
            pytest.raises(SimulationError, match="interrupted; saved in"),
        ):
            simulate(system, ROUGH, checkpoints=checkpoints)
    continued = simulate_warned(system, ROUGH, resume=read_checkpoint(checkpoints.path))
    assert_same_bits(continued, complete)
    assert_same_steps(continued, complete)


def test_the_error_of_an_output_with_feedthrough_is_no_mean_over_time(linear: Build) -> None:
    """Its permitted error is the whole tolerance: here 20 of 130 steps exceed it, not the mean."""
    system = coupled(linear, 0.02, solver_error=SOLVER_ERROR, saves_state=True)
    tolerance = 0.8 * SOLVER_ERROR
    run = simulate_warned(system, Experiment(0.2, 0.1, tolerance=tolerance))
    assert run.provenance["solver_error"]["estimated_error"] > tolerance


@pytest.mark.parametrize("misdeed_time", [0.0, 0.05], ids=["the whole step", "the second half"])
@pytest.mark.parametrize(
    ("misdeed", "message"),
    [
        (Misdeed.ERROR, "fmi2DoStep returned error: the rudder is stuck"),
        (Misdeed.FATAL, "fmi2DoStep returned fatal: the hull is breached"),
        (Misdeed.DISCARD, ""),
    ],
)
def test_a_step_that_fails_to_find_the_solvers_error_ends_the_run(
    linear: Build,
    rogue: Build,
    misdeed: Misdeed,
    message: str,
    misdeed_time: float,
) -> None:
    """After a fatal error no state is set; a discarded step only leaves the error unknown."""
    with Simulator(pair(linear, rogue)) as simulator:
        wired = simulator.start(doing(misdeed, misdeed_time)).wired
        before = Snapshot(wired)
        before.take()
        arguments = wired, before, 0, 0.0, 0.1
        if message:
            with pytest.raises(FmuError, match=rf"rogue at t = {misdeed_time:g} s: {message}"):
                step_together_and_split(*arguments)
        else:
            assert step_together_and_split(*arguments) is None
