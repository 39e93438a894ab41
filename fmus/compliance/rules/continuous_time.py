"""Continuous-time mode of model exchange (3.1, 3.2.1): states, their derivatives, and going back in time."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, cycle, pairwise
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, differences, differential, starts
from fmus.compliance.fmu_file import MODEL_EXCHANGE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.rules import events
from fmus.compliance.script import Action, Script
from fmus.compliance.texts import VECTORS
from fmus.compliance.traces import paths
from fmus.fmi.binding import DISCARD

_STATES, _DERIVATIVES, _INDICATORS, _NOMINALS = VECTORS
_SOLVED = 1e-5  # relative, of large values: an iterative solver in the FMU may change them as much
_FAR = 1e4  # times a state: many FMUs discard it
_MOST_STATES = 20  # that are moved alone
_NOT_NEEDED = "completedIntegratorStepNotNeeded"
_rule = partial(behaviour_rule, interface=MODEL_EXCHANGE)
_rule_of_rows = partial(differential, interface=MODEL_EXCHANGE)
_FOLLOWING = _DERIVATIVES, _INDICATORS  # they follow from time, states and inputs
_ask, _read = do.glance_vectors(_FOLLOWING), do.read_vectors(_FOLLOWING)


class _Start:
    """States at a start of rows, and the times between which there is no time event."""

    def __init__(self, probe: Probe, lead: Sequence[Action]) -> None:
        script = probe.script(do.start, lead=lead)
        info = script.call("new_discrete_states")
        vectors = script.read_vectors((_STATES, _NOMINALS)).replies.values()
        script.play()
        self.states, self._nominals = [reply.value for reply in vectors] or ([], [])
        self._begin, end = script.time, script.time + probe.step_size
        if info.value["nextEventTimeDefined"]:
            end = min(end, info.value["nextEventTime"])
        if not end > self._begin:
            raise NotJudgedError("there is an event at the start")
        self._size = end - self._begin

    def time(self, part: float) -> float:
        return self._begin + part * self._size

    def near(self, part: float) -> list[float]:
        """Returns states near those at the start, by less than a hundredth."""
        pairs = zip(self.states, self._nominals, strict=True)
        return [x + part * 1e-2 * min(abs(x) or nominal, abs(nominal)) for x, nominal in pairs]


def _start(script: Script) -> _Start:
    """Returns the states where the runs of a script begin."""
    probe, lead = script.probe, script.lead
    words = next(start.words for start in starts(probe) if start.lead == lead)
    return probe.once("start of model exchange", lambda: _Start(probe, lead), words)


def _enter(script: Script) -> None:
    """Goes to where the runs of a row begin, and enters continuous-time mode there."""
    script.write([do.start, do.enter_continuous_time_mode])


def _set_time(part: float) -> Action:
    """Sets the time to a part of the step that begins there."""
    return lambda script: script.call("set_time", _start(script).time(part))


def _move(part: float, alone: int | None = None) -> Action:
    """Sets states of a part of the step, and no time.

    alone: index of a state, if the others belong to the part 0.3
    """

    def action(script: Script) -> None:
        states, others = _start(script).near(part), _start(script).near(0.3)
        if alone is not None:
            states = [*others[:alone], states[alone], *others[alone + 1 :]]
        if states:
            script.call("fmi2SetContinuousStates", states, len(states))

    return action


def _go(part: float) -> Action:
    return lambda script: script.write([_set_time(part), _move(part)])


def _row(
    when: str,
    varied: Sequence[Action],
    usual: Sequence[Action] = (),
    tolerance: float = _SOLVED,
    **options: Any,
) -> Row:
    """Returns a row whose runs are in continuous-time mode."""
    return Row(when, (_enter, *varied), (_enter, *usual) if usual else (), tolerance=tolerance, **options)


@_rule("3.2.1")
def derivatives_have_no_history(probe: Probe) -> Iterator[str]:
    """Derivatives and event indicators depend only on time, states and inputs. They are the same again after
    time and states are set back, and right after another time or other states. So are continuous variables,
    in any reading order.
    """
    back = _go(0.3), do.expect(_read), _go(0.6), _ask, _go(0.3), _read, _read
    ways = [None, *range(min(probe.fmu.vector_length(_STATES), _MOST_STATES))]
    # variables with one reference stand side by side, and so become a pair
    variables = sorted(events.follow_at_once(probe.fmu), key=lambda v: v.reference or 0)
    follow, pairs = do.read(variables), [*pairwise(variables[: do.MOST_VARIABLES])]
    before = _move(0.3), _ask, do.glance(variables)
    moved = chain(*((*before, _move(0.9, alone), _read, follow) for alone in ways))
    fresh = chain(*((_move(0.9, alone), do.read_vectors(_FOLLOWING[::-1]), follow) for alone in ways))
    first, second = (
        chain(*((_go(part), do.read(pair[::order])) for part, pair in zip(cycle((0.3, 0.6)), pairs)))
        for order in (1, -1)
    )
    later = (
        (_go(0.3), _ask, _set_time(0.6), _read, _set_time(0.2), follow, _read),
        (_set_time(0.6), _move(0.3), _read, _set_time(0.2), _move(0.3), follow, _read),
    )
    same_time = "after states were set at the same time, as in a new instance"
    rows = [
        _row("after time and states were set back", back),
        _row("after fmi2SetTime alone", *later, again="{}, as where states are set after it"),
        _row(same_time, (_go(0.3), *moved), (_set_time(0.3), *fresh)),
        _row("where another variable is read with it", [*first], [*second]),
    ]

    def read_twice(event: events.Event) -> Iterator[str]:
        _, z, once_more = event.crossing
        scale = 1e-3 * max(map(abs, event.indicators), default=0.0)
        if words := events.change("event indicator", z, once_more, _SOLVED, scale):
            where = f"where the continuous-time mode after {event.words} ends"
            yield f"{words}, read once more {where}: expected the same value"

    yield from [*events.of_events(probe, read_twice)] or differences(probe, rows)


@_rule("3.2.1, 3.2.2", condition=events.no_states)
def discarded_states_can_be_replaced(probe: Probe) -> Iterator[str]:
    """After states that the FMU discards, or whose derivatives it does, it takes the states before, and gives
    their derivatives.
    """

    def far(script: Script, i: int) -> None:
        states = [*_start(script).states]
        states[i] = _FAR * (states[i] or 1.0)
        script.call("fmi2SetContinuousStates", states, len(states))

    for i in range(min(probe.fmu.vector_length(_STATES), _MOST_STATES)):
        tried = do.ignore(partial(far, i=i), _ask)
        script = do.played(probe, (_enter, _go(0.3), tried, _go(0.3), _ask), logging=True)
        is_discarded = DISCARD in {reply.status for reply in script.ignored}
        if is_discarded and (failure := script.failure):
            yield f"after a state was {_FAR:g} times as large, which is discarded: {failure.problem}"
            return


@_rule_of_rows("3.2.2")
def time_goes_back_in_continuous_time(probe: Probe) -> Iterator[Row]:
    """After a completed step without an event the FMU is in continuous-time mode still; time can be set back
    as far as to the completed step before, or to the event before, and gives the derivatives of that time.
    """
    follow = do.read(events.follow_at_once(probe.fmu))
    begin = _go(0.0), do.expect(_read, follow), _go(0.3), _go(0.0), _read, follow
    yield _row("after time was set back to the event's time", begin, failing="back at the event's time")
    complete = [] if probe.fmu.claims(_NOT_NEEDED) else [do.call("complete_step")]
    first = _go(0.3), *complete, _go(0.5)
    yield _row("after a completed step without an event, in continuous-time mode still", (*first, _ask))
    varied = *first, do.expect(_read), _go(0.6), *complete, _go(0.5), _read
    failing = "back in time, after the completed step before"
    yield _row("after time was set back", varied, failing=failing)


@_rule("3.3.1", condition=values.unless_claimed(_NOT_NEEDED))
def completed_step_without_need_has_no_effect(probe: Probe) -> Iterator[str]:
    """With completedIntegratorStepNotNeeded, fmi2CompletedIntegratorStep asks for nothing and changes
    nothing.
    """
    read, complete = do.read_vectors(VECTORS[:3]), do.call("completed_integrator_step")
    first, options = (_go(0.5), do.expect(read), complete), {"needs_completed": True}
    reply = do.played(probe, (_enter, *first)).replies[-1]
    if any(reply.value or ()):
        yield f"{reply.function} asks for event mode or an end of the simulation: expected neither"

    def asked(event: events.Event) -> Iterator[str]:
        if event.cause == "step event":
            yield f"{reply.function} asks for {event.words}: expected that it need not be called"

    yield from events.of_events(probe, asked, **options)
    called = paths.rows(
        probe, partial(paths.with_options, f"where {reply.function} is called", options, paths.SUMMED)
    )
    yield from differences(probe, [_row(f"after {reply.function}", (*first, read)), *called])


@_rule("3.1")
def discrete_variables_are_frozen(probe: Probe) -> Iterator[str]:
    """Discrete variables do not change in continuous-time mode, whatever time, states and inputs are."""
    chosen = events.discrete_variables(probe.fmu)
    read = do.read(chosen)

    def mirrored(sign: int) -> Action:
        def action(script: Script) -> None:
            if states := _start(script).near(0.5):
                moved = [sign * (x or 1e-3) for x in states]
                script.call("fmi2SetContinuousStates", moved, len(moved))

        return action

    inputs = values.continuous_reals(probe, "input")
    sets = (do.set_values([(v, x)]) for v in inputs for x in (*values.far_values(v), v.start_value))
    moved = mirrored(1), read, mirrored(-1), read
    first = do.start, do.expect(read), do.enter_continuous_time_mode
    varied = *first, *moved, _set_time(0.5), *moved, *chain(*((change, read) for change in sets))
    row = Row("in continuous-time mode", varied, (), may_fail=True)

    def left(event: events.Event) -> Iterator[str]:
        for v in chosen if event.left else ():
            if not values.same(a := event.values[v.name], b := event.left[v.name]):
                mode = f"in continuous-time mode after {event.words}"
                yield f"{v.name} changes from {a!r} to {b!r} {mode}: expected {a!r}"

    yield from [*events.of_events(probe, left)] or differences(probe, [row])
