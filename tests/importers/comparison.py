"""Our master against other importers: the same package, the depth at the same communication points."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmus.generate.builder import build_missing
from orchestration.cli.package_fmus import build_ramp_source, build_started
from orchestration.exchange import ssp_write
from orchestration.exchange.ssp_xml import SspVersion
from orchestration.results.recording import Recording
from orchestration.scenarios.scenario import Scenario
from tests.importers.importers import ImporterJob, Trajectory, run_job
from tests.isolated import answer_of

SCENARIOS = ("nominal-extended", "nominal-l1")
OUTPUTS = (("plant", "depth"),)
_LONGEST_S = 300.0
_SHIFTS = (0, 1, -1, 2, -2)


@dataclass(frozen=True)
class Outcome:
    """How one importer ran one scenario.

    shift: communication steps that the importer's labels are early: the shift with the least difference
    difference: largest difference of the depth from our master's, labels shifted by that [m]
    problem: why there is no difference
    """

    importer: str
    scenario: str
    shift: int = 0
    difference: float = float("nan")
    problem: str = ""


def packaged(scenario: Scenario, folder: Path, version: SspVersion = SspVersion.V1) -> ImporterJob:
    """What importers do with a scenario, whose package is written to `folder`."""
    build_missing(scenario.system.components.values())
    path = folder / f"{scenario.name}.ssp"
    package = ssp_write.package(scenario, path, build_ramp_source, build_started, version)
    experiment = scenario.experiment
    times = experiment.start_time, experiment.stop_time, experiment.step_size
    return ImporterJob(package, OUTPUTS, *times)


def run_isolated(importer: str, job: ImporterJob) -> Trajectory | str:
    """The importer's trajectory, or why there is none."""
    return answer_of(run_job, (importer, job), _LONGEST_S)


def trajectory(importer: str, job: ImporterJob) -> Trajectory:
    """The importer's trajectory; AssertionError says why there is none."""
    answer = run_isolated(importer, job)
    assert isinstance(answer, Trajectory), answer
    return answer


def outcome(importer: str, job: ImporterJob, ours: Recording) -> Outcome:
    """One importer on one package."""
    blank = Outcome(importer, job.package.stem)
    answer = run_isolated(importer, job)
    if isinstance(answer, str):
        return replace(blank, problem=answer)
    if len(answer.time) < job.reports or not np.all(np.isfinite(answer.values)):
        return replace(blank, problem=f"gave {len(answer.time)} of {job.reports + 1} points, or no numbers")
    shift, difference = least_difference(answer, ours, job)
    return replace(blank, shift=shift, difference=difference)


def least_difference(answer: Trajectory, ours: Recording, job: ImporterJob) -> tuple[int, float]:
    """(shift, difference) as `Outcome` has them."""
    points = np.rint((answer.time - job.start_time) / job.step_size).astype(int)
    columns = np.column_stack([ours[".".join(output)] for output in job.outputs])
    differences = {shift: _difference(answer.values, points + shift, columns) for shift in _SHIFTS}
    shift = min(differences, key=lambda shift: differences[shift])
    return shift, differences[shift]


def _difference(values: np.ndarray, points: np.ndarray, ours: np.ndarray) -> float:
    there = (points >= 0) & (points < len(ours))
    return float(np.max(np.abs(values[there] - ours[points[there]])))
