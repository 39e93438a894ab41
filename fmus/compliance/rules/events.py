"""Events of model exchange (3.1, 3.2.2), as a run up to the stop time observes them."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance.fmu_file import MODEL_EXCHANGE, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule, rule_of
from fmus.compliance.script import KINDS
from fmus.compliance.texts import VECTORS
from fmus.compliance.traces.generator import Trace, excited
from fmus.compliance.values import other_values, references_of, same, texts
from fmus.compliance.variable import Variable, is_true

_STEPS, _FEW_STEPS = 50, 5  # of the run
_NEAR = 1e-3  # of the run: solvers find events that time events follow at other times
_SOLVED = 1e-6  # relative: an iterative solver in the FMU may change values as much
_JUMP = 0.01  # of an indicator of the order of one, in a millionth of a step
_NO_EVENT = "communication point"
_rule = partial(behaviour_rule, interface=MODEL_EXCHANGE)


def no_states(fmu: FmuFile) -> str:
    """Returns the reason why a rule of states does not apply, if so."""
    return "" if fmu.vector_length(VECTORS[0]) else "it has no continuous states"


def _no_indicators(fmu: FmuFile) -> str:
    return "" if fmu.vector_length(VECTORS[2]) else "it has no event indicators"


def discrete_variables(fmu: FmuFile) -> list[Variable]:
    return [v for v in fmu.variables if v.variability == "discrete" and v.causality != "input"]


def follow_at_once(fmu: FmuFile) -> list[Variable]:
    """Returns the continuous variables, which follow from time, states, inputs and parameters."""
    return [v for v in fmu.variables if v.kind == "Real" and v.variability == "continuous"]


def elements_of_vectors(fmu: FmuFile) -> dict[str, list[Variable]]:
    """Returns function -> the variables that are elements of its vector: states, and their derivatives."""
    derivatives = [fmu.variables[index - 1] for index in fmu.state_derivatives]
    return dict(zip(VECTORS, (fmu.state_variables, derivatives), strict=False))


def _by_name(groups: dict[str, list[Variable]], values: dict[str, Sequence[Any]]) -> dict[str, Any]:
    pairs = ((groups[key], some) for key, some in values.items())
    return {v.name: x for group, some in pairs for v, x in zip(group, some, strict=False)}


@dataclass
class Event:
    """An event, and the continuous-time mode after it, as `CalledModelExchange` observes them.

    words: in messages; previous: the event before; infos: fmi2EventInfo of each iteration
    is_after_set: whether it ends a step before which something was set
    vectors: states and their nominal values, before the first iteration and after each
    values, again, left: discrete variables, states and derivatives after the last iteration, after one more,
      and where continuous-time mode ends; begin, indicators: states and event indicators where that begins
    elements: states and derivatives as elements of vectors, by the same words
    completed: states that were set for each completed step in it, and those before and after it
    crossing: event indicators before a change of sign and after it, and read once more
    jumps: time, and derivatives before and after it, where they jump
    """

    cause: str
    time: float
    infos: list[dict[str, Any]]
    vectors: list[list[list[float]]]
    words: str = ""
    is_after_set: bool = False
    previous: "Event | None" = None
    values: dict[str, Any] = field(default_factory=dict[str, Any])
    again: dict[str, Any] = field(default_factory=dict[str, Any])
    left: dict[str, Any] = field(default_factory=dict[str, Any])
    elements: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    begin: Sequence[float] = ()
    indicators: Sequence[float] = ()
    completed: Sequence[Sequence[Sequence[float]]] = ()
    crossing: Sequence[Sequence[float]] = ((), (), ())
    jumps: Sequence[tuple[float, Sequence[float], Sequence[float]]] = ()

    def changes(self, which: int, name: str) -> list[tuple[dict[str, Any], str]]:
        """Returns fmi2EventInfo of each iteration with a change in words, of states (0) or nominals (1)."""
        # nominal values stay in continuous-time mode, and where event mode is entered
        before = self.previous.vectors[-1] if which and self.previous else self.vectors[0]
        vectors = itertools.pairwise(v[which] for v in (before, *self.vectors[1:]))
        return [(info, change(name, *pair)) for info, pair in zip(self.infos, vectors, strict=False)]


def change(
    name: str, before: Sequence[float], after: Sequence[float], tolerance: float = 0.0, scale: float = 0.0
) -> str:
    """Returns the first change of a vector in words, or nothing; tolerance and scale as in `same`."""
    for i, (a, b) in enumerate(zip(before, after, strict=False), 1):
        if not same(a, b, tolerance, scale):
            old, new = texts(a, b)
            return f"{name} {i} changes from {old} to {new}"
    return ""


def _run(probe: Probe, others: int = 0, steps: int = _STEPS, **options: Any) -> tuple[list[Event], str]:
    """Returns the events of a run up to the stop time, played once, and the reason why it ended before.

    others: number of the run with other inputs, if it is one; steps: their number, at whose ends the instance
      is in event mode; options: of `CalledModelExchange`
    """

    def played() -> tuple[list[Event], str]:
        end = probe.stop_time if math.isfinite(probe.stop_time) else probe.start_time + 1.0
        size = (end - probe.start_time) / steps
        vectors = elements_of_vectors(probe.fmu)
        variables = *discrete_variables(probe.fmu), *chain(*vectors.values())
        groups = {kind: [v for v in variables if v.base_kind == kind] for kind in KINDS}
        observing = {kind: references_of(group) for kind, group in groups.items() if group}
        run = excited(probe)[others - 1] if others else Trace(0, (), (), ())
        sets = run.sets
        begins = {i * steps // len(sets): pairs for i, pairs in enumerate(sets)}
        # another run may leave what one more iteration shows
        again = (do.begin, do.step(), do.reset) if sets and "again" in options else ()
        script = probe.script(*again, *run.initialised, observed=observing, logging=True, **options)
        for i in range(steps if sets or not others else 0):
            script.write([do.set_values(begins.get(i, ()))])
            script.call("do_step", probe.start_time + i * size, size)
        observed = script.call("observed_events")
        # a discarded step ends the run
        with suppress(NotJudgedError):
            script.play(keep_going=True)
        events = list[Event]()
        for fields in observed.value or []:
            for when in {"values", "again", "left"} & fields.keys():
                elements = _by_name(vectors, {name: fields[when].pop(name) for name in vectors})
                fields.setdefault("elements", {})[when] = elements
                fields[when] = _by_name(groups, fields[when])
            t = fields["time"] if math.isfinite(fields["time"]) else probe.start_time
            fields["words"] = f"the {fields['cause']} at {t:g} s"
            fields["words"] += " in a run with other inputs" if sets else ""
            fields["is_after_set"] = round((t - probe.start_time) / size, 6) - 1 in begins
            events.append(Event(**fields, previous=events[-1] if events else None))
        return events, next((r.reason for r in script.replies if r.reason), "")

    return probe.once("run of model exchange", played, others, steps, options)


def _runs(probe: Probe, **options: Any) -> Iterator[tuple[list[Event], str]]:
    """Yields what `_run` returns, of a usual run and of some with other inputs."""
    return (_run(probe, others, **options) for others in range(len(excited(probe)) + 1))


def _of_runs(
    probe: Probe, about: Callable[[Sequence[Event]], Iterable[str]], **options: Any
) -> Iterator[str]:
    """Yields the messages about the first of `_runs` with any."""
    found = ([*about(events)] for events, _ in _runs(probe, **options))
    yield from next(filter(None, found), [])


def of_events(probe: Probe, about: Callable[[Event], Iterable[str]], **options: Any) -> Iterator[str]:
    """Yields the messages about each event of the first of the runs with any."""
    return _of_runs(probe, lambda events: chain(*map(about, events)), **options)


_event_rule = partial(rule_of, of_events, interface=MODEL_EXCHANGE)


# states and their nominal values


@_rule("2.2.8", condition=no_states)
def vectors_have_the_order_of_the_description(probe: Probe) -> Iterator[str]:
    """States and derivatives as vectors have the values and the order of the variables of Derivatives, after
    events, and where continuous-time mode ends. Nominal values at the start have the order of the states.
    """
    of_vectors = elements_of_vectors(probe.fmu)
    if len(of_vectors[VECTORS[0]]) != probe.fmu.vector_length(VECTORS[0]):
        raise NotJudgedError("Derivatives lists variables that are derivatives of none")

    nominals = {v.name: v.nominal for v in chain(*of_vectors.values())}

    stated = [v.nominal for v in of_vectors[VECTORS[0]]]

    def unlike(event: Event) -> Iterator[str]:
        got = event.vectors[-1][1]
        if event.cause == "start" and got != stated and sorted(got) == sorted(stated):
            yield f"nominal values are {got} at {event.words}: expected {stated}, in the order of the states"
        for when, where in (("values", "at {}"), ("left", "where the continuous-time mode after {} ends")):
            for name, x in event.elements.get(when, {}).items():
                if not same(a := getattr(event, when)[name], x, _SOLVED, nominals[name]):
                    got, expected = texts(a, x)
                    yield f"{name} is {got} {where.format(event.words)}: expected {expected}, its element"

    return of_events(probe, unlike)


@_event_rule("3.2.1, 3.2.2", condition=no_states)
def changes_of_states_are_announced(event: Event) -> Iterator[str]:
    """If fmi2NewDiscreteStates changes a state, valuesOfContinuousStatesChanged is true, and
    fmi2GetContinuousStates gives the new states; neither fmi2EnterContinuousTimeMode nor
    fmi2CompletedIntegratorStep changes one, and fmi2SetContinuousStates sets each to the given value.
    """
    for info, words in event.changes(0, "state"):
        if words and not info["valuesOfContinuousStatesChanged"]:
            yield f"at {event.words} {words}: expected valuesOfContinuousStatesChanged true"
    if words := change("state", event.vectors[-1][0], event.begin, _SOLVED):
        what = f"{words} by fmi2EnterContinuousTimeMode"
        yield f"after {event.words} {what}: expected by fmi2NewDiscreteStates"
    for given, before, after in event.completed:
        if words := change("state", given, before, _SOLVED):
            yield f"after {event.words} {words} by fmi2SetContinuousStates: expected what was set"
        elif words := change("state", before, after, _SOLVED):
            what = f"{words} by fmi2CompletedIntegratorStep"
            yield f"after {event.words} {what}: expected that in event mode alone"


@_event_rule("3.2.2", condition=no_states)
def changes_of_nominals_are_announced(event: Event) -> Iterator[str]:
    """If fmi2NewDiscreteStates changes a nominal value, nominalsOfContinuousStatesChanged is true; nothing
    else changes one.
    """
    for info, words in event.changes(1, "nominal value"):
        if words and not info["nominalsOfContinuousStatesChanged"]:
            yield f"at {event.words} {words}: expected nominalsOfContinuousStatesChanged true"


@_event_rule("3.2.2", condition=no_states)
def states_that_stay_are_not_announced(event: Event) -> Iterator[str]:
    """If fmi2NewDiscreteStates changes no state, valuesOfContinuousStatesChanged is false."""
    for info, words in event.changes(0, "state"):
        if not words and info["valuesOfContinuousStatesChanged"]:
            yield f"at {event.words} no state changes: expected valuesOfContinuousStatesChanged false"


@_rule("2.2.7", condition=no_states)
def states_that_change_at_events_have_reinit(probe: Probe) -> Iterator[str]:
    """A state that changes at an event after the start has reinit."""
    events = [event for event in chain(*(some for some, _ in _runs(probe))) if event.cause != "start"]
    for i, v in enumerate(elements_of_vectors(probe.fmu)[VECTORS[0]]):
        changed = (e for e in events if len({vectors[0][i] for vectors in e.vectors}) > 1)
        for event in itertools.islice(changed, 1 - is_true(v.get("reinit"))):
            yield f"{v.name} changes at {event.words}: expected reinit=true"


@_event_rule("3.2.2", condition=no_states)
def nominals_are_positive(event: Event) -> Iterator[str]:
    """Nominal values of states are above 0, from initialisation on."""
    for i, nominal in enumerate(event.vectors[-1][1], 1):
        if not 0 < nominal < math.inf:
            yield f"at {event.words} nominal value {i} is {nominal:g}: expected above 0"


# iterations and times of events


@_rule("3.2.2")
def events_come_to_an_end(probe: Probe) -> Iterator[str]:
    """newDiscreteStatesNeeded becomes false after some calls of fmi2NewDiscreteStates, also after an input or
    a tunable parameter was set to another value.
    """
    usual, *others = (reason for _, reason in _runs(probe))
    ends = [usual, *(f"with other inputs {reason}" for reason in others)]
    pairs = other_values(probe.fmu.settable_while_stepping[: do.MOST_VARIABLES])
    # where the usual run fails, a long one fails for that
    later = [] if usual else [do.leap(2)]
    # Reals have many values and seldom distinguish cases, so one run sets all
    reals = [pair for pair in pairs if pair[0].kind == "Real"]
    for some in (reals, *([pair] for pair in pairs if pair not in reals)):
        failure = do.played(probe, [do.begin, do.set_values(some), do.step(), *later]).failure
        names = ", ".join(v.name for v, _ in some)
        ends.append(f"after {names} was set {failure.reason if failure else ''}")
    for reason in ends:
        if "iterations" in reason:
            yield f"{reason}: expected newDiscreteStatesNeeded false"


@_rule("3.2.2")
def ended_events_stay_ended(probe: Probe) -> Iterator[str]:
    """One more call of fmi2NewDiscreteStates, which an importer makes while another FMU needs it, changes
    nothing where newDiscreteStatesNeeded is false, in a run with other inputs after fmi2Reset either.
    """
    # derivatives near 0 are rounding errors
    derivatives = {v.name for v in elements_of_vectors(probe.fmu)[VECTORS[1]]}

    def changes(event: Event) -> Iterator[str]:
        for name, b in event.again.items():
            if name not in derivatives and not same(a := event.values[name], b, _SOLVED):
                where = f"by one more fmi2NewDiscreteStates at {event.words}"
                yield f"{name} changes from {a!r} to {b!r} {where}: expected newDiscreteStatesNeeded before"

    return of_events(probe, changes, again=True)


@_event_rule("3.1")
def next_events_are_ahead(event: Event) -> Iterator[str]:
    """nextEventTime, where it is defined, lies after the present."""
    last = event.infos[-1] if event.infos else {}
    # at the start the time is not known
    if last.get("nextEventTimeDefined") and last["nextEventTime"] <= event.time:
        yield f"at {event.words} nextEventTime is {last['nextEventTime']:g} s: expected later"


@_rule("3.1")
def changes_have_events(probe: Probe) -> Iterator[str]:
    """Discrete variables change at time, state and step events, and within a step after something is set.
    Entering event mode alone changes none, except a Real that follows a continuous variable.
    """
    variables, near = discrete_variables(probe.fmu), _NEAR * probe.step_size

    def is_judged(event: Event) -> bool:
        before = event.previous
        if event.cause != _NO_EVENT or event.is_after_set or before is None or not before.left:
            # nothing was integrated before the event
            return False
        last = before.infos[-1] if before.infos else {}
        return not last.get("nextEventTimeDefined") or abs(last["nextEventTime"] - event.time) > near

    def is_moved(event: Event) -> bool:
        begin = list(event.previous.begin) if event.previous else []
        return not begin or begin != event.vectors[0][0]

    def change_of(v: Variable, event: Event) -> tuple[Any, ...]:
        left = event.previous.left if event.previous else {}
        pair = left.get(v.name, x := event.values.get(v.name)), x
        return () if same(*pair, _SOLVED) else pair

    def changes(events: Sequence[Event]) -> Iterator[str]:
        # a variable that changes at a communication point may change another a step later
        others = [v for v in variables if v.kind != "Real"]
        begun = {e.time for e in events if e.cause == _NO_EVENT and any(change_of(v, e) for v in others)}
        judged = [e for e in events if is_judged(e) and e.previous and e.previous.time not in begun]
        moved = sum(is_moved(e) for e in judged)
        for v in variables:
            changed = [(event, pair) for event in judged if (pair := change_of(v, event))]
            if v.kind == "Real" and len(changed) > moved / 2:
                # it follows a continuous variable whenever event mode is entered
                continue
            for event, (a, b) in changed:
                yield f"{v.name} changes from {a!r} to {b!r} at {event.words}: expected a time or state event"

    return _of_runs(probe, changes)


@_rule("3.1")
def time_events_are_defined_anew(probe: Probe) -> Iterator[str]:
    """Time events of a run with few communication points occur in a run with many. Event mode is entered at
    each point, which removes the next time event: the FMU has to define it anew.
    """
    (few, _), (many, _) = _run(probe, steps=_FEW_STEPS), _run(probe)
    times = [event.time for event in many]
    near = _NEAR * (times[-1] - probe.start_time) if times else 0.0
    for event in few:
        is_within = event.cause == "time event" and times and event.time < times[-1]
        if is_within and not any(abs(event.time - t) <= near for t in times):
            where = "in a run with more communication points"
            yield f"{event.words} does not occur {where}: expected it there too"


# event indicators


@_event_rule("3.2.2", condition=_no_indicators)
def event_indicators_are_finite(event: Event) -> Iterator[str]:
    """Event indicators are numbers, neither infinite nor NaN."""
    for i, z in enumerate(event.indicators, 1):
        if not math.isfinite(z):
            yield f"after {event.words} event indicator {i} is {z}: expected a number"


@_event_rule("3.2.2", condition=_no_indicators)
def event_indicators_are_not_zero_at_restart(event: Event) -> Iterator[str]:
    """After a state, time or step event, no event indicator is 0 when continuous-time mode is entered."""
    # whether the start, or a communication point without an event, is a restart is a matter of reading
    if event.cause not in ("start", _NO_EVENT):
        for i, z in enumerate(event.indicators, 1):
            if z == 0.0:
                yield f"after {event.words} event indicator {i} is 0: expected another value"


@_event_rule("3.1", condition=no_states)
def relations_are_frozen(event: Event) -> Iterator[str]:
    """Derivatives do not jump in continuous-time mode: a relation changes in event mode alone, also where an
    event indicator has another sign.
    """
    for t, before, after in event.jumps:
        for i, (a, b) in enumerate(zip(before, after, strict=True), 1):
            if abs(a - b) > _JUMP * max(1.0, abs(a), abs(b)):
                jump = f"derivative {i} jumps from {a:.6g} to {b:.6g} at {t:g} s"
                yield f"{jump} in continuous-time mode after {event.words}: expected that in event mode"


@_rule("3.1", condition=_no_indicators)
def event_indicators_are_continuous(probe: Probe) -> Iterator[str]:
    """Event indicators do not jump where they change their sign."""

    def jumps(events: Sequence[Event]) -> Iterator[str]:
        begins = [event.indicators for event in events if event.indicators]
        # other inputs may make an indicator larger, and faster, than the usual ones
        sizes = [max(1.0, *map(abs, column)) for column in zip(*begins, strict=True)]
        for event in events:
            for i, (a, b) in enumerate(zip(*event.crossing[:2], strict=True)):
                if (a > 0) != (b > 0) and abs(a - b) > _JUMP * sizes[i]:
                    jump = f"event indicator {i + 1} jumps from {a:.6g} to {b:.6g}"
                    yield f"{jump} after {event.words}: expected continuous values"

    return _of_runs(probe, jumps)
