"""Runs of a scenario: in either state, with their metrics, and down to the same equations as one C program.

A run is all of `Simulator.run`: reset, parameters, initialisation, steps, recording; with the FMUs and the
compiled loop of each state.
"""

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import NamedTuple

from tests.speed.part import Goal, Options, Part, Table, ratios, spread
from tests.speed.scenarios import HOST, MASTER, MASTER_LOOP, MONOLITH, Loop, loop

SCENARIO = "nominal-extended"
_RUNS = 3  # of each state in a round
_PROCESSES = 3  # of each state, one after another


class _Turn(NamedTuple):
    """CPU time [ms] of a run, that of its metrics, and a hash of the recording."""

    run: float
    metrics: float
    recording: str


class _Turns(NamedTuple):
    """Of a state: its turns, and CPU time [ms] of the first metrics of each process."""

    turns: list[_Turn]
    first: list[float]

    @property
    def runs(self) -> list[float]:
        return [turn.run for turn in self.turns]

    @property
    def metrics(self) -> list[float]:
        return [turn.metrics for turn in self.turns]


def _turn(process: "subprocess.Popen[str]") -> _Turn:
    assert process.stdin
    assert process.stdout
    process.stdin.write(f"{_RUNS}\n")
    process.stdin.flush()
    run, metrics, recording = process.stdout.readline().split()
    return _Turn(1e3 * float(run), 1e3 * float(metrics), recording)


def _turns(options: Options) -> list[_Turns]:
    """For each state its turns."""
    turns = [_Turns([], []) for _ in options.states]
    for _ in range(options.rounds(_PROCESSES)):
        processes = [state.start("run.py", SCENARIO) for state in options.states]
        try:
            for process, own in zip(processes, turns, strict=True):
                assert process.stdout
                own.first.append(1e3 * float(process.stdout.readline()))
            for _ in range(options.rounds(14)):
                for process, own in zip(processes, turns, strict=True):
                    own.turns.append(_turn(process))
        finally:
            for process in processes:
                process.communicate()
    return turns


def measure(options: Options) -> Part:
    """Runs by turns, and the ways in which a scenario can run."""
    *before, now = _turns(options)
    ways = loop(SCENARIO, options.rounds(7), options.before)
    for turns in before:  # by turns with now, since minutes differ
        slower = median(ratios(turns.runs, now.runs))
        ways = replace(ways, before={MASTER: [slower * x for x in ways.seconds[MASTER]], **ways.before})
    rows = [_row("a run", *(x.runs for x in (now, *before)))]
    rows.append(_row("all its metrics", *(x.metrics for x in (now, *before))))
    rows.append(
        _row(
            "all its metrics, the first of a process, with what they import",
            *(x.first for x in (now, *before)),
        )
    )
    if before:
        are_equal = len({turn.recording for x in (now, *before) for turn in x.turns}) == 1
        rows.append(("its recording", "", options.equality(are_equal), ""))
    tables = [Table("runs", ("CPU time", "before", "now", "ratio"), rows), of_ways(ways)]
    return Part(tables, _goals(ways, now, *before))


def _row(what: str, now: list[float], before: list[float] | None = None) -> tuple[str, ...]:
    """ms"""
    if not before:
        return what, "", spread(now, 2, "ms"), ""
    return what, spread(before, 2, "ms"), spread(now, 2, "ms"), spread(ratios(now, before), 3)


def of_ways(ways: Loop) -> Table:
    headings = (
        "nominal scenario",
        "time",
        "ratio to the C host",
        "ratio to the C program",
        "ns a step more than the C program",
    )
    return Table(
        "ways", headings, [*_rows("", ways.seconds, ways.steps), *_rows("before: ", ways.before, ways.steps)]
    )


def _rows(prefix: str, seconds: Mapping[str, Sequence[float]], steps: int) -> Iterator[tuple[str, ...]]:
    """Ratios of medians."""
    for way, taken in seconds.items():
        time = spread([1e3 * x for x in taken], 2, "ms")
        more = (median(taken) - median(seconds[MONOLITH])) / steps
        to_host, to_program = (f"{_ratio(seconds, way, other):.2f}" for other in (HOST, MONOLITH))
        yield prefix + way, time, to_host, to_program, f"{1e9 * more:.0f}"


def _ratio(seconds: Mapping[str, Sequence[float]], way: str, other: str) -> float:
    return median(seconds[way]) / median(seconds[other])


def _goals(ways: Loop, now: _Turns, *before: _Turns) -> list[Goal]:
    ratio = f", {median(ratios(now.runs, before[0].runs)):.2f} of before" if before else ""
    *old_run, run = (f"{median(x.runs):.2f} ms" for x in (*before, now))
    *old_metrics, metrics = (_part_of_run(x) for x in (*before, now))
    *old_of_c, of_c = (_of_c(x) for x in (*([ways.before] if before else []), ways.seconds))
    loop_of_c = f"; its loop {_ratio(ways.seconds, MASTER_LOOP, HOST):.2f} of a host in C"
    return [
        Goal("a run of the nominal scenario", "0.55 of before", run + ratio, "".join(old_run)),
        Goal("the same beside C", "none", of_c + loop_of_c, "".join(old_of_c)),
        Goal("all its metrics", "0.2 of the run", metrics, "".join(old_metrics)),
    ]


def _of_c(seconds: Mapping[str, Sequence[float]]) -> str:
    host, program = (_ratio(seconds, MASTER, other) for other in (HOST, MONOLITH))
    return f"{host:.2f} of a host in C, {program:.2f} of one C program"


def _part_of_run(turns: _Turns) -> str:
    part = median(ratios(turns.metrics, turns.runs))
    return f"{median(turns.metrics):.2f} ms, {part:.2f} of the run"
