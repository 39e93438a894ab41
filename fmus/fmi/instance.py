"""One FMU instance: loaded, called through arrays bound once, and always freed.

Every call that an FMU refuses becomes an FmuError with the messages that the FMU logged.
"""

import contextlib
import ctypes
import threading
import time
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fmus.errors import FmuError, FmuLoadError, FmuWarning
from fmus.files import extract_archive
from fmus.fmi import binding
from fmus.fmi.binding import BoundInstance, Callbacks, Library, library_member, platform_name, status_name
from fmus.fmi.description import FileVersion, is_independent
from fmus.fmi.fmi3 import Fmi3Library
from fmus.fmi.model_description import ModelDescription, ScalarVariable
from fmus.fmi.variable_types import TRANSFER_TYPE, FmiValue
from fmus.operating_system import foreign_threads

# in an error or a warning
_MOST_MESSAGES = 10


class FmuInstance(BoundInstance, contextlib.AbstractContextManager["FmuInstance"]):
    """An instance of a co-simulation FMU, between instantiation and `close`.

    Raises FmuLoadError if the FMU cannot be loaded.

    is_fresh: whether it was instantiated or reset, and neither set nor initialised since
    has_warned: whether a call returned a warning since it was instantiated or reset
    returned_fatal: whether a call returned fatal, after which FMI forbids further calls
    time [s]: of the present call
    busy: shape (1,), `number` while a call is in progress, else 0; another process can watch it
    calls: shape (1,), number of calls that have returned; another process can watch it
    """

    # After a fatal error, FMI forbids calls of all instances of a library. So each instance has its own
    # library, except instances of native FMUs that this user built: these never return fatal.

    def __init__(self, name: str, path: Path, description: ModelDescription) -> None:
        self.name, self.description, self.time = name, description, 0.0
        self.is_fresh, self._stepping, self._failed, self.returned_fatal = True, False, False, False
        self.has_warned = False
        self.number, self.busy, self.calls = 1, np.zeros(1, np.int64), np.zeros(1, np.int64)
        self.after_call: Callable[[], object] = lambda: None
        self.termination_log: list[str] = []
        callbacks = Callbacks()
        try:
            with contextlib.ExitStack() as resources:
                resources.callback(callbacks.close)
                fmu = resources.enter_context(unpacked(path, description))
                super().__init__(fmu.library, callbacks)
                guid, folder = description.guid or "", fmu.folder / "resources"
                if not self.instantiate(name, guid, folder, logging_on=True):
                    raise RuntimeError(f"{self.library.instantiates} returned NULL")
                self._resources = resources.pop_all()
        except FmuLoadError:
            raise
        except Exception as error:
            reason = "; ".join(message for _, message in callbacks.log) or str(error)
            raise FmuLoadError(f"{name}: {path} cannot be instantiated: {reason}") from error

    @property
    def address(self) -> int:
        """Address of the instance in memory."""
        return (self.handle and self.handle.value) or 0

    def function(self, name: str) -> int:
        """Returns the address of a function of the FMU's library."""
        return ctypes.cast(getattr(self.library, name), ctypes.c_void_p).value or 0

    def reset(self) -> bool:
        """Resets to the state after instantiation; False if the FMU refuses and must be loaded again."""
        status = self.status("fmi2Reset")
        self.log.clear()
        self.returned_fatal = self.returned_fatal or status == binding.FATAL
        if status == 0:
            self.is_fresh, self._stepping, self._failed, self.termination_log = True, False, False, []
            self.has_warned = False
            self.time = 0.0
        return status == 0

    def set(self, variable: ScalarVariable, value: FmiValue) -> None:
        """Sets one variable, outside the loop."""
        self.set_all([(variable, value)])

    def set_all(self, settings: Iterable[tuple[ScalarVariable, FmiValue]]) -> None:
        """Sets variables outside the loop, with one call for each type."""
        # also if a call is refused: calls before it may have set values
        self.is_fresh = False
        groups: dict[str, list[tuple[int, FmiValue | bytes]]] = {}
        for variable, value in settings:
            pair = variable.valueReference, str(value).encode() if variable.type == "String" else value
            groups.setdefault(TRANSFER_TYPE[variable.type], []).append(pair)
        for transfer_type, members in groups.items():
            self.set_values(transfer_type, *zip(*members, strict=True))

    def get(self, variable: ScalarVariable) -> Any:
        """Reads one variable, outside the loop."""
        (value,) = self.get_values(TRANSFER_TYPE[variable.type], [variable.valueReference])
        return (value or b"").decode("utf-8", "replace") if variable.type == "String" else value

    def initialise(
        self,
        start_time: float,
        stop_time: float | None,
        tolerance: float | None = None,
        settings: Iterable[tuple[ScalarVariable, FmiValue]] = (),
    ) -> None:
        """Sets the experiment up and variables, enters initialization mode; tolerance: of its solver."""
        self.time = start_time
        self.is_fresh = False
        self.set_up_experiment(start_time, stop_time, tolerance)
        self.set_all(settings)  # after it: FMUs of 20-sim lose what was set before
        self.enter_initialization_mode()

    def exit_initialization_mode(self) -> None:
        super().exit_initialization_mode()
        self._stepping = True

    def set_fmu_state(self, state: int) -> None:
        super().set_fmu_state(state)
        self.forget_failure()

    def start_anew(self) -> None:
        """Makes the saved state of the FMU the whole state, also of a solver, which then starts again."""

    def forget_failure(self) -> None:
        """Forgets a failure, after the state from before it was set."""
        self._failed = False

    def free_fmu_state(self, state: int) -> None:
        """Frees a saved state; after a fatal error, unloading the library frees it."""
        if not self.returned_fatal:
            super().free_fmu_state(state)

    def last_successful_time(self) -> float | None:
        """Returns the time [s] up to which a discarded step was computed; None if the FMU gives none."""
        time = ctypes.c_double()
        status = self.status("fmi2GetRealStatus", binding.LAST_SUCCESSFUL_TIME, ctypes.byref(time))
        self._remember(status)
        return time.value if status == 0 else None

    def terminates(self) -> bool:
        """Whether the FMU discarded the step because it terminates the simulation (FMI 2.0.5, 4.2.3).

        `termination_log` then holds its messages. An FMU that logged an error has failed.
        """
        if self.log.error_logged[0]:
            return False
        self.termination_log = [message for _, message in self.log]
        answer = ctypes.c_int()
        status = self.status("fmi2GetBooleanStatus", binding.TERMINATED, ctypes.byref(answer))
        self._remember(status)
        return status == 0 and bool(answer.value)

    def status(self, function: str, *arguments: Any) -> int:
        self.busy[0] = self.number
        try:
            return super().status(function, *arguments)
        finally:
            self.after_call()
            self.busy[0] = 0
            self.calls[0] += 1

    def check_status(self, function: str, status: int) -> None:
        """Raises FmuError for a refused call, warns for a warning, and clears the log."""
        # Some FMUs report an error in the log alone: then a call that returned ok counts as refused.
        if not status and not self.log:
            return
        function = self.library.function_called(self.handle, function)
        log = list(self.log)
        self.log.clear()
        logged = [s for s, _ in log if s in (binding.ERROR, binding.FATAL)]
        worst = max([status, *logged]) if status >= binding.OK else status
        self._remember(status)
        messages = _shortened([message for _, message in log])
        if worst not in (binding.OK, binding.WARNING):
            raise FmuError(self.name, self.time, function, status_name(worst), messages)
        if worst:
            self.has_warned = True
            text = "; ".join(messages) or "it logged nothing"
            warnings.warn(
                f"{self.name} at t = {self.time:.9g} s: {function}: {text}", FmuWarning, stacklevel=2
            )

    def _remember(self, status: int) -> None:
        self._failed = self._failed or not binding.OK <= status < binding.ERROR
        self.returned_fatal = self.returned_fatal or status == binding.FATAL

    def close(self) -> None:
        """Terminates and frees the instance, unloads its library, removes its folder.

        An error of fmi2Terminate is a warning, as the run is done.
        """
        # FMI forbids fmi2Terminate after an error, and any call after a fatal error.
        try:
            if self.handle and self._stepping and not (self._failed or self.returned_fatal):
                self.log.clear()
                self.call("fmi2Terminate")
        except FmuError as error:
            warnings.warn(str(error), FmuWarning, stacklevel=2)
        finally:
            if self.handle and not self.returned_fatal:
                self.status("fmi2FreeInstance")
            self.handle = None
            self._resources.close()

    def __exit__(self, *error: object) -> None:
        self.close()


