"""The process that loads an FMU and plays calls on its instances: statuses, messages, memory, settings.

It makes no judgement. Its messages are untrusted, because the FMU controls this process.
"""

import ctypes
import gc
import mmap
import os
import struct
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmus.compliance.called_instance import CalledInstance
from fmus.compliance.instance_parts import MessageLog
from fmus.compliance.model_exchange import CalledModelExchange
from fmus.compliance.process_settings import ProcessSettings
from fmus.compliance.texts import ALLOCATIONS, STEPS, defect
from fmus.fmi.binding import CO_SIMULATION, DISCARD, ERROR, FATAL, WARNING, Library
from fmus.fmi.callbacks import CountingAllocator
from fmus.fmi.process import Parent
from fmus.operating_system import limit_process

if TYPE_CHECKING:
    from fmus.fmi.model_description import Element  # it takes time to import, and FMI 2.0 does without

MOST_MEMORY = 4 << 30  # bytes
MOST_OF_A_FILE = 1 << 30  # bytes
CALLED = "called"  # a file of the working folder: when the call that is under way began, and which it is
BEGAN = struct.Struct("d")  # seconds since the epoch; 0 if none is under way
_ANNOUNCED = struct.Struct("d391sx")  # the content of that file
_DEFECTS = (TypeError, LookupError, NameError, AssertionError, ctypes.ArgumentError)
_OWN = "observed_events", "cpu_time"  # which call nothing
_AFTER_A_FAILURE = {  # status -> functions, and methods of `CalledInstance`, that FMI allows then
    DISCARD: (*_OWN, "free_state", "fmi2SetDebugLogging", "get", "status_of", "fmi2Terminate"),
    ERROR: (*_OWN, "free_state", "fmi2SetDebugLogging"),
}


def _failed(method: str, status: int) -> int:
    """Returns the status that ends a run, if it is one."""
    ends = status in (ERROR, FATAL) or (status == DISCARD and method in STEPS)
    return status if ends else 0


def _loaded(
    path: Path, interface: int, optional: Sequence[str], elements: Sequence["Element"] | None
) -> Library:
    if elements is None:
        return Library(path, interface, optional)
    # it needs NumPy, which takes time to import
    from fmus.fmi.fmi3 import Fmi3Library

    return Fmi3Library(path, interface, elements, is_examined=True)


