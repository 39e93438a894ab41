"""The whole system at one communication point, in memory: to go back to, with the record that leads there.

A run that goes back writes new rows over the old ones of its record. Should it later go to a state that was
saved on the way it left, the rows that lead there are needed again: they are copied when it leaves that way.
"""

import ctypes
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.errors import FmuError
from orchestration.run.access import Written
from orchestration.run.loop_data import Report, SavedMemory
from orchestration.run.run_recording import failure_error
from orchestration.run.wiring import WiredRun


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

        What the instances logged is dropped, and they are as before their failure.
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
                with suppress(FmuError):  # the instance is freed next, and its states with it
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

    written: what the caller has set until then, where that is noted
    unused: where the run finds memory for its next saved states; this one's returns there when it is deleted
    """

    snapshot: Snapshot
    position: int
    step_control: Mapping[str, Any]
    segment: Segment
    written: tuple[Written, ...]
    unused: list[Snapshot]

    def __del__(self) -> None:
        self.unused.append(self.snapshot)
