"""Saved FMU states of an instance under examination, by numbers of the script that asks for them."""

import ctypes
from typing import Any, Protocol

_GUARD = 64  # bytes behind a serialised state
_GUARD_BYTE = b"\xa5"


class Instance(Protocol):
    """An instance whose functions are called. last_status: of the latest call."""

    last_status: int

    def call(self, function: str, *arguments: Any) -> None: ...


class SavedStates:
    """The states that were saved, each in a numbered slot."""

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        self._pointers: dict[int, ctypes.c_void_p] = {}

    def holds(self, slot: int) -> bool:
        """Whether a state was saved in a slot."""
        return bool(self._pointers.get(slot, ctypes.c_void_p()).value)

    def get_fmu_state(self, slot: int) -> bool:
        """Saves the state in a slot, over the one there; returns whether the FMU gave an address."""
        pointer = self._pointers.setdefault(slot, ctypes.c_void_p())
        self._instance.call("fmi2GetFMUstate", ctypes.byref(pointer))
        return bool(pointer.value)

    def set_fmu_state(self, slot: int) -> None:
        self._instance.call("fmi2SetFMUstate", self._pointers[slot])

    def free_fmu_state(self, slot: int) -> bool:
        """Frees a saved state, or an empty slot; returns whether the FMU left NULL."""
        pointer = self._pointers.pop(slot, ctypes.c_void_p())
        self._instance.call("fmi2FreeFMUstate", ctypes.byref(pointer))
        return not pointer.value

    def serialized_fmu_state_size(self, slot: int) -> int:
        size = ctypes.c_size_t()
        self._instance.call("fmi2SerializedFMUstateSize", self._pointers[slot], ctypes.byref(size))
        return size.value

    def serialize_fmu_state(self, slot: int) -> list[Any]:
        """Returns [the state as hexadecimal bytes, whether nothing was written behind its size]."""
        size = self.serialized_fmu_state_size(slot)
        if self._instance.last_status:
            return ["", True]
        content = ctypes.create_string_buffer(_GUARD_BYTE * (size + _GUARD), size + _GUARD)
        self._instance.call("fmi2SerializeFMUstate", self._pointers[slot], content, size)
        return [content.raw[:size].hex(), content.raw[size:] == _GUARD_BYTE * _GUARD]

    def deserialize_fmu_state(self, slot: int, content: str) -> bool:
        """Makes a saved state of bytes, which are overwritten after the call."""
        data = bytes.fromhex(content)
        buffer, pointer = ctypes.create_string_buffer(data, len(data)), ctypes.c_void_p()
        self._instance.call("fmi2DeSerializeFMUstate", buffer, len(data), ctypes.byref(pointer))
        ctypes.memset(buffer, ord("#"), len(data))
        self._pointers[slot] = pointer
        return bool(pointer.value)

    def copy_fmu_state(self, slot: int, other: int) -> bool:
        """Makes another saved state of the bytes of one."""
        content, _ = self.serialize_fmu_state(slot)
        return not self._instance.last_status and self.deserialize_fmu_state(other, content)
