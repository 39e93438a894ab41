"""All measurements of docs/performance.md and docs/explanation/scale.md, whose tables are replaced by

    python -m tests.speed --before 7cf1486 --page docs/performance.md --page docs/explanation/scale.md

Run it in a clone of the repository, with the extra `test` installed, on a machine that does nothing else.
"""

import os
import platform
import subprocess
import tempfile
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from tests.speed import commands, ensemble, importers, memory, runs, samples, scale, stepping, steps, sweeps
from tests.speed.loops import LOOPS
from tests.speed.page import replace_tables
from tests.speed.part import Goal, Options, Table
from tests.speed.states import ROOT, state

PARTS = {
    "commands": commands.measure,
    "steps": steps.measure,
    "runs": runs.measure,
    "sweeps": sweeps.measure,
    "ensemble": ensemble.measure,
    "scale": scale.measure,
    "memory": memory.measure,
    "samples": samples.measure,
    "stepping": stepping.measure,
    "importers": importers.measure,
}


def main(
    parts: Annotated[
        list[str] | None, typer.Argument(metavar=f"[{'|'.join(PARTS)}]...", help="All by default.")
    ] = None,
    before: Annotated[
        str | None, typer.Option(help="Compare with this git revision, or with another clone.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Show that all works, by one round of small sizes.")] = False,
    page: Annotated[
        list[Path] | None, typer.Option(help="Replace the tables of this page; repeatable.")
    ] = None,
) -> None:
    """Measure how fast commands, runs, sweeps, steps and other importers are, as tables in Markdown."""
    chosen = parts or [*PARTS]
    if unknown := set(chosen) - set(PARTS):
        raise typer.BadParameter(f"{', '.join(sorted(unknown))}: expected some of {', '.join(PARTS)}")
    if page and (parts or not before):
        raise typer.BadParameter("--page: expected all parts, and --before")
    tables: list[Table] = []
    goals: list[Goal] = []
    with tempfile.TemporaryDirectory(prefix="l1-depth-speed-") as name:
        folder = Path(name)
        now = state(str(ROOT), folder / "now")
        options = Options(folder, now, state(before, folder / "before") if before else None, quick)
        for part in chosen:
            measured = PARTS[part](options)
            for table in measured.tables:
                print(f"{table.name}:\n\n{table.markdown}", flush=True)
            tables += measured.tables
            goals += measured.goals
    summary = [machine(before), of_goals(goals)]
    for table in summary:
        print(f"{table.name}:\n\n{table.markdown}", flush=True)
    if page:
        replace_tables(page, [*summary, *tables])


def of_goals(goals: list[Goal]) -> Table:
    rows = [(goal.what, goal.target, goal.before, goal.now, goal.others) for goal in goals]
    return Table("goals", ("what", "target", "before", "now", "others"), rows)


def machine(before: str | None) -> Table:
    """What the figures depend on."""
    peers = sorted({loop.distribution for loop in LOOPS.values()} - {"l1-depth"})
    used = ("numpy", "matplotlib", "ziglang", "dask", *peers)
    rows = [
        ("date", date.today().isoformat()),
        ("processor", f"{processor()}, {os.cpu_count()} cores"),
        ("system", f"{platform.system()} {platform.release()}, {platform.machine()}"),
        ("Python", platform.python_version()),
        ("packages", ", ".join(f"{name} {version(name)}" for name in used)),
        ("now", revision("HEAD")),
    ]
    return Table("machine", ("", ""), [*rows, *([("before", revision(before))] if before else [])])


def processor() -> str:
    """Its name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def revision(name: str) -> str:
    """A git revision with its date, or the name itself."""
    command = ["git", "-C", str(ROOT), "show", "--no-patch", "--format=%h of %cs", name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or name


if __name__ == "__main__":
    typer.run(main)
