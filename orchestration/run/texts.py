"""Strings in the communication loop: on the bus each is the index of its text in a table, which only grows.

The loop gets and sets them through functions that have the arguments of fmi2GetInteger and fmi2SetInteger.
"""

import ctypes
from typing import Any

from fmus.fmi.binding import OK, WARNING
from fmus.fmi.instance import FmuInstance

_POINTER = ctypes.c_void_p
_exchange_type = ctypes.CFUNCTYPE(ctypes.c_int, _POINTER, _POINTER, ctypes.c_size_t, _POINTER)


class Texts:
    """The texts of one run; number 0 is the empty one."""

    def __init__(self) -> None:
        self._numbers = {"": 0}
        self._encoded = [b""]
        self._functions: list[Any] = []  # they must live as long as the run

    def number(self, text: str) -> int:
        """The index of a text."""
        number = self._numbers.setdefault(text, len(self._encoded))
        if number == len(self._encoded):
            self._encoded.append(text.encode())
        return number

    @property
    def table(self) -> list[str]:
        """The texts in the order of their numbers."""
        return list(self._numbers)

    @table.setter
    def table(self, texts: list[str]) -> None:
        self._numbers, self._encoded = {}, []
        for text in texts:
            self.number(text)

    def function(self, instance: FmuInstance, name: str) -> int:
        """Address of fmi2GetString or fmi2SetString with an array of numbers in place of texts."""

        def get(handle: int, references: int, count: int, numbers: int) -> int:
            values = (ctypes.c_char_p * count)()
            status = instance.library.fmi2GetString(handle, references, count, values)
            if status in (OK, WARNING):
                target = (ctypes.c_int * count).from_address(numbers)
                target[:] = [self.number((value or b"").decode("utf-8", "replace")) for value in values]
            return status

        def set_(handle: int, references: int, count: int, numbers: int) -> int:
            chosen = (ctypes.c_int * count).from_address(numbers)
            values = (ctypes.c_char_p * count)(*(self._encoded[number] for number in chosen))
            return instance.library.fmi2SetString(handle, references, count, values)

        self._functions.append(_exchange_type(get if name == "fmi2GetString" else set_))
        return ctypes.cast(self._functions[-1], _POINTER).value or 0
