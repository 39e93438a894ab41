"""Memory of a long recording, beside its raw size: `python -m tests.speed.memory`.

A process of its own for each way: what it holds at most, less what it held before the run.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from orchestration.master import simulate
from tests.speed.pair import Pair, build

WAYS = ("run", "parquet", "csv")


def peak(two: Pair, points: int, way: str) -> tuple[float, float]:
    """(peak memory, raw size) [bytes] of a run of two small FMUs with one output each, written that way."""
    simulate(two.system, two.experiment(1000)).write(two.folder / "short.parquet")  # what is imported once
    before = _most()
    recording = simulate(two.system, two.experiment(points - 1))
    if way != "run":
        recording.write(two.folder / f"long.{way}")
    return _most() - before, recording.values.nbytes + recording.time.nbytes


def _most() -> float:
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main(
    points: Annotated[int, typer.Option(help="Communication points.")] = 10_000_000,
    way: Annotated[str, typer.Option(help="One of them alone, in this process.")] = "",
    folder: Annotated[Path, typer.Option(help="Of its FMUs.")] = Path(),
) -> None:
    """Measure each way in a process of its own."""
    if way:
        most, raw = peak(Pair(folder), points, way)
        print(f"{way:8} of {points} points: {most / 1e6:.0f} MB, {most / raw:.2f} of {raw / 1e6:.0f} MB raw")
        return
    with tempfile.TemporaryDirectory() as name:
        build(Path(name))
        for one in WAYS:
            options = ["--points", str(points), "--way", one, "--folder", name]
            subprocess.run([sys.executable, "-m", "tests.speed.memory", *options], check=True)


if __name__ == "__main__":
    typer.run(main)
