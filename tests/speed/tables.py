"""What was measured, as tables with the ratios that matter."""

from collections.abc import Iterable, Sequence

from rich.table import Table

from tests.speed.importers import Entry
from tests.speed.layers import Layer
from tests.speed.scenarios import MONOLITH, PYTHON, Loop

_NUMBERS = {
    "ns by FMI",
    "ns in bare C",
    "ratio",
    "ms",
    "us a step",
    "of python",
    "of one C program",
    "ns a step more",
    "us",
}
_NUMBERS |= {"us overhead", "times the FMUs"}


def tables(layers: Sequence[Layer], loops: Sequence[Loop], entries: Sequence[Entry]) -> list[Table]:
    """One of each kind."""
    title = "Two FMUs, one signal each way: a communication step"
    headings = ("Importer", "Version", "us", "us overhead", "times the FMUs", "Remark")
    return [
        _table("One communication step", ("Block", "ns by FMI", "ns in bare C", "ratio"), map(_step, layers)),
        _table(
            "A whole scenario",
            ("Scenario", "How", "ms", "us a step", "of python", "of one C program", "ns a step more"),
            (row for loop in loops for row in _ways(loop)),
        ),
        _table(title, headings, map(_importer, sorted(entries, key=lambda e: (bool(e.problem), e.per_step)))),
    ]


def _step(layer: Layer) -> tuple[str, ...]:
    fmi, bare = layer.through_fmi, layer.bare
    return layer.block, f"{1e9 * fmi:.0f}", f"{1e9 * bare:.0f}", f"{fmi / bare:.2f}"


def _ways(loop: Loop) -> Iterable[tuple[str, ...]]:
    for way, seconds in loop.seconds.items():
        speed, ratio = loop.seconds[PYTHON] / seconds, seconds / loop.seconds[MONOLITH]
        times = f"{1e3 * seconds:.2f}", f"{1e6 * seconds / loop.steps:.2f}"
        more = 1e9 * (seconds - loop.seconds[MONOLITH]) / loop.steps
        yield loop.scenario, way, *times, f"1/{speed:.0f}", f"{ratio:.2f}", f"{more:.0f}"


def _importer(entry: Entry) -> tuple[str, ...]:
    if entry.problem:
        return entry.name, entry.version, "", "", "", entry.problem
    times = f"{1e6 * entry.per_step:.3f}", f"{1e6 * entry.overhead:.3f}", f"{entry.ratio:.1f}"
    return entry.name, entry.version, *times, entry.remark


def _table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="right" if heading in _NUMBERS else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
