"""Make mutants of the laws, the vehicle, the C layer and the master, and run the tests that should notice.

Run `python -m tests.mutation` in the project's root, with the extra `test` installed; it takes an hour or so.
What is done is kept in the file of results; the same command goes on from there.
"""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
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

from tests.mutation.collected import BrokenEnvironmentError, CollectedTests
from tests.mutation.mutants import Mutant, chosen, mutants_of
from tests.mutation.verdict import KILLED_BY, SAME_CODE, SURVIVED, TIME_LIMIT, Judge, check_killers

_OF_THE_C_LAYER = (
    "steps",
    "derivatives",
    "forged_states",
    "numbers",
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
        "tests/fmus/export/test_reals_only.py",
    ],
    "orchestration/master": ["tests/orchestration/master", "tests/orchestration/fmi", "tests/closed_loop"],
}
_SOURCES = (".py", ".c", ".h")
_RECENT_S = 2.5  # after which a file that was copied counts as one that nobody changes


def main(
    rooms: Annotated[
        list[str] | None, typer.Argument(metavar="[FOLDER]...", help=f"Of {', '.join(TESTS)}.")
    ] = None,
    count: Annotated[int, typer.Option(help="Mutants a folder.", min=1)] = 110,
    seed: Annotated[int, typer.Option(help="Which mutants are drawn.")] = 1,
    workers: Annotated[int, typer.Option(help="Mutants at a time.", min=1)] = os.cpu_count() or 1,
    budget: Annotated[
        float, typer.Option(metavar="S", help="CPU time of the tests that a mutant may meet.", min=1)
    ] = 60.0,
    results: Annotated[Path, typer.Option(help="File of results.")] = Path("mutation.json"),
) -> None:
    """Count the mutants that the tests notice, and list the others; `verdict.py` says what counts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background; tests send it
    verdicts: dict[str, str] = json.loads(results.read_text()) if results.exists() else {}
    with tempfile.TemporaryDirectory() as folder, Progress(console=Console(stderr=True)) as progress:
        copies = [_copy(Path(folder) / str(number) / "project") for number in range(workers)]
        time.sleep(_RECENT_S)
        for room in rooms or TESTS:
            bar = progress.add_task(f"{room}: the tests without a mutant", total=None)
            with ExitStack() as open_tests, ThreadPoolExecutor(workers) as pool:
                try:
                    collected = [
                        open_tests.enter_context(CollectedTests(copy, TESTS[room])) for copy in copies
                    ]
                    measured, *_ = pool.map(CollectedTests.measured, collected, [room] * workers)
                    drawn = _drawn(room, count, seed)
                    progress.update(bar, description=room, total=len(drawn))
                    for _ in _judged(drawn, collected, Judge(measured, budget), verdicts, pool):
                        progress.advance(bar)
                        _write(verdicts, results)
                    check_killers(verdicts, room, collected[0], measured)
                except BrokenEnvironmentError as error:
                    _write(verdicts, results)
                    raise SystemExit(f"{room}: {error}; what is done is kept in {results}") from error
    _print(verdicts)


def _judged(
    drawn: Sequence[Mutant],
    collected: Sequence[CollectedTests],
    judge: Judge,
    verdicts: dict[str, str],
    pool: ThreadPoolExecutor,
) -> Iterator[None]:
    """Judge the mutants that have no verdict, as many at a time as there are copies of the project."""
    free: Queue[CollectedTests] = Queue()
    for tests in collected:
        free.put(tests)

    def judge_one(mutant: Mutant) -> None:
        name = mutant.describe(mutant.path.read_text())
        if name not in verdicts:
            tests = free.get()
            try:
                verdicts[name] = judge.verdict(mutant, tests)
            finally:
                free.put(tests)

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


def _print(verdicts: dict[str, str]) -> None:
    table = Table("folder", "mutants", "the same machine code", "killed", "of them without end", "%")
    for room in TESTS:
        outcomes = [outcome for name, outcome in verdicts.items() if name.startswith(room)]
        same, survived, endless = (
            sum(outcome.startswith(kind) for outcome in outcomes)
            for kind in (SAME_CODE, SURVIVED, TIME_LIMIT)
        )
        if judged := len(outcomes) - same:
            killed = judged - survived
            numbers = len(outcomes), same, killed, endless, round(100 * killed / judged)
            table.add_row(room, *map(str, numbers))
    console = Console()
    console.print(table)
    for name, outcome in sorted(verdicts.items()):
        if not outcome.startswith(KILLED_BY):
            console.print(f"{outcome}  {name}", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
