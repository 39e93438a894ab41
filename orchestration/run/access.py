"""Values of a run by their names, read and set at a communication point.

A reader and a writer know the places of their values on the bus, so that nothing is looked up in a step.
"""

import sys
from collections.abc import Callable, Sequence
from functools import cached_property
from operator import itemgetter
from typing import Any

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.run.bus import SIGNAL
from orchestration.run.loop_data import Report
from orchestration.run.wiring import WiredRun
from orchestration.system.experiment_checks import check_changeable
from orchestration.system.system import Port
from orchestration.system.values import Value, fmi_value, value_range

Reader = Callable[[], Any]
Writer = Callable[..., None]
Written = tuple[int, str, Value]
"""Index of a communication point, and the name and the value of what is set there."""

_LARGEST = sys.float_info.max
_PLAIN: dict[str, Callable[[float], Any]] = {"Real": float, "Boolean": bool}  # others: int


class Access:
    """Reads and sets values of one run, until it is closed.

    exchange: gives inputs at the present communication point the values that they have there
    written: gets what is set, if the error of the run is to be estimated
    """

    def __init__(self, run: WiredRun, exchange: Callable[[], object], written: list[Written]) -> None:
        self._run, self._exchange, self._written = run, exchange, written
        self._system, self._index = run.prepared.system, run.bus.index
        self._bus: Any = run.wiring.bus.data  # of float64, which typing does not know

    @cached_property
    def _driven(self) -> set[str]:
        return {target for _, target in self._run.bus.connections}

    @cached_property
    def _driven_by_others(self) -> set[str]:
        return self._driven - self._run.prepared.external.keys()

    def read(self, name: str) -> Any:
        """Returns the present value of "component.variable", in the type of Python that it has."""
        port = self._system.port(name, "read")
        if name not in self._index or port.variable.type == "String":
            return self._run.instances[port.component].get(port.variable)
        if name in self._driven:
            self._exchange()
        return _PLAIN.get(port.variable.type, int)(self._bus[self._index[name]])

    def reader(self, *names: str) -> Reader:
        """Returns a function that returns the present number of one variable, or a tuple of several."""
        ports = [self._system.port(name, "reader") for name in names]
        if not names:
            raise SystemDefinitionError("reader: expected the name of a variable, or several")
        for port in ports:
            if port.variable.type == "String":
                raise SystemDefinitionError(f"reader: {port.name}: expected a number, got a String; use read")
        if not all(name in self._index for name in names):
            getters = [(self._run.instances[port.component].get, port.variable) for port in ports]
            values = lambda: tuple(get(variable) for get, variable in getters)  # noqa: E731
            return values if len(names) > 1 else lambda: values()[0]
        return self._bus_reader(names)

    def _bus_reader(self, names: Sequence[str]) -> Reader:
        bus, pick, exchange = self._bus, itemgetter(*(self._index[name] for name in names)), self._exchange
        must_exchange = not self._driven.isdisjoint(names)  # inputs take their value at the exchange

        def read() -> Any:
            if must_exchange:
                exchange()
            try:
                return pick(bus)
            except ValueError:
                raise OrchestrationError(stale("reader")) from None

        return read

    def writer(self, *names: str) -> Writer:
        """Returns a function that sets one variable or several in order."""
        if len(names) == 1:
            return self._noting_writer(*names)
        if not names:
            raise SystemDefinitionError("writer: expected the name of a variable, or several")
        writers = [self._noting_writer(name) for name in names]

        def write(*values: Value) -> None:
            if len(values) != len(writers):
                raise SystemDefinitionError(f"writer of {', '.join(names)}: got {len(values)} values")
            for write_one, value in zip(writers, values):  # noqa: B905
                write_one(value)

        return write

    def _noting_writer(self, name: str) -> Callable[[Value], None]:
        write, report = self._writer(name), self._run.wiring.report
        if not self._run.prepared.experiment.error_estimate:
            return write

        def write_and_note(value: Value) -> None:
            write(value)
            self._written.append((int(report[Report.POSITION]), name, value))

        return write_and_note

    def _writer(self, name: str) -> Callable[[Value], None]:
        check_changeable(self._system, name, "set", self._driven_by_others)
        port = self._system.ports[name]
        if name not in self._run.prepared.external:
            return lambda value: set_in_fmu(self._run, port, fmi_value(port, value))
        bus, index = self._bus, self._index[f"{SIGNAL}{name}"]
        low, high = (max(-_LARGEST, min(limit, _LARGEST)) for limit in value_range(port))
        is_real = port.variable.type == "Real"

        def write(value: Any) -> None:
            if not (is_real and isinstance(value, float) and low <= value <= high):
                value = fmi_value(port, value)  # which converts, or refuses
            try:
                bus[index] = value
            except ValueError:
                raise OrchestrationError(stale("writer")) from None

        return write

    def close(self) -> None:
        """Makes readers and writers refuse, and lets go of the run, whose rows the next one may use."""
        self._bus.release()
        self._exchange = bool


def set_in_fmu(run: WiredRun, port: Port, value: FmiValue) -> None:
    """Sets a parameter or an input that nothing drives; it is recorded from the present point on."""
    wiring, instance = run.wiring, run.instances[port.component]
    instance.time = float(wiring.points[wiring.report[Report.POSITION]])
    instance.set(port.variable, value)
    index = run.bus.index.get(port.name)
    if index is not None:
        wiring.bus[index] = run.strings.number(value) if isinstance(value, str) else value


def stale(what: str) -> str:
    """Returns the error about something that belongs to a run before the present one."""
    return f"the {what} belongs to a run that has ended: expected a {what} of the present run"