def _shortened(messages: list[str]) -> list[str]:
    """Returns the different messages, at most as many as can be read."""
    different = list(dict.fromkeys(messages))
    left = len(different) - _MOST_MESSAGES
    return [*different[:_MOST_MESSAGES], f"and {left} more"] if left > 1 else different


class UnpackedFmu:
    """The folder of an FMU and its library; users: number of instances that share them."""

    def __init__(self, path: Path, description: ModelDescription) -> None:
        self._temporary = TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True)
        self.folder, self.users = Path(self._temporary.name), 0
        self._threads_before = foreign_threads()
        try:
            self.library = _library(path, description, self.folder)
        except BaseException:
            self._temporary.cleanup()
            raise

    def close(self) -> None:
        """Removes the folder, and unloads the library unless a thread that it started may still run."""
        for _ in range(10):
            if foreign_threads() <= self._threads_before:
                self.library.unload()
                break
            # the system lists a thread of Python for a moment after its end
            time.sleep(0.01)
        self._temporary.cleanup()


_shared: dict[FileVersion, UnpackedFmu] = {}
_lock = threading.Lock()


@contextmanager
def unpacked(path: Path, description: ModelDescription) -> Iterator[UnpackedFmu]:
    """Yields the unpacked FMU of an instance; independent instances of one file share it."""
    fmu, version = _entered(path, description)
    try:
        yield fmu
    finally:
        with _lock:
            fmu.users -= 1
            is_last = not fmu.users
            if is_last and version:
                del _shared[version]
        if is_last:
            fmu.close()


