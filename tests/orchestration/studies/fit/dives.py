"""A synthetic dive of the shipped vehicle, whose parameters are known."""

import numpy as np

from orchestration import Recording
from orchestration.studies.fit.dive import Dive
from orchestration.system.signals import Table

TRUE = {
    "plant.inertia": 6.2,
    "plant.linear_damping": 4.0,
    "plant.net_weight": -1.1,
    "plant.initial_depth": 3.0,
}
EDGES = np.arange(0.0, 60.0, 4.0)
# 2.3 V hold the net weight
COMMAND = Table(EDGES, 2.3 + np.random.default_rng(0).uniform(-4.0, 4.0, len(EDGES)), hold=True)
COMMANDS = {f"voltage[{i}]": COMMAND for i in (1, 2)}


def as_dive(run: Recording, depths: np.ndarray, name: str = "dive") -> Dive:
    """The depths at every second communication point, as those of a sensor that reads every 40 ms."""
    return Dive(name, COMMANDS, dict.fromkeys(COMMANDS, "V"), run.time[2::2], depths[2::2])
