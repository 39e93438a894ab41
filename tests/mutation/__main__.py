"""Make mutants of the laws, the vehicle, the C layer and the master, and run the tests that should notice.

Run `python -m tests.mutation` in the project's root, with the extra `test` installed; it takes hours. What is
done is kept in the file of results; the same command goes on from there.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from tests.mutation.mutants import Mutant, chosen, mutants_of

_OF_THE_C_LAYER = ("refusals", "lifecycle", "states", "calls", "rare_calls", "small_block", "importers")
# the folders that are mutated, and the tests that should notice: the first that fails ends the run
TESTS = {
    "controller_fmu": ["tests/controller_fmu", "tests/closed_loop", "tests/fmus/test_both_flavours.py"],
    "plant_fmu": ["tests/plant_fmu", "tests/closed_loop", "tests/fmus/test_both_flavours.py"],
    "fmus/native": [f"tests/fmus/export/test_native_{claim}.py" for claim in _OF_THE_C_LAYER],
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
    results: Annotated[Path, typer.Option(help="File of results.")] = Path("mutation.json"),
) -> None:
    """Count the mutants that the tests notice, and list the others."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background; tests send it
    verdicts: dict[str, str] = json.loads(results.read_text()) if results.exists() else {}
    copies: Queue[Path] = Queue()
    with tempfile.TemporaryDirectory() as folder, Progress(console=Console(stderr=True)) as progress:
        for number in range(workers):
            copies.put(_copy(Path(folder) / str(number)))
        for room in rooms or TESTS:
            bar = progress.add_task(f"{room}: the tests without a mutant", total=None)
            limit = _TIMES_THE_BASELINE * _baseline(room, copies)
            drawn = _drawn(room, count, seed)
            progress.update(bar, description=room, total=len(drawn))

            def judge(mutant: Mutant, room: str = room, limit: float = limit) -> tuple[str, str]:
                content = mutant.path.read_text()
                name = mutant.describe(content)
                if name not in verdicts:
                    copy = copies.get()
                    (copy / mutant.path).write_text(mutant.source(content))
                    verdicts[name] = _verdict(copy, room, limit)
                    (copy / mutant.path).write_text(content)
                    copies.put(copy)
                return name, verdicts[name]

            with ThreadPoolExecutor(workers) as pool:
                for _ in pool.map(judge, drawn):
                    progress.advance(bar)
                    results.write_text(json.dumps(dict(verdicts), indent=1))
    _print(verdicts)


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


def _baseline(room: str, copies: Queue[Path]) -> float:
    """How long [s] the tests of a folder take without a mutant."""
    copy, start = copies.get(), time.monotonic()
    if _verdict(copy, room, None) != "survived":
        raise SystemExit(f"{room}: its tests fail without a mutant")
    copies.put(copy)
    return time.monotonic() - start


def _verdict(copy: Path, room: str, limit: float | None) -> str:
    """What becomes of a mutant: killed, timeout or survived."""
    # the tests that noticed the mutants before it come first
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--failed-first", "-n", "0", *TESTS[room]]
    process = subprocess.Popen(
        command,
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        return "killed" if process.wait(limit) else "survived"
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _print(verdicts: dict[str, str]) -> None:
    table = Table("folder", "mutants", "killed", "%")
    for room in TESTS:
        counts = Counter(verdict for name, verdict in verdicts.items() if name.startswith(room))
        killed = counts.total() - counts["survived"]
        if counts:
            table.add_row(room, str(counts.total()), str(killed), f"{100 * killed / counts.total():.0f}")
    console = Console()
    console.print(table)
    for name, verdict in verdicts.items():
        if verdict == "survived":
            console.print(f"survived  {name}", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
