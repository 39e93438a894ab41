"""The row of one controller: every case, what is measured of it once, and every plant.

Rows of built-in controllers from earlier scores are in the store. A row is found there by the content of all
that it follows from: FMUs, parameters, protocol, seeds, this program and the libraries, Python and machine
that run it.
"""

import hashlib
import json
import math
import platform
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fmus import store
from fmus.fmi.description import describe, of_causality
from orchestration.errors import OrchestrationError, ScenarioError, SimulationError, SweepError
from orchestration.many.job import ENDED, TOO_LONG, Done, Failure, Job, Run
from orchestration.many.run_many import LocalRuns, in_order
from orchestration.many.runners import ClosedError
from orchestration.margins.fmu_margins import scan
from orchestration.margins.hold import HoldRuns, LoopSignal, last_part
from orchestration.results.recording import Recording
from orchestration.score.closed_loop import GAINS, OWN, ClosedLoop, ClosedLoopRun, Controller
from orchestration.score.protocol import FILE, Case, Protocol, plants
from orchestration.score.protocol_format import COMPARED
from orchestration.score.run_metrics import Trace, declared, failures, traced_metrics
from orchestration.score.score_document import CaseResult, MetricOverPlants, PlantsResult, Row
from orchestration.score.statistics import distribution
from orchestration.score.table_seeds import table_seeds
from orchestration.score.vehicle import DEPTH
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

OVER_PLANTS = (*COMPARED, "settling_time", "overshoot", "breach")
"""Metrics of the runs over plants."""

_MOST_ENDINGS = 3  # of a controller's process
_FEW_STEPS, _MANY_STEPS = 5_000, 200_000  # that are timed: many where few take a short time
_SHORT_S = 0.5
_REPETITIONS = 3
_TIMED_RUN = 10.0  # timeouts for a run that is timed, which has more steps than a case
_TRUE_RATE = "measured_depth_rate"

STORED = "score"
"""Kind of the rows in the store."""
_PROJECT = Path(__file__).parents[2]
_PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
_OF_OTHERS = ("controllers", "cost")  # tables of a protocol that a row does not follow from

Progress = Callable[[int], object]
RowTraces = tuple[Row, dict[str, Trace]]
"""A row, and what is drawn of its runs by case."""
_ROW_TRACES = TypeAdapter(RowTraces)


class Patience:
    """Makes the runs of one controller, until one took too long or its process has ended three times.

    The others are failures that say so: hundreds of them might each take as long.
    """

    def __init__(self, place: LocalRuns) -> None:
        self.place = place
        self._refusal = ""
        self._endings = 0

    @property
    def is_intact(self) -> bool:
        """Whether no run took too long, and no process ended: at another load of the machine, one might."""
        return not self._endings and not self._refusal

    def __call__(self, job: Job, runs: Sequence[Run]) -> Iterator[Done]:
        """Yields the runs of a job in their order."""
        with closing(in_order(self.place, job, runs)) as made:
            for _ in runs:
                yield Done(Failure(self._refusal, ENDED)) if self._refusal else self._noted(made)

    def _noted(self, made: Iterator[Done]) -> Done:
        try:
            done = next(made)
        except SweepError as error:  # its process cannot even start
            self._refusal = str(error)
            return Done(Failure(self._refusal, ENDED))
        cause = done.result.cause if isinstance(done.result, Failure) else ""
        self._endings += cause == ENDED
        if cause == TOO_LONG:
            self._refusal = "not run: it took too long before"
        elif self._endings == _MOST_ENDINGS:
            self._refusal = f"not run: its process ended {_MOST_ENDINGS} times before"
        return done


