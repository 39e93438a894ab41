"""All measurements of the pages performance and scale, whose tables the site makes from a file that

    python -m tests.speed --before 7cf1486 --out docs/performance.json

writes. Run it in a clone of the repository, with the extra `test` installed, on a machine that does nothing
else.
"""

import os
import platform
import tempfile
import traceback
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Annotated

import typer

from orchestration import OrchestrationError
from tests.speed.parts import PARTS, Measure, Rows
from tests.speed.states import ROOT, State, state
from tests.speed.tables import MACHINE, Tables, markdown, write

_MANY = 10  # values, of which the half in the middle tells more than the extremes


def main(
    parts: Annotated[
        list[str] | None, typer.Argument(metavar=f"[{'|'.join(PARTS)}]...", help="All by default.")
    ] = None,
    before: Annotated[
        str | None, typer.Option(help="Compare with this git revision, or with another clone.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Show that all works, by one round of small sizes.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Replace the tables of this file. Needs all parts, and --before.",
            dir_okay=False,
            resolve_path=True,
        ),
    ] = None,
) -> None:
    """Measure how fast commands, runs, sweeps, steps and other importers are, as tables in Markdown.

    A part that fails leaves its tables as they are, and the exit status is 1.
    """
    if unknown := set(parts or []) - set(PARTS):
        raise typer.BadParameter(f"{', '.join(sorted(unknown))}: expected some of {', '.join(PARTS)}")
    if out and (parts or not before):
        raise typer.BadParameter("--out: expected all parts, and --before")
    if quick and out and out.is_relative_to(ROOT / "docs"):
        raise typer.BadParameter("--quick: expected a file outside docs/, as its figures are no measurement")
    with tempfile.TemporaryDirectory(prefix="l1-depth-speed-") as name:
        folder = Path(name)
        try:
            now = state(str(ROOT), folder / "now")
            # this clone beside itself, as .ci/run has it, builds and compiles everything once
            is_same = before and Path(before).is_dir() and now.sources.samefile(before)
            states = [now if is_same else state(before, folder / "before"), now] if before else [now]
        except OrchestrationError as error:
            raise typer.BadParameter(str(error)) from error
        tables, failed = measure(parts or [*PARTS], states, quick)
    if out:
        write(out, tables)
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


def measure(parts: Sequence[str], states: Sequence[State], quick: bool) -> tuple[Tables, list[str]]:
    """Returns the tables of parts, which are printed as well, and the names of parts that failed."""
    tables, failed = Tables({MACHINE: machine(states)}), list[str]()
    for part in parts:
        names, measures = PARTS[part]
        rows: Tables = {name: [] for name in names}
        try:
            for chosen in measures:
                if chosen.quick or not quick:
                    for table, own in measured(chosen, states, quick).items():
                        rows[table] += own
        except Exception:  # whatever it is, the other parts are measured
            traceback.print_exc()
            failed.append(part)
            continue
        tables |= rows
        for name in names:
            print(f"{name}:\n\n{markdown(rows[name])}", flush=True)
    return tables, failed


def measured(chosen: Measure, states: Sequence[State], quick: bool) -> dict[str, list[tuple[str, ...]]]:
    """Returns the rows of tables of a measure, from rounds in which the states take turns.

    What an earlier state cannot do is not measured there.
    """
    *earlier, now = states if chosen.compared else states[-1:]
    turns: list[list[Rows]] = []
    for _ in range(1 if quick else chosen.rounds + 1):
        new = chosen.read(now, quick)
        try:
            turns.append([new, *(chosen.read(before, quick) for before in earlier)])
        except OrchestrationError as error:
            print(f"not measured before: {error}")
            earlier, turns = [], [[new]]
    if not quick:
        del turns[0]  # what is built and compiled once was in it
    shared = bool(earlier) and earlier[0].sources.samefile(now.sources)
    return {
        table: [
            row_of(row, *([x[table][row] for x in own] for own in zip(*turns, strict=True)), shared=shared)
            for row in rows
        ]
        for table, rows in turns[0][0].items()
    }


def row_of(
    row: str, new: Sequence[float | str], old: Sequence[float | str] = (), shared: bool = False
) -> tuple[str, ...]:
    """Returns the cells of a row: of numbers, or of text that is the same or not.

    Raises OrchestrationError if the text of one state, which is before and now, is not the same.
    """
    what, _, goal = row.partition(" -> ")
    if all(isinstance(x, str) for x in new):
        is_equal = len({*new, *old}) == 1
        if shared and not is_equal:
            raise OrchestrationError(f"{row}: results of one state differ: expected equal bit for bit")
        return what, goal, "", "", ("equal bit for bit" if is_equal else "different") if old else ""
    before, now = ([float(x) for x in values] for values in (old, new))
    ratios = [a / b for a, b in zip(now, before, strict=True)] if before and all(before) else []
    return what, goal, *(spread(values) if values else "" for values in (before, now, ratios))


def spread(values: Sequence[float]) -> str:
    """Returns the median, and in brackets the least and the largest, or of many the half in the middle."""
    ordered = sorted(values)
    cut = len(ordered) // 4 if len(ordered) > _MANY else 0
    least, middle, most = (
        f"{x:.0f}" if abs(x) >= 100.0 else f"{x:.3g}"
        for x in (ordered[cut], median(ordered), ordered[-1 - cut])
    )
    return middle if len(values) == 1 else f"{middle} ({least} to {most})"


def machine(states: Sequence[State]) -> list[Sequence[str]]:
    """Returns the rows of what the figures depend on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    used = ("numpy", "matplotlib", "ziglang", "dask")
    return [
        ("date", date.today().isoformat()),
        ("processor", f"{(names or [platform.processor()])[0]}, {os.cpu_count()} cores"),
        ("system", f"{platform.system()} {platform.release()}, {platform.machine()}"),
        ("Python", platform.python_version()),
        ("packages", ", ".join(f"{name} {version(name)}" for name in used)),
        ("now", states[-1].revision),
        *(("before", before.revision) for before in states[:-1]),
    ]


if __name__ == "__main__":
    typer.run(main)
