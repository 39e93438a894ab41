"""What was measured, as tables with the ratios that matter."""

import os
import platform
from collections.abc import Sequence

from rich.table import Table

from tests.speed.importers import Entry
from tests.speed.layers import Layer
from tests.speed.scenarios import Loop


def tables(layers: Sequence[Layer], loops: Sequence[Loop], entries: Sequence[Entry]) -> list[Table]:
    """One of each kind."""
    return [_steps(layers), _runs(loops), _importers(entries)]


def machine() -> str:
    """What was measured on, for the record."""
    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return f"{system}, Python {platform.python_version()}"


def _steps(layers: Sequence[Layer]) -> Table:
    table = _table("One communication step", ("Block",), ("ns by FMI", "ns in bare C", "ratio"))
    for each in layers:
        fmi, bare = each.through_fmi, each.bare
        table.add_row(each.block, f"{1e9 * fmi:.0f}", f"{1e9 * bare:.0f}", f"{fmi / bare:.2f}")
    return table


def _runs(loops: Sequence[Loop]) -> Table:
    table = _table(
        "A whole scenario", ("Scenario", "How"), ("ms", "us a step", "of python", "of one C program")
    )
    for each in loops:
        for how, seconds in each.ways.items():
            per_step, speed = 1e6 * seconds / each.steps, each.master_python / seconds
            table.add_row(
                each.scenario,
                how,
                f"{1e3 * seconds:.2f}",
                f"{per_step:.2f}",
                f"1/{speed:.0f}",
                f"{seconds / each.monolith:.2f}",
            )
        table.add_section()
    return table


def _importers(entries: Sequence[Entry]) -> Table:
    """Fastest first, those that did not run last."""
    title = "Two FMUs, one signal each way: a communication step"
    table = _table(title, ("Importer", "Version"), ("us", "us overhead", "times the FMUs"), ("Remark",))
    for each in sorted(entries, key=lambda entry: (bool(entry.problem), entry.per_step)):
        if each.problem:
            table.add_row(each.name, each.version, "", "", "", each.problem)
        else:
            table.add_row(
                each.name,
                each.version,
                f"{1e6 * each.per_step:.3f}",
                f"{1e6 * each.overhead:.3f}",
                f"{each.ratio:.1f}",
                each.remark,
            )
    return table


def _table(title: str, texts: Sequence[str], numbers: Sequence[str], remarks: Sequence[str] = ()) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in (*texts, *numbers, *remarks):
        table.add_column(heading, justify="right" if heading in numbers else "left", overflow="fold")
    return table
