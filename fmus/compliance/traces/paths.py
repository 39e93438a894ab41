"""Paths that must agree: the same trace in other ways, each a row of the rule whose sentence it breaks."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row
from fmus.compliance.probe import Probe
from fmus.compliance.script import Action, Script
from fmus.compliance.traces.generator import Trace, traces
from fmus.compliance.traces.table import TABLES

_SLOT, _COPY = 0, 1  # of saved states
_SUMMED = 1e-3  # relative: some dozen steps of a solver that begins elsewhere sum up their errors
Path = Callable[[Probe, Trace, Trace], Iterator[Row]]


def rows(probe: Probe, path: Path) -> Iterator[Row]:
    """Yields the rows of a path, given each random trace and another one."""
    some = traces(probe)
    for trace, other in zip(some, [*some[1:], *some[:1]], strict=True):
        yield from path(probe, trace, other)


def _row(when: str, trace: Trace, varied: Sequence[Action], tolerance: float = 0.0, **more: Any) -> Row:
    return Row(when, tuple(varied), trace.whole(), tolerance=tolerance, **more)


def again(_: Probe, trace: Trace, __: Trace) -> Iterator[Row]:
    """Yields the same run, with logging."""
    yield _row("with logging", trace, trace.whole())


def asked(probe: Probe, trace: Trace, _: Trace) -> Iterator[Row]:
    """Yields a run with all questions that the states allow."""
    table = TABLES[probe.fmu.interface]
    saved = (do.save(_SLOT), do.free_state(_SLOT)) if probe.fmu.claims("canGetAndSetFMUstate") else ()

    def questions(state: str) -> list[Action]:
        return [*chain(*(calls(probe, state) for states, calls in table.questions if state in states))]

    stepping = *saved, *questions(table.stepping)
    legs = chain(*((*trace.run(i, i + 1), *stepping) for i in range(len(trace.legs))))
    yield _row(
        "where values and derivatives are read more often",
        trace,
        (*trace.begin(), *stepping, *legs),
        _SUMMED,
        may_fail=True,
    )


def set_otherwise(probe: Probe, trace: Trace, _: Trace) -> Iterator[Row]:
    """Yields a run in which values are set together, in another order."""

    def together(pairs: Sequence[do.Pair]) -> Action:
        return lambda script: script.write(do.set_at_once(pairs[::-1]))

    yield _row("where values were set together, in another order", trace, trace.whole(together))


def set_twice(probe: Probe, trace: Trace, _: Trace) -> Iterator[Row]:
    """Yields a run in which each value is set twice, at first to its start value."""

    def twice(pairs: Sequence[do.Pair]) -> Action:
        starts = values.start_values(v for v, _ in pairs)
        return lambda script: script.write([do.set_values(starts), do.set_values(pairs)])

    if not probe.fmu.is_model_exchange:
        yield _row("where values were set twice at a time", trace, trace.whole(twice), values.RESTARTED)


def unread(actions: Iterable[Action]) -> Action:
    """Returns actions whose readings are not compared, and whose failure is ignored."""

    def action(script: Script) -> None:
        count = len(script.observed)
        script.write([do.ignore(*actions)])
        del script.observed[count:]

    return action


def after_reset(_: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run after another one and fmi2Reset."""
    yield _row(
        "after another run and fmi2Reset",
        trace,
        (unread(other.whole()), do.reset, *trace.whole()),
        _SUMMED,
    )


def beside(_: Probe, trace: Trace, other: Trace) -> Iterator[Row]:
    """Yields a run beside two other instances, which take turns with it."""

    def in_turns(one: Trace) -> list[Action]:
        return [*one.begin(), *chain(*((do.pause, *one.run(i, i + 1)) for i in range(len(one.legs))))]

    others = tuple((unread(in_turns(one)),) for one in (other, trace))
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
        first = *trace.begin(), *trace.run(0, part - 1), do.set_values(leg.sets), *map(do.advance, leg.sizes)
        away = unread([*other.run(0, part), do.read_all()])
        back = do.restore(slot), do.read_all(), *trace.run(part)
        yield _row(when, trace, (*first, do.save(_SLOT), *copied, away, *back), _SUMMED)
