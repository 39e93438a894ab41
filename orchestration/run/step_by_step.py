"""Runs that a loop of the caller's own leads step by step, with values read and set in between.

The steps are those of `RunInProgress`: the same loop over the same arrays. A reader and a writer know the
places of their values on the bus, so that nothing is looked up in a step.
"""

import sys
import time
import warnings
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from operator import itemgetter
from typing import Any

import numpy as np

from orchestration.errors import FmuWarning, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.bus import SIGNAL
from orchestration.run.error_estimate import with_error_estimate
from orchestration.run.loop_data import LoopFunctions, Report, SavedMemory
from orchestration.run.process_guard import ProcessGuard
from orchestration.run.run_recording import reason_of
from orchestration.run.snapshot import Record, SavedState, free_states, new_memory, restore_after_failure
from orchestration.run.stepping import RunInProgress
from orchestration.run.wiring import WiredRun
from orchestration.system.experiment import Experiment
from orchestration.system.experiment_checks import check_changeable
from orchestration.system.values import Value, fmi_value, value_range

Reader = Callable[[], Any]
Writer = Callable[..., None]
Written = tuple[int, str, Value]
"""Index of a communication point, and the name and the value of what is set there."""

_LARGEST = sys.float_info.max
_PLAIN: dict[str, Callable[[float], Any]] = {"Real": float, "Boolean": bool}  # others: int
_LOOK_EVERY_S = 1e-3  # at what FMUs did to this process, and at their warnings
_POSITION = int(Report.POSITION)
_RECORDED, _TERMINATED = int(Report.RECORDED), int(Report.TERMINATED)


