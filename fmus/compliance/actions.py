"""Small actions, of which scripts are written: calls on an instance, and readings to be compared."""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError
from fmus.compliance.script import Reading, Reply, Script
from fmus.compliance.values import (
    INTERPOLATES,
    Given,
    accepted_together,
    continuous_reals,
    other_values,
    references_of,
    refused_reference,
)
from fmus.compliance.variable import Variable

MOST_VARIABLES = 50  # that are changed in a rule
Action = Callable[["Play"], object]
Pair = tuple[Variable, Any]


class Play:
    """A script that actions write, with its readings.

    expected, observed: readings to be compared; the latter with words for when and where
    attempts: calls that the FMU may refuse, and then nothing can be compared
    ignored: calls whose failure tells nothing
    errors: calls that return error, each with words for a finding if it does not
    """

    def __init__(self, probe: Probe, actions: Iterable[Action], **options: Any) -> None:
        self.probe, self.script = probe, probe.script(**options)
        self.expected: list[Reading | Given] = []
        self.observed: list[tuple[str, str, Reading]] = []
        self.attempts, self.ignored = list[Reply](), list[Reply]()
        self.errors: list[tuple[Reply, str]] = []
        self.write(actions)

    def write(self, actions: Iterable[Action]) -> list[Reply]:
        """Adds the calls of some actions; returns their replies to be."""
        first = len(self.script.replies)
        for action in actions:
            action(self)
        return self.script.replies[first:]

    def replies_of(self, function: str) -> list[Reply]:
        """Returns the replies of a function. Raises NotJudgedError if any call has failed."""
        if not self.script.succeeded:
            raise NotJudgedError(f"a run with {function} fails")
        return [reply for reply in self.script.replies if reply.function == function]

    @property
    def content(self) -> str:
        """The bytes of the state that was serialised, as hexadecimal digits."""
        return self.replies_of("fmi2SerializeFMUstate")[0].value[0]

    def failure(self) -> Reply | None:
        """Returns the first call that fails, but those that are ignored, or that return error."""
        excused = {id(reply) for reply in (*self.ignored, *(reply for reply, _ in self.errors))}
        failed = (reply for reply in self.script.replies if reply.status is not None and not reply.ok)
        return next((reply for reply in failed if id(reply) not in excused), None)


def _of_script(method: Callable[[Script], object]) -> Action:
    return lambda play: method(play.script)


begin, initialise, pause = _of_script(Script.begin), _of_script(Script.initialise), _of_script(Script.pause)
forbidden = _of_script(Script.forbidden)
exit_initialization_mode = _of_script(Script.exit_initialization_mode)
enter_initialization_mode = _of_script(Script.enter_initialization_mode)
enter_event_mode = _of_script(Script.enter_event_mode)
enter_continuous_time_mode = _of_script(Script.enter_continuous_time_mode)
terminate, reset = _of_script(Script.terminate), _of_script(Script.reset)


def step(count: int = 1, no_going_back: bool = False) -> Action:
    return lambda play: play.script.step(count, no_going_back)


def go_on(count: int) -> Action:
    """Steps in one call, which are many."""
    return lambda play: play.script.go_on(count)


def set_up(stop: int, tolerance: float | None = None) -> Action:
    """Sets the experiment up with a stop time at the communication point of a number."""
    return lambda play: play.script.set_up(stop=play.script.point(stop), tolerance=tolerance)


def begin_until(stop: int, tolerance: float | None = None) -> tuple[Action, ...]:
    """Initialises, with a stop time at the communication point of a number."""
    return set_up(stop, tolerance), enter_initialization_mode, exit_initialization_mode


def in_state(name: str) -> Action:
    """Notes the state that the calls before lead to."""
    return lambda play: setattr(play.script, "state", name)


def plain(function: str) -> Action:
    """Calls a function of FMI that has no argument but the instance."""
    return lambda play: play.script.plain(function)


def call(method: str, *arguments: Any) -> Action:
    """Calls a method of `CalledInstance`."""
    return lambda play: play.script.call(method, *arguments)


def save(slot: int = 0) -> Action:
    return lambda play: play.script.save(slot)


def restore(slot: int = 0) -> Action:
    return lambda play: play.script.restore(slot)


def copy(slot: int, other: int) -> Action:
    """Makes another saved state of the bytes of one."""
    return lambda play: play.script.copy(slot, other)


def read_bytes(source: Play, slot: int = 0) -> Action:
    """Makes a saved state of the bytes of another script that was played."""
    return lambda play: play.script.read_bytes(slot, source.content, source.script)


def free_state(slot: int = 0) -> Action:
    return call("free_fmu_state", slot)


