"""Steps: their times, their sizes, the stop time, what a step does, and steps that are pending."""

import itertools
import math
from collections.abc import Iterator
from contextlib import suppress

from fmus.compliance import actions as do
from fmus.compliance.differential import Row, differential
from fmus.compliance.fmu_file import CO_SIMULATION, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.call_table import LARGE_TOLERANCE, TOLERANCE, run_with_tolerance
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import (
    continuous_reals,
    differing,
    if_not_claimed,
    is_utf_8,
    texts,
    unless_claimed,
)
from fmus.compliance.variable import Variable
from fmus.fmi.binding import DISCARD, LAST_SUCCESSFUL_TIME, OK, WARNING, status_name

_ASYNCHRONOUS, _PENDING_STATUS = "canRunAsynchronuously", 1  # fmi2StatusKind
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_LAST_TIME = "status_of", "Real", LAST_SUCCESSFUL_TIME
_MORE_STEPS = (13, 47, 211)  # instead of two: for each internal step from the usual size to a hundredth
_APART = 0.4  # of the change over two steps: a rough solver, but not half a step


@differential("2.1.6")
def step_beyond_the_stop_time_is_an_error(probe: Probe) -> Iterator[Row]:
    """If a stop time is defined, steps up to it succeed and a step past it returns error; fmi2Reset brings
    the instance back, where the same holds of another stop time with a tolerance.
    """
    tolerance = TOLERANCE if run_with_tolerance(probe).succeeded else None
    beyond = "a step to {} s {{}}: expected error beyond the stop time {} s"
    first, again = (
        do.error(do.step(), beyond.format(*(f"{probe.point(i):g}" for i in (stop + 1, stop))))
        for stop in (3, 1)
    )
    until = *do.begin_until(3), do.step(3)
    failing = f"with the stop time {probe.point(3):g} s, before it"
    yield Row("", (*until, first), (), failing)
    after = "after fmi2Reset from a step beyond the stop time"
    varied = *until, do.ignore(do.step()), do.reset, *do.begin_until(1, tolerance), do.step(), again
    yield Row(after, varied, ())


@differential("2.1.6")
def undefined_arguments_are_ignored(probe: Probe) -> Iterator[Row]:
    """A tolerance or a stop time that is not defined is not looked at."""
    set_up = do.call("set_up_experiment_with", [], probe.start_time, [], probe.start_time - 1.0)
    varied = set_up, do.enter_initialization_mode, do.exit_initialization_mode, do.run(2)
    failing = "with neither tolerance nor stop time defined"
    yield Row("where an undefined stop time lies before the start time", varied, failing=failing)


@behaviour_rule("2.1.6")
def tolerance_is_accepted(probe: Probe) -> Iterator[str]:
    """A tolerance that is defined is accepted."""
    if failure := run_with_tolerance(probe).failure:
        yield f"with the tolerance {TOLERANCE:g}: {failure.problem}"


def _without_independent(fmu: FmuFile) -> str:
    return "" if any(v.causality == "independent" for v in fmu.variables) else "no variable is independent"


@behaviour_rule("2.2.7", condition=_without_independent)
def time_is_the_communication_point(probe: Probe) -> Iterator[str]:
    """The independent variable is the start time after initialisation, and then the end of the last step,
    also of its multiples: after a fraction, an FMU of fixed internal steps may be behind. So it is after
    fmi2Reset, with a tolerance, a stop time and another start time, and in the default experiment.
    """
    (v,) = [v for v in probe.fmu.variables if v.causality == "independent"][:1]
    if not probe.states_step_size:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    for t, where, reading in _times(probe, v):
        got = reading.values[v.name]
        if not abs(got - t) <= 1e-3 * probe.step_size + 1e-9 * abs(t):
            shown = texts(got, t)
            yield f"{v.name} is {shown[0]} {where}: expected {shown[1]}"
            return


