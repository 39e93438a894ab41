"""One FMU instance: loaded, called through arrays bound once, and always freed.

Every call that an FMU refuses becomes an FmuError with the messages that the FMU logged.
"""

import contextlib
import ctypes
import tempfile
import warnings
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import fmpy
import numpy as np
from fmpy.fmi2 import fmi2LastSuccessfulTime, fmi2String
from fmpy.model_description import ModelDescription, ScalarVariable

from fmus.binding import (
    DISCARD,
    ERROR,
    FATAL,
    BoundInstance,
    Callbacks,
    Library,
    library_member,
    reference_array,
    status_name,
)
from orchestration.errors import FmuError, FmuLoadError, FmuWarning
from orchestration.fmi.values import Values, grouped

_MOST_MESSAGES = 10  # in an error or a warning


class CallInProgress:
    """Marks calls of an instance for someone who watches from another process; a context manager.

    busy: shape (1,), `number` while a call is under way, else 0; calls: shape (1,), how many have returned
    """

    def __init__(self, number: int, busy: np.ndarray, calls: np.ndarray) -> None:
        self._number, self._busy, self._calls = number, busy, calls

    def __enter__(self) -> None:
        self._busy[0] = self._number

    def __exit__(self, *reason: object) -> None:
        self._busy[0] = 0
        self._calls[0] += 1


class _PlatformError(FmuLoadError):
    """The FMU has no library for this platform."""


