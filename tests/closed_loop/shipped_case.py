"""A scenario of the vehicle and the L1 controller as the second program takes it."""

from dataclasses import replace
from functools import cache

from orchestration.run import simulate
from orchestration.scenarios.scenario import Scenario
from tests.closed_loop.same_experiment import component_values, slope
from tests.closed_loop.second_program import L1Case

PIECEWISE = (-0.1, 0.04)  # A_s [1/s] and Ts [s] of the FMU


def shipped_case(loaded: Scenario) -> L1Case:
    """The same experiment for the second program: numbers of the model descriptions and of the scenario."""
    experiment = loaded.experiment
    values, given, signals = component_values(loaded), experiment.parameters, experiment.signals
    first, second = (
        signals.get(f"plant.{name}", lambda t, name=name: values["plant"][name])
        for name in ("thruster_efficiency[1]", "thruster_efficiency[2]")
    )
    return L1Case(
        plant=values["plant"],
        law=values["controller"],
        augmentation=str(given.get("controller.augmentation", "none")),
        feedforward=str(given.get("controller.reference_feedforward", "none")),
        learns_from_all=given.get("controller.input_gain_regressor") == "adaptive_control_and_extension",
        piecewise=PIECEWISE if "controller.adaptation_law" in given else None,
        reference_rate=slope,
        ideal=bool(given.get("plant.sensor_ideal", False)),
        reference=cache(signals["controller.depth_reference"]),  # asked for several times at each time
        force=signals.get("plant.external_force", lambda t: 0.0),
        current=signals.get("plant.current_velocity", lambda t: 0.0),
        efficiency=lambda t: 0.5 * (first(t) + second(t)),
        duration=experiment.stop_time,
    )


def noisy_case(loaded: Scenario) -> L1Case:
    """The same with the noise that the sensor of the scenario has.

    Without rounding, what the sensor reads every 40 ms, two communication steps, is depth and noise.
    """
    experiment = loaded.experiment
    unrounded = {**experiment.parameters, "plant.sensor_resolution": 0.0}
    record = ("plant.depth", "plant.measured_depth")
    run = simulate(loaded.system, replace(experiment, parameters=unrounded, record=record))
    noise = (run["plant.measured_depth"] - run["plant.depth"])[::2]
    return replace(shipped_case(loaded), noise=tuple(noise.tolist()))
