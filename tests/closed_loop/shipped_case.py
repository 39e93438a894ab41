"""A scenario of the vehicle and the L1 controller as the second program takes it."""

from orchestration.scenarios.scenario import Scenario
from tests.closed_loop.same_experiment import component_values, slope
from tests.closed_loop.second_program import L1Case

PIECEWISE = (-0.1, 0.04)  # A_s [1/s] and Ts [s] of the FMU


def shipped_case(loaded: Scenario) -> L1Case:
    """The same experiment for the second program: numbers of the model descriptions and of the scenario."""
    experiment = loaded.experiment
    values, given, signals = component_values(loaded), experiment.parameters, experiment.signals
    second = signals.get("plant.thruster_efficiency[2]", lambda t: 1.0)
    return L1Case(
        plant=values["plant"],
        law=values["controller"],
        augmentation=str(given.get("controller.augmentation", "none")),
        feedforward=str(given.get("controller.reference_feedforward", "none")),
        piecewise=PIECEWISE if "controller.adaptation_law" in given else None,
        reference_rate=slope,
        ideal=bool(given.get("plant.sensor_ideal", False)),
        reference=signals["controller.depth_reference"],
        force=signals.get("plant.external_force", lambda t: 0.0),
        current=signals.get("plant.current_velocity", lambda t: 0.0),
        efficiency=lambda t: 0.5 * (1.0 + second(t)),
        duration=experiment.stop_time,
    )
