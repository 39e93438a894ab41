"""The linear loop of the blocks' code, against runs of their FMUs at small amplitude."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.margins.code_loop import Step, code_loop, delayed
from orchestration.studies.margins.theory_metrics import code_metrics
from orchestration.system.faults import Fault, Scale
from orchestration.system.signals import Constant
from tests.orchestration.studies.margins.small_amplitude import PULSE, VOLTAGES, largest_delay
from tests.shared_builds import Fmus

# at rest from the start, with a sensor that samples without noise: nothing but the pulse moves the vehicle
QUIET: dict[str, Any] = {
    "plant.initial_depth": 0.0,
    "plant.net_weight": 0.0,
    "plant.free_surface": False,
    "plant.sensor_noise": 0.0,
    "plant.sensor_resolution": 0.0,
}
# the largest of |x| has no derivative at 0
SMOOTH: dict[str, Any] = {"controller.regressor": "state", "controller.augmentation": "pi"}


def at_rest(controller: str, parameters: dict[str, Any], efficiency: float = 1.0) -> Scenario:
    changes = {
        "components": {"controller": controller},
        "parameters": QUIET | parameters,
        "inputs": {"plant.thruster_efficiency[2]": efficiency},
    }
    loaded = scenario.load(scenario.find("hold-force-step"), changes)
    signals = dict.fromkeys(loaded.experiment.signals, Constant(0.0)) | {"plant.external_force": PULSE}
    changed = replace(loaded.experiment, stop_time=120.0, signals=signals, record=("plant.depth",))
    return replace(loaded, experiment=changed, metrics={})


def delay_margin(loaded: Scenario) -> float:
    loop = code_loop(loaded, loaded.experiment.stop_time, VOLTAGES)
    assert loop
    return next(metric.value for metric in code_metrics(loop) if metric.unit == "s")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "parameters", "efficiency"),
    [
        ("L1DepthController", SMOOTH | {"controller.augmentation": "none"}, 1.0),
        ("L1DepthController", SMOOTH | {"controller.adaptation_gain": 1e4}, 1.0),
        ("L1DepthController", SMOOTH, 0.0),
        ("PidDepthController", {}, 1.0),
        ("AdrcDepthController", {}, 1.0),
    ],
)
def test_the_fmus_bear_the_delay_of_the_code(
    built: Fmus, controller: str, parameters: dict[str, Any], efficiency: float
) -> None:
    """The runs' delay is found within 0.5 ms, which is 0.3 % of the smallest one."""
    assert built[controller].is_file()
    loaded = at_rest(controller, parameters, efficiency)
    expected = delay_margin(loaded)
    assert largest_delay(loaded, expected) == pytest.approx(expected, rel=3e-3)


def test_a_delay_lies_on_straight_lines_between_whole_steps() -> None:
    """Of an integrator x' = x + 0.1 u with u = -x: 2 steps and a quarter."""
    step = Step(np.array([[0.9]]), np.array([[0.1]]), np.array([[-1.0]]))
    later = np.array(
        [[1.0, 0.0, 0.075, 0.025], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    )
    assert delayed(step, 2.25, 1.0) == pytest.approx(later)
    assert delayed(step, 0.0, 2.0)[0, 0] == pytest.approx(0.8)


@pytest.mark.slow
def test_a_loop_with_faults_is_not_made() -> None:
    loaded = at_rest("L1DepthController", SMOOTH)
    faults = (Fault(VOLTAGES[0], Scale(0.5)),)
    faulty = replace(loaded, experiment=replace(loaded.experiment, faults=faults))
    assert code_loop(loaded, 100.0, VOLTAGES)
    assert code_loop(faulty, 100.0, VOLTAGES) is None
