"""Parts of a step: integration, and states that change only at sampling instants."""

from dataclasses import dataclass, replace
from typing import TypeVar

from fmus.block.integration import DUE, rk4_step
from fmus.numerics.choice import where

__all__ = ["Clock", "at_events", "rk4_step", "sampled"]

_EARLY = 1e-6  # of a period: t and the clock round differently
_LATE = 0.5  # of a period


@dataclass(frozen=True)
class Clock:
    """Clock of samples, due at start + count * period, without accumulated rounding.

    start: time of the first sample [s]; `Clock(t)` in `initial_state` for one in the first step
    count: samples taken since
    """

    start: float = 0.0
    count: int = 0

    def next_sample(self, period: float) -> float:
        """Returns the time at which the next sample is due [s]."""
        return self.start + self.count * period

    def last_sample(self, period: float) -> float:
        """Returns the time at which the last sample was due [s]."""
        return self.start + (self.count - 1) * period


Part = TypeVar("Part")


def at_events(state: Part, new: Part) -> Part:
    """Returns `new`; between the events of model exchange, `state` as it was.

    For what `step` changes besides samples: the state of a switch, a count, or a continuous state that jumps.
    """
    return new if DUE.get() is None else state


def sampled(t: float, period: float, state: Part, new: Part) -> Part:
    """Returns `new` if a sample is due at time t, else `state` as it was.

    t: of the sample [s]: where `step` begins, or `t + h` where it ends
    period: sampling period [s]; it must not change during a run
    state, new: dataclasses of one class with a field `clock: Clock`, which this function sets; it is the
        only one to read that of `state`, and that of `new` does not matter

    A step takes one sample at most, so require `internal_step <= period`. Samples that were missed are not
    made up for: one that is late by more than half a period, in steps longer than that, starts the clock
    again, with the next sample half a period later.
    """
    clock: Clock = state.clock  # type: ignore[attr-defined]
    due = clock.next_sample(period)
    if (noted := DUE.get()) is not None:
        noted.append(due)
        return state
    is_late = t > due + _LATE * period
    ticked = where(is_late, Clock(t + _LATE * period, 0), Clock(clock.start, clock.count + 1))
    return where(t >= due - _EARLY * period, replace(new, clock=ticked), state)  # type: ignore[type-var]
