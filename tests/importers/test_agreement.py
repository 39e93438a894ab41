"""Foreign importers run the closed loop as our master does."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration.master import simulate
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.system.experiment import Experiment
from tests.importers import comparison
from tests.importers.comparison import DISTRIBUTIONS, SCENARIOS, least_difference, run_isolated
from tests.importers.importer_job import ImporterJob, Trajectory

pytestmark = pytest.mark.importers

OUTPUT = "plant.depth"

# All exchange as Jacobi does, at t_i, so that only the rounding of t_i differs: one counts steps, another
# adds them up and ends at 310.000000000008 s. Below, this alone moves our own master's depth by some 1e-10 m.
ROUNDING_OF_TIME = 1e-9
STEP_SHIFT = {"fmpy_ssp": 1, "libcosim": 0, "ecos": 0, "fmucontainer": 0}


def job(package: Path, name: str, stop_time: float = 310.0) -> ImporterJob:
    return ImporterJob(package, name, OUTPUT, 0.0, stop_time, 0.02)


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("importer", DISTRIBUTIONS)
def test_the_depth_is_that_of_this_master(
    importer: str,
    name: str,
    packages: dict[str, Path],
    ours: dict[str, Recording],
    installed: Callable[[str], str],
) -> None:
    answer = run_isolated(installed(importer), job(packages[name], name))
    assert isinstance(answer, Trajectory), answer
    assert len(answer.values) >= 15500
    shift, difference = least_difference(answer, ours[name], job(packages[name], name))
    assert difference < ROUNDING_OF_TIME
    assert shift == STEP_SHIFT[importer]


def test_adding_up_steps_explains_the_difference(
    ours: dict[str, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    def added_up(self: Experiment) -> np.ndarray:
        return np.cumsum(np.r_[0.0, np.full(15500, self.step_size)])

    chosen = scenario.load(scenario.find("nominal-extended"))
    monkeypatch.setattr(Experiment, "time_grid", added_up)
    moved = simulate(chosen.system, chosen.experiment)
    assert moved.time[-1] == pytest.approx(310.0, abs=1e-10)  # the size of the drift itself
    difference = np.max(np.abs(moved[OUTPUT] - ours["nominal-extended"][OUTPUT]))
    assert 1e-11 < difference < ROUNDING_OF_TIME


def test_the_scenarios_differ_by_far_more_than_importers_do(ours: dict[str, Recording]) -> None:
    """Else an importer that ignores a parameter set would pass."""
    extended, plain = (ours[name][OUTPUT] for name in SCENARIOS)
    assert np.max(np.abs(extended - plain)) > 0.1


@pytest.mark.parametrize("importer", DISTRIBUTIONS)
def test_packages_and_extraction_in_folders_of_any_name_work(
    importer: str,
    packages: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    installed: Callable[[str], str],
) -> None:
    folder = tmp_path / "a space #1 + 2 %20 [x] (y) Tiefe-äø 水深"
    folder.mkdir()
    package = folder / "loop.ssp"
    package.write_bytes(packages["nominal-extended"].read_bytes())
    plain = run_isolated(installed(importer), job(packages["nominal-extended"], "nominal-extended", 1.0))
    monkeypatch.setattr("tempfile.tempdir", str(folder))  # where importers extract
    odd = run_isolated(importer, job(package, "nominal-extended", 1.0))
    assert isinstance(plain, Trajectory), plain
    assert isinstance(odd, Trajectory), odd
    np.testing.assert_array_equal(odd.values, plain.values)


def test_the_command_writes_a_row_for_each_importer_and_scenario(
    installed: Callable[[str], str], scenario_fmus: None
) -> None:
    for importer in DISTRIBUTIONS:
        installed(importer)
    command = [sys.executable, "-m", "tests.importers", "--markdown"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    lines = [line for line in printed.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    assert {(row[0], row[2]) for row in rows} == {(i, s) for i in DISTRIBUTIONS for s in SCENARIOS}
    assert all(float(row[4].removesuffix(" m")) < ROUNDING_OF_TIME for row in rows)


def test_a_crash_is_a_row(packages: dict[str, Path], ours: dict[str, Recording], tmp_path: Path) -> None:
    nowhere = replace(job(packages["nominal-l1"], "nominal-l1"), package=tmp_path / "nothing.ssp")
    found = comparison.outcome("fmpy_ssp", nowhere, ours["nominal-l1"])
    assert "ended with exit status 1: FileNotFoundError" in found.problem


def test_an_importer_that_is_not_installed_is_a_row(
    packages: dict[str, Path], ours: dict[str, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(DISTRIBUTIONS, "ecos", "a distribution that does not exist")
    found = comparison.outcome("ecos", job(packages["nominal-l1"], "nominal-l1"), ours["nominal-l1"])
    assert (found.version, found.problem) == ("", "not installed")


def test_a_shift_of_labels_is_found_and_not_hidden(ours: dict[str, Recording]) -> None:
    run = ours["nominal-l1"]
    late = Trajectory(run.time[:-2], run[OUTPUT][2:])
    assert least_difference(late, run, job(Path(), "nominal-l1")) == (2, 0.0)


def test_the_first_metric_names_the_output_that_is_compared(ours: dict[str, Recording]) -> None:
    chosen = scenario.load(scenario.find("nominal-l1"))
    assert comparison.compared_output(chosen, ours["nominal-l1"]) == OUTPUT
    bare = replace(chosen, metrics={})
    assert comparison.compared_output(bare, ours["nominal-l1"]) == ours["nominal-l1"].names[0]
