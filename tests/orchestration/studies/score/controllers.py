"""Controllers that misbehave in the loop of the protocol."""

from pathlib import Path

from orchestration.studies.score.closed_loop import Controller
from tests.foreign_fmus import Misdeed


def rogue_doing(fmu: Path, misdeed: Misdeed) -> Controller:
    """A controller that misbehaves after a second of the run."""
    return Controller(
        misdeed.name.lower(),
        str(fmu),
        parameters={"misdeed": misdeed.name.lower(), "misdeed_time": 1.0},
        mapping={"depth_reference": "u", "control_force": "y"},
    )
