"""A scenario of the vehicle and the L1 controller as the second program takes it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

from orchestration.run import simulate
from orchestration.scenarios.scenario import Scenario
from tests.closed_loop.same_experiment import component_values, slope
from tests.closed_loop.second_loop import STILL, Heave, Water
from tests.closed_loop.second_plane import Plane
from tests.closed_loop.second_program import L1Case

NO_OBSERVER = {"observer_period": 0.04, "observer_alpha": 0.0, "observer_beta": 0.0}  # of ours: ADRC


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
        law={**NO_OBSERVER, **values["controller"]},
        augmentation=str(given.get("controller.augmentation", "pi")),
        pitch_augmentation=str(given.get("controller.pitch_augmentation", "none")),
        priority=str(given.get("controller.priority", "heave")),
        feedforward=str(given.get("controller.reference_feedforward", "none")),
        learns_from_all=given.get("controller.input_gain_regressor") == "adaptive_control_and_extension",
        piecewise=_piecewise(values["controller"]) if "controller.adaptation_law" in given else None,
        reference_rate=slope,
        ideal=bool(given.get("plant.sensor_ideal", False)),
        reference=cache(signals["controller.depth_reference"]),  # asked for several times at each time
        force=signals.get("plant.external_force", lambda t: values["plant"]["external_force"]),
        moment=lambda t: values["plant"].get("external_moment", 0.0),
        current=signals.get("plant.current_velocity", lambda t: values["plant"]["current_velocity"]),
        water=_water(loaded) if "waves" in loaded.system.components else lambda t, depth: STILL,
        efficiency=lambda t: (first(t), second(t)),
        duration=experiment.stop_time,
        body=Plane if "pitch_inertia" in values["plant"] else Heave,
    )


def _piecewise(law: Mapping[str, float]) -> tuple[tuple[float, float], float]:
    """The diagonal of A_s and Ts; the rest of A_s is 0."""
    first, second = (law[f"prediction_error_matrix[{i},{i}]"] for i in (1, 2))
    return (first, second), law["adaptation_period"]


def _water(loaded: Scenario) -> Callable[[float, float], Water]:
    """The waves of the scenario: its numbers, and of a sea the components that its FMU has drawn."""
    parts = ("amplitude", "angular_frequency", "phase")
    names = [f"waves.{part}[{i + 1}]" for i in range(32) for part in parts]
    drawn = simulate(loaded.system, replace(loaded.experiment, stop_time=0.02, record=tuple(names)))
    numbers = [float(drawn[name][0]) for name in names]
    components = list(zip(*(numbers[k::3] for k in range(3)), strict=True))
    given = loaded.experiment.parameters
    if given["waves.kind"] == "regular":
        amplitude, period = (float(given[f"waves.{name}"]) for name in ("wave_amplitude", "period"))
        components = [(amplitude, 2.0 * math.pi / period, 0.0)]

    def water(t: float, depth: float) -> Water:
        below = max(0.0, depth)  # above the mean surface the water moves as at it
        moved = [(a * math.exp(-w * w / 9.81 * below), w, w * t + phase) for a, w, phase in components]
        velocity = sum(a * w * math.sin(angle) for a, w, angle in moved)
        acceleration = sum(a * w * w * math.cos(angle) for a, w, angle in moved)
        return velocity, acceleration, sum(a * math.cos(angle) for a, _, angle in moved)

    return water


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
