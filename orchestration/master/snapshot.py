"""The whole system at one communication point, kept so that it can be gone back to."""

from collections.abc import Mapping

import numpy as np

from orchestration.errors import FmuError
from orchestration.fmi.instance import FmuInstance
from orchestration.master.loop import Wiring


def moving_arrays(w: Wiring) -> dict[str, np.ndarray]:
    """What a step changes, but for the record and the history of faults, which only grow."""
    links = w.links
    return {
        "bus": w.bus, "slopes": w.slopes, "whole": w.whole, "begun": w.begun, "warned": w.warned,
        "value": links.value, "slope": links.slope, "stamp": links.stamp, "given": links.given,
        "interval": links.interval,
    }  # fmt: skip


class Snapshot:
    """States of all FMUs and the arrays between them; `free` when it is needed no more."""

    def __init__(self, components: Mapping[str, FmuInstance], w: Wiring) -> None:
        self._components, self._wiring = components, w
        self._states: dict[str, int] = {}
        self._arrays = {name: array.copy() for name, array in moving_arrays(w).items()}

    def take(self) -> None:
        """Now."""
        for name, array in moving_arrays(self._wiring).items():
            self._arrays[name][:] = array
        for name, component in self._components.items():
            self._states[name] = component.get_fmu_state(self._states.get(name))

    def restore(self) -> None:
        """Back to when it was taken."""
        for name, array in moving_arrays(self._wiring).items():
            array[:] = self._arrays[name]
        for name, component in self._components.items():
            component.log.clear()
            component.set_fmu_state(self._states[name])

    def free(self) -> None:
        for name, state in self._states.items():
            try:
                self._components[name].free_fmu_state(state)
            except FmuError:  # the instance goes next, and its states with it
                continue
        self._states.clear()
