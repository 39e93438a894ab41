"""Steps between two communication points: after a discarded step, and as short as a tolerance needs.

Step doubling: the step h is done at once and in two halves. Their difference, divided by 2^p - 1, estimates
the error of the halves, p being the order of the exchange: 1, or 2 with extrapolation. A step may bring the
part h / T of the tolerance, T being the length of the run: what all steps bring together stays below it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestration.errors import OrchestrationError
from orchestration.fmi.instance import FmuInstance
from orchestration.master.failure import explain, is_discarded_step
from orchestration.master.loop import WHO, Entries
from orchestration.master.snapshot import Snapshot
from orchestration.master.wiring import Loom
from orchestration.system.signals import Signal

_SHORTEST = 1e-9  # of a communication step
_SAFETY, _LEAST, _MOST = 0.9, 0.2, 5.0  # the usual factors of a step-size control
_MOST_AFTER_DISCARD = 2.0


@dataclass
class Effort:
    """What it took: steps between points, and tries that were discarded or not exact enough."""

    steps: int = 0
    discarded: int = 0
    inexact: int = 0


@dataclass(frozen=True)
class Tolerance:
    """Error that a run may bring, relative to max(|value|, nominal); `places` of the values on the bus.

    at_once: whether an output may follow an input directly. What it is late by is an error of its own, which
    does not add up from step to step: it is judged against the whole tolerance.
    """

    relative: float
    order: int
    duration: float
    places: np.ndarray
    nominal: np.ndarray
    at_once: np.ndarray

    def excess(self, coarse: np.ndarray, fine: np.ndarray, h: float) -> float:
        """Estimated error of the fine values over what a step of h s may bring; 1 is just allowed.

        A value that is not finite either way is only recorded, and no matter of this step.
        """
        part = np.where(self.at_once, 1.0, h / self.duration)
        scale = self.relative * np.maximum(np.abs(fine), self.nominal) * part
        with np.errstate(invalid="ignore"):
            ratio = np.abs(fine - coarse) / (2.0**self.order - 1.0) / scale
        ratio[~(np.isfinite(coarse) | np.isfinite(fine))] = 0.0
        ratio[np.isnan(ratio)] = np.inf
        return float(np.max(ratio, initial=0.0))


class ShorterSteps:
    """Covers a communication step in several; components must be able to go back."""

    def __init__(
        self,
        components: Mapping[str, FmuInstance],
        loom: Loom,
        loop: Entries,
        signals: Sequence[Signal],
        tolerance: Tolerance | None,
        step_size: float,
    ) -> None:
        self._components, self._loom, self._wiring, self._loop = components, loom, loom.wiring, loop
        self._signals, self.tolerance = signals, tolerance
        self._before = Snapshot(components, loom.wiring)
        self.step_size = step_size  # the next to try [s]
        self.effort = Effort()

    def cover(self, i: int, check_interrupt: Callable[[], None]) -> None:
        """From communication point i, which was looked at, to the next."""
        t, end = float(self._wiring.points[i]), float(self._wiring.points[i + 1])
        self._shortest = _SHORTEST * (end - t)
        if not self.tolerance:
            self.step_size = end - t
        while t < end:
            check_interrupt()
            aim = t + self.step_size
            if aim > end - self._shortest:
                aim = end
            elif self.tolerance and end - aim < self.step_size:
                aim = t + 0.5 * (end - t)  # two equal steps rather than a long and a short one
            self._before.take()
            if self._reaches(i, t, aim):
                if not self.tolerance:
                    self.step_size = _MOST_AFTER_DISCARD * (aim - t)
                t = aim
                self.effort.steps += 1
            else:
                self._before.restore()

    def _reaches(self, i: int, t: float, aim: float) -> bool:
        """Go from t to aim; if not accepted, the step size is shorter afterwards."""
        if not self.tolerance:
            return self._goes(i, t, aim)
        if not self._goes(i, t, aim):
            return False
        coarse = self._wiring.bus[self.tolerance.places]
        self._before.restore()
        middle = t + 0.5 * (aim - t)
        if not (self._goes(i, t, middle) and self._goes(i, middle, aim)):
            return False
        fine, h = self._wiring.bus[self.tolerance.places], aim - t
        excess = self.tolerance.excess(coarse, fine, h)
        # the error of a step is of order p + 1, what it may bring of order 1
        factor = _SAFETY * excess ** (-1.0 / self.tolerance.order) if excess > 0.0 else _MOST
        if not excess <= 1.0:
            self.effort.inexact += 1
            if h <= 2.0 * self._shortest:
                raise OrchestrationError(
                    f"at t = {t:.9g} s the tolerance needs a step of less than {h:.3g} s: expected outputs "
                    "without jumps; take a larger tolerance, or steps of fixed size"
                )
        self.step_size = h * max(_LEAST, min(factor, _MOST))
        return excess <= 1.0

    def _goes(self, i: int, t: float, aim: float) -> bool:
        """One step; False if a component discarded it."""
        w = self._wiring
        if t != w.points[i]:
            for place, signal in zip(w.signal_places, self._signals, strict=True):
                w.bus[place] = signal(t)
            if not self._loop.exchange(i, t, False):
                raise explain(self._loom, self._components, t)
        if self._loop.step(i, t, aim):
            return True
        if not is_discarded_step(w):
            raise explain(self._loom, self._components, t)
        self.effort.discarded += 1
        self.step_size = self._accepted_part(t, aim)
        if self.step_size < self._shortest:
            raise explain(self._loom, self._components, t)
        return False

    def _accepted_part(self, t: float, aim: float) -> float:
        """The step [s] that the component which discarded the one to `aim` can do."""
        component = list(self._components.values())[self._wiring.report[WHO]]
        reached = component.last_successful_time()
        if reached is None:
            return 0.5 * (aim - t)
        slack = self._shortest
        if not t - slack <= reached <= aim + slack:
            raise OrchestrationError(
                f"{component.name} discarded the step from {t:.9g} to {aim:.9g} s and gave "
                f"LastSuccessfulTime = {reached:.9g} s: expected a time within the step"
            )
        return reached - t if t + slack < reached < aim - slack else 0.5 * (aim - t)

    def free(self) -> None:
        self._before.free()
