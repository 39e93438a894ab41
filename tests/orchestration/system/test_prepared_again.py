"""A simulator that prepares a run again from the one before gives what a new simulator gives."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import SystemDefinitionError
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Event, Experiment
from orchestration.system.faults import Fault, Offset
from orchestration.system.prepared_run import PreparedRuns
from orchestration.system.signals import Constant, Cosine, Ramps, Signal
from orchestration.system.system import System, check

FIRST = Experiment(
    0.5,
    0.01,
    start_time=0.1,
    parameters={"p.omega": 1.5},
    inputs={"p.disturbance": 0.1},
    signals={"p.control": Cosine(1.0, 9.0)},
)
CHANGES: dict[str, Callable[[Experiment], Experiment]] = {
    "parameter": lambda e: replace(e, parameters={"p.omega": 0.5}),
    "another parameter": lambda e: replace(e, parameters={"p.initial_state[1]": 0.3}),
    "no parameter": lambda e: replace(e, parameters={}),
    "input": lambda e: replace(e, inputs={"p.disturbance": -1.0}),
    "signal": lambda e: replace(e, signals={"p.control": Constant(2.0)}),
    "function": lambda e: replace(e, signals={"p.control": lambda t: t}),
    "times": lambda e: replace(e, start_time=0.2, stop_time=0.8, step_size=0.02),
    "record": lambda e: replace(e, record=("p.output",)),
    "event": lambda e: replace(e, events=(Event(0.2, {"p.omega": 2.0}),)),
    "fault": lambda e: replace(e, faults=(Fault("p.control", Offset(0.5)),)),
}


@pytest.fixture
def system(built: Mapping[str, Path]) -> System:
    return System({"p": built["ExamplePlant"]})


@pytest.mark.parametrize("extrapolation", [0, 1])
def test_runs_after_another_are_those_of_a_new_simulator(system: System, extrapolation: int) -> None:
    """An extrapolation begins without an earlier sample, too."""
    first = replace(FIRST, extrapolation=extrapolation)
    with Simulator(system) as simulator:
        for change in (lambda e: e, *CHANGES.values()):
            for experiment in (first, change(first), change(first)):
                recording, expected = simulator.run(experiment), simulate(system, experiment)
                assert recording.names == expected.names
                assert np.array_equal(recording.time, expected.time)
                assert np.array_equal(recording.values, expected.values)
                assert recording.provenance == expected.provenance
                recording.time[:] = recording.values[:] = 7.0  # of the caller, and of no later run


def test_signals_that_changed_meanwhile_are_evaluated_again(system: System) -> None:
    """In the dictionary of the same experiment, or what a function reads."""
    gain = [1.0]
    changed = replace(FIRST, signals={"p.control": Constant(1.0)})
    function = replace(FIRST, signals={"p.control": lambda t: gain[0]})
    with Simulator(system) as simulator:
        values = [simulator.run(changed)["p.control"][-1]]
        changed.signals["p.control"] = Constant(2.0)  # type: ignore[index]
        values += [simulator.run(changed)["p.control"][-1], simulator.run(function)["p.control"][-1]]
        gain[0] = 3.0
        values.append(simulator.run(function)["p.control"][-1])
    assert values == [1.0, 2.0, 1.0, 3.0]


def test_the_sign_of_a_zero_is_that_of_the_run(system: System) -> None:
    with Simulator(system) as simulator:
        for value in (0.0, -0.0, 0.0):
            experiment = replace(FIRST, signals={"p.control": Constant(value)})
            assert np.signbit(simulator.run(experiment)["p.control"]).all() == np.signbit(value)


@pytest.mark.parametrize(
    "signal", [Constant, lambda value: Cosine(value, 0.0), lambda value: Ramps([(0.0, value)])]
)
def test_numbers_that_numpy_shows_alike_are_those_of_the_run(
    system: System, signal: Callable[[Any], Signal]
) -> None:
    """NumPy shows 8 digits of a number in an array."""
    numbers = [np.array(1.0), np.array(1.0 + 1e-9), np.float64(1.0 + 2e-9), 1.0]
    with Simulator(system) as simulator:
        runs = [simulator.run(replace(FIRST, signals={"p.control": signal(x)})) for x in numbers]
    assert [run["p.control"][-1] for run in runs] == [1.0, 1.0 + 1e-9, 1.0 + 2e-9, 1.0]


def test_only_runs_that_differ_in_values_are_prepared_again(system: System) -> None:
    checked, runs = check(system, FIRST.driven_inputs), PreparedRuns()
    only_values_differ = {}
    for name, change in CHANGES.items():
        runs.prepare(checked, FIRST)
        runs.prepare(checked, change(FIRST))
        only_values_differ[name] = runs.only_values_differ
    assert [name for name, again in only_values_differ.items() if again] == [
        "parameter", "another parameter", "no parameter", "input"
    ]  # fmt: skip


def test_a_refused_value_is_refused_again_and_leaves_the_next_run_as_it_is(system: System) -> None:
    with Simulator(system) as simulator:
        expected = simulator.run(FIRST).values
        for _ in range(2):
            with pytest.raises(SystemDefinitionError, match="internal_step"):
                simulator.run(replace(FIRST, parameters={"p.internal_step": -1.0}))
            assert np.array_equal(simulator.run(FIRST).values, expected)
