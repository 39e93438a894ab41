"""A run has its communication points and what is set there, or is refused; prepared again, it is the same."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import SystemDefinitionError
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Event, Experiment
from orchestration.system.faults import Fault, Offset
from orchestration.system.prepared_run import PreparedRun, PreparedRuns, prepare
from orchestration.system.signals import Constant, Cosine, Ramps, Signal, Table
from orchestration.system.system import System, check
from tests.described_fmus import redescribed
from tests.shared_builds import Build

NEAR = 1e-13  # rounding, of times of about 1 s


def prepared_lag(lag: Path, *events: Event, **settings: Any) -> PreparedRun:
    """A run of 1 s in steps of 0.1 s, as it is prepared."""
    inputs = {"one.u[1]": 0.0}
    return prepare(System({"one": lag}), Experiment(1.0, 0.1, inputs=inputs, events=events, **settings))


@pytest.mark.parametrize("varies_step_size", [True, False])
@pytest.mark.parametrize("offset", [-NEAR, 0.0, NEAR])
def test_an_event_near_a_communication_point_is_at_it(
    linear: Build, varies_step_size: bool, offset: float
) -> None:
    """7 times 0.1 is not 0.7 in floating point: it is the same point, without a step of 1e-16 s."""
    lag = linear(varies_step_size=varies_step_size)
    prepared = prepared_lag(lag, Event(0.7 + offset, {"one.a": -2.0}))
    assert len(prepared.points) == 11
    assert list(prepared.changes) == [7]


def test_events_near_each_other_share_a_communication_point(linear: Build) -> None:
    events = [Event(0.25 + i * NEAR, {"one.a": -2.0 - i}) for i in range(3)]
    prepared = prepared_lag(linear(), *events)
    assert len(prepared.points) == 12
    assert {index: [value for _, value in changes] for index, changes in prepared.changes.items()} == {
        3: [-2.0, -3.0, -4.0]
    }


def test_events_that_are_not_near_have_points_of_their_own(linear: Build) -> None:
    """A thousandth of a step apart."""
    events = [Event(t, {"one.a": -2.0}) for t in (0.2001, 0.25, 0.2501)]
    prepared = prepared_lag(linear(), *events)
    assert prepared.points[2:7].tolist() == pytest.approx([0.2, 0.2001, 0.25, 0.2501, 0.3], abs=NEAR)
    assert list(prepared.changes) == [3, 4, 5]


def test_an_event_after_the_last_point_of_a_slow_component_is_at_the_end(linear: Build) -> None:
    """Steps of 0.4 s in 1 s: the next of its own points would be at 1.2 s."""
    prepared = prepared_lag(linear(), Event(0.9, {"one.a": -2.0}), step_sizes={"one": 0.4})
    assert list(prepared.changes) == [len(prepared.points) - 1] == [10]


def test_a_step_size_longer_than_the_run_is_refused() -> None:
    with pytest.raises(SystemDefinitionError, match=r"step size 2.0 s: expected at most the run, 1 s"):
        Experiment(1.0, 2.0)
    assert len(Experiment(0.3, 0.1 + 0.2).time_grid()) == 2  # equal but for rounding


@pytest.mark.parametrize(
    ("start", "step"), [("36000", "0.001"), ("1e6", "0.01"), ("-36000", "0.001"), ("0", "1e-6")]
)
def test_a_run_has_its_whole_steps_wherever_it_starts(start: str, step: str) -> None:
    """Rounding of a late start is much of a short step: no step of 0 s follows."""
    for count in (1, 2, 3, 7, 27, 506, 2999):
        stop = float(Decimal(start) + count * Decimal(step))
        experiment = Experiment(stop, float(step), float(start))
        assert experiment.step_count == count
        longer = replace(experiment, stop_time=stop + 0.1 * float(step))
        assert longer.step_count == count + 1


def test_a_late_run_needs_no_component_that_varies_its_step(linear: Build) -> None:
    system = System({"one": linear(varies_step_size=False)})
    experiment = Experiment(36000.027, 0.001, 36000.0, inputs={"one.u[1]": 0.0})
    assert len(simulate(system, experiment).time) == 28


def test_a_signal_that_misses_a_limit_by_rounding_is_on_it(linear: Build, tmp_path: Path) -> None:
    of_input = re.compile(r'(name="u\[1\]".*?<Real )', re.DOTALL)
    fmu = redescribed(linear(), tmp_path / "a.fmu", lambda xml: of_input.sub(r'\1min="0" max="1" ', xml))
    signal = Table([0.0, 0.5], [1.0, math.nextafter(1.0, 2.0)], hold=True)
    prepared = prepare(System({"one": fmu}), Experiment(1.0, 0.1, signals={"one.u[1]": signal}))
    assert prepared.values_of_signal("one.u[1]", signal).max() == 1.0


def test_a_recording_has_each_name_once(linear: Build) -> None:
    prepared = prepared_lag(linear(), record=("one.y[1]", "one.u[1]", "one.y[1]"))
    assert prepared.recorded == ("one.y[1]", "one.u[1]")


def test_a_recording_that_no_machine_holds_is_refused(linear: Build) -> None:
    system = System({f"c{i}": linear() for i in range(1000)})
    inputs = {f"c{i}.u[1]": 0.0 for i in range(1000)}
    with pytest.raises(SystemDefinitionError, match=r"1e\+09 communication points of 1000 .* GB of"):
        prepare(system, Experiment(1.0, 1e-9, inputs=inputs))


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


@pytest.mark.parametrize("signal", [Constant, lambda x: Cosine(x, 0.0), lambda x: Ramps([(0.0, x)])])
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
