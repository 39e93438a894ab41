"""Variables of one FMI type, read and written together."""

import ctypes
from collections.abc import Iterable

import numpy as np
from fmpy.model_description import ScalarVariable

from fmus.binding import ELEMENTS, BoundInstance, reference_array
from fmus.fmi_types import NUMBERS, TRANSFER_TYPE


class Values:
    """Variables of one FMI type, read or written in one call through arrays that never move.

    `array` is a NumPy view of what the FMU reads and writes.
    """

    def __init__(self, instance: BoundInstance, fmi_type: str, variables: list[ScalarVariable]) -> None:
        name = TRANSFER_TYPE[fmi_type]
        buffer = (ELEMENTS[name] * len(variables))()
        references = reference_array([v.valueReference for v in variables])
        self.variables = variables
        self.array: np.ndarray = np.ctypeslib.as_array(buffer)
        self._instance = instance
        self._getter, self._setter = f"fmi2Get{name}", f"fmi2Set{name}"
        self._arguments = references, ctypes.c_size_t(len(variables)), buffer

    def read(self) -> None:
        """FMU -> array."""
        self._instance.call(self._getter, *self._arguments)

    def write(self) -> None:
        """Array -> FMU."""
        self._instance.call(self._setter, *self._arguments)


def grouped(instance: BoundInstance, variables: Iterable[ScalarVariable]) -> list[Values]:
    """The variables grouped by FMI type, in the order in which the types appear; String is left out."""
    groups: dict[str, list[ScalarVariable]] = {}
    for variable in variables:
        if variable.type in NUMBERS:
            groups.setdefault(variable.type, []).append(variable)
    return [Values(instance, fmi_type, members) for fmi_type, members in groups.items()]
