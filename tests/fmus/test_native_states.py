"""A saved state of the native FMU is all of it, exactly, and no other FMU's."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fmus import catalogue


def test_state_is_restored_exactly_also_from_bytes_and_in_another_instance(
    built: dict[str, Path], load: Any
) -> None:
    first, second = load(built["RovDepthPlant"]).begin(), load(built["RovDepthPlant"])
    first["voltage[1]"] = 2.0
    for i in range(10):
        first.slave.doStep(i * 0.02, 0.02)
    state = first.slave.getFMUstate()
    data = first.slave.serializeFMUstate(state)
    first.slave.doStep(0.2, 0.02)
    expected = first["measured_depth"], first["depth"]
    first.slave.setFMUstate(state)
    first.slave.freeFMUstate(state)
    second.slave.setFMUstate(second.slave.deSerializeFMUstate(data))
    for fmu in (first, second):
        fmu.slave.doStep(0.2, 0.02)
        assert (fmu["measured_depth"], fmu["depth"]) == expected


def test_another_process_goes_on_from_the_bytes(built: dict[str, Path], load: Any, tmp_path: Path) -> None:
    fmu = load(built["RovDepthPlant"]).begin()
    fmu["voltage[1]"] = 2.0
    fmu.slave.doStep(0.0, 0.02)
    (tmp_path / "state").write_bytes(fmu.slave.serializeFMUstate(fmu.slave.getFMUstate()))
    script = """
import json, pathlib, sys, fmpy
from fmpy.fmi2 import FMU2Slave
path, state = sys.argv[1:]
description = fmpy.read_model_description(path)
slave = FMU2Slave(guid=description.guid, unzipDirectory=fmpy.extract(path), instanceName="other",
                  modelIdentifier=description.coSimulation.modelIdentifier)
slave.instantiate()
slave.setFMUstate(slave.deSerializeFMUstate(pathlib.Path(state).read_bytes()))
slave.doStep(0.02, 0.02)
print(json.dumps(slave.getReal([v.valueReference for v in description.modelVariables if v.type == "Real"])))
"""
    command = [sys.executable, "-c", script, str(built["RovDepthPlant"]), str(tmp_path / "state")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    fmu.slave.doStep(0.02, 0.02)
    real = [v.value_reference for v in catalogue.load_block("RovDepthPlant").variables if v.type == "Real"]
    assert json.loads(done.stdout) == fmu.slave.getReal(real)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-1], "wrong size"),
        (lambda data: b"", "not a serialized state"),
        (lambda data: b"x" + data[1:], "not a serialized state"),
        (lambda data: data[:8] + b"\x02" + data[9:], "another version's format"),
        (lambda data: data[:300] + bytes([data[300] ^ 1]) + data[301:], "damaged"),
        (None, "another FMU's"),
    ],
)
def test_bytes_that_are_not_this_fmus_are_refused(
    built: dict[str, Path], load: Any, damage: Any, message: str
) -> None:
    plant, other = load(built["RovDepthPlant"]).begin(), load(built["BenchmarkPlant"]).begin()
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


def test_reset_gives_a_new_instance(built: dict[str, Path], load: Any) -> None:
    plant = load(built["RovDepthPlant"])
    plant["initial_depth"] = 1.0
    plant.begin()
    plant.slave.doStep(0.0, 0.02)
    plant.slave.reset()
    plant.begin()
    assert plant["depth"] == 0.0
    assert plant["initial_depth"] == 0.0
