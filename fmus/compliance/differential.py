"""Rules that compare two runs: a row holds a usual and a varied run, and one function judges all rows."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

from fmus.compliance import actions as do
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Check, NotApplicableError, NotJudgedError, rule_of
from fmus.compliance.script import Action, CallError, Script
from fmus.compliance.traces.cases import case_of_difference, case_of_reply
from fmus.compliance.traces.generator import excited
from fmus.compliance.traces.replay import Case
from fmus.compliance.values import Difference, differing
from fmus.fmi.binding import DISCARD

ROUNDING = 1e-9  # relative: of values that are computed again
_LATE = 5  # legs: some is left of the default experiment for what follows
_SLOT = 1000  # of a saved state, which no row uses
OF_EXPERIMENT = None  # tolerance of a row: the tolerance of the default experiment


class Start(NamedTuple):
    """A state from which rows are played. words: in messages; lead: actions that lead there."""

    words: str
    lead: Sequence[Action]


AT_FIRST = Start("", ())


@dataclass(frozen=True)
class Row:
    """A varied run, which gives what a usual one gives.

    It is crossed with starts, if its actions begin with `start`: see `starts`.

    when: words for the variation, in messages; failing: for a call that fails, if others; {state} is replaced
    usual: actions; what they read is expected, after what the varied run itself expects, and over again;
      None for as many steps as outputs are read
    tolerance: relative; None: the tolerance of the default experiment
    options: of the instance, or of those beside it, if there are any; beside: actions on other instances,
      which take turns with it; those with none are created before it
    may_fail: whether the FMU may refuse a call, and then nothing can be compared
    again: template of the expected value in messages
    start: where its runs begin
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
    start: Start = AT_FIRST


def differential(clause: str, **options: Any) -> Callable[[Callable[[Probe], Iterable[Row]]], Check]:
    """Makes a function that yields rows a rule; its docstring is the claim of the rule.

    options: of `behaviour_rule`
    """
    return rule_of(lambda probe, rows: differences(probe, rows(probe)), clause, **options)


def differences(probe: Probe, rows: Iterable[Row]) -> Iterator[str]:
    """Yields how varied runs differ from usual ones, all of which are played once for all rules.

    Raises NotJudgedError if no row can be judged.
    """
    reasons, written = list[NotJudgedError](), list[tuple[Row, Script, list[Script]]]()
    for row in rows:
        try:
            written += _crossed(probe, row)
        except NotJudgedError as reason:
            # the row needs a call that is not known, such as one that returns error
            reasons.append(reason)
    count = len(written) + len(reasons)
    probe.play_once([usual for _, usual, _ in written if usual.calls])
    try:
        probe.play_once([plays[0] for row, _, plays in written if not row.beside])
    except CallError as error:
        # without options the same error is a finding of other rules
        if not written[0][0].options:
            raise
        yield f"{_failing(written[0][0])}: {error}"
        return
    for row, usual, plays in written:
        if row.beside:
            first_idle = sorted(plays, key=lambda play: bool(play.calls))
            probe.play(*first_idle, keep_going=True)
        try:
            for message, case in verdict(probe, row, usual, plays):
                probe.shared.cases[message] = case
                yield message
        except NotJudgedError as reason:
            reasons.append(reason)
    if reasons and len(reasons) == count:
        raise reasons[0]


def _failing(row: Row) -> str:
    return row.when if row.failing is None else row.failing


def _crossed(probe: Probe, row: Row) -> Iterator[tuple[Row, Script, list[Script]]]:
    """Yields a row as `_write` returns it, from each start if it is crossed with these."""
    at_first = _write(probe, row)
    yield at_first
    for start in starts(probe)[1:] if at_first[2][0].has_started and not row.start.lead else ():
        yield _write(probe, replace(row, start=start))


def starts(probe: Probe) -> list[Start]:
    """Returns the states from which rows are played: at first; and late in a run, with other inputs if
    possible, and of a state that was set back there if another rule finds that right.
    """
    return probe.once("starts of runs", lambda: [AT_FIRST, *_other_starts(probe)])


def late_lead(probe: Probe) -> Sequence[Action]:
    """Returns the actions that lead late into a run; none where `starts` has but the first state."""
    return starts(probe)[-1].lead


