"""Signals are what they say at every time."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestration.errors import ScenarioError
from orchestration.system.signals import Constant, Cosine, Ramps, Table

POINTS = [[0.0, 0.0], [40.0, 0.8], [140.0, 0.8], [180.0, 0.4]]


def test_straight_ramps_interpolate_and_hold() -> None:
    r = Ramps(POINTS)
    assert [r(t) for t in (-1.0, 0.0, 20.0, 40.0, 100.0, 160.0, 500.0)] == pytest.approx(
        [0.0, 0.0, 0.4, 0.8, 0.8, 0.6, 0.4]
    )


@pytest.mark.parametrize("t", [0.0, 40.0, 140.0, 180.0])
def test_quintic_ramps_start_and_end_at_rest(t: float) -> None:
    r, h = Ramps(POINTS, smooth=True), 1e-3
    assert (r(t + h) - r(t - h)) / (2 * h) == pytest.approx(0.0, abs=1e-8)  # 10 s^3 / T at s = h / T
    assert (r(t + h) - 2 * r(t) + r(t - h)) / h**2 == pytest.approx(0.0, abs=1e-5)


@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0))
def test_quintic_ramps_are_monotonic_and_pass_the_middle(one: float, other: float) -> None:
    r = Ramps(POINTS, smooth=True)
    assert r(min(one, other)) <= r(max(one, other)) + 1e-15
    assert r(20.0) == pytest.approx(0.4)


def test_cosine_and_constant() -> None:
    assert Cosine(100.0, 0.2, 0.1, 5.0)(3.0) == pytest.approx(5.0 + 100.0 * math.cos(0.7))
    assert Constant(2.0)(99.0) == 2.0


def test_samples_are_joined_by_lines_or_hold() -> None:
    times, values = [0.0, 1.0, 3.0], np.array([2.0, 4.0, 0.0])
    asked = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0])
    assert Table(times, values).at(asked).tolist() == [2.0, 2.0, 3.0, 4.0, 2.0, 0.0, 0.0]
    assert Table(times, values, hold=True).at(asked).tolist() == [2.0, 2.0, 2.0, 4.0, 4.0, 0.0, 0.0]


def test_held_samples_change_at_their_communication_point_whatever_the_rounding() -> None:
    """3 * 0.1 is a little more than 0.3, 0.7 + 0.1 a little less than 0.8."""
    held = Table([0.0, 3 * 0.1, 0.8], [0.0, 1.0, 2.0], hold=True)
    assert [held(0.3), held(0.7 + 0.1)] == [1.0, 2.0]
    assert held(0.3 - 1e-6) == 0.0


def test_samples_are_copied() -> None:
    values = np.array([1.0, 2.0])
    samples = Table([0.0, 1.0], values)
    values[:] = 9.0
    assert samples(0.0) == 1.0


def test_numbers_are_copied() -> None:
    number: Any = np.array(1.0)
    signals = [Constant(number), Cosine(number, 0.0), Ramps([(0.0, number)])]
    number += 1.0
    assert [signal(0.0) for signal in signals] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ramps([[1.0, 0.0], [1.0, 2.0]]), r"ascending time"),
        (lambda: Ramps([[1.0]]), r"\[time, value\]"),
        (lambda: Ramps([[0.0, 0.0], ["1", 2.0]]), r"ramps: time = '1': expected a number"),  # type: ignore[list-item]
        (lambda: Ramps([[0.0, None]]), r"ramps: value = None: expected a number"),  # type: ignore[list-item]
        (lambda: Constant("1.0"), r"constant: value = '1.0': expected a number"),  # type: ignore[arg-type]
        (lambda: Constant(np.ones(1)), r"value = array\(\[1\.\]\): expected a number"),  # type: ignore[arg-type]
        (lambda: Cosine(1.0, 1j), r"cosine: angular_frequency = 1j: expected"),  # type: ignore[arg-type]
        (lambda: Cosine(10**400, 1.0), r"cosine: amplitude = 10+: expected a number"),
        (lambda: Table([0.0, 1.0], [0.0]), r"shapes \(2,\) and \(1,\)"),
        (lambda: Table([], []), r"expected times and as many values"),
        (lambda: Table([0.0, 0.0], [0.0, 1.0]), r"ascending times"),
        (lambda: Table([0.0, math.nan], [0.0, 1.0]), r"finite numbers"),
    ],
)
def test_bad_arguments_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make()
