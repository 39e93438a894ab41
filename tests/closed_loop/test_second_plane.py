"""Vehicles that pitch, and the L1 law of both axes, against a second program.

It knows the equations alone. Two choices of ours are no equations, and stand in its docstrings: u cos(theta)
of the paper's (11) for the force of a tilted vehicle, and a filter that holds while it would widen a
saturation.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from tests.closed_loop.same_experiment import SMOOTH
from tests.closed_loop.second_laws import Pid
from tests.closed_loop.second_loop import continuous, run
from tests.closed_loop.second_plane import ContinuousHeavePitch, HeavePitch
from tests.closed_loop.second_program import LawStep, law_of
from tests.closed_loop.shipped_case import shipped_case
from tests.shared_builds import Fmus, slow_but

Settings = Mapping[str, Any]
NOISELESS: Settings = {**SMOOTH, "plant.pitch_noise": 0.0}
SMALL: Settings = {"plant": "RovHeavePitchPlant", "plant.thruster_efficiency[2]": 0.9}
BOTH: Settings = {**SMALL, "controller": "L1HeavePitchController"}
TURNED: Settings = {
    "plant.initial_pitch": 0.3, "plant.initial_depth": 0.5, "plant.sensor_below": 0.05,
    "plant.external_moment": 0.03,
}  # fmt: skip
LIMITED: Settings = {
    **TURNED, "controller.voltage_limit": 3.0,
    "plant.thruster_voltage_limit[1]": 3.0, "plant.thruster_voltage_limit[2]": 3.0,
}  # fmt: skip
BLUE: Settings = {
    "plant": "BlueRov2Plant", "controller": "PidDepthController", "controller.kp": 96.5,
    "controller.ki": 32.2, "controller.kd": 63.5,
}  # fmt: skip
INVERSE: Settings = {f"controller.thruster_scale[{i}]": 2.0 for i in (1, 2)} | {
    "controller.thruster_tabulated": True
}
LINE: Settings = {f"controller.thruster_gain[{i}]": 6.65 for i in (1, 2)}
BLUE_L1: Settings = {
    "plant": "BlueRov2Plant", "controller": "L1HeavePitchController", **INVERSE,
    "plant.thruster_efficiency[2]": 0.9, "controller.thruster_lever[1]": 0.12,
    "controller.thruster_lever[2]": -0.12, "controller.model_inertia": 32.18,
    "controller.model_damping": 33.0,
    "controller.depth_feedback_gain": 20.0, "controller.rate_feedback_gain": 40.0,
    "controller.pitch_model_inertia": 0.365, "controller.pitch_model_damping": 0.8,
    "controller.pitch_model_stiffness": 1.33, "controller.pitch_feedback_gain": 0.1,
    "controller.pitch_rate_feedback_gain": 0.2,
}  # fmt: skip
LAGGING: Settings = {
    **BLUE, **LINE, "plant.thruster_efficiency[1]": 0.8, "plant.initial_pitch": 0.2,
    "plant.sensor_forward": 0.2, "plant.thruster_lag[1]": 0.1, "plant.thruster_lag[2]": 0.1,
}  # fmt: skip
LOOPS: dict[str, tuple[str, Settings]] = {
    "both axes": ("heave-pitch", BOTH),
    "both, turned": ("heave-pitch", {**BOTH, **TURNED, "controller.pitch_augmentation": "pi"}),
    "both, limited": ("heave-pitch", {**BOTH, **LIMITED}),
    "both, limited, pitch first": ("heave-pitch", {**BOTH, **LIMITED, "controller.priority": "pitch"}),
    "depth alone": ("heave-pitch", {**SMALL, **TURNED, "controller": "L1DepthController"}),
    "current": ("heave-pitch", {**BOTH, "plant.current_velocity": 0.05}),
    "sea": ("hold-jonswap-sea", BOTH),
    "BlueROV2": ("nominal-extended", {**BLUE, **INVERSE}),
    "BlueROV2, dead band": ("nominal-extended", {**BLUE, **LINE}),
    "BlueROV2, lag, pitch": ("nominal-extended", LAGGING),
    "BlueROV2, both axes, waves": ("hold-regular-waves", BLUE_L1),
}  # fmt: skip

# what they add to the vehicle or the law, others have too
CONTAINED = "both axes", "both, limited", "depth alone", "sea", "BlueROV2", "BlueROV2, dead band"


def loop_of(name: str, settings: Settings, stop: float, step: float = 0.02) -> Scenario:
    shipped = scenario.find(name)
    changes = {
        "experiment": {"stop_time": stop, "step_size": step},
        "metrics": dict.fromkeys(scenario.load(shipped).metrics, False),
    }
    steps = {"plant.internal_step": min(step, 0.005), "controller.internal_step": step}
    loaded = scenario.load(shipped, changes, settings={**NOISELESS, **steps, **settings})
    record = ("plant.depth", "plant.pitch", "controller.depth_reference")
    return replace(loaded, experiment=replace(loaded.experiment, record=record))


def law(settings: Settings) -> Any:
    if settings["controller"] == "PidDepthController":
        return Pid
    both = settings["controller"] == "L1HeavePitchController"
    return partial(HeavePitch if both else law_of, kind=LawStep.BETWEEN_MEASUREMENTS)


def rmse(depth: np.ndarray, reference: np.ndarray | float) -> float:
    return math.sqrt(np.mean((depth - reference) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("loop", slow_but(LOOPS.keys() - {*CONTAINED}, LOOPS))
def test_a_second_program_moves_in_heave_and_pitch_alike(built: Fmus, loop: str) -> None:
    """RMSE of the depth, and root of the mean square of the pitch, to 0.5 %; PID has no law to be integrated.

    1e-7 m: a vehicle's own steps of 5 ms here and 2.5 ms there.
    """
    name, settings = LOOPS[loop]
    assert all(built[fmu].is_file() for fmu in (settings["plant"], settings["controller"], "WaveSource"))
    loaded = loop_of(name, settings, stop=10.0)
    own, case = simulate(loaded.system, loaded.experiment), shipped_case(loaded)
    second = run(case, 0.02, law(settings)(case, 0.02), parts=8)
    pitch, reference = second["state"][:, 2], own["controller.depth_reference"]
    assert rmse(own["plant.depth"], reference) == pytest.approx(rmse(second["depth"], reference), rel=5e-4)
    assert rmse(own["plant.pitch"], 0.0) == pytest.approx(rmse(pitch, 0.0), rel=5e-3)
    if settings["controller"] == "PidDepthController":
        np.testing.assert_allclose(own["plant.depth"], second["depth"], rtol=0.0, atol=1e-7)
        np.testing.assert_allclose(own["plant.pitch"], pitch, rtol=0.0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["both axes", "BlueROV2"])
def test_depth_and_pitch_tend_to_those_of_the_continuous_system_with_first_order(
    built: Fmus, loop: str
) -> None:
    """Within 3 % of its root mean square at 20 ms, with a sensor that reads at every time.

    BlueROV2 does not pitch here. Second-order terms are about the step times the loop's 4 rad/s = 8 %.
    """
    name, settings = LOOPS[loop]
    assert all(built[fmu].is_file() for fmu in (settings["plant"], settings["controller"]))
    ideal = {**settings, "plant.sensor_ideal": True, "controller.velocity_source": "measured"}
    errors = list[np.ndarray]()
    limits = np.ones(2)
    for step in (0.02, 0.01):
        loaded = loop_of(name, ideal, 40.0, step)
        own, case = simulate(loaded.system, loaded.experiment), shipped_case(loaded)
        every = slice(None, None, round(0.5 / step))
        law_of_loop = Pid(case, step) if loop == "BlueROV2" else ContinuousHeavePitch(case)
        exact = continuous(case, own.time[every], law_of_loop)
        r = own["controller.depth_reference"][every]
        limits = np.array([rmse(exact[:, 0], r), rmse(exact[:, 2], 0.0)])
        found = np.array([rmse(own["plant.depth"][every], r), rmse(own["plant.pitch"][every], 0.0)])
        errors.append(abs(found - limits))
    moving = limits > 0.0
    assert np.all(errors[0] <= 0.03 * limits)
    orders = np.log2(errors[0][moving] / errors[1][moving])
    assert orders == pytest.approx(np.ones(len(orders)), abs=0.1)
