"""The score: controllers in every case of the protocol, beside those that the protocol has.

result = score([Controller("mine", "my.fmu")])
result.document.figure(result.document.scored[0], "nominal", "rmse")
"""

import hashlib
import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from typing import Any

from orchestration.errors import ScenarioError
from orchestration.fmi.description import describe
from orchestration.study import score_cache
from orchestration.study.isolated_loop import IsolatedLoop, RunError
from orchestration.study.loop import Controller, Loop
from orchestration.study.plants import plants
from orchestration.study.protocol import Case, Protocol, read_protocol
from orchestration.study.protocol_format import COMPARED
from orchestration.study.score_document import (
    CaseResult,
    FigureOverPlants,
    PairedDifference,
    PlantsResult,
    Row,
    Score,
    protocol_info,
)
from orchestration.study.scored_run import (
    ScoredRun,
    Trace,
    measured_delay_margin,
    microseconds,
    scored_run,
    uses_true_rate,
)
from orchestration.study.statistics import compare, distribution, holm
from orchestration.study.table_seeds import table_seeds
from orchestration.study.tuned_gains import tuned
from orchestration.system.prepared_run import prepare

OVER_PLANTS = (*COMPARED, "settling_time", "overshoot", "breach")
"""Figures of the runs over plants."""

_MOST_RUNS = 40  # of a delay margin

Progress = Callable[[int], object]


@dataclass(frozen=True)
class ScoreResult:
    """The document of a score, and what is drawn: row and case -> the trace of that run."""

    document: Score
    traces: Mapping[str, Mapping[str, Trace]]


def score(
    controllers: Sequence[Controller],
    protocol: Protocol | None = None,
    *,
    beside: Sequence[Controller] | None = None,
    full: bool = False,
    timeout: float | None = None,
    workers: int = os.cpu_count() or 1,
    progress: Progress = lambda done: None,
) -> ScoreResult:
    """Run every case, with `full` every plant too, and compare with the controllers of the protocol.

    beside: the other controllers, by default those of the protocol, tuned; their rows are kept in a cache
    timeout: longest time [s] of a run, by default that of the protocol
    progress: called with how many more runs are done, of `run_count`
    Each controller runs in a process of its own. One that fails, hangs or crashes has its row with the
    reason; one that does not fit the vehicle raises OrchestrationError before anything runs.
    """
    protocol = protocol or read_protocol()
    if timeout is not None and not timeout > 0.0:
        raise ScenarioError(f"timeout {timeout!r} s: expected more than 0")
    scoring = _Scoring(protocol, full, protocol.tables.time_limit if timeout is None else timeout, progress)
    if beside is None:
        beside = [tuned(protocol, name) for name in protocol.controllers]
    taken = {controller.name for controller in beside}
    jobs = [(_named(controller, taken), True) for controller in controllers]
    jobs += [(controller, False) for controller in beside]
    for controller, _ in jobs:
        if [c.name for c, _ in jobs].count(controller.name) > 1:
            raise ScenarioError(f"two controllers are called {controller.name!r}: expected different names")
    with ExitStack() as stack:
        loops = [stack.enter_context(Loop(controller, protocol)) for controller, _ in jobs]
        for loop in loops:
            prepare(loop.scenario(protocol.nominal).system, loop.experiment(protocol.nominal))
        pool = stack.enter_context(ThreadPoolExecutor(workers))
        stack.callback(scoring.close)
        stack.callback(pool.shutdown, wait=False, cancel_futures=True)  # first: no thread takes another row
        futures = [
            pool.submit(scoring.row, loop, scored) for loop, (_, scored) in zip(loops, jobs, strict=True)
        ]
        rows = [future.result() for future in futures]
    document = Score(
        made_by=f"l1-depth {version('l1-depth')}",
        protocol=protocol_info(protocol),
        rows=[row for row, _ in rows],
    )
    document.differences = _differences(document)
    return ScoreResult(document, {row.name: traces for row, traces in rows})


def run_count(controllers: int, protocol: Protocol, full: bool) -> int:
    """Runs of a score of so many controllers beside those of the protocol."""
    runs = len(protocol.cases) + (protocol.tables.plants.count if full else 0)
    return (controllers + len(protocol.controllers)) * runs


def _named(controller: Controller, taken: Collection[str]) -> Controller:
    """The controller, under a name that is not taken."""
    name = f"{controller.name} (scored)" if controller.name in taken else controller.name
    return replace(controller, name=name)


@dataclass
class _Scoring:
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
        row.uses_true_rate = _or(None, isolated, uses_true_rate, nominal)
        row.delay_margin = _or(math.nan, isolated, measured_delay_margin, nominal)
        row.microseconds = _or(math.nan, isolated, microseconds, nominal)
        if self.plants:
            runs = [self._result(isolated, plant, OVER_PLANTS) for plant in self.plants]
            row.plants = _over_plants(runs)
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


def _or(default: Any, isolated: IsolatedLoop, function: Callable[..., Any], case: Case) -> Any:
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


def _over_plants(runs: Sequence[ScoredRun]) -> PlantsResult:
    values = {name: [run.figures.get(name, math.nan) for run in runs] for name in OVER_PLANTS}
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


def _differences(document: Score) -> list[PairedDifference]:
    """The scored controllers against each of the others, plant by plant; corrected for their number."""
    result: list[PairedDifference] = []
    for scored in document.scored:
        others = {row.name: row.plants for row in document.rows if row.plants and row.name != scored.name}
        if scored.plants is None:
            continue
        for figure in COMPARED:
            own = scored.plants.figures[figure].values
            found = {name: compare(own, other.figures[figure].values) for name, other in others.items()}
            corrected = holm({name: comparison.p for name, comparison in found.items()})
            result += [
                PairedDifference(
                    scored=scored.name,
                    other=name,
                    figure=figure,
                    pairs=comparison.pairs,
                    median_difference=comparison.median_difference,
                    interval=(comparison.low, comparison.high),
                    p=comparison.p,
                    p_holm=corrected[name],
                )
                for name, comparison in found.items()
            ]
    return result
