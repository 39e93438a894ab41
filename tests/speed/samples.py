"""Memory and time of sweeps that grow: `python -m tests.speed.samples`.

The shipped Monte Carlo over 5 s, so that a sample takes about a millisecond, by the command line in a
process of its own: what all of it holds at most, and its CPU time. Sweeps of at most 10,000 samples are run
with simulators alone too (`--no-ensemble`), as all were before samples stepped together. The last sweep is
interrupted when half of its samples are done, and continued.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import pyarrow.parquet as pq
import typer

from fmus import catalogue
from orchestration.scenarios import scenario

_ROOT = Path(__file__).parents[2]
_COMMAND = [sys.executable, "-P", "-c", "from orchestration.cli import main; main()", "sweep"]
_MOST_ALONE = 10_000
_SCENARIO = """
base = "monte-carlo"
[experiment]
stop_time = 5.0
[metrics]
holding_thrust = false
lag = false
[sweep]
samples = {}
"""


class Sweep:
    """A sweep of so many samples by the command line, in a folder."""

    def __init__(self, samples: int, folder: Path, *options: str) -> None:
        self.folder, self.options = folder, options
        folder.mkdir()
        self.file = folder / "many.toml"
        self.file.write_text(_SCENARIO.format(samples), encoding="utf-8")

    def run(self, until: int | None = None) -> tuple[float, float, float]:
        """(peak memory [bytes] of its largest process, CPU [s] and wall clock [s]) of the command.

        until: samples after which it is interrupted
        """
        environment = {**os.environ, "PYTHONPATH": str(_ROOT)}
        start = time.perf_counter()
        process = subprocess.Popen(
            [*_COMMAND, str(self.file), "--out", str(self.folder), *self.options],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        while until and self._done() < until and process.poll() is None:
            time.sleep(0.1)
        if until:
            process.send_signal(signal.SIGINT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 130 if until else 0):
            raise RuntimeError(f"the sweep ended with status {process.returncode}")
        return 1024.0 * used.ru_maxrss, used.ru_utime + used.ru_stime, time.perf_counter() - start

    def _done(self) -> int:
        logs = list(self.folder.glob("*.sweep.jsonl"))
        return logs[0].read_bytes().count(b"\n") if logs else 0


def main(
    samples: Annotated[list[int] | None, typer.Argument(help="Numbers of samples.")] = None,
) -> None:
    """Measure sweeps of so many samples."""
    catalogue.build_missing([*scenario.load(scenario.find("monte-carlo")).system.components.values()])
    numbers = samples or [1_000, 10_000, 100_000]
    with tempfile.TemporaryDirectory(prefix="l1-depth-speed-") as name:
        folder = Path(name)
        for count in numbers:
            _print(f"{count} samples", Sweep(count, folder / str(count), "--ensemble").run())
            if count <= _MOST_ALONE:
                alone = Sweep(count, folder / f"{count}-alone", "--no-ensemble")
                _print(f"{count} samples, simulators", alone.run())
        last = Sweep(numbers[-1], folder / "continued", "--ensemble")
        _print(f"half of {numbers[-1]}, interrupted", last.run(until=numbers[-1] // 2))
        _print("continued", last.run())
        tables = [next((folder / str(part)).glob("*.parquet")) for part in (numbers[-1], "continued")]
        first, second = (pq.read_table(table).to_pandas() for table in tables)  # where NaN equals NaN
        equal = first.equals(second)
        print(f"both tables are {'equal' if equal else 'different'}: {tables[0].stat().st_size / 1e6:.1f} MB")


def _print(what: str, measured: tuple[float, float, float]) -> None:
    memory, cpu_s, wall_s = measured
    print(f"{what}: {memory / 1e6:.0f} MB, CPU {cpu_s:.1f} s, {wall_s:.1f} s", flush=True)


if __name__ == "__main__":
    typer.run(main)
