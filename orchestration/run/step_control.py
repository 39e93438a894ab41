"""Steps between two communication points: after a discarded step, and to meet a tolerance.

Step doubling: a step of size h is taken once as a whole and once as two halves. The difference of the two,
divided by 2^p - 1, estimates the error of the halves, where p is the order of the exchange: 1, or 2 with
extrapolation. A step may contribute the share h / T of the tolerance, where T is the duration of the run:
the sum over all steps stays below the tolerance.

Where the error does not fall with the step, the FMUs' own solvers may have left it (`tolerance.py`). Such an
error is permitted: the step stays as long as it is, and the recording holds what the run reaches instead.
"""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fmus.fmi.instance import FmuInstance
from orchestration.errors import FmuWarning, OrchestrationError
from orchestration.run.access import Snapshot
from orchestration.run.loop_data import Report
from orchestration.run.run_recording import failure_error, step_unless_discarded
from orchestration.run.tolerance import Tolerance, step_together_and_split
from orchestration.run.wiring import WiredRun
from orchestration.system.signals import Table
from orchestration.system.values import is_discrete

_SHORTEST = 1e-9  # of a communication step
_SAFETY, _LARGEST_REDUCTION, _LARGEST_GROWTH = 0.9, 0.2, 5.0  # the usual factors of step-size control
_GROWTH_AFTER_DISCARD = 2.0
# The error ratio of an exchange falls with order 1 or 2; below it the FMUs' solvers may leave it.
_LEAST_ORDER = 0.5


