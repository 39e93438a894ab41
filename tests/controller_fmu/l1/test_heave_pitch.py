"""The law of both axes: allocation with a priority, each axis alone, and what one leaves to the other."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu import allocation, depth_interface
from controller_fmu.l1 import depth_controller
from controller_fmu.l1 import heave_pitch_controller as both
from controller_fmu.l1.heave_pitch_controller import Parameters, Priority

BOTH, DEPTH = both.BLOCK, depth_controller.BLOCK
RANGES = ((-3.0, 2.0), (-1.5, 2.5))
LEVERS = (0.1, -0.05)
SHARE = allocation.shares(LEVERS)
DEMANDS = st.floats(-8.0, 8.0)


def forces(force: float, couple: float) -> tuple[float, float]:
    return SHARE[0] * force - couple, SHARE[1] * force + couple


@given(force=DEMANDS, couple=DEMANDS)
def test_the_shares_give_the_force_and_the_moment(force: float, couple: float) -> None:
    first, second = forces(force, couple)
    moment = -LEVERS[0] * first - LEVERS[1] * second
    # sums of a few numbers below 20, rounded
    assert first + second == pytest.approx(force, abs=1e-13)
    assert moment == pytest.approx(couple * (LEVERS[0] - LEVERS[1]), abs=1e-13)


@given(force=DEMANDS, couple=DEMANDS, heave_first=st.booleans())
def test_the_axis_with_priority_keeps_what_is_possible_and_the_other_what_is_left(
    force: float, couple: float, heave_first: bool
) -> None:
    """Beside a search over all forces of both thrusters, on a grid that both ranges end on."""
    given_force, given_couple = allocation.limited(force, couple, SHARE, RANGES, heave_first)
    first, second = np.meshgrid(*(np.linspace(low, high, 401) for low, high in RANGES), indexing="ij")
    sums, couples = first + second, SHARE[0] * (first + second) - first
    spacing = 2 * 5.0 / 400  # of the sum of two thrusters, the largest range being 5 N
    in_order = [(sums, force, given_force), (couples, couple, given_couple)][:: 1 if heave_first else -1]
    (wanted, demand, result), (other, beside, rest) = in_order
    assert abs(result - demand) <= np.abs(wanted - demand).min() + 1e-12
    near = np.abs(wanted - result) <= spacing
    # F changes by up to 1 / s_1 = 3 with m
    assert abs(rest - beside) <= np.abs(other - beside)[near].min() + 4 * spacing
    own = forces(given_force, given_couple)
    assert all(low - 1e-12 <= f <= high + 1e-12 for f, (low, high) in zip(own, RANGES, strict=True))


@given(force=st.floats(-0.5, 0.5), couple=st.floats(-0.5, 0.5), heave_first=st.booleans())
def test_what_both_thrusters_give_stays_to_the_last_bit(
    force: float, couple: float, heave_first: bool
) -> None:
    assert allocation.limited(force, couple, SHARE, RANGES, heave_first) == (force, couple)


@pytest.mark.parametrize("tabulated", [False, True])
@pytest.mark.parametrize("priority", list(Priority))
@pytest.mark.parametrize(("force", "moment"), [(1.0, 0.05), (40.0, 0.2), (1.0, -20.0), (-90.0, 5.0)])
def test_errors_and_deliveries_are_those_of_the_voltages(
    tabulated: bool, priority: Priority, force: float, moment: float
) -> None:
    """Force and moment computed here from the voltages; the error is exactly 0 of what keeps its demand."""
    p = Parameters(priority=priority, thruster_tabulated=tabulated, thruster_gain=(0.25, 0.2))
    heave, pitch = both._deliver(force, moment, 1.0, p, both.calculate(p))
    table = p.thruster_table_voltage, p.thruster_table_force
    first, second = (
        float(np.interp(v, *table)) if tabulated else gain * v
        for v, gain in zip(heave.voltage, p.thruster_gain, strict=True)
    )
    x_1, x_2 = p.thruster_lever
    for given_now, demand, delivered in (
        (heave, force, first + second),
        (pitch, moment, -x_1 * first - x_2 * second),
    ):
        # the table's slopes times the rounding of a voltage
        assert given_now.force == pytest.approx(delivered, abs=1e-12)
        assert given_now.saturation_error == pytest.approx(delivered - demand, abs=1e-11)
    (low_1, high_1), (low_2, high_2) = depth_interface.force_ranges(p)
    if priority == Priority.HEAVE:
        assert (heave.saturation_error == 0.0) == (low_1 + low_2 <= force <= high_1 + high_2)
    else:
        ends = -x_1 * high_1 - x_2 * low_2, -x_1 * low_1 - x_2 * high_2
        assert (pitch.saturation_error == 0.0) == (ends[0] <= moment <= ends[1])


def depth_at(t: float) -> dict[str, float]:
    return {"depth_reference": 0.02 * t, "measured_depth": 0.015 * t + 0.01 * math.sin(3.0 * t), "roll": 0.1}


@pytest.mark.parametrize(
    ("given", "rounding"),
    [
        ({"augmentation": both.Augmentation.PI}, 0.0),
        pytest.param({"augmentation": both.Augmentation.NONE}, 0.0, marks=pytest.mark.slow),
        ({"augmentation": both.Augmentation.NONE, "voltage_limit": 0.4}, 1e-12),
    ],
    ids=["pi", "plain", "saturated"],
)
def test_with_the_pitch_at_rest_the_depth_axis_is_that_controller(
    driver: Any, given: dict[str, float], rounding: float
) -> None:
    """To the last bit: with equal levers each thruster's share is half, and a moment of 0 changes nothing.

    At their limit its saturation is that of the force there, of each voltage here: rounding lies between.
    """
    one, two = (driver(block, **given).begin() for block in (DEPTH, BOTH))
    names = [v.name for v in DEPTH.of_causality("output")]
    for k in range(300):
        for name, value in depth_at(0.02 * k).items():
            one[name] = two[name] = value
        one.step(0.02)
        two.step(0.02)
        assert two["demanded_force"] == pytest.approx(one["demanded_force"], rel=0.0, abs=rounding)
    assert abs(one["demanded_force"]) > 0.02
    assert (abs(one["voltage[1]"]) == 0.4) == ("voltage_limit" in given)
    assert [two[name] for name in names] == pytest.approx([one[name] for name in names], abs=rounding)


def test_the_pitch_axis_is_the_same_law_with_its_own_gains(driver: Any) -> None:
    """A depth controller with the gains that a heavier pitch has here, and without a righting moment."""
    own = {
        "adaptation_gain": 2.0, "filter_bandwidth": 1.5, "theta_bound[1]": 0.5, "sigma_bound": 0.8,
        "augmentation": both.Augmentation.PI, "proportional_gain": 0.7, "integral_gain": 0.3,
        "model_inertia": 0.5, "model_damping": 0.1, "rate_feedback_gain": 2.9,
    }  # fmt: skip
    wide = {"voltage_limit": 1e6}  # nothing saturates
    one = driver(DEPTH, depth_feedback_gain=4.5, **own, **wide).begin()
    of_pitch = {f"pitch_{name}": value for name, value in own.items()}
    two = driver(BOTH, pitch_feedback_gain=4.5, pitch_model_stiffness=0.0, **of_pitch, **wide).begin()
    for k in range(300):
        pitch = 0.1 * math.sin(0.04 * k)
        one["measured_depth"], two["measured_pitch"] = pitch, pitch
        one["depth_reference"] = two["pitch_reference"] = 0.05
        one.step(0.02)
        two.step(0.02)
        # the moment that is delivered goes through two thrusters here: rounding lies between
        assert two["demanded_moment"] == pytest.approx(one["demanded_force"], rel=1e-9, abs=1e-12)
        assert two["pitch_sigma_hat"] == pytest.approx(one["sigma_hat"], rel=1e-9, abs=1e-12)
    assert abs(two["demanded_moment"]) > 1e-3


def test_a_thruster_behind_the_other_is_refused_and_so_is_the_nonlinear_p_of_the_pitch() -> None:
    lever = next(v for v in BOTH.variables if v.name == "thruster_lever[2]")
    assert (lever.minimum, lever.maximum) == (-1e3, -1e-3)
    p = replace(Parameters(), pitch_augmentation=both.Augmentation.NONLINEAR_P)
    unmet = [text for is_met, text in both.requirements(p, both.calculate(p)) if not is_met]
    assert unmet == ["pitch_augmentation none or pi"]
