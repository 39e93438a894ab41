"""Memory and time of sweeps that grow.

The shipped Monte Carlo over 5 s, so that a sample takes about a millisecond, by the command line in a
process of its own: what all of it holds at most, and its CPU time. Sweeps of fewer samples are run with
simulators alone too (`--no-ensemble`). The last sweep is interrupted when half of its samples are done, and
continued.
"""

import os
import signal
import time
from pathlib import Path

import pyarrow.parquet as pq

from fmus.lanes import LANES
from tests.speed.part import Goal, Options, Part, Table
from tests.speed.states import COMMAND, State

_NUMBERS = (1_000, 10_000, 100_000)
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
_Cost = tuple[float, float, float]


class Sweep:
    """A sweep of so many samples by the command line, in a folder."""

    def __init__(self, state: State, samples: int, folder: Path, *options: str) -> None:
        self.state, self.folder, self.options = state, folder, options
        folder.mkdir(parents=True)
        self.file = folder / "many.toml"
        self.file.write_text(_SCENARIO.format(samples), encoding="utf-8")

    def run(self, until: int | None = None) -> _Cost:
        """(peak memory [bytes] of its largest process, CPU [s] and wall clock [s]) of the command.

        until: samples after which it is interrupted
        """
        start = time.perf_counter()
        command = [*COMMAND, "sweep", self.file, "--out", self.folder, *self.options]
        process = self.state.start("launch.py", *command, new_session=True)
        while until and self._done() < until and process.poll() is None:
            time.sleep(0.1)
        if until:
            os.killpg(process.pid, signal.SIGINT)
        output, _ = process.communicate()
        memory, cpu_s, status = map(float, output.split())
        if status not in (0, 130 if until else 0):
            raise RuntimeError(f"the sweep ended with status {status:.0f}")
        return memory, cpu_s, time.perf_counter() - start

    def _done(self) -> int:
        logs = list(self.folder.glob("*.sweep.jsonl"))
        return logs[0].read_bytes().count(b"\n") if logs else 0

    @property
    def table(self) -> Path:
        return next(self.folder.glob("*.parquet"))


def measure(options: Options) -> Part:
    """Sweeps of growing numbers of samples."""
    state, folder = options.now, options.folder / "samples"
    numbers = (100, 200) if options.quick else _NUMBERS
    Sweep(state, LANES, folder / "first", "--ensemble").run()  # which compiles what the others need
    rows, costs, last = [], [], None
    for count in numbers:
        last = Sweep(state, count, folder / str(count), "--ensemble")
        costs.append(last.run())
        rows.append(_row(f"{count} samples", costs[-1]))
        if count <= _MOST_ALONE:
            alone = Sweep(state, count, folder / f"{count}-alone", "--no-ensemble")
            rows.append(_row(f"{count} samples, by simulators", alone.run()))
    continued = Sweep(state, numbers[-1], folder / "continued", "--ensemble")
    half = continued.run(until=numbers[-1] // 2)
    rows.append(_row(f"{numbers[-1]} samples, interrupted at the half", half))
    rows.append(_row("continued", continued.run()))
    assert last
    first, second = (pq.read_table(sweep.table).to_pandas() for sweep in (last, continued))
    equal = "equal" if first.equals(second) else "different"  # where NaN equals NaN
    rows.append((f"its table beside that of the sweep that was not interrupted: {equal}", "", "", ""))
    least, most = (f"{cost[0] / 1e6:.0f} MB" for cost in (costs[0], costs[-1]))
    goal = Goal(f"{numbers[-1]} samples: peak memory", "flat", f"{most}; {numbers[0]} samples {least}")
    headings = ("a sweep of", "peak memory of its largest process", "CPU", "on the clock")
    return Part([Table("samples", headings, rows)], [goal])


def _row(what: str, cost: _Cost) -> tuple[str, ...]:
    memory, cpu_s, wall_s = cost
    return what, f"{memory / 1e6:.0f} MB", f"{cpu_s:.1f} s", f"{wall_s:.1f} s"