class SteppedRun(RunInProgress):
    """A run that the caller leads, from `Simulator.start` to the next `start` or `run`, or to `close`.

        run = simulator.start(Experiment(10.0, 0.01), external=["plant.force"])
        while not run.is_done:
            run.set("plant.force", -2.0 * run.get("plant.position"))
            run.step()
        recording = run.recording()

    Without anything set, the recording is that of `Simulator.run`, to the last bit. The second run of an
    error estimate takes what was set at the points that both have; a loop that the caller closes is none in
    it.

    failure: why no further step can be taken; empty if one can
    """

    # time [s] when a step of any run looks again, as the runs share the process
    _next_look = 0.0

    def __init__(
        self,
        wired: WiredRun,
        loop: LoopFunctions,
        guard: ProcessGuard,
        second: Callable[[], AbstractContextManager[Any]],
    ) -> None:
        """Makes the run at its first communication point; second: another simulator of the system."""
        super().__init__(wired, loop, guard)
        self.failure = ""
        self._has_ended = False
        self._bus: Any = self.wiring.bus.data  # of float64, which typing does not know
        self._driven = {target for _, target in wired.bus.connections}
        self._second = second
        self._written: list[Written] = []  # if the error is to be estimated
        self._estimated: tuple[list[Written], np.ndarray, Recording] | None = None
        self._last = len(self.wiring.points) - 1
        self._points: Any = self.wiring.points.data
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
    def point(self) -> int:
        """Index of the present communication point."""
        return self.position

    @property
    def points(self) -> np.ndarray:
        """The communication points of the run [s]."""
        return self.prepared.points

    @property
    def is_terminated(self) -> bool:
        """Whether an FMU has terminated the simulation, at the present communication point."""
        return bool(self._report[_TERMINATED])

    @property
    def can_save(self) -> bool:
        """Whether every FMU can save its state."""
        return not self._unable

    @property
    def is_done(self) -> bool:
        """Whether the run is at its stop time, or an FMU has terminated the simulation."""
        return self._report[_POSITION] == self._last or self.is_terminated

    def step(self) -> None:
        """Steps to the next communication point.

        Raises SimulationError if the step fails: its `recording` holds the values recorded until then;
        OrchestrationError if the run is done.
        """
        point = self._report[_POSITION]
        is_plain = point not in self._special and not self.failure
        if not is_plain and (self.failure or point == self._last):
            raise OrchestrationError(self.failure or self._end())
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
            raise SimulationError(self.failure, self.recorded()) from error

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
        elif time.perf_counter() > SteppedRun._next_look:
            self.look_around()
            SteppedRun._next_look = time.perf_counter() + _LOOK_EVERY_S

    def _step_and_more(self, point: int) -> None:
        """Takes a step, with what is due before and after it."""
        self._change_and_wait(None)
        self._run_batch(point + 1)

    def _go_to(self, time: float) -> None:
        index = self.position + 1
        before = [array[index].copy() for array in self._of_points]
        super()._go_to(time)
        self._moved_point = index, before

    def get(self, name: str) -> Any:
        """Returns the present value of "component.variable", in the type of Python that it has."""
        self._check_not_ended()
        port = self.prepared.system.port(name, "get")
        if name not in self.wired.bus.index or port.variable.type == "String":
            return self.instances[port.component].get(port.variable)
        return _PLAIN.get(port.variable.type, int)(self.reader(name)())

    def set(self, name: str, value: Value) -> None:
        """Sets "component.variable", from the present communication point on.

        It is an external input, an input that the experiment gives a constant value, or a tunable parameter;
        the latter two are recorded if `record` names them. Raises SystemDefinitionError for another variable,
        and for a value of another type or outside the declared range.
        """
        self._check_not_ended()
        self.writer(name)(value)

    def reader(self, *names: str) -> Reader:
        """Returns a quick `get`: a function that returns the present number of one variable, or a tuple.

        It serves this run alone. Booleans are 0.0 and 1.0, as in a recording.
        """
        index = self.wired.bus.index
        ports = [self.prepared.system.port(name, "reader") for name in names]
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
        """Returns a reader; must_exchange: it reads inputs, which take their value at the exchange."""
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
        """Returns a function that sets one variable or several in order: a quick `set` for this run alone."""
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
        if not self.prepared.experiment.error_estimate:
            return write

        def write_and_note(value: Value) -> None:
            write(value)
            self._written.append((self.position, name, value))

        return write_and_note

    def _writer(self, name: str) -> Callable[[Value], None]:
        external = self.prepared.external
        check_changeable(self.prepared.system, name, "set", self._driven - external.keys())
        port = self.prepared.system.ports[name]
        if name not in external:
            return lambda value: self.set_in_fmu(port, fmi_value(port, value))
        bus, index = self._bus, self.wired.bus.index[f"{SIGNAL}{name}"]
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

    def recording(self) -> Recording:
        """Returns the values recorded until now, those of the present communication point included.

        An error estimate of anything new loads the FMUs a second time.
        """
        self._check_not_ended()
        if not self.failure:
            self.record_now()
            self.look_around()
        recording = self.recorded()
        if not self.prepared.experiment.error_estimate:
            return recording
        if self._estimated and self._estimated[0] == self._written:
            _, values, estimated = self._estimated
            if np.array_equal(values, recording.values, equal_nan=True):
                return estimated
        estimated = with_error_estimate(recording, self.prepared, self._repeat)
        self._estimated = list(self._written), recording.values, estimated
        return estimated

    def _repeat(self, experiment: Experiment) -> Recording:
        """Leads a run at twice the step to the present point, with what was set here.

        Raises OrchestrationError where this one is not two steps from its start.
        """
        if self.position < 2:
            raise OrchestrationError(f"expected at least two steps, got {self.position}")
        remaining = deque(self._written)
        with self._second() as simulator:
            run: SteppedRun = simulator.start(experiment, list(self.prepared.external))
            while not run.is_done and 2 * (run.point + 1) <= self.position:
                while remaining and remaining[0][0] <= 2 * run.point:
                    _, name, value = remaining.popleft()
                    run.set(name, value)
                run.step()
            return run.recording()

    def _check_not_ended(self) -> None:
        if self._has_ended:
            raise OrchestrationError(self.failure)

    def save(self) -> SavedState:
        """Returns the whole system at the present communication point: FMUs, connections and record.

        Raises OrchestrationError if an FMU cannot save its state.
        """
        if self.failure or self._unable:
            raise OrchestrationError(self.failure or _cannot_save(self._unable))
        if not self._unused:
            self._memories.append(new_memory(self.wired))
            self._unused.append(self._memories[-1])
        memory = self._unused.pop()
        if not self._loop.save(memory):
            raise self._failure()
        point = self._report[_POSITION]
        step_control = self.step_control.state if self.step_control else {}
        segment, written = self._record.keep(point), tuple(self._written)
        return SavedState(memory, point, step_control, segment, written, self._unused)

    def restore(self, state: SavedState) -> None:
        """Goes back to a state that this run saved, also after a failure, or on to one on another way.

        Raises OrchestrationError for a state of another run, and after an FMU returned fatal.
        """
        self._check_not_ended()
        if state.unused is not self._unused:
            raise OrchestrationError(_stale("saved state"))
        if self.failure:
            self._recover(state)
        elif not self._loop.restore(state.memory):
            raise self._failure()
        if state.segment is not self._record.present:
            self._record.return_to(state.segment)
        self._report[_POSITION] = self._report[_RECORDED] = state.position
        self._written[:] = state.written
        if self.step_control:
            self.step_control.state = state.step_control

    def _recover(self, state: SavedState) -> None:
        """Sets the system back after a failure; no call of an FMU is allowed after a fatal one."""
        if any(instance.returned_fatal for instance in self.instances.values()):
            raise OrchestrationError(self.failure)
        restore_after_failure(self.wired, self._loop, state.memory)
        index, before = self._moved_point
        for array, row in zip(self._of_points, before, strict=False):
            array[index] = row
        self.failure, self._termination, self._moved_point = "", {}, (0, [])

    def free(self) -> None:
        """Ends the run: frees the states saved in the FMUs, and makes readers and writers refuse."""
        self.failure = "the run has ended: expected start(experiment) for another"
        self._has_ended = True
        self._bus.release()
        for memory in self._memories:
            free_states(self.wired, memory)
        super().free()
        try:
            self.restore_process()
        except OrchestrationError as error:
            warnings.warn(str(error), FmuWarning, stacklevel=3)


def _cannot_save(components: list[str]) -> str:
    return f"{', '.join(components)} cannot save its state: expected canGetAndSetFMUstate"


def _stale(what: str) -> str:
    """Returns the error about something that belongs to a run before the present one."""
    return f"the {what} belongs to a run that has ended: expected a {what} of the present run"
