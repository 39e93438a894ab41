"""Errors and warnings around FMUs, in words that say what to do next."""

from typing import Any

# those of one FMU stand with the FMU
from fmus.errors import FmuError, FmuLoadError, FmuWarning, OrchestrationError  # noqa: F401


class ScenarioError(OrchestrationError):
    """A scenario file that says something wrong or not enough."""


class SweepError(OrchestrationError):
    """A sweep that cannot begin, or cannot go on; what is done is kept."""


class SystemDefinitionError(OrchestrationError):
    """Components and connections that do not fit; found before anything is loaded."""


class EnsembleError(SystemDefinitionError):
    """An error: an `Ensemble` cannot run this, but a `Simulator` can."""


class ScenarioWarning(UserWarning):
    """A warning: a scenario inherits what it cannot use, and drops it or cuts it to what it can use."""


class SimulationError(OrchestrationError):
    """A run that ended early; `recording` holds what was recorded until then."""

    def __init__(self, reason: str, recording: Any) -> None:
        super().__init__(reason, recording)
        self.reason, self.recording = reason, recording

    def __str__(self) -> str:
        return self.reason
