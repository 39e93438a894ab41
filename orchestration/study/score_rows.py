"""The row of one controller: every case, what is measured of it once, and every plant."""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from orchestration.fmi.description import describe
from orchestration.study import score_cache
from orchestration.study.isolated_loop import IsolatedLoop, RunError
from orchestration.study.loop import Loop
from orchestration.study.plants import plants
from orchestration.study.protocol import Case, Protocol
from orchestration.study.protocol_format import COMPARED
from orchestration.study.score_document import CaseResult, FigureOverPlants, PlantsResult, Row
from orchestration.study.scored_run import (
    ScoredRun,
    Trace,
    measured_delay_margin,
    microseconds,
    scored_run,
    uses_true_rate,
)
from orchestration.study.statistics import distribution
from orchestration.study.table_seeds import table_seeds

OVER_PLANTS = (*COMPARED, "settling_time", "overshoot", "breach")
"""Figures of the runs over plants."""


_MOST_RUNS = 40  # of a delay margin

Progress = Callable[[int], object]


@dataclass
class Scoring:
    """How rows are made."""

    protocol: Protocol
    full: bool
    timeout: float
    progress: Progress
    running: list[IsolatedLoop] = field(default_factory=list)
    closed: bool = False

    def __post_init__(self) -> None:
        seeds = table_seeds()
        self.cases = [case.with_seed(seeds.sensor_seed) for case in self.protocol.cases.values()]
        self.plants = plants(self.protocol, seeds.plants_seed) if self.full else []

    def row(self, loop: Loop, scored: bool) -> tuple[Row, dict[str, Trace]]:
        """The row of a controller, and its traces; of a built-in one from the cache, if they are there."""
        name = "" if scored else score_cache.key(loop.controller, loop, self.full)
        cached = score_cache.read(name) if name else None
        if cached:
            self.progress(len(self.cases) + len(self.plants))
            return cached.row, cached.traces
        isolated = IsolatedLoop(loop.controller, self.protocol.file.path, self.timeout)
        self.running.append(isolated)
        if self.closed:
            isolated.close()
        try:
            row, traces = self._run(loop, isolated, scored)
            is_intact = isolated.is_intact  # at another load of the machine, the row may be another
        finally:
            isolated.close()
        if name and is_intact and not self.closed:
            score_cache.write(name, row, traces)
        return row, traces

    def close(self) -> None:
        """End what runs."""
        self.closed = True
        for isolated in self.running:
            isolated.close()

    def _run(self, loop: Loop, isolated: IsolatedLoop, scored: bool) -> tuple[Row, dict[str, Trace]]:
        controller, nominal = loop.controller, self.cases[0]
        row = Row(
            name=controller.name,
            title=controller.title or controller.name,
            league=controller.league,
            scored=scored,
            fmu=_fmu(loop),
            parameters=loop.parameters(),
        )
        traces: dict[str, Trace] = {}
        for case in self.cases:
            run = self._result(isolated, case, traced=True)
            row.cases[case.name] = CaseResult(figures=run.figures, failed=run.failed)
            traces[case.name] = run.trace
        row.uses_true_rate = _value_or(None, isolated, uses_true_rate, nominal)
        row.delay_margin = _value_or(math.nan, isolated, measured_delay_margin, nominal)
        row.microseconds = _value_or(math.nan, isolated, microseconds, nominal)
        if self.plants:
            names = [name for name in OVER_PLANTS if name in self.protocol.figures]
            runs = [self._result(isolated, plant, names) for plant in self.plants]
            row.plants = _over_plants(runs, names)
        return row, traces

    def _result(
        self, isolated: IsolatedLoop, case: Case, names: Sequence[str] = (), traced: bool = False
    ) -> ScoredRun:
        """A run, or the reason why there is none."""
        try:
            return isolated.call(scored_run, case, names, traced)
        except RunError as error:
            return ScoredRun({}, [str(error)])
        finally:
            self.progress(1)


def _value_or(default: Any, isolated: IsolatedLoop, function: Callable[..., Any], case: Case) -> Any:
    """What a function of the loop gives, or the default where its run fails."""
    try:
        return isolated.call(function, case, runs=_MOST_RUNS)
    except RunError:
        return default


def _fmu(loop: Loop) -> dict[str, Any]:
    path = loop.scenario(loop.protocol.nominal).system.components["controller"]
    description = describe(path)
    return {
        "model": description.modelName,
        "guid": description.guid,
        "tool": description.generationTool or "",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def _over_plants(runs: Sequence[ScoredRun], names: Sequence[str]) -> PlantsResult:
    values = {name: [run.figures.get(name, math.nan) for run in runs] for name in names}
    failed = {str(number): run.failed for number, run in enumerate(runs) if run.failed}
    return PlantsResult(
        count=len(runs),
        failure_rate=len(failed) / len(runs),
        failed=failed,
        figures={
            name: FigureOverPlants(**asdict(distribution(column)), values=column)
            for name, column in values.items()
        },
    )