def _times(probe: Probe, v: Variable) -> Iterator[tuple[float, str, Reading]]:
    """Yields times, in words too, with readings of a variable, up to a call that fails."""
    initialised, point = "after initialisation with startTime {:g} s", "at the communication point {:g} s"
    # a slave of fixed internal steps may be behind after a fraction
    exchanged = (1.0, 2.0, 0.30901699) if probe.fmu.is_model_exchange else (1.0, 1.0, 1.0)
    factors = (1.0, 2.0, 3.0) if probe.fmu.claims(_ANY_STEP) else exchanged
    tolerance = LARGE_TOLERANCE if run_with_tolerance(probe).succeeded else None
    for start in (probe.start_time, probe.start_time + 3 * probe.step_size):
        script, t = probe.script(), start
        if start == probe.start_time:
            script.begin()
        else:
            script.begin().step().reset()
            script.set_up(start, probe.point(1000), tolerance).enter_initialization_mode()
            script.exit_initialization_mode()
        rows = [(script.replies[-1], script.read([v]), start, initialised.format(start))]
        for factor in factors:
            step = script.call("do_step", t, factor * probe.step_size)
            t += factor * probe.step_size
            rows.append((step, script.read([v]), t, point.format(t)))
        script.play(keep_going=True)
        for _, reading, t, where in itertools.takewhile(lambda row: row[0].ok and row[1].ok, rows):
            yield t, where, reading
    # 4.2.4 does not list it among what is read
    script = probe.script(do.forbidden).initialise(probe.point(3))
    reading = script.read([v])
    script.play(keep_going=True)
    if reading.ok:
        yield probe.point(3), f"in initialization mode with startTime {probe.point(3):g} s", reading
    with suppress(NotApplicableError, NotJudgedError):  # then the times before are judged alone
        whole = do.over_the_experiment(probe)
        count = len(whole.observed)
        for i, (*_, reading) in enumerate(whole.observed if whole.succeeded else (), 1):
            t = probe.point(probe.steps_of_experiment * i // count)
            yield t, point.format(t), reading


@behaviour_rule("4.2.2", interface=CO_SIMULATION)
def communication_points_may_be_rounded(probe: Probe) -> Iterator[str]:
    """Communication points may be sums of step sizes or multiples of one: their rounding is no error."""
    script = probe.script(logging=True).begin()
    t, h = probe.start_time, probe.step_size
    for i in range(30):
        script.call("do_step", t if i % 2 else probe.point(i), h)
        t += h
    script.play(keep_going=True)
    if script.failure and script.failure.status != DISCARD:
        yield script.failure.problem


@differential("4.2.2")
def no_set_state_flag_changes_nothing(probe: Probe) -> Iterator[Row]:
    """noSetFMUStatePriorToCurrentPoint = fmi2True is accepted, and the values are the same."""
    read = do.read([v for v in probe.fmu.variables if v.causality != "independent"])
    varied = do.start, *(do.step(no_going_back=True), read) * 3
    when = "with noSetFMUStatePriorToCurrentPoint"
    yield Row(when, varied, (do.start, *(do.step(), read) * 3), failing="")


@behaviour_rule("4.3.1", condition=unless_claimed(_ANY_STEP))
def variable_step_size(probe: Probe) -> Iterator[str]:
    """Steps of different sizes succeed one after the other; one that is discarded says how far it came."""
    script = probe.script(logging=True).begin()
    ends = [probe.start_time]
    for factor in (1.0, 0.5, 2.0, 0.25, 1.5):
        script.call("do_step", ends[-1], factor * probe.step_size)
        ends.append(ends[-1] + factor * probe.step_size)
    last = script.call(*_LAST_TIME)
    script.play(keep_going=True)
    failure = script.failure if script.failure is not last else None
    if failure is None:
        return
    number = sum(reply.is_step and reply.ok for reply in script.replies)
    t, end = ends[number : number + 2]
    # a discarded step tells where it ended: without that the master cannot go on
    if failure.status != DISCARD or end - t < 0.9 * probe.step_size:
        yield f"a step of {end - t:g} s after one of {probe.step_size:g} s: {failure.problem}"
    if last.ok and not t - 1e-9 * abs(t) <= last.value < end:
        yield f"a step from {t:g} to {end:g} s is discarded, and fmi2LastSuccessfulTime is {last.value:g} s"


@behaviour_rule("4.3.1", condition=unless_claimed(_ANY_STEP))
def two_steps_are_one_of_twice_the_size(probe: Probe) -> Iterator[str]:
    """A step reaches its end: after a step, two more bring continuous outputs about as far as one of twice
    the size, or many of no simple fraction of it.
    """
    chosen = continuous_reals(probe, "output")
    small, others = probe.script().begin(), [(n, probe.script().begin()) for n in (1, *_MORE_STEPS)]
    before = small.step().read(chosen)
    two = small.step(2).read(chosen)
    readings = [_in_steps(probe, script, n).read(chosen) for n, script in others]
    small.play()
    probe.play_each([script for _, script in others])
    if not chosen or not any(script.succeeded for _, script in others):
        raise NotJudgedError("there is no continuous output, or no step of twice the size")
    names = [v.name for v in chosen if abs(_change(before, two, v.name)) > 1e-9 * abs(two.values[v.name])]
    for (n, script), got in zip(others, readings, strict=True):
        if script.succeeded and names and all(_is_elsewhere(before, two, got, name) for name in names):
            shown = texts(got.values[names[0]], two.values[names[0]])
            steps = "one step" if n == 1 else f"{n} steps"
            yield (
                f"{names[0]} is {shown[0]} after {steps} of {2 * probe.step_size / n:g} s: expected about "
                f"{shown[1]}, as after two of {probe.step_size:g} s"
            )
            return


def _in_steps(probe: Probe, script: Script, count: int) -> Script:
    """Returns a script that goes two usual steps further, after the first, in equal steps of a number."""
    h = 2 * probe.step_size / count
    script.step()
    for i in range(count):
        script.call("do_step", probe.point(1) + i * h, h)
    return script


def _is_elsewhere(before: Reading, two: Reading, got: Reading, name: str) -> bool:
    return abs(got.values[name] - two.values[name]) > _APART * abs(_change(before, two, name))


def _change(before: Reading, after: Reading, name: str) -> float:
    return after.values[name] - before.values[name]


@behaviour_rule("advice: 2.2.5, what a user runs first")
def default_experiment_runs(probe: Probe) -> Iterator[str]:
    """The steps of DefaultExperiment succeed up to its stop time, as far as they take about a second."""
    if not probe.states_step_size or not math.isfinite(probe.stop_time):
        raise NotApplicableError("no stop time and step size are stated")
    failure = do.over_the_experiment(probe).failure
    if failure and failure.status != DISCARD:
        yield failure.problem


# steps that are pending


@behaviour_rule("4.2.2", condition=if_not_claimed(_ASYNCHRONOUS), interface=CO_SIMULATION)
def steps_are_not_pending(probe: Probe) -> Iterator[str]:
    """Without canRunAsynchronuously, fmi2DoStep does not return pending."""
    script = probe.script(logging=True).begin()
    pending = script.call("begin_step", probe.start_time, probe.step_size)
    script.play(keep_going=True)
    if pending.value:
        yield "fmi2DoStep returned pending: expected that only with canRunAsynchronuously"


@behaviour_rule("2.1.5", condition=unless_claimed(_ASYNCHRONOUS))
def step_finished_is_called(probe: Probe) -> Iterator[str]:
    """After a pending step, perhaps also after others, the callback stepFinished is called once; without it
    fmi2GetStatus tells the step's end.
    """
    count = 3
    script = probe.script(logging=True).begin().step(count)
    steps = script.call("finished_steps")
    script.play(keep_going=True)
    pending, calls = steps.value or (0, [])
    finished = len(calls)
    if script.failure:
        yield script.failure.problem
    elif not pending <= finished <= count:  # a step that is not pending is completed too
        yield (
            f"stepFinished was called {finished} times for {pending} pending steps of {count}: "
            "expected once for each"
        )
    if not all(right_environment for _, right_environment in calls):
        yield "stepFinished was called without the componentEnvironment of its instance"
    if not script.failure and any(status not in (OK, WARNING) for status, _ in calls):
        statuses = ", ".join(sorted({status_name(status) for status, _ in calls}))
        yield f"stepFinished was called with the status {statuses} for steps that succeed: expected theirs"
    fewest = probe.script(callbacks="fewest").begin().step(3)
    fewest.play(keep_going=True)
    if fewest.failure:
        yield f"without stepFinished: {fewest.failure.problem}"


@behaviour_rule("4.2.3", condition=unless_claimed(_ASYNCHRONOUS))
def status_of_a_pending_step_is_given(probe: Probe) -> Iterator[str]:
    """While a step is pending, fmi2GetStatus returns ok and gives pending, or the status of the step that has
    ended; a text of fmi2PendingStatus is UTF-8.
    """
    script = probe.script(logging=True).begin()
    pending = script.call("begin_step", probe.start_time, probe.step_size)
    text = script.call("status_of", "String", _PENDING_STATUS)
    polled = script.call("poll_step")
    time = script.read([v for v in probe.fmu.variables if v.causality == "independent"])
    outputs = script.read(probe.outputs)
    usual = do.played(probe, (do.begin, do.run(1)))
    script.play(keep_going=True)
    if not pending.value:
        raise NotJudgedError("the step was not pending")
    if text.ok and (text.value is None or not is_utf_8(bytes.fromhex(text.value))):
        shown = "NULL" if text.value is None else bytes.fromhex(text.value)
        yield f"fmi2GetStringStatus of fmi2PendingStatus is {shown!r}: expected a text in UTF-8"
    if polled.status is None:
        return
    answer, step = polled.value[-1]
    if answer:
        yield f"fmi2GetStatus of a pending step returned {status_name(answer)}: expected ok and its status"
    elif step not in (OK, WARNING):
        yield f"fmi2GetStatus gives {status_name(step)} for a step that succeeds: expected ok"
    elif outputs.ok and time.ok:
        expected = [reading for *_, reading in usual.observed]
        yield from differing(expected, [outputs], "after a step that has ended by fmi2GetStatus")
