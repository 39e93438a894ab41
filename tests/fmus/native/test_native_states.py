"""A saved state of the native FMU is all of it, exactly, and no other FMU's."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fmus.build import builder
from tests.shared_builds import Fmus


def test_another_process_goes_on_from_the_bytes(built: Fmus, load: Any, tmp_path: Path) -> None:
    fmu = load(built["RovDepthPlant"]).begin()
    fmu["voltage[1]"] = 2.0
    fmu.slave.doStep(0.0, 0.02)
    (tmp_path / "state").write_bytes(fmu.slave.serializeFMUstate(fmu.slave.getFMUstate()))
    script = """
import json, pathlib, sys, fmpy
from fmpy.fmi2 import FMU2Slave
path, state, folder = sys.argv[1:]
fmpy.extract(path, folder)
description = fmpy.read_model_description(path)
slave = FMU2Slave(guid=description.guid, unzipDirectory=folder, instanceName="other",
                  modelIdentifier=description.coSimulation.modelIdentifier)
slave.instantiate()
slave.setFMUstate(slave.deSerializeFMUstate(pathlib.Path(state).read_bytes()))
slave.doStep(0.02, 0.02)
print(json.dumps(slave.getReal([v.valueReference for v in description.modelVariables if v.type == "Real"])))
"""
    files = (built["RovDepthPlant"], tmp_path / "state", tmp_path / "extracted")
    command = [sys.executable, "-c", script, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    fmu.slave.doStep(0.02, 0.02)
    block = builder.load_block("RovDepthPlant")
    real = [v.value_reference for v in (*block.variables, *block.states) if v.type == "Real"]
    assert json.loads(done.stdout) == fmu.slave.getReal(real)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-1], "wrong size"),
        (lambda data: b"", "not a serialized state"),
        (lambda data: b"x" + data[1:], "not a serialized state"),
        (lambda data: data[:8] + b"\x01" + data[9:], "another version's format"),
        (lambda data: data[:300] + bytes([data[300] ^ 1]) + data[301:], "damaged"),
        (None, "another FMU's"),
    ],
)
def test_bytes_that_are_not_this_fmus_are_refused(built: Fmus, load: Any, damage: Any, message: str) -> None:
    plant, other = load(built["RovDepthPlant"]).begin(), load(built["ExamplePlant"]).begin()
    plant.slave.doStep(0.0, 0.02)
    saved = plant.slave.getFMUstate()
    data = (plant if damage else other).slave.serializeFMUstate(
        (plant if damage else other).slave.getFMUstate()
    )
    before = plant["depth"]
    assert plant.status("deSerializeFMUstate", damage(data) if damage else data) == "error"
    assert message in plant.log[-1]
    assert plant["depth"] == before
    plant.slave.setFMUstate(saved)  # the way on after an error
    plant.slave.doStep(0.02, 0.02)


def test_a_restored_state_leaves_the_stop_time_of_the_setup(built: Fmus, load: Any) -> None:
    """Wherever the state is from: the end is what the importer said to this instance."""
    plant = load(built["ExamplePlant"])
    before_setup = plant.slave.getFMUstate()
    plant.slave.setupExperiment(startTime=0.0, stopTime=1.0)
    plant.slave.setFMUstate(before_setup)
    plant.slave.enterInitializationMode()
    plant.slave.exitInitializationMode()
    at_start = plant.slave.getFMUstate()
    assert plant.status("doStep", 0.0, 1.1) == "error"
    assert plant.log[-1] == "fmi2DoStep: step to 1.1 s: expected at most the stop time 1 s"
    plant.slave.setFMUstate(at_start)
    plant.slave.doStep(0.0, 1.0)

    content = plant.slave.serializeFMUstate(plant.slave.getFMUstate())
    never_set_up = load(built["ExamplePlant"])
    never_set_up.slave.setFMUstate(never_set_up.slave.deSerializeFMUstate(content))
    never_set_up.slave.doStep(1.0, 1e3)

    plant.slave.reset()
    plant.slave.setFMUstate(at_start)
    plant.slave.doStep(0.0, 1.1)
