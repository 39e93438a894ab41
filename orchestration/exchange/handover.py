"""Which tools a scenario can be written for, besides SSP packages."""

from enum import StrEnum
from pathlib import Path

from orchestration.exchange import modelica, simulink
from orchestration.scenarios.scenario import Scenario


class Tool(StrEnum):
    """A tool that does not read scenarios."""

    MODELICA = "modelica"
    SIMULINK = "simulink"


_WRITERS = {Tool.MODELICA: modelica.write, Tool.SIMULINK: simulink.write}


def write(tool: Tool, chosen: Scenario, folder: Path) -> Path:
    """Write what the tool needs to a folder; returns the file to open.

    Raises OrchestrationError for what the tool cannot express.
    """
    return _WRITERS[tool](chosen, folder)
