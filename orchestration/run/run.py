"""One run: FMUs on their way from the first communication point to the last, led by whoever advances it.

Steps are made in batches. A batch ends where Python has to act: at a scheduled change, where the caller wants
to be, and some ten times a second for the progress and an interrupt. Where a component discards a step, the
system is set back to the start of the batch, steps again to the discarded step, and takes that one in shorter
steps.
"""

import math
import time
import warnings
from bisect import bisect_right
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Protocol

import numpy as np

from fmus.fmi.binding import MODEL_EXCHANGE
from orchestration.errors import FmuWarning, OrchestrationError, SimulationError
from orchestration.results.recording import Recording
from orchestration.run.access import (
    Access,
    Reader,
    Record,
    SavedState,
    Snapshot,
    Writer,
    set_in_fmu,
    stale,
)
from orchestration.run.compiled_loop import StepThreads
from orchestration.run.initialisation import initialise
from orchestration.run.loop_data import Report
from orchestration.run.process_guard import ProcessGuard, deferred_interrupt
from orchestration.run.run_recording import (
    Pacing,
    RunStatistics,
    emit_warnings,
    failure_error,
    is_discarded_step,
    make_recording,
    reason_of,
)
from orchestration.run.step_control import StepControl, termination_within_step
from orchestration.run.wiring import WiredRun, move_point
from orchestration.system.values import Value

_BATCH_S = 0.05
# Largest growth of a batch from one to the next: the first batches measure the time of a step.
_GROWTH = 8
_MOST_STEPS = 1_000_000  # in a batch
# At changes of this process by FMUs, and at their warnings; looking takes longer than a light step.
_LOOK_EVERY_S = 1e-3
_POSITION, _RECORDED, _TERMINATED = int(Report.POSITION), int(Report.RECORDED), int(Report.TERMINATED)


def _let_interrupts_come() -> None:
    """Checks nothing, where no interrupt is deferred."""


class Progress(Protocol):
    """Called some ten times a second with the communication points done, and all of the run."""

    def __call__(self, done: int, total: int, /) -> object: ...


