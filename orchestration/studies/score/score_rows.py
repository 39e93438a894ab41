"""The result row of one controller: all cases, one-off measurements, all sampled plants."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from pydantic import ValidationError

from fmus.fmi.description import describe, is_independent, of_causality
from fmus.fmi.variable_types import FmiValue
from fmus.store import digest
from orchestration.errors import OrchestrationError, ScenarioError, SimulationError, SweepError
from orchestration.many.job import ENDED, TOO_LONG, ClosedError, Done, Failure, Job, Reduce, Run
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import in_order, recordings_of
from orchestration.results.recording import Recording
from orchestration.results.statistics import distribution, proportion_interval
from orchestration.scenarios.changes import with_values
from orchestration.studies.margins.fmu_margins import DELAYS, scan
from orchestration.studies.margins.hold import QUIET, HoldRuns, LoopSignal, last_part
from orchestration.studies.score.closed_loop import OWN, ClosedLoop, ClosedLoopRun
from orchestration.studies.score.draws import drawn_cases, plants, repeated_cases
from orchestration.studies.score.protocol import Case, Protocol, on_vehicle
from orchestration.studies.score.protocol_format import COMPARED, DELAY_MARGIN
from orchestration.studies.score.run_metrics import Trace, declared, failures, traced_metrics
from orchestration.studies.score.score_document import CaseResult, ManyRuns, MetricOverRuns, Row
from orchestration.studies.score.tune_problem import costs
from orchestration.studies.vehicle import DEPTH
from orchestration.system.experiment import Experiment
from orchestration.system.signals import Table
from orchestration.system.system import System

OVER_PLANTS = (*COMPARED, "settling_time", "overshoot", "breach")
"""Metrics of the runs over plants."""

_MOST_ENDINGS = 3  # of a controller's process
_REPETITIONS = 3
# timeouts for a run that is timed, which has more steps than a case
_TIMED_RUN = 10.0
Progress = Callable[[int], object]
RowTraces = tuple[Row, dict[str, Trace]]
"""A row, and the traces of its runs by case."""


class LimitedRuns:
    """Makes the runs of one controller, until one took too long or its process has ended three times.

    The others are failures that say so: hundreds of them might each take as long.
    Each run has a separate process and folder: neither a global nor a file passes notes to the next run. Runs
    of FMUs that share no memory (`is_independent`) have one process together.
    """

    def __init__(self, local: LocalRuns) -> None:
        self.local = local
        self._refusal = ""
        self._endings = 0

    def __call__(self, job: Job, runs: Sequence[Run]) -> Iterator[Done]:
        """Yields the runs of a job in their order."""
        share_no_memory = all(is_independent(describe(path)) for path in job.system.components.values())
        for group in [runs] if share_no_memory else [[run] for run in runs]:
            with closing(in_order(self.local, job, group)) as made:
                for _ in group:
                    yield Done(Failure(self._refusal, ENDED)) if self._refusal else self._noted(made)
            if not share_no_memory:
                self.local.end_runs()

    def _noted(self, made: Iterator[Done]) -> Done:
        try:
            done = next(made)
        # a process that cannot start once will not start for the other runs
        except SweepError as error:
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
    seed: int
    progress: Progress

    def __post_init__(self) -> None:
        self.cases = drawn_cases(self.protocol, self.seed)
        self.plants = plants(self.protocol, self.seed) if self.full else []
        self.draws = repeated(self.protocol, self.seed) if self.full else {}

    def row(self, loop: ClosedLoop, limited: LimitedRuns, scored: bool) -> RowTraces:
        """Returns the row of a controller and its traces."""
        with limited.local:
            try:
                return self._run(loop, scored)
            except ValidationError as error:
                mistake = error.errors()[0]
                raise ScenarioError(
                    f"score of {loop.controller.name}: {mistake['loc'][0]} = {mistake['input']!r}: "
                    f"{mistake['msg'].lower()}, so nothing is written; check the FMU with l1-depth check"
                ) from error

    def _run(self, loop: ClosedLoop, scored: bool) -> RowTraces:
        controller, nominal = loop.controller, self.cases[0]
        row = Row(
            name=controller.name,
            title=controller.title or controller.name,
            connected=loop.connected(),
            scored=scored,
            fmu=_fmu(loop),
            parameters=loop.parameters(),
            step=loop.experiment(nominal).step_size,
        )
        traces: dict[str, Trace] = {}
        for case, (run, trace) in zip(self.cases, self._judged(loop, self.cases, traced=True), strict=True):
            row.cases[case.name], traces[case.name] = run, trace
        row.unranked = beyond_ranges(loop)
        if row.cases[nominal.name].failed:
            row.unranked += [f"{nominal.title}: {reason}" for reason in row.cases[nominal.name].failed]
        else:
            row.unranked += _value_or([], not_repeated, loop, nominal)
            row.unranked += _value_or([], beyond_bounds, loop, nominal)
            draws = self.draws.get(nominal.name, [nominal])
            row.delay_margins = [_value_or(math.nan, delay_margin_of, loop, draw) for draw in draws]
            row.delay_margin = float(np.median(row.delay_margins))
        row.microseconds = _value_or(math.nan, microseconds, loop, nominal)
        if self.plants:
            names = [name for name in OVER_PLANTS if name in self.protocol.metrics]
            row.plants = self._over_runs(loop, self.plants, names)
            row.draws = {name: self._over_runs(loop, cases, names) for name, cases in self.draws.items()}
        return row, traces

    def _over_runs(self, loop: ClosedLoop, cases: Sequence[Case], names: Sequence[str]) -> ManyRuns:
        """Returns what many runs of a controller have in common, with the metrics named."""
        runs = [run for run, _ in self._judged(loop, cases, names)]
        values = {name: [run.metrics.get(name, math.nan) for run in runs] for name in names}
        failed = {str(number): run.failed for number, run in enumerate(runs) if run.failed}
        return ManyRuns(
            count=len(runs),
            failure_rate=len(failed) / len(runs),
            failure_interval=proportion_interval(len(failed), len(runs)),
            failed=failed,
            metrics={
                name: MetricOverRuns(**asdict(distribution(column)), values=column)
                for name, column in values.items()
            },
        )

    def _judged(
        self, loop: ClosedLoop, cases: Sequence[Case], names: Collection[str] = (), traced: bool = False
    ) -> Iterator[tuple[CaseResult, Trace]]:
        """Yields the result of each case, or the reason why it is missing, and its trace."""
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
    # an interrupted score must end, not fill its rows with defaults
    except ClosedError:
        raise
    except OrchestrationError:
        return default


def beyond_bounds(loop: ClosedLoop, case: Case) -> list[str]:
    """Returns the bounds of the search that a controller does not keep in its practice cases.

    Built-in controllers and scored ones are held to the same bounds, with the same noise: gains at a bound
    keep it with one noise and not with another.
    """
    protocol = on_vehicle(loop.protocol)
    with ClosedLoop(loop.controller, protocol, loop.make, loop.timeout) as held:
        (result,) = costs(held, [{}])
    if "failure" in result:
        return [f"practice cases: {result['failure']}"]
    bounds = dict(protocol.tables.cost.bounds)
    delay = bounds.pop(DELAY_MARGIN, 0.0)
    reasons = [
        f"{protocol.cases[name].title}, practice: {metric} {value:.4g} {protocol.metrics[metric].unit}, "
        f"above {bound:g}, the bound of the search"
        for name, metrics in result["metrics"].items()
        for metric, bound in bounds.items()
        if (value := metrics.get(metric, 0.0)) > bound
    ]
    if result["unrest"] > QUIET:
        reasons.append(f"practice: not quiet with a delay of {delay:g} s, the bound of the search")
    return reasons


def beyond_ranges(loop: ClosedLoop) -> list[str]:
    """Returns the gains beyond the widest range that the protocol has for them in this FMU."""
    ranges: dict[str, tuple[float, float]] = {}
    for table in loop.protocol.controllers.values():
        if table.fmu == loop.controller.fmu:
            for name, gain in table.gains.items():
                low, high = ranges.get(name, (math.inf, -math.inf))
                ranges[name] = min(low, gain.low), max(high, gain.high)
    given = {name: float(value) for name, value in loop.parameters().items() if name in ranges}
    return [
        f"{name} = {value:g}: beyond {ranges[name][0]:g} to {ranges[name][1]:g}, in which gains are tuned"
        for name, value in given.items()
        if not ranges[name][0] <= value <= ranges[name][1]
    ]


def not_repeated(loop: ClosedLoop, case: Case) -> list[str]:
    """Returns the reason why a controller is not ranked whose run gives other values when it is repeated."""
    first, second = (loop.run(case).values for _ in range(2))
    return [] if np.array_equal(first, second, equal_nan=True) else ["its run, repeated, gives other values"]


def delay_margin_of(
    loop: ClosedLoop, case: Case, gains: Mapping[str, FmiValue] = {}, largest: float = DELAYS.largest
) -> float:
    """Returns how much later [s] the measured depth may be while the case holds its target quietly.

    The first loss on a scan, up to its end. Not a number if the loop is not quiet without a delay.
    gains: variable of the controller -> value; largest: delay [s] of the scan
    """
    experiment = with_values(loop.experiment(case), {f"{OWN}{name}": x for name, x in gains.items()})
    scenario = replace(loop.scenario(case), experiment=experiment)
    hold = last_part(loop.protocol.vehicle.variable(DEPTH), case.target.window[1])
    with HoldRuns(scenario, hold, loop.make, loop.timeout) as runs:
        grid = replace(DELAYS, largest=largest)
        return scan(runs, LoopSignal.MEASUREMENT, grid, only_first_loss=True).margin


def microseconds(loop: ClosedLoop, case: Case) -> float:
    """Returns the processor time [us] of a communication step of the controller's FMU in the run of a case.

    The FMU runs alone, with the inputs that it had in the case. The fastest of three runs counts; the
    time of a tenth of the run is subtracted, with the start in it.
    """
    system, base = alone(loop, case)
    timeout = None if loop.timeout is None else _TIMED_RUN * loop.timeout
    job = Job(system, base, timeout)
    steps = round(base.stop_time / base.step_size)
    few = steps // 10

    def duration(steps: int) -> float:
        return _done(loop, job, replace(base, stop_time=steps * base.step_size), _last).seconds

    longer, shorter = (min(duration(steps) for _ in range(_REPETITIONS)) for steps in (steps, few))
    return 1e6 * (longer - shorter) / (steps - few)


def alone(loop: ClosedLoop, case: Case) -> tuple[System, Experiment]:
    """Returns the controller's FMU alone, and the run of a case with the inputs that it had in the loop."""
    loaded, experiment = loop.scenario(case), loop.experiment(case)
    fmu = loaded.system.components["controller"]
    driven = {target: (source, *way) for source, target, *way in loaded.system.connections}
    driven = {target: source for target, source in driven.items() if target.startswith(OWN)}
    in_loop = replace(experiment, record=tuple(source for source, *_ in driven.values()))
    given = _done(loop, Job(loaded.system, experiment, loop.timeout), in_loop, recordings_of).result
    signals = {name: value for name, value in experiment.signals.items() if name.startswith(OWN)}
    for target, (source, *transformations) in driven.items():
        values = given[source]
        for transformation in transformations:
            values = transformation(values)
        signals[target] = Table(given.time, values, hold=True)
    output = next(v.name for v in of_causality(describe(fmu), "output") if v.type != "String")
    return System({"controller": fmu}), replace(
        experiment,
        parameters={n: v for n, v in experiment.parameters.items() if n.startswith(OWN)},
        inputs={n: v for n, v in experiment.inputs.items() if n.startswith(OWN)},
        signals=signals,
        faults=(),
        record=(OWN + output,),
    )


def _done(loop: ClosedLoop, job: Job, experiment: Experiment, reduce: Reduce) -> Done:
    """Returns the only run of an experiment; SimulationError if it failed."""
    (done,) = loop.make(job, [Run(None, experiment, reduce)])
    if isinstance(done.result, Failure):
        raise SimulationError(done.result.reason, None)
    return done


def _last(runs: Recording) -> list[float]:
    return runs.values[:, -1, 0].tolist()


def _fmu(loop: ClosedLoop) -> dict[str, Any]:
    path = loop.scenario(loop.protocol.nominal).system.components["controller"]
    description = describe(path)
    return {
        "model": description.modelName,
        "guid": description.guid,
        "tool": description.generationTool or "",
        "sha256": digest(path.read_bytes()),
    }


def repeated(protocol: Protocol, seed: int) -> dict[str, list[Case]]:
    """Returns case -> its draws of a full score, of each case that does not repeat the nominal one."""
    drawn = repeated_cases(protocol, seed, protocol.tables.repetitions)
    return {draws[0].name: draws for draws in drawn if not draws[0].repeats_nominal}
