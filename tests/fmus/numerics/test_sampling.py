"""Samples are taken at start + k * period, however long the steps and however many there were."""

from dataclasses import dataclass
from typing import Any

import casadi
import pytest

from fmus.block.integration import between_events
from fmus.block.scalars import flatten, unflatten
from fmus.numerics import Clock, at_events, sampled

PERIOD = 0.1


@dataclass(frozen=True)
class Part:
    clock: Clock = Clock()
    time: float = -1.0
    inner: tuple[float, bool] = (0.0, False)


def sample(t: Any, part: Part) -> Part:
    return sampled(t, PERIOD, part, Part(Clock(99.0, 99), t, (part.inner[0] + 1.0, True)))


def sample_times(start: float, h: float, steps: int, part: Part) -> list[float]:
    times = []
    for i in range(steps):
        t = start + i * h
        after = sample(t, part)
        if after is not part:
            times.append(t)
        part = after
    return times


@pytest.mark.parametrize("start", [0.0, 7.3])
@pytest.mark.parametrize("divisor", [1, 3, 7, 10])
def test_steps_that_divide_the_period_sample_at_each_multiple_of_it(start: float, divisor: int) -> None:
    times = sample_times(start, PERIOD / divisor, 50 * divisor, Part(Clock(start)))
    assert times == pytest.approx([start + k * PERIOD for k in range(50)], abs=1e-9)  # as steps round


@pytest.mark.parametrize("h", [0.03, 0.041, 0.05])
def test_other_steps_sample_at_the_first_one_after_each_multiple(h: float) -> None:
    times = sample_times(0.0, h, 1000, Part())
    assert all(-1e-9 < t - k * PERIOD < h for k, t in enumerate(times))
    assert len(times) == pytest.approx(1000 * h / PERIOD, abs=1.0)


def test_the_clock_does_not_accumulate_rounding() -> None:
    """A sum of ten million tenths is 1.6e-4 off, which is 1600 times what a sample may be early."""
    part = Part(Clock(0.0, 10**7))
    assert sample(1e6 - 1e-5, part) is part
    assert sample(1e6, part).clock == Clock(0.0, 10**7 + 1)


def test_a_sample_late_by_more_than_half_a_period_starts_the_clock_again() -> None:
    late = sample(0.26, Part(Clock(0.0, 2)))
    assert late.clock == Clock(0.31, 0)
    assert sample(0.25, Part(Clock(0.0, 2))).clock == Clock(0.0, 3)


def test_symbols_sample_when_numbers_do() -> None:
    t, x = casadi.SX.sym("t"), casadi.SX.sym("x", 5)
    traced = sample(t, unflatten(Part(), casadi.vertsplit(x)))
    function = casadi.Function("sample", [t, x], [casadi.vertcat(*flatten(traced))])
    for part in (Part(), Part(Clock(0.5, 1)), Part(Clock(0.2, 3), 0.4, (3.0, True))):
        for time in (0.0, 0.1, 0.3, 0.5 - 2e-7, 0.6, 0.7):
            assert function(time, flatten(part)).full().ravel().tolist() == flatten(sample(time, part))


def test_between_events_samples_and_what_is_guarded_are_held_and_the_times_of_samples_noted() -> None:
    part = Part(Clock(2.0, 3), 0.0, (1.0, False))
    with between_events() as due:
        assert sample(99.0, part) is part
        assert at_events(1.0, 2.0) == 1.0
    assert due == [2.0 + 3 * PERIOD]
    assert sample(99.0, part) is not part
    assert at_events(1.0, 2.0) == 2.0
