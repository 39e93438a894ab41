"""Errors and warnings around FMUs."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# errors of one FMU stand with the FMU
from fmus.errors import FmuError, FmuLoadError, FmuWarning, OrchestrationError  # noqa: F401

Key = str | tuple[str | int, ...]
"""A variable, "component.variable", or the keys of an entry of a scenario: ("experiment", "step_size")."""


class InputError(OrchestrationError):
    """An error in a file, an option or an argument.

    about: the names and keys that a file is searched for, to add the line
    place: begins the message, such as "gains.toml:2: "; no file is searched then
    """

    def __init__(self, message: str, *about: Key, place: str = "") -> None:
        super().__init__(f"{place}{message}")
        self.about, self.is_placed = about, bool(place)


@contextmanager
def about(*keys: Key) -> Iterator[None]:
    """Adds keys to `InputError.about` of an error that is raised inside."""
    try:
        yield
    except InputError as error:
        error.about = (*error.about, *keys)
        raise


class ScenarioError(InputError):
    """An error in a scenario file."""


class SweepError(OrchestrationError):
    """An error of a sweep that cannot begin or go on; finished runs are kept."""


class SystemDefinitionError(InputError):
    """An error of components, connections or settings that do not fit, found before anything is loaded."""


class EnsembleError(SystemDefinitionError):
    """An error: an `Ensemble` cannot run this, but a `Simulator` can."""


class ScenarioWarning(UserWarning):
    """A warning: a scenario inherits what it cannot use, and drops it or cuts it to what it can use."""


class SimulationError(OrchestrationError):
    """An error of a run that ended early.

    Parameters
    ----------
    reason : str
        The cause, in one line, which is the message.
    recording : Recording
        The values until then.
    """

    def __init__(self, reason: str, recording: Any) -> None:
        super().__init__(reason, recording)
        self.reason, self.recording = reason, recording

    def __str__(self) -> str:
        return self.reason
