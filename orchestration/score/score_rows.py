"""The row of one controller: every case, what is measured of it once, and every plant."""

import hashlib
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from pydantic import ValidationError

from fmus.fmi.description import describe
from orchestration.errors import EnsembleError, ScenarioError
from orchestration.many.ensemble_checks import check_ensemble
from orchestration.many.lane_library import LANES
from orchestration.score import score_cache
from orchestration.score.isolated_loop import IsolatedLoop, RunError
from orchestration.score.loop import Loop
from orchestration.score.plants import plants
from orchestration.score.protocol import Case, Protocol
from orchestration.score.protocol_format import COMPARED
from orchestration.score.score_document import CaseResult, FigureOverPlants, PlantsResult, Row
from orchestration.score.scored_run import (
    ScoredRun,
    Trace,
    load_ensemble,
    measured_delay_margin,
    microseconds,
    scored_run,
    scored_runs,
    uses_true_rate,
)
from orchestration.score.statistics import distribution
from orchestration.score.table_seeds import table_seeds

OVER_PLANTS = (*COMPARED, "settling_time", "overshoot", "breach")
"""Figures of the runs over plants."""


_MOST_RUNS = 40  # that a delay margin takes; to compile an ensemble takes less

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
        except ValidationError as error:
            mistake = error.errors()[0]
            raise ScenarioError(
                f"score of {loop.controller.name}: {mistake['loc'][0]} = {mistake['input']!r}: "
                f"{mistake['msg'].lower()}, so nothing is written; check the FMU with l1-depth check"
            ) from error
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
            groups = self._groups_of_plants(loop, isolated)
            runs = [run for group in groups for run in self._results(isolated, group, names)]
            row.plants = _over_plants(runs, names)
        return row, traces

    def _groups_of_plants(self, loop: Loop, isolated: IsolatedLoop) -> list[Sequence[Case]]:
        """The plants that run at once: those that step together in an ensemble, if it can be and pays."""
        first, count, most = self.plants[0], len(self.plants), 1
        with suppress(EnsembleError, RunError):
            check_ensemble(loop.scenario(first).system, loop.experiment(first), count)
            isolated.call(load_ensemble, first, runs=_MOST_RUNS)
            most = LANES
        return [self.plants[i : i + most] for i in range(0, count, most)]

    def _results(
        self, isolated: IsolatedLoop, cases: Sequence[Case], names: Sequence[str]
    ) -> list[ScoredRun]:
        """Runs of cases of one layer at once; of one that fails so, that of a simulator."""
        runs: list[ScoredRun | None] = [None] * len(cases)
        if len(cases) > 1:
            with suppress(RunError):
                runs = isolated.call(scored_runs, cases, names, runs=len(cases))
            self.progress(sum(run is not None for run in runs))
        return [run or self._result(isolated, case, names) for run, case in zip(runs, cases, strict=True)]

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
