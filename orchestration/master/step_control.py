"""Steps between two communication points: after a discarded step, and to meet a tolerance.

Step doubling: a step of size h is taken once as a whole and once as two halves. The difference of the two,
divided by 2^p - 1, estimates the error of the halves, where p is the order of the exchange: 1, or 2 with
extrapolation. A step may contribute the share h / T of the tolerance, where T is the duration of the run:
the sum over all steps stays below the tolerance.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from orchestration.errors import OrchestrationError
from orchestration.fmi.instance import FmuInstance
from orchestration.master.failure import failure_error, is_discarded_step
from orchestration.master.loop_data import LoopFunctions, Report
from orchestration.master.snapshot import Snapshot
from orchestration.master.wiring import NamedWiring
from orchestration.system.prepared_run import PreparedRun

_SHORTEST = 1e-9  # of a communication step
_SAFETY, _LARGEST_REDUCTION, _LARGEST_GROWTH = 0.9, 0.2, 5.0  # the usual factors of step-size control
_GROWTH_AFTER_DISCARD = 2.0


@dataclass
class StepStatistics:
    """Steps between communication points.

    accepted; discarded: by an FMU; inexact: their estimated error was too large
    """

    accepted: int = 0
    discarded: int = 0
    inexact: int = 0


class StepControl:
    """Divides communication steps into shorter ones; every FMU must be able to restore its state.

    step_size: the next to try [s]
    """

    def __init__(
        self,
        prepared: PreparedRun,
        instances: Mapping[str, FmuInstance],
        named: NamedWiring,
        loop: LoopFunctions,
    ) -> None:
        self._instances, self._named, self._wiring, self._loop = instances, named, named.wiring, loop
        self._signals = list(prepared.experiment.signals.values())
        self._before = Snapshot(instances, named.wiring)
        self._shortest = 0.0
        self.tolerance = tolerance_of(prepared, named)
        self.step_size = prepared.experiment.step_size
        self.statistics = StepStatistics()

    def advance_to(self, point: int, check_interrupt: Callable[[], None]) -> None:
        """Advance from the communication point before `point`, where the exchange is done, to `point`."""
        time, stop = float(self._wiring.points[point - 1]), float(self._wiring.points[point])
        self._shortest = _SHORTEST * (stop - time)
        if not self.tolerance:
            self.step_size = stop - time
        while time < stop:
            check_interrupt()
            end = time + self.step_size
            if end > stop - self._shortest:
                end = stop
            elif self.tolerance and stop - end < self.step_size:
                end = time + 0.5 * (stop - time)  # two equal steps rather than a long and a short one
            self._before.take()
            if self.try_controlled_step(point - 1, time, end):
                if not self.tolerance:
                    self.step_size = _GROWTH_AFTER_DISCARD * (end - time)
                time = end
                self.statistics.accepted += 1
            else:
                self._before.restore()

    def try_controlled_step(self, point: int, start: float, end: float) -> bool:
        """Step from `start` to `end`, with error control if there is a tolerance.

        point: the communication point at or before `start`
        False if the step is not accepted: `step_size` is shorter then.
        """
        if not self.try_step(point, start, end):
            return False
        if not self.tolerance:
            return True
        coarse = self._wiring.bus[self.tolerance.bus_index]
        self._before.restore()
        middle = start + 0.5 * (end - start)
        if not (self.try_step(point, start, middle) and self.try_step(point, middle, end)):
            return False
        fine, size = self._wiring.bus[self.tolerance.bus_index], end - start
        ratio = self.tolerance.error_ratio(coarse, fine, size)
        # the error of a step is of order p + 1 in its size, the permitted error of order 1
        factor = _SAFETY * ratio ** (-1.0 / self.tolerance.order) if ratio > 0.0 else _LARGEST_GROWTH
        if not ratio <= 1.0:
            self.statistics.inexact += 1
            self._check_can_be_shorter(start, size)
        self.step_size = size * max(_LARGEST_REDUCTION, min(factor, _LARGEST_GROWTH))
        return ratio <= 1.0

    def _check_can_be_shorter(self, start: float, size: float) -> None:
        if size <= 2.0 * self._shortest:
            raise OrchestrationError(
                f"at t = {start:.9g} s the tolerance needs a step of less than {size:.3g} s: expected "
                "outputs without jumps; choose a larger tolerance, or steps of fixed size"
            )

    def try_step(self, point: int, start: float, end: float) -> bool:
        """Step from `start` to `end`; False if a component discarded the step."""
        wiring = self._wiring
        if start != wiring.points[point]:
            for index, signal in zip(wiring.signal_index, self._signals, strict=True):
                wiring.bus[index] = signal(start)
            if not self._loop.exchange(point, start, False):
                raise failure_error(self._named, self._instances, start)
        if self._loop.step(point, start, end):
            return True
        if not is_discarded_step(wiring):
            raise failure_error(self._named, self._instances, start)
        self.statistics.discarded += 1
        self.step_size = self._possible_step_size(start, end)
        if self.step_size < self._shortest:
            raise failure_error(self._named, self._instances, start)
        return False

    def _possible_step_size(self, start: float, end: float) -> float:
        """The step size [s] that the component which discarded the step to `end` can take."""
        instance = list(self._instances.values())[self._wiring.report[Report.COMPONENT]]
        reached = instance.last_successful_time()
        if reached is None:
            return 0.5 * (end - start)
        slack = self._shortest
        if not start - slack <= reached <= end + slack:
            raise OrchestrationError(
                f"{instance.name} discarded the step from {start:.9g} to {end:.9g} s and returned "
                f"LastSuccessfulTime = {reached:.9g} s: expected a time within the step"
            )
        return reached - start if start + slack < reached < end - slack else 0.5 * (end - start)

    def free(self) -> None:
        """Free the saved states."""
        self._before.free()


@dataclass(frozen=True)
class Tolerance:
    """The permitted error, relative to max(|value|, nominal).

    order: of the exchange in the step size; duration: of the run [s]
    bus_index, nominal: of the outputs from which the error is estimated, shape (m,)
    has_feedthrough: whether the output may depend directly on an input, shape (m,). The error of such an
    output does not add up from step to step: it is compared with the whole tolerance.
    """

    relative: float
    order: int
    duration: float
    bus_index: np.ndarray
    nominal: np.ndarray
    has_feedthrough: np.ndarray

    def error_ratio(self, coarse: np.ndarray, fine: np.ndarray, size: float) -> float:
        """Estimated error of the fine values over the permitted error of a step of `size` [s].

        A step is accepted up to a ratio of 1. A value that is not finite in both is left out.
        """
        share = np.where(self.has_feedthrough, 1.0, size / self.duration)
        scale = self.relative * np.maximum(np.abs(fine), self.nominal) * share
        with np.errstate(invalid="ignore"):
            ratio = np.abs(fine - coarse) / (2.0**self.order - 1.0) / scale
        ratio[~(np.isfinite(coarse) | np.isfinite(fine))] = 0.0
        ratio[np.isnan(ratio)] = np.inf
        return float(np.max(ratio, initial=0.0))


def tolerance_of(prepared: PreparedRun, named: NamedWiring) -> Tolerance | None:
    """The tolerance of a run, if it has one, for all Real outputs that are exchanged or recorded."""
    experiment, ports = prepared.experiment, prepared.system.ports
    if not experiment.tolerance:
        return None
    exchanged = {name for group in named.bus.outputs if group.type == "Real" for name in group.names}
    names = [name for name in ports if name in exchanged]
    nominal = [abs(float(ports[name].variable.nominal or 1.0)) for name in names]
    driven = {target for _, target in named.bus.connections}
    return Tolerance(
        relative=experiment.tolerance,
        order=1 + experiment.extrapolation,
        duration=experiment.stop_time - experiment.start_time,
        bus_index=np.array([named.bus.index[name] for name in names], np.int64),
        nominal=np.array(nominal),
        has_feedthrough=np.array([_has_feedthrough(prepared, name, driven) for name in names], bool),
    )


def _has_feedthrough(prepared: PreparedRun, output: str, driven: set[str]) -> bool:
    """Whether an output may depend directly on a driven input in step mode; true if not declared."""
    port = prepared.system.ports[output]
    for unknown in prepared.system.descriptions[port.component].outputs:
        if unknown.variable is port.variable and unknown.dependencies is not None:
            return any(f"{port.component}.{variable.name}" in driven for variable in unknown.dependencies)
    return any(name.startswith(f"{port.component}.") for name in driven)