def _other_starts(probe: Probe) -> Iterator[Start]:
    """Yields the first of some states late in a run from which the run can continue."""
    back, saves = (do.save(_SLOT), do.step(), do.restore(_SLOT), do.free_state(_SLOT)), "canGetAndSetFMUstate"
    # odd parameters often cause numerical trouble
    others = (
        t.sets for t in excited(probe) if {v.causality for v, _ in itertools.chain(*t.sets)} == {"input"}
    )
    with_others = [(" with other inputs", do.excite(sets[:_LATE])) for sets in others]
    for words, lead in (*with_others, ("", do.leap(2))):
        if probe.fmu.claims(saves) and _is_steady(probe, (lead, *back), (lead,)):
            yield Start(f", from a state set back late in a run{words}", (lead, *back))
            return
        if _is_steady(probe, (lead,), (lead,)):
            yield Start(f", late in a run{words}", (lead,))
            return


def _is_steady(probe: Probe, lead: Sequence[Action], usual: Sequence[Action]) -> bool:
    """Whether a run continues after some actions without a failed call, and as after the usual ones."""
    read = do.read_all(), do.step(8), do.read_all()
    row = Row("", (do.begin, *lead, *read), (do.begin, *usual, *read), tolerance=OF_EXPERIMENT)
    try:
        return not list(differences(probe, [row]))
    except (CallError, NotJudgedError, NotApplicableError):
        return False


def _write(probe: Probe, row: Row) -> tuple[Row, Script, list[Script]]:
    """Returns a row with its usual run, and its varied one with those beside it."""
    written = partial(probe.script, lead=row.start.lead)
    plays = [written(*row.varied, logging=not row.may_fail, **row.options)]
    if row.beside:
        all_actions = enumerate([row.varied, *row.beside])
        plays = [
            written(*actions, name=f"instance {i}", logging=True, **(row.options if i else {}))
            for i, actions in all_actions
        ]
    steps = max(len(play.observed) for play in plays)
    usual = row.usual if row.usual is not None else (do.begin, do.run(steps)) if steps else ()
    return row, written(*usual), plays


def verdict(probe: Probe, row: Row, usual: Script, plays: Sequence[Script]) -> Iterator[tuple[str, Case]]:
    """Yields the differences of the played runs of a row, each with what shows it: the varied one and those
    beside it.

    Raises NotJudgedError where the usual run fails, or the varied one in what may fail.
    """
    if failure := usual.failure:
        raise NotJudgedError(f"the usual run fails: {failure.problem}")
    errors = [error for play in plays for error in play.errors]
    if any(reply.status not in expected and not finding for reply, finding, expected in errors):
        raise NotJudgedError("no call that returns error is known")
    for play in (play for play in plays if play is plays[0] or play.observed):
        failure = play.failure
        # `statuses-are-legal` reports an illegal discard
        may_discard = failure and (probe.fmu.is_model_exchange or failure.reason)
        is_discarded = failure and failure.status == DISCARD and may_discard
        if failure and (row.may_fail or is_discarded):
            raise NotJudgedError(f"a call fails that may: {failure.problem}")
        if failure:
            prefix = f"{_failing(row).format(state=failure.state)}{row.start.words}".removeprefix(", ")
            text = f"{prefix}: {failure.problem}" if prefix else failure.problem
            yield text, case_of_reply(failure, plays)
            return
        tolerance = probe.tolerance if row.tolerance is None else row.tolerance
        differences = list(_unlike(row, tolerance, usual, play))
        unsteady = _unsteady(probe) if differences and usual.observed else set[str]()
        for found in differences:
            if found.name not in unsteady:
                yield found.text, case_of_difference(found, tolerance, usual, play, plays)
    for reply, finding, expected in errors:
        if finding and reply.status not in (None, *expected):
            text = finding.format(reply=reply)
            yield f"{row.when}: {text}" if row.when else text, case_of_reply(reply, plays)


def _unlike(row: Row, tolerance: float, usual: Script, play: Script) -> Iterator[Difference]:
    if not all(reading.ok for reading in (*play.readings, *usual.readings)):
        raise NotJudgedError("a call fails that may")
    expected = [*play.expected, *usual.readings]
    compared = [(*seen, one) for one, seen in zip(itertools.cycle(expected), play.observed, strict=False)]
    for when, group in itertools.groupby(compared, lambda parts: parts[0]):
        _, where, after, before = zip(*group, strict=True)
        words = f"{when or row.when}{row.start.words}"
        yield from differing(before, after, words, tolerance, row.again, where)


def _unsteady(probe: Probe) -> set[str]:
    """Returns the names of the variables that differ between instances, such as clocks of the computer."""

    def names() -> set[str]:
        run = do.begin, *(do.step(), do.read(probe.fmu.variables)) * 3
        scripts = [probe.script(*run) for _ in range(2)]
        probe.play_each(scripts)
        if not all(script.succeeded for script in scripts):
            raise NotJudgedError("a run fails")
        first, second = (script.readings for script in scripts)
        return {found.name for found in differing(first, second, "")}

    return probe.once("comparison of two runs", names)
