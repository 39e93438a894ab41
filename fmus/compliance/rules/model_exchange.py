"""Model exchange (chapter 3): states and their derivatives, event indicators, events."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial, wraps
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance.differential import AT_FIRST, OF_EXPERIMENT, Row, Start, differences, starts
from fmus.compliance.fmu_file import MODEL_EXCHANGE, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Check, NotJudgedError, behaviour_rule
from fmus.compliance.script import KINDS, CallError, Reading, Reply, Script
from fmus.compliance.values import if_not_claimed, references_of, same, texts, unless_claimed
from fmus.compliance.variable import Variable, is_true
from fmus.fmi.binding import DISCARD

_STATES, _DERIVATIVES = "fmi2GetContinuousStates", "fmi2GetDerivatives"
_INDICATORS, _NOMINALS = "fmi2GetEventIndicators", "fmi2GetNominalsOfContinuousStates"
_STEPS = 50  # of the run whose events are observed
_SOLVED = 1e-6  # relative: what an iterative solver in the FMU may change
_JUMP = 0.01  # of an indicator of the order of one, in a millionth of a step
_HYSTERESIS = 1e-6  # of an indicator of the order of one, at most
_MOST_STATES = 20  # that are moved alone
_NO_BOOLEAN = -1234567  # of a flag that the FMU has not written
_NOT_NEEDED = "completedIntegratorStepNotNeeded"
_NO_EVENT = "communication point"
_Observed = dict[str, Any]
_rule = partial(behaviour_rule, interface=MODEL_EXCHANGE)


def _no_states(fmu: FmuFile) -> str:
    return "" if fmu.vector_length(_STATES) else "it has no continuous states"


def _no_indicators(fmu: FmuFile) -> str:
    return "" if fmu.vector_length(_INDICATORS) else "it has no event indicators"


def _discrete(fmu: FmuFile) -> list[Variable]:
    return [v for v in fmu.variables if v.variability == "discrete" and v.causality != "input"]


def _states(fmu: FmuFile) -> list[Variable]:
    return [fmu.variables[index - 1] for index in fmu.state_derivatives.values()]


def _vectors(probe: Probe, script: Script, functions: Sequence[str]) -> list[Reply]:
    return [script.call("vector", function) for function in functions if probe.fmu.vector_length(function)]


# continuous-time mode


class _Start:
    """States at a start of rows, and the times between which there is no time event."""

    def __init__(self, probe: Probe, start: Start) -> None:
        script = probe.script(do.start, lead=start.lead)
        info = script.call("new_discrete_states")
        states, nominals = _vectors(probe, script, (_STATES, _NOMINALS)) or (Reply("", ""), Reply("", ""))
        script.play()
        self.states, self.nominals = states.value or [], nominals.value or []
        self.begin, end = script.time, script.time + probe.step_size
        if info.value["nextEventTimeDefined"]:
            end = min(end, info.value["nextEventTime"])
        if not end > self.begin:
            raise NotJudgedError("there is an event at the start")
        self.size = end - self.begin

    def near(self, part: float) -> list[float]:
        """Returns states near those at the start, by less than a hundredth."""
        pairs = zip(self.states, self.nominals, strict=True)
        return [x + part * 1e-2 * min(abs(x) or nominal, abs(nominal)) for x, nominal in pairs]


class _ContinuousTime:
    """A script in continuous-time mode within the step after a start.

    before: reading of some variables before that mode was entered
    """

    def __init__(self, probe: Probe, start: Start, read: Sequence[Variable] = ()) -> None:
        self._probe = probe
        self.start = probe.once("start of model exchange", lambda: _Start(probe, start), start.words)
        self.script = probe.script(do.start, lead=start.lead, logging=True)
        self.before = self.script.read(read)
        self.script.enter_continuous_time_mode()

    def go(self, part: float, functions: Sequence[str] = (_DERIVATIVES, _INDICATORS)) -> list[Reply]:
        """Sets the time to a part of the step, and states of that part; returns vectors there."""
        self.script.call("set_time", self.start.begin + part * self.start.size)
        return self.move(part, functions)

    def move(
        self, part: float, functions: Sequence[str] = (_DERIVATIVES, _INDICATORS), alone: int | None = None,
    ) -> list[Reply]:  # fmt: skip
        """Sets states of a part of the step, and no time; returns vectors there.

        alone: index of a state, if the others are those of the part 0.3
        """
        states = self.start.near(part)
        if alone is not None:
            states = [*self.start.near(0.3)[:alone], states[alone], *self.start.near(0.3)[alone + 1 :]]
        if states:
            self.script.call("set_continuous_states", states)
        return _vectors(self._probe, self.script, functions)

    def play(self) -> None:
        """Plays the script. Raises NotJudgedError where the FMU discards states."""
        self.script.play(keep_going=True)
        failure = self.script.failure
        if failure and failure.status == DISCARD:
            raise NotJudgedError(f"the FMU discards {failure.function}")
        if failure:
            raise CallError(failure.problem, failure.status)


def _differences(
    expected: Sequence[Reply], got: Sequence[Reply], when: str, tolerance: float = _SOLVED
) -> Iterator[str]:
    """Yields the first element of each vector that is not as expected."""
    for before, after in zip(expected, got, strict=True):
        scale = max(map(abs, before.value), default=0.0)
        for i, (a, b) in enumerate(zip(before.value, after.value, strict=True), 1):
            if not same(a, b, tolerance, 1e-3 * scale):
                wanted, found = texts(a, b)
                yield f"{after.function} gives {found} for element {i} {when}: expected {wanted}"
                break


def _from_starts(check: Callable[[Probe, Start], Iterator[str]]) -> Check:
    """Returns a check from all starts: the findings of the first that has any."""

    @wraps(check)
    def checked(probe: Probe) -> Iterator[str]:
        reasons, chosen = list[NotJudgedError](), starts(probe)
        for start in chosen:
            try:
                messages = list(check(probe, start))
            except NotJudgedError as reason:
                reasons.append(reason)
                continue
            yield from (message.replace(": expected", f"{start.words}: expected", 1) for message in messages)
            if messages:
                return
        if len(reasons) == len(chosen):
            raise reasons[0]

    return checked


@_rule("3.2.1", condition=_no_states)
@_from_starts
def states_that_are_set_are_read(probe: Probe, start: Start) -> Iterator[str]:
    """fmi2GetContinuousStates gives the states that fmi2SetContinuousStates has set."""
    for part in (0.7, -0.7):
        run = _ContinuousTime(probe, start)
        run.script.call("set_continuous_states", run.start.near(part))
        (states,) = _vectors(probe, run.script, (_STATES,))
        run.play()
        expected = Reply(_STATES, "", value=run.start.near(part))
        yield from _differences([expected], [states], "after it was set", 0.0)


@_rule("3.2.1")
@_from_starts
def derivatives_have_no_history(probe: Probe, start: Start) -> Iterator[str]:
    """Derivatives and event indicators follow from time, states and inputs alone: setting time and states
    back gives them again, and other states at the same time give those of these states.
    """
    run, new = _ContinuousTime(probe, start), _ContinuousTime(probe, start)
    functions = [f for f in (_DERIVATIVES, _INDICATORS) if probe.fmu.vector_length(f)]
    before, _, after = (run.go(part) for part in (0.3, 0.6, 0.3))
    again = _vectors(probe, run.script, functions)
    ways = [None, *range(min(len(run.start.states), _MOST_STATES))]
    moved = [(run.move(0.3), run.move(0.9, alone=i))[1] for i in ways]
    new.script.call("set_time", new.start.begin + 0.3 * new.start.size)
    expected = [new.move(0.9, functions[::-1], alone=i)[::-1] for i in ways]
    run.play()
    new.play()
    yield from _differences(before, after, "after time and states were set back")
    yield from _differences(after, again, "read once more")
    when = "after states were set at the same time, as in a new instance"
    for wanted, got in zip(expected, moved, strict=True):
        yield from _differences(wanted, got, when)
    for event in _run(probe)[0]:
        _, *twice = (Reply(_INDICATORS, "", value=z) for z in event.get("crossing", [[], [], []]))
        yield from _differences(
            twice[:1], twice[1:], f"read once more at the end of {_interval(probe, event)}"
        )


@_rule("3.2.2")
@_from_starts
def time_goes_back_in_continuous_time(probe: Probe, start: Start) -> Iterator[str]:
    """After a completed step, time can be set back as far as to the completed step before, and gives the
    derivatives of that time.
    """
    run = _ContinuousTime(probe, start)
    enters = []
    before: list[Reply] = []
    for part in (0.3, 0.6):
        before = run.go(0.5) if part > 0.3 else []
        run.go(part)
        if not probe.fmu.claims(_NOT_NEEDED):
            enters.append(run.script.call("completed_integrator_step", False))
    first = len(run.script.replies)
    after = run.go(0.5)
    run.script.play(keep_going=True)
    failure = run.script.failure
    if any(any(enter.value or []) for enter in enters):
        raise NotJudgedError("a step event comes first")
    if failure in run.script.replies[first:]:
        yield f"back in time, after the completed step before: {failure.problem}"
    elif not failure:
        yield from _differences(before, after, "after time was set back")


@_rule("3.2.2", condition=if_not_claimed(_NOT_NEEDED))
@_from_starts
def completed_steps_write_booleans(probe: Probe, start: Start) -> Iterator[str]:
    """fmi2CompletedIntegratorStep writes a Boolean value to enterEventMode and to terminateSimulation."""
    run = _ContinuousTime(probe, start)
    run.go(0.5)
    reply = run.script.call("completed_integrator_step", True, _NO_BOOLEAN)
    run.play()
    for name, value in zip(("enterEventMode", "terminateSimulation"), reply.value, strict=True):
        if value not in (0, 1):
            what = "does not write" if value == _NO_BOOLEAN else f"writes {value} to"
            yield f"{reply.function} {what} {name}: expected fmi2False or fmi2True"


@_rule("3.3.1", condition=unless_claimed(_NOT_NEEDED))
def completed_step_without_need_has_no_effect(probe: Probe) -> Iterator[str]:
    """With completedIntegratorStepNotNeeded, fmi2CompletedIntegratorStep asks for nothing and changes
    nothing.
    """
    run = _ContinuousTime(probe, AT_FIRST)
    functions = (_STATES, _DERIVATIVES, _INDICATORS)
    before = run.go(0.5, functions)
    enter = run.script.call("completed_integrator_step")
    after = _vectors(probe, run.script, functions)
    run.play()
    if any(enter.value):
        yield f"{enter.function} asks for event mode or an end of the simulation: expected neither"
    yield from _differences(before, after, f"after {enter.function}")
    over = do.begin, do.go_on_reading(probe.steps_of_experiment, 8)
    where = f"where {enter.function} is called"
    yield from differences(
        probe, [Row(where, over, over, tolerance=OF_EXPERIMENT, options={"needs_completed": True})]
    )


@_rule("2.2.8", condition=_no_states)
def vectors_have_the_order_of_the_description(probe: Probe) -> Iterator[str]:
    """States and derivatives as vectors have the values and the order of the variables of Derivatives."""
    derivatives, states = probe.fmu.state_derivatives.keys(), probe.fmu.state_derivatives.values()
    if len(states) != probe.fmu.vector_length(_STATES):
        raise NotJudgedError("Derivatives lists variables that are derivatives of none")
    groups = [[probe.fmu.variables[index - 1] for index in indices] for indices in (states, derivatives)]
    run = _ContinuousTime(probe, AT_FIRST)
    vectors = run.go(0.5, (_STATES, _DERIVATIVES))
    readings = [run.script.read(group) for group in groups]
    run.play()
    for vector, reading, group in zip(vectors, readings, groups, strict=True):
        for i, v in enumerate(group):
            if not same(vector.value[i], reading.values[v.name], _SOLVED):
                got, read = texts(vector.value[i], reading.values[v.name])
                yield f"{vector.function} gives {got} for element {i + 1}, {v.name}: expected {read}, as read"
                return
    for event in _run(probe)[0]:
        for v, x in zip(_states(probe.fmu), event["vectors"][-1][0], strict=True):
            if event["values"] and not same(x, event["values"][v.name], _SOLVED):
                got, read = texts(x, event["values"][v.name])
                when = f"after {_event(probe, event)}"
                yield f"{_STATES} gives {got} for {v.name} {when}: expected {read}, as read"
                return


@_rule("3.1")
@_from_starts
def discrete_variables_are_frozen(probe: Probe, start: Start) -> Iterator[str]:
    """Discrete variables do not change in continuous-time mode, whatever time and states are."""
    chosen = _discrete(probe.fmu)
    run = _ContinuousTime(probe, start, chosen)
    readings = list[Reading]()
    for part in (0.0, 0.5):
        if part:
            run.script.call("set_time", run.start.begin + part * run.start.size)
        for sign in (1, -1) if run.start.states else ():
            run.script.call("set_continuous_states", [sign * (x or 1e-3) for x in run.start.near(0.5)])
        readings.append(run.script.read(chosen))
    run.play()
    for v, reading in itertools.product(chosen, readings):
        if (a := run.before.values[v.name]) != (b := reading.values[v.name]):
            yield f"{v.name} changes from {a!r} to {b!r} in continuous-time mode: expected {a!r}"
            return
    for event in _run(probe)[0]:
        for v in chosen if event["left"] else ():
            if not same(a := event["values"][v.name], b := event["left"][v.name]):
                mode = f"in continuous-time mode after {_event(probe, event)}"
                yield f"{v.name} changes from {a!r} to {b!r} {mode}: expected {a!r}"
                return


@_rule("3.1", condition=_no_indicators)
def discrete_changes_have_an_event(probe: Probe) -> Iterator[str]:
    """Discrete variables do not change where event mode is entered although there is no event."""
    events, _ = _run(probe)
    for i, (before, event) in enumerate(itertools.pairwise(events), 1):
        next_event = before["infos"][-1]["nextEventTime"] if before["infos"] else math.inf
        is_time_event = abs(next_event - event["time"]) <= 1e-9 * max(1.0, abs(next_event))
        # within a hysteresis a relation may change before its indicator does
        indicators = next((e["indicators"] for e in events[i:] if "indicators" in e), ())
        is_near = any(abs(z) < _HYSTERESIS for z in indicators)
        is_later = event["time"] > before["time"] and not is_time_event and not is_near
        for v in _discrete(probe.fmu) if event["cause"] == _NO_EVENT and is_later else ():
            a, b = (e.get(when, {}).get(v.name) for e, when in ((before, "values"), (event, "values")))
            if None not in (a, b) and not same(a, b):
                where = f"at {_event(probe, event)}, where no event is indicated"
                yield f"{v.name} changes from {a!r} to {b!r} {where}: expected a state, time or step event"
                return


# events


def _run(probe: Probe, again: bool = False) -> tuple[list[_Observed], str]:
    """Returns the events of a run up to the stop time, played once, and the reason why it ended before.

    again: whether the end of each event is tried once more
    """

    def played() -> tuple[list[_Observed], str]:
        end = probe.stop_time if math.isfinite(probe.stop_time) else probe.start_time + 1.0
        size = (end - probe.start_time) / _STEPS
        discrete, states = _discrete(probe.fmu), _states(probe.fmu)
        groups = {kind: [v for v in (*discrete, *states) if v.base_kind == kind] for kind in KINDS}
        observing = {kind: references_of(group) for kind, group in groups.items() if group}
        script = probe.script(observed=observing, again=again, logging=True).begin()
        for i in range(_STEPS):
            script.call("do_step", probe.start_time + i * size, size)
        observed = script.call("observed_events")
        with suppress(NotJudgedError):  # a step that is discarded ends the run
            script.play(keep_going=True)
        for event, when in itertools.product(observed.value or [], ("values", "again", "left")):
            pairs = ((groups[kind], some) for kind, some in event.get(when, {}).items())
            event[when] = {v.name: x for group, some in pairs for v, x in zip(group, some, strict=True)}
        return observed.value or [], next((r.reason for r in script.replies if r.reason), "")

    return probe.once("run of model exchange", played, again)


def _event(probe: Probe, event: _Observed) -> str:
    t = event["time"] if math.isfinite(event["time"]) else probe.start_time
    return f"the {event['cause']} at {t:g} s"


def _interval(probe: Probe, event: _Observed) -> str:
    return f"the continuous-time mode after {_event(probe, event)}"


def _steps_of(event: _Observed) -> Iterator[tuple[_Observed, Sequence[float], Sequence[float], int]]:
    """Yields fmi2EventInfo of each iteration with vectors before and after: of states, then of nominals."""
    for which in (0, 1):
        values = [vectors[which] for vectors in event["vectors"]]
        for info, before, after in zip(event["infos"], values, values[1:], strict=False):
            yield info, before, after, which


def _changes(probe: Probe, which: int, element: str) -> Iterator[str]:
    """Yields the first change that is not announced, of states (0) or nominals (1)."""
    name = ("state", "nominal value")[which]
    for event in _run(probe)[0]:
        for info, before, after, of in _steps_of(event):
            i = next((i for i, (a, b) in enumerate(zip(before, after, strict=True)) if a != b), None)
            if of == which and i is not None and not info[element]:
                old, new = texts(before[i], after[i])
                change = f"{name} {i + 1} changes from {old} to {new}"
                yield f"at {_event(probe, event)} {change}: expected {element} true"
                return


@_rule("3.2.2", condition=_no_states)
def changes_of_states_are_announced(probe: Probe) -> Iterator[str]:
    """If fmi2NewDiscreteStates changes a state, valuesOfContinuousStatesChanged is true;
    fmi2CompletedIntegratorStep changes none.
    """
    yield from _changes(probe, 0, "valuesOfContinuousStatesChanged")
    for event in _run(probe)[0]:
        for before, after in event.get("completed", ()):
            for i, (a, b) in enumerate(zip(before, after, strict=True), 1):
                if not same(a, b, _SOLVED):
                    old, new = texts(a, b)
                    what = f"fmi2CompletedIntegratorStep changes state {i} from {old} to {new}"
                    yield f"{what} after {_event(probe, event)}: expected that in event mode alone"
                    return


@_rule("3.2.2", condition=_no_states)
def changes_of_nominals_are_announced(probe: Probe) -> Iterator[str]:
    """If fmi2NewDiscreteStates changes a nominal value, nominalsOfContinuousStatesChanged is true."""
    yield from _changes(probe, 1, "nominalsOfContinuousStatesChanged")


@_rule("3.2.2", condition=_no_states)
def states_that_stay_are_not_announced(probe: Probe) -> Iterator[str]:
    """If fmi2NewDiscreteStates changes no state, valuesOfContinuousStatesChanged is false."""
    for event in _run(probe)[0]:
        for info, before, after, which in _steps_of(event):
            if which == 0 and before == after and info["valuesOfContinuousStatesChanged"]:
                yield (
                    f"at {_event(probe, event)} no state changes: "
                    "expected valuesOfContinuousStatesChanged false"
                )
                return


@_rule("2.2.7", condition=_no_states)
def states_that_change_at_events_have_reinit(probe: Probe) -> Iterator[str]:
    """A state that changes at an event after the start has reinit."""
    states = _states(probe.fmu)
    changed = {
        i: event
        for event in reversed(_run(probe)[0])
        if event["cause"] != "start" and len(states) == len(event["vectors"][0][0])
        for _, before, after, which in _steps_of(event)
        for i in range(len(before))
        if which == 0 and before[i] != after[i]
    }
    for i, event in changed.items():
        if not is_true(states[i].get("reinit")):
            yield f"{states[i].name} changes at {_event(probe, event)}: expected reinit=true"


@_rule("3.2.2", condition=_no_states)
def nominals_are_positive(probe: Probe) -> Iterator[str]:
    """Nominal values of states are above 0, from initialisation on."""
    for event in _run(probe)[0]:
        for i, nominal in enumerate(event["vectors"][-1][1], 1):
            if not 0 < nominal < math.inf:
                yield f"at {_event(probe, event)} nominal value {i} is {nominal:g}: expected above 0"
                return


@_rule("3.2.2")
def events_come_to_an_end(probe: Probe) -> Iterator[str]:
    """newDiscreteStatesNeeded becomes false after some calls of fmi2NewDiscreteStates."""
    _, ended = _run(probe)
    if "iterations" in ended:
        yield f"{ended}: expected newDiscreteStatesNeeded false"


@_rule("3.2.2")
def ended_events_stay_ended(probe: Probe) -> Iterator[str]:
    """One more call of fmi2NewDiscreteStates changes nothing where newDiscreteStatesNeeded is false."""
    for event in _run(probe, again=True)[0]:
        for name, b in event.get("again", {}).items():
            if not same(a := event["values"][name], b, _SOLVED):
                where = f"by one more fmi2NewDiscreteStates at {_event(probe, event)}"
                yield f"{name} changes from {a!r} to {b!r} {where}: expected newDiscreteStatesNeeded before"
                return


@_rule("3.1")
def next_events_are_ahead(probe: Probe) -> Iterator[str]:
    """nextEventTime, where it is defined, lies after the present."""
    for event in _run(probe)[0][1:]:
        last = event["infos"][-1] if event["infos"] else {}
        if last.get("nextEventTimeDefined") and not last["nextEventTime"] > event["time"]:
            yield f"at {_event(probe, event)} nextEventTime is {last['nextEventTime']:g} s: expected later"
            return


@_rule("3.2.2", condition=_no_indicators)
def event_indicators_are_finite(probe: Probe) -> Iterator[str]:
    """Event indicators are numbers, neither infinite nor NaN."""
    for event in _run(probe)[0]:
        for i, z in enumerate(event.get("indicators", []), 1):
            if not math.isfinite(z):
                yield f"after {_event(probe, event)} event indicator {i} is {z}: expected a number"
                return


@_rule("3.2.2", condition=_no_indicators)
def event_indicators_are_not_zero_at_restart(probe: Probe) -> Iterator[str]:
    """After a state, time or step event, no event indicator is 0 when continuous-time mode is entered."""
    for event in _run(probe)[0]:
        # whether the start, or a communication point without an event, is a restart is a matter of reading
        is_restart = event["cause"] in ("state event", "time event", "step event")
        if is_restart and 0.0 in event.get("indicators", []):
            i = event["indicators"].index(0.0) + 1
            yield f"after {_event(probe, event)} event indicator {i} is 0: expected another value"
            return


@_rule("3.1", condition=_no_indicators)
def event_indicators_are_continuous(probe: Probe) -> Iterator[str]:
    """Event indicators do not jump where they change their sign."""
    events, _ = _run(probe)
    for event in events:
        for i, (a, b) in enumerate(zip(*event.get("crossing", ([], []))[:2], strict=True)):
            sizes = [abs(e["indicators"][i]) for e in events if "indicators" in e]
            if (a > 0) != (b > 0) and abs(a - b) > _JUMP * max(1.0, *sizes):
                yield (
                    f"event indicator {i + 1} jumps from {a:.6g} to {b:.6g} after {_event(probe, event)}: "
                    "expected continuous values"
                )
                return
