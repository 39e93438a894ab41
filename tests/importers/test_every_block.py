"""A package with a component of every block, in every importer: no error, no warning, the same values."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus.generate import builder
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from tests.importers.comparison import least_difference, packaged, trajectory
from tests.importers.importers import IMPORTERS, ImporterJob
from tests.shared_builds import Fmus

pytestmark = pytest.mark.importers

ROUNDING = 1e-12  # of numbers up to 10, over 100 steps
NAMES = builder.block_names()
DEPTH_CONTROLLERS = [name for name in NAMES if name.endswith("DepthController")]
OUTPUTS = (
    ("L1DepthController", "demanded_force"),
    ("ExamplePlant", "output"),
    ("ThrustAllocation", "voltage[1]"),
)
FED = [
    ("DepthReference.depth_reference", "depth_reference"),
    ("RovDepthPlant.measured_depth", "measured_depth"),
]
CONNECTIONS = [
    ("L1DepthController.voltage[1]", "RovDepthPlant.voltage[1]"),
    ("L1DepthController.voltage[2]", "RovDepthPlant.voltage[2]"),
    ("PidDepthController.demanded_force", "ThrustAllocation.control_force"),
    ("L1Controller.control", "ExamplePlant.control"),
    *((f"ExamplePlant.state[{i}]", f"L1Controller.measured_state[{i}]") for i in (1, 2)),
    *((source, f"{name}.{target}") for name in DEPTH_CONTROLLERS for source, target in FED),
]


@pytest.fixture(scope="module")
def job_and_ours(built: Fmus, tmp_path_factory: pytest.TempPathFactory) -> tuple[ImporterJob, Recording]:
    folder = tmp_path_factory.mktemp("every block")
    components = "".join(f'{name} = "{built[name]}"\n' for name in NAMES)
    pairs = ", ".join(f'["{source}", "{target}"]' for source, target in CONNECTIONS)
    (folder / "every.toml").write_text(
        f"connections = [{pairs}]\n"
        f"[components]\n{components}"
        '[experiment]\nstop_time = 2.0\nstep_size = 0.02\nopen_inputs = "start"\n'
        '[inputs]\n"L1Controller.reference" = 1.0\n'
        # FMPy's loop of packages differs by 0.8 with the nonlinear extension, those of the others do not
        '[parameters]\n"L1Controller.augmentation" = "none"\n'
    )
    chosen = scenario.load(folder / "every.toml")
    return packaged(chosen, folder), simulate(chosen.system, chosen.experiment)


# what a container of fmucontainer 2.0 prints of itself, whatever is in it
BANNER = ("FMUContainer 'V2.0'", "Solver configure....", "Container use PARALLEL mode")


def is_complaint(line: str) -> bool:
    named = re.search(r"\b(warn|warning|error|fatal)\b", line, re.IGNORECASE)
    return bool(named) and not any(text in line for text in BANNER)


@pytest.mark.parametrize("importer", IMPORTERS)
def test_every_block_runs_without_an_error_or_a_warning(
    importer: str, job_and_ours: tuple[ImporterJob, Recording]
) -> None:
    """The outputs of three loops in which all blocks are."""
    job, ours = job_and_ours
    for output in OUTPUTS:
        own = replace(job, outputs=(output,))
        answer = trajectory(importer, own)
        assert not [line for line in answer.printed.splitlines() if is_complaint(line)]
        assert np.ptp(answer.values) > 0.0
        assert least_difference(answer, ours, own)[1] < ROUNDING


@pytest.mark.parametrize("importer", IMPORTERS)
def test_fmus_of_the_python_flavour_run_in_importers_that_python_calls(
    importer: str, python_built: Fmus, tmp_path: Path
) -> None:
    """PythonFMU's library takes the interpreter of the process, which an importer without Python lacks."""
    plant, controller = (python_built[name] for name in ("RovDepthPlant", "PidDepthController"))
    (tmp_path / "python.toml").write_text(
        'connections = [["plant.measured_depth", "controller.measured_depth"],'
        ' ["controller.voltage[1]", "plant.voltage[1]"], ["controller.voltage[2]", "plant.voltage[2]"]]\n'
        f'[components]\nplant = "{plant}"\ncontroller = "{controller}"\n'
        '[experiment]\nstop_time = 1.0\nstep_size = 0.02\nopen_inputs = "start"\n'
    )
    chosen = scenario.load(tmp_path / "python.toml")
    job = packaged(chosen, tmp_path)
    answer = trajectory(importer, job)
    assert np.ptp(answer.values) > 0.0
    assert least_difference(answer, simulate(chosen.system, chosen.experiment), job)[1] < ROUNDING
