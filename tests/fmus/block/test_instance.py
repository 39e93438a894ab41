"""An instance does what it says or refuses and stays as it was."""

import json
import math
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.block import Block, variable
from fmus.block.instance import BlockError, BlockInstance
from fmus.generate import builder
from tests.shared_builds import one_of_a_kind


def outputs(instance: BlockInstance) -> list[float]:
    return [instance.get(v.value_reference) for v in instance.block.of_causality("output")]


@pytest.mark.parametrize("name", one_of_a_kind(builder.block_names()))
@given(data=st.data())
def test_save_step_restore_step_gives_identical_results(name: str, data: st.DataObject) -> None:
    block = builder.load_block(name)
    instance = BlockInstance(block, "x")
    values = st.floats(-1.0, 1.0)
    inputs = [v for v in block.of_causality("input") if v.minimum is None and v.type == "Real"]
    instance.start(0.0)
    for v in inputs:
        instance.set(v.value_reference, data.draw(values))
    instance.exit_initialization_mode()
    h = block.step_size
    for _ in range(data.draw(st.integers(0, 5))):
        instance.do_step(instance.time, h)
    saved = instance.snapshot()
    for v in inputs:
        instance.set(v.value_reference, data.draw(values))
    for _ in range(3):
        instance.do_step(instance.time, h)
    instance.restore(saved)
    other = BlockInstance(block, "x")
    other.restore(saved)
    for _ in range(3):
        instance.do_step(instance.time, h)
        other.do_step(other.time, h)
        assert outputs(instance) == outputs(other)
    assert instance.snapshot() == other.snapshot()


def damaged(driver: Any, key: str, index: int | slice, value: Any) -> str:
    """A snapshot with one entry changed."""
    saved = json.loads(driver.instance.snapshot())
    saved[key][index] = value
    return json.dumps(saved)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (lambda d: d.__setitem__("inertia", -1.0), r"inertia = -1.0: expected 0.1 to 1e6 kg"),
        (lambda d: d.__setitem__("voltage[1]", float("inf")), r"voltage\[1\] = inf: expected a finite"),
        (lambda d: d.__setitem__("initial_depth", 1.0), "initial_depth: is fixed"),
        (lambda d: d.__setitem__("depth", 1.0), "depth: cannot be set, its causality is output"),
        (lambda d: d.instance.do_step(0.0, 0.0), "communication step size 0.0 s: expected more than 0"),
        (lambda d: d.instance.do_step(0.0, -1.0), "communication step size -1.0 s"),
        (lambda d: d.instance.do_step(0.0, float("nan")), "communication step size nan s"),
        (lambda d: d.instance.do_step(5.0, 0.1), "communication point 5.0 s: expected 0.0"),
        (lambda d: d.instance.do_step(math.inf, 0.1), "communication point inf s"),
        (lambda d: d.instance.do_step(0.0, 1e300), r"step size 1e\+300 s: expected at most 1e\+09 internal"),
        (lambda d: d.instance.restore("{}"), "not a serialised state of RovDepthPlant"),
        (lambda d: d.instance.restore("nonsense"), "not a serialised state of RovDepthPlant"),
        (lambda d: d.instance.restore(damaged(d, "state", 0, "x")), "not a serialised state"),
        (
            lambda d: d.instance.restore(damaged(d, "state", 0, math.nan)),
            "depth = nan: expected a finite number",
        ),
        (
            lambda d: d.instance.restore(damaged(d, "state", 6, 1.5)),
            r"of RovDepthPlant: j = 1.5: expected -1 to 1",
        ),
        (
            lambda d: d.instance.restore(damaged(d, "state", slice(0, 0), [0.0])),
            r"\(.*, 22\) values and states",
        ),
        (lambda d: d.instance.restore(damaged(d, "values", 3, -7.0)), r"inertia = -7.0: expected 0.1"),
    ],
)
def test_a_refused_call_leaves_everything_as_it_was(driver: Any, action: Any, message: str) -> None:
    plant = driver(builder.load_block("RovDepthPlant")).begin()
    before = plant.instance.snapshot()
    with pytest.raises(BlockError, match=message):
        action(plant)
    assert plant.instance.snapshot() == before


def test_another_blocks_state_is_refused() -> None:
    plant = BlockInstance(builder.load_block("RovDepthPlant"), "one")
    other = BlockInstance(builder.load_block("RovDepthPlant"), "two")
    with pytest.raises(BlockError, match="expected"):
        other.restore(plant.snapshot())


def test_a_diverging_step_is_refused_and_the_state_kept(driver: Any) -> None:
    plant = driver(builder.load_block("ExamplePlant")).begin()
    plant["control"] = 1e300
    plant["omega"] = 1e300
    before = plant.instance.snapshot()
    with pytest.raises(BlockError, match="not finite any more"):
        plant.step(1.0)
    assert plant.instance.snapshot() == before


