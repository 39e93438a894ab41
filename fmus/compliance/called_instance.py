"""One instance of an FMU under examination; it makes every call, including calls that FMI forbids."""

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, cast

from fmus.compliance import instance_parts as parts
from fmus.compliance.process_settings import ProcessSettings
from fmus.compliance.texts import ARGUMENTS, PENDED, UNWRITTEN, USUAL_NAME, VECTORS, packed
from fmus.fmi import binding
from fmus.fmi.callbacks import AllocateMemory, Callbacks, CountingAllocator, FreeMemory

_GUARD = 0xA5  # each byte behind an array
_CHANGES_OF_STATE = (
    "fmi2Enter", "fmi2Exit", "fmi2DoStep", "fmi2Completed", "fmi2Terminate", "fmi2Reset", "fmi2SetFMUstate",
)  # fmt: skip
_OF_SOLVERS = {*VECTORS, "fmi2SetContinuousStates", "fmi2SetTime"}
_RETURN_ARRAYS = ("fmi2Get", "fmi2Serialize")  # by the last array among their arguments


@cache
def _kind(function: str) -> tuple[bool, bool, bool]:
    """Returns whether the last argument of a function is what it writes, whether the function changes the
    state, and whether a solver calls it.
    """
    return (
        function.startswith(_RETURN_ARRAYS),
        function.startswith(_CHANGES_OF_STATE),
        function in _OF_SOLVERS,
    )


@cache
def _announcement(function: str, after: str) -> bytes:
    return f"{function}(...){after}".encode()


def _overwrite(buffers: Sequence[Any]) -> None:
    """Overwrites strings that were arguments of a call: the FMU may no longer read them."""
    for buffer in buffers:
        ctypes.memset(buffer, ord("#"), len(buffer) - 1)


@cache
def _guarded(element: Any, count: int, is_marked: bool) -> Any:
    """Returns an array with a marked element behind it; is_marked: whether its own are marked too."""
    array = (element * (count + 1))()
    size = ctypes.sizeof(element) * (count + 1 if is_marked else 1)
    ctypes.memset(ctypes.addressof(array) + ctypes.sizeof(array) - size, _GUARD, size)
    return array


def _not_numbers(count: int) -> Any:
    """Returns an array of results, each of which the FMU must write."""
    return (ctypes.c_double * count)(*[math.nan] * count)


