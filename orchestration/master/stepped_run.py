"""A run that a loop of the caller's own leads: step by step, with values read and set in between.

Each step is one of `RunInProgress`: the same loop over the same arrays. A reader and a writer know the
places of their values on the bus, so that nothing is looked up in a step.
"""

import sys
import time
from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np

from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.master.bus import SIGNAL
from orchestration.master.failure import reason_of
from orchestration.master.loop_data import LoopFunctions, Report, SavedMemory
from orchestration.master.process_guard import ProcessGuard
from orchestration.master.saved_state import Record, SavedState
from orchestration.master.snapshot import free_states, new_memory, restore_after_failure
from orchestration.master.stepping import RunInProgress
from orchestration.master.wiring import WiredRun
from orchestration.results.recording import Recording
from orchestration.system.prepared_run import check_changeable
from orchestration.system.values import Value, fmi_value, value_range

Reader = Callable[[], Any]
Writer = Callable[..., None]

_LOOK_EVERY_S = 1e-3  # at what FMUs changed in this process, and at their warnings
_LARGEST = sys.float_info.max
_POSITION = int(Report.POSITION)
_RECORDED, _TERMINATED = int(Report.RECORDED), int(Report.TERMINATED)
_PLAIN: dict[str, Callable[[float], Any]] = {"Real": float, "Boolean": bool}  # others: int


class _NextLook:
    """When a step of any run looks again at what FMUs changed in this process, which the runs share [s]."""

    time = 0.0


_next_look = _NextLook()