def test_internal_steps_are_equal_and_land_on_the_communication_point(driver: Any) -> None:
    """One long communication step equals the internal steps that it must take."""
    one = driver(builder.load_block("RovDepthPlant"), internal_step=0.01).begin()
    many = driver(builder.load_block("RovDepthPlant"), internal_step=0.01).begin()
    one["voltage[1]"] = many["voltage[1]"] = 3.0
    one.step(0.04)
    many.step(0.01, count=4)
    assert one["depth"] == pytest.approx(many["depth"], rel=1e-14)  # t differs by rounding


def test_a_tuned_gain_acts_from_the_next_step(driver: Any) -> None:
    controller = driver(builder.load_block("L1DepthController"), measured_depth=0.5).begin()
    controller["depth_feedback_gain"] = 5.0
    controller.step(0.02)
    assert controller["u_m"] == pytest.approx(-5.0 * 0.5)
    assert controller["feedforward_gain"] == pytest.approx(5.0)


def test_outputs_follow_inputs_during_initialisation(driver: Any) -> None:
    controller = driver(builder.load_block("L1DepthController"))
    controller.instance.start(0.0)
    controller["depth_reference"] = 0.3
    assert controller["tracking_error"] == -0.3
    controller["measured_depth"] = 0.1
    assert controller["tracking_error"] == pytest.approx(-0.2)
    assert controller["predicted_depth"] == 0.1


@pytest.mark.parametrize("role", ["inputs", "parameters"])
def test_zero_and_minus_zero_are_values_that_differ(role: str) -> None:
    """atan2 distinguishes them; 3 set over 3 changes nothing, so it need not be calculated again."""

    @dataclass(frozen=True)
    class Value:
        x: float = variable(0.0, "A number")

    @dataclass(frozen=True)
    class Angle:
        y: float = variable(0.0, "The angle of -1 and the number")

    calls: list[float] = []

    def angle(p: Any, u: Any) -> Angle:
        calls.append((u if role == "inputs" else p).x)
        return Angle(math.atan2(calls[-1], -1.0))

    roles: Any = {role: Value}
    block = Block(
        "Angle",
        "An angle",
        outputs=Angle,
        state=Angle,
        initial_state=lambda t, u, p, c: angle(p, u),
        step=lambda t, h, state, u, p, c: angle(p, u),
        output=lambda t, state, p, c: state,
        **roles,
    )
    instance = BlockInstance(block)
    names = {v.name: v.value_reference for v in block.variables}
    for value in (0.0, -0.0, 0.0, 3.0, -0.0):
        instance.set(names["x"], value)
        assert str(instance.get(names["x"])) == str(value)
        assert instance.get(names["y"]) == math.atan2(value, -1.0)
    count = len(calls)
    instance.set(names["x"], -0.0)
    assert instance.get(names["y"]) == -math.pi
    assert len(calls) == count


def test_a_contradicting_gain_stops_steps_and_nothing_else(driver: Any) -> None:
    controller = driver(builder.load_block("L1Controller"), reference=1.0).begin().step(0.001)
    before = controller["control"]
    controller["state_matrix[2,2]"] = 1.4
    with pytest.raises(BlockError, match="expected a Hurwitz A_m"):
        controller.step(0.001)
    assert (controller["control"], controller["reference"]) == (before, 1.0)
    controller["state_matrix[2,2]"] = -1.4
    controller.step(0.001)


def test_a_step_before_the_initialisation_has_ended_is_refused(driver: Any) -> None:
    plant = driver(builder.load_block("RovDepthPlant"))
    plant.instance.start(0.0)
    with pytest.raises(BlockError, match="before the initialisation has ended"):
        plant.step(0.02)


def test_contradicting_parameters_are_refused(driver: Any) -> None:
    plant = driver(builder.load_block("RovDepthPlant"), sensor_period=0.001)
    with pytest.raises(BlockError, match="internal_step at most sensor_period"):
        plant.begin()


def test_a_refused_step_leaves_calculated_parameters_as_they_were(driver: Any) -> None:
    """Also when the parameter that changed them is fine, and the step fails for another reason."""
    controller = driver(builder.load_block("L1DepthController")).begin()
    before = controller["feedforward_gain"]
    controller["depth_feedback_gain"] = 3.0
    with pytest.raises(BlockError, match="expected at most"):
        controller.step(1e300)
    assert controller["feedforward_gain"] == before
    controller.step(0.02)
    assert controller["feedforward_gain"] == pytest.approx(3.0, rel=1e-12)


def test_an_initial_state_that_is_not_finite_is_refused(driver: Any) -> None:
    plant = driver(builder.load_block("RovDepthPlant"), initial_depth=1e308)
    with pytest.raises(BlockError, match=r"not finite at the start|cannot convert"):
        plant.begin()
    plant["initial_depth"] = 1.0
    assert plant.begin()["depth"] == 1.0
