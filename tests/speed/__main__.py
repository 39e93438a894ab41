"""All measurements of docs/performance.md and docs/explanation/scale.md, whose tables are replaced by

    python -m tests.speed --before 7cf1486 --page docs/performance.md --page docs/explanation/scale.md

Run it in a clone of the repository, with the extra `test` installed, on a machine that does nothing else.
"""

import os
import platform
import tempfile
import traceback
from collections.abc import Callable
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from orchestration.errors import OrchestrationError
from tests.speed import commands, ensemble, importers, memory, runs, samples, scale, stepping, steps, sweeps
from tests.speed.loops import LOOPS
from tests.speed.page import check_places, replace_tables
from tests.speed.part import Goal, Options, Part, Table
from tests.speed.states import ROOT, state

# part -> what measures it, and the names of its tables
PARTS: dict[str, tuple[Callable[[Options], Part], tuple[str, ...]]] = {
    "commands": (commands.measure, ("commands",)),
    "steps": (steps.measure, ("fmi", "steps")),
    "runs": (runs.measure, ("runs", "ways")),
    "sweeps": (sweeps.measure, ("sweeps", "million")),
    "ensemble": (ensemble.measure, ("ensemble",)),
    "scale": (scale.measure, ("chains", "slopes", "thousand", "threads")),
    "memory": (memory.measure, ("memory",)),
    "samples": (samples.measure, ("samples",)),
    "stepping": (stepping.measure, ("calls", "environments")),
    "importers": (importers.measure, ("importers",)),
}
_SUMMARY = ("machine", "goals")


def main(
    parts: Annotated[
        list[str] | None, typer.Argument(metavar=f"[{'|'.join(PARTS)}]...", help="All by default.")
    ] = None,
    before: Annotated[
        str | None, typer.Option(help="Compare with this git revision, or with another clone.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Show that all works, by one round of small sizes.")] = False,
    page: Annotated[
        list[Path] | None,
        typer.Option(
            help="Replace the tables of this page; repeatable. Needs all parts, --before, and all pages.",
            exists=True,
            dir_okay=False,
            resolve_path=True,
        ),
    ] = None,
) -> None:
    """Measure how fast commands, runs, sweeps, steps and other importers are, as tables in Markdown.

    A part that fails leaves its tables as they are, and the exit status is 1.
    """
    pages = page or []
    if unknown := set(parts or []) - set(PARTS):
        raise typer.BadParameter(f"{', '.join(sorted(unknown))}: expected some of {', '.join(PARTS)}")
    if pages and (parts or not before):
        raise typer.BadParameter("--page: expected all parts, and --before")
    if quick and any(path.is_relative_to(ROOT / "docs") for path in pages):
        raise typer.BadParameter("--quick: expected copies of the pages, as its figures are no measurement")
    with tempfile.TemporaryDirectory(prefix="l1-depth-speed-") as name:
        folder = Path(name)
        try:
            if pages:
                check_places(pages, [*_SUMMARY, *(table for _, tables in PARTS.values() for table in tables)])
            now = state(str(ROOT), folder / "now")
            options = Options(folder, now, state(before, folder / "before") if before else None, quick)
        except OrchestrationError as error:
            raise typer.BadParameter(str(error)) from error
        tables, failed = measure(parts or [*PARTS], options)
    replace_tables(pages, tables)
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


def measure(parts: list[str], options: Options) -> tuple[list[Table], list[str]]:
    """The tables of parts and a summary, which are printed as well, and the names of parts that failed."""
    tables, goals, failed = list[Table](), list[Goal](), list[str]()
    for part in parts:
        try:
            measured = PARTS[part][0](options)
        except Exception:  # whatever it is, the other parts are measured
            traceback.print_exc()
            failed.append(part)
            goals.append(Goal(f"`{part}`", "", "failed"))
            continue
        print(*map(_text, measured.tables), sep="\n", flush=True)
        tables += measured.tables
        goals += measured.goals
    summary = [machine(options), of_goals(goals, bool(options.before))]
    print(*map(_text, summary), sep="\n", flush=True)
    return [*summary, *tables], failed


def _text(table: Table) -> str:
    return f"{table.name}:\n\n{table.markdown}"


def of_goals(goals: list[Goal], compared: bool) -> Table:
    missing = "not measured" if compared else ""
    rows = [(goal.what, goal.target, goal.before or missing, goal.now, goal.others) for goal in goals]
    return Table("goals", ("what", "target", "before", "now", "others"), rows)


def machine(options: Options) -> Table:
    """What the figures depend on."""
    peers = sorted({loop.distribution for loop in LOOPS.values()} - {"l1-depth"})
    used = ("numpy", "matplotlib", "ziglang", "dask", *peers)
    rows = [
        ("date", date.today().isoformat()),
        ("processor", f"{processor()}, {os.cpu_count()} cores"),
        ("system", f"{platform.system()} {platform.release()}, {platform.machine()}"),
        ("Python", platform.python_version()),
        ("packages", ", ".join(f"{name} {version(name)}" for name in used)),
        ("now", options.now.revision),
    ]
    before = [("before", options.before.revision)] if options.before else []
    return Table("machine", ("", ""), [*rows, *before])


def processor() -> str:
    """Its name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


if __name__ == "__main__":
    typer.run(main)