class StepControl:
    """Divides communication steps into shorter ones; every FMU must be able to restore its state.

    batch_start: the system where the present batch of steps began
    step_size: the next to try [s]
    statistics: numbers of steps between communication points, discarded ones (by an FMU) and inexact ones (of
    too large an estimated error)
    solver_error: where and how often the error of an FMU's own solver was permitted; empty if it never was
    """

    def __init__(self, run: WiredRun, batch_start: Snapshot) -> None:
        self._run, self._wiring, self._loop, self._batch_start = run, run.wiring, run.loop, batch_start
        experiment = run.prepared.experiment
        ports, indices = run.prepared.system.ports, run.wiring.signal_index.tolist()
        # a discrete input keeps the value of the communication point within the step
        self._signals = [
            (index, signal)
            for index, (name, signal) in zip(indices, experiment.signals.items(), strict=True)
            if not is_discrete(ports[name])
        ]
        tables = (signal for _, signal in self._signals if isinstance(signal, Table))
        # two halves do not show the error of a step across a jump: each step ends there
        self._jumps = np.unique([time for table in tables for time in table.jumps])
        self._before = Snapshot(run)
        self._shortest = 0.0
        self._terminated = 0
        self.tolerance = Tolerance(run) if experiment.tolerance else None
        self.step_size = experiment.step_size
        self.solver_error: dict[str, Any] = {}
        self._rejected = 0.0, 0.0  # size [s] and error ratio of the last inexact step
        self._has_warned = False  # of an error of an FMU's own solver
        # of all accepted steps, over the tolerance: the sum of errors that add up, the largest other one
        self._summed_error, self._largest_error = 0.0, 0.0
        self.statistics = dict.fromkeys(("steps_between_points", "discarded_steps", "inexact_steps"), 0)

    @property
    def provenance(self) -> dict[str, Any]:
        """Provenance of the steps; empty if none was divided."""
        solver_error = {"solver_error": dict(self.solver_error)} if self.solver_error else {}
        return {**self.statistics, **solver_error} if any(self.statistics.values()) else {}

    @property
    def state(self) -> dict[str, Any]:
        """The state at a communication point that later steps and the provenance depend on, as plain data."""
        return {
            "step_size": self.step_size,
            "known_solver_error": self.tolerance.solver_error.tolist() if self.tolerance else [],
            "summed_error": self._summed_error,
            "largest_error": self._largest_error,
            "solver_error": dict(self.solver_error),
            "statistics": dict(self.statistics),
        }

    @state.setter
    def state(self, state: Mapping[str, Any]) -> None:
        self.step_size = state["step_size"]
        if self.tolerance:
            self.tolerance.solver_error = np.array(state["known_solver_error"])
        self._summed_error, self._largest_error = state["summed_error"], state["largest_error"]
        self.solver_error, self.statistics = dict(state["solver_error"]), dict(state["statistics"])

    def repeat_discarded_step(self, start: int, check_interrupt: Callable[[], None]) -> float:
        """Goes back to a point where the batch started, steps to the present one, and takes the step divided.

        Returns what `divide_step` does.
        """
        self._batch_start.restore()
        point = int(self._wiring.report[Report.POSITION])
        if self._loop.run(start, point) != point:
            raise failure_error(self._run)
        return self.divide_step(check_interrupt)

    def divide_step(self, check_interrupt: Callable[[], None]) -> float:
        """Steps from the present communication point to the next; returns the time reached [s].

        The time is earlier than the next point's if a component terminated the simulation.
        """
        point = int(self._wiring.report[Report.POSITION])
        if not self._loop.exchange_and_record(point):
            raise failure_error(self._run)
        self._batch_start.take()
        state = self.state
        try:
            return self._advance_from(point, check_interrupt)
        except KeyboardInterrupt:
            # between two communication points no checkpoint can be saved
            self._batch_start.restore()
            self.state = state
            raise

    def _advance_from(self, point: int, check_interrupt: Callable[[], None]) -> float:
        """Steps from a communication point, where the exchange is done, to the next, as `divide_step`."""
        time, stop = self._wiring.points[point : point + 2].tolist()
        self._shortest = _SHORTEST * (stop - time)
        if self.tolerance:
            self.tolerance.forget_solver_error()
            self._rejected = 0.0, 0.0
        else:
            self.step_size = stop - time
        while time < stop:
            check_interrupt()
            end = time + self.step_size
            if end > stop - self._shortest:
                end = stop
            elif self.tolerance and stop - end < self.step_size:
                # two equal steps: a long and a short one would have a larger error
                end = time + 0.5 * (stop - time)
            if self.tolerance:
                following = np.searchsorted(self._jumps, time + self._shortest, "right")
                jump = float(self._jumps[following]) if following < len(self._jumps) else end
                end = jump if jump < end - self._shortest else end
            self._before.take()
            if self.try_controlled_step(point, time, end):
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
        """Steps from `start` to `end`, with error control if there is a tolerance.

        point: the communication point at or before `start`
        False if the step is not accepted: `step_size` is shorter then.
        """
        if not self.try_step(point, start, end):
            return False
        if not self.tolerance:
            return True
        tolerance, size = self.tolerance, end - start
        coarse = self._wiring.bus[tolerance.bus_index]
        if not self._try_halves(point, start, end):
            return False
        fine = self._wiring.bus[tolerance.bus_index]
        ratios = tolerance.error_ratios(coarse, fine, size)
        ratio = float(np.max(tolerance.beyond_solvers(ratios, fine, size), initial=0.0))
        if not ratio <= 1.0 and (self._hardly_fell(size, ratio) or tolerance.is_below_solvers(fine, size)):
            self._learn_solver_error(point, start, end)
            ratio = float(np.max(tolerance.beyond_solvers(ratios, fine, size), initial=0.0))
            if ratio <= 1.0 and not self._try_halves(point, start, end):
                return False
        # the error of a step is of order p + 1 in its size, the permitted error of order 1
        factor = _SAFETY * ratio ** (-1.0 / tolerance.order) if ratio > 0.0 else _LARGEST_GROWTH
        if ratio <= 1.0:
            self._note_accepted(start, size, ratios)
        else:
            self.statistics["inexact_steps"] += 1
            self._check_can_be_shorter(start, size)
        self.step_size = size * max(_LARGEST_REDUCTION, min(factor, _LARGEST_GROWTH))
        return ratio <= 1.0

    def _try_halves(self, point: int, start: float, end: float) -> bool:
        """Steps from `start` to `end` in halves; False if a step was discarded, or ends the simulation."""
        self._before.restore()
        middle = start + 0.5 * (end - start)
        if not self.try_step(point, start, middle):
            return False
        if self._wiring.report[Report.TERMINATED]:
            self.step_size = middle - start
            return False
        return self.try_step(point, middle, end)

    def _hardly_fell(self, size: float, ratio: float) -> bool:
        """Whether the error ratio hardly fell from the last inexact step to this shorter one."""
        (last_size, last_ratio), self._rejected = self._rejected, (size, ratio)
        return size < last_size and ratio > last_ratio * (size / last_size) ** _LEAST_ORDER

    def _learn_solver_error(self, point: int, start: float, end: float) -> None:
        assert self.tolerance
        outcome = step_together_and_split(self._run, self._before, point, start, end)
        if outcome:
            self.tolerance.learn_solver_error(*(bus[self.tolerance.bus_index] for bus in outcome))

    def _note_accepted(self, start: float, size: float, ratios: np.ndarray) -> None:
        """Adds up the errors of a step; notes and warns where only the solvers' own errors permit them."""
        assert self.tolerance
        is_of_solvers = (
            ratios > 1.0
        )  # it then is the whole difference, not a part that follows from the order
        errors = np.where(is_of_solvers, (2.0**self.tolerance.order - 1.0) * ratios, ratios)
        adds_up = self.tolerance.adds_up
        self._summed_error += float(np.max(errors[adds_up], initial=0.0)) * size / self.tolerance.duration
        self._largest_error = float(np.max(errors[~adds_up], initial=self._largest_error))
        if np.any(is_of_solvers):
            output = self.tolerance.names[int(np.argmax(ratios))]
            if not self.solver_error:
                self.solver_error = {"from_time_s": start, "output": output, "steps": 0}
            if not self._has_warned:
                self._has_warned = True
                warnings.warn(self._solver_warning(output, start, size), FmuWarning, stacklevel=2)
            self.solver_error["steps"] += 1
        if self.solver_error:
            reached = self.tolerance.relative * max(self._summed_error, self._largest_error)
            self.solver_error["estimated_error"] = reached

    def _solver_warning(self, output: str, time: float, size: float) -> str:
        assert self.tolerance
        return (
            f"tolerance = {self.tolerance.relative:g} may not be met: at t = {time:.9g} s the error of "
            f"{output} does not fall with the step, here {size:.3g} s, as its FMU's own solver leaves it; "
            "the step stays as long, and the recording holds the error that is reached "
            "(provenance: solver_error)"
        )

    def _check_can_be_shorter(self, start: float, size: float) -> None:
        if size <= 2.0 * self._shortest:
            raise OrchestrationError(
                f"at t = {start:.9g} s the tolerance needs a step of less than {size:.3g} s: expected "
                "outputs without jumps; choose a larger tolerance, or steps of fixed size"
            )

    def try_step(self, point: int, start: float, end: float) -> bool:
        """Steps from `start` to `end`; False if a component discarded the step."""
        wiring = self._wiring
        if start != wiring.points[point]:
            for index, signal in self._signals:
                wiring.bus[index] = signal(start)
            if not self._loop.exchange(point, start, False):
                raise failure_error(self._run, start)
        if step_unless_discarded(self._run, point, start, end):
            return True
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
        """Returns the step size [s] of an FMU that discarded the step to `end`; 0 if it ends at `start`."""
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
        """Frees the saved states."""
        self._before.free()


def termination_within_step(run: WiredRun) -> float:
    """Returns the time [s] when the component that discarded its step terminates the simulation.

    It is within the step that was discarded, or the start of it. Raises OrchestrationError for a component
    that does not terminate the simulation.
    """
    report = run.wiring.report
    component, point = int(report[Report.COMPONENT]), int(report[Report.POSITION])
    instance = list(run.instances.values())[component]
    if not instance.terminates():
        obstacle = run.prepared.retry_obstacle
        raise OrchestrationError(f"{failure_error(run)}; no shorter step was tried, as {obstacle}")
    report[Report.TERMINATED] = component + 1
    before, after = run.wiring.points[point : point + 2].tolist()
    reached = instance.last_successful_time()
    return before if reached is None or not before <= reached <= after else reached
