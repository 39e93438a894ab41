"""Memory and time of sweeps that grow.

The shipped Monte Carlo over 5 s, so that a sample takes about a millisecond, by the command line in a
process of its own: what all of it holds at most, and its CPU time. Sweeps of fewer samples are run with
simulators alone too (`--no-ensemble`). The last sweep is interrupted when half of its samples are done, and
continued; its table must be that of the sweep that was not.
"""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pyarrow.parquet as pq

from orchestration.errors import OrchestrationError
from orchestration.many.lane_library import LANES
from tests.speed.part import Goal, Options, Part, Table
from tests.speed.states import COMMAND, State

_NUMBERS = (1_000, 20_000, 100_000)  # more than one group of 10 000 rows of a table, and many
_MOST_ALONE = 20_000
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
        if until and process.poll() is None:
            with suppress(ProcessLookupError):  # a short one may be done already
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

    @property
    def size(self) -> str:
        """Of the table, or of the log while there is none."""
        (file,) = [*self.folder.glob("*.parquet")] or self.folder.glob("*.sweep.jsonl")
        return f"{'table' if file.suffix == '.parquet' else 'log'} {file.stat().st_size / 1e6:.1f} MB"


def measure(options: Options) -> Part:
    """Sweeps of growing numbers of samples."""
    folder, numbers = options.folder / "samples", (100, 200) if options.quick else _NUMBERS
    before, rows = _measured(options.before, numbers[0], folder / "before") if options.before else None, []
    if before:
        rows.append(_row(f"before: {numbers[0]} samples", *before))
    costs, last = [], None
    for count in numbers:
        cost, last = _measured(options.now, count, folder / str(count), "--ensemble")
        costs.append(cost)
        rows.append(_row(f"{count} samples", cost, last))
        if count <= _MOST_ALONE:
            alone = _measured(options.now, count, folder / f"{count}-alone", "--no-ensemble")
            rows.append(_row(f"{count} samples, by simulators", *alone))
    continued = Sweep(options.now, numbers[-1], folder / "continued", "--ensemble")
    half = continued.run(until=numbers[-1] // 2)
    rows.append(_row(f"{numbers[-1]} samples, interrupted at the half", half, continued))
    rows.append(_row("continued", continued.run(), continued))
    assert last
    _check_equal(last.table, continued.table)
    fewer, most = map(_megabytes, costs[-2:])
    goal = Goal(
        f"{numbers[-1]} samples: peak memory",
        "flat",
        f"{most}; {numbers[-2]} samples {fewer}",
        f"not measured; {numbers[0]} samples {_megabytes(before[0])}" if before else "",
    )
    headings = ("a sweep of", "peak memory of its largest process", "CPU", "on the clock", "on the disk")
    return Part([Table("samples", headings, rows)], [goal])


def _measured(state: State, count: int, folder: Path, *arguments: str) -> tuple[_Cost, Sweep]:
    """A sweep, after a short one, which compiles what it needs."""
    Sweep(state, LANES, folder.with_name(f"{folder.name}-first"), *arguments).run()
    sweep = Sweep(state, count, folder, *arguments)
    return sweep.run(), sweep


def _check_equal(first: Path, second: Path) -> None:
    one, other = (pq.read_table(path).to_pandas() for path in (first, second))
    if not one.equals(other):  # where NaN equals NaN
        raise OrchestrationError("a continued sweep has another table: expected that of one in a single run")


def _row(what: str, cost: _Cost, sweep: Sweep) -> tuple[str, ...]:
    _, cpu_s, wall_s = cost
    return what, _megabytes(cost), f"{cpu_s:.1f} s", f"{wall_s:.1f} s", sweep.size


def _megabytes(cost: _Cost) -> str:
    return f"{cost[0] / 1e6:.0f} MB"
