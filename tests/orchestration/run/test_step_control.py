"""How far a step may grow or shrink from one to the next, and which errors add up."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from orchestration.run import simulate
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.system.experiment import Experiment
from orchestration.system.signals import Table
from orchestration.system.system import System
from tests.described_fmus import redescribed
from tests.orchestration.linear_systems import RESUMABLE, alone, coupled
from tests.shared_builds import Build


def test_a_step_grows_at_most_five_times(linear: Build, tmp_path: Path) -> None:
    """The error is far below this tolerance: without a limit the next step would be longer than the run."""
    checkpoints = Checkpoints(tmp_path / "checkpoint", every=0.001)
    simulate(coupled(linear, **RESUMABLE), Experiment(0.002, 0.001, tolerance=0.5), checkpoints=checkpoints)
    checkpoint = read_checkpoint(checkpoints.path)
    assert checkpoint.position == 1
    assert checkpoint.step_control["step_size"] == pytest.approx(5 * 0.001, rel=1e-12)


def test_a_step_shrinks_at_most_to_a_fifth(linear: Build) -> None:
    """From a step of 1 s to one of below 0.2^5 s it takes at least six attempts."""
    run = simulate(coupled(linear, **RESUMABLE), Experiment(1.0, 1.0, tolerance=1e-4))
    assert run.provenance["steps_between_points"] > 5**5
    assert run.provenance["inexact_steps"] >= 6


def test_the_permitted_error_is_a_share_of_the_run_wherever_time_begins(linear: Build) -> None:
    def steps(begin: float) -> int:
        run = simulate(coupled(linear, **RESUMABLE), Experiment(begin + 2.0, 0.5, begin, tolerance=1e-3))
        return run.provenance["steps_between_points"]

    assert [steps(-1.0), steps(100.0)] == pytest.approx([steps(0.0)] * 2, rel=0.02)  # times are rounded


def test_negative_values_are_permitted_the_errors_of_positive_ones(linear: Build) -> None:
    """Of values above the nominal one, to which the error is relative."""
    system, start = coupled(linear, **RESUMABLE), {"one.initial_state": 100.0, "two.initial_state": 40.0}
    negative = {name: -value for name, value in start.items()}
    runs = [
        simulate(system, Experiment(1.0, 0.5, tolerance=1e-3, parameters=parameters))
        for parameters in (start, negative)
    ]
    assert runs[0].provenance["steps_between_points"] == runs[1].provenance["steps_between_points"] > 2
    assert (runs[0].values == -runs[1].values).all()


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("extrapolation", [0, 1])
def test_a_step_ends_at_a_jump(linear: Build, hold: bool, extrapolation: int) -> None:
    """x' = u - x, u jumps from 0 to -1 at 0.15 s, between two points, and back at 0.4 s: x is exact."""
    table = Table([-0.5, 0.15, 0.15, 0.4, 0.4, 1.0], [0.0, 0.0, -1.0, -1.0, 0.0, 0.0], hold=hold)
    settings: dict[str, Any] = {"tolerance": 1e-2, "extrapolation": extrapolation}
    experiment = Experiment(1.0, 0.1, signals={"one.u[1]": table}, **settings)
    run = simulate(alone(linear, initial_state=0.0, **RESUMABLE), experiment)
    exact = (np.exp(-0.25) - 1.0) * np.exp(-0.6)
    # with extrapolation the slope across the jump is left in one short step
    assert run["one.y[1]"][-1] == pytest.approx(exact, abs=1e-9 if extrapolation == 0 else 1e-3)


def test_a_discrete_real_holds_between_communication_points(linear: Build, tmp_path: Path) -> None:
    """It jumps between two points and arrives at the second; a continuous one is there at once."""
    continuous = linear(initial_state=0.0, **RESUMABLE)
    discrete = redescribed(continuous, tmp_path / "discrete.fmu", discrete_inputs)
    table = Table([0.0, 0.15, 0.15, 1.0], [0.0, 0.0, -1.0, -1.0])
    after = {}
    for fmu in (continuous, discrete):
        experiment = Experiment(0.2, 0.1, signals={"one.u[1]": table}, tolerance=1e-2)
        after[fmu] = simulate(System({"one": fmu}), experiment)["one.y[1]"][-1]
    assert after[discrete] == 0.0
    assert after[continuous] == pytest.approx(np.exp(-0.05) - 1.0, abs=1e-9)


def discrete_inputs(description: str) -> str:
    root = ElementTree.fromstring(description)
    for variable in root.iter("ScalarVariable"):
        if variable.get("causality") == "input":
            variable.set("variability", "discrete")
    return ElementTree.tostring(root, encoding="unicode")


@pytest.mark.parametrize("through", [0.0, 0.3])
def test_an_undeclared_output_may_follow_any_input(linear: Build, through: float) -> None:
    """Its error is taken for one that does not add up, as that of an output that declares so."""

    def steps(declares: bool) -> int:
        system = coupled(linear, through, declares_dependencies=declares, **RESUMABLE)
        return simulate(system, Experiment(1.0, 0.5, tolerance=1e-3)).provenance["steps_between_points"]

    # y of a system without direct feedthrough that declares so has to be more accurate
    assert (steps(False) == steps(True)) == (through != 0.0)
    assert steps(False) <= steps(True)
