"""Parts of an instance under examination: its callbacks, which are observed, and its saved states."""

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from fmus.compliance.process_settings import ProcessSettings
from fmus.compliance.texts import without_folders
from fmus.fmi.binding import OK, WARNING, BoundInstance, Library
from fmus.fmi.callbacks import Callbacks, Log, Logger

_MOST_MESSAGES = 1000


class MessageLog(Log):
    """Messages with the instance and the category that the FMU gave.

    noted: gets rows if the FMU calls the logger with other settings of the process
    name: of the instance whose environment leads here; None of the log of unknown environments
    called: the log of the instance that is called
    """

    called: "MessageLog | None" = None

    def __init__(
        self, settings: ProcessSettings, noted: set[tuple[str, str, str]], name: str | None = None
    ) -> None:
        super().__init__()
        self._settings, self._noted, self._name = settings, noted, name
        self.messages: list[list[Any]] = []

    def add(
        self, status: int, message: str, instance: str | None = None, category: str | None = None
    ) -> None:
        self._noted |= {(f"{name} in a callback", *values) for name, *values in self._settings.differing()}
        called = MessageLog.called
        # with the environment of another instance; its threads give its own name
        log = self if called is None or instance != called._name or instance == self._name else called
        if len(log.messages) < _MOST_MESSAGES:
            # before rules cut the text, where half of a folder's name could stay
            text = without_folders(message)
            is_right = log is self and self._name is not None
            log.messages.append([status, text, instance, category, is_right])


def logger_of_formats(messages: MessageLog) -> Any:
    """Returns a logger that keeps the format of each message, as arguments do not reach Python."""

    def log(_: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
        texts = [None if text is None else text.decode("utf-8", "replace") for text in (name, category)]
        messages.add(status, (message or b"").decode("utf-8", "replace"), *texts)

    return Logger(log)


_GUARD = 64  # bytes behind a serialised state
_GUARD_BYTE = b"\xa5"


_PLAIN = (float, int, str, type(None))
_MOST_SHOWN = 8  # elements


@cache  # every call is announced
def shower(kind: type) -> Callable[[Any], Any] | None:
    """Returns what gives an argument of a type as plain data, few elements of an array; None for an address
    of results.
    """
    if kind in _PLAIN:
        return lambda argument: argument
    if not issubclass(kind, ctypes.Array):
        return None
    # the FMU may leave wrong addresses of texts
    is_text = kind._type_ in (ctypes.c_char, ctypes.c_char_p)
    return lambda argument: ... if is_text else argument[:_MOST_SHOWN]


def plain(argument: Any, pointers: dict[int, ctypes.c_void_p]) -> Any:
    """Returns an argument of a call as plain data: a number; [type, elements] of an array; ["state", slot]
    of a saved state, and ["state&", slot] of its address; ["address", type] of another result.

    pointers: slot -> saved state
    """
    if isinstance(argument, ctypes.Array):
        kind = argument._type_
        if kind is ctypes.c_char:
            return ["bytes", argument.raw.hex()]
        elements = argument[:]
        if kind is ctypes.c_char_p:
            elements = [(x or b"").decode("utf-8", "replace") for x in elements]
        return [kind.__name__, elements]
    target = getattr(argument, "_obj", argument)
    if isinstance(target, ctypes.c_void_p):
        slot = next((slot for slot, pointer in pointers.items() if pointer is target), -1)
        return ["state" if target is argument else "state&", slot]
    return argument if target is argument else ["address", type(target).__name__]


def with_results(given: list[Any], arguments: Sequence[Any]) -> list[Any]:
    """Returns the plain arguments of a call, with the elements of its array of results as they are after it.

    The last array holds the results, and perhaps one element that guards its end.
    """
    place = max((i for i, x in enumerate(arguments) if isinstance(x, ctypes.Array)), default=None)
    if place is None or given[place][0] == "bytes":
        return given
    kind, elements = plain(arguments[place], {})
    is_guarded = len(elements) not in [x for x in arguments if isinstance(x, int)]
    return [*given[:place], [kind, elements[:-1] if is_guarded else elements], *given[place + 1 :]]


def array_of(values: list[Any], strings: list[Any]) -> Any:
    """Returns an array of texts, Reals, or whole numbers with or without a sign; NULL without elements.

    strings: gets the memory of the texts, which are hexadecimal bytes
    """
    if not values:
        return None
    if isinstance(values[0], str):
        strings += [ctypes.create_string_buffer(bytes.fromhex(x)) for x in values]
        kind, values = ctypes.c_char_p, [ctypes.cast(buffer, ctypes.c_char_p) for buffer in strings]
    elif any(isinstance(x, float) for x in values):
        kind = ctypes.c_double
    else:
        kind = ctypes.c_int if min(values) < 0 else ctypes.c_uint
    return (kind * len(values))(*values)


class StateSlots(BoundInstance):
    """An instance whose saved states have numbered slots. last_status: of the latest call."""

    last_status = 0

    def __init__(self, library: Library, callbacks: Callbacks) -> None:
        super().__init__(library, callbacks)
        self._pointers: dict[int, ctypes.c_void_p] = {}

    def holds(self, slot: int) -> bool:
        """Whether a state was saved in a slot."""
        return bool(self._pointers.get(slot, ctypes.c_void_p()).value)

    def save_state(self, slot: int) -> bool:
        """Saves the state in a slot, over the one there; returns whether the FMU gave an address."""
        pointer = self._pointers.setdefault(slot, ctypes.c_void_p())
        self.call("fmi2GetFMUstate", ctypes.byref(pointer))
        return bool(pointer.value)

    def set_state(self, slot: int) -> None:
        self.call("fmi2SetFMUstate", self._pointers[slot])

    def free_state(self, slot: int) -> bool:
        """Frees a saved state, or an empty slot; returns whether the FMU left NULL."""
        pointer = self._pointers.setdefault(slot, ctypes.c_void_p())
        self.call("fmi2FreeFMUstate", ctypes.byref(pointer))
        del self._pointers[slot]
        return not pointer.value

    def state_size(self, slot: int) -> int:
        size = ctypes.c_size_t()
        self.call("fmi2SerializedFMUstateSize", self._pointers[slot], ctypes.byref(size))
        return size.value

    def state_bytes(self, slot: int, more: int = 0) -> list[Any]:
        """Returns [the state as hexadecimal bytes, whether nothing was written behind its size].

        more: bytes that it has beyond the size that the FMU gives
        """
        size = self.state_size(slot) + more
        if self.last_status:
            return ["", True]
        content = ctypes.create_string_buffer(_GUARD_BYTE * (size + _GUARD), size + _GUARD)
        self.call("fmi2SerializeFMUstate", self._pointers[slot], content, size)
        return [content.raw[:size].hex(), content.raw[size:] == _GUARD_BYTE * _GUARD]

    def state_of_bytes(self, slot: int, content: str) -> bool:
        """Makes a saved state of bytes, which are overwritten after the call."""
        data = bytes.fromhex(content)
        buffer = ctypes.create_string_buffer(data, len(data))
        pointer = self._pointers[slot] = ctypes.c_void_p()
        self.call("fmi2DeSerializeFMUstate", buffer, len(data), ctypes.byref(pointer))
        ctypes.memset(buffer, ord("#"), len(data))
        self._pointers[slot] = pointer if self.last_status in (OK, WARNING) else ctypes.c_void_p()
        return bool(pointer.value)

    def copy_state(self, slot: int, other: int) -> bool:
        """Makes another saved state of the bytes of one."""
        content, _ = self.state_bytes(slot)
        return not self.last_status and self.state_of_bytes(other, content)
