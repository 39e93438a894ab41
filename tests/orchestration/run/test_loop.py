"""The compiled loop, also on threads, is the one in Python, to the last bit, whatever the wiring."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fmus.errors import ExportError
from orchestration.errors import SimulationError
from orchestration.run import Simulator, compiled_loop, simulate
from orchestration.scenarios.declarations import fault
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.signals import Cosine
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import coupled
from tests.shared_builds import Build

FAULTS = [
    {"kind": "freeze", "start": 0.2, "end": 0.4},
    {"kind": "delay", "delay": 0.07},
    {"kind": "noise", "standard_deviation": 0.1, "seed": 3},
    {"kind": "drop-out", "probability": 0.3, "seed": 4, "start": 0.1},
]


def in_each_way(system: System, experiment: Experiment) -> list[Any]:
    """What each loop makes of it, compiled, in Python, on threads: recordings, or errors that hold them."""
    outcomes = []
    for is_compiled, threads in ((True, 1), (False, 1), (True, 3)):
        with Simulator(system, is_compiled, threads) as simulator:
            try:
                outcomes.append(simulator.run(experiment))
            except SimulationError as error:
                outcomes.append(error)
    return outcomes


@given(
    algorithm=st.sampled_from(Algorithm),
    extrapolation=st.sampled_from([0, 1]),
    interpolates=st.booleans(),
    order=st.permutations(["one", "two", "three"]),
    periods=st.tuples(*[st.integers(1, 4)] * 3),
    faulty=st.lists(
        st.tuples(st.sampled_from(["one.u[1]", "two.u[1]", "three.u[1]"]), st.sampled_from(FAULTS))
    ),
    step=st.sampled_from([0.05, 0.07]),
    factor=st.sampled_from([1.0, -0.3]),
    versions=st.tuples(*[st.sampled_from([2, 3])] * 3),
)
@example(Algorithm.JACOBI, 1, True, ["one", "two", "three"], (2, 3, 1), [], 0.07, 1.0, (2, 2, 2))
@example(Algorithm.JACOBI, 1, False, ["one", "two", "three"], (3, 2, 2), [], 0.07, 1.0, (3, 3, 2))
def test_all_loops_agree(
    linear: Build,
    algorithm: Algorithm,
    extrapolation: int,
    interpolates: bool,
    order: list[str],
    periods: tuple[int, int, int],
    faulty: list[tuple[str, dict]],
    step: float,
    factor: float,
    versions: tuple[int, int, int],
) -> None:
    options = {"a": -2.0, "d": ((0.1,),), "passes_discrete": True, "interpolates_inputs": interpolates}
    connections = (
        ("one.y[1]", "two.u[1]"),
        ("two.y[1]", "three.u[1]", {"factor": factor, "offset": 0.1}),
        ("one.integer_out", "two.integer_in"),
        ("two.boolean_out", "one.boolean_in"),
    )
    fmus = {name: linear(fmi=fmi, **options) for name, fmi in zip(order, versions, strict=True)}
    system = System(fmus, connections)
    experiment = Experiment(
        1.0,
        step,
        algorithm=algorithm,
        inputs={
            "one.integer_in": 7,
            "three.integer_in": -3,
            "two.boolean_in": True,
            "three.boolean_in": False,
        },
        signals={"one.u[1]": Cosine(1.0, 6.0)},
        extrapolation=extrapolation,
        step_sizes={name: n * step for name, n in zip(("one", "two", "three"), periods, strict=True)},
        faults=tuple(fault({"input": name, **declared}, "here") for name, declared in faulty),
    )
    fast, slow, shared = in_each_way(system, experiment)
    assert fast.names == slow.names
    assert np.array_equal(fast.values, slow.values)
    assert np.array_equal(fast.values, shared.values)
    assert fast["two.integer_out"][-1] == 7.0
    assert len(np.unique(fast["three.y[1]"])) > 2
    if not interpolates:  # which FMI 3.0 has no function for
        of_fmi_2 = System(dict.fromkeys(order, linear(**options)), connections)
        assert np.array_equal(fast.values, in_each_way(of_fmi_2, experiment)[0].values)


@given(
    algorithm=st.sampled_from(Algorithm),
    extrapolation=st.sampled_from([0, 1]),
    interpolates=st.booleans(),
    periods=st.tuples(st.integers(1, 4), st.integers(1, 4)),
)
def test_a_fault_that_changes_nothing_changes_nothing(
    linear: Build, algorithm: Algorithm, extrapolation: int, interpolates: bool, periods: tuple[int, int]
) -> None:
    harmless = tuple(
        fault({"input": name, "kind": "offset", "value": 0.0}, "here") for name in ("one.u[1]", "two.u[1]")
    )
    sizes = {"one": 0.05 * periods[0], "two": 0.05 * periods[1]}
    experiment = Experiment(1.0, 0.05, algorithm=algorithm, extrapolation=extrapolation, step_sizes=sizes)
    with Simulator(coupled(linear, interpolates_inputs=interpolates)) as simulator:
        healthy = simulator.run(experiment)
        assert np.array_equal(simulator.run(replace(experiment, faults=harmless)).values, healthy.values)


@pytest.mark.parametrize(
    "misdeed", [Misdeed.ERROR, Misdeed.DISCARD, Misdeed.NAN_OUTPUT, Misdeed.REFUSE_INPUT]
)
def test_all_loops_fail_alike(rogue: Build, linear: Build, misdeed: Misdeed) -> None:
    system = System({"bad": rogue(), "good": linear()}, (("bad.y", "good.u[1]"), ("good.y[1]", "bad.u")))
    parameters = {"bad.misdeed": int(misdeed), "bad.misdeed_time": 0.5}
    fast, slow, shared = in_each_way(system, Experiment(1.0, 0.1, parameters=parameters))
    assert str(fast) == str(slow) == str(shared)
    assert np.array_equal(fast.recording.values, slow.recording.values, equal_nan=True)
    assert np.array_equal(fast.recording.values, shared.recording.values, equal_nan=True)
    assert 5 <= len(fast.recording.time) <= 7


def test_without_a_compiler_the_loop_in_python_runs_with_a_warning(
    linear: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = Experiment(1.0, 0.1)
    expected = simulate(coupled(linear), experiment)

    def refuse() -> None:
        raise ExportError("no compiler")

    monkeypatch.setattr(compiled_loop, "library", refuse)
    with pytest.warns(UserWarning, match="the communication loop runs in Python, which is slower: no compil"):
        recording = simulate(coupled(linear), experiment)
    assert np.array_equal(recording.values, expected.values)


def test_all_loops_name_the_function_of_a_call_that_fails(linear: Build) -> None:
    """Not the first one of its kind, which sets the Reals."""
    refusing = linear(passes_discrete=True, refuses_boolean_from=0.45)
    system = System(
        {"source": linear(passes_discrete=True), "refusing": refusing},
        [
            (f"source.{name}", f"refusing.{target}")
            for name, target in (
                ("y[1]", "u[1]"),
                ("integer_out", "integer_in"),
                ("boolean_out", "boolean_in"),
            )
        ],
    )
    inputs = {"source.u[1]": 1.0, "source.integer_in": 3, "source.boolean_in": True}
    fast, slow, shared = in_each_way(system, Experiment(1.0, 0.1, inputs=inputs))
    assert str(fast) == str(slow) == str(shared)
    assert "refusing at t = 0.5 s: fmi2SetBoolean returned discard: no Boolean is taken any more" in str(fast)


def test_all_loops_exchange_what_a_slow_component_gives_at_the_last_point(linear: Build) -> None:
    """Its last step is a shorter one: the last point is none of its own."""
    system = System(dict.fromkeys(("one", "two"), linear()), (("one.y[1]", "two.u[1]"),))
    record = ("one.y[1]", "two.u[1]")
    experiment = Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, step_sizes={"one": 0.3}, record=record)
    for run in in_each_way(system, experiment):
        assert run["two.u[1]"][-1] == run["one.y[1]"][-1] < run["one.y[1]"][-2]
