"""One oracle for rules that compare two runs: a row holds a usual and a varied one, one function judges."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Check, NotJudgedError, behaviour_rule
from fmus.compliance.script import Action, CallError, Script
from fmus.compliance.values import differing, steadily
from fmus.fmi.binding import ERROR

ROUNDING = 1e-9  # relative: of values that are computed again
OF_EXPERIMENT = None  # tolerance of a row: that of the default experiment


@dataclass(frozen=True)
class Row:
    """A varied run, which gives what a usual one gives.

    when: words for the variation, in messages; failing: for a call that fails, if others; {state} is replaced
    usual: actions; what they read is expected, after what the varied run itself expects, and over again;
      None for as many steps as outputs are read
    tolerance: relative; None is that of the default experiment
    options: of the instance; beside: actions on other instances, which take turns with it
    may_fail: whether the FMU may refuse a call, and then nothing can be compared
    again: what is expected, in words, of a value
    """

    when: str
    varied: Sequence[Action]
    usual: Sequence[Action] | None = None
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
    written = [_write(probe, row) for row in rows]
    probe.play_once([usual for _, usual, _ in written if usual.calls])
    try:
        probe.play_once([plays[0] for row, _, plays in written if not row.beside])
    except CallError as error:
        if not written[0][0].options:  # then it is the finding of another rule, or of all
            raise
        yield f"{_failing(written[0][0])}: {error}"
        return
    reasons: list[NotJudgedError] = []
    messages: dict[str, str] = {}  # the first of each variable
    for row, usual, plays in written:
        if row.beside:
            probe.play(*plays, keep_going=True)
        try:
            for message in verdict(probe, row, usual, plays):
                messages.setdefault(message.split(" is ", 1)[0], message)
        except NotJudgedError as reason:
            reasons.append(reason)
    yield from messages.values()
    if reasons and len(reasons) == len(written):
        raise reasons[0]


def _failing(row: Row) -> str:
    return row.when if row.failing is None else row.failing


def _write(probe: Probe, row: Row) -> tuple[Row, Script, list[Script]]:
    """Returns a row with its usual run, and its varied one with those beside it."""
    plays = [probe.script(*row.varied, logging=not row.may_fail, **row.options)]
    if row.beside:
        all_actions = enumerate([row.varied, *row.beside])
        plays = [probe.script(*actions, name=f"instance {i}", logging=True) for i, actions in all_actions]
    steps = max(len(play.observed) for play in plays)
    usual = row.usual if row.usual is not None else (do.begin, do.run(steps)) if steps else ()
    return row, probe.script(*usual), plays


def verdict(probe: Probe, row: Row, usual: Script, plays: Sequence[Script]) -> Iterator[str]:
    """Yields what differs, in plays of a row that were played: its varied one, and those beside it.

    Raises NotJudgedError where the usual run fails, or the varied one in what may fail.
    """
    if failure := usual.failure:
        raise NotJudgedError(f"the usual run fails: {failure.problem}")
    errors = [error for play in plays for error in play.errors]
    if any(reply.status != ERROR and not finding for reply, finding in errors):
        raise NotJudgedError("no call that returns error is known")
    for play in (play for play in plays if play is plays[0] or play.observed):
        failure = play.failure
        if failure and (row.may_fail or any(failure is reply for reply in play.attempts)):
            raise NotJudgedError(f"a call fails that may: {failure.problem}")
        if failure:
            prefix = _failing(row).format(state=failure.state)
            yield f"{prefix}: {failure.problem}" if prefix else failure.problem
            return
        messages = list(_unlike(probe, row, usual, play))
        yield from steadily(probe, messages) if messages and usual.observed else messages
    for reply, finding in errors:
        if finding and reply.status not in (None, ERROR):
            text = finding.format(reply.status_name)
            yield f"{row.when}: {text}" if row.when else text


def _unlike(probe: Probe, row: Row, usual: Script, play: Script) -> Iterator[str]:
    if not all(reading.ok for *_, reading in play.observed):
        raise NotJudgedError("a call fails that may")
    tolerance = probe.tolerance if row.tolerance is None else row.tolerance
    expected = [*play.expected, *(reading for *_, reading in usual.observed)]
    compared = [(*seen, one) for one, seen in zip(itertools.cycle(expected), play.observed, strict=False)]
    for when, group in itertools.groupby(compared, lambda parts: parts[0]):
        _, where, after, before = zip(*group, strict=True)
        yield from differing(before, after, when or row.when, tolerance, row.again, where)
