"""What can go wrong around FMUs, in words that say what to do next."""

from typing import Any


class OrchestrationError(Exception):
    """Base of every error that a user can put right; its message is one line."""


class ScenarioError(OrchestrationError):
    """A scenario file that says something wrong or not enough."""


class SweepError(OrchestrationError):
    """A sweep that cannot begin, or cannot go on; what is done is kept."""


class SystemDefinitionError(OrchestrationError):
    """Components and connections that do not fit; found before anything is loaded."""


class EnsembleError(SystemDefinitionError):
    """What an `Ensemble` cannot run, and a `Simulator` can."""


class FmuLoadError(OrchestrationError):
    """A file that is not an FMI 2.0 co-simulation FMU for this platform."""


class FmuError(OrchestrationError):
    """An FMU refused a call. Names the instance, the time and the FMU's own log line."""

    def __init__(self, instance: str, time: float, call: str, status: str, log: list[str]) -> None:
        super().__init__(instance, time, call, status, log)
        self.instance, self.time, self.call, self.status, self.log = instance, time, call, status, log

    def __str__(self) -> str:
        said = "; ".join(self.log) or "it logged nothing"
        return f"{self.instance} at t = {self.time:.9g} s: {self.call} returned {self.status}: {said}"


class FmuWarning(UserWarning):
    """An FMU returned fmi2Warning: the simulation goes on."""


class ScenarioWarning(UserWarning):
    """What a scenario inherits and cannot use is dropped, or cut to what it can use."""


class SimulationError(OrchestrationError):
    """A run that ended early; `recording` holds what was recorded until then."""

    def __init__(self, reason: str, recording: Any) -> None:
        super().__init__(reason, recording)
        self.reason, self.recording = reason, recording

    def __str__(self) -> str:
        return self.reason