class LoadedFmu:
    """A loaded library with its instances by number.

    announced: the file `CALLED`
    interface: fmi2Type; optional: functions that may be missing
    elements: of `Fmi3Library`; None of FMI 2.0
    """

    def __init__(
        self, announced: mmap.mmap, library: Path, resources: Path, interface: int,
        optional: Sequence[str], elements: Sequence["Element"] | None,
    ) -> None:  # fmt: skip
        self._library = _loaded(library, interface, optional, elements)
        self._resources = resources
        self._class = CalledInstance if interface == CO_SIMULATION else CalledModelExchange
        self._announced = announced
        self._memory = CountingAllocator()
        self._settings = ProcessSettings()
        self._instances: dict[int, CalledInstance] = {}

    def text(self, function: str) -> tuple[str, bool]:
        """Returns the text of a function without arguments, and whether it has the same address twice."""
        address = ctypes.cast(getattr(self._library, function), ctypes.CFUNCTYPE(ctypes.c_void_p))
        text = getattr(self._library, function)().decode("utf-8", "replace")
        return text, address() == address()

    def blocks(self) -> dict[str, int]:
        """Returns the number of blocks of memory of `allocateMemory` that are in use, how many it has given,
        and how often an address was freed that is not in use.
        """
        memory = self._memory
        return {"held": len(memory.held), "given": memory.given, "foreign frees": memory.foreign_frees}

    def resources_in_use(self) -> dict[str, int]:
        """Returns open files and threads of the process, and bytes of its heap, 0 if unknown."""
        return self._settings.resources_in_use()

    def link(self, name: str) -> str:
        """Returns the location of the resources, as a URI, through a link of that name."""
        link = self._resources.parent.parent / name
        if not link.exists():
            link.symlink_to(self._resources.parent, target_is_directory=True)
        return (link / self._resources.name).as_uri()

    def resource_location(self) -> str:
        return self._resources.as_uri()

    def free_of_null(self) -> None:
        self._announce(b"fmi2FreeInstance(NULL)")
        self._library.free_of_null()

    def _announce(self, call: bytes) -> None:
        """Writes the call that is about to be made into the file `CALLED`, for the case of a crash."""
        # a pending step is one call, however often its status is asked for
        is_poll = call.startswith(b"fmi2GetStatus(")
        began = BEGAN.unpack_from(self._announced)[0] if is_poll else time.time()
        _ANNOUNCED.pack_into(self._announced, 0, began, call)

    def create(self, number: int, options: dict[str, Any]) -> list[Any]:
        """Creates an instance; returns whether the FMU did, messages, changed settings.

        options: see `CalledInstance`
        """
        options = {"location": self._resources.as_uri(), "resources": self._resources, **options}
        instance = self._class(self._library, self._memory, self._settings, options, self._announce)
        self._instances[number] = instance
        return self._observed(instance, instance.create)

    def play(self, number: int, calls: Sequence[Sequence[Any]], keep_going: bool) -> list[list[Any]]:
        """Returns [status, value, messages, changed settings, latest function, latest that
        changed the state] of calls, up to one that fails.

        keep_going: also after a call that fails; what FMI forbids then is not called, and has no answer
        """
        answers: list[list[Any]] = []
        if self._instances[number].handle is None:
            return answers
        failed = 0
        for method, *arguments in calls:
            instance = self._instances[number]
            is_saved = method != "set_state" or instance.holds(*arguments)
            recovers = method == "fmi2Reset" or (method == "set_state" and is_saved)
            forbidden = failed and not recovers and method not in _AFTER_A_FAILURE.get(failed, ())
            if forbidden or not is_saved:
                answers.append([])
                continue
            answer = self._answer(instance, method, arguments)
            answers.append(answer)
            if not keep_going and not 0 <= answer[0] <= WARNING:
                break
            failed = _failed(method, answer[0]) or (0 if recovers else failed)
            if failed == FATAL:
                break
        return answers

    def _answer(self, instance: CalledInstance, method: str, arguments: Sequence[Any]) -> list[Any]:
        is_function = method.startswith("fmi2")
        action = partial(instance.call_with_lists, method) if is_function else getattr(instance, method)
        instance.last_status = 0
        observed = self._observed(instance, partial(action, *arguments))
        return [instance.last_status, *observed, instance.function, instance.mode]

    def _observed(self, instance: CalledInstance, action: Callable[[], Any]) -> list[Any]:
        """Returns the result of an action, the messages meanwhile and changed settings."""
        MessageLog.called = instance.messages
        value = action()
        changed = instance.changed_settings() if instance.watched else []
        self._settings.restore_floating_point()
        return [value, instance.new_messages(), changed]

    def free(self, number: int) -> list[Any]:
        """Frees an instance, unless it does not exist or is fatal; returns as `create`, with its calls."""
        instance = self._instances.pop(number)
        observed = self._observed(instance, instance.free)
        self._settings.restore()
        return observed


def call_fmu(parent: Parent) -> None:
    """Receives a working folder and the arguments of `LoadedFmu`; then calls of its methods.

    Sends [results, error]: results of the calls up to the first error, and that error, or null.
    """
    folder, *arguments = parent.receive()
    # relative paths of the FMU lead there, and the folder is removed afterwards
    os.chdir(folder)
    limit_process(MOST_MEMORY, MOST_OF_A_FILE)
    gc.set_threshold(ALLOCATIONS)
    with Path(os.devnull).open("wb") as stream:
        for standard in (sys.stdout, sys.stderr):
            os.dup2(stream.fileno(), standard.fileno())
    with Path(folder, CALLED).open("w+b") as file:
        file.truncate(_ANNOUNCED.size)
        announced = mmap.mmap(file.fileno(), _ANNOUNCED.size)
    fmu = None
    while True:
        calls = parent.receive()
        results, error = [], None
        BEGAN.pack_into(announced, 0, time.time())
        try:
            if calls and fmu is None:
                fmu = LoadedFmu(announced, *arguments)
            results.extend(getattr(fmu, method)(*values) for method, *values in calls)
        except _DEFECTS as exception:
            error = defect(exception)
        except Exception as exception:
            # any error of a foreign library is a finding, not an end of this process
            error = str(exception) or type(exception).__name__
        BEGAN.pack_into(announced, 0, 0.0)
        parent.send_json([results, error])
