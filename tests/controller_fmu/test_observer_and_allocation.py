"""The alpha-beta observer and the way from force to voltages."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu.allocation import allocate, body_to_earth, saturate, shortfall
from controller_fmu.observer import ObserverState, correct, sample_when_due

PERIOD = 0.04


def test_a_constant_velocity_is_observed_without_bias() -> None:
    observer = ObserverState()
    for k in range(1, 400):
        observer = correct(observer, 0.02 * PERIOD * k, 0.4, 0.1, PERIOD)
    assert observer.rate == pytest.approx(0.02, rel=1e-9)  # the slowest mode has died out
    assert observer.depth == pytest.approx(0.02 * PERIOD * 399, rel=1e-9)


def test_one_correction_is_penoyers() -> None:
    observer = correct(ObserverState(depth=1.0, rate=0.5), 1.1, 0.4, 0.1, PERIOD)
    innovation = 1.1 - (1.0 + PERIOD * 0.5)
    assert observer.depth == pytest.approx(1.0 + PERIOD * 0.5 + 0.4 * innovation)
    assert observer.rate == pytest.approx(0.5 + 0.1 / PERIOD * innovation)


def test_samples_are_taken_once_a_period_whatever_the_step() -> None:
    for h in (0.01, 0.02, 0.04):
        observer, taken = ObserverState(next_sample=PERIOD), 0
        for i in range(round(4.0 / h) + 1):
            after = sample_when_due(i * h, observer, 1.0 * i, 0.4, 0.1, PERIOD)
            taken += after != observer
            observer = after
        assert taken == 100


@given(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_thrusters_give_j_times_the_demand(force: float, roll: float, pitch: float) -> None:
    j = body_to_earth(roll, pitch)
    assert j == math.cos(roll) * math.cos(pitch)
    gains = (0.2, 0.3)
    voltages = allocate(force, j, gains)
    assert gains[0] * voltages[0] + gains[1] * voltages[1] == pytest.approx(j * force)
    assert shortfall(voltages, saturate(voltages, 100.0), j, gains) == 0.0


def test_the_shortfall_is_what_saturation_takes_away() -> None:
    gains = (0.25, 0.25)
    wanted = allocate(10.0, 1.0, gains)
    possible = saturate(wanted, 12.0)
    assert possible == (12.0, 12.0)
    assert shortfall(wanted, possible, 1.0, gains) == pytest.approx(6.0 - 10.0)


@given(st.floats(-20.0, 20.0), st.floats(-3.0, 3.0))
def test_force_delivered_is_force_demanded_and_the_shortfall(force: float, roll: float) -> None:
    """Upright or upside down: T K u / J is what the earth frame sees."""
    j, gains = math.cos(roll), (0.25, 0.25)
    if abs(j) > 0.1:
        wanted = allocate(force, j, gains)
        possible = saturate(wanted, 12.0)
        delivered = (gains[0] * possible[0] + gains[1] * possible[1]) / j
        demanded = (gains[0] * wanted[0] + gains[1] * wanted[1]) / j
        assert shortfall(wanted, possible, j, gains) == pytest.approx(delivered - demanded, abs=1e-9)
