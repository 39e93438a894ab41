"""The recordings of the instances of an ensemble."""

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording
from orchestration.run.run_recording import make_recording
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.signals import Signal
from orchestration.system.values import Value


@dataclass(frozen=True, eq=False)
class EnsembleRecording:
    """Signals of many instances over time.

    prepared: the run that they share; varied: variable -> its values or signals, shape (instances,)
    values: shape (groups, signals, n, lanes), instances in groups of lanes
    counts: recorded communication points of each instance, shape (instances,)
    failures: instance -> why it ended early
    """

    prepared: PreparedRun
    varied: Mapping[str, Sequence[Value | Signal]]
    values: np.ndarray
    counts: np.ndarray
    failures: Mapping[int, str]

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.counts)

    @property
    def complete(self) -> list[int]:
        """The instances that did not fail."""
        return [instance for instance in range(len(self)) if instance not in self.failures]

    def recordings(self) -> Recording:
        """Returns those of `complete`, at least one, with an axis of runs, without `varied`."""
        complete, (_, signals, points, _) = self.complete, self.values.shape
        # a signal of a run is contiguous, so that a sum along time rounds as that of the run alone
        values = np.ascontiguousarray(self.values.transpose(1, 0, 3, 2)).reshape(signals, -1, points)
        is_all = len(complete) == len(self)
        kept = values[:, : len(self)] if is_all else values[:, complete]
        return replace(self._recording(complete[0], {}), values=kept.transpose(1, 2, 0))

    @property
    def names(self) -> Sequence[str]:
        """Names of the signals, "component.variable"."""
        return self.prepared.recorded

    @property
    def time(self) -> np.ndarray:
        """Communication points [s], shape (n,)."""
        return self.prepared.points[: self.values.shape[2]]

    def __getitem__(self, name: str) -> np.ndarray:
        """A signal of every instance, shape (n, instances); NaN after the end of one that failed.

        OrchestrationError offers the nearest name for one that was not recorded.
        """
        if name not in self.names:
            raise OrchestrationError(f"{name!r} was not recorded; {nearest(name, self.names)}")
        signal = np.concatenate([*self.values[:, self.names.index(name)]], axis=1)[:, : len(self)]
        for instance in self.failures:
            signal[self.counts[instance] :, instance] = np.nan
        return signal

    def recording(self, instance: int) -> Recording:
        """That of one instance, until its end, as a `Simulator` returns it; `varied` is in its provenance."""
        varied = {name: _as_plain_data(values[instance]) for name, values in self.varied.items()}
        return self._recording(instance, {"varied": varied})

    def _recording(self, instance: int, more: Mapping[str, Any]) -> Recording:
        group, lane = divmod(range(len(self))[instance], self.values.shape[-1])
        rows = np.ascontiguousarray(self.values[group, :, :, lane].T)
        return make_recording(self.prepared, rows, int(self.counts[instance]), more=more, is_final=True)


def _as_plain_data(value: Value | Signal) -> Value:
    """A value itself; of a signal its text with all numbers and digits, without addresses in memory."""
    if not callable(value):
        return value
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return re.sub(r" at 0x[0-9A-Fa-f]+", "", repr(value))
