"""Runs of a scenario: in either state, with their metrics, and down to the same equations as one C program.

A run is all of `Simulator.run`: reset, parameters, initialisation, steps, recording; with the FMUs and the
compiled loop of each state.
"""

import subprocess
from statistics import median
from typing import NamedTuple

from orchestration.errors import OrchestrationError
from tests.speed.part import Goal, Options, Part, Table, ratios, spread
from tests.speed.scenarios import HOST, MASTER_LOOP, MONOLITH, Loop, loop

SCENARIO = "nominal-extended"
_RUNS = 3  # of each state in a round


class _Turn(NamedTuple):
    """CPU time [s] of a run, that of its metrics, and a hash of the recording."""

    run: float
    metrics: float
    recording: str


def _turn(process: "subprocess.Popen[str]") -> _Turn:
    assert process.stdin
    assert process.stdout
    process.stdin.write(f"{_RUNS}\n")
    process.stdin.flush()
    run, metrics, recording = process.stdout.readline().split()
    return _Turn(float(run), float(metrics), recording)


def _turns(options: Options) -> list[list[_Turn]]:
    """For each state its turns."""
    processes = [state.start("run.py", SCENARIO) for state in options.states]
    try:
        for process in processes:
            assert process.stdout
            if process.stdout.readline() != "ready\n":
                raise OrchestrationError("run.py did not start")
        turns = [[_turn(process) for process in processes] for _ in range(options.rounds(41))]
    finally:
        for process in processes:
            process.communicate()
    return [list(column) for column in zip(*turns, strict=True)]


def measure(options: Options) -> Part:
    """Runs by turns, and the ways in which a scenario can run."""
    *before, now = _turns(options)
    ways = loop(SCENARIO, rounds=options.rounds(7))
    rows = [_row("a run", _runs(now), *map(_runs, before))]
    rows.append(_row("all its metrics", _metrics(now), *map(_metrics, before)))
    if before:
        are_equal = {turn.recording for turn in now} == {turn.recording for turn in before[0]}
        rows.append(("its recording", "", "equal bit for bit" if are_equal else "different", ""))
    tables = [Table("runs", ("CPU time", "before", "now", "ratio"), rows), of_ways(ways)]
    return Part(tables, _goals(ways, now, *before))


def _runs(turns: list[_Turn]) -> list[float]:
    return [1e3 * turn.run for turn in turns]


def _metrics(turns: list[_Turn]) -> list[float]:
    return [1e3 * turn.metrics for turn in turns]


def _row(what: str, now: list[float], before: list[float] | None = None) -> tuple[str, ...]:
    """ms"""
    if not before:
        return what, "", spread(now, 2, "ms"), ""
    return what, spread(before, 2, "ms"), spread(now, 2, "ms"), spread(ratios(now, before), 3)


def of_ways(ways: Loop) -> Table:
    rows = []
    for way, seconds in ways.seconds.items():
        ratio, more = seconds / ways.seconds[MONOLITH], seconds - ways.seconds[MONOLITH]
        rows.append((way, f"{1e3 * seconds:.2f} ms", f"{ratio:.2f}", f"{1e9 * more / ways.steps:.0f}"))
    headings = ("nominal scenario", "time", "ratio to the C program", "ns a step more than the C program")
    return Table("ways", headings, rows)


def _goals(ways: Loop, now: list[_Turn], *before: list[_Turn]) -> list[Goal]:
    runs = [_runs(turns) for turns in (*before, now)]
    ratio = f", {median(ratios(runs[-1], runs[0])):.2f} of before" if before else ""
    *old_run, run = (f"{median(column):.2f} ms" for column in runs)
    *old_metrics, metrics = (_part_of_run(turns) for turns in (*before, now))
    of_c = ways.seconds[MASTER_LOOP] / ways.seconds[HOST]
    others = f"a host in C {1e3 * ways.seconds[HOST]:.2f} ms: the loop takes {of_c:.2f} of that"
    return [
        Goal("a run of the nominal scenario", "0.55 of before", run + ratio, "".join(old_run), others),
        Goal("all its metrics", "0.2 of the run", metrics, "".join(old_metrics)),
    ]


def _part_of_run(turns: list[_Turn]) -> str:
    part = median(turn.metrics / turn.run for turn in turns)
    return f"{median(_metrics(turns)):.2f} ms, {part:.2f} of the run"
