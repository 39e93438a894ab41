"""One FMU instance: loaded, called through arrays bound once, and always freed.

Every call that an FMU refuses becomes a FmuError with the FMU's own words.
"""

import contextlib
import ctypes
import itertools
import tempfile
import warnings
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription, ScalarVariable

from fmus.platforms import host_platform, library_name
from orchestration.errors import FmuError, FmuLoadError, FmuWarning

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_REFUSED_FROM = 2  # discard and worse
_ERROR, _FATAL = 3, 4
_MOST_MESSAGES = 10  # in an error or a warning
_LAST_SUCCESSFUL_TIME = 2  # of fmi2StatusKind

# FMI type -> (ctypes element, name of getter and setter)
_TYPES = {
    "Real": (fmi2.fmi2Real, "Real"),
    "Integer": (fmi2.fmi2Integer, "Integer"),
    "Enumeration": (fmi2.fmi2Integer, "Integer"),
    "Boolean": (fmi2.fmi2Boolean, "Boolean"),
}


class Log(list[tuple[int, str]]):
    """What an instance has said since it was last judged, as (status, message), repetitions left out.

    error_logged: shape (1,), not 0 once that was an error; the communication loop looks at it
    """

    def __init__(self) -> None:
        super().__init__()
        self.error_logged = np.zeros(1, np.int64)

    def clear(self) -> None:
        super().clear()
        self.error_logged[0] = 0


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


# by a number of the instance, which its callbacks carry: two instances in a process may have one name
_logs: dict[int, Log] = {}
_numbers = itertools.count(1)


def _keep_log(
    environment: int | None,
    instance: bytes | None,
    status: int,
    category: bytes | None,
    message: bytes | None,
) -> None:
    log = _logs.get(environment or 0)
    if log is not None:
        entry = status, " ".join((message or b"").decode("utf-8", "replace").split())
        if not log or log[-1] != entry:
            log.append(entry)
        if status in (_ERROR, _FATAL):
            log.error_logged[0] = 1


_logger = fmi2.fmi2CallbackLoggerTYPE(_keep_log)


def _listen(callbacks: fmi2.fmi2CallbackFunctions) -> None:
    """Let FMPy's proxy, which formats messages, pass them on to us.

    It serves the logger that asked last: whoever else used FMPy in this process may have asked since.
    """
    callbacks.logger = _logger
    addLoggerProxy(ctypes.byref(callbacks))


class Values:
    """Variables of one FMI type, read or written in one call through arrays that never move.

    `array` is a NumPy view of what the FMU reads and writes.
    """

    def __init__(self, component: "FmuInstance", fmi_type: str, variables: list[ScalarVariable]) -> None:
        element, name = _TYPES[fmi_type]
        count = len(variables)
        self.variables = variables
        self._component = component
        self._buffer = (element * count)()
        self.array = np.ctypeslib.as_array(self._buffer)
        references = (fmi2.fmi2ValueReference * count)(*[v.valueReference for v in variables])
        self._arguments = (component.handle, references, ctypes.c_size_t(count), self._buffer)
        self._get_name, self._set_name = f"fmi2Get{name}", f"fmi2Set{name}"
        self._getter = getattr(component.library, self._get_name)
        self._setter = getattr(component.library, self._set_name)

    def read(self) -> None:
        """FMU -> array."""
        with self._component.call_in_progress:
            status = self._getter(*self._arguments)
        if status or self._component.log:
            self._component.check_status(self._get_name, status)

    def write(self) -> None:
        """Array -> FMU."""
        with self._component.call_in_progress:
            status = self._setter(*self._arguments)
        if status or self._component.log:
            self._component.check_status(self._set_name, status)


