"""From one communication point to the last: the loop in stretches, and what interrupts it.

A stretch ends where Python must look: at an event, at a checkpoint, and some ten times a second for the
progress and an interrupt. Where a component discards a step, the system goes back to the beginning of the
stretch, comes again to the discarded step, and takes it in shorter ones.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from orchestration.errors import OrchestrationError
from orchestration.fmi.instance import FmuInstance
from orchestration.master.failure import explain, is_discarded_step, judge_warnings
from orchestration.master.loop import RECORDED, Entries
from orchestration.master.pacing import Pacing
from orchestration.master.progress import Progress
from orchestration.master.record import make_recording
from orchestration.master.snapshot import Snapshot
from orchestration.master.step_control import ShorterSteps, Tolerance
from orchestration.master.wiring import Loom
from orchestration.results.recording import Recording
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import CheckedSystem

_STRETCH_S = 0.05
_GROWTH = 8  # of a stretch at most, from one to the next: the first ones tell how long a step takes
MOST_STEPS = 1_000_000


class Run:
    """Initialised components on their way; `position` is the communication point that they are at."""

    def __init__(
        self,
        prepared: PreparedRun,
        components: Mapping[str, FmuInstance],
        loom: Loom,
        loop: Entries,
    ) -> None:
        self.prepared, self._components = prepared, components
        self.loom, self.wiring, self._loop = loom, loom.wiring, loop
        self.position = 0
        self._check_interrupt: Callable[[], None] = lambda: None
        self._snapshot = None if prepared.retry_obstacle else Snapshot(components, self.wiring)
        self.shorter = None if prepared.retry_obstacle else self._shorter_steps()

    def _shorter_steps(self) -> ShorterSteps:
        experiment = self.prepared.experiment
        signals = list(experiment.signals.values())
        tolerance = _tolerance(self.prepared, self.loom) if experiment.tolerance else None
        return ShorterSteps(self._components, self.loom, self._loop, signals, tolerance, experiment.step_size)

    def read_outputs(self) -> None:
        """The outputs of the first communication point."""
        for c in range(len(self._components)):
            if not self._loop.read(c):
                raise self._failure()

    def go(
        self,
        check_interrupt: Callable[[], None],
        progress: Progress | None = None,
        pacing: Pacing | None = None,
        keeper: Callable[[int], int] | None = None,
    ) -> None:
        """To the last communication point.

        keeper: called at each point where the loop rests; how many steps it may take to the next rest
        """
        last = len(self.wiring.points) - 1
        stretch = 1
        self._check_interrupt = check_interrupt
        while self.position < last:
            check_interrupt()
            if progress:
                progress(self.position, last)
            kept = keeper(self.position) if keeper else MOST_STEPS
            self._change(self.position)
            if pacing:
                pacing.wait(float(self.wiring.points[self.position]), check_interrupt)
            most = min(kept, 1 if pacing else stretch)
            begun, first = time.perf_counter(), self.position
            repeated = self._cover(self._rest(first + most))
            steps_a_second = (self.position - first) / max(time.perf_counter() - begun, 1e-9)
            longer = min(_GROWTH * stretch, int(_STRETCH_S * steps_a_second), MOST_STEPS)
            stretch = 1 if repeated else max(1, longer)
        check_interrupt()
        self._change(last)
        if pacing:
            pacing.wait(float(self.wiring.points[last]), check_interrupt)
        if not self._loop.arrive(last):
            raise self._failure()
        if progress:
            progress(last, last)

    def _rest(self, wanted: int) -> int:
        """The communication point at which to rest: the one wanted, the next change or the last."""
        changes = (i for i in self.prepared.changes if i > self.position)
        return min(wanted, len(self.wiring.points) - 1, *changes)

    def look(self) -> None:
        """Record the present communication point too, for a run that ends here."""
        self._loop.arrive(self.position)

    def _cover(self, end: int) -> bool:
        """To communication point `end`, or behind a step that had to be done in shorter ones (then True)."""
        if self.shorter and self.shorter.tolerance:
            self._in_shorter_steps()
            return True
        if self._snapshot:
            self._snapshot.take()
        begun, self.position = self.position, self._loop.run(self.position, end)
        judge_warnings(self.loom, self._components, failed=self.position < end)
        if self.position == end:
            return False
        if not is_discarded_step(self.wiring):
            raise self._failure()
        if not (self._snapshot and self.shorter):
            raise OrchestrationError(
                f"{self._failure()}; no shorter step was tried, as {self.prepared.retry_obstacle}"
            )
        self._snapshot.restore()
        if self._loop.run(begun, self.position) != self.position:
            raise self._failure()
        self._in_shorter_steps()
        return True

    def _in_shorter_steps(self) -> None:
        assert self.shorter
        assert self._snapshot
        if not self._loop.arrive(self.position):
            raise self._failure()
        self._snapshot.take()
        try:
            self.shorter.cover(self.position, self._check_interrupt)
        except KeyboardInterrupt:  # between two communication points nothing can be saved
            self._snapshot.restore()
            raise
        judge_warnings(self.loom, self._components, failed=False)
        self.position += 1

    def _failure(self) -> OrchestrationError:
        return explain(self.loom, self._components, float(self.wiring.points[self.position]))

    def _change(self, position: int) -> None:
        """Make the changes that are scheduled for a communication point."""
        for port, value in self.prepared.changes.get(position, []):
            component = self._components[port.component]
            component.time = float(self.wiring.points[position])
            component.set(port.variable, value)

    def recording(self, pacing: Pacing | None) -> Recording:
        """What there is until now."""
        done = int(self.wiring.report[RECORDED])
        more = self._effort() | ({"real_time": pacing.report()} if pacing else {})
        return make_recording(self.prepared, self.wiring.rows, done, more)

    def _effort(self) -> dict[str, int]:
        """What shorter steps took, if there were any."""
        done = self.shorter.effort if self.shorter else None
        if not done or not (done.steps or done.discarded):
            return {}
        return {
            "steps_between_points": done.steps,
            "discarded_steps": done.discarded,
            "inexact_steps": done.inexact,
        }

    def changes_before(self, position: int) -> list[tuple[int, str, Any]]:
        """Scheduled changes that were made before a communication point."""
        return [
            (at, port.name, value)
            for at, changes in sorted(self.prepared.changes.items())
            for port, value in changes
            if at < position
        ]

    def free(self) -> None:
        """Give the saved states back to the FMUs."""
        for each in (self._snapshot, self.shorter):
            if each:
                each.free()


def _follows_at_once(checked: CheckedSystem, name: str, driven: set[str]) -> bool:
    """Whether an output follows a driven input directly in step mode; what is not declared may."""
    port = checked.ports[name]
    for unknown in checked.descriptions[port.component].outputs:
        if unknown.variable is port.variable and unknown.dependencies is not None:
            return any(f"{port.component}.{each.name}" in driven for each in unknown.dependencies)
    return any(each.startswith(f"{port.component}.") for each in driven)


def _tolerance(prepared: PreparedRun, loom: Loom) -> Tolerance:
    """Judged by every Real output that travels or is recorded."""
    checked, experiment = prepared.system, prepared.experiment
    names = [n for n in loom.outputs if checked.ports[n].variable.type == "Real"]
    nominal = [abs(float(checked.ports[n].variable.nominal or 1.0)) for n in names]
    driven = {target for _, target in loom.links}
    return Tolerance(
        relative=experiment.tolerance or 0.0,
        order=1 + experiment.extrapolation,
        duration=experiment.stop_time - experiment.start_time,
        places=np.array([loom.place(n) for n in names], np.int64),
        nominal=np.array(nominal),
        at_once=np.array([_follows_at_once(checked, n, driven) for n in names], bool),
    )