class Run:
    """A run that the caller leads, from `Simulator.start` to the next `start` or `run`, or to `close`.

        run = simulator.start(Experiment(10.0, 0.01), external=["plant.force"])
        while not run.is_done:
            run.set("plant.force", -2.0 * run.read("plant.position"))
            run.step()
        recording = run.recording()

    If the caller sets nothing, the recording equals `Simulator.run`'s to the last bit.

    Attributes
    ----------
    failure : str
        Why the run cannot go on; empty if it can.
    batch : int
        Steps of the next batch.
    """

    # time [s] when a step of any run looks again, as the runs share the process
    _next_look = 0.0

    def __init__(
        self,
        wired: WiredRun,
        guard: ProcessGuard,
        statistics: RunStatistics,
        threads: int | None = 1,
        pacing: Pacing | None = None,
    ) -> None:
        """Makes a run of FMUs that are not initialised.

        Parameters
        ----------
        wired : WiredRun
            The FMUs and their loop.
        guard : ProcessGuard
            Restores what FMUs change in this process.
        statistics : RunStatistics
            Times of the phases.
        threads : int, optional
            See `StepThreads`.
        pacing : Pacing, optional
            In real time.
        """
        self.wired, self.prepared, self.wiring = wired, wired.prepared, wired.wiring
        self.statistics, self.failure, self.batch = statistics, "", 1
        self._resources = ExitStack()  # freed when the run ends
        self._batch_start = None if wired.prepared.retry_obstacle else self._snapshot()
        self._loop, self._guard, self._pacing = wired.loop, guard, pacing
        # A solver starts again in a restored state, as where a batch begins. This depends on the processor's
        # speed, so that batches then have one step.
        has_solver = any(one.interface == MODEL_EXCHANGE for one in wired.instances.values())
        self._most_steps = 1 if pacing or has_solver else _MOST_STEPS
        self._threads = StepThreads(wired.wiring, wired.loop, threads)
        self._resources.callback(self._threads.close)
        self._step_control: StepControl | None = None
        self._access = Access(wired, self.record_now)
        self._resources.callback(self._access.close)
        self._record = Record(wired.wiring.rows, wired.wiring.faults.history.T)
        self._unused: list[Snapshot] = []  # of saved states
        # a memoryview: indexing is faster than of the array
        self._report = wired.wiring.report.data
        self._points: Any = wired.wiring.points.data
        self._last = len(wired.wiring.points) - 1
        self._changes = sorted(wired.prepared.changes)
        every_point = range(self._last + 1) if wired.prepared.experiment.tolerance else ()
        # the first and the last point, points with changes, or all of a run with a tolerance
        self._special = every_point or {0, self._last, *self._changes}
        self._has_ended = False
        self._termination: dict[str, Any] = {}
        self._check_interrupt: Callable[[], None] = _let_interrupts_come
        self._move_back: Callable[[], None] = lambda: None  # of a point that moved

    @property
    def step_control(self) -> StepControl | None:
        """The control of steps between communication points; None where steps cannot be repeated."""
        if self._batch_start and not self._step_control:
            self._step_control = StepControl(self.wired, self._batch_start)
            self._resources.callback(self._step_control.free)
        return self._step_control

    def _snapshot(self) -> Snapshot:
        snapshot = Snapshot(self.wired)
        self._resources.callback(snapshot.free)
        return snapshot

    @property
    def time(self) -> float:
        """The present communication point [s]."""
        return self._points[self._report[_POSITION]]

    @property
    def point(self) -> int:
        """Index of the present communication point; the loop moves it on, whatever interrupts Python."""
        return self._report[_POSITION]

    @property
    def points(self) -> np.ndarray:
        """The communication points of the run [s]."""
        return self.prepared.points

    @property
    def is_terminated(self) -> bool:
        """Whether an FMU has terminated the simulation, at the present communication point."""
        return bool(self._report[_TERMINATED])

    @property
    def is_done(self) -> bool:
        """Whether the run is at its stop time, or an FMU has terminated the simulation."""
        return self._report[_POSITION] == self._last or bool(self._report[_TERMINATED])

    @property
    def can_save(self) -> bool:
        """Whether every FMU can save its state."""
        return not self.prepared.system.components_without("canGetAndSetFMUstate")

    def initialise(self) -> None:
        """Gives new FMUs their initial values, and reads the outputs at the first communication point.

        Raises
        ------
        SimulationError
            If an FMU refuses.
        """
        try:
            with self.statistics.phase("initialisation"):
                initialise(self.prepared, self.wired.instances)
                for c in range(len(self.wired.instances)):
                    if not self._loop.read_outputs(c):
                        raise failure_error(self.wired)
                self._restore_process()
        except Exception as error:
            raise self.failed(error) from error

    def step(self) -> None:
        """Steps to the next communication point.

        Raises
        ------
        SimulationError
            If the step fails; its `recording` has the values recorded until then.
        OrchestrationError
            If the run is done.
        """
        point = self._report[_POSITION]
        if self.failure or self._report[_TERMINATED] or point == self._last:
            raise OrchestrationError(self.failure or self._end())
        try:
            if point in self._special:
                self._change_and_wait()
                self._run_batch(point + 1)
            else:
                # the same without the overhead of a batch: agents and controllers in Python step point by
                # point
                if self._batch_start:
                    self._batch_start.take()
                if self._loop.run(point, point + 1) == point:
                    self._look_around(failed=True)
                    self._repeat_discarded_step(point)
            if self._report[_TERMINATED] or point + 1 == self._last:
                self._finish()
            elif time.perf_counter() > Run._next_look:
                self._look_around()
                Run._next_look = time.perf_counter() + _LOOK_EVERY_S
        except Exception as error:
            raise self.failed(error) from error

    def advance(self, to: float = math.inf, progress: Progress | None = None) -> None:
        """Steps to the first communication point that is not before `to`, or to the end of the run.

        Parameters
        ----------
        to : float
            Time [s].
        progress : callable, optional
            Called some ten times a second with the number of communication points done, and of all.

        Raises
        ------
        SimulationError
            If a step fails; its `recording` has the values recorded until then.
        OrchestrationError
            If the run has failed before.
        KeyboardInterrupt
            At a communication point, from where the run can go on.
        """
        if self.failure:
            raise OrchestrationError(self.failure)
        end = self._last
        if to < math.inf:
            earliest = to - self.prepared.experiment.time_resolution()
            end = min(end, int(np.searchsorted(self.wiring.points, earliest)))
        try:
            with self.statistics.phase("stepping"), deferred_interrupt() as self._check_interrupt:
                while self.point < end and not self._is_terminated():
                    self._check_interrupt()
                    if progress:
                        progress(self.point, self._last)
                    self._change_and_wait()
                    self._run_batch(end)
                self._check_interrupt()
                if self.is_done:
                    if self._report[_RECORDED] <= self.point:
                        self._finish()
                    if progress:
                        progress(self.point, self.point)
        except Exception as error:
            raise self.failed(error) from error
        finally:
            self._check_interrupt = _let_interrupts_come

    def _run_batch(self, end: int) -> None:
        """Runs towards communication point `end`, or to behind a step that was divided."""
        start, first = time.perf_counter(), self.point
        following = bisect_right(self._changes, first)
        next_change = self._changes[following : following + 1]
        end = min(end, first + min(self.batch, self._most_steps), *next_change)
        if self.prepared.experiment.tolerance and self.step_control:
            self._go_to(self.step_control.divide_step(self._check_interrupt))
            self.batch = 1
            return
        if self._batch_start:
            self._batch_start.take()
        is_divided = self._threads.run(first, end) < end
        is_terminated = self._is_terminated()
        self._look_around(failed=is_divided)
        if is_divided and not is_terminated:
            self._repeat_discarded_step(first)
        steps_a_second = (self.point - first) / max(time.perf_counter() - start, 1e-9)
        longer = min(_GROWTH * self.batch, int(_BATCH_S * steps_a_second), _MOST_STEPS)
        self.batch = 1 if is_divided else max(1, longer)

    def _finish(self) -> None:
        """Makes the changes of the last communication point and records it."""
        # an FMU that has terminated accepts no change
        if not self._is_terminated():
            self._change_and_wait()
        if not self.record_now():
            raise failure_error(self.wired)
        self._look_around()

    def record_now(self) -> bool:
        """Records the present communication point too, for a run that ends here.

        Returns
        -------
        bool
            False if it failed.
        """
        if self.is_terminated and self._report[_RECORDED] > self.point:
            # components that cannot go back have stepped past this point: their present values are of a later
            # time
            return True
        return bool(self._loop.exchange_and_record(self.point))

    def _change_and_wait(self) -> None:
        """Makes the scheduled changes of the present communication point; in real time, waits for it."""
        for port, value in self.prepared.changes.get(self.point, ()):
            set_in_fmu(self.wired, port, value)
        if self._pacing:
            self._pacing.wait(self.time, self._check_interrupt)

    def _repeat_discarded_step(self, start: int) -> None:
        """Takes the step that failed in shorter ones if it was discarded; else raises the failure.

        start: the communication point where the batch started
        """
        if not is_discarded_step(self.wiring):
            raise failure_error(self.wired)
        if self.step_control:
            self._go_to(self.step_control.repeat_discarded_step(start, self._check_interrupt))
            return
        point, reached = self.point, termination_within_step(self.wired)
        self._is_terminated(reached)
        # components that do not end stay where they are
        self._go_to(reached if len(self.wired.instances) == 1 else self.time)
        if self.point > point and not self._loop.read_outputs(0):
            raise failure_error(self.wired)

    def _is_terminated(self, time: float | None = None) -> bool:
        """Whether a component has terminated the simulation, at `time` [s] or else at the present point."""
        if self.is_terminated and not self._termination:
            instance = list(self.wired.instances.values())[self._report[_TERMINATED] - 1]
            messages = instance.termination_log or [message for _, message in instance.log]
            time = self.time if time is None else time
            self._termination = {"component": instance.name, "time_s": time, "messages": messages}
        return self.is_terminated

    def _go_to(self, time: float) -> None:
        """Makes the next communication point the present one; at an earlier time [s] it is the last one.

        At the time of the present point nothing changes.
        """
        self._is_terminated(time)
        self._look_around()
        before, index = self.time, self.point + 1
        if time > before:
            self._report[_POSITION] = index
        if self.time > time:
            self._move_back = move_point(self.wired, index, time)

    def _look_around(self, failed: bool = False) -> None:
        """Looks at what FMUs did to this process, and issues their warnings."""
        self._restore_process()
        emit_warnings(self.wired, failed and not self.is_terminated)

    def _restore_process(self) -> None:
        """Restores what `ProcessGuard` does, if the FMUs may have changed it."""
        if not self.wiring.independent:
            names = ", ".join(self.wired.instances)
            self._guard.restore(f"one of {names}" if len(self.wired.instances) > 1 else names)

    def failed(self, error: Exception) -> SimulationError:
        """Returns the error of a run that cannot go on, with the values recorded until then.

        Parameters
        ----------
        error : Exception
            Its cause.

        Returns
        -------
        SimulationError
        """
        self.failure = reason_of(error)
        return SimulationError(self.failure, self.recorded())

    def _end(self) -> str:
        by = self._termination.get("component")
        where = f"{by} terminated the simulation at" if by else "the run is at its stop time,"
        return f"{where} {self.time:.9g} s: expected no further step"

    def _check_not_ended(self) -> None:
        if self._has_ended:
            raise OrchestrationError(self.failure)

    def read(self, name: str) -> Any:
        """Returns the present value of a variable.

        Parameters
        ----------
        name : str
            "component.variable".

        Returns
        -------
        float, int, bool or str
            In the type that the variable has in Python.

        Raises
        ------
        SystemDefinitionError
            For an unknown variable.
        OrchestrationError
            If the run has ended.
        """
        self._check_not_ended()
        return self._access.read(name)

    def set(self, name: str, value: Value) -> None:
        """Sets a variable, from the present communication point on.

        It is an external input, an input that the experiment gives a constant value, or a tunable parameter;
        the latter two are recorded if `record` names them.

        Parameters
        ----------
        name : str
            "component.variable".
        value : float, int, bool or str
            In the unit of the variable.

        Raises
        ------
        SystemDefinitionError
            For another variable, and for a value of another type or outside the declared range.
        OrchestrationError
            If the run has ended.
        """
        self._check_not_ended()
        self._access.writer(name)(value)

    def reader(self, *names: str) -> Reader:
        """Returns a quick `read` of the same variables again and again, for this run alone.

        Parameters
        ----------
        *names : str
            "component.variable" of each.

        Returns
        -------
        function
            Without arguments. It returns the present number of one variable, or a tuple of several; Booleans
            are 0.0 and 1.0, as in a recording.

        Raises
        ------
        SystemDefinitionError
            For an unknown variable, a String, and no name.
        """
        return self._access.reader(*names)

    def writer(self, *names: str) -> Writer:
        """Returns a quick `set` of the same variables again and again, for this run alone.

        Parameters
        ----------
        *names : str
            "component.variable" of each.

        Returns
        -------
        function
            Its arguments are a value for each variable, in order.

        Raises
        ------
        SystemDefinitionError
            For a variable that `set` refuses.
        """
        return self._access.writer(*names)

    def recording(self) -> Recording:
        """Returns the values recorded until now, including the present communication point.

        Returns
        -------
        Recording

        Raises
        ------
        OrchestrationError
            If the run has ended.
        """
        self._check_not_ended()
        if not self.failure:
            self.record_now()
            self._look_around()
        return self.recorded()

    def recorded(self, is_final: bool = False) -> Recording:
        """Returns the values recorded until now, without the present communication point.

        Parameters
        ----------
        is_final : bool
            Whether the run has ended, so that the recording may have the rows of the run.

        Returns
        -------
        Recording
        """
        more = self._step_control.provenance if self._step_control else {}
        more |= {"terminated": self._termination} if self._termination else {}
        more |= {"real_time": self._pacing.report()} if self._pacing else {}
        more |= self.statistics.report(self.time, not self._threads.have_shared)
        rows, count, strings = self.wiring.rows, self._report[_RECORDED], self.wired.strings.table
        return make_recording(self.prepared, rows, count, strings, more, is_final)

    def save(self) -> SavedState:
        """Returns the whole system at the present communication point: FMUs, connections and record.

        Returns
        -------
        SavedState
            For `restore`.

        Raises
        ------
        OrchestrationError
            If an FMU cannot save its state, or the run has failed or was terminated.
        """
        if self.failure or self._report[_TERMINATED]:
            raise OrchestrationError(self.failure or self._end())
        if not self._unused:
            if not self.can_save:
                names = ", ".join(self.prepared.system.components_without("canGetAndSetFMUstate"))
                raise OrchestrationError(f"{names} cannot save its state: expected canGetAndSetFMUstate")
            self._unused.append(self._snapshot())
        snapshot, point = self._unused.pop(), self._report[_POSITION]
        if not self._loop.save(snapshot.memory):
            raise failure_error(self.wired)
        for instance in self.wired.instances.values():
            instance.start_anew()
        control = self.step_control
        step_control = control.state if control else {}
        return SavedState(snapshot, point, step_control, self._record.keep(point), self._unused)

    def restore(self, state: SavedState) -> None:
        """Goes back to a state that this run saved, also after a failure, or on to one on another way.

        Parameters
        ----------
        state : SavedState
            Result of `save`.

        Raises
        ------
        OrchestrationError
            For a state of another run, and after an FMU returned fatal.
        """
        self._check_not_ended()
        if state.unused is not self._unused:
            raise OrchestrationError(stale("saved state"))
        if self.failure or self._report[_TERMINATED]:
            if any(instance.returned_fatal for instance in self.wired.instances.values()):
                raise OrchestrationError(self.failure)
            state.snapshot.restore()
            self._move_back()
            self.failure, self._termination, self._move_back = "", {}, lambda: None
        elif not self._loop.restore(state.snapshot.memory):
            raise failure_error(self.wired)
        if state.segment is not self._record.present:
            self._record.return_to(state.segment)
        self._report[_POSITION] = self._report[_RECORDED] = state.position
        if self._step_control:
            self._step_control.state = state.step_control

    def close(self) -> None:
        """Ends the run: frees the states saved in the FMUs, and makes readers and writers refuse."""
        self.failure = "the run has ended: expected start(experiment) for another"
        self._has_ended = True
        for instance in self.wired.instances.values():
            # which a warning of fmi2Terminate says
            instance.time = self.time
        self._resources.close()
        try:
            self._restore_process()
        except OrchestrationError as error:
            warnings.warn(str(error), FmuWarning, stacklevel=3)
