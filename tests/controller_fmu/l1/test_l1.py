"""The law: its wiring, the control that drives the prediction, saturation."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from controller_fmu.l1 import law as l1
from controller_fmu.l1 import siso_controller
from controller_fmu.l1.adaptation import Interval, adapt
from controller_fmu.l1.law import Held, LawState, Measurement
from controller_fmu.l1.lowpass import FilterState
from controller_fmu.l1.parameters import Augmentation, FilterOrder, ReferenceFeedforward
from fmus.generate import builder

SEEN = Measurement(x=(2.0, -1.0), y=2.0, r=3.0)
CONTROLLER = siso_controller.BLOCK


def parameters(**values: Any) -> siso_controller.Parameters:
    standard = {"adaptation_gain": 50.0, "filter_bandwidth": 3.0, "sigma_bound": 5.0}
    return replace(siso_controller.Parameters(), **(standard | values))


def stepped(p: siso_controller.Parameters, law: LawState, h: float, count: int, now: Measurement) -> LawState:
    """The law after `count` steps of one measurement, nothing saturated."""
    matrices = siso_controller.calculate(p)
    for _ in range(count):
        u = l1.control(law, p.feedback_gain, p)
        law = l1.law_step(h, law, now, u, u.total, 0.0, p.feedback_gain, p, matrices)
    return law


@pytest.mark.parametrize("at_end", [False, True])
@pytest.mark.parametrize("order", list(FilterOrder))
def test_either_filter_settles_where_eta_hat_is_k_g_r(order: FilterOrder, at_end: bool) -> None:
    p = parameters(filter_order=order, inputs_at_step_end=at_end, state_matrix=((0.0, 1.0), (-2.0, -1.4)))
    law = stepped(p, l1.initial_law(SEEN, p), 4e-3, 5000, SEEN)
    e = law.estimates
    eta = e.omega_hat * law.filter.u_a + e.theta_hat[0] * 2.0 - e.theta_hat[1] + e.sigma_hat
    assert eta == pytest.approx(2.0 * SEEN.r, rel=1e-6)  # k_g = -1 / (C A_m^-1 B_m) = 2


@pytest.mark.parametrize("at_end", [False, True])
@pytest.mark.parametrize("limit", [1e6, 1.0])
@pytest.mark.parametrize("feedforward", [ReferenceFeedforward.NONE, ReferenceFeedforward.OUTSIDE])
def test_the_prediction_is_driven_by_the_control_that_the_plant_received(
    driver: Any, at_end: bool, limit: float, feedforward: ReferenceFeedforward
) -> None:
    """A plant that is the model, fed with the held control: no prediction error but that of the step.

    Jacobi hands over what was measured at the beginning of a step, Gauss-Seidel what is measured at its end.
    With the other setting the prediction is driven by the control of the step before, or after.
    """
    matched, other = (
        largest_prediction_error(driver, at_end, setting, limit, feedforward)
        for setting in (at_end, not at_end)
    )
    assert matched < 1e-4  # h^2 |A_m| |u'| / 8
    assert other > 30.0 * matched


def largest_prediction_error(
    driver: Any, at_end: bool, setting: bool, limit: float, feedforward: ReferenceFeedforward
) -> float:
    """Gamma is 0: nothing is learnt. The plant, A = A_m + B_m k_m, is exact; step sizes alternate."""
    lengths, k_m = (0.01, 0.006), np.array([0.5, 0.4])
    a = np.array([[0.0, 1.0], [-1.0, -1.4]]) + np.outer([0.0, 1.0], k_m)
    system = np.block([[a, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]])
    steps = [(h, expm(system * h)) for h in lengths]
    controller = driver(
        CONTROLLER, adaptation_gain=0.0, filter_bandwidth=5.0, augmentation=Augmentation.PI,
        proportional_gain=2.0, integral_gain=1.0, control_limit=limit, inputs_at_step_end=setting,
        reference_feedforward=feedforward,
        **{"feedback_gain[1]": k_m[0], "feedback_gain[2]": k_m[1]},
    ).begin()  # fmt: skip
    x, largest = np.zeros(2), 0.0
    for i in range(300):
        h, step = steps[i % 2]
        after = (step @ [*x, controller["control"]])[:2]
        measured = after if at_end else x
        controller["reference"] = 1.0 + math.sin(0.01 * i)
        controller["measured_state[1]"], controller["measured_state[2]"] = measured
        controller.step(h)
        largest = max(largest, abs(controller["prediction_error[1]"]), abs(controller["prediction_error[2]"]))
        assert controller["predicted_state[1]"] == measured[0] + controller["prediction_error[1]"]
        assert controller["predicted_state[2]"] == measured[1] + controller["prediction_error[2]"]
        x = after
    return largest


@pytest.mark.parametrize("limit", [12.0, 2.0])
def test_the_vehicles_prediction_is_driven_by_the_force_of_its_voltages(driver: Any, limit: float) -> None:
    """The same for the depth controller: tilted, its thrusters saturated or not, the velocity measured."""
    h, m, d, j = 0.02, 5.5, 2.5, math.cos(0.3)
    step = expm(np.array([[0.0, 1.0, 0.0], [0.0, -d / m, 1.0 / m], [0.0, 0.0, 0.0]]) * h)
    controller = driver(
        builder.load_block("L1DepthController"), adaptation_gain=0.0, velocity_source=2, roll=0.3,
        voltage_limit=limit, augmentation=Augmentation.PI, depth_reference=0.5,
    ).begin()  # fmt: skip
    x, largest, saturated = np.zeros(2), 0.0, False
    for _ in range(200):
        force = 0.25 * (controller["voltage[1]"] + controller["voltage[2]"]) / j
        saturated |= abs(controller["voltage[1]"]) == limit
        controller["measured_depth"], controller["measured_depth_rate"] = x
        controller.step(h)
        largest = max(largest, abs(controller["depth_rate_prediction_error"]))
        assert controller["predicted_depth"] == x[0] + controller["depth_prediction_error"]
        assert controller["predicted_depth_rate"] == x[1] + controller["depth_rate_prediction_error"]
        x = (step @ [*x, force])[:2]
    assert saturated == (limit < 12.0)
    assert largest < 1e-4  # m/s, of 0.1 m/s


def test_omega_hat_learns_from_a_feedforward_outside_as_from_one_inside() -> None:
    """What precedes the extension is u_a + u_f."""
    p = parameters(input_gain_uncertainty=0.5, reference_feedforward=ReferenceFeedforward.OUTSIDE)
    law = LawState(measured=Measurement(f=1.5), filter=FilterState(u_a=4.0))
    u, matrices = l1.control(law, p.feedback_gain, p), siso_controller.calculate(p)
    assert (u.u_a, u.u_f, u.total) == (4.0, 1.5, 5.5)
    after = l1.law_step(0.01, law, SEEN, u, 5.5, 0.0, p.feedback_gain, p, matrices)
    assert after.held == Held(0.01, 5.5, 5.5)


@pytest.mark.parametrize("at_end", [False, True])
def test_omega_hat_learns_from_the_adaptive_control_that_was_delivered(at_end: bool) -> None:
    """Jacobi: that of the step before; Gauss-Seidel: that of this step."""
    p = parameters(input_gain_uncertainty=0.5, inputs_at_step_end=at_end)
    before, delivered, given = LawState(), Held(0.01, 3.0, 2.0), Held(0.01, 5.0, 4.0)
    law = replace(before, held=delivered, filter=FilterState(u_a=given.u_a))
    u, matrices = l1.control(law, p.feedback_gain, p), siso_controller.calculate(p)
    after = l1.law_step(0.01, law, SEEN, u, given.u, 0.0, p.feedback_gain, p, matrices)
    held = given if at_end else delivered
    expected, _ = adapt(law.estimates, Interval(0.01, (0.0, 0.0), SEEN.x, held.u, held.u_a), p, matrices)
    assert after.estimates == expected
    assert after.held == given
    assert after.estimates.omega_hat != 1.0


def test_the_output_has_a_share_of_both_states(driver: Any) -> None:
    """y = C x, and e = y - r."""
    own = {"output_vector[2]": 0.5, "measured_state[1]": 1.0, "measured_state[2]": 2.0, "reference": 0.25}
    assert driver(CONTROLLER, **own).begin()["tracking_error"] == 1.0 + 0.5 * 2.0 - 0.25


def test_an_internal_step_is_at_most_the_observers_period(driver: Any) -> None:
    block = builder.load_block("L1DepthController")
    driver(block, internal_step=0.04, observer_period=0.04).begin()
    with pytest.raises(ValueError, match="internal_step at most observer_period"):
        driver(block, internal_step=0.05, observer_period=0.04).begin()


def test_omega_hat_begins_at_the_centre_of_its_box() -> None:
    assert l1.initial_law(SEEN, parameters(input_gain=3.0)).estimates.omega_hat == 3.0


@pytest.mark.parametrize(("bound", "expected"), [(10.0, -1.2), (1.0, -1.0)])
def test_a_law_that_has_learnt_the_buoyancy_holds_the_vehicle_from_the_start(
    driver: Any, bound: float, expected: float
) -> None:
    """u_a cancels what sigma_hat knows, so that filter and estimate stay where they begin."""
    learnt = {"initial_u_a": 1.2, "initial_sigma_hat": -1.2, "sigma_bound": bound}
    controller = driver(builder.load_block("L1DepthController"), **learnt).begin()
    assert controller["u_a"] == controller["demanded_force"] == 1.2
    assert controller["sigma_hat"] == expected
    controller.step(0.02)
    assert (controller["u_a"] == 1.2) == (bound == 10.0)


def test_only_the_depth_starts_with_what_it_has_learnt(driver: Any) -> None:
    learnt = {"initial_u_a": 1.2, "initial_sigma_hat": -1.2}
    controller = driver(builder.load_block("L1HeavePitchController"), **learnt).begin()
    assert (controller["u_a"], controller["sigma_hat"]) == (1.2, -1.2)
    assert (controller["pitch_u_a"], controller["pitch_sigma_hat"]) == (0.0, 0.0)


def test_a_prediction_error_is_that_of_one_time(driver: Any) -> None:
    """x_hat - x at the time of the last measurement: the measurement of a later time does not enter."""
    controller = driver(CONTROLLER, **{"measured_state[1]": 1.0}).begin()
    controller.step(1e-3)
    assert controller["prediction_error[1]"] == 0.0  # the prediction begins at the measured state
    assert controller["predicted_state[1]"] == 1.0


@pytest.mark.parametrize("block", ["L1Controller", "L1DepthController"])
def test_a_step_does_not_depend_on_how_it_is_called(driver: Any, block: str) -> None:
    """Two communication steps, or one with two internal steps: the same under held inputs."""
    inputs = {"L1Controller": "measured_state[1]", "L1DepthController": "measured_depth"}
    two = driver(builder.load_block(block), **{inputs[block]: 0.3}).begin()
    one = driver(builder.load_block(block), **{inputs[block]: 0.3}, internal_step=0.02).begin()
    two.step(0.02).step(0.02)
    one.step(0.04)
    assert two["sigma_hat"] == one["sigma_hat"]
    assert two["u_a"] == one["u_a"]


@given(
    augmentation=st.sampled_from(Augmentation),
    h=st.floats(1e-5, 0.1),
    gain=st.floats(1.0, 1e6),
    x=st.tuples(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0)),
    r=st.floats(-100.0, 100.0),
)
def test_no_step_size_or_gain_makes_the_filter_diverge(
    augmentation: Augmentation, h: float, gain: float, x: tuple[float, float], r: float
) -> None:
    chosen = {"adaptation_gain": gain, "filter_bandwidth": 160.0, "input_gain_uncertainty": 0.5}
    p = parameters(**chosen, augmentation=augmentation, proportional_gain=50.0)
    law = stepped(p, l1.initial_law(Measurement(), p), h, 30, Measurement(x, x[0], r))
    drive = 10.0 * (abs(x[0]) + abs(x[1])) + 5.0 + abs(r)  # what the bounds of the estimates allow
    # u_a' = -w (omega_hat u_a + drive), omega_hat >= 0.5; in steps above 2 / w the midpoint rule overshoots
    assert abs(law.filter.u_a) <= max(2.0, 0.5 * h * 160.0) * drive * (1.0 + 1e-12)


def saturated_controller(driver: Any, **values: Any) -> Any:
    """Held at 0 m for 40 s under a reference of 5 m: the thrusters saturate at 6 N."""
    block = builder.load_block("L1DepthController")
    controller = driver(block, augmentation=Augmentation.PI, depth_reference=5.0, **values).begin()
    controller.step(0.02, count=2000)
    assert controller["voltage[1]"] == 12.0
    return controller


def test_estimates_do_not_learn_the_saturation(driver: Any) -> None:
    """The vehicle does not move although 6 N push it: the model explains that by 6 N against."""
    assert saturated_controller(driver)["sigma_hat"] == pytest.approx(-6.0, rel=0.05)


@pytest.mark.parametrize("order", list(FilterOrder))
def test_integrators_do_not_wind_up(driver: Any, order: FilterOrder) -> None:
    """Held in saturation, neither u_a nor the integral of the PI goes on demanding more."""
    controller = saturated_controller(driver, filter_order=order, integral_gain=1.0)
    u_a, u_p = controller["u_a"], controller["u_p"]
    controller.step(0.02, count=500)
    assert controller["u_a"] <= u_a
    assert controller["u_p"] <= u_p
    controller["depth_reference"] = 0.0  # and the demand leaves saturation with its cause
    controller.step(0.02)
    assert abs(controller["voltage[1]"]) < 12.0


def test_each_state_of_the_third_order_filter_is_held_by_its_own_rate() -> None:
    """The actuator delivers less than demanded: p_1, p_2 and u_a stop where they would demand still more."""
    p = parameters(filter_order=FilterOrder.THIRD, filter_bandwidth=1.0)
    for side in (1.0, -1.0):
        start = FilterState(u_a=0.0, p_1=5.0 * side, p_2=5.0 * side)
        after = one_step(p, start, saturation_error=-1.0)
        assert (after.filter.u_a == 0.0) == (side > 0.0)
        assert (after.filter.p_1 == start.p_1) == (side < 0.0)  # it decays: from below, that is upwards
        assert (after.filter.p_2 == start.p_2) == (side > 0.0)


@pytest.mark.parametrize(("saturation_error", "drive"), [(-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (1.0, 1.0)])
def test_first_order_filter_and_integral_are_held_only_where_it_would_demand_still_more(
    saturation_error: float, drive: float
) -> None:
    """A demand above the limit (negative error) may fall and not rise; one below it may rise and not fall."""
    after = one_step(parameters(integral_gain=0.5), FilterState(), saturation_error, reference=drive)
    free = saturation_error * drive >= 0.0
    assert after.filter.u_a == (pytest.approx(3e-3 * drive, rel=0.01) if free else 0.0)
    assert after.integral == (-0.5e-3 * drive if free else 0.0)  # e = -r; the control has -int K_I e


def one_step(
    p: siso_controller.Parameters, start: FilterState, saturation_error: float, reference: float = 0.0
) -> LawState:
    """1 ms from rest at x = 0."""
    law, now, matrices = LawState(filter=start), Measurement(r=reference), siso_controller.calculate(p)
    u = l1.control(law, p.feedback_gain, p)
    delivered = u.total + saturation_error
    return l1.law_step(1e-3, law, now, u, delivered, saturation_error, p.feedback_gain, p, matrices)


@pytest.mark.parametrize(
    ("block", "values"),
    [
        ("L1DepthController", {"measured_depth": 0.1}),
        ("L1HeavePitchController", {"measured_depth": 0.1}),
        ("L1Controller", {"measured_state[1]": 0.1}),
    ],
)
def test_a_controller_that_is_called_extended_starts_with_its_extension(
    driver: Any, block: str, values: dict[str, float]
) -> None:
    assert "L1 adaptive" in builder.load_block(block).description
    assert driver(builder.load_block(block), **values).begin()["u_p"] < -0.1
    assert driver(builder.load_block(block), augmentation=1, **values).begin()["u_p"] == 0.0


def test_a_measured_velocity_bypasses_the_observer(driver: Any) -> None:
    block = builder.load_block("L1DepthController")
    controller = driver(block, velocity_source=2, measured_depth_rate=0.1).begin()
    assert controller["estimated_depth_rate"] == 0.1
    assert driver(block, measured_depth_rate=0.1).begin()["estimated_depth_rate"] == 0.0


def test_a_tilted_vehicle_is_driven_by_less_from_the_step_on_in_which_the_tilt_is_measured(
    driver: Any,
) -> None:
    """u = K^-1 T^+ J' (u_m + u_a + u_p)."""
    controller = driver(builder.load_block("L1DepthController"), measured_depth=1.0, roll=0.3, pitch=0.2)
    controller.begin()
    for roll in (0.3, 1.0):
        expected = math.cos(roll) * math.cos(0.2) * controller["demanded_force"] / (2.0 * 0.25)
        assert controller["voltage[1]"] == pytest.approx(expected)
        controller["roll"] = 1.0
        controller.step(0.02)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"state_matrix[2,1]": 1.0}, "expected a Hurwitz A_m"),  # a saddle: its trace is negative
        ({"input_gain_uncertainty": 1.0}, "input_gain_uncertainty below input_gain"),
    ],
)
def test_an_unstable_design_is_refused(driver: Any, values: dict[str, float], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        driver(CONTROLLER, **values).begin()
