"""The numbers of an experiment, for programs that run it without our FMUs, and the figures of its runs."""

import math
from typing import Any

import numpy as np

from fmus.fmi.description import describe
from orchestration.scenarios.scenario import Scenario

# of the sensor, what no other program can repeat: noise, and rounding to a resolution
SMOOTH = {"plant.sensor_noise": 0.0, "plant.sensor_resolution": 0.0}
KINDS, BOOLEANS = ("Real", "Boolean"), {"true": 1.0, "false": 0.0}


def component_values(loaded: Scenario) -> dict[str, dict[str, float]]:
    """Component -> name -> number, of the scenario and else of its model description."""
    given: dict[str, Any] = {**loaded.experiment.parameters, **loaded.experiment.inputs}
    values: dict[str, dict[str, float]] = {}
    for component, fmu in loaded.system.components.items():
        starts: dict[str, Any] = {v.name: v.start for v in describe(fmu).modelVariables if v.type in KINDS}
        own = {name: given.get(f"{component}.{name}", start) for name, start in starts.items()}
        numbers = {name: BOOLEANS.get(value, value) for name, value in own.items()}
        values[component] = {name: float(value) for name, value in numbers.items() if value is not None}
    return values


def slope(t: float) -> float:
    """r' [m/s] of the paper's trajectory, from t on."""
    ramps = ((0.0, 40.0, 0.8 / 40.0), (140.0, 180.0, -0.4 / 40.0), (250.0, 310.0, 0.2 / 60.0))
    return next((rate for start, end, rate in ramps if start - 1e-9 <= t < end - 1e-9), 0.0)


def figures(time: np.ndarray, depth: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """RMSE [m] of the run; settling time [s] to 5 % of 0.8 m, before the reference leaves it at 140 s."""
    outside = time[(time <= 140.0) & ~(abs(depth - 0.8) <= 0.04)]
    return math.sqrt(np.mean((depth - reference) ** 2)), float(outside[-1])
