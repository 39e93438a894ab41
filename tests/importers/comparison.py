"""Our master against other importers: the same package, one output at the same communication points."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from rich.table import Table

from orchestration.cli.ramp_sources import build_ramp_source
from orchestration.exchange import ssp_write
from orchestration.exchange.ssp_read import opened
from orchestration.master import simulate
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from tests.importers.importer_job import ImporterJob, Trajectory
from tests.importers.worker import run_job
from tests.isolated import answer_of

DISTRIBUTIONS = {
    "fmpy_ssp": "fmpy",
    "libcosim": "libcosimpy",
    "ecos": "ecospy",
    "fmucontainer": "fmu-manipulation-toolbox",
}
SCENARIOS = ("nominal-extended", "nominal-l1")
_LONGEST_S = 300.0
_SHIFTS = (0, 1, -1, 2, -2)


@dataclass(frozen=True)
class Outcome:
    """How one importer ran one scenario.

    output: "component.variable" that is compared; unit: of this output
    shift: communication steps that the importer's labels are early: the shift with the least difference
    difference: largest difference of the output from our master's, labels shifted by that
    problem: why there is no difference
    """

    importer: str
    version: str
    scenario: str
    output: str
    unit: str
    shift: int = 0
    difference: float = float("nan")
    problem: str = ""


def outcomes(folder: Path) -> Iterator[Outcome]:
    """Every importer on every scenario; packages are written to `folder`."""
    for name in SCENARIOS:
        chosen = scenario.load(scenario.find(name))
        package = ssp_write.package(chosen, folder / f"{name}.ssp", build_ramp_source)
        with opened(package) as loop:
            ours = simulate(loop.system, loop.experiment)
        experiment = chosen.experiment
        times = experiment.start_time, experiment.stop_time, experiment.step_size
        for importer in DISTRIBUTIONS:
            yield outcome(importer, ImporterJob(package, name, compared_output(chosen, ours), *times), ours)


def compared_output(chosen: Scenario, recording: Recording) -> str:
    """The signal of the scenario's first metric; without metrics, the first that is recorded."""
    return next((str(metric["signal"]) for metric in chosen.metrics.values()), recording.names[0])


def outcome(importer: str, job: ImporterJob, ours: Recording) -> Outcome:
    """One importer on one package."""
    blank = Outcome(importer, "", job.parameter_set, job.output, ours.unit(job.output))
    try:
        blank = replace(blank, version=version(DISTRIBUTIONS[importer]))
    except PackageNotFoundError:
        return replace(blank, problem="not installed")
    answer = run_isolated(importer, job)
    if isinstance(answer, str):
        return replace(blank, problem=answer)
    points = (job.stop_time - job.start_time) / job.step_size
    if len(answer.time) < round(points) or not np.all(np.isfinite(answer.values)):
        return replace(blank, problem=f"gave {len(answer.time)} of {round(points) + 1} points, or no numbers")
    shift, difference = least_difference(answer, ours, job)
    return replace(blank, shift=shift, difference=difference)


def run_isolated(importer: str, job: ImporterJob) -> Trajectory | str:
    """The importer's trajectory, or why there is none."""
    return answer_of(run_job, (importer, job), _LONGEST_S)


def least_difference(answer: Trajectory, ours: Recording, job: ImporterJob) -> tuple[int, float]:
    """(shift, difference) as `Outcome` has them."""
    points = np.rint((answer.time - job.start_time) / job.step_size).astype(int)
    differences = {shift: _difference(answer.values, points + shift, ours[job.output]) for shift in _SHIFTS}
    shift = min(differences, key=lambda shift: differences[shift])
    return shift, differences[shift]


def _difference(values: np.ndarray, points: np.ndarray, ours: np.ndarray) -> float:
    there = (points >= 0) & (points < len(ours))
    return float(np.max(np.abs(values[there] - ours[points[there]])))


_HEADINGS = ("Importer", "Version", "Scenario", "Output", "Largest difference", "Labels early by")


def _cells(outcome: Outcome) -> tuple[str, ...]:
    difference = outcome.problem or f"{outcome.difference:.1e} {outcome.unit}".strip()
    shift = "" if outcome.problem else f"{outcome.shift} steps" if outcome.shift != 1 else "1 step"
    return outcome.importer, outcome.version, outcome.scenario, outcome.output, difference, shift


def table(outcomes: list[Outcome]) -> Table:
    table = Table(title="Our master against other importers")
    for heading in _HEADINGS:
        table.add_column(heading, overflow="fold")
    for outcome in outcomes:
        table.add_row(*_cells(outcome))
    return table
