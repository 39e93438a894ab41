"""The instances of an ensemble, led step by step: values are read and set in between, of all at once."""

from collections.abc import Sequence

import numpy as np

from orchestration.errors import OrchestrationError, SimulationError
from orchestration.master.ensemble_loop import EnsembleLoop
from orchestration.master.ensemble_recording import EnsembleRecording
from orchestration.system.values import fmi_value, value_range


class SteppedEnsemble:
    """Initialised instances, all at the same communication point; `Ensemble.start` makes them.

    point: index of the communication point. The recording is that of `Simulator.step`, to the last bit; but
    a step that an FMU refuses is an error, where a Simulator tries shorter ones.
    """

    def __init__(self, loop: EnsembleLoop, count: int) -> None:
        self._loop, self._prepared, self._count = loop, loop.prepared, count
        self._groups = [loop.data_of_group(group) for group in range(len(loop.rows))]
        self.point = 0

    @property
    def time(self) -> float:
        """The present communication point [s]."""
        return float(self._prepared.points[self.point])

    @property
    def is_done(self) -> bool:
        """Whether the instances are at their stop time."""
        return self.point + 1 == len(self._prepared.points)

    def step(self) -> None:
        """Step to the next communication point; SimulationError if an instance cannot, or at the end."""
        if self.is_done:
            raise OrchestrationError(
                f"the run is at its stop time, {self.time:.9g} s: expected no further step"
            )
        for group, data in enumerate(self._groups):
            self._loop.run_points(group, data, self.point, self.point + 1)
        failed = np.flatnonzero(self._loop.failure.ravel()[: self._count])
        if len(failed):
            raise SimulationError(
                f"instance {failed[0]}: {self._loop.reason(failed[0])}", self._record().recording(failed[0])
            )
        self.point += 1

    def read(self, names: Sequence[str]) -> np.ndarray:
        """The present values of variables, shape (names, instances); Booleans are 0.0 and 1.0."""
        ports = [self._prepared.system.ports[name] for name in names]
        return np.array([self._loop.values(port).reshape(-1)[: self._count] for port in ports])

    def write(self, names: Sequence[str], values: np.ndarray) -> None:
        """Set external inputs from the present point on; values: shape (names, instances).

        Raises SystemDefinitionError for a value that is not finite or outside of the declared range.
        """
        for name, of_instances in zip(names, values, strict=True):
            port = self._prepared.system.ports[name]
            low, high = value_range(port)
            for value in of_instances[
                ~(np.isfinite(of_instances) & (low <= of_instances) & (of_instances <= high))
            ]:
                fmi_value(port, float(value))  # which refuses it
            lanes = self._loop.values(port)
            lanes[:] = np.resize(of_instances, lanes.shape)

    def recordings(self) -> EnsembleRecording:
        """The values recorded until now, those of the present communication point included."""
        for signal, values in zip(
            self._prepared.experiment.signals, self._prepared.signal_values, strict=True
        ):
            self._loop.values(self._prepared.system.ports[signal])[:] = values[self.point]
        for column, name in enumerate(self._prepared.recorded):
            self._loop.rows[:, column, self.point] = self._loop.values(self._prepared.system.ports[name])
        return self._record()

    def _record(self) -> EnsembleRecording:
        counts = np.full(self._count, self.point + 1)
        return EnsembleRecording(self._prepared, {}, self._loop.rows, counts, {})
