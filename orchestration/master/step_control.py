"""Steps between two communication points: after a discarded step, and to meet a tolerance.

Step doubling: a step of size h is taken once as a whole and once as two halves. The difference of the two,
divided by 2^p - 1, estimates the error of the halves, where p is the order of the exchange: 1, or 2 with
extrapolation. A step may contribute the share h / T of the tolerance, where T is the duration of the run:
the sum over all steps stays below the tolerance.
"""

from collections.abc import Callable

import numpy as np

from orchestration.errors import OrchestrationError
from orchestration.fmi.description import of_causality
from orchestration.fmi.instance import FmuInstance
from orchestration.master.failure import failure_error, is_discarded_step
from orchestration.master.loop_data import LoopFunctions, Report
from orchestration.master.snapshot import Snapshot
from orchestration.master.wiring import WiredRun
from orchestration.system.system import CheckedSystem, Port

_SHORTEST = 1e-9  # of a communication step
_SAFETY, _LARGEST_REDUCTION, _LARGEST_GROWTH = 0.9, 0.2, 5.0  # the usual factors of step-size control
_GROWTH_AFTER_DISCARD = 2.0


class StepControl:
    """Divides communication steps into shorter ones; every FMU must be able to restore its state.

    step_size: the next to try [s]
    statistics: numbers of steps between communication points, discarded ones (by an FMU) and inexact ones (of
    too large an estimated error), under their names in the provenance
    """

    def __init__(self, run: WiredRun, loop: LoopFunctions) -> None:
        self._run, self._wiring, self._loop = run, run.wiring, loop
        experiment = run.prepared.experiment
        ports, indices = run.prepared.system.ports, run.wiring.signal_index.tolist()
        self._signals = [  # others keep the value of the communication point
            (index, signal)
            for index, (name, signal) in zip(indices, experiment.signals.items(), strict=True)
            if ports[name].variable.type == "Real"
        ]
        self._before = Snapshot(run, loop)
        self._shortest = 0.0
        self._terminated = 0
        self.tolerance = Tolerance(run) if experiment.tolerance else None
        self.step_size = experiment.step_size
        self.statistics = dict.fromkeys(("steps_between_points", "discarded_steps", "inexact_steps"), 0)

    def advance_to(self, point: int, check_interrupt: Callable[[], None]) -> float:
        """Advance from the communication point before `point`, where the exchange is done, to `point`.

        Returns the time reached [s]: earlier than that of `point` if a component terminated the simulation.
        """
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
                self.statistics["steps_between_points"] += 1
            else:
                self._before.restore()
                self._wiring.report[Report.TERMINATED] = self._terminated
            if self._wiring.report[Report.TERMINATED]:
                break
        return time

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
        if not self.try_step(point, start, middle):
            return False
        if self._wiring.report[Report.TERMINATED]:
            self.step_size = middle - start
            return False
        if not self.try_step(point, middle, end):
            return False
        fine, size = self._wiring.bus[self.tolerance.bus_index], end - start
        ratio = self.tolerance.error_ratio(coarse, fine, size)
        # the error of a step is of order p + 1 in its size, the permitted error of order 1
        factor = _SAFETY * ratio ** (-1.0 / self.tolerance.order) if ratio > 0.0 else _LARGEST_GROWTH
        if not ratio <= 1.0:
            self.statistics["inexact_steps"] += 1
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
            for index, signal in self._signals:
                wiring.bus[index] = signal(start)
            if not self._loop.exchange(point, start, False):
                raise failure_error(self._run, start)
        if self._loop.step(point, start, end):
            return True
        if not is_discarded_step(wiring):
            raise failure_error(self._run, start)
        self.statistics["discarded_steps"] += 1
        component = int(wiring.report[Report.COMPONENT])
        instance = list(self._run.instances.values())[component]
        terminates = instance.terminates()
        self.step_size = self._possible_step_size(instance, start, end, terminates)
        if self.step_size < self._shortest:
            if not terminates:
                raise failure_error(self._run, start)
            self._terminated = component + 1
        return False

    def _possible_step_size(self, instance: FmuInstance, start: float, end: float, terminates: bool) -> float:
        """The step size [s] of an FMU that discarded the step to `end`; 0 if it ends at `start`."""
        reached = instance.last_successful_time()
        if reached is None:
            return 0.5 * (end - start)
        slack = self._shortest
        if not start - slack <= reached <= end + slack:
            raise OrchestrationError(
                f"{instance.name} discarded the step from {start:.9g} to {end:.9g} s and returned "
                f"LastSuccessfulTime = {reached:.9g} s: expected a time within the step"
            )
        if terminates and reached <= start + slack:
            return 0.0
        return reached - start if start + slack < reached < end - slack else 0.5 * (end - start)

    def free(self) -> None:
        """Free the saved states."""
        self._before.free()


class Tolerance:
    """The permitted error, relative to max(|value|, nominal), of all Real outputs exchanged or recorded.

    order: of the exchange in the step size
    bus_index: of the outputs, shape (m,)
    """

    def __init__(self, run: WiredRun) -> None:
        experiment, ports = run.prepared.experiment, run.prepared.system.ports
        read = [name for group in run.bus.outputs if group.type == "Real" for name in group.names]
        names = [name for name in read if ports[name].variable.causality == "output"]
        driven = {ports[target] for _, target in run.bus.connections}
        self.order = 1 + experiment.extrapolation
        self.bus_index = np.array([run.bus.index[name] for name in names], np.int64)
        self._relative = experiment.tolerance
        self._duration = experiment.stop_time - experiment.start_time
        self._nominal = np.array([abs(float(ports[name].variable.nominal or 1.0)) for name in names])
        # The error of an output that may depend directly on an input in step mode does not add up from step
        # to step: it is compared with the whole tolerance.
        feedthrough = outputs_with_feedthrough(run.prepared.system, driven)
        self._has_feedthrough = np.array([name in feedthrough for name in names], bool)

    def error_ratio(self, coarse: np.ndarray, fine: np.ndarray, size: float) -> float:
        """Estimated error of the fine values over the permitted error of a step of `size` [s].

        A step is accepted up to a ratio of 1. A value that is not finite in both is left out.
        """
        share = np.where(self._has_feedthrough, 1.0, size / self._duration)
        scale = self._relative * np.maximum(np.abs(fine), self._nominal) * share
        with np.errstate(invalid="ignore"):
            ratio = np.abs(fine - coarse) / (2.0**self.order - 1.0) / scale
        ratio[~(np.isfinite(coarse) | np.isfinite(fine))] = 0.0
        ratio[np.isnan(ratio)] = np.inf
        return float(np.max(ratio, initial=0.0))


def outputs_with_feedthrough(system: CheckedSystem, driven: set[Port]) -> set[str]:
    """Names of the outputs that may depend directly on a driven input in step mode; all if not declared."""
    own = {id(port.variable) for port in driven}
    components = {port.component for port in driven}
    names = set()
    for component, description in system.descriptions.items():
        declared = {id(unknown.variable): unknown.dependencies for unknown in description.outputs}
        for variable in of_causality(description, "output"):
            dependencies = declared.get(id(variable))
            if component in components if dependencies is None else any(id(v) in own for v in dependencies):
                names.add(f"{component}.{variable.name}")
    return names
