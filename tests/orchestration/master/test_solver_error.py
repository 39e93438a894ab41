"""Error control where an FMU's own solver leaves an error that no shorter step takes away."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import FmuWarning
from orchestration.master import simulate
from orchestration.master.checkpoint import Checkpoints, read_checkpoint
from orchestration.results.recording import Recording
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.system import System
from tests.orchestration.linear_systems import LOOP, coupled, solution

Build = Callable[..., Path]
SOLVER_ERROR = 1e-4
INTERPOLATES = pytest.mark.parametrize("interpolates", [True, False], ids=["by the FMU", "at the middle"])


def inexact(linear: Build, **capabilities: Any) -> System:
    """`coupled`, each of whose FMUs leaves up to `SOLVER_ERROR` in every step longer than 1 us."""
    return coupled(linear, solver_error=SOLVER_ERROR, saves_state=True, serialises_state=True, **capabilities)


def true_error(run: Recording) -> float:
    ours = np.column_stack([run["one.y[1]"], run["two.y[1]"]])
    return float(np.abs(ours - solution(run.time)).max())


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
        FmuWarning, match=r"tolerance = 0\.0001 is not met: at t = .* s the error of .*\.y\[1\]"
    ):
        run = simulate(inexact(linear, interpolates_inputs=interpolates), experiment)
    reached = run.provenance["solver_error"]
    assert 0 < reached["steps"] <= run.provenance["steps_between_points"] < 100
    assert 1e-4 < true_error(run) <= reached["estimated_error"] < 100 * SOLVER_ERROR


def test_a_tolerance_above_the_solvers_error_is_met(linear: Build) -> None:
    """At 100 times the solver's error the exchange is what the steps are chosen for."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = simulate(
            inexact(linear, interpolates_inputs=True),
            Experiment(0.5, 0.1, tolerance=100 * SOLVER_ERROR, extrapolation=1),
        )
    assert "solver_error" not in run.provenance
    assert true_error(run) <= 100 * SOLVER_ERROR


@INTERPOLATES
@pytest.mark.parametrize("extrapolation", [0, 1])
def test_a_stiff_system_is_no_solvers_error(linear: Build, extrapolation: int, interpolates: bool) -> None:
    """x_1' = -500 x_1 + 500 x_2, x_2' = -x_2 + 0.5 x_1: from 0.5 s down to 2 ms the error hardly falls."""
    able: dict[str, Any] = {"saves_state": True, "interpolates_inputs": interpolates}
    fmus = {"one": linear(a=-500.0, b=(500.0,), **able), "two": linear(b=(0.5,), initial_state=0.0, **able)}
    experiment = Experiment(0.5, 0.5, tolerance=1e-2, extrapolation=extrapolation)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = simulate(System(fmus, LOOP), experiment)
    assert run.provenance["inexact_steps"] > 2
    assert "solver_error" not in run.provenance


@INTERPOLATES
@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_a_step_in_two_halves_without_an_exchange_is_the_same_to_an_exact_fmu(
    linear: Build, algorithm: Algorithm, interpolates: bool, tmp_path: Path
) -> None:
    """Stiff from 0.5 s on, where inputs have slopes; what was learned is in the checkpoint of 1 s."""
    able: dict[str, Any] = {
        "saves_state": True,
        "serialises_state": True,
        "interpolates_inputs": interpolates,
    }
    fmus = {"one": linear(b=(1.0,), **able), "two": linear(b=(0.5,), initial_state=0.0, **able)}
    experiment = Experiment(
        1.5, 0.5, tolerance=1e-3, extrapolation=1, algorithm=algorithm, events=[Event(0.5, {"one.a": -500.0})]
    )
    checkpoints = Checkpoints(tmp_path / "checkpoint", every=1.0)
    simulate(System(fmus, LOOP), experiment, checkpoints=checkpoints)
    learned = read_checkpoint(checkpoints.path).step_control[1:]
    assert any(learned)  # to rounding
    assert max(learned) < 1e-13


def test_a_run_continues_with_the_solvers_error_that_it_knows(linear: Build, tmp_path: Path) -> None:
    system, checkpoints = inexact(linear), Checkpoints(tmp_path / "checkpoint", every=0.3)
    experiment = Experiment(0.5, 0.1, tolerance=1e-3)
    with pytest.warns(FmuWarning, match="is not met"):
        complete = simulate(system, experiment, checkpoints=checkpoints)
    with pytest.warns(FmuWarning, match="is not met"):
        continued = simulate(system, experiment, resume=read_checkpoint(checkpoints.path))
    assert np.array_equal(continued.values, complete.values)
