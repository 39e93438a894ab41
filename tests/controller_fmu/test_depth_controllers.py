"""What every controller of the depth control interface shares."""

from types import ModuleType
from typing import Any

import pytest

from controller_fmu.baselines import adrc, mrac, pid, sliding_mode, super_twisting
from controller_fmu.depth_interface import DepthInputs, DepthOutputs
from controller_fmu.l1 import depth_controller
from fmus.block import Block, NoValues
from fmus.block.scalars import flatten

OTHERS = [pid.BLOCK, mrac.BLOCK, sliding_mode.BLOCK, super_twisting.BLOCK, adrc.BLOCK]
BLOCKS = [depth_controller.BLOCK, *OTHERS]


def named(block: Block) -> str:
    return block.name


@pytest.mark.parametrize("block", BLOCKS, ids=named)
def test_it_has_the_ports_of_the_depth_control_interface(block: Block) -> None:
    assert block.inputs is DepthInputs
    names = [v.name for v in block.of_causality("output")]
    assert names[:2] == ["voltage[1]", "voltage[2]"]
    assert names[2 : len(flatten(DepthOutputs()))] == [
        "demanded_force", "tracking_error", "estimated_depth_rate"
    ]  # fmt: skip


@pytest.mark.parametrize("block", BLOCKS, ids=named)
def test_a_gain_that_the_identification_of_l1_fits_is_no_gain_of_another_law(block: Block) -> None:
    """A scenario's value of an L1 gain stays where a controller that takes its place has that name."""
    fitted = {"depth_feedback_gain", "rate_feedback_gain", "filter_bandwidth", "proportional_gain"}
    names = {v.name for v in block.of_causality("parameter")}
    shared = names & {*fitted, "integral_gain", "adaptation_gain"}
    assert not shared or block is depth_controller.BLOCK


@pytest.mark.parametrize("block", OTHERS, ids=named)
def test_the_acceleration_of_the_reference_is_fed_forward_but_by_the_pid(driver: Any, block: Block) -> None:
    controller = driver(block, depth_reference_acceleration=0.1).begin()
    inertia = 0.0 if block is pid.BLOCK else controller["model_inertia"]
    assert controller["demanded_force"] == pytest.approx(0.1 * inertia)


@pytest.mark.parametrize("block", BLOCKS, ids=named)
def test_a_run_that_starts_late_has_the_samples_of_one_that_starts_at_0(driver: Any, block: Block) -> None:
    def rates(start: float) -> list[float]:
        controller = driver(block, measured_depth=0.1).begin(start)
        observed = []
        for i in range(9):
            controller["measured_depth"] = 0.1 + 0.01 * i
            observed.append(controller.step(0.02)["estimated_depth_rate"])
        return observed

    assert rates(100.0) == rates(0.0)
    assert rates(0.0)[-1] > 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("block", [b for b in OTHERS if b not in (mrac.BLOCK, adrc.BLOCK)], ids=named)
def test_integrators_hold_while_they_would_widen_a_saturation(driver: Any, block: Block, sign: float) -> None:
    """5 m too deep saturates thrusters that give 1 N; 5 mm do not."""
    integral = "sliding_variable" if block is sliding_mode.BLOCK else "integral_force"
    controller = driver(block, measured_depth=5.0 * sign, velocity_source=2, voltage_limit=2.0).begin()
    before = controller[integral]
    for _ in range(50):
        controller.step(0.02)
        assert abs(controller["demanded_force"]) > 1.0
        assert abs(controller["voltage[1]"]) == 2.0
    assert controller[integral] == before
    controller["measured_depth"] = 0.005 * sign
    controller.step(0.02)
    changed = controller[integral]
    for _ in range(50):
        controller.step(0.02)
    assert abs(controller[integral] - changed) > 1e-3


