"""The layout of the bus: an index for every value that components exchange or that is recorded.

A String on the bus is the index of its text in a table, which only grows. The loop gets and sets it through
functions that have the arguments of fmi2GetInteger and fmi2SetInteger.
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from fmus.fmi.binding import OK, WARNING
from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import TRANSFER_TYPE
from orchestration.run.loop_data import InputMode
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import Port

SIGNAL = "."  # prefix of a signal or an external value on the bus, with which no name of a variable begins


@dataclass(frozen=True)
class VariableGroup:
    """Variables of one component and one type, read or set in one call.

    bus_index: of the first variable; integer_index: of the first in `Wiring.integers`, -1 for Real
    """

    component: str
    type: str
    variables: tuple[ScalarVariable, ...]
    bus_index: int
    integer_index: int

    @property
    def names(self) -> list[str]:
        return [f"{self.component}.{variable.name}" for variable in self.variables]


@dataclass(frozen=True)
class BusLayout:
    """connections: (source, target) of connections and signals, in the order of the target's component

    input_modes: of the connections
    outputs, inputs: the variables that are read, which need not be outputs, and those that are set
    integer_count: how many of them are not Real
    derivatives: the inputs whose derivatives are set
    index: name -> index on the bus
    """

    connections: tuple[tuple[str, str], ...]
    input_modes: tuple[InputMode, ...]
    outputs: tuple[VariableGroup, ...]
    inputs: tuple[VariableGroup, ...]
    derivatives: tuple[VariableGroup, ...]
    integer_count: int
    index: Mapping[str, int]


def lay_out_bus(prepared: PreparedRun) -> BusLayout:
    """Outputs come first, then inputs, then signals and external values."""
    pairs = [(source.name, target.name) for source, target in prepared.system.connections]
    signals = [*prepared.experiment.signals, *prepared.external]
    pairs += [(f"{SIGNAL}{name}", name) for name in signals]
    order = {name: c for c, name in enumerate(prepared.system.components)}
    connections = tuple(sorted(pairs, key=lambda pair: order[component_of(pair[1])]))
    modes = {target: _input_mode(prepared, source, target) for source, target in connections}
    smooth = {target for target, mode in modes.items() if mode is InputMode.FMU_DERIVATIVE}
    read = {*prepared.recorded, *(source for source, _ in connections)} - modes.keys()
    outputs = _variables_by_type(prepared, read, smooth)
    groups: list[VariableGroup] = []
    size = integer_count = 0
    for component, fmi_type, members in (*outputs, *_variables_by_type(prepared, {*modes}, smooth)):
        is_real = fmi_type == "Real"
        groups.append(VariableGroup(component, fmi_type, members, size, -1 if is_real else integer_count))
        size += len(members)
        integer_count += 0 if is_real else len(members)
    names = [name for group in groups for name in group.names]
    names += [f"{SIGNAL}{name}" for name in signals]
    inputs = tuple(groups[len(outputs) :])
    counts = ((group, sum(name in smooth for name in group.names)) for group in inputs)
    return BusLayout(
        connections=connections,
        input_modes=tuple(modes.values()),
        outputs=tuple(groups[: len(outputs)]),
        inputs=inputs,
        derivatives=tuple(replace(group, variables=group.variables[:n]) for group, n in counts if n),
        integer_count=integer_count,
        index={name: i for i, name in enumerate(names)},
    )


def component_of(name: str) -> str:
    """Returns the component of "component.variable"; empty for a signal."""
    return name.partition(".")[0]


def _input_mode(prepared: PreparedRun, source: str, target: str) -> InputMode:
    ports = prepared.system.ports
    ends = [ports[name].variable for name in (source, target) if not name.startswith(SIGNAL)]
    is_continuous = all(v.type == "Real" and v.variability in (None, "continuous") for v in ends)
    if not (prepared.experiment.extrapolation and is_continuous) or target in prepared.external:
        return InputMode.HOLD
    interface: Any = prepared.system.descriptions[ports[target].component].coSimulation
    return InputMode.FMU_DERIVATIVE if interface.canInterpolateInputs else InputMode.MIDPOINT


def _variables_by_type(
    prepared: PreparedRun, names: set[str], first: set[str]
) -> list[tuple[str, str, tuple[ScalarVariable, ...]]]:
    """Returns (component, type of getter and setter, variables) of the variables of these names.

    first: those that come before the others of their group
    """
    groups: dict[tuple[str, str], list[Port]] = {}
    for name, port in prepared.system.ports.items():
        if name in names:
            groups.setdefault((port.component, TRANSFER_TYPE[port.variable.type]), []).append(port)
    for members in groups.values():
        members.sort(key=lambda port: port.name not in first)
    return [(*key, tuple(port.variable for port in members)) for key, members in groups.items()]


_POINTER = ctypes.c_void_p
_exchange_type = ctypes.CFUNCTYPE(ctypes.c_int, _POINTER, _POINTER, ctypes.c_size_t, _POINTER)


class Strings:
    """The strings of one run; number 0 is the empty one."""

    def __init__(self) -> None:
        self._numbers = {"": 0}
        self._encoded = [b""]
        self._functions: list[Any] = []  # they must live as long as the run

    def number(self, text: str) -> int:
        """Returns the index of a text."""
        number = self._numbers.setdefault(text, len(self._encoded))
        if number == len(self._encoded):
            self._encoded.append(text.encode())
        return number

    @property
    def table(self) -> list[str]:
        """The strings in the order of their numbers."""
        return list(self._numbers)

    @table.setter
    def table(self, strings: list[str]) -> None:
        self._numbers, self._encoded = {}, []
        for text in strings:
            self.number(text)

    def function(self, instance: FmuInstance, name: str) -> int:
        """Returns the address of fmi2GetString or fmi2SetString with numbers in place of strings."""

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
