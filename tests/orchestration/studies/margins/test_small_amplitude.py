"""The delay that the FMUs bear at small amplitude, against the margin of the linear loop."""

from dataclasses import replace
from typing import Any

import pytest

from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.margins.l1_design import design_of
from orchestration.studies.margins.l1_loop import loop
from orchestration.studies.margins.linear_margins import margins
from orchestration.system.signals import Constant
from tests.orchestration.studies.margins.small_amplitude import PULSE, largest_delay

# at rest from the start, with the true state: nothing but the pulse moves the vehicle
QUIET: dict[str, Any] = {
    "plant.initial_depth": 0.0,
    "plant.net_weight": 0.0,
    "plant.free_surface": False,
    "plant.sensor_ideal": True,
    "controller.velocity_source": "measured",
}


def at_rest(augmentation: str, step: float, efficiency: float = 1.0, stop_time: float = 80.0) -> Scenario:
    steps = {"plant.internal_step": step, "controller.internal_step": step}
    parameters = QUIET | steps | {"controller.augmentation": augmentation}
    inputs = {"plant.thruster_efficiency[2]": efficiency}
    changes = {"parameters": parameters, "inputs": inputs, "experiment": {"step_size": step}}
    loaded = scenario.load(scenario.find("hold-force-step"), changes)
    signals = {"controller.depth_reference": Constant(0.0), "plant.external_force": PULSE}
    changed = replace(loaded.experiment, stop_time=stop_time, signals=signals, record=("plant.depth",))
    return replace(loaded, experiment=changed, metrics={})


@pytest.mark.parametrize("step", [0.02, 0.01])
@pytest.mark.parametrize("augmentation", ["none", "pi"])
def test_the_fmus_bear_the_delay_of_the_linear_loop_less_one_and_a_half_steps(
    augmentation: str, step: float
) -> None:
    """Exchange by Jacobi is one step late, and a held control half a step; the root is found to 0.1 %."""
    loaded = at_rest(augmentation, step)
    design = design_of(loaded, largest_reference=0.0, rest=0.0)
    assert design
    expected = margins(loop(design.law, design.plant)).delay - 1.5 * step
    assert largest_delay(loaded, expected) == pytest.approx(expected, rel=2e-3)


def test_with_one_thruster_the_fmus_bear_the_delay_of_the_linear_loop_as_the_step_shrinks() -> None:
    """The other one is dead and gives its half of the force no more, which the law does not know.

    The delay borne then depends on the step by more than its one and a half: twice the value at half the
    step, less the value, leaves that out to second order.
    """
    loaded = {step: at_rest("pi", step, efficiency=0.0, stop_time=160.0) for step in (0.02, 0.01)}
    design = design_of(loaded[0.02], largest_reference=0.0, rest=0.0)
    assert design
    assert design.plant.gains == (0.5, 0.0)
    expected = margins(loop(design.law, design.plant)).delay
    coarse, fine = (largest_delay(one, expected - 1.5 * step) + 1.5 * step for step, one in loaded.items())
    assert coarse > 1.02 * expected
    assert 2.0 * fine - coarse == pytest.approx(expected, rel=2e-3)
