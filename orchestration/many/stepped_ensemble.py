"""The instances of an ensemble, led step by step: values are read and set in between, of all at once."""

from collections.abc import Sequence

import numpy as np

from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.many.ensemble_loop import EnsembleLoop
from orchestration.many.ensemble_recording import EnsembleRecording
from orchestration.system.system import Port
from orchestration.system.values import fmi_value, possible_values, value_range


class SteppedEnsemble:
    """Initialised instances, all at the same communication point; `Ensemble.start` makes them.

    point: index of the communication point. The recording is that of `Simulator.step`, to the last bit; but
    a step that an FMU refuses is an error, where a Simulator tries shorter ones.
    """

    def __init__(self, loop: EnsembleLoop, count: int) -> None:
        self._loop, self._prepared, self._count = loop, loop.prepared, count
        self._driven = {*loop.prepared.experiment.signals, *(target for _, target in loop.connections)}
        self._groups = [loop.data_of_group(group) for group in range(len(loop.rows))]
        self.point = 0

    @property
    def time(self) -> float:
        """The present communication point [s]."""
        return float(self._prepared.points[self.point])

    @property
    def points(self) -> np.ndarray:
        """The communication points of the run [s]."""
        return self._prepared.points

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
        ports = [self._prepared.system.port(name, "read") for name in names]
        if not self._driven.isdisjoint(names):
            self._exchange()
        return np.array([self._loop.values(port).reshape(-1)[: self._count] for port in ports])

    def write(self, names: Sequence[str], values: np.ndarray) -> None:
        """Set external inputs from the present point on; values: shape (names, instances).

        Raises SystemDefinitionError, and sets none, for another variable or shape, and for a value that is
        not finite or outside of the declared range.
        """
        ports = [self._prepared.system.port(name, "write") for name in names]
        for name in names:
            if name not in self._prepared.external:
                expected = ", ".join(self._prepared.external)
                raise SystemDefinitionError(f"write: {name}: expected an external input: {expected}")
        if values.shape != (len(ports), self._count):
            raise SystemDefinitionError(
                f"write: shape {values.shape}: expected (names, instances) = {(len(ports), self._count)}"
            )
        for port, of_instances in zip(ports, values, strict=True):
            _check(port, of_instances)
        for port, of_instances in zip(ports, values, strict=True):
            lanes = self._loop.values(port)
            lanes[:] = np.resize(of_instances, lanes.shape)

    def recordings(self) -> EnsembleRecording:
        """The values recorded until now, those of the present communication point included."""
        self._exchange()
        return self._record()

    def _exchange(self) -> None:
        """Set and record what the next step sets and records first."""
        for data in self._groups:
            self._loop.exchange(data, self.point)

    def _record(self) -> EnsembleRecording:
        counts = np.full(self._count, self.point + 1)
        rows = self._loop.rows[:, :, : self.point + 1].copy()  # which the next steps leave as they are
        return EnsembleRecording(self._prepared, {}, rows, counts, {})


def _check(port: Port, values: np.ndarray) -> None:
    """SystemDefinitionError for a value that the input cannot have."""
    low, high = value_range(port)
    for value in values[~(possible_values(port, values)[1] & (low <= values) & (values <= high))]:
        fmi_value(port, float(value))  # which refuses it