def read(variables: Iterable[Variable], when: str = "", where: str = "") -> Action:
    """Reads variables to be compared, all of one type by one call."""
    return lambda play: play.observed.append((when, where, play.script.read(variables)))


def read_all(when: str = "", where: str = "") -> Action:
    return lambda play: play.write([read(play.script.variables, when, where)])


def go_on_reading(steps: int, readings: int, when: str = "", observed: Sequence[Variable] = ()) -> Action:
    """Makes many steps, in which all variables are read a few times, and those observed after each."""
    ends = [steps * i // readings for i in range(readings + 1)]
    groups = itertools.groupby(observed, lambda v: v.base_kind)
    of_kinds = [(kind, references_of(variables)) for kind, variables in groups]

    def action(play: Play) -> None:
        for before, end in itertools.pairwise(ends):
            play.script.go_on(end - before, of_kinds)
            play.write([read_all(when, f", at {play.script.time:g} s")])

    return action


def run(steps: int, when: str = "") -> Action:
    """Makes steps, and reads the outputs after each."""
    return lambda play: [
        play.write([step(), read(play.probe.outputs, when, f", step {i + 1}")]) for i in range(steps)
    ]


def run_all(steps: int, when: str = "") -> Action:
    """Makes steps, and reads all variables after each."""
    return lambda play: [play.write([step(), read_all(when, f", step {i + 1}")]) for i in range(steps)]


def glance(variables: Iterable[Variable]) -> Action:
    """Reads variables, and compares nothing."""
    return lambda play: play.script.read(variables)


def read_slopes(outputs: Sequence[Variable], when: str = "", orders: int | Sequence[int] = 1) -> Action:
    """Reads derivatives of outputs, if there are any, of one order or each of its own, in one call."""

    def action(play: Play) -> None:
        if outputs:
            reply = play.script.call("output_derivatives", references_of(outputs), orders)
            play.observed.append((when, "", Reading({"Real": list(outputs)}, {"Real": reply})))

    return action


def read_as(pairs: Sequence[Pair], when: str = "") -> Action:
    """Reads variables that should have the values given."""

    def action(play: Play) -> None:
        play.expected.append(Given({v.name: x for v, x in pairs}))
        play.write([read([v for v, _ in pairs], when)])

    return action


def expect(*actions: Action) -> Action:
    """Takes what actions read as what is expected later."""

    def action(play: Play) -> None:
        first = len(play.observed)
        play.write(actions)
        play.expected += [reading for *_, reading in play.observed[first:]]
        del play.observed[first:]

    return action


def attempt(*actions: Action) -> Action:
    """Makes calls that the FMU may refuse, and then nothing can be compared."""
    return lambda play: play.attempts.extend(play.write(actions))


def ignore(*actions: Action) -> Action:
    """Makes calls whose failure tells nothing."""
    return lambda play: play.ignored.extend(play.write(actions))


def set_values(pairs: Iterable[Pair]) -> Action:
    """Sets each variable in a call of its own."""
    return lambda play: [play.script.set(v, x) for v, x in pairs]


def set_others(variables: Sequence[Variable]) -> Action:
    """Sets some variables to other values, which the FMU may refuse."""
    return ignore(set_values(other_values(variables[:MOST_VARIABLES])))


def set_at_once(kind: str, pairs: Sequence[Pair]) -> Action:
    """Sets variables of one type in one call."""
    contents = [x.encode().hex() if isinstance(x, str) else x for _, x in pairs]
    return call("set", kind, references_of(v for v, _ in pairs), contents)


def set_derivatives(value: float = 1.0, order: int = 1) -> Action:
    """Sets derivatives of one order, of all continuous Real inputs, if the FMU interpolates."""

    def action(play: Play) -> None:
        references = references_of(continuous_reals(play.probe, "input"))
        if references and play.probe.fmu.claims(INTERPOLATES):
            count = len(references)
            play.script.call("set_input_derivatives", references, [order] * count, [value] * count)

    return action


def error(action: Action, finding: str = "") -> Action:
    """Makes a call that returns error, and allows what follows; otherwise nothing is judged, or it is a
    finding, where {} in its words is what the call returned.
    """
    return lambda play: play.errors.extend((reply, finding) for reply in play.write([action]))


def fail(play: Play) -> None:
    """Makes a call that returns error."""
    play.write([error(call("get", "Real", [refused_reference(play.probe)]))])


def played(probe: Probe, actions: Iterable[Action], **options: Any) -> Play:
    """Returns what actions write, played once for all rules; a call that fails ends nothing."""
    play = Play(probe, actions, **options)
    probe.play_once([play.script])
    return play


def over_the_experiment(probe: Probe) -> Play:
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
    pairs = other_values(variables[:MOST_VARIABLES])
    return accepted_together(probe, pairs, lambda: Play(probe, before).script)
