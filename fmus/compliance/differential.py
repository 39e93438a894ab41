"""One oracle for rules that compare two runs: each row holds a usual and a varied one, one function judges."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

from fmus.compliance.accepted import accepted_together
from fmus.compliance.comparison import Given, differing, steadily
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Check, NotJudgedError, behaviour_rule
from fmus.compliance.script import CallError, Reading, Reply, Script
from fmus.compliance.values import other_values, set_input_derivatives, start_value, unknown_reference
from fmus.compliance.variable import Variable
from fmus.fmi.binding import ERROR

ROUNDING = 1e-9  # relative; what is lost by writing a state as text is less
MOST_VARIABLES = 50  # that are changed in a rule
OF_EXPERIMENT = None  # tolerance of a row: that of the default experiment
Action = Callable[["Play"], object]
Pair = tuple[Variable, Any]


class Play:
    """A script that actions write, with its readings: those expected, and those observed, each with when.

    attempts: calls that the FMU may refuse, and then nothing can be compared
    ignored: calls whose failure tells nothing; errors: calls that return error
    """

    def __init__(self, probe: Probe, actions: Iterable[Action], **options: Any) -> None:
        self.probe, self.script = probe, probe.script(**options)
        self.expected: list[Reading | Given] = []
        self.observed: list[tuple[str, Reading]] = []
        self.attempts, self.ignored, self.errors = list[Reply](), list[Reply](), list[Reply]()
        self.write(actions)

    def write(self, actions: Iterable[Action]) -> list[Reply]:
        """Adds the calls of some actions; returns their replies to be."""
        first = len(self.script.replies)
        for action in actions:
            action(self)
        return self.script.replies[first:]

    def failure(self) -> Reply | None:
        """Returns the first call that fails, but those that are ignored, or that return error."""
        excused = {id(reply) for reply in (*self.ignored, *self.errors)}
        failed = (reply for reply in self.script.replies if reply.status is not None and not reply.ok)
        return next((reply for reply in failed if id(reply) not in excused), None)


def _of_script(method: Callable[[Script], object]) -> Action:
    return lambda play: method(play.script)


begin, initialise, pause = _of_script(Script.begin), _of_script(Script.initialise), _of_script(Script.pause)
exit_initialization_mode = _of_script(Script.exit_initialization_mode)
terminate, reset = _of_script(Script.terminate), _of_script(Script.reset)


def step(count: int = 1, no_going_back: bool = False) -> Action:
    return lambda play: play.script.step(count, no_going_back)


def go_on(count: int) -> Action:
    """Steps in one call, which are many."""
    return lambda play: play.script.go_on(count)


def set_up(start: int = 0, stop: int | None = None) -> Action:
    """Sets the experiment up with communication points by their numbers."""
    return lambda play: play.script.set_up(
        play.probe.point(start), None if stop is None else play.probe.point(stop)
    )


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


def free_state(slot: int = 0) -> Action:
    return call("free_fmu_state", slot)


def read(variables: Iterable[Variable], when: str = "") -> Action:
    """Reads variables to be compared, all of one type by one call."""
    return lambda play: play.observed.append((when, play.script.read(variables)))


def read_all(when: str = "") -> Action:
    return lambda play: play.write([read(play.script.variables, when)])


def run(steps: int, when: str = "") -> Action:
    """Makes steps, and reads the outputs after each."""
    return lambda play: play.write([step(), read(play.probe.outputs, when)] * steps)


def run_all(steps: int, when: str = "") -> Action:
    """Makes steps, and reads all variables after each."""
    return lambda play: play.write([step(), read_all(when)] * steps)


def read_slopes(outputs: Sequence[Variable], when: str = "") -> Action:
    """Reads the first derivatives of outputs, if there are any."""

    def action(play: Play) -> None:
        if outputs:
            play.observed.append((when, play.script.read_output_derivatives(outputs)))

    return action


def read_as(pairs: Sequence[Pair], when: str = "") -> Action:
    """Reads variables that should have the values given."""

    def action(play: Play) -> None:
        play.expected.append(Given(dict((v.name, x) for v, x in pairs)))
        play.write([read([v for v, _ in pairs], when)])

    return action


def expect(*actions: Action) -> Action:
    """Takes what actions read as what is expected later."""

    def action(play: Play) -> None:
        first = len(play.observed)
        play.write(actions)
        play.expected += [reading for _, reading in play.observed[first:]]
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


def set_starts(variables: Iterable[Variable]) -> Action:
    return set_values([(v, x) for v in variables if (x := start_value(v)) is not None])


def set_derivatives(value: float = 1.0) -> Action:
    """Sets first derivatives of all continuous Real inputs, if the FMU interpolates."""
    return lambda play: set_input_derivatives(play.probe, play.script, value)


def fail(play: Play) -> None:
    """Makes a call that returns error, and is allowed in every state after initialisation."""
    play.errors.append(play.script.call("get", "Real", [unknown_reference(play.probe)]))


def others_accepted(probe: Probe, variables: Sequence[Variable], *before: Action) -> list[Pair]:
    """Returns variables with other values that the FMU accepts at once after some actions."""
    pairs = other_values(variables[:MOST_VARIABLES])
    return accepted_together(probe, pairs, lambda: Play(probe, before).script)


@dataclass(frozen=True)
class Row:
    """A varied run, which gives what a usual one gives.

    when: words for the variation, in messages; failing: for a call that fails, if others; {state} is replaced
    usual: actions; what they read is expected, after what the varied run itself expects, and over again
    tolerance: relative; None is that of the default experiment
    options: of the instance; beside: actions on other instances, which take turns with it
    may_fail: whether the FMU may refuse a call, and then nothing can be compared
    again: what is expected, in words, of a value
    """

    when: str
    varied: Sequence[Action]
    usual: Sequence[Action] = (begin, run(5))
    failing: str | None = None
    tolerance: float | None = 0.0
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    beside: Sequence[Sequence[Action]] = ()
    may_fail: bool = False
    again: str = "{} again"


def differential(clause: str, **options: Any) -> Callable[[Callable[[Probe], Iterable[Row]]], Check]:
    """Makes a function that yields rows a rule: its docstring is what the rule claims.

    options: of `behaviour_rule`
    """

    def register(rows: Callable[[Probe], Iterable[Row]]) -> Check:
        @wraps(rows)
        def check(probe: Probe) -> Iterator[str]:
            return differences(probe, rows(probe))

        return behaviour_rule(clause, **options)(check)

    return register


def differences(probe: Probe, rows: Iterable[Row]) -> Iterator[str]:
    """Yields how varied runs differ from usual ones, all of which are played once for all rules.

    Raises NotJudgedError if no row can be judged.
    """
    written = [(row, Play(probe, row.usual), _varied(probe, row)) for row in rows]
    probe.play_once([usual.script for row, usual, _ in written if row.usual])
    try:
        probe.play_once([plays[0].script for row, _, plays in written if not row.beside])
    except CallError as error:
        if not written[0][0].options:  # then it is the finding of another rule, or of all
            raise
        yield f"{written[0][0].when}: {error}"
        return
    reasons: list[NotJudgedError] = []
    for row, usual, plays in written:
        if row.beside:
            probe.play(*(play.script for play in plays), keep_going=True)
        try:
            yield from _verdict(probe, row, usual, plays)
        except NotJudgedError as reason:
            reasons.append(reason)
    if reasons and len(reasons) == len(written):
        raise reasons[0]


def _varied(probe: Probe, row: Row) -> list[Play]:
    if not row.beside:
        return [Play(probe, row.varied, logging=not row.may_fail, **row.options)]
    return [Play(probe, actions, name=f"instance {i}") for i, actions in enumerate([row.varied, *row.beside])]


def _verdict(probe: Probe, row: Row, usual: Play, plays: Sequence[Play]) -> Iterator[str]:
    if failure := usual.script.failure:
        raise NotJudgedError(f"the usual run fails: {failure.problem}")
    if any(error.status != ERROR for play in plays for error in play.errors):
        raise NotJudgedError("no call that returns error is known")
    for play in (play for play in plays if play is plays[0] or play.observed):
        failure = play.failure()
        if failure and (row.may_fail or any(failure is reply for reply in play.attempts)):
            raise NotJudgedError(f"a run with other values fails: {failure.problem}")
        if failure:
            prefix = (row.when if row.failing is None else row.failing).format(state=failure.state)
            yield f"{prefix}: {failure.problem}" if prefix else failure.problem
            return
        messages = list(_unlike(probe, row, usual, play))
        yield from steadily(probe, messages) if messages and row.usual else messages


def _unlike(probe: Probe, row: Row, usual: Play, play: Play) -> Iterator[str]:
    if not all(reading.ok for _, reading in play.observed):
        raise NotJudgedError("a call before it fails, which may be")
    tolerance = probe.tolerance if row.tolerance is None else row.tolerance
    expected = [*play.expected, *(reading for _, reading in usual.observed)]
    pairs = zip(itertools.cycle(expected), play.observed, strict=False)
    for when, group in itertools.groupby(pairs, lambda pair: pair[1][0]):
        before, after = zip(*((one, other) for one, (_, other) in group), strict=True)
        yield from differing(before, after, when or row.when, tolerance, row.again)