class SteppedRun(RunInProgress):
    """An initialised run at its first communication point; `free` ends it.

    failure: why no further step can be taken; empty if one can
    """

    def __init__(self, wired: WiredRun, loop: LoopFunctions, guard: ProcessGuard) -> None:
        super().__init__(wired, loop, guard)
        self.failure = ""
        self._last = len(self.wiring.points) - 1
        self._bus, self._report = self.wiring.bus.data, self.wiring.report.data
        self._points: Any = self.wiring.points.data
        self._driven = {target for _, target in wired.bus.connections}
        has_tolerance = self.step_control and self.step_control.tolerance
        every_point = range(self._last + 1)  # points where more is due than a step
        self._special = every_point if has_tolerance else {0, self._last, *wired.prepared.changes}
        faults = self.wiring.faults
        self._of_points = (
            self.wiring.points,
            self.wiring.signal_values.T,
            faults.source.swapaxes(0, 1),
            faults.weight.swapaxes(0, 1),
            faults.addition.T,
        )
        self._is_noted = False  # whether what the caller may change was noted before the present step
        self._moved_point: tuple[int, list[np.ndarray]] = 0, []
        self._unable = self.prepared.system.components_without("canGetAndSetFMUstate")
        self._record = Record(self.wiring.rows, self.wiring.faults.history.T)
        self._memories: list[SavedMemory] = []  # all of them
        self._unused: list[SavedMemory] = []

    @property
    def time(self) -> float:
        """The present communication point [s]."""
        return self._points[self._report[_POSITION]]

    @property
    def is_terminated(self) -> bool:
        """Whether a component has terminated the simulation, at the present communication point."""
        return bool(self._report[_TERMINATED])

    @property
    def can_save(self) -> bool:
        """Whether every FMU can save its state."""
        return not self._unable

    @property
    def is_done(self) -> bool:
        """Whether the run is at its stop time, or a component has terminated the simulation."""
        return self._report[_POSITION] == self._last or self.is_terminated

    @property
    def position(self) -> int:
        """Index of the present communication point."""
        return self._report[_POSITION]

    @position.setter
    def position(self, point: int) -> None:
        self._report[_POSITION] = point

    def step(self) -> None:
        """Step to the next communication point. SimulationError if that fails, or the run is at its end."""
        point = self._report[_POSITION]
        is_plain = point not in self._special and not self.failure
        if not is_plain and (self.failure or point == self._last):
            raise OrchestrationError(self.failure or self._end())
        is_due = self.guard.has_restored or time.perf_counter() > _next_look.time
        self._is_noted = is_due or not is_plain or point + 1 == self._last
        if self._is_noted:
            self.guard.note_surroundings()
        try:
            if is_plain:
                self._plain_step(point)
            else:
                self._step_and_more(point)
            if self._report[_TERMINATED]:
                self._finish()
                self.look_around()
                self.failure = self._end()
            elif point + 1 == self._last:
                self._finish()
                self.look_around()
        except Exception as error:
            self.failure = reason_of(error)
            raise SimulationError(self.failure, self.recording()) from error

    def _end(self) -> str:
        by = self._termination.get("component")
        where = f"{by} terminated the simulation at" if by else "the run is at its stop time,"
        return f"{where} {self.time:.9g} s: expected no further step"

    def _plain_step(self, point: int) -> None:
        if self._snapshot:
            self._snapshot.take()
        if self._loop.run(point, point + 1) == point:
            self.look_around(failed=True)
            self._repeat_discarded_step(point)
        elif self._is_noted:
            self.look_around()
            _next_look.time = time.perf_counter() + _LOOK_EVERY_S

    def look_around(self, failed: bool = False) -> None:
        if not self._is_noted:
            self.guard.note_surroundings()
        super().look_around(failed)

    def _step_and_more(self, point: int) -> None:
        """A step with what is due before and after it."""
        self._change_and_wait(None)
        self._run_batch(point + 1)

    def _go_to(self, time: float) -> None:
        index = self.position + 1
        before = [array[index].copy() for array in self._of_points]
        super()._go_to(time)
        self._moved_point = index, before

    def recording_now(self) -> Recording:
        """The values recorded until now, those of the present communication point included."""
        if not self.failure:
            self.guard.note_surroundings()
            self._is_noted = True
            self.record_now()
            self.look_around()
        return self.recording()

    def save(self) -> SavedState:
        """The whole system at the present communication point."""
        if self.failure or self._unable:
            raise OrchestrationError(self.failure or _cannot_save(self._unable))
        if not self._unused:
            self._memories.append(new_memory(self.wired))
            self._unused.append(self._memories[-1])
        memory = self._unused.pop()
        if not self._loop.save(memory):
            raise self._failure()
        point = self._report[_POSITION]
        step_size = self.step_control.step_size if self.step_control else 0.0
        return SavedState(memory, point, step_size, self._record.keep(point), self._unused)

    def restore(self, state: SavedState) -> None:
        """Set the whole system, and its record, back to a state of this run."""
        if state.unused is not self._unused:
            raise OrchestrationError(_stale("saved state"))
        if self.failure:
            self._recover(state)
        elif not self._loop.restore(state.memory):
            raise self._failure()
        if state.segment is not self._record.present:
            self._record.return_to(state.segment)
        self._report[_POSITION] = self._report[_RECORDED] = state.position
        if self.step_control:
            self.step_control.step_size = state.step_size

    def _recover(self, state: SavedState) -> None:
        """Set the system back after a failure; no call of an FMU is allowed after a fatal one."""
        if any(instance.is_dead for instance in self.instances.values()):
            raise OrchestrationError(self.failure)
        restore_after_failure(self.wired, self._loop, state.memory)
        index, before = self._moved_point
        for array, row in zip(self._of_points, before, strict=False):
            array[index] = row
        self.failure, self._termination, self._moved_point = "", {}, (0, [])

    def get(self, name: str) -> Any:
        """The present value of a variable, in the type of Python that it has."""
        port = self.prepared.system.port(name, "get")
        if name not in self.wired.bus.index or port.variable.type == "String":
            return self.instances[port.component].get(port.variable)
        return _PLAIN.get(port.variable.type, int)(self.reader(name)())

    def set(self, name: str, value: Value) -> None:
        """Set a variable from the present communication point on."""
        self.writer(name)(value)

    def reader(self, *names: str) -> Reader:
        """A function that returns the present number of one variable, or those of several as a tuple."""
        ports = [self.prepared.system.port(name, "reader") for name in names]
        index = self.wired.bus.index
        if not names:
            raise SystemDefinitionError("reader: expected the name of a variable, or several")
        for port in ports:
            if port.variable.type == "String":
                raise SystemDefinitionError(f"reader: {port.name}: expected a number, got a String; use get")
        if not all(name in index for name in names):
            getters = [(self.instances[port.component].get, port.variable) for port in ports]
            values = lambda: tuple(get(variable) for get, variable in getters)  # noqa: E731
            return values if len(names) > 1 else lambda: values()[0]
        return self._bus_reader([index[name] for name in names], not self._driven.isdisjoint(names))

    def _bus_reader(self, indices: list[int], must_exchange: bool) -> Reader:
        """must_exchange: whether inputs are read, which take their value at the exchange."""
        bus, pick = self._bus, itemgetter(*indices)

        def read() -> Any:
            if must_exchange:
                self.record_now()
            try:
                return pick(bus)
            except ValueError:
                raise OrchestrationError(_stale("reader")) from None

        return read

    def writer(self, *names: str) -> Writer:
        """A function that sets one variable, or several in this order, from the present point on."""
        if not names:
            raise SystemDefinitionError("writer: expected the name of a variable, or several")
        writers = [self._writer(name) for name in names]
        if len(writers) == 1:
            return writers[0]

        def write(*values: Value) -> None:
            if len(values) != len(writers):
                raise SystemDefinitionError(f"writer of {', '.join(names)}: got {len(values)} values")
            for write_one, value in zip(writers, values):  # noqa: B905
                write_one(value)

        return write

    def _writer(self, name: str) -> Callable[[Value], None]:
        external = self.prepared.external
        check_changeable(self.prepared.system, name, "set", self._driven - external.keys())
        port = self.prepared.system.ports[name]
        if name not in external:
            return lambda value: self._set_in_fmu(port, fmi_value(port, value))
        bus: Any = self._bus  # of float64, which typing does not know
        index = self.wired.bus.index[f"{SIGNAL}{name}"]
        low, high = (max(-_LARGEST, min(limit, _LARGEST)) for limit in value_range(port))
        is_real = port.variable.type == "Real"

        def write(value: Any) -> None:
            if not (is_real and isinstance(value, float) and low <= value <= high):
                value = fmi_value(port, value)  # which converts, or refuses
            try:
                bus[index] = value
            except ValueError:
                raise OrchestrationError(_stale("writer")) from None

        return write

    def free(self) -> None:
        """End the run: free the states saved in the FMUs, and make readers and writers refuse."""
        self.failure = "the run has ended: expected start(experiment) for another"
        self._bus.release()
        for memory in self._memories:
            free_states(self.wired, memory)
        super().free()


def _cannot_save(components: list[str]) -> str:
    return f"{', '.join(components)} cannot save its state: expected canGetAndSetFMUstate"


def _stale(what: str) -> str:
    return f"the {what} belongs to a run that has ended: expected a {what} of the present run"
