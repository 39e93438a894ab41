"""Values of variables, read and set at the present communication point of a run that is led step by step.

A reader and a writer know the places of their values on the bus, so that nothing is looked up in a step.
"""

import sys
from collections.abc import Callable
from operator import itemgetter
from typing import Any

from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.run.bus import SIGNAL
from orchestration.run.stepping import RunInProgress
from orchestration.system.experiment_checks import check_changeable
from orchestration.system.values import Value, fmi_value, value_range

Reader = Callable[[], Any]
Writer = Callable[..., None]
Written = tuple[int, str, Value]
"""Index of a communication point, and the name and the value of what is set there."""

_LARGEST = sys.float_info.max
_PLAIN: dict[str, Callable[[float], Any]] = {"Real": float, "Boolean": bool}  # others: int


class VariableAccess:
    """Reads and sets variables of one run, until `release`.

    written: what was set, if the error is to be estimated, which a second run is made for
    """

    def __init__(self, run: RunInProgress) -> None:
        self._run, self._system, self._index = run, run.prepared.system, run.wired.bus.index
        self._bus: Any = run.wiring.bus.data  # of float64, which typing does not know
        self._driven = {target for _, target in run.wired.bus.connections}
        self.written: list[Written] = []

    def get(self, name: str) -> Any:
        """Returns the present value of a variable, in the type of Python that it has."""
        port = self._system.port(name, "get")
        if name not in self._index or port.variable.type == "String":
            return self._run.instances[port.component].get(port.variable)
        return _PLAIN.get(port.variable.type, int)(self.reader(name)())

    def set(self, name: str, value: Value) -> None:
        """Sets a variable from the present communication point on."""
        self.writer(name)(value)

    def reader(self, *names: str) -> Reader:
        """Returns a function that returns the present number of one variable, or a tuple of several."""
        ports = [self._system.port(name, "reader") for name in names]
        if not names:
            raise SystemDefinitionError("reader: expected the name of a variable, or several")
        for port in ports:
            if port.variable.type == "String":
                raise SystemDefinitionError(f"reader: {port.name}: expected a number, got a String; use get")
        if not all(name in self._index for name in names):
            getters = [(self._run.instances[port.component].get, port.variable) for port in ports]
            values = lambda: tuple(get(variable) for get, variable in getters)  # noqa: E731
            return values if len(names) > 1 else lambda: values()[0]
        return self._bus_reader([self._index[name] for name in names], not self._driven.isdisjoint(names))

    def _bus_reader(self, indices: list[int], must_exchange: bool) -> Reader:
        """Returns a reader; must_exchange: it reads inputs, which take their value at the exchange."""
        bus, pick = self._bus, itemgetter(*indices)

        def read() -> Any:
            if must_exchange:
                self._run.record_now()
            try:
                return pick(bus)
            except ValueError:
                raise OrchestrationError(stale("reader")) from None

        return read

    def writer(self, *names: str) -> Writer:
        """Returns a function that sets one variable, or several in this order, from the present point on."""
        if not names:
            raise SystemDefinitionError("writer: expected the name of a variable, or several")
        writers = [self._noting_writer(name) for name in names]
        if len(writers) == 1:
            return writers[0]

        def write(*values: Value) -> None:
            if len(values) != len(writers):
                raise SystemDefinitionError(f"writer of {', '.join(names)}: got {len(values)} values")
            for write_one, value in zip(writers, values):  # noqa: B905
                write_one(value)

        return write

    def _noting_writer(self, name: str) -> Callable[[Value], None]:
        write = self._writer(name)
        if not self._run.prepared.experiment.error_estimate:
            return write

        def write_and_note(value: Value) -> None:
            write(value)
            self.written.append((self._run.position, name, value))

        return write_and_note

    def _writer(self, name: str) -> Callable[[Value], None]:
        external = self._run.prepared.external
        check_changeable(self._system, name, "set", self._driven - external.keys())
        port = self._system.ports[name]
        if name not in external:
            return lambda value: self._run.set_in_fmu(port, fmi_value(port, value))
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

    def release(self) -> None:
        """Makes readers and writers refuse."""
        self._bus.release()


def stale(what: str) -> str:
    """Returns the error about something that belongs to a run before the present one."""
    return f"the {what} belongs to a run that has ended: expected a {what} of the present run"
