"""What an importer does, and what it returns."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class ImporterJob:
    """Run a package from its start to its stop time and report one output.

    parameter_set: name of the set that the package binds
    output: "component.variable"
    start_time, stop_time, step_size: s
    """

    package: Path
    parameter_set: str
    output: str
    start_time: float
    stop_time: float
    step_size: float

    @property
    def steps(self) -> int:
        return round((self.stop_time - self.start_time) / self.step_size)


@dataclass(frozen=True)
class Trajectory:
    """Values of the output at the importer's times [s]."""

    time: np.ndarray
    values: np.ndarray
