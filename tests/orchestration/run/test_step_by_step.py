"""Runs led step by step: the same as `run`, but for what is set between the steps."""

import gc
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from orchestration.errors import FmuWarning, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.run.run import Run
from orchestration.scenarios.declarations import fault
from orchestration.system.experiment import Event, Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import alone, coupled
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits, interrupt_at
from tests.shared_builds import Build

STATES = {"saves_state": True}
FORCED = Experiment(1.0, 0.1, inputs={"one.u[1]": 2.0})
EXTERNAL = ("one.u[1]",)


def stepped(simulator: Simulator, experiment: Experiment, external: tuple[str, ...] = ()) -> Recording:
    run = simulator.start(experiment, external)
    while run.time < experiment.stop_time:
        run.step()
    return run.recording()


@pytest.fixture
def one(linear: Build) -> Iterator[Simulator]:
    """Of one linear system, x' = -x + u, that saves its state."""
    with Simulator(alone(linear, saves_state=True)) as simulator:
        yield simulator


@pytest.fixture
def forced(one: Simulator) -> Run:
    """A run whose input is external."""
    return one.start(FORCED, EXTERNAL)


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize(
    ("options", "capabilities"),
    [
        ({}, {}),
        ({"extrapolation": 1}, STATES),
        ({"events": (Event(0.33, {"one.a": -5.0}), Event(0.4, {"two.a": -1.0}))}, STATES),
        ({"faults": (fault({"input": "two.u[1]", "kind": "delay", "delay": 0.2}, "fault"),)}, {}),
        ({"step_sizes": {"two": 0.2}, "extrapolation": 1}, {}),
        ({"tolerance": 1e-2}, STATES),
    ],
    ids=["plain", "extrapolation", "events", "fault", "step sizes", "tolerance"],
)
def test_steps_make_the_recording_of_a_run(
    linear: Build, algorithm: Any, options: Any, capabilities: Any
) -> None:
    experiment = Experiment(1.0, 0.1, algorithm=algorithm, **options)
    with Simulator(coupled(linear, **capabilities)) as simulator:
        expected = simulator.run(experiment)
        steps = stepped(simulator, experiment)
    assert_same_bits(steps, expected)
    assert (steps.units, steps.provenance) == (expected.units, expected.provenance)


def test_a_run_advances_to_the_first_point_that_is_not_before_a_time(one: Simulator) -> None:
    expected = one.run(FORCED)
    run = one.start(FORCED)
    reached = []
    # 0.3 lies a rounding before the third point, the next one a rounding behind it
    for time in (0.3, 0.3 + 2e-16, 0.35, 0.1, 2.0):
        run.advance(time)
        reached.append(run.point)
    assert reached == [3, 3, 4, 4, 10]
    run.advance()
    assert_same_bits(run.recording(), expected)


def test_a_run_that_was_interrupted_goes_on(one: Simulator) -> None:
    expected = one.run(FORCED)
    run = one.start(FORCED)
    with pytest.raises(KeyboardInterrupt):
        run.advance(progress=interrupt_at(1))
    assert 0 < run.point < 10
    run.advance()
    assert_same_bits(run.recording(), expected)


@pytest.mark.parametrize("saves_state", [True, False])
def test_a_discarded_step_is_taken_in_shorter_ones_as_in_a_run(rogue: Build, saves_state: bool) -> None:
    """At once: every step is a plain one but the first."""
    experiment = replace(doing(Misdeed.DISCARD, longest_step=0.04), inputs={"rogue.u": 1.0})
    made = []
    with Simulator(System({"rogue": rogue(saves_state=saves_state)})) as simulator:
        for make in (simulator.run, partial(stepped, simulator)):
            try:
                made.append(make(experiment))
            except SimulationError as error:
                made.append(error.recording)
    expected, steps = made
    assert len(expected.time) == (11 if saves_state else 6)
    assert np.array_equal(steps.values, expected.values)
    assert steps.provenance == expected.provenance


def test_warnings_of_fmus_are_emitted(linear: Build, rogue: Build) -> None:
    with Simulator(pair(linear, rogue)) as simulator, pytest.warns(FmuWarning, match="fmi2DoStep"):
        stepped(simulator, doing(Misdeed.WARNING))


def test_what_an_external_input_is_set_to_acts_like_a_signal_of_the_same_values(one: Simulator) -> None:
    def force(time: float) -> float:
        return 3.0 if time > 0.45 else -1.0

    expected = one.run(Experiment(1.0, 0.1, signals={"one.u[1]": force}))
    run = one.start(Experiment(1.0, 0.1), external=EXTERNAL)
    while run.time < 1.0:
        run.set("one.u[1]", force(run.time))
        run.step()
    run.set("one.u[1]", force(1.0))
    # the initial value of a signal is that of the start time, of an external input the FMU's start value
    assert_same_bits(run.recording(), expected)


def test_an_external_input_is_held_where_others_are_extrapolated(linear: Build) -> None:
    made = []
    with Simulator(alone(linear, interpolates_inputs=True)) as simulator:
        for order in (0, 1):
            run = simulator.start(Experiment(1.0, 0.25, extrapolation=order), EXTERNAL)
            while not run.is_done:
                run.set("one.u[1]", run.time)
                run.step()
            made.append(run.recording().values)
    assert np.array_equal(*made)


def test_a_fault_acts_on_an_external_input(one: Simulator) -> None:
    stuck = fault({"input": "one.u[1]", "kind": "stuck", "value": 7.0, "start": 0.5}, "fault")
    recording = stepped(one, Experiment(1.0, 0.25, faults=(stuck,)), EXTERNAL)
    assert recording["one.u[1]"].tolist() == [0.0, 0.0, 7.0, 7.0, 7.0]


