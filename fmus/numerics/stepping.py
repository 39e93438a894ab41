"""Parts of a step: integration, and states that change only at sampling instants."""

from dataclasses import dataclass, replace
from typing import TypeVar

from fmus.block.integration import DUE, rk4_step
from fmus.block.variables import variable
from fmus.numerics.choice import where

__all__ = ["Clock", "at_events", "rk4_step", "sampled"]

# of a period: t and the clock round differently
_EARLY = 1e-6
# of a period: a sample that is later was missed
_LATE = 0.5


@dataclass(frozen=True)
class Clock:
    """Clock of samples, which are due at start + count * period.

    Take `Clock(t)` in `initial_state` for a sample in the first step.

    Examples
    --------
    >>> Clock(start=1.0, count=3).next_sample(0.5)
    2.5
    """

    # counted and not summed: a sum of periods would accumulate their rounding

    start: float = variable(0.0, "Time of the first sample", unit="s")
    count: int = variable(0, "Samples taken since", min=0)

    def next_sample(self, period: float) -> float:
        """Returns the time of the next sample [s].

        Parameters
        ----------
        period : float
            Sampling period [s].

        Returns
        -------
        float
        """
        return self.start + self.count * period

    def last_sample(self, period: float) -> float:
        """Returns the time of the last sample [s].

        Parameters
        ----------
        period : float
            Sampling period [s].

        Returns
        -------
        float
        """
        return self.start + (self.count - 1) * period


Part = TypeVar("Part")


def at_events(state: Part, new: Part) -> Part:
    """Returns `new`; between the events of model exchange, `state`.

    Use it for every change in `step` that is not a sample: of a switch, a count, or a continuous state that
    jumps.

    Parameters
    ----------
    state : float, tuple or dataclass
        Part of the state before the event.
    new : float, tuple or dataclass
        The same part after the event.

    Returns
    -------
    float, tuple or dataclass

    Examples
    --------
    >>> at_events(False, True)
    True
    """
    # between events an importer's solver tries times and states that it may reject
    return new if DUE.get() is None else state


def sampled(t: float, period: float, state: Part, new: Part) -> Part:
    """Returns `new` if a sample is due at time t, else `state`.

    A step takes one sample at most, so require `internal_step <= period`. Missed samples are not made up for:
    a sample that is late by more than half a period starts the clock again, with the next sample half a
    period later.

    Parameters
    ----------
    t : float
        Time of the sample [s]: `t` of `step`, or `t + h` for a sample at the end of the step.
    period : float
        Sampling period [s]; it must not change during a run.
    state, new : dataclass
        The part of the state before and after the sample, with a field `clock: Clock`. This function sets
        the clock; the clock of `new` is ignored.

    Returns
    -------
    dataclass

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Reading:
    ...     value: float = 0.0
    ...     clock: Clock = Clock()
    >>> sampled(0.0, 0.5, Reading(), Reading(7.0)).value
    7.0
    >>> sampled(0.3, 0.5, Reading(clock=Clock(0.0, 1)), Reading(7.0)).value
    0.0
    """
    clock: Clock = state.clock  # type: ignore[attr-defined]
    due = clock.next_sample(period)
    if (noted := DUE.get()) is not None:
        noted.append(due)
        return state
    is_late = t > due + _LATE * period
    ticked = where(is_late, Clock(t + _LATE * period, 0), Clock(clock.start, clock.count + 1))
    return where(t >= due - _EARLY * period, replace(new, clock=ticked), state)  # type: ignore[type-var]