def _entered(path: Path, description: ModelDescription) -> tuple[UnpackedFmu, FileVersion | None]:
    """Acquires the unpacked FMU for one more user; returns it and the key by which it is shared, or None."""
    if not is_independent(description):
        fmu, version = UnpackedFmu(path, description), None
        fmu.users = 1
        return fmu, version
    with _lock:
        version = FileVersion.of(path)
        if version not in _shared:
            _shared[version] = UnpackedFmu(path, description)
        _shared[version].users += 1
        return _shared[version], version


def _library(path: Path, description: ModelDescription, folder: Path) -> Library:
    """Unpacks an FMU and loads its library; of an independent FMU, unpacks library and resources alone."""
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    identifier = description.coSimulation.modelIdentifier
    fmi = int(description.fmiVersion[0])
    member, platform = library_member(names, identifier, fmi), platform_name(fmi)
    if member is None:
        prefix = f"binaries/{platform}/"
        here = [name for name in names if name.startswith(prefix) and name != prefix]
        others = {name.split("/")[1] for name in names if name.startswith("binaries/") and name[-1] != "/"}
        sources = ["C sources"] if any(name.startswith("sources/") for name in names) else []
        available = ", ".join(here or [*sources, *sorted(others)]) or "none"
        named = f" called {identifier}, its modelIdentifier" if here else ""
        # every FMU of PythonFMU has this file
        is_python = "resources/slavemodule.txt" in names
        hint = "; it runs Python: of a block, the native flavour is compiled for each" if is_python else ""
        raise FmuLoadError(f"{path} has no binary for {platform}{named}: it has {available}{hint}")
    needed = [name for name in names if name == member or name.startswith("resources/")]
    extract_archive(path, folder, needed if is_independent(description) else None)
    interface = binding.MODEL_EXCHANGE if description.is_model_exchange else binding.CO_SIMULATION
    if fmi == 3:
        return Fmi3Library(folder / member, interface, description.elements)
    return Library(folder / member, interface)
