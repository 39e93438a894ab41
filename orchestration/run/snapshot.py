"""The whole system at one communication point, kept in memory to go back to."""

import ctypes
from contextlib import suppress

from orchestration.errors import FmuError
from orchestration.run.failure import failure_error
from orchestration.run.loop_data import LoopFunctions, Report, SavedMemory
from orchestration.run.wiring import WiredRun


class Snapshot:
    """The states of all FMUs and the arrays of the loop at one time; call `free` at the end."""

    def __init__(self, run: WiredRun, loop: LoopFunctions) -> None:
        self._run, self._loop = run, loop
        self._memory = new_memory(run)

    def take(self) -> None:
        """Replace the snapshot by the present states and arrays."""
        if not self._loop.save(self._memory):
            raise failure_error(self._run)

    def restore(self) -> None:
        """Set all states and arrays back to those of the snapshot."""
        restore_after_failure(self._run, self._loop, self._memory)

    def free(self) -> None:
        """Free the states."""
        free_states(self._run, self._memory)


def new_memory(run: WiredRun) -> SavedMemory:
    """Memory for `LoopFunctions.save`, without saved states."""
    return (ctypes.c_int64 * (len(run.instances) + len(run.wiring.memory)))()


def restore_after_failure(run: WiredRun, loop: LoopFunctions, saved: SavedMemory) -> None:
    """Set everything back; what the instances logged is dropped, and they are as before their failure."""
    for instance in run.instances.values():
        instance.log.clear()
    if not loop.restore(saved):
        raise failure_error(run)
    run.wiring.report[Report.TERMINATED] = 0
    for instance in run.instances.values():
        instance.forget_failure()


def free_states(run: WiredRun, saved: SavedMemory) -> None:
    """Free the saved states."""
    for c, instance in enumerate(run.instances.values()):
        if saved[c]:
            with suppress(FmuError):  # the instance is freed next, and its states with it
                instance.free_fmu_state(saved[c])
        saved[c] = 0
