"""Runs of the four scenarios of the paper's tables, through the FMUs and by the continuous model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from orchestration.master import Simulator
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.study.depth_loop_model import depth_task, figures, shipped_values
from orchestration.study.open_numbers import K_I, K_P, VALUES

SEEDS = (1, 2, 3, 4, 5)
HOLD = (100.0, 140.0)  # s, at 0.8 m
Figure = tuple[str, str]
"""(scenario, metric)"""
SCENARIOS = tuple(dict.fromkeys(name for name, _ in VALUES))
_EXTENSION = (K_P, K_I)
_CHANGE = "plant.buoyancy_change"


class Runs(Protocol):
    """What gives the figures of all four scenarios, one value for each seed."""

    def figures(self, values: Mapping[str, float], seeds: Sequence[int]) -> dict[Figure, np.ndarray]: ...


class VehicleRuns:
    """The four scenarios of the tables on FMUs that stay loaded; a context manager."""

    def __init__(self) -> None:
        loaded = {name: scenario.load(scenario.find(name)) for name in SCENARIOS}
        declared = loaded[SCENARIOS[0]].metrics
        self._metrics = {name: declared[name] for name in ("settling_time", "rmse", "overshoot")}
        self._experiments = {
            name: replace(chosen.experiment, record=("plant.depth", "controller.depth_reference"))
            for name, chosen in loaded.items()
        }
        self._simulator = Simulator(loaded[SCENARIOS[0]].system)

    def __enter__(self) -> "VehicleRuns":
        return self

    def __exit__(self, *error: object) -> None:
        self._simulator.close()

    def one(self, name: str, values: Mapping[str, float], seed: int = 1) -> dict[str, float]:
        """Settling time, RMSE, overshoot and spread of depth in hold [mm] of one run.

        values: of parameters, and of the buoyancy change, which counts in the scenarios of that name
        """
        before, values = self._experiments[name], dict(values)
        inputs, change = dict(before.inputs), values.pop(_CHANGE, None)
        if name.startswith("buoyancy") and change is not None:
            inputs[_CHANGE] = float(change)
        parameters = {**before.parameters, **values, "plant.sensor_seed": seed}
        recording = self._simulator.run(replace(before, inputs=inputs, parameters=parameters))
        return metrics.evaluate(recording, self._metrics) | {"hold_spread": hold_spread(recording)}

    def figures(self, values: Mapping[str, float], seeds: Sequence[int] = SEEDS) -> dict[Figure, np.ndarray]:
        """The same of all four scenarios, one value for each seed."""
        return {
            (name, metric): np.array([run[metric] for run in runs])
            for name in SCENARIOS
            for runs in [[self.one(name, values, seed) for seed in seeds]]
            for metric in runs[0]
        }


class ModelRuns:
    """The same of the continuous model, which needs no seeds and rests in the hold: for a first approach."""

    def figures(self, values: Mapping[str, float], seeds: Sequence[int] = SEEDS) -> dict[Figure, np.ndarray]:
        plain = dict.fromkeys(_EXTENSION, 0.0)
        changes = {name: shipped_values(name)[_CHANGE] for name in SCENARIOS}
        runs = [
            {**values, _CHANGE: changes[name], **(plain if name.endswith("-l1") else {})}
            for name in SCENARIOS
        ]
        measured = figures(depth_task(), {key: np.array([run[key] for run in runs]) for key in runs[0]})
        measured["hold_spread"] = np.zeros(len(SCENARIOS))
        return {
            (name, metric): column[i : i + 1]
            for i, name in enumerate(SCENARIOS)
            for metric, column in measured.items()
        }


def hold_spread(recording: Recording) -> float:
    """Standard deviation of the depth in the hold at 0.8 m [mm]."""
    held = (recording.time >= HOLD[0]) & (recording.time <= HOLD[1])
    return 1e3 * float(np.std(recording["plant.depth"][held]))