@pytest.mark.parametrize("law", [pid, sliding_mode], ids=["pid", "sliding mode"])
def test_the_integral_takes_the_error_of_the_newest_measurement(law: ModuleType) -> None:
    p, nothing = law.Parameters(), NoValues()
    state = law.initial_state(0.0, DepthInputs(measured_depth=0.1), p, nothing)
    after = law.step(0.0, 0.02, state, DepthInputs(measured_depth=0.5, depth_reference=0.2), p, nothing)
    integral = after.integral / p.ki if law is pid else after.error_integral
    assert integral == pytest.approx(0.02 * 0.3)


@pytest.mark.parametrize(
    ("block", "gain", "others"),
    [
        (pid.BLOCK, "ki", {}),
        (depth_controller.BLOCK, "integral_gain", {"augmentation": 2, "proportional_gain": 4.0}),
    ],
    ids=["pid", "l1"],
)
@pytest.mark.parametrize(("before", "after"), [(0.0, 5.5), (2.0, 0.0), (0.5, 0.75)])
def test_a_gain_of_the_integral_that_changes_in_a_run_acts_on_later_errors_alone(
    driver: Any, block: Block, gain: str, others: dict[str, float], before: float, after: float
) -> None:
    """Demands of three instances after 10 s with errors of 4 and 1 cm, the gain changed in one of them."""

    def demands(*changes: float) -> list[float]:
        given = {gain: before, **others, "velocity_source": 2, "depth_reference": 0.3, "measured_depth": 0.34}
        controller = driver(block, **given).begin()
        controller.step(0.02, 250)
        controller["measured_depth"] = 0.31
        controller.step(0.02, 250)
        at_change = controller["demanded_force"]
        for value in changes:
            controller[gain] = value
        return [at_change, *(controller.step(0.02)["demanded_force"] for _ in range(2))]

    kept, changed = demands(), demands(after)
    assert changed[0] == kept[0]
    for k in (1, 2):
        assert changed[k] - kept[k] == pytest.approx(-k * 0.02 * 0.01 * (after - before), rel=0.02, abs=1e-9)


def test_super_twisting_takes_the_direction_of_the_newest_measurement() -> None:
    p, nothing = super_twisting.Parameters(), NoValues()
    state = super_twisting.initial_state(0.0, DepthInputs(measured_depth=0.1), p, nothing)
    after = super_twisting.step(0.0, 0.02, state, DepthInputs(measured_depth=-0.5), p, nothing)
    s = super_twisting.sliding_variable(after.interface.measured, p)
    assert after.direction == super_twisting.direction(0.02, s, p)
    assert after.direction < 0.0 < state.direction


def test_mrac_learns_from_the_newest_measurement() -> None:
    """The model is at the first one: only another makes an estimate move."""
    p = mrac.Parameters()
    matrices = mrac.calculate(p)
    state = mrac.initial_state(0.0, DepthInputs(measured_depth=0.1), p, matrices)
    after = mrac.step(0.0, 0.02, state, DepthInputs(measured_depth=0.5), p, matrices)
    now = after.interface.measured
    learnt = mrac.adapt(0.02, state.adaptive, (now.depth, now.rate), p, matrices)
    assert (after.adaptive.theta_hat, after.adaptive.sigma_hat) == (learnt.theta_hat, learnt.sigma_hat)
    assert learnt.sigma_hat > 0.0


def test_the_model_of_mrac_is_driven_by_the_control_that_the_vehicle_receives() -> None:
    """That of the reference of the step before: a reference that jumps moves it a step later."""
    p = mrac.Parameters()
    matrices = mrac.calculate(p)
    state = mrac.initial_state(0.0, DepthInputs(), p, matrices)
    jumped = DepthInputs(depth_reference=0.1)
    after = mrac.step(0.0, 0.02, state, jumped, p, matrices)
    assert after.adaptive.model == (0.0, 0.0)
    assert mrac.step(0.02, 0.02, after, jumped, p, matrices).adaptive.model[0] > 0.0
