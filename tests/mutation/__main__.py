"""Make mutants of the laws, the vehicle, the C layer and the master, and run the tests that should notice.

Run `python -m tests.mutation` in the project's root, with the extra `test` installed; it takes hours. What is
done is kept in the file of results; the same command goes on from there.
"""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import Queue
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from tests.mutation.mutants import Mutant, chosen, mutants_of
from tests.mutation.verdict import (
    SURVIVED,
    TIME_LIMIT,
    BrokenEnvironmentError,
    CollectedTests,
    check_killers,
    verdict,
)

_OF_THE_C_LAYER = (
    "small_block",
    "refusals",
    "states",
    "rare_calls",
    "lifecycle",
    "items",
    "calls",
    "importers",
)
# the folders that are mutated, and the tests that should notice: the first that fails ends the run
TESTS = {
    "controller_fmu": ["tests/controller_fmu", "tests/closed_loop", "tests/fmus/test_both_flavours.py"],
    "plant_fmu": ["tests/plant_fmu", "tests/closed_loop", "tests/fmus/test_both_flavours.py"],
    "fmus/native": [
        *(f"tests/fmus/export/test_native_{claim}.py" for claim in _OF_THE_C_LAYER),
        "tests/fmus/export/test_whole_numbers.py",
    ],
    "orchestration/master": ["tests/orchestration/master", "tests/orchestration/fmi", "tests/closed_loop"],
}
_SOURCES = (".py", ".c", ".h")
_TIMES_THE_BASELINE = 4.0  # after which the tests of a mutant are ended: it may never return


def main(
    rooms: Annotated[
        list[str] | None, typer.Argument(metavar="[FOLDER]...", help=f"Of {', '.join(TESTS)}.")
    ] = None,
    count: Annotated[int, typer.Option(help="Mutants a folder.", min=1)] = 110,
    seed: Annotated[int, typer.Option(help="Which mutants are drawn.")] = 1,
    workers: Annotated[int, typer.Option(help="Mutants at a time.", min=1)] = os.cpu_count() or 1,
    limit: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Longest time for a mutant; by default four times that without one.", min=1
        ),
    ] = None,
    results: Annotated[Path, typer.Option(help="File of results.")] = Path("mutation.json"),
) -> None:
    """Count the mutants that the tests notice, and list the others; `verdict.py` says what counts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background; tests send it
    verdicts: dict[str, str] = json.loads(results.read_text()) if results.exists() else {}
    with tempfile.TemporaryDirectory() as folder, Progress(console=Console(stderr=True)) as progress:
        copies = [_copy(Path(folder) / str(number) / "project") for number in range(workers)]
        for room in rooms or TESTS:
            bar = progress.add_task(f"{room}: the tests without a mutant", total=None)
            with ExitStack() as open_tests:
                try:
                    judges = [
                        (copy, open_tests.enter_context(CollectedTests(copy, TESTS[room]))) for copy in copies
                    ]
                    seconds = limit or _TIMES_THE_BASELINE * _baseline(room, judges)
                    drawn = _drawn(room, count, seed)
                    progress.update(bar, description=room, total=len(drawn))
                    for _ in _judged(drawn, judges, seconds, verdicts):
                        progress.advance(bar)
                        _write(verdicts, results)
                    check_killers(verdicts, room, judges[0][1], seconds)
                except BrokenEnvironmentError as error:
                    _write(verdicts, results)
                    raise SystemExit(f"{room}: {error}; what is done is kept in {results}") from error
    _print(verdicts)


def _judged(
    drawn: Sequence[Mutant],
    judges: Sequence[tuple[Path, CollectedTests]],
    seconds: float,
    verdicts: dict[str, str],
) -> Iterator[None]:
    """Judge the mutants that have no verdict, as many at a time as there are copies of the project."""
    free: Queue[tuple[Path, CollectedTests]] = Queue()
    for judge in judges:
        free.put(judge)

    def judge_one(mutant: Mutant) -> None:
        content = mutant.path.read_text()
        name = mutant.describe(content)
        if name not in verdicts:
            copy, tests = free.get()
            try:
                verdicts[name] = verdict(copy, mutant.path, mutant.source(content), tests, seconds)
            finally:
                free.put((copy, tests))

    with ThreadPoolExecutor(len(judges)) as pool:
        yield from pool.map(judge_one, drawn)


def _write(verdicts: dict[str, str], results: Path) -> None:
    results.write_text(json.dumps(dict(verdicts), indent=1))


def _copy(folder: Path) -> Path:
    """A copy of the project's files as they are here."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(os.path.isfile, listed.stdout.splitlines()):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(name, folder / name)
    return folder


def _drawn(room: str, count: int, seed: int) -> list[Mutant]:
    files = sorted(path for path in Path(room).rglob("*") if path.suffix in _SOURCES)
    return chosen([mutant for path in files for mutant in mutants_of(path, path.read_text())], count, seed)


def _baseline(room: str, judges: Sequence[tuple[Path, CollectedTests]]) -> float:
    """How long [s] the tests of a folder take without a mutant; the quickest files run first from then on."""
    (_, first), *others = judges
    start = time.monotonic()
    if test := first.first_failure():
        raise SystemExit(f"{room}: {test} fails without a mutant")
    for _, tests in others:
        tests.files = first.files
    return time.monotonic() - start


def _print(verdicts: dict[str, str]) -> None:
    table = Table("folder", "mutants", "killed", "of them by the time limit", "%")
    for room in TESTS:
        counts = Counter(outcome for name, outcome in verdicts.items() if name.startswith(room))
        total, killed = counts.total(), counts.total() - counts[SURVIVED]
        if total:
            numbers = (total, killed, counts[TIME_LIMIT], round(100 * killed / total))
            table.add_row(room, *map(str, numbers))
    console = Console()
    console.print(table)
    for name, outcome in verdicts.items():
        if outcome in (SURVIVED, TIME_LIMIT):
            console.print(f"{outcome}  {name}", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
