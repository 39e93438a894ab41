"""A thruster stays within its bounds and answers its lag exactly."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_fmu.thruster import Thruster, force_after, steady_force

REAL = Thruster(gain=0.25, dead_zone=0.5, limit=12.0, lag=0.1, ideal=False)
VOLTAGES = st.floats(-1e3, 1e3)
EFFICIENCIES = st.floats(0.0, 1.0)


@given(VOLTAGES, EFFICIENCIES, st.floats(0.0, 10.0))
def test_force_stays_within_gain_times_limit(voltage: float, efficiency: float, elapsed: float) -> None:
    bound = 0.25 * (12.0 - 0.5)
    steady = steady_force(REAL, voltage, efficiency)
    assert abs(steady) <= bound
    for begin in (-bound, 0.0, bound):
        assert abs(force_after(REAL, begin, steady, elapsed)) <= bound * (1.0 + 1e-15)


@given(st.floats(-0.5, 0.5))
def test_nothing_happens_in_the_dead_zone(voltage: float) -> None:
    assert steady_force(REAL, voltage, 1.0) == 0.0


@given(VOLTAGES)
def test_it_is_odd(voltage: float) -> None:
    assert steady_force(REAL, -voltage, 1.0) == -steady_force(REAL, voltage, 1.0)


def test_the_lag_is_exact_in_one_step_or_many() -> None:
    force = 0.0
    for _ in range(10):
        force = force_after(REAL, force, 1.0, 0.02)
    assert force == pytest.approx(1.0 - math.exp(-2.0), rel=1e-14)
    assert force_after(REAL, 0.0, 1.0, 0.2) == pytest.approx(force, rel=1e-14)


def test_an_efficiency_is_a_fault() -> None:
    assert steady_force(REAL, 8.5, 0.5) == pytest.approx(0.5 * 0.25 * 8.0)
    assert steady_force(REAL, 8.5, 0.0) == 0.0


def test_an_ideal_thruster_gives_gain_times_voltage_at_once() -> None:
    ideal = replace(REAL, ideal=True)
    assert steady_force(ideal, 100.0, 1.0) == 25.0
    assert force_after(ideal, 0.0, 25.0, 1e-3) == 25.0
    assert force_after(replace(REAL, lag=0.0), 0.0, 1.0, 1e-3) == 1.0
