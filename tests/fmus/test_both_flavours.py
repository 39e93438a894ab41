"""What an importer may rely on whichever flavour it loads."""

from pathlib import Path
from typing import Any


def test_state_is_restored_exactly_also_from_bytes_and_in_another_instance(
    either: dict[str, Path], load: Any
) -> None:
    first, second = load(either["RovDepthPlant"]).begin(), load(either["RovDepthPlant"])
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


def test_reset_gives_a_new_instance(either: dict[str, Path], load: Any) -> None:
    plant = load(either["RovDepthPlant"])
    plant["initial_depth"] = 1.0
    plant.begin()
    plant.slave.doStep(0.0, 0.02)
    plant.slave.reset()
    plant.begin()
    assert plant["depth"] == 0.0
    assert plant["initial_depth"] == 0.0
