"""Every block runs unchanged on CasADi symbols: the flavour to come needs no change in a block."""

import random

import numpy as np
import pytest

from fmus import catalogue
from fmus.block import Block, ScalarVariable, flatten, unflatten
from fmus.export.symbolic import Traced, initial_dependencies

# Both evaluate the same operations in double precision; only the elementary functions of the two
# libraries round differently, and cancellation enlarges that by the size of the terms.
RELATIVE, ABSOLUTE = 1e-11, 1e-11


def random_value(variable: ScalarVariable, rng: random.Random) -> float:
    if variable.enumeration:
        return rng.choice(list(variable.enumeration))
    if variable.type == "Boolean":
        return rng.random() < 0.5
    low = variable.minimum if variable.minimum is not None else -2.0
    high = variable.maximum if variable.maximum is not None else 2.0
    if variable.type == "Integer":
        return rng.randint(int(low), int(high))
    around = variable.start * rng.uniform(0.7, 1.4) if variable.start else rng.uniform(-0.5, 0.5)
    return min(max(around, low), high)


def random_values(block: Block, causality: str, rng: random.Random) -> list:
    return [random_value(v, rng) for v in block.of_causality(causality)]


@pytest.mark.parametrize("name", catalogue.block_names())
def test_traced_functions_equal_the_floats_at_random_points(name: str) -> None:
    block, rng = catalogue.load_block(name), random.Random(1)
    traced = Traced(block)
    for _ in range(200):
        scalars = random_values(block, "parameter", rng)
        parameters = unflatten(block.parameters, scalars)
        inputs_scalars = random_values(block, "input", rng)
        inputs = unflatten(block.inputs, inputs_scalars)
        calculated = block.calculate(parameters)
        t, h = rng.uniform(0.0, 10.0), parameters.internal_step
        state = block.initial_state(t, inputs, parameters, calculated)
        derived = flatten(calculated)
        assert_equal(traced.calculate(scalars), calculated)
        assert_equal(traced.initial_state(t, inputs_scalars, scalars, derived), state)

        perturbed = [x + rng.uniform(-0.1, 0.1) for x in flatten(state)]
        state = unflatten(state, perturbed)
        assert_equal(
            traced.step(t, h, perturbed, inputs_scalars, scalars, derived),
            block.step(t, h, state, inputs, parameters, calculated),
        )
        outputs = block.output(t, state, parameters, calculated)
        assert_equal(traced.output(t, perturbed, scalars, derived), outputs)


def assert_equal(column: object, value: object) -> None:
    np.testing.assert_allclose(np.array(column).ravel(), flatten(value), RELATIVE, ABSOLUTE)


def test_the_plant_starts_independently_of_its_voltages() -> None:
    """Otherwise controller and plant would form a loop in initialisation mode."""
    plant = catalogue.load_block("RovDepthPlant")
    voltages = {v.value_reference for v in plant.variables if v.name.startswith("voltage")}
    for known in initial_dependencies(plant).values():
        assert not voltages & set(known)


def test_initial_outputs_of_the_controller_follow_its_measurement() -> None:
    controller = catalogue.load_block("L1DepthController")
    reference = {v.name: v.value_reference for v in controller.variables}
    dependencies = initial_dependencies(controller)
    assert reference["measured_depth"] in dependencies[reference["tracking_error"]]
    assert dependencies[reference["omega_hat"]] == (reference["input_gain"],)