def test_a_value_is_read_where_it_is_recorded(forced: Run) -> None:
    read, write = forced.reader("one.y[1]", "one.u[1]"), forced.writer("one.u[1]")
    assert read() == (1.0, 2.0)
    write(5.0)
    assert (forced.read("one.u[1]"), read()) == (5.0, (1.0, 5.0))
    forced.step()
    output = forced.read("one.y[1]")
    assert forced.reader("one.y[1]")() == output
    recording = forced.recording()
    assert recording.time.tolist() == [0.0, 0.1]
    assert recording["one.u[1]"].tolist() == [5.0, 5.0]
    assert recording["one.y[1]"].tolist() == [1.0, output]


def test_a_variable_that_is_not_recorded_is_read_from_its_fmu(linear: Build) -> None:
    with Simulator(coupled(linear, passes_discrete=True)) as simulator:
        inputs = {"one.integer_in": 3, "one.boolean_in": True, "two.integer_in": 4, "two.boolean_in": False}
        run = simulator.start(Experiment(1.0, 0.1, inputs=inputs, record=("one.y[1]", "one.integer_out")))
        assert run.read("two.a") == -2.0
        assert run.reader("one.y[1]", "two.a")() == (run.read("one.y[1]"), -2.0)
        assert run.reader("two.integer_out")() == 4
        assert repr(run.read("one.integer_out")) == "3"


def test_tunable_parameters_and_constant_inputs_are_set_between_steps(one: Simulator) -> None:
    experiment = Experiment(1.0, 0.5, inputs={"one.u[1]": 2.0})
    change = Event(0.5, {"one.a": -4.0, "one.u[1]": 1.0})
    expected = one.run(replace(experiment, events=(change,)))
    run = one.start(experiment)
    run.step()
    run.writer("one.a", "one.u[1]")(-4.0, 1.0)
    run.step()
    assert_same_bits(run.recording(), expected)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.set("one.u[1]", "much"), "one.u[1] = 'much': expected a number"),
        (lambda s: s.set("one.u[1]", np.nan), "one.u[1] = nan: expected a finite number"),
        (lambda s: s.set("one.u[1]", -np.inf), "one.u[1] = -inf: expected a finite number"),
        (lambda s: s.set("one.y[1]", 1.0), "set: one.y[1] does not fit: expected a parameter or an input"),
        (lambda s: s.set("one.initial_state", 1.0), "set: one.initial_state is fixed"),
        (lambda s: s.set("one.v", 1.0), "set: no variable 'one.v'; nearest is"),
        (lambda s: s.read("uno.y[1]"), "read: no component 'uno' for 'uno.y[1]'; known: 'one'"),
        (lambda s: s.reader("one.z"), "reader: no variable 'one.z'; nearest is"),
        (lambda s: s.reader(), "reader: expected the name of a variable, or several"),
        (lambda s: s.writer(), "writer: expected the name of a variable, or several"),
    ],
)
def test_what_cannot_be_read_or_set_is_refused(forced: Run, call: Callable[[Run], Any], message: str) -> None:
    with pytest.raises(SystemDefinitionError) as refusal:
        call(forced)
    assert message in str(refusal.value)
    forced.step()


def test_a_connected_input_cannot_be_set(linear: Build) -> None:
    with Simulator(coupled(linear)) as simulator:
        run = simulator.start(Experiment(1.0, 0.1))
        with pytest.raises(SystemDefinitionError, match=r"two.u\[1\] is driven already, by a connection"):
            run.set("two.u[1]", 1.0)
        with pytest.raises(SystemDefinitionError, match=r"two.u\[1\] is driven 2 times: expected once"):
            simulator.start(Experiment(1.0, 0.1), external=("two.u[1]",))


def test_a_step_needs_a_time_before_the_stop_time(one: Simulator) -> None:
    recording = stepped(one, FORCED)
    run = one.start(FORCED)
    while not run.is_done:
        run.step()
    with pytest.raises(OrchestrationError, match="at its stop time, 1 s: expected no further step"):
        run.step()
    assert_same_bits(run.recording(), recording)


def test_a_run_with_its_readers_and_writers_ends_when_another_begins(one: Simulator, forced: Run) -> None:
    calls = {
        "the reader belongs to a run that has ended": forced.reader("one.y[1]"),
        "the writer belongs to a run that has ended": partial(forced.writer("one.u[1]"), 1.0),
    }
    state = forced.save()
    one.run(FORCED)
    for message, call in calls.items():
        with pytest.raises(OrchestrationError, match=message):
            call()
    for call in (
        forced.step,
        forced.save,
        forced.recording,
        partial(forced.restore, state),
        partial(forced.read, "one.y[1]"),
        partial(forced.set, "one.u[1]", 1.0),
    ):
        with pytest.raises(OrchestrationError, match="the run has ended: expected start"):
            call()


def test_a_step_that_fails_keeps_the_recording_and_ends_the_run(linear: Build, rogue: Build) -> None:
    with Simulator(pair(linear, rogue)) as simulator:
        run = simulator.start(doing(Misdeed.ERROR))
        with pytest.raises(SimulationError) as failure:
            [run.step() for _ in range(10)]
        assert len(failure.value.recording.time) == 6
        assert_same_bits(run.recording(), failure.value.recording)
        with pytest.raises(OrchestrationError, match="fmi2DoStep returned error"):
            run.step()
        assert len(stepped(simulator, doing(Misdeed.NONE)).time) == 11


def test_a_run_lets_go_of_its_rows_when_another_begins(one: Simulator) -> None:
    """Without a collection of cycles: the next run takes its memory, which is quicker than new memory."""
    gc.disable()
    try:
        one.run(FORCED)
        first = weakref.ref(one._last_run)
        assert first()
        one.run(FORCED)
        assert first() is None
    finally:
        gc.enable()
