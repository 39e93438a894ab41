"""Access to a run at a communication point: its values, read and set by name, and its whole state.

A reader and a writer hold the indices of their values on the bus, so that a step looks nothing up.

A run that goes back writes new rows over the old ones of its record. Should it later go to a state that was
saved on the way it left, the rows that lead there are needed again: they are copied when it leaves that way.
"""

import ctypes
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import FmuError, OrchestrationError, SystemDefinitionError
from orchestration.run.bus import SIGNAL
from orchestration.run.loop_data import Report, SavedMemory
from orchestration.run.run_recording import failure_error
from orchestration.run.wiring import WiredRun
from orchestration.system.experiment_checks import check_changeable
from orchestration.system.system import Port
from orchestration.system.values import Value, fmi_value, value_range

Reader = Callable[[], Any]
Writer = Callable[..., None]

_LARGEST = sys.float_info.max
_PLAIN: dict[str, Callable[[float], Any]] = {"Real": float, "Boolean": bool}  # others: int


class Access:
    """Reads and sets values of one run, until it is closed.

    exchange: gives inputs at the present communication point the values that they have there
    """

    def __init__(self, run: WiredRun, exchange: Callable[[], object]) -> None:
        self._run, self._exchange = run, exchange
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
        # an input gets the value of its present communication point at the exchange, which may be due
        must_exchange = not self._driven.isdisjoint(names)

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
            return self._writer(*names)
        if not names:
            raise SystemDefinitionError("writer: expected the name of a variable, or several")
        writers = [self._writer(name) for name in names]

        def write(*values: Value) -> None:
            if len(values) != len(writers):
                raise SystemDefinitionError(f"writer of {', '.join(names)}: got {len(values)} values")
            for write_one, value in zip(writers, values):  # noqa: B905
                write_one(value)

        return write

    def _writer(self, name: str) -> Callable[[Value], None]:
        port = self._system.port(name, "set")
        check_changeable(port, "set", self._driven_by_others)
        if name not in self._run.prepared.external:
            return self._writer_in_fmu(port)
        bus, index = self._bus, self._index[f"{SIGNAL}{name}"]
        low, high = (max(-_LARGEST, min(limit, _LARGEST)) for limit in value_range(port))
        is_real = port.variable.type == "Real"

        def write(value: Any) -> None:
            if not (is_real and isinstance(value, float) and low <= value <= high):
                # converts another number type, or raises the error that names the range
                value = fmi_value(port, value)
            try:
                bus[index] = value
            except ValueError:
                raise OrchestrationError(stale("writer")) from None

        return write

    def _writer_in_fmu(self, port: Port) -> Callable[[Value], None]:
        experiment, report = self._run.prepared.experiment, self._run.wiring.report
        period = experiment.period(port.component)

        def write(value: Value) -> None:
            if report[Report.POSITION] % period:
                size = experiment.step_sizes[port.component]
                raise OrchestrationError(
                    f"{port.name}: {port.component} is within a step: expected a set at its communication "
                    f"points, every {size:g} s"
                )
            set_in_fmu(self._run, port, fmi_value(port, value))

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


class Snapshot:
    """The states of all FMUs and the arrays of the loop at one time; call `free` at the end.

    memory: as `LoopFunctions.save` fills it
    """

    __slots__ = ("_run", "memory")

    def __init__(self, run: WiredRun) -> None:
        self._run = run
        self.memory: SavedMemory = (ctypes.c_int64 * (len(run.instances) + len(run.wiring.memory)))()

    def take(self) -> None:
        """Replaces the snapshot by the present states and arrays."""
        if not self._run.loop.save(self.memory):
            raise failure_error(self._run)

    def restore(self) -> None:
        """Sets all states and arrays back, also after a failure.

        Drops the instances' messages and their failures.
        """
        for instance in self._run.instances.values():
            instance.log.clear()
        if not self._run.loop.restore(self.memory):
            raise failure_error(self._run)
        self._run.wiring.report[Report.TERMINATED] = 0
        for instance in self._run.instances.values():
            instance.forget_failure()

    def free(self) -> None:
        """Frees the states."""
        for c, instance in enumerate(self._run.instances.values()):
            if self.memory[c]:
                with suppress(FmuError):
                    # an instance that refuses is freed next, and its states with it
                    instance.free_fmu_state(self.memory[c])
            self.memory[c] = 0


class Segment:
    """A segment of the record, from one saved state to the next.

    before: the segment that leads to its beginning, itself for the first
    end: the communication point where it ends
    parts: the rows of each array of the record, once they may be overwritten there
    """

    __slots__ = ("before", "end", "parts")

    def __init__(self, before: "Segment | None", end: int) -> None:
        self.before, self.end = before or self, end
        self.parts: list[np.ndarray] | None = None


class Record:
    """The arrays of a run that grow from point to point, a row for each.

    Those before `present.end` lead to the state that was saved or restored last.
    """

    def __init__(self, *arrays: np.ndarray) -> None:
        self._arrays = [array for array in arrays if array.size]
        self.present = Segment(None, 0)

    def keep(self, point: int) -> Segment:
        """Returns the segment that leads to a point, of what was recorded until then."""
        if self.present.end != point:
            self.present = Segment(self.present, point)
        return self.present

    def return_to(self, segment: Segment) -> None:
        """Brings back what was recorded until a segment's end."""
        present, target, missing = self.present, segment, []
        while present is not target:
            if present.end > target.end:
                if present.parts is None:
                    start, end = present.before.end, present.end
                    present.parts = [array[start:end].copy() for array in self._arrays]
                present = present.before
            else:
                missing.append(target)
                target = target.before
        for lost in missing:
            for array, part in zip(self._arrays, lost.parts or (), strict=True):
                array[lost.before.end : lost.end] = part
        self.present = segment


@dataclass(eq=False, slots=True)
class SavedState:
    """The whole system at one communication point of a run: opaque, for `Run.restore` in that run.

    unused: memory for the run's next saved states; a deleted state returns its snapshot there
    """

    snapshot: Snapshot
    position: int
    step_control: Mapping[str, Any]
    segment: Segment
    unused: list[Snapshot]

    def __del__(self) -> None:
        self.unused.append(self.snapshot)