class CalledInstance(parts.StateSlots):
    """An instance of which each call may fail: `last_status` is its status.

    options: name, guid, location of the resources, logging (bool), and
      callbacks: "usual"; "fewest" without stepFinished and environment; "no memory" without memory functions;
        "formats" with messages before they are printed
      overwritten: whether all arguments of fmi2Instantiate are overwritten after the call
      uses: of an instance of FMI 3.0, see `Fmi3Library`
      interface: fmi2Type, by default the interface of this class
      watched: whether settings of the process are compared before and after each call
      recorded: whether `free` returns all calls
    announce: gets each call before it is made, as a text
    function, mode: the latest that was called, and the latest that changed the state
    """

    interface = binding.CO_SIMULATION
    _unknown: parts.MessageLog  # of environments of no instance, perhaps of one that was freed

    def __init__(
        self, library: binding.Library, memory: CountingAllocator, settings: ProcessSettings,
        options: dict[str, Any], announce: Callable[[bytes], None],
    ) -> None:  # fmt: skip
        self._options, self._settings, self._announce = options, settings, announce
        self.function = self.mode = ""
        self._noted = set[tuple[str, str, str]]()
        self._kept: list[Any] = []
        self.watched = bool(options.get("watched"))
        self._calls: list[list[Any]] | None = [] if options.get("recorded") else None
        kind = options.get("callbacks", "usual")
        self._after = self._callbacks = f" (callbacks: {kind})" if "callbacks" in options else ""
        log = parts.MessageLog(settings, self._noted, options.get("name", USUAL_NAME))
        is_usual = kind != "fewest"
        super().__init__(library, Callbacks(memory, is_usual, log, None if is_usual else 0))
        self.messages = log
        CalledInstance._unknown = parts.MessageLog(settings, self._noted)
        if is_usual:
            Callbacks(environment=0, log=CalledInstance._unknown)
        structure = self.callbacks.structure
        if kind == "formats":
            structure.logger = parts.logger_of_formats(self.messages)
        if kind == "no memory":
            structure.allocateMemory, structure.freeMemory = AllocateMemory(), FreeMemory()

    def create(self) -> bool:
        """Calls fmi2Instantiate; False if it returns NULL."""
        options = self._options
        defaults = ("name", USUAL_NAME), ("guid", ""), ("location", "")
        texts = [options.get(key, default) for key, default in defaults]
        strings = [ctypes.create_string_buffer(text.encode()) for text in texts]
        structure = type(self.callbacks.structure).from_buffer_copy(self.callbacks.structure)
        name, guid, location = strings
        self._tell("fmi2Instantiate", texts)
        if self.library.fmi == 3:
            address = self._created_of_fmi3(name, guid)
        else:
            address = self.library.fmi2Instantiate(
                name, options.get("interface", self.interface), guid, location, ctypes.byref(structure),
                0, int(options.get("logging", False)),
            )  # fmt: skip
        self.handle = ctypes.c_void_p(address) if address else None
        self._kept += [*strings, structure]
        self._record("fmi2Instantiate", [texts[0], int(bool(options.get("logging")))])
        if options.get("overwritten"):
            _overwrite(strings)
        return self.handle is not None

    def _created_of_fmi3(self, name: Any, token: Any) -> int | None:
        options, environment = self._options, self.callbacks.structure.componentEnvironment
        is_logging, library = bool(options.get("logging")), cast(Any, self.library)
        return library.created(name, token, options["resources"], environment, is_logging, options["uses"])

    def check_status(self, function: str, status: int) -> None:
        self.last_status = status

    def _tell(self, function: str, arguments: Sequence[Any]) -> None:
        """Announces a call, with the function that brought the instance where it is, and its callbacks."""
        shown = [show(argument) for argument in arguments if (show := parts.shower(type(argument)))]
        self._announce(f"{function}({str(shown)[1:-1]}){self._after}".encode())

    def note(self, what: str, is_so: bool, name: str = "") -> None:
        """Notes a fault of the FMU, if there is one, for `changed_settings`; name: of an argument."""
        if is_so:
            self._noted.add((what, self.function, name))

    def call(self, function: str, *arguments: Any) -> None:
        """Calls a function, and notes if one that is watched writes into an array that is constant to it."""
        is_result, changes_state, is_of_solver = _kind(function)
        self.function = function
        # a solver makes most calls, and its vectors show little
        if is_of_solver:
            self._announce(_announcement(function, self._after))
        else:
            self._tell(function, arguments[:-1] if is_result else arguments)
        if not self.watched and self._calls is None:
            self.last_status = getattr(self.library, function)(self.handle, *arguments)
        else:
            self._call_watched(function, is_result, arguments)
        if changes_state and 0 <= self.last_status <= binding.WARNING:
            self.mode = function
            self._after = f" after {function}{self._callbacks}"

    def _call_watched(self, function: str, is_result: bool, arguments: Sequence[Any]) -> None:
        arrays = [x for x in arguments if isinstance(x, ctypes.Array)] if self.watched else []
        if is_result:
            arrays = arrays[:-1]
        before = [bytes(array) for array in arrays]
        given = [] if self._calls is None else [parts.plain(x, self._pointers) for x in arguments]
        self.last_status = self.status(function, *arguments)
        if self._calls is not None:
            given = parts.with_results(given, arguments) if is_result else given
            self._record(function, given)
        if arrays:
            self.note(ARGUMENTS, before != [bytes(array) for array in arrays])

    def _record(self, function: str, arguments: list[Any]) -> None:
        """Notes a call, with its time and the latest status."""
        if self._calls is not None:
            self._calls.append([time.monotonic(), function, arguments, self.last_status])

    def call_with_lists(self, function: str, *arguments: Any) -> None:
        """Calls a function with lists as arrays. Strings are hexadecimal bytes; their memory is overwritten
        after the call.
        """
        strings: list[Any] = []
        arrays = (parts.array_of(x, strings) if isinstance(x, list) else x for x in arguments)
        self.call(function, *arrays)
        self._kept += strings
        _overwrite(strings)

    def new_messages(self) -> list[list[Any]]:
        """Returns [status, message, instance, category, right environment or not] of each new message."""
        unknown = CalledInstance._unknown
        messages = self.messages.messages + unknown.messages
        self.messages.messages, unknown.messages = [], []
        return messages

    def changed_settings(self) -> list[list[str]]:
        """Returns [setting, before, after] of each setting changed since the FMU was loaded, and restores it.

        Noted faults have the function in the place of the value before.
        """
        changed = [*self._settings.changed(), *map(list, sorted(self._noted))]
        self._noted.clear()
        self._settings.restore()
        return changed

    # calls

    def read(self, kind: str, references: list[int]) -> list[Any]:
        """Returns values; Strings as hexadecimal bytes, or nothing for NULL."""
        count, function, element = len(references), f"fmi2Get{kind}", binding.element_type(kind)
        read = binding.reference_array(references)
        values = self.results(element, count, lambda array: self.call(function, read, count, array))
        return values if kind != "String" else [None if x is None else bytes(x).hex() for x in values]

    def get(self, kind: str, references: list[int]) -> list[Any] | str:
        """Returns values as `read` does, but Reals by `packed`."""
        values = self.read(kind, references)
        return packed(values) if kind == "Real" else values

    def results(self, element: Any, count: int, call: Callable[[Any], None]) -> list[Any]:
        """Returns what a call writes into an array, with an element behind it that the FMU may not write."""
        is_marked = self.watched and element is not ctypes.c_char_p
        guarded = _guarded(element, count, is_marked)
        array = type(guarded).from_buffer_copy(guarded)
        call(array)
        values = array[:count]
        if self.watched:
            size = ctypes.sizeof(element)
            self.note(ARGUMENTS, bytes(array)[-size:] != bytes(guarded)[-size:])
            self.note(UNWRITTEN, is_marked and self.last_status == binding.OK and guarded[0] in values)
        return values

    def do_step(self, t: float, h: float, no_going_back: bool = False) -> str:
        """Advances from t to t + h seconds, and waits for a pending step.

        Returns the reason why a step of FMI 3.0 is discarded although no call failed, or "".
        """
        self.call("fmi2DoStep", t, h, int(no_going_back))
        if self.last_status == binding.PENDING:
            self.note(PENDED, True)
            self.wait()
        if self.library.fmi == 3 and (name := cast(Any, self.library).unwritten(self.handle)):
            self.note(UNWRITTEN, True, name)
        if self.library.fmi == 3 and self.last_status == binding.DISCARD:
            ends = ctypes.c_int()
            self.library.fmi2GetBooleanStatus(self.handle, binding.TERMINATED, ctypes.byref(ends))
            return "the FMU ends the simulation" if ends.value else ""
        return ""

    def do_steps(
        self, start: float, h: float, first: int, count: int, observed: Sequence[tuple[str, list[int]]] = ()
    ) -> str | list[list[Any]]:
        """Makes equal steps of h seconds, from number `first` after the start, until one fails.

        observed: types with value references, which are read after each step
        Returns the reason of a step that is discarded, as `do_step` does, or each value that was observed
        with the times of its least and largest value: [least, time, largest, time].
        """
        extremes: list[list[Any]] = []
        for i in range(first, first + count):
            reason = self.do_step(start + i * h, h)
            if not 0 <= self.last_status <= binding.WARNING:
                return reason
            t, values = start + (i + 1) * h, [x for kind, of in observed for x in self.read(kind, of)]
            extremes = extremes or [[x, t, x, t] for x in values]
            for value, extreme in zip(values, extremes, strict=True):
                if value < extreme[0] or math.isnan(value):
                    extreme[:2] = value, t
                if value > extreme[2]:
                    extreme[2:] = value, t
        return extremes if observed else ""

    def cpu_time(self) -> float:
        """Returns the CPU time of this process [s], which does not depend on the load of the machine."""
        return time.process_time()

    def wait(self) -> None:
        """Waits until a pending step has ended; the time limit of the rule ends a wait without end."""
        status = ctypes.c_int(binding.PENDING)
        while status.value == binding.PENDING:
            time.sleep(0.001)
            self.call("fmi2GetStatus", binding.DO_STEP_STATUS, ctypes.byref(status))
            if self.last_status:
                # without a status the step is not a discarded one
                self.last_status = binding.ERROR
                return
        self.last_status = status.value

    def status_of(self, kind: str, status_kind: int) -> Any:
        """Returns the value of fmi2GetXXXStatus; XXX is the type `kind`; notes if a string is missing."""
        value = binding.element_type(kind or "Integer")()
        self.call(f"fmi2Get{kind}Status", status_kind, ctypes.byref(value))
        self.note(UNWRITTEN, self.last_status == binding.OK and value.value is None)
        return value.value.hex() if isinstance(value.value, bytes) else value.value

    def directional_derivatives(
        self, unknowns: list[int], knowns: list[int], seed: list[float]
    ) -> list[float]:
        result = _not_numbers(len(unknowns))
        arguments = unknowns, len(unknowns), knowns, len(knowns), seed, result
        self.call_with_lists("fmi2GetDirectionalDerivative", *arguments)
        return list(result)

    def output_derivatives(self, references: list[int], order: int) -> list[float]:
        """Returns derivatives of outputs, all of one order."""
        count = len(references)
        result = _not_numbers(count)
        self.call_with_lists("fmi2GetRealOutputDerivatives", references, count, [order] * count, result)
        return list(result)

    def free(self) -> list[list[Any]]:
        """Returns time, function, arguments as `plain` has them, and status of each recorded call."""
        if self.handle is not None and self.last_status != binding.FATAL:
            self._tell("fmi2FreeInstance", ())
            self.last_status = 0
            self._record("fmi2FreeInstance", [])
            self.status("fmi2FreeInstance")
        self.handle = None
        self.callbacks.close()
        return self._calls or []
