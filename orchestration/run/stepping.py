"""A run from the first communication point to the last: the loop in batches, and what happens between them.

A batch ends where Python has to act: at a scheduled change, at a checkpoint, and some ten times a second for
the progress and an interrupt. Where a component discards a step, the system is set back to the start of the
batch, steps again to the discarded step, and takes that one in shorter steps.
"""

import time
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording
from orchestration.run.compiled_loop import StepThreads
from orchestration.run.interrupt import Pacing
from orchestration.run.loop_data import LoopFunctions, Report
from orchestration.run.process_guard import ProcessGuard
from orchestration.run.run_recording import emit_warnings, failure_error, is_discarded_step, make_recording
from orchestration.run.run_statistics import RunStatistics
from orchestration.run.snapshot import Snapshot
from orchestration.run.step_control import StepControl
from orchestration.run.wiring import WiredRun
from orchestration.system.faults import Pattern
from orchestration.system.system import Port

_BATCH_S = 0.05
_GROWTH = 8  # largest growth of a batch from one to the next: the first ones measure how long a step takes
MOST_STEPS = 1_000_000  # in a batch
_POSITION = int(Report.POSITION)


class Progress(Protocol):
    """Called some ten times a second with the communication points done, and all of the run."""

    def __call__(self, done: int, total: int, /) -> object: ...


