"""The hold of a scenario, and runs of it with faults on the loop that are judged in the hold."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import OrchestrationError, ScenarioError, SimulationError
from orchestration.many.job import Failure, Job, Run
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import Make, in_order
from orchestration.results.recording import Recording
from orchestration.scenarios.changes import with_values
from orchestration.scenarios.scenario import Scenario
from orchestration.system.faults import Effect, Fault
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.signals import values_at

QUIET = 3e-3  # m; largest standard deviation while holding, docs/explanation/margins.md
# m, the band of the paper's settling time: a run with a mean farther away holds another depth
MOVED = 0.04
_JUDGED = (
    0.4  # of the time for which the reference is constant, its last part: 100 s to 140 s of 40 s to 140 s
)
_JUDGED_S = 40.0  # the same of the nominal case, whose vehicle is on its way to the target at first


class LoopSignal(StrEnum):
    """The signal where the loop is changed: an input or an output of the plant."""

    CONTROL = "control"
    MEASUREMENT = "measurement"


@dataclass(frozen=True)
class Hold:
    """A hold of `signal`, "component.variable", from `start` to `end` [s]; quiet: its largest deviation."""

    signal: str
    start: float
    end: float
    quiet: float = QUIET


def last_part(signal: str, end: float) -> Hold:
    """Returns the 40 s before a target is left at `end` [s], in which a vehicle that came to it is quiet."""
    return Hold(signal, end - _JUDGED_S, end)


def hold_of(chosen: Scenario, quiet: float = QUIET) -> Hold:
    """Returns the last part of the longest time for which the reference of a metric is constant.

    Raises ScenarioError for a scenario without such a metric, or whose reference is never constant.
    """
    compared = [m for m in chosen.metrics.values() if m.get("signal") and m.get("reference")]
    if not compared:
        raise ScenarioError(
            f"{chosen.name}: no metric compares a signal with a reference: "
            "expected one, or --signal and --window"
        )
    signal, reference = str(compared[0]["signal"]), str(compared[0]["reference"])
    start, end = _constant(chosen, reference)
    return Hold(signal, end - _JUDGED * (end - start), end, quiet)


def _constant(chosen: Scenario, reference: str) -> tuple[float, float]:
    """Returns beginning and end [s] of the longest time for which the reference is constant."""
    experiment = chosen.experiment
    if reference in experiment.inputs:
        return experiment.start_time, experiment.stop_time
    if reference not in experiment.signals:
        raise ScenarioError(f"{chosen.name}: {reference} is no signal: expected --signal and --window")
    times = experiment.time_grid()
    changes = np.flatnonzero(np.diff(values_at(experiment.signals[reference], times)))
    # a stretch begins where a change ends
    edges = np.concatenate([[0], changes + 1, [len(times) - 1]])
    ends = np.concatenate([changes, [len(times) - 1]])
    begins = edges[:-1]
    longest = int(np.argmax(times[ends] - times[begins]))
    if ends[longest] - begins[longest] < 10:
        raise ScenarioError(
            f"{chosen.name}: {reference} is never constant: expected a hold, or --signal and --window"
        )
    return float(times[begins[longest]]), float(times[ends[longest]])


def loop_inputs(prepared: PreparedRun, signal: str, loop_signal: LoopSignal) -> tuple[str, ...]:
    """Returns the inputs of type Real on the loops through the component of the signal, of that signal.

    Raises ScenarioError for a scenario without one.
    """
    plant = signal.partition(".")[0]
    arrows = {(source.component, target.component) for source, target in prepared.system.connections}
    behind, before = _reachable(plant, arrows), _reachable(plant, {(b, a) for a, b in arrows})
    on_loop = behind & before
    inputs = tuple(
        target.name
        for source, target in prepared.system.connections
        if (target if loop_signal is LoopSignal.CONTROL else source).component == plant
        and {source.component, target.component} <= on_loop | {plant}
        and target.variable.type == "Real"
    )
    if not inputs:
        raise ScenarioError(f"no connection of a loop through {plant}: expected a controller behind it")
    return inputs


def _reachable(start: str, arrows: Iterable[tuple[str, str]]) -> set[str]:
    """Returns the components that arrows lead to from `start`."""
    arrows, reached, new = [*arrows], set[str](), {start}
    while new:
        reached |= new
        new = {b for a, b in arrows if a in reached} - reached
    return reached


def _samples(runs: Recording, signal: str, start: float) -> list[np.ndarray]:
    """Returns the samples of a signal from a time [s] on, shape (n,) of each run."""
    samples = runs[signal][:, runs.time >= start]
    if not samples.shape[1] or "terminated" in runs.provenance:
        raise SimulationError("the run ended before the end of the hold", runs)
    return [*samples]


class HoldRuns(AbstractContextManager["HoldRuns"]):
    """Runs of a scenario until the end of its hold.

    make: makes them, by default runners of their own, which `close` ends; timeout: of a run [s]
    """

    def __init__(
        self,
        chosen: Scenario,
        hold: Hold | None = None,
        make: Make | None = None,
        timeout: float | None = None,
    ) -> None:
        self.hold = hold or hold_of(chosen)
        experiment, begin, end = chosen.experiment, self.hold.start, self.hold.end
        first, last = experiment.start_time, experiment.stop_time
        if not first <= begin < end <= last:
            expected = f"expected a part of the run, {first:g} to {last:g} s"
            raise OrchestrationError(f"window {begin:g} to {end:g} s: {expected}")
        self._experiment = replace(
            experiment,
            stop_time=end,
            events=[event for event in experiment.events if event.time <= end],
            faults=[fault for fault in experiment.faults if fault.start < end],
            record=(self.hold.signal,),
        )
        self.prepared = prepare(chosen.system, self._experiment)
        self._local_runs = LocalRuns(1)
        self._make = make or partial(in_order, self._local_runs)
        self._job = Job(chosen.system, self._experiment, timeout)
        start = self.hold.start - self._experiment.time_resolution()
        self._reduce = partial(_samples, signal=self.hold.signal, start=start)
        self.count = 0
        try:
            unchanged = self._samples((), {})
        except BaseException:
            self.close()
            raise
        self.deviation, self.mean = float(unchanged.std()), float(unchanged.mean())

    def is_quiet(
        self,
        inputs: Sequence[str] = (),
        effect: Effect | None = None,
        parameters: Mapping[str, FmiValue] = {},
    ) -> bool:
        """Whether the scenario holds quietly, about where it did, with an effect on some inputs.

        A run that fails does not.
        """
        try:
            samples = self._samples([Fault(name, effect) for name in inputs if effect], parameters)
        except SimulationError:
            return False
        return bool(samples.std() < self.hold.quiet and abs(samples.mean() - self.mean) < MOVED)

    def _samples(self, faults: Sequence[Fault], parameters: Mapping[str, FmiValue]) -> np.ndarray:
        """Returns the signal in the hold, shape (n,).

        Raises SimulationError for a run that failed, OrchestrationError for one whose process ended or was
        ended: its further course is not known.
        """
        self.count += 1
        experiment = replace(self._experiment, faults=(*self._experiment.faults, *faults))
        experiment = with_values(experiment, parameters)
        if parameters:
            # a parameter that does not fit raises here: as a failed run it would count as a lost hold
            prepare(self._job.system, experiment)
        (done,) = self._make(self._job, [Run(0, experiment, self._reduce)])
        if isinstance(done.result, Failure):
            if done.result.cause:
                raise OrchestrationError(done.result.reason)
            raise SimulationError(done.result.reason, None)
        return done.result

    def close(self) -> None:
        """Frees the FMUs."""
        self._local_runs.__exit__()

    def __exit__(self, *error: object) -> None:
        self.close()
