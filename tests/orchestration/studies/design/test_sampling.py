"""The designed adaptation gain is as large as the sampling allows: responses to a step of force, by runs."""

from dataclasses import replace

import numpy as np
import pytest

from orchestration.many.run_many import run_many
from orchestration.scenarios import scenario
from orchestration.scenarios.changes import with_values
from orchestration.studies.design.parameter_file import l1_gains
from orchestration.studies.design.rules import Conditions, L1Design
from orchestration.studies.design.vehicle_data import VehicleData

QUIET = {  # a vehicle and a sensor without noise, whose response is linear but for the quadratic damping
    "plant.sensor_noise": 0.0,
    "plant.sensor_resolution": 0.0,
    "plant.net_weight": 0.0,
    "plant.initial_depth": 0.8,
    "plant.external_force": 1.0,
    "controller.depth_reference": 0.8,
    "experiment.stop_time": 30.0,
}


def responses(gains: dict[str, float]) -> list[np.ndarray]:
    """The way of the depth [m] every 20 ms, at steps of 20 and 10 ms."""
    chosen = scenario.load(scenario.find("nominal-l1"))
    experiments = []
    for step in (0.02, 0.01):
        steps = {"experiment.step_size": step, "plant.internal_step": step, "controller.internal_step": step}
        changed = with_values(chosen.experiment, {**QUIET, **gains, **steps})
        experiments.append(replace(changed, record=("plant.depth",)))
    coarse, fine = (run["plant.depth"] - 0.8 for run in run_many(chosen.system, experiments))
    return [coarse, fine[::2]]


def change(gains: dict[str, float]) -> float:
    coarse, fine = responses(gains)
    return float(np.abs(coarse - fine).max() / np.abs(fine).max())


@pytest.mark.parametrize(("turns", "is_accurate"), [(0.25, True), (0.5, False)])
def test_half_the_step_changes_the_response_by_less_than_3_per_cent(
    l1: L1Design, data: VehicleData, conditions: Conditions, turns: float, is_accurate: bool
) -> None:
    """Half of a turn in a sample is beyond the limit: the fast loop aliases with the samples."""
    gain = l1.adaptation_gain * (turns / 0.25) ** 2
    made = l1_gains(replace(l1, adaptation_gain=gain), data, conditions)
    gains = {f"controller.{one.name}": one.value for one in made} | {"controller.sigma_bound": 10.0}
    assert (change(gains) < 0.03) is is_accurate
