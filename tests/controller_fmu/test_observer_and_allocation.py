"""The alpha-beta observer and the way from force to voltages."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu import depth_interface, thrust_allocation
from controller_fmu.allocation import body_to_earth, force, saturate, table_voltage
from controller_fmu.baselines import adrc, pid
from controller_fmu.observer import ObserverState, correct, sample_when_due
from fmus.block.instance import BlockError
from fmus.numerics import Clock, interp
from plant_fmu import thruster

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


GAINS = depth_interface.ActuatorParameters(thruster_gain=(0.2, 0.3))


@given(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_each_thruster_gives_half_of_j_times_the_demand(demand: float, roll: float, pitch: float) -> None:
    j = body_to_earth(roll, pitch)
    assert j == math.cos(roll) * math.cos(pitch)
    delivered = depth_interface.deliver(demand, j, GAINS)
    forces = [gain * v for gain, v in zip(GAINS.thruster_gain, delivered.voltage, strict=True)]
    assert forces == pytest.approx([0.5 * j * demand] * 2)
    assert delivered.saturation_error == 0.0


@given(st.floats(-20.0, 20.0), st.floats(-3.0, 3.0))
def test_force_delivered_is_force_demanded_and_the_shortfall(demand: float, roll: float) -> None:
    """Upright or upside down: T K u / J is what the earth frame sees."""
    j = math.cos(roll)
    if abs(j) > 0.1:
        delivered = depth_interface.deliver(demand, j, GAINS)
        thrust = 0.2 * delivered.voltage[0] + 0.3 * delivered.voltage[1]
        # rounding of 20 N over J of 0.1
        assert delivered.force == pytest.approx(thrust / j, abs=1e-12)
        assert delivered.saturation_error == pytest.approx(delivered.force - demand, abs=1e-12)


@pytest.mark.parametrize("j", [0.0, 0.05, -0.05])
def test_a_vehicle_on_its_side_has_a_finite_force(j: float) -> None:
    assert force((1.0, 1.0), j) == pytest.approx(20.0 if j >= 0.0 else -20.0)


def test_each_voltage_is_limited_on_both_sides() -> None:
    assert saturate((13.0, -14.0), 12.0) == (12.0, -12.0)
    assert saturate((-13.0, 14.0), 12.0) == (-12.0, 12.0)
    assert saturate((-5.0, 5.0), 3.0) == (-3.0, 3.0)


TABLE = depth_interface.ActuatorParameters(thruster_tabulated=True)
VOLTAGES, FORCES = TABLE.thruster_table_voltage, TABLE.thruster_table_force


@given(st.floats(FORCES[0], FORCES[-1]))
def test_the_voltage_of_a_force_gives_this_force(force: float) -> None:
    """1e-12 N: rounding of 51 N, over slopes that differ by a factor of 30."""
    voltage = table_voltage(force, VOLTAGES, FORCES)
    assert interp(voltage, VOLTAGES, FORCES) == pytest.approx(force, abs=1e-12)


def test_the_voltage_jumps_over_the_dead_band_at_a_change_of_sign() -> None:
    """1472 us and 1528 us are 0.84 V and -0.84 V; a force of exactly 0 is 0 V. 1e-9: the slope is 0.3 V/N."""
    voltages = [table_voltage(force, VOLTAGES, FORCES) for force in (-1e-9, -0.0, 0.0, 1e-9)]
    assert voltages == pytest.approx([-0.84, 0.0, 0.0, 0.84], abs=1e-9)


@given(st.floats(-300.0, 300.0), st.floats(-1.2, 1.2), st.sampled_from([12.0, 20.0, 3.0]))
def test_thrusters_by_a_table_deliver_the_demand_as_far_as_they_can(
    demand: float, roll: float, limit: float
) -> None:
    """The force of the table at the voltages, over J; and what is missing of the demand."""
    j = math.cos(roll)
    p = replace(TABLE, thruster_scale=(2.0, 1.8), voltage_limit=limit)
    delivered = depth_interface.deliver(demand, j, p)
    assert all(abs(voltage) <= limit for voltage in delivered.voltage)
    forces = [interp(voltage, VOLTAGES, FORCES) for voltage in delivered.voltage]
    thrust = 2.0 * forces[0] + 1.8 * forces[1]
    assert delivered.force == pytest.approx(thrust / j, abs=1e-10)  # rounding of 206 N over J of 0.36
    assert delivered.saturation_error == pytest.approx(delivered.force - demand, abs=1e-10)
    if abs(j * demand) < 3.0:  # 3 V give 4.2 N each at least
        assert delivered.saturation_error == 0.0


def test_vehicles_and_controllers_start_with_one_table() -> None:
    """Neither imports the other, so the numbers stand twice."""
    assert (thruster.T200_VOLTAGE, thruster.T200_FORCE) == (VOLTAGES, FORCES)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"thruster_table_voltage[3]": -12.0}, "thruster_table_voltage: each above the one before"),
        ({"thruster_table_force[3]": -60.0}, "thruster_table_force: none below the one before"),
        ({f"thruster_table_force[{i}]": 0.0 for i in range(14, 25)}, "from below 0 N to above 0 N"),
    ],
)
@pytest.mark.parametrize("block", [pid.BLOCK, adrc.BLOCK, thrust_allocation.BLOCK])
def test_a_table_without_an_inverse_is_refused_if_it_is_used(
    driver: Any, block: Any, change: dict[str, float], expected: str
) -> None:
    driver(block, **change).begin()
    with pytest.raises(BlockError, match=expected):
        driver(block, thruster_tabulated=True, **change).begin()
