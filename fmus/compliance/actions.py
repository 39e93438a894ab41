"""Small actions, of which scripts are written: calls on an instance, and readings to be compared."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Concatenate, ParamSpec

from fmus.compliance import values
from fmus.compliance.probe import Probe
from fmus.compliance.script import Action, Given, Reading, Script
from fmus.compliance.variable import Variable
from fmus.fmi.binding import ERROR

MOST_VARIABLES = 50  # that are changed in a rule
P = ParamSpec("P")
Pair = tuple[Variable, Any]


def _action(method: Callable[Concatenate[Script, P], object]) -> Callable[P, Action]:
    """Returns a function of arguments that returns the action of calling a method with them."""
    return lambda *args, **kwargs: lambda script: method(script, *args, **kwargs)


begin: Action = Script.begin
start: Action = Script.start
initialise: Action = Script.initialise
enter_initialization_mode: Action = Script.enter_initialization_mode
exit_initialization_mode: Action = Script.exit_initialization_mode
enter_event_mode: Action = Script.enter_event_mode
enter_continuous_time_mode: Action = Script.enter_continuous_time_mode
pause: Action = Script.pause
forbidden: Action = Script.forbidden
terminate: Action = Script.terminate
reset: Action = Script.reset
call, step, leap = _action(Script.call), _action(Script.step), _action(Script.leap)
go_on = _action(Script.go_on)
save, restore, copy = _action(Script.save), _action(Script.restore), _action(Script.copy)
read_bytes, glance, plain = _action(Script.read_bytes), _action(Script.read), _action(Script.plain)


def set_up(stop: int, tolerance: float | None = None, start: int = 0) -> Action:
    """Sets the experiment up, from the communication point of a number to that of another."""

    def action(script: Script) -> None:
        times = script.probe.point(start), script.probe.point(stop)
        script.call("set_up_experiment", *times, tolerance)

    return action


def begin_until(stop: int, tolerance: float | None = None, start: int = 0) -> tuple[Action, ...]:
    """Initialises, with start and stop times as of `set_up`."""
    return set_up(stop, tolerance, start), enter_initialization_mode, exit_initialization_mode


def in_state(name: str) -> Action:
    """Notes the state that the calls before lead to."""
    return lambda script: setattr(script, "state", name)


def set_time(script: Script) -> None:
    """Sets the time to what they are."""
    script.call("set_time", script.time)


def free_state(slot: int = 0) -> Action:
    return call("free_fmu_state", slot)


def read(variables: Iterable[Variable], when: str = "", where: str = "") -> Action:
    """Reads variables to be compared, all of one type by one call."""
    return lambda script: script.observed.append((when, where, script.read(variables)))


def read_all(when: str = "", where: str = "") -> Action:
    return lambda script: script.observed.append((when, where, script.read_everything()))


def glance_all(script: Script) -> None:
    """Reads all variables, which are not compared."""
    script.read(script.probe.fmu.variables)


def read_vectors(functions: Iterable[str], when: str = "") -> Action:
    """Reads vectors of model exchange."""
    return lambda script: script.observed.append((when, "", script.read_vectors(functions)))


def go_on_reading(steps: int, readings: int, when: str = "", observed: Sequence[Variable] = ()) -> Action:
    """Makes many steps, in which all variables are read a few times, and those observed after each."""
    ends = [steps * i // readings for i in range(readings + 1)]
    groups = itertools.groupby(observed, lambda v: v.base_kind)
    of_kinds = [(kind, values.references_of(variables)) for kind, variables in groups]

    def action(script: Script) -> None:
        for before, end in itertools.pairwise(ends):
            script.go_on(end - before, of_kinds)
            script.write([read_all(when, f", at {script.time:g} s")])

    return action


def run(steps: int, when: str = "") -> Action:
    """Makes steps, and reads the outputs after each."""
    return lambda script: [
        script.write([step(), read(script.probe.outputs, when, f", step {i + 1}")]) for i in range(steps)
    ]


def run_all(steps: int, when: str = "") -> Action:
    """Makes steps, and reads all variables after each."""
    return lambda script: [script.write([step(), read_all(when, f", step {i + 1}")]) for i in range(steps)]


def read_slopes(outputs: Sequence[Variable], when: str = "", order: int = 1) -> Action:
    """Reads derivatives of one order of outputs, if there are any, in one call; values are of order 0."""
    if not order:
        return read(outputs, when)

    def action(script: Script) -> None:
        if outputs:
            reply = script.call("output_derivatives", values.references_of(outputs), order)
            script.observed.append((when, "", Reading({"Real": list(outputs)}, {"Real": reply})))

    return action


def read_as(pairs: Sequence[Pair], when: str = "") -> Action:
    """Reads variables that should have the values given."""

    def action(script: Script) -> None:
        script.expected.append(Given({v.name: x for v, x in pairs}))
        script.write([read([v for v, _ in pairs], when)])

    return action


def expect(*actions: Action) -> Action:
    """Takes what actions read as what is expected later."""

    def action(script: Script) -> None:
        first = len(script.observed)
        script.write(actions)
        script.expected += [reading for *_, reading in script.observed[first:]]
        del script.observed[first:]

    return action


def ignore(*actions: Action) -> Action:
    """Makes calls whose failure tells nothing."""
    return lambda script: script.ignored.extend(script.write(actions))


def set_values(pairs: Iterable[Pair]) -> Action:
    """Sets each variable in a call of its own."""
    return lambda script: [script.set(v, x) for v, x in pairs]


def set_others(variables: Sequence[Variable]) -> Action:
    """Sets some variables to other values, which the FMU may refuse."""
    return ignore(set_values(values.other_values(variables[:MOST_VARIABLES])))


def set_at_once(pairs: Sequence[Pair]) -> list[Action]:
    """Returns actions that set variables, all of one type in one call."""
    kinds: dict[str, list[Pair]] = {}
    for v, x in pairs:
        kinds.setdefault(v.base_kind, []).append((v, x.encode().hex() if isinstance(x, str) else x))
    return [
        call("set", kind, values.references_of(v for v, _ in some), [x for _, x in some])
        for kind, some in kinds.items()
    ]


def set_derivatives(value: float = 1.0, order: int = 1) -> Action:
    """Sets derivatives of one order, of all continuous Real inputs, if the FMU interpolates."""

    def action(script: Script) -> None:
        references = values.references_of(values.continuous_reals(script.probe, "input"))
        if references and script.probe.fmu.claims(values.INTERPOLATES):
            count = len(references)
            script.call("set_input_derivatives", references, [order] * count, [value] * count)

    return action


def error(action: Action, finding: str = "", *statuses: int) -> Action:
    """Makes a call that returns error, and allows what follows; otherwise nothing is judged, or it is a
    finding, whose words are those of the reply.

    statuses: that it may return, if others
    """
    expected = statuses or (ERROR,)
    return lambda script: script.errors.extend((reply, finding, expected) for reply in script.write([action]))


def fail(script: Script) -> None:
    """Makes a call that returns error."""
    script.write([error(call("get", "Real", [values.refused_reference(script.probe)]))])


def played(probe: Probe, actions: Iterable[Action], **options: Any) -> Script:
    """Returns a script of actions, played once for all rules; a call that fails ends nothing."""
    script = probe.script(*actions, **options)
    probe.play_once([script])
    return script


def over_the_experiment(probe: Probe) -> Script:
    """Returns a run with the stop time of the default experiment, if it has one, all variables read a few
    times and numbers among the outputs after each step; up to that time, or as far as steps take about a
    second.
    """
    stop = probe.stop_time if math.isfinite(probe.stop_time) else None
    set_up = call("set_up_experiment", probe.start_time, stop)
    steps = go_on_reading(probe.steps_of_experiment, 8, "in the default experiment", number_outputs(probe))
    start = set_up, enter_initialization_mode, exit_initialization_mode
    return played(probe, [*start, steps], logging=True, watched=True)


def number_outputs(probe: Probe) -> list[Variable]:
    """Returns the outputs that are numbers, by type."""
    return [v for kind in ("Real", "Integer") for v in probe.outputs if v.base_kind == kind]


def others_accepted(probe: Probe, variables: Sequence[Variable], *before: Action) -> list[Pair]:
    """Returns variables with other values that the FMU accepts at once after some actions."""
    return accepted_together(probe, values.other_values(variables[:MOST_VARIABLES]), *before)


def others_in_turn(probe: Probe, variables: Sequence[Variable], *before: Action) -> Iterator[list[Pair]]:
    """Yields sets of variables and values that the FMU accepts at once after some actions: those near the
    start values first, then each of those far from them.
    """
    ways = ([(v, x) for x in (values.other_value(v), *values.far_values(v))] for v in variables)
    for some in itertools.zip_longest(*ways):
        pairs = [pair for pair in some if pair and pair[1] is not None]
        yield accepted_together(probe, pairs, *before)


def accepted_together(probe: Probe, pairs: Sequence[Pair], *before: Action) -> list[Pair]:
    """Returns variables and values with which the FMU takes a step at once after some actions: all, or each
    that it takes beside those before it; found once for all rules that begin alike.
    """

    def chosen(some: Sequence[Pair], beside: Sequence[Pair] = ()) -> list[Pair]:
        if not some or _takes(probe, [*beside, *some], before):
            return list(some)
        half = len(some) // 2
        left = chosen(some[:half], beside) if half else []
        return [*left, *(chosen(some[half:], [*beside, *left]) if half else [])]

    key = [(v.name, x) for v, x in pairs], probe.script(*before).calls
    return probe.once("choice of values", lambda: chosen(pairs), *key)


def _takes(probe: Probe, pairs: Sequence[Pair], before: Sequence[Action]) -> bool:
    """Whether the FMU takes a step after values were set in a new script."""

    def finish(script: Script) -> None:
        if script.state == "instantiated":
            script.initialise()
        if script.state == "initialization mode":
            script.exit_initialization_mode()
        script.step()

    script = probe.script(*before, set_values(pairs), finish)
    probe.play_each([script])
    return script.succeeded
