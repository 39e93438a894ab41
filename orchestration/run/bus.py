"""The layout of the bus: an index for every value that components exchange or that is recorded.

A String on the bus is the index of its text in a table, which only grows. The loop gets and sets it through
functions that have the arguments of fmi2GetInteger and fmi2SetInteger.
"""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fmus.fmi.binding import OK, WARNING
from fmus.fmi.instance import FmuInstance
from fmus.fmi.variable_types import TRANSFER_TYPE
from orchestration.run.loop_data import Call, InputMode
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import Port

SIGNAL = "."  # prefix of a signal or an external value on the bus, with which no name of a variable begins


@dataclass(frozen=True)
class VariableGroup:
    """Variables of one component and one type, read or set in one call of an FMI function.

    bus_index: of the first variable; integer_index: of the first in `Wiring.integers`, -1 for Real
    """

    component: str
    type: str
    function: str
    ports: Sequence[Port]
    bus_index: int
    integer_index: int


@dataclass(frozen=True)
class BusLayout:
    """connections: (source, target) of connections and signals, in the order of the target's component

    input_modes: of the connections
    calls: kind of call -> its groups, one for each call: variables that are read (outputs and others), inputs
    that are set, inputs whose derivatives are set
    integer_count: how many variables are not Real
    index: name -> index on the bus
    """

    connections: Sequence[tuple[str, str]]
    input_modes: Sequence[InputMode]
    calls: Mapping[int, Sequence[VariableGroup]]
    integer_count: int
    index: Mapping[str, int]


def lay_out_bus(prepared: PreparedRun) -> BusLayout:
    """Outputs come first, then inputs, then signals and external values."""
    pairs = [(source.name, target.name) for source, target in prepared.system.connections]
    signals = [*prepared.experiment.signals, *prepared.external]
    pairs += [(f"{SIGNAL}{name}", name) for name in signals]
    order = {name: c for c, name in enumerate(prepared.system.components)}
    connections = sorted(pairs, key=lambda pair: order[component_of(pair[1], prepared)])
    modes = {target: _input_mode(prepared, source, target) for source, target in connections}
    smooth = {target for target, mode in modes.items() if mode is InputMode.FMU_DERIVATIVE}
    read = {*prepared.recorded, *(source for source, _ in connections)} - modes.keys()
    kinds = Call.GET_OUTPUTS, Call.SET_INPUTS, Call.SET_DERIVATIVES
    calls: dict[int, list[VariableGroup]] = {kind: [] for kind in kinds}
    names: list[str] = []
    integer_count = 0
    for kind, verb, chosen in ((Call.GET_OUTPUTS, "Get", read), (Call.SET_INPUTS, "Set", {*modes})):
        for (component, fmi_type), ports in _ports_by_type(prepared, chosen, smooth).items():
            integer_index = -1 if fmi_type == "Real" else integer_count
            integer_count += 0 if fmi_type == "Real" else len(ports)
            function = f"fmi2{verb}{fmi_type}"
            group = VariableGroup(component, fmi_type, function, ports, len(names), integer_index)
            calls[kind].append(group)
            names += [port.name for port in ports]
            if derived := [port for port in ports if port.name in smooth]:
                derivatives = replace(group, function="fmi2SetRealInputDerivatives", ports=derived)
                calls[Call.SET_DERIVATIVES].append(derivatives)
    names += [f"{SIGNAL}{name}" for name in signals]
    index = {name: i for i, name in enumerate(names)}
    return BusLayout(connections, [*modes.values()], calls, integer_count, index)


def component_of(name: str, prepared: PreparedRun) -> str:
    """Returns the component of "component.variable"; empty for a signal."""
    return prepared.system.ports[name].component if name in prepared.system.ports else ""


def _input_mode(prepared: PreparedRun, source: str, target: str) -> InputMode:
    ports = prepared.system.ports
    ends = [ports[name].variable for name in (source, target) if not name.startswith(SIGNAL)]
    is_continuous = all(v.type == "Real" and v.variability in (None, "continuous") for v in ends)
    if not (prepared.experiment.extrapolation and is_continuous) or target in prepared.external:
        return InputMode.HOLD
    interface: Any = prepared.system.descriptions[ports[target].component].coSimulation
    return InputMode.FMU_DERIVATIVE if interface.canInterpolateInputs else InputMode.MIDPOINT


def _ports_by_type(
    prepared: PreparedRun, names: set[str], first: set[str]
) -> dict[tuple[str, str], list[Port]]:
    """Returns (component, type of getter and setter) -> the variables of these names.

    first: those that come before the others of their group
    """
    groups: dict[tuple[str, str], list[Port]] = {}
    for name, port in prepared.system.ports.items():
        if name in names:
            groups.setdefault((port.component, TRANSFER_TYPE[port.variable.type]), []).append(port)
    for ports in groups.values():
        ports.sort(key=lambda port: port.name not in first)
    return groups


_POINTER = ctypes.c_void_p
_exchange_type = ctypes.CFUNCTYPE(ctypes.c_int, _POINTER, _POINTER, ctypes.c_size_t, _POINTER)


class Strings:
    """The strings of one run; number 0 is the empty one."""

    def __init__(self) -> None:
        self._numbers = {"": 0}
        self._encoded = [b""]
        # ctypes frees a callback with its Python object: they must live as long as the run
        self._functions: list[Any] = []

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
