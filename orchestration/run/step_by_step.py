"""Runs that a loop of the caller's own leads step by step, with values read and set in between.

`SteppedRun` is one such run, whose steps are those of `RunInProgress`: the same loop over the same arrays.
`StepByStep` holds the methods of `Simulator` for it.
"""

import time
import warnings
from collections import deque
from typing import Any

import numpy as np

from orchestration.errors import FmuWarning, OrchestrationError, SimulationError
from orchestration.results.recording import Recording
from orchestration.run.loop_data import LoopFunctions, Report, SavedMemory
from orchestration.run.process_guard import ProcessGuard
from orchestration.run.run_recording import reason_of
from orchestration.run.snapshot import Record, SavedState, free_states, new_memory, restore_after_failure
from orchestration.run.stepping import RunInProgress
from orchestration.run.variable_access import Reader, VariableAccess, Writer, stale
from orchestration.run.wiring import WiredRun
from orchestration.system.values import Value

_LOOK_EVERY_S = 1e-3  # at what FMUs did to this process, and at their warnings
_POSITION = int(Report.POSITION)
_RECORDED, _TERMINATED = int(Report.RECORDED), int(Report.TERMINATED)


class SteppedRun(RunInProgress):
    """An initialised run at its first communication point; `free` ends it.

    failure: why no further step can be taken; empty if one can
    variables: to read and set them
    """

    # time [s] when a step of any run looks again, as the runs share the process
    _next_look = 0.0

    def __init__(self, wired: WiredRun, loop: LoopFunctions, guard: ProcessGuard) -> None:
        super().__init__(wired, loop, guard)
        self.failure = ""
        self.variables = VariableAccess(self)
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

    def step(self) -> None:
        """Steps to the next communication point. SimulationError if that fails, or the run is at its end."""
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

    def recording_now(self) -> Recording:
        """Returns the values recorded until now, those of the present communication point included."""
        if not self.failure:
            self.record_now()
            self.look_around()
        return self.recording()

    def save(self) -> SavedState:
        """Saves the whole system at the present communication point."""
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
        segment, written = self._record.keep(point), tuple(self.variables.written)
        return SavedState(memory, point, step_control, segment, written, self._unused)

    def restore(self, state: SavedState) -> None:
        """Sets the whole system, and its record, back to a state of this run."""
        if state.unused is not self._unused:
            raise OrchestrationError(stale("saved state"))
        if self.failure:
            self._recover(state)
        elif not self._loop.restore(state.memory):
            raise self._failure()
        if state.segment is not self._record.present:
            self._record.return_to(state.segment)
        self._report[_POSITION] = self._report[_RECORDED] = state.position
        self.variables.written[:] = state.written
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
        self.variables.release()
        for memory in self._memories:
            free_states(self.wired, memory)
        super().free()
        try:
            self.restore_process()
        except OrchestrationError as error:
            warnings.warn(str(error), FmuWarning, stacklevel=3)


def _cannot_save(components: list[str]) -> str:
    return f"{', '.join(components)} cannot save its state: expected canGetAndSetFMUstate"


class StepByStep:
    """One run at a time, from `Simulator.start` to the next `start` or `run`, or to `close`.

        simulator.start(Experiment(10.0, 0.01), external=["plant.force"])
        while not simulator.is_done:
            simulator.set("plant.force", -2.0 * simulator.get("plant.position"))
            simulator.step()
        recording = simulator.recording()

    Without anything set, the recording is that of `run`, to the last bit. The second run of an error estimate
    takes what was set at the points that both have; a loop that the caller closes is none in it.
    """

    _stepped: SteppedRun | None = None

    def _started(self) -> SteppedRun:
        if self._stepped is None:
            raise OrchestrationError("no run is started: expected start(experiment) first")
        return self._stepped

    @property
    def time(self) -> float:
        """The present communication point [s]."""
        return self._started().time

    @property
    def point(self) -> int:
        """Index of the present communication point."""
        return self._started().position

    @property
    def points(self) -> np.ndarray:
        """The communication points of the run [s]."""
        return self._started().prepared.points

    @property
    def is_terminated(self) -> bool:
        """Whether an FMU has terminated the simulation, at the present communication point."""
        return self._started().is_terminated

    @property
    def can_save(self) -> bool:
        """Whether every FMU can save its state."""
        return self._started().can_save

    @property
    def is_done(self) -> bool:
        """Whether the run is at its stop time, or an FMU has terminated the simulation."""
        return self._started().is_done

    def step(self) -> None:
        """Steps to the next communication point.

        Raises SimulationError if the step fails: its `recording` holds the values recorded until then;
        OrchestrationError if the run is done.
        """
        self._started().step()

    def get(self, name: str) -> Any:
        """Returns the value of "component.variable" at the present communication point."""
        return self._started().variables.get(name)

    def set(self, name: str, value: Value) -> None:
        """Sets "component.variable", from the present communication point on.

        It is an external input, an input that the experiment gives a constant value, or a tunable parameter;
        the latter two are recorded if `record` names them. Raises SystemDefinitionError for another variable,
        and for a value of another type or outside the declared range.
        """
        self._started().variables.set(name, value)

    def reader(self, *names: str) -> Reader:
        """Returns a quick `get`: a function that returns the present number of one variable, or a tuple.

        It serves this run alone. Booleans are 0.0 and 1.0, as in a recording.
        """
        return self._started().variables.reader(*names)

    def writer(self, *names: str) -> Writer:
        """Returns a function that sets one variable or several in order: a quick `set` for this run alone."""
        return self._started().variables.writer(*names)

    def save(self) -> SavedState:
        """Returns the whole system at the present communication point: FMUs, connections and record.

        Raises OrchestrationError if an FMU cannot save its state.
        """
        return self._started().save()

    def restore(self, state: SavedState) -> None:
        """Goes back to a state that this run saved, also after a failure, or on to one on another way.

        Raises OrchestrationError for a state of another run, and after an FMU returned fatal.
        """
        self._started().restore(state)

    def recording(self) -> Recording:
        """Returns the values recorded until now, those of the present communication point included."""
        return self._started().recording_now()


def replay(run: StepByStep, first: SteppedRun) -> Recording:
    """Leads a run at twice the step of another one to its present point, with what was set there.

    Raises OrchestrationError where the first one is not two steps from its start.
    """
    if first.position < 2:
        raise OrchestrationError(f"expected at least two steps, got {first.position}")
    remaining = deque(first.variables.written)
    while not run.is_done and 2 * (run.point + 1) <= first.position:
        while remaining and remaining[0][0] <= 2 * run.point:
            _, name, value = remaining.popleft()
            run.set(name, value)
        run.step()
    return run.recording()