@dataclass
class Scoring:
    """The scoring of rows, with their cases and plants; progress: takes how many more runs are done."""

    protocol: Protocol
    full: bool
    progress: Progress

    def __post_init__(self) -> None:
        seeds = table_seeds()
        self.cases = [case.with_seed(seeds.sensor_seed) for case in self.protocol.cases.values()]
        self.plants = plants(self.protocol, seeds.plants_seed) if self.full else []

    def row(self, loop: ClosedLoop, patience: Patience, scored: bool) -> RowTraces:
        """Returns the row of a controller and its traces; of a built-in one from the cache, if there."""
        key = "" if scored else row_key(loop.controller, loop, self.full)
        if key and (stored := stored_row(key)):
            self.progress(len(self.cases) + len(self.plants))
            return stored
        with patience.place:
            try:
                row, traces = self._run(loop, scored)
            except ValidationError as error:
                mistake = error.errors()[0]
                raise ScenarioError(
                    f"score of {loop.controller.name}: {mistake['loc'][0]} = {mistake['input']!r}: "
                    f"{mistake['msg'].lower()}, so nothing is written; check the FMU with l1-depth check"
                ) from error
        if key and patience.is_intact:
            store_row(key, row, traces)
        return row, traces

    def _run(self, loop: ClosedLoop, scored: bool) -> RowTraces:
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
        for case, (run, trace) in zip(self.cases, self._judged(loop, self.cases, traced=True), strict=True):
            row.cases[case.name], traces[case.name] = run, trace
        row.uses_true_rate = _value_or(None, uses_true_rate, loop, nominal)
        row.delay_margin = _value_or(math.nan, delay_margin_of, loop, nominal)
        row.microseconds = _value_or(math.nan, microseconds, loop, nominal)
        if self.plants:
            names = [name for name in OVER_PLANTS if name in self.protocol.metrics]
            row.plants = _over_plants([run for run, _ in self._judged(loop, self.plants, names)], names)
        return row, traces

    def _judged(
        self, loop: ClosedLoop, cases: Sequence[Case], names: Collection[str] = (), traced: bool = False
    ) -> Iterator[tuple[CaseResult, Trace]]:
        """Yields the result of each case, or the reason why there is none, and what is drawn of it."""
        metrics = (declared(case, self.protocol, names) for case in cases)
        compute = (partial(traced_metrics, metrics=of_case, traced=traced) for of_case in metrics)
        for result in loop.results([ClosedLoopRun(*pair) for pair in zip(cases, compute, strict=True)]):
            if isinstance(result, Failure):
                yield CaseResult(failed=[result.reason]), {}
            else:
                of_run, trace = result
                yield CaseResult(metrics=of_run, failed=failures(of_run, self.protocol)), trace
            self.progress(1)


def _value_or(default: Any, function: Callable[[ClosedLoop, Case], Any], loop: ClosedLoop, case: Case) -> Any:
    """Returns what a function of the loop returns, or the default where its run fails."""
    try:
        return function(loop, case)
    except ClosedError:
        raise
    except OrchestrationError:
        return default


def uses_true_rate(loop: ClosedLoop, case: Case) -> bool:
    """Checks whether a run depends on the true depth rate, which no sensor of the vehicle measures."""
    controller = loop.controller
    variable = controller.variable(_TRUE_RATE)
    inputs = of_causality(describe(loop.scenario(case).system.components["controller"]), "input")
    if variable.removeprefix(OWN) not in {v.name for v in inputs}:
        return False
    without = replace(controller, settings={**controller.settings, variable: 0.0})
    blind = ClosedLoop(without, loop.protocol, loop.make, loop.timeout)
    # the force of a vehicle without a gain is not a number
    return not np.array_equal(loop.run(case).values, blind.run(case).values, equal_nan=True)


def delay_margin_of(loop: ClosedLoop, case: Case) -> float:
    """Returns how much later [s] the measured depth may be while the case holds its target quietly.

    Of the first loss on a scan, as far as that goes. Not a number if it is not quiet as it is.
    """
    scenario = replace(loop.scenario(case), experiment=loop.experiment(case))
    hold = last_part(loop.protocol.vehicle.variable(DEPTH), case.target.window[1])
    with HoldRuns(scenario, hold, loop.make, loop.timeout) as runs:
        return scan(runs, LoopSignal.MEASUREMENT, only_first_loss=True).margin