class FmuInstance(BoundInstance):
    """An instance of an FMI 2.0 co-simulation FMU, between instantiation and `close`.

    Its library is a copy of its own: a fatal error, after which FMI forbids calls of any instance,
    ends this instance alone. Raises FmuLoadError if the FMU cannot be loaded.
    """

    def __init__(self, name: str, path: Path, description: ModelDescription) -> None:
        self.name, self.description, self.time = name, description, 0.0
        self._initialised = self._stepping = self._failed = self._dead = False
        self.call_in_progress = CallInProgress(1, np.zeros(1, np.int64), np.zeros(1, np.int64))
        callbacks = Callbacks()
        try:
            with contextlib.ExitStack() as resources:
                resources.callback(callbacks.close)
                folder = Path(resources.enter_context(_temporary_folder()))
                library = _unpacked_library(path, description, folder)
                super().__init__(library, callbacks)
                resources.callback(library.unload)
                if not self.instantiate(name, description.guid or "", folder / "resources", logging_on=True):
                    raise RuntimeError("fmi2Instantiate returned NULL")
                self._resources = resources.pop_all()
        except _PlatformError:
            raise
        except Exception as error:
            reason = "; ".join(message for _, message in callbacks.log) or str(error)
            raise FmuLoadError(f"{name}: {path} cannot be instantiated: {reason}") from error

    @property
    def address(self) -> int:
        """Of the instance in memory."""
        return (self.handle and self.handle.value) or 0

    def function(self, name: str) -> int:
        """Address of a function of the FMU's library."""
        return ctypes.cast(getattr(self.library, name), ctypes.c_void_p).value or 0

    @property
    def is_fresh(self) -> bool:
        """Whether the instance is instantiated or reset, and not yet initialised."""
        return not self._initialised

    def reset(self) -> bool:
        """Reset to the state after instantiation; False if the FMU refuses, and must be loaded anew."""
        status = self.status("fmi2Reset")
        self.log.clear()
        self._dead = self._dead or status == FATAL
        if status == 0:
            self._initialised = self._stepping = self._failed = False
        return status == 0

    def values(self, variables: Iterable[ScalarVariable]) -> list[Values]:
        """The variables grouped by FMI type, each group bound for fast reading and writing."""
        return grouped(self, variables)

    def set(self, variable: ScalarVariable, value: Any) -> None:
        """Set one variable, outside the loop."""
        self.set_all([(variable, value)])

    def set_all(self, settings: Sequence[tuple[ScalarVariable, Any]]) -> None:
        """Set variables, those of one type in one call, outside the loop."""
        values = {variable.name: value for variable, value in settings}
        for variable, value in settings:
            if variable.type == "String":
                text = (fmi2String * 1)(str(value).encode())
                self.call("fmi2SetString", reference_array([variable.valueReference]), 1, text)
        for group in self.values(variable for variable, _ in settings):
            group.array[:] = [values[variable.name] for variable in group.variables]
            group.write()

    def get(self, variable: ScalarVariable) -> Any:
        """Read one variable, outside the loop."""
        (group,) = self.values([variable])
        group.read()
        return group.array[0].item()

    def initialise(self, start_time: float, stop_time: float | None) -> None:
        """Set the experiment up and enter initialization mode."""
        self.time = start_time
        self._initialised = True
        self.set_up_experiment(start_time, stop_time)
        self.enter_initialization_mode()

    def exit_initialization_mode(self) -> None:
        super().exit_initialization_mode()
        self._stepping = True

    def set_fmu_state(self, state: int) -> None:
        super().set_fmu_state(state)
        self._failed = False

    def free_fmu_state(self, state: int) -> None:
        """Free a saved state; after a fatal error nothing is called, the state goes with the library."""
        if not self._dead:
            super().free_fmu_state(state)

    def last_successful_time(self) -> float | None:
        """The time up to which a discarded step was computed [s]; None if the FMU does not provide it."""
        time = ctypes.c_double()
        status = self.status("fmi2GetRealStatus", fmi2LastSuccessfulTime, ctypes.byref(time))
        self._remember(status)
        return time.value if status == 0 else None

    def do_step(self, t: float, h: float) -> None:
        """Advance from t to t + h seconds."""
        self.time = t
        self.call("fmi2DoStep", t, h, 1)

    def status(self, function: str, *arguments: Any) -> int:
        with self.call_in_progress:
            return super().status(function, *arguments)

    def check_status(self, function: str, status: int) -> None:
        """Raise FmuError for a refused call, warn for a warning, and clear the log.

        A call that returned ok but logged an error is refused too: some FMUs report an error only there.
        """
        if not status and not self.log:
            return
        log = list(self.log)
        self.log.clear()
        worst = max([status, *(s for s, _ in log if s in (ERROR, FATAL))])
        self._remember(status)
        messages = _shortened([message for _, message in log])
        if worst >= DISCARD:
            raise FmuError(self.name, self.time, function, status_name(worst), messages)
        if worst:
            text = "; ".join(messages) or "it logged nothing"
            warnings.warn(
                f"{self.name} at t = {self.time:.9g} s: {function}: {text}", FmuWarning, stacklevel=2
            )

    def _remember(self, status: int) -> None:
        self._failed = self._failed or status >= ERROR
        self._dead = self._dead or status == FATAL

    def close(self) -> None:
        """Terminate and free the instance, unload its library, remove its folder.

        FMI forbids fmi2Terminate after an error, and any call after a fatal error.
        """
        try:
            if self.handle and self._stepping and not (self._failed or self._dead):
                self._dead = self.status("fmi2Terminate") == FATAL
            if self.handle and not self._dead:
                self.status("fmi2FreeInstance")
        finally:
            self.handle = None
            self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _shortened(messages: list[str]) -> list[str]:
    """The different messages, at most as many as can be read."""
    different = list(dict.fromkeys(messages))
    left = len(different) - _MOST_MESSAGES
    return [*different[:_MOST_MESSAGES], *([f"and {left} more"] if left > 0 else [])]


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True)


def _unpacked_library(path: Path, description: ModelDescription, folder: Path) -> Library:
    """Unpack an FMU and load its library for this platform."""
    interface = description.coSimulation
    with zipfile.ZipFile(path) as archive:
        member = library_member(archive.namelist(), str(interface.modelIdentifier) if interface else "")
    if member is None:
        available = [
            "C sources" if name == "c-code" else name for name in fmpy.supported_platforms(str(path))
        ]
        raise _PlatformError(
            f"{path} has no binary for {fmpy.platform}: it has {', '.join(available) or 'none'}"
        )
    fmpy.extract(str(path), str(folder))
    return Library(folder / member)
