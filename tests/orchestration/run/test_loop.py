"""The compiled loop, also on threads, fails as that in Python, and faults that change nothing do nothing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fmus.errors import ExportError
from orchestration.errors import OrchestrationError, SimulationError
from orchestration.run import Simulator, compiled_loop, simulate
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.faults import Fault, Offset
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import coupled
from tests.orchestration.python_loop import LoopInPython
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build


def in_each_way(system: System, experiment: Experiment) -> list[Any]:
    """What each loop makes of it, compiled, in Python, on threads: recordings, or errors that hold them."""
    outcomes = []
    for made in (Simulator(system, threads=1), LoopInPython(system), Simulator(system, threads=3)):
        with made as simulator:
            try:
                outcomes.append(simulator.run(experiment))
            except SimulationError as error:
                outcomes.append(error)
    return outcomes


@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize("extrapolation", [0, 1])
@pytest.mark.parametrize("step_sizes", [{}, {"one": 0.15, "two": 0.1}])
def test_a_fault_that_changes_nothing_changes_nothing(
    linear: Build, algorithm: Algorithm, extrapolation: int, step_sizes: dict[str, float]
) -> None:
    harmless = tuple(Fault(name, Offset(0.0)) for name in ("one.u[1]", "two.u[1]"))
    settings: dict[str, Any] = {"extrapolation": extrapolation, "step_sizes": step_sizes}
    experiment = Experiment(1.0, 0.05, algorithm=algorithm, **settings)
    with Simulator(coupled(linear, interpolates_inputs=True)) as simulator:
        healthy = simulator.run(experiment)
        assert_same_bits(simulator.run(replace(experiment, faults=harmless)), healthy)


@pytest.mark.parametrize(
    "misdeed", [Misdeed.ERROR, Misdeed.DISCARD, Misdeed.NAN_OUTPUT, Misdeed.REFUSE_INPUT]
)
def test_all_loops_fail_alike(rogue: Build, linear: Build, misdeed: Misdeed) -> None:
    fast, slow, shared = in_each_way(pair(linear, rogue, saves_state=False), doing(misdeed))
    assert str(fast) == str(slow) == str(shared)
    assert np.array_equal(fast.recording.values, slow.recording.values, equal_nan=True)
    assert np.array_equal(fast.recording.values, shared.recording.values, equal_nan=True)
    assert 5 <= len(fast.recording.time) <= 7


def test_a_loop_that_cannot_be_compiled_is_an_error(linear: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_loop, "_library_or_error", lambda: ExportError("no compiler"))
    with pytest.raises(OrchestrationError, match="the communication loop is not compiled: no compiler"):
        simulate(coupled(linear), Experiment(1.0, 0.1))


def test_all_loops_name_the_function_of_a_call_that_fails(linear: Build) -> None:
    """Not the first one of its kind, which sets the Reals."""
    refusing = linear(passes_discrete=True, refuses_boolean_from=0.45)
    connections = [
        ("source.y[1]", "refusing.u[1]"),
        ("source.integer_out", "refusing.integer_in"),
        ("source.boolean_out", "refusing.boolean_in"),
    ]
    system = System({"source": linear(passes_discrete=True), "refusing": refusing}, connections)
    inputs = {"source.u[1]": 1.0, "source.integer_in": 3, "source.boolean_in": True}
    fast, slow, shared = in_each_way(system, Experiment(1.0, 0.1, inputs=inputs))
    assert str(fast) == str(slow) == str(shared)
    assert "refusing at t = 0.5 s: fmi2SetBoolean returned discard: no Boolean is taken any more" in str(fast)


@pytest.mark.slow
def test_all_loops_exchange_what_a_slow_component_gives_at_the_last_point(linear: Build) -> None:
    """Its last step is a shorter one: the last point is none of its own."""
    system = System(dict.fromkeys(("one", "two"), linear()), (("one.y[1]", "two.u[1]"),))
    record = ("one.y[1]", "two.u[1]")
    experiment = Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, step_sizes={"one": 0.3}, record=record)
    for run in in_each_way(system, experiment):
        assert run["two.u[1]"][-1] == run["one.y[1]"][-1] < run["one.y[1]"][-2]
