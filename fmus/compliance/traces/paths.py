"""Paths that must agree: the same trace in other ways, each a row of the rule whose sentence it breaks."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row
from fmus.compliance.probe import Probe
from fmus.compliance.script import Action, Script
from fmus.compliance.traces.generator import Pairs, Trace, set_together, traces
from fmus.compliance.traces.table import TABLES
from fmus.compliance.variable import is_true

MANY_SETS = "canHandleMultipleSetPerTimeInstant"
_JUDGED = 2  # traces of each path
_SLOT, _COPY = 0, 1  # of saved states
SUMMED = 1e-3  # relative: some dozen steps of a solver that begins elsewhere sum up their errors
Path = Callable[[Probe, Trace, Trace], Iterator[Row]]


def rows(probe: Probe, path: Path, with_plain: bool = False) -> Iterator[Row]:
    """Yields the rows of a path, given each of the last random traces, which vary most, and another one.

    with_plain: whether the first trace, which sets nothing, is judged, too
    """
    some = [*traces(probe)[:with_plain], *traces(probe)[-_JUDGED:]]
    for trace, other in zip(some, [*some[1:], *some[:1]], strict=True):
        yield from path(probe, trace, other)


def _row(when: str, trace: Trace, varied: Sequence[Action], tolerance: float = 0.0, **more: Any) -> Row:
    return Row(when, tuple(varied), trace.whole(), tolerance=tolerance, **more)


def with_options(
    when: str, options: Mapping[str, Any], tolerance: float, _: Probe, trace: Trace, __: Trace
) -> Iterator[Row]:
    """Yields the same run of an instance with logging and some options."""
    yield _row(when, trace, trace.whole(), tolerance, options=options)


# the same calls in the same order give the same bits
again = partial(with_options, "with logging", {"watched": True}, 0.0)


def asked(probe: Probe, trace: Trace, _: Trace) -> Iterator[Row]:
    """Yields a run with all questions that the states allow."""
    table = TABLES[probe.fmu.interface]
    saved = (do.save(_SLOT), do.free_state(_SLOT)) if probe.fmu.claims(values.SAVES) else ()

    def questions(state: str) -> list[Action]:
        return [*chain(*(calls(probe, state) for states, calls in table.questions if state in states))]

    def leg(i: int) -> Iterator[Action]:
        # 4.2.4 has no reading between setting and a step
        middle = questions(table.stepping) if probe.fmu.is_model_exchange else ()
        yield from trace.run(i, i + 1, lambda pairs: do.together(set_together(pairs), *middle))
        yield from (*saved, *questions(table.stepping))

    legs = chain(*map(leg, range(len(trace.legs))))
    first = *trace.begin(), *saved, *questions(table.stepping)
    when = "where values and derivatives are read more often"
    yield _row(when, trace, (*first, *legs), SUMMED, may_fail=True)


def set_otherwise(probe: Probe, trace: Trace, _: Trace) -> Iterator[Row]:
    """Yields a run in which each value is set in a separate call, in another order."""

    varied = trace.whole(lambda pairs: do.set_values(pairs[::-1]))
    yield _row("where values were set one after another, the last first", trace, varied)


def set_again(probe: Probe, trace: Trace, _: Trace) -> Iterator[Row]:
    """Yields a run in which all inputs and tunable parameters are set at each point, to what they are."""
    present = {v.index: (v, x) for v, x in values.start_values(probe.fmu.settable_while_stepping)}
    present |= {v.index: (v, x) for v, x in (*trace.before, *trace.early) if v.index in present}

    def everything(pairs: Pairs) -> Action:
        present.update((v.index, (v, x)) for v, x in pairs)
        return set_together([*present.values()])

    when = "where inputs and tunable parameters were set to what they are"
    yield _row(when, trace, (*trace.begin(), *trace.run(setting=everything)), values.RESTARTED)


def set_twice(_: Probe, trace: Trace, __: Trace) -> Iterator[Row]:
    """Yields a run in which values are set twice at a time, at first to their start values."""

    def twice(pairs: Pairs) -> Action:
        many = (v for v, _ in pairs if is_true(v.attributes.get(MANY_SETS, "true")))
        return do.together(set_together(values.start_values(many)), set_together(pairs))

    yield _row("where values were set twice at a time", trace, trace.whole(twice), values.RESTARTED)


def unread(*actions: Action) -> Action:
    """Returns actions whose readings are not compared, and whose failure is ignored."""

    def action(script: Script) -> None:
        count = len(script.observed)
        script.write([do.ignore(*actions)])
        del script.observed[count:]

    return action


def after_reset(_: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run after another one, after itself, and fmi2Reset."""
    varied = unread(*other.whole()), do.reset, unread(*trace.whole()), do.reset, *trace.whole()
    yield _row("after other runs and fmi2Reset", trace, varied, SUMMED)


def after_an_error(_: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run after another one, an error and fmi2Reset."""
    varied = unread(*other.whole()), do.fail, do.reset, *trace.whole()
    yield _row("after another run, fmi2GetReal returned error and fmi2Reset", trace, varied, SUMMED)


def beside(_: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run beside two other instances, which take turns with it."""

    def in_turns(one: Trace) -> list[Action]:
        return [*one.begin(), *chain(*((do.pause, *one.run(i, i + 1)) for i in range(len(one.legs))))]

    others = tuple((unread(*in_turns(one)),) for one in (other, trace))
    yield _row("beside two other instances", trace, in_turns(trace), beside=others)


def restored(probe: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run from a state that was set back after other legs."""
    yield from _from_a_state(probe, trace, other, (), _SLOT, "from a state that was set back")


def from_bytes(probe: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run from the bytes of a state."""
    copied = do.copy(_SLOT, _COPY), do.free_state(_SLOT)
    yield from _from_a_state(probe, trace, other, copied, _COPY, "from the bytes of a state")


def _from_a_state(
    probe: Probe, trace: Trace, other: Trace, copied: Sequence[Action], slot: int, when: str
) -> Iterator[Row]:
    part = len(trace.legs) // 2
    if part:
        leg = trace.legs[part - 1]
        first = *trace.begin(), *trace.run(0, part - 1), set_together(leg.sets), *map(do.advance, leg.sizes)
        away = unread(*other.run(0, part), do.read_all())
        back = do.restore(slot), do.read_all(), *trace.run(part)
        yield _row(when, trace, (*first, do.save(_SLOT), *copied, away, *back), SUMMED)
