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


def test_a_state_goes_on_in_an_instance_with_a_later_stop_time(either: dict[str, Path], load: Any) -> None:
    """The stop time is the setup's, and no part of a state."""
    short, long = load(either["RovDepthPlant"]), load(either["RovDepthPlant"])
    for fmu, stop_time in ((short, 0.02), (long, 0.04)):
        fmu.slave.setupExperiment(startTime=0.0, stopTime=stop_time)
        fmu.slave.enterInitializationMode()
        fmu["voltage[1]"] = 2.0
        fmu.slave.exitInitializationMode()
        fmu.slave.doStep(0.0, 0.02)
    content = short.slave.serializeFMUstate(short.slave.getFMUstate())
    long.slave.doStep(0.02, 0.02)
    expected = long["depth"]
    long.slave.setFMUstate(long.slave.deSerializeFMUstate(content))
    long.slave.doStep(0.02, 0.02)
    assert long["depth"] == expected != 0.0


def test_reset_gives_a_new_instance(either: dict[str, Path], load: Any) -> None:
    plant = load(either["RovDepthPlant"])
    plant["initial_depth"] = 1.0
    plant.begin()
    plant.slave.doStep(0.0, 0.02)
    plant.slave.reset()
    plant.begin()
    assert plant["depth"] == 0.0
    assert plant["initial_depth"] == 0.0