class FmuInstance:
    """An instance of an FMI 2.0 co-simulation FMU, between instantiation and `close`.

    Its library is a copy of its own: what FMI says of all instances after a fatal error ends this one alone.
    """

    def __init__(self, name: str, path: Path, description: ModelDescription) -> None:
        self.name, self.description, self.time = name, description, 0.0
        self._folder = tempfile.TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True)
        self._initialised = self._stepping = self._failed = self._dead = False
        self._number = next(_numbers)
        self.log = _logs[self._number] = Log()
        self.call_in_progress = CallInProgress(1, np.zeros(1, np.int64), np.zeros(1, np.int64))
        self._callbacks = fmi2.fmi2CallbackFunctions(
            allocateMemory=fmi2.defaultCallbacks.allocateMemory,
            freeMemory=fmi2.defaultCallbacks.freeMemory,
            componentEnvironment=self._number,
        )
        self._slave: Any = None
        try:
            _check_platform(path, description)
            fmpy.extract(str(path), self._folder.name)
            with contextlib.chdir(Path.cwd()):  # fmpy changes the folder, and stays there if it fails
                self._slave = fmi2.FMU2Slave(
                    guid=description.guid,
                    unzipDirectory=self._folder.name,
                    modelIdentifier=_identifier(description),
                    instanceName=name,
                    libraryPath=_library(Path(self._folder.name), description),
                )
            self._instantiate()
        except BaseException as error:
            self._unload()
            if isinstance(error, FmuLoadError) or not isinstance(error, Exception):
                raise
            said = "; ".join(message for _, message in self.log) or str(error)
            raise FmuLoadError(f"{name}: {path} cannot be instantiated: {said}") from error

    def _instantiate(self) -> None:
        _listen(self._callbacks)
        self._slave.instantiate(callbacks=self._callbacks, loggingOn=True)
        self._initialised = self._stepping = False

    @property
    def address(self) -> int:
        """Of the instance."""
        return int(self._slave.component)

    def function(self, name: str) -> int:
        """Address of a function of the FMU's library."""
        return int(ctypes.cast(getattr(self.library, name), ctypes.c_void_p).value or 0)

    @property
    def is_fresh(self) -> bool:
        """Instantiated or reset, and not yet initialised."""
        return not self._initialised

    def reset(self) -> bool:
        """Back to the state after instantiation; False if the FMU refuses, and must be loaded anew."""
        status = self._status("fmi2Reset")
        self.log.clear()
        self._dead = self._dead or status == _FATAL
        if status == 0:
            self._initialised = self._stepping = self._failed = False
        return status == 0

    @property
    def handle(self) -> Any:
        return ctypes.c_void_p(self._slave.component)

    @property
    def library(self) -> Any:
        return self._slave.dll

    def values(self, variables: Iterable[ScalarVariable]) -> list[Values]:
        """The variables grouped by FMI type, each group bound for fast reading and writing."""
        groups: dict[str, list[ScalarVariable]] = {}
        for variable in variables:
            if variable.type in _TYPES:
                groups.setdefault(variable.type, []).append(variable)
        return [Values(self, fmi_type, members) for fmi_type, members in groups.items()]

    def set(self, variable: ScalarVariable, value: Any) -> None:
        """Set one variable, outside the loop."""
        self.set_all([(variable, value)])

    def set_all(self, settings: Sequence[tuple[ScalarVariable, Any]]) -> None:
        """Set variables, those of one type in one call, outside the loop."""
        values = {variable.name: value for variable, value in settings}
        for variable, value in settings:
            if variable.type == "String":
                self._call("setString", [variable.valueReference], [str(value)])
        for group in self.values(variable for variable, _ in settings):
            group.array[:] = [values[variable.name] for variable in group.variables]
            group.write()

    def get(self, variable: ScalarVariable) -> Any:
        """Read one variable, outside the loop."""
        (group,) = self.values([variable])
        group.read()
        return group.array[0].item()

    def initialise(self, start_time: float, stop_time: float | None) -> None:
        """Set the experiment up and enter initialisation mode."""
        self.time = start_time
        self._initialised = True
        self._call("setupExperiment", startTime=start_time, stopTime=stop_time)
        self._call("enterInitializationMode")

    def exit_initialization_mode(self) -> None:
        self._call("exitInitializationMode")
        self._stepping = True

    def get_fmu_state(self, state: int | None = None) -> int:
        """The FMU's own state; one saved before, if given, is overwritten."""
        pointer = ctypes.c_void_p(state)
        self.check_status("fmi2GetFMUstate", self._status("fmi2GetFMUstate", ctypes.byref(pointer)))
        return int(pointer.value or 0)

    def set_fmu_state(self, state: int) -> None:
        self.check_status("fmi2SetFMUstate", self._status("fmi2SetFMUstate", ctypes.c_void_p(state)))
        self._failed = False

    def free_fmu_state(self, state: int) -> None:
        """Give a saved state back; after fatal it goes with the library."""
        if self._dead:
            return
        pointer = ctypes.c_void_p(state)
        self.check_status("fmi2FreeFMUstate", self._status("fmi2FreeFMUstate", ctypes.byref(pointer)))

    def serialize_fmu_state(self, state: int) -> bytes:
        """A saved state as bytes, which another instance of this FMU can take."""
        size = ctypes.c_size_t()
        saved = ctypes.c_void_p(state)
        status = self._status("fmi2SerializedFMUstateSize", saved, ctypes.byref(size))
        self.check_status("fmi2SerializedFMUstateSize", status)
        content = ctypes.create_string_buffer(size.value)
        status = self._status("fmi2SerializeFMUstate", saved, content, size)
        self.check_status("fmi2SerializeFMUstate", status)
        return content.raw

    def deserialize_fmu_state(self, content: bytes) -> int:
        """The inverse of `serialize_fmu_state`."""
        state, length = ctypes.c_void_p(), ctypes.c_size_t(len(content))
        status = self._status("fmi2DeSerializeFMUstate", content, length, ctypes.byref(state))
        self.check_status("fmi2DeSerializeFMUstate", status)
        return int(state.value or 0)

    def last_successful_time(self) -> float | None:
        """Up to where a discarded step was computed [s]; None if the FMU does not tell."""
        time = ctypes.c_double()
        status = self._status("fmi2GetRealStatus", _LAST_SUCCESSFUL_TIME, ctypes.byref(time))
        self._remember(status)
        return time.value if status == 0 else None

    def do_step(self, t: float, h: float) -> None:
        """Advance from t to t + h seconds."""
        self.time = t
        status = self._status("fmi2DoStep", ctypes.c_double(t), ctypes.c_double(h), 1)
        if status or self.log:
            self.check_status("fmi2DoStep", status)

    def check_status(self, call: str, status: int) -> None:
        """Raise FmuError for a refused call, warn for a warning; keep the log empty.

        A call that returned ok but logged an error is refused too: some FMUs can say it only so.
        """
        log = list(self.log)
        self.log.clear()
        worst = max([status, *(s for s, _ in log if s in (_ERROR, _FATAL))])
        self._remember(status)
        name = _STATUS[worst] if worst < len(_STATUS) else f"status {worst}"
        messages = _shortened([message for _, message in log])
        if worst >= _REFUSED_FROM:
            raise FmuError(self.name, self.time, call, name, messages)
        if worst:
            said = "; ".join(messages) or "it logged nothing"
            warnings.warn(f"{self.name} at t = {self.time:.9g} s: {call}: {said}", FmuWarning, stacklevel=2)

    def _remember(self, status: int) -> None:
        self._failed = self._failed or status >= _ERROR
        self._dead = self._dead or status == _FATAL

    def close(self) -> None:
        """Terminate and free the instance, unload its library, remove its folder.

        FMI forbids to terminate what has returned an error, and any call of what has returned fatal.
        """
        try:
            if self._stepping and self._slave is not None and not (self._failed or self._dead):
                self._dead = self._status("fmi2Terminate") == _FATAL
            if self._slave is not None and not self._dead:
                self._status("fmi2FreeInstance")
        finally:
            self._unload()

    def _unload(self) -> None:
        if self._slave is not None:
            self._slave.freeLibrary()
            self._slave = None
        _logs.pop(self._number, None)
        self._folder.cleanup()

    def _status(self, function: str, *arguments: Any) -> int:
        """What a function of the library answers for the instance."""
        with self.call_in_progress:
            return getattr(self.library, function)(self.handle, *arguments)

    def _call(self, method: str, *arguments: Any, **options: Any) -> None:
        call = f"fmi2{method[0].upper()}{method[1:]}"
        try:
            with self.call_in_progress:
                status = getattr(self._slave, method)(*arguments, **options) or 0
        except FMICallException as error:
            status = error.status
        self.check_status(call, status)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _shortened(messages: list[str]) -> list[str]:
    """Each once, and no more than can be read."""
    different = list(dict.fromkeys(messages))
    left = len(different) - _MOST_MESSAGES
    return [*different[:_MOST_MESSAGES], *([f"and {left} more"] if left > 0 else [])]


def _identifier(description: ModelDescription) -> str:
    interface = description.coSimulation
    return str(interface.modelIdentifier) if interface else ""


def _library(folder: Path, description: ModelDescription) -> str | None:
    """The library of this very platform; None for the one that FMPy takes, which knows no ARM in FMI 2.0."""
    library = folder / library_name(_identifier(description), host_platform())
    return str(library) if library.is_file() else None


def _check_platform(path: Path, description: ModelDescription) -> None:
    available = fmpy.supported_platforms(str(path))
    with zipfile.ZipFile(path) as archive:
        is_here = library_name(_identifier(description), host_platform()) in archive.namelist()
    if fmpy.platform not in available and not is_here:
        found = ["C sources" if each == "c-code" else each for each in available]
        raise FmuLoadError(f"{path} has no binary for {fmpy.platform}: it has {', '.join(found) or 'none'}")
