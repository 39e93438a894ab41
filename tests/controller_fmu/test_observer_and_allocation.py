"""The alpha-beta observer and the way from force to voltages."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu import depth_interface
from controller_fmu.allocation import allocate, body_to_earth, force, saturate, saturation_error
from controller_fmu.observer import ObserverState, correct, sample_when_due
from fmus.numerics import Clock

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


def test_an_observer_has_the_measurement_and_clock_of_its_sample() -> None:
    early = ObserverState(depth=1.0, rate=0.5, clock=Clock(PERIOD))
    assert sample_when_due(PERIOD - 1e-4, early, 9.0, 0.4, 0.1, PERIOD) == early
    corrected = correct(early, 9.0, 0.4, 0.1, PERIOD)
    expected = replace(corrected, clock=Clock(PERIOD, 1))
    assert sample_when_due(PERIOD, early, 9.0, 0.4, 0.1, PERIOD) == expected


@given(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_thrusters_give_j_times_the_demand(force: float, roll: float, pitch: float) -> None:
    j = body_to_earth(roll, pitch)
    assert j == math.cos(roll) * math.cos(pitch)
    gains = (0.2, 0.3)
    voltages = allocate(force, j, gains)
    assert gains[0] * voltages[0] + gains[1] * voltages[1] == pytest.approx(j * force)
    assert saturation_error(voltages, saturate(voltages, 100.0), j, gains) == 0.0


@given(st.floats(-20.0, 20.0), st.floats(-3.0, 3.0))
def test_force_delivered_is_force_demanded_and_the_shortfall(demand: float, roll: float) -> None:
    """Upright or upside down: T K u / J is what the earth frame sees."""
    j, gains = math.cos(roll), (0.25, 0.25)
    if abs(j) > 0.1:
        demanded = allocate(demand, j, gains)
        saturated = saturate(demanded, 12.0)
        delivered = (gains[0] * saturated[0] + gains[1] * saturated[1]) / j
        assert force(saturated, j, gains) == pytest.approx(delivered, abs=1e-9)
        missing = force(saturated, j, gains) - force(demanded, j, gains)
        assert saturation_error(demanded, saturated, j, gains) == pytest.approx(missing, abs=1e-9)


@pytest.mark.parametrize("j", [0.0, 0.05, -0.05])
def test_a_vehicle_on_its_side_has_a_finite_force(j: float) -> None:
    assert force((4.0, 4.0), j, (0.25, 0.25)) == pytest.approx(20.0 if j >= 0.0 else -20.0)


def test_each_thruster_has_its_own_gain_and_takes_half_of_the_force() -> None:
    assert allocate(2.0, 1.0, (0.25, 0.5)) == (4.0, 2.0)
    assert force((4.0, 2.0), 1.0, (0.25, 0.5)) == 2.0
    assert saturate((-5.0, 5.0), 3.0) == (-3.0, 3.0)


def test_each_voltage_is_limited_on_both_sides() -> None:
    assert saturate((13.0, -14.0), 12.0) == (12.0, -12.0)
    assert saturate((-13.0, 14.0), 12.0) == (-12.0, 12.0)


@pytest.mark.parametrize("j", [1.0, 0.5, -0.5])
def test_what_saturation_takes_from_a_tilted_vehicle_is_in_the_earth_frame(j: float) -> None:
    """24 V, of which 6 V are left, and these twice 0.25 N/V over J."""
    p = depth_interface.ActuatorParameters(voltage_limit=6.0)
    delivered = depth_interface.deliver(12.0 / j, j, p)
    assert delivered.force == pytest.approx(3.0 / j)
    assert delivered.saturation_error == pytest.approx(delivered.force - 12.0 / j)
