"""The instances of an ensemble: led step by step or to the end at once, and what they record."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.many.ensemble_loop import EnsembleLoop
from orchestration.results.recording import Recording, on_host
from orchestration.run.run_recording import make_recording
from orchestration.system.system import Port
from orchestration.system.values import fmi_value, possible_values, value_range


@dataclass(frozen=True)
class EnsembleRecording(Recording):
    """Recording of many instances, with a first axis of runs; NaN after the end of one that failed.

    Parameters
    ----------
    names, units, time, values, provenance, strings
        See `Recording`; the shape of `values` is (runs, n, len(names)).
    counts : array of int, shape (runs,)
        Recorded communication points of each instance.
    failures : mapping
        Instance -> why it ended early.
    """

    counts: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    failures: Mapping[int, str] = field(default_factory=dict)

    @property
    def complete(self) -> list[int]:
        """Instances that did not fail."""
        return [instance for instance in range(len(self.counts)) if instance not in self.failures]

    def recordings(self) -> Recording:
        """Returns the recordings of the `complete` instances.

        Returns
        -------
        Recording
            With a first axis of runs.
        """
        of_signals = self.values.transpose(2, 0, 1)  # as they lie in memory
        values = of_signals[:, self.complete].transpose(1, 2, 0) if self.failures else self.values
        return Recording(self.names, self.units, self.time, values, self.provenance, self.strings)

    def run(self, index: int) -> Recording:
        """Returns the recording of one instance, until its end.

        Parameters
        ----------
        index : int
            Number of the instance, from 0.

        Returns
        -------
        Recording
        """
        count = self.counts[index]
        time, values = self.time[:count], on_host(self.values[index, :count])
        return Recording(self.names, self.units, time, values, self.provenance, self.strings)


class SteppedEnsemble:
    """Instances that the caller leads, all at the same communication point; `Ensemble.start` makes them.

    It has the form of `Run`, with an array for the instances in place of a number. The recording equals
    the recordings of as many stepped runs, to the last bit; but a step that an FMU refuses is an error,
    where a Simulator tries shorter ones.

    Attributes
    ----------
    point : int
        Index of the communication point.
    failures : dict
        Instance -> why it ended early.
    """

    is_terminated = False  # its FMUs never terminate a simulation

    def __init__(self, loop: EnsembleLoop, count: int) -> None:
        self._loop, self._prepared, self._count = loop, loop.prepared, count
        self._driven = {*loop.prepared.experiment.signals, *(target for _, target in loop.connections)}
        self.point, self.failures = 0, dict[int, str]()
        self._note_failures()

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
        """Steps to the next communication point.

        Raises
        ------
        SimulationError
            If an instance cannot; `recording` has its values until then.
        OrchestrationError
            At the stop time.
        """
        if self.is_done:
            raise OrchestrationError(
                f"the run is at its stop time, {self.time:.9g} s: expected no further step"
            )
        self._run_to(self.point + 1)
        for instance, reason in self.failures.items():
            raise SimulationError(f"instance {instance}: {reason}", self._recording().run(instance))
        self.point += 1

    def run_to_end(self) -> None:
        """Runs the groups to their end; the other instances of one that fails go on."""
        self._run_to(len(self.points) - 1)
        self.point = len(self.points) - 1

    def _run_to(self, last: int) -> None:
        self._loop.run_points(self.point, last)
        self._note_failures()

    def reader(self, *names: str) -> Callable[[], Any]:
        """Returns a function that returns the present values of one variable, or a tuple of several.

        Parameters
        ----------
        *names : str
            "component.variable" of each.

        Returns
        -------
        function
            Without arguments. Values have the shape (instances,); Booleans are 0.0 and 1.0.

        Raises
        ------
        SystemDefinitionError
            For an unknown variable.
        """
        ports = [self._prepared.system.port(name, "reader") for name in names]
        must_exchange = not self._driven.isdisjoint(names)

        def read() -> Any:
            if must_exchange:
                self._loop.exchange(self.point)
            values = [self._loop.values(port).flatten()[: self._count] for port in ports]
            return tuple(values) if len(values) > 1 else values[0]

        return read

    def writer(self, *names: str) -> Callable[..., None]:
        """Returns a function that sets external inputs from the present point on.

        Parameters
        ----------
        *names : str
            "component.variable" of each external input.

        Returns
        -------
        function
            Its arguments are an array of shape (instances,) for each name. It raises SystemDefinitionError,
            and sets none, for another shape, and for a value that is not finite or outside of the declared
            range.

        Raises
        ------
        SystemDefinitionError
            For a variable that is no external input.
        """
        ports = [self._prepared.system.port(name, "writer") for name in names]
        for name in names:
            if name not in self._prepared.external:
                expected = ", ".join(self._prepared.external)
                raise SystemDefinitionError(f"writer: {name}: expected an external input: {expected}")

        def write(*values: np.ndarray) -> None:
            for port, of_instances in zip(ports, values, strict=True):
                if of_instances.shape != (self._count,):
                    raise SystemDefinitionError(
                        f"{port.name}: shape {of_instances.shape}: expected (instances,) = ({self._count},)"
                    )
                _check(port, of_instances)
            for port, of_instances in zip(ports, values, strict=True):
                self._loop.put(port, of_instances)

        return write

    def recording(self) -> EnsembleRecording:
        """Returns the values recorded until now, including the present communication point.

        Returns
        -------
        EnsembleRecording
        """
        self._loop.exchange(self.point)
        return self._recording()

    def _note_failures(self) -> None:
        counts, failures = self._loop.ends()
        for instance in np.flatnonzero(failures).tolist():
            self.failures.setdefault(instance, self._loop.reason(counts[instance], failures[instance]))

    def _recording(self) -> EnsembleRecording:
        points = self.point + 1
        values = self._loop.signals(points).transpose(1, 2, 0)
        counts = np.minimum(self._loop.ends()[0], points)
        for instance in self.failures:
            values[instance, counts[instance] :] = np.nan
        common = make_recording(self._prepared, values, points, is_final=True)
        failures = dict(sorted(self.failures.items()))
        return EnsembleRecording(**vars(common), counts=counts, failures=failures)


def _check(port: Port, values: np.ndarray) -> None:
    """Raises SystemDefinitionError for a value that the input cannot have."""
    low, high = value_range(port)
    for value in values[~(possible_values(port, values)[1] & (low <= values) & (values <= high))]:
        fmi_value(port, float(value))  # which refuses it
