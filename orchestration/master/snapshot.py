"""The whole system at one communication point, kept in memory to go back to."""

from contextlib import suppress

import numpy as np

from orchestration.errors import FmuError
from orchestration.master.loop_data import Report, Wiring
from orchestration.master.wiring import WiredRun


def changing_arrays(wiring: Wiring) -> dict[str, np.ndarray]:
    """The arrays that a step changes; the record and the history of faults, which only grow, are left out."""
    names = ("bus", "slopes", "integers", "step_start", "warning")
    arrays = {name: getattr(wiring, name) for name in names}
    names = ("value", "slope", "sample_time", "sample", "sample_interval")
    return arrays | {name: getattr(wiring.connections, name) for name in names}


class Snapshot:
    """The states of all FMUs and the arrays of the loop at one time; call `free` at the end."""

    def __init__(self, run: WiredRun) -> None:
        self._instances, self._wiring = run.instances, run.wiring
        self._states: dict[str, int] = {}
        self._arrays = {name: array.copy() for name, array in changing_arrays(run.wiring).items()}

    def take(self) -> None:
        """Replace the snapshot by the present states and arrays."""
        for name, array in changing_arrays(self._wiring).items():
            self._arrays[name][:] = array
        for name, instance in self._instances.items():
            self._states[name] = instance.get_fmu_state(self._states.get(name))

    def restore(self) -> None:
        """Set all states and arrays back to those of the snapshot."""
        for name, array in changing_arrays(self._wiring).items():
            array[:] = self._arrays[name]
        self._wiring.report[Report.TERMINATED] = 0
        for name, instance in self._instances.items():
            instance.log.clear()
            instance.set_fmu_state(self._states[name])

    def free(self) -> None:
        """Free the states."""
        for name, state in self._states.items():
            with suppress(FmuError):  # the instance is freed next, and its states with it
                self._instances[name].free_fmu_state(state)
        self._states.clear()