class RunInProgress:
    """Initialised instances on their way through a run.

    step_control: None where steps cannot be repeated
    batch: steps of the next batch
    threads: see `StepThreads`
    statistics: None if they were not asked for
    """

    batch = 1
    failure = ""  # of a run that the caller leads
    statistics: RunStatistics | None = None

    def __init__(
        self, wired: WiredRun, loop: LoopFunctions, guard: ProcessGuard, threads: int | None = 1
    ) -> None:
        self.wired, self._loop, self.guard = wired, loop, guard
        self._threads = StepThreads(wired.wiring, loop, threads)
        self.prepared, self.instances, self.wiring = wired.prepared, wired.instances, wired.wiring
        self._report = wired.wiring.report.data  # quicker than the array
        self._termination: dict[str, Any] = {}
        self._changes = sorted(wired.prepared.changes)
        self._check_interrupt: Callable[[], None] = lambda: None
        can_repeat = not wired.prepared.retry_obstacle
        self._snapshot = Snapshot(wired, loop) if can_repeat else None
        self.step_control = StepControl(wired, loop) if can_repeat else None

    @property
    def position(self) -> int:
        """Index of the present communication point; the loop moves it on, whatever interrupts Python."""
        return self._report[_POSITION]

    @position.setter
    def position(self, point: int) -> None:
        self._report[_POSITION] = point

    def read_outputs(self) -> None:
        """Reads the outputs at the first communication point."""
        for c in range(len(self.instances)):
            if not self._loop.read_outputs(c):
                raise self._failure()

    def run_to_end(
        self,
        check_interrupt: Callable[[], None],
        progress: Progress | None = None,
        pacing: Pacing | None = None,
        checkpoint_callback: Callable[[int], int] | None = None,
    ) -> None:
        """Runs to the last communication point, or to that at which a component terminates the simulation.

        checkpoint_callback: called with the position between two batches; returns the most steps of the next
        """
        last = len(self.wiring.points) - 1
        self._check_interrupt = check_interrupt
        while self.position < last and not self._is_terminated():
            check_interrupt()
            if progress:
                progress(self.position, last)
            most = checkpoint_callback(self.position) if checkpoint_callback else MOST_STEPS
            self._change_and_wait(pacing)
            most = min(most, 1 if pacing else self.batch)
            start, first = time.perf_counter(), self.position
            repeated = self._run_batch(self._batch_end(first + most))
            steps_a_second = (self.position - first) / max(time.perf_counter() - start, 1e-9)
            longer = min(_GROWTH * self.batch, int(_BATCH_S * steps_a_second), MOST_STEPS)
            self.batch = 1 if repeated else max(1, longer)
        check_interrupt()
        self._finish(pacing)
        if progress:
            progress(self.position, self.position)

    def _finish(self, pacing: Pacing | None = None) -> None:
        """Makes the changes of the last communication point, which no FMU that ended accepts; records it."""
        if not self._is_terminated():
            self._change_and_wait(pacing)
        if not self.record_now():
            raise self._failure()

    def record_now(self) -> bool:
        """Records the present communication point too, for a run that ends here; False if it failed."""
        if self._is_terminated() and self.wiring.report[Report.RECORDED] > self.position:
            return True  # what components that cannot go back have computed since is of a later time
        return bool(self._loop.exchange_and_record(self.position))

    def _batch_end(self, end: int) -> int:
        """Returns the first of `end`, the next scheduled change and the last communication point."""
        next_change = bisect_right(self._changes, self.position)
        return min(end, len(self.wiring.points) - 1, *self._changes[next_change : next_change + 1])

    def _run_batch(self, end: int) -> bool:
        """Runs to communication point `end`, or to behind a step that was divided (then True)."""
        if self.step_control and self.step_control.tolerance:
            self._divide_step()
            return True
        if self._snapshot:
            self._snapshot.take()
        start, reached = self.position, self._threads.run(self.position, end)
        is_terminated = self._is_terminated()
        self.look_around(failed=reached < end)
        if reached < end and not is_terminated:
            self._repeat_discarded_step(start)
        return reached < end

    def look_around(self, failed: bool = False) -> None:
        """Looks at what FMUs did to this process, and issues their warnings."""
        self.restore_process()
        emit_warnings(self.wired, failed and not self.wiring.report[Report.TERMINATED])

    def _repeat_discarded_step(self, start: int) -> None:
        """Takes the step that failed in shorter ones if it was discarded; else raises the failure.

        start: the communication point of the snapshot
        """
        if not is_discarded_step(self.wiring):
            raise self._failure()
        if not self._snapshot:
            self._terminate_within_step()
            return
        self._snapshot.restore()
        if self._loop.run(start, self.position) != self.position:
            raise self._failure()
        self._divide_step()

    def _divide_step(self) -> None:
        """Goes on to the next communication point under step control."""
        assert self.step_control
        assert self._snapshot
        if not self._loop.exchange_and_record(self.position):
            raise self._failure()
        self._snapshot.take()
        state = self.step_control.state
        try:
            reached = self.step_control.advance_to(self.position + 1, self._check_interrupt)
        except KeyboardInterrupt:  # between two communication points nothing can be saved
            self._snapshot.restore()
            self.step_control.state = state
            raise
        self._is_terminated(reached)
        self.look_around()
        self._go_to(reached)

    def _terminate_within_step(self) -> None:
        """Ends the run if the component that discarded its step terminates the simulation; the others stay.

        Raises OrchestrationError if it does not.
        """
        component = int(self.wiring.report[Report.COMPONENT])
        instance = list(self.instances.values())[component]
        if not instance.terminates():
            obstacle = self.prepared.retry_obstacle
            raise OrchestrationError(f"{self._failure()}; no shorter step was tried, as {obstacle}")
        self.wiring.report[Report.TERMINATED] = component + 1
        before, after = self.wiring.points[self.position : self.position + 2].tolist()
        reached = instance.last_successful_time()
        if reached is None or not before <= reached <= after:
            reached = before
        self._is_terminated(reached)
        self.look_around()
        if len(self.instances) == 1 and reached > before:
            self._go_to(reached)
            self.read_outputs()

    def _is_terminated(self, time: float | None = None) -> bool:
        """Whether a component has terminated the simulation, at `time` [s] or else at the present point."""
        component = int(self.wiring.report[Report.TERMINATED])
        if component and not self._termination:
            time = float(self.wiring.points[self.position]) if time is None else time
            instance = list(self.instances.values())[component - 1]
            messages = instance.termination_log or [message for _, message in instance.log]
            self._termination = {"component": instance.name, "time_s": time, "messages": messages}
        return component > 0

    def _go_to(self, time: float) -> None:
        """Makes the next communication point the present one; at an earlier time [s] it is the last one.

        At the time of the present point nothing changes.
        """
        wiring, index = self.wiring, self.position + 1
        if time > wiring.points[self.position]:
            self.position = index
        if wiring.points[self.position] > time:
            wiring.points[index] = time
            shortened = replace(self.prepared, points=wiring.points[: index + 1])
            wiring.signal_values[:, index] = shortened.signal_values[:, -1]
            for row, pattern in enumerate(shortened.fault_patterns.values()):
                wiring.faults.put(row, index, Pattern(*(x[-1] for x in pattern)))

    def restore_process(self) -> None:
        """Restores what `ProcessGuard` does, if the FMUs may have changed it."""
        if self.wiring.independent:
            return
        names = ", ".join(self.instances)
        self.guard.restore(f"one of {names}" if len(self.instances) > 1 else names)

    def _failure(self) -> OrchestrationError:
        return failure_error(self.wired)

    def _change_and_wait(self, pacing: Pacing | None) -> None:
        """Makes the scheduled changes of the present communication point; in real time, waits for it."""
        for port, value in self.prepared.changes.get(self.position, ()):
            self.set_in_fmu(port, value)
        if pacing:
            pacing.wait(float(self.wiring.points[self.position]), self._check_interrupt)

    def set_in_fmu(self, port: Port, value: FmiValue) -> None:
        """Sets a parameter or an input that nothing drives; it is recorded from the present point on."""
        instance = self.instances[port.component]
        instance.time = float(self.wiring.points[self.position])
        instance.set(port.variable, value)
        index = self.wired.bus.index.get(port.name)
        if index is not None:
            is_string = isinstance(value, str)
            self.wiring.bus[index] = self.wired.strings.number(value) if is_string else value

    def recorded(self, pacing: Pacing | None = None, is_final: bool = False) -> Recording:
        """Returns the values recorded; is_final: the run has ended, the rows are the recording's."""
        count = int(self.wiring.report[Report.RECORDED])
        more = self.step_control.provenance if self.step_control else {}
        more |= {"terminated": self._termination} if self._termination else {}
        more |= {"real_time": pacing.report()} if pacing else {}
        if self.statistics:
            time = float(self.wiring.points[self.position])
            more |= {"statistics": self.statistics.report(time, not self._threads.have_shared)}
        rows, strings = self.wiring.rows, self.wired.strings.table
        return make_recording(self.prepared, rows, count, strings, more, is_final)

    def free(self) -> None:
        """Frees the states that were saved in the FMUs, and ends the threads."""
        self._threads.close()
        if self._snapshot and self.step_control:
            self._snapshot.free()
            self.step_control.free()
