"""Derivatives of signals, against difference quotients of the signals themselves."""

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.system.signal_derivatives import Derivative, derivative, with_derivatives
from orchestration.system.signals import (
    ArraySignal,
    Constant,
    Cosine,
    Ramps,
    Table,
    sine,
    spectrum,
    sum_of_sines,
    values_at,
)

POINTS = [[1.0, 0.0], [3.0, 2.0], [4.0, 1.0]]
TIMES = np.linspace(0.0, 5.0, 401) + 1e-3  # beside the kinks
STEP = 1e-4


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "signal",
    [
        Ramps(POINTS),
        Ramps(POINTS, smooth=True),
        Cosine(2.0, 3.0, 0.4, 1.0),
        sine(2.0, 0.4, 0.4, 1.0),
        sum_of_sines([1.0, 0.2], [0.1, 0.5], [0.0, 1.0]),
        spectrum(1.0, 5.0, components=20),
        Constant(3.0),
        Table([1.0, 2.0, 4.0], [0.0, 1.0, -1.0]),
        Table([1.0, 2.0], [0.0, 1.0], hold=True),
        Table([1.0], [2.0]),
        Table([1.0, 2.0, 2.0, 4.0, 4.0, 4.0], [0.0, 1.0, -5.0, -4.5, 3.0, 6.0]),
        Table([3.0, 3.0], [2.0, -1.0]),
    ],
)
def test_it_is_the_difference_quotient(signal: ArraySignal, order: int) -> None:
    later, earlier = signal.at(TIMES + STEP), signal.at(TIMES - STEP)
    quotient = (later - earlier) / (2 * STEP)
    if order == 2:
        quotient = (later - 2.0 * signal.at(TIMES) + earlier) / STEP**2
    # truncation is 1e-6 and rounding 1e-7 of values about 100
    assert values_at(derivative(signal, order), TIMES) == pytest.approx(quotient, abs=1e-4)


@pytest.mark.parametrize("signal", [Ramps(POINTS), Table([1.0, 3.0, 4.0], [0.0, 2.0, 1.0])])
def test_at_a_kink_it_is_that_of_the_time_after_it(signal: ArraySignal) -> None:
    kinks = np.array([1.0, 3.0, 4.0])
    assert values_at(derivative(signal), kinks).tolist() == [1.0, -1.0, 0.0]


def test_at_a_jump_it_is_that_of_the_line_after_it() -> None:
    table = Table([1.0, 2.0, 2.0, 4.0, 4.0], [0.0, 1.0, -5.0, -4.5, 3.0])
    assert values_at(derivative(table), np.array([0.5, 1.0, 2.0, 4.0])).tolist() == [0.0, 1.0, 0.25, 0.0]


def test_it_follows_the_signal_of_another_input() -> None:
    signals = with_derivatives({"a.rate": Derivative("a.u"), "a.u": Ramps(POINTS)})
    assert signals["a.rate"](2.0) == 1.0


def test_that_of_a_constant_input_is_zero() -> None:
    assert with_derivatives({"a.rate": Derivative("a.u")}, {"a.u": 3.0})["a.rate"](2.0) == 0.0
    with pytest.raises(ScenarioError, match=r"of = 'a.u': expected an input that has a signal or a constant"):
        with_derivatives({"a.rate": Derivative("a.u")}, {"a.u": True})


def test_the_error_about_a_connected_input_says_what_to_connect_or_to_give() -> None:
    with pytest.raises(ScenarioError) as refusal:
        with_derivatives({"a.rate": Derivative("a.u")}, connections=[("b.y", "a.v"), ("c.y", "a.u")])
    message = str(refusal.value)
    assert "but c.y drives it: connect the output of c that is its rate" in message
    assert '[connections] "a.rate" = "c.NAME", or give [inputs] "a.rate" = 0.0' in message


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({"a.rate": Derivative("a.v")}, r"signals.\"a.rate\": of = 'a.v': expected an input that has a sig"),
        ({"a.rate": Derivative("a.u"), "a.u": abs}, r"signals.\"a.rate\": expected the derivative of ramps"),
    ],
)
def test_a_signal_without_derivative_is_refused(signals: dict, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        with_derivatives(signals)


def test_an_order_above_two_is_refused() -> None:
    with pytest.raises(ScenarioError, match="derivative: order = 3: expected 1 or 2"):
        Derivative("a.u", 3)
