"""A controller of another tool in the paper's loop: the PID in C of the tutorial, against the block of it.

The tutorial itself, with the same PID from PythonFMU and from Modelica, is among the examples that are slow.
"""

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.block.block_file import write_new_block
from fmus.files import write_archive
from fmus.generate import builder
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


JUMP = {"kind": "ramps", "points": [[0.0, 0.0], [1.0, 0.0], [1.02, 3.0]]}  # m: the force is at its limit


def run_with(controller: Path, signals: dict[str, Any], settings: dict[str, Any]) -> Recording:
    """The first 30 s of the dive, sensor and velocity ideal."""
    overrides: dict[str, Any] = {
        "experiment": {"stop_time": 30.0},
        "metrics": dict.fromkeys(("settling_time", "overshoot", "holding_thrust", "lag"), False),
        "signals": signals,
    }
    path = scenario.find("nominal-extended-ideal")
    chosen = scenario.load(path, overrides, settings={"controller": str(controller), **settings})
    return simulate(chosen.system, chosen.experiment)


@pytest.mark.slow
def test_a_controller_in_c_gives_the_depth_of_the_same_block(
    scenario_fmus: None, c_pid: Path, tmp_path: Path
) -> None:
    """On the ramp, and at the limit of the force with and without an integral."""
    (block, *_) = write_new_block("pid", tmp_path)
    jump = {"controller.depth_reference": JUMP}
    for signals, settings, deepest in (
        ({}, {}, 0.2),
        (jump, {}, 2.9),
        (jump, {"controller.ki": 0.0}, 2.9),
    ):
        own, foreign = (run_with(c, signals, settings) for c in (builder.fmu_of_file(block), c_pid))
        depth = own["plant.depth"]
        assert depth.max() > deepest  # m: it dives
        np.testing.assert_allclose(foreign["plant.depth"], depth, rtol=0.0, atol=1e-6)  # m
