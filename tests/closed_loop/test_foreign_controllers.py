"""A controller of another tool in the paper's loop: the PID in C of the tutorial, against the block of it.

The tutorial itself, with the same PID from PythonFMU and from Modelica, is among the examples that are slow.
"""

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.block.block_file import write_new_block
from fmus.build import builder
from fmus.files import write_archive
from fmus.native.toolchain import compile_library
from fmus.platforms import host_platform, library_name
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario

FOLDER = Path(__file__).parents[2] / "docs" / "tutorials" / "other-tools"
HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")


@pytest.fixture
def c_pid(tmp_path: Path) -> Path:
    """The FMU of the tutorial's C files."""
    files = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    headers = Path(fmpy.__file__).parent / "c-code"
    sources = {name: (headers / name).read_text(encoding="utf-8") for name in HEADERS}
    sources |= {name: files[name] for name in ("Pid.h", "Pid.c", "fmi.c")}
    library = compile_library("Pid", sources, ["fmi.c", "Pid.c"], host_platform())
    description = files["modelDescription.xml"].encode()
    members = {"modelDescription.xml": description, library_name("Pid", host_platform()): library}
    return write_archive(tmp_path / "c_pid.fmu", members)


def run_with(controller: Path) -> Recording:
    """The first 30 s of the dive, sensor and velocity ideal."""
    overrides: dict[str, Any] = {
        "experiment": {"stop_time": 30.0},
        "metrics": dict.fromkeys(("settling_time", "overshoot", "holding_thrust"), False),
    }
    path = scenario.find("nominal-extended-ideal")
    chosen = scenario.load(path, overrides, settings={"controller": str(controller)})
    return simulate(chosen.system, chosen.experiment)


def test_a_controller_in_c_gives_the_depth_of_the_same_block(
    scenario_fmus: None, c_pid: Path, tmp_path: Path
) -> None:
    (block, *_) = write_new_block("pid", tmp_path)
    own, foreign = run_with(builder.fmu_of_file(block)), run_with(c_pid)
    depth = own["plant.depth"]
    assert depth.max() > 0.2  # m: it dives
    np.testing.assert_allclose(foreign["plant.depth"], depth, rtol=0.0, atol=1e-6)  # m
