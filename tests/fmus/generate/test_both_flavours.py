"""What an importer may rely on whichever flavour it loads, besides what the rules of the check say."""

from pathlib import Path
from typing import Any


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
