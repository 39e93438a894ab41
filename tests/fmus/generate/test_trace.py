"""Which initial values follow from which parameters and inputs; traced functions grow as the block does."""

from dataclasses import dataclass, field, make_dataclass
from typing import Any

import casadi
import pytest

from fmus.block import Block, variable
from fmus.generate import builder
from fmus.generate.derivatives import Sensitivities
from fmus.generate.trace import trace
from fmus.numerics import maximum, sqrt, tanh


def test_the_plant_starts_independently_of_its_voltages() -> None:
    """Otherwise controller and plant would form a loop in initialisation mode."""
    plant = builder.load_block("RovDepthPlant")
    voltages = {v.value_reference for v in plant.variables if v.name.startswith("voltage")}
    dependencies = Sensitivities(trace(plant)).initial.dependencies()
    for known in (dependencies[v.value_reference] for v in plant.variables if v.causality == "output"):
        assert not voltages & set(known)


def test_initial_outputs_of_the_controller_follow_its_measurement() -> None:
    controller = builder.load_block("L1DepthController")
    reference = {v.name: v.value_reference for v in controller.variables}
    dependencies = Sensitivities(trace(controller)).initial.dependencies(controller.variables)
    assert reference["measured_depth"] in dependencies[reference["tracking_error"]]
    assert dependencies[reference["omega_hat"]] == (reference["input_gain"],)


def wide_block(width: int) -> Block:
    """As many parameters, inputs and outputs; a chain of `width` states."""

    def class_of(prefix: str) -> Any:
        members = [(f"{prefix}{i}", float, variable(1.0, f"Number {i}", min=-9.0)) for i in range(width)]
        return make_dataclass(prefix, members, frozen=True)

    parameters, inputs, outputs = map(class_of, "puy")
    state = make_dataclass("State", [("x", tuple, field(default=(0.5,) * width))], frozen=True)

    def step(t: Any, h: Any, s: Any, u: Any, p: Any, c: Any) -> Any:
        drive = tanh(sum(a * b for a, b in zip(vars(u).values(), vars(p).values(), strict=False)))
        before = (drive, *s.x[:-1])
        return state(tuple(x + h * (b - x) for x, b in zip(s.x, before, strict=True)))

    def output(t: Any, s: Any, p: Any, c: Any) -> Any:
        return outputs(*[a * b for a, b in zip(vars(p).values(), s.x, strict=False)])

    return Block(
        f"Wide{width}", "Wide", parameters=parameters, inputs=inputs, state=state, outputs=outputs,
        step=step, output=output,
    )  # fmt: skip


def test_the_operations_of_a_wide_block_grow_with_its_width() -> None:
    """Those of derivatives too: about ten times as many for ten times the width, not a hundred times."""
    narrow, wide = (
        {
            name: function.n_instructions()
            for name, function in (traced.functions() | Sensitivities(traced).functions(2)).items()
        }
        for traced in (trace(wide_block(10)), trace(wide_block(100)))
    )
    assert {name for name in wide if wide[name] > 11 * narrow[name]} == set()


@pytest.mark.slow
def test_a_block_of_three_hundred_variables_is_built(tmp_path: Any) -> None:
    assert len(wide_block(100).variables) == 301
    assert builder.build_block(wide_block(100), tmp_path).stat().st_size > 0


@pytest.mark.parametrize("of_root", [sqrt, lambda level: 1.0 / maximum(1.0 / level, 1.0)])
def test_a_steep_function_of_a_state_at_0_leaves_derivatives_by_parameters_numbers(of_root: Any) -> None:
    """A seed 0 times an infinite slope is no number: such states have no seeds."""

    @dataclass(frozen=True)
    class Gains:
        gain: float = variable(3.0, "Gain")

    @dataclass(frozen=True)
    class State:
        level: float = 0.0

    @dataclass(frozen=True)
    class Outputs:
        flow: float = variable(0.0, "Flow")

    def step(t: Any, h: Any, s: State, u: Any, p: Any, c: Any) -> State:
        return State(s.level + h)

    def output(t: Any, s: State, p: Any, c: Any) -> Outputs:
        return Outputs(p.gain + of_root(s.level))

    block = Block("Tank", "Tank", parameters=Gains, state=State, outputs=Outputs, step=step, output=output)
    flow = block.variables[-1].value_reference
    functions = Sensitivities(trace(block)).functions(2)
    for function in (functions["initial_forward"], functions["step_forward"]):
        seed = [1.0] + [0.0] * (function.numel_in(4) - 1)
        along = function(0.0, 0.0, casadi.DM(0, 1), [3.0, 0.02], seed)
        assert float(along[flow]) == 1.0
