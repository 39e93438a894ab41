"""Foreign importers run the closed loop as our master does."""

import subprocess
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.exchange.ssp_xml import STRUCTURE, SspVersion
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from tests.importers.comparison import SCENARIOS, least_difference, outcome, packaged, trajectory
from tests.importers.importers import IMPORTERS, ImporterJob, Trajectory

pytestmark = pytest.mark.importers

# All exchange as Jacobi does, at t_i, so that only the rounding of t_i differs: one counts steps, another
# adds them up and ends at 310.000000000008 s. Below, this alone moves our own master's depth by some 1e-10 m.
ROUNDING_OF_TIME = 1e-9
STEP_SHIFT = {"fmpy_ssp": 1, "libcosim": 0, "ecos": 0, "fmucontainer": 0, "omsimulator": 0}


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("importer", IMPORTERS)
def test_the_depth_is_that_of_this_master(
    importer: str, name: str, jobs: dict[str, ImporterJob], ours: dict[str, Recording]
) -> None:
    answer = trajectory(importer, jobs[name])
    assert len(answer.values) >= 15500
    shift, difference = least_difference(answer, ours[name], jobs[name])
    assert difference < ROUNDING_OF_TIME
    assert shift == STEP_SHIFT[importer]


@pytest.fixture(scope="module")
def package_of_ssp_2(tmp_path_factory: pytest.TempPathFactory, loaded: Mapping[str, Scenario]) -> ImporterJob:
    folder = tmp_path_factory.mktemp("ssp 2")
    return packaged(loaded["nominal-l1"], folder, SspVersion.V2)


# fmpy.ssp 0.3.32 and Ecos 0.7.2 refuse the version
READ_SSP_2 = [name for name in ("libcosim", "fmucontainer", "omsimulator") if name in IMPORTERS]


@pytest.mark.parametrize("importer", READ_SSP_2)
def test_the_depth_is_that_of_this_master_from_a_package_of_ssp_2(
    importer: str, package_of_ssp_2: ImporterJob, ours: dict[str, Recording]
) -> None:
    answer = trajectory(importer, package_of_ssp_2)
    assert least_difference(answer, ours["nominal-l1"], package_of_ssp_2)[1] < ROUNDING_OF_TIME


def test_files_of_ssp_2_follow_its_schemas(package_of_ssp_2: ImporterJob, tmp_path: Path) -> None:
    """As pyssp_standard has them, with XML Schema 1.1, and its reader reads what is written."""
    from pyssp_standard.ssd import SSD  # which takes longer to import than other tests may
    from pyssp_standard.ssv import SSV

    with zipfile.ZipFile(package_of_ssp_2.package) as archive:
        archive.extractall(tmp_path)
    files = [*map(SSD, tmp_path.glob("*.ssd")), *map(SSV, tmp_path.glob("parameters/*.ssv"))]
    assert len(files) > 2
    for file in files:
        assert file.version == "2.0"
        file.__check_compliance__()
    read: Any = SSD(tmp_path / STRUCTURE)
    assert len(read.connections()) == 5
    assert {element.name for element in read.system.elements} == {
        "controller", "plant", "depth_reference"
    }  # fmt: skip


def test_fmpy_applies_the_parameter_set_of_another_scenario_when_it_is_named(
    jobs: dict[str, ImporterJob], ours: dict[str, Recording]
) -> None:
    """Each set has every value that one of them has, as the FMUs start with those of the packaged one."""
    job = replace(jobs["nominal-extended"], parameter_set="nominal-l1")
    answer = trajectory("fmpy_ssp", job)
    assert least_difference(answer, ours["nominal-l1"], job)[1] < ROUNDING_OF_TIME


def test_adding_up_steps_explains_the_difference(
    ours: dict[str, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    def added_up(self: Experiment) -> np.ndarray:
        return np.cumsum(np.r_[0.0, np.full(15500, self.step_size)])

    chosen = scenario.load(scenario.find("nominal-extended"))
    monkeypatch.setattr(Experiment, "time_grid", added_up)
    moved = simulate(chosen.system, chosen.experiment)
    assert moved.time[-1] == pytest.approx(310.0, abs=1e-10)  # the size of the drift itself
    difference = np.max(np.abs(moved["plant.depth"] - ours["nominal-extended"]["plant.depth"]))
    assert 1e-11 < difference < ROUNDING_OF_TIME


def test_the_scenarios_differ_by_far_more_than_importers_do(ours: dict[str, Recording]) -> None:
    """So that the test detects FMUs that do not start with the values of the scenario."""
    extended, plain = (ours[name]["plant.depth"] for name in SCENARIOS)
    assert np.max(np.abs(extended - plain)) > 0.1


@pytest.mark.parametrize("importer", IMPORTERS)
def test_packages_and_extraction_in_folders_of_any_name_work(
    importer: str, jobs: dict[str, ImporterJob], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a space #1 + 2 %20 [x] (y) Tiefe-äø 水深"
    folder.mkdir()
    short = replace(jobs["nominal-extended"], stop_time=1.0)
    plain = trajectory(importer, short)
    package = folder / "loop.ssp"
    package.write_bytes(short.package.read_bytes())
    monkeypatch.setattr("tempfile.tempdir", str(folder))  # where importers extract
    odd = trajectory(importer, replace(short, package=package))
    np.testing.assert_array_equal(odd.values, plain.values)


@pytest.mark.parametrize("importer", IMPORTERS)
def test_an_importer_asked_for_the_last_value_alone_gives_the_same(
    importer: str, jobs: dict[str, ImporterJob]
) -> None:
    short = replace(jobs["nominal-extended"], stop_time=1.0)
    every, last = trajectory(importer, short), trajectory(importer, replace(short, report_every=50))
    assert last.values[-1] == every.values[-1]


def test_the_command_writes_a_row_for_each_importer_and_scenario(scenario_fmus: None) -> None:
    command = [sys.executable, "-m", "tests.importers"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    lines = [line for line in printed.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    assert {(row[0], row[2]) for row in rows} == {(i, s) for i in IMPORTERS for s in SCENARIOS}
    assert all(float(row[3].removesuffix(" m")) < ROUNDING_OF_TIME for row in rows)


def test_a_crash_is_a_row(jobs: dict[str, ImporterJob], ours: dict[str, Recording], tmp_path: Path) -> None:
    nowhere = replace(jobs["nominal-l1"], package=tmp_path / "nothing.ssp")
    row = outcome("fmpy_ssp", nowhere, ours["nominal-l1"])
    assert "ended with exit status 1: FileNotFoundError" in row.problem


def test_a_shift_of_labels_is_found_and_not_hidden(
    jobs: dict[str, ImporterJob], ours: dict[str, Recording]
) -> None:
    run = ours["nominal-l1"]
    late = Trajectory(run.time[:-2], run["plant.depth"][2:, None])
    assert least_difference(late, run, jobs["nominal-l1"]) == (2, 0.0)