def microseconds(loop: ClosedLoop, case: Case) -> float:
    """Returns the processor time [us] of a communication step of the controller's FMU alone.

    Of the fastest of three runs. Its inputs keep their start values. The time of a short run is subtracted,
    which is that of the start.
    """
    loaded = loop.scenario(case)
    fmu = loaded.system.components["controller"]
    parameters = {n: v for n, v in loop.experiment(case).parameters.items() if n.startswith(OWN)}
    output = next(v.name for v in of_causality(describe(fmu), "output") if v.type != "String")
    step = loaded.experiment.step_size
    base = Experiment(step, step, parameters=parameters, record=(OWN + output,), open_inputs="start")
    timeout = None if loop.timeout is None else _TIMED_RUN * loop.timeout
    job = Job(System({"controller": fmu}), base, timeout)

    def duration(steps: int) -> float:
        (done,) = loop.make(job, [Run(None, replace(base, stop_time=steps * step), _last)])
        if isinstance(done.result, Failure):
            raise SimulationError(done.result.reason, None)
        return done.seconds

    many = _MANY_STEPS if duration(_FEW_STEPS) < _SHORT_S else _FEW_STEPS
    few = many // 10
    longer, shorter = (min(duration(steps) for _ in range(_REPETITIONS)) for steps in (many, few))
    return 1e6 * (longer - shorter) / (many - few)


def _last(runs: Recording) -> list[float]:
    return runs.values[:, -1, 0].tolist()


def _fmu(loop: ClosedLoop) -> dict[str, Any]:
    path = loop.scenario(loop.protocol.nominal).system.components["controller"]
    description = describe(path)
    return {
        "model": description.modelName,
        "guid": description.guid,
        "tool": description.generationTool or "",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def _over_plants(runs: Sequence[CaseResult], names: Sequence[str]) -> PlantsResult:
    values = {name: [run.metrics.get(name, math.nan) for run in runs] for name in names}
    failed = {str(number): run.failed for number, run in enumerate(runs) if run.failed}
    return PlantsResult(
        count=len(runs),
        failure_rate=len(failed) / len(runs),
        failed=failed,
        metrics={
            name: MetricOverPlants(**asdict(distribution(column)), values=column)
            for name, column in values.items()
        },
    )


def row_key(controller: Controller, loop: ClosedLoop, full: bool) -> str:
    """Returns the key of a row in the store."""
    loaded = loop.scenario(loop.protocol.nominal)
    fmus = [store.digest(fmu.read_bytes()) for fmu in loaded.system.components.values()]
    runs = {name: table for name, table in loop.protocol.file.data.items() if name not in _OF_OTHERS}
    vehicle = loop.protocol.vehicle.key
    content = [asdict(controller), full, runs, vehicle, _sources(), _environment(), fmus]
    return store.digest(json.dumps(content, sort_keys=True, default=str).encode())


@cache
def _sources() -> list[tuple[str, str]]:
    """Returns path and digest of what metrics follow from in this program.

    Of the shipped protocol the tables count one by one, and of tuned gains those that the controller has.
    """
    return [
        (path, digest)
        for name in _PACKAGES
        for path, digest, _ in store.digests(_PROJECT / name)
        if (source := _PROJECT / name / path) != FILE and source.parent != GAINS
    ]


@cache
def _environment() -> list[object]:
    """Returns what metrics depend on besides the sources: Python, the C library and what is installed."""
    installed = sorted({(found.name, found.version) for found in distributions()})
    return [sys.version, platform.machine(), platform.libc_ver(), installed]


def stored_row(key: str) -> RowTraces | None:
    """Returns the row of a key and its traces, if they are stored.

    Raises OrchestrationError, with what to do, if another user can have written it.
    """
    if reason := store.reason_for_distrust(store.folder(STORED) / key):
        raise OrchestrationError(reason)
    with suppress(ValueError):  # of another version of Pydantic
        return _ROW_TRACES.validate_json(store.get(STORED, key) or b"")
    return None


def store_row(key: str, row: Row, traces: dict[str, Trace]) -> None:
    """Stores a row and its traces."""
    store.put(STORED, key, _ROW_TRACES.dump_json((row, traces)))
