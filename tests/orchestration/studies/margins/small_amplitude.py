"""Runs at small amplitude: the delay of the control that the FMUs bear."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from orchestration.run.simulator import Simulator
from orchestration.scenarios.scenario import Scenario
from orchestration.system.faults import Fault, InterpolatedDelay
from orchestration.system.signals import Table

PULSE = Table([0.0, 1.0, 2.0], [0.0, 1e-5, 0.0], hold=True)  # N
VOLTAGES = ("plant.voltage[1]", "plant.voltage[2]")


def largest_delay(loaded: Scenario, near: float) -> float:
    """The delay of the control [s] at which an oscillation neither grows nor decays, within 5 % of one."""
    begins = 0.25 * loaded.experiment.stop_time, 0.75 * loaded.experiment.stop_time
    with Simulator(loaded.system) as simulator:

        def growth(delay: float) -> float:
            """Of the oscillation, per second; a difference over 0.4 s leaves what is slow out."""
            faults = tuple(Fault(name, InterpolatedDelay(delay)) for name in VOLTAGES)
            run = simulator.run(replace(loaded.experiment, faults=faults))
            lag = round(0.4 / loaded.experiment.step_size)
            fast, time = run["plant.depth"][lag:] - run["plant.depth"][:-lag], run.time[lag:]
            early, late = (np.std(fast[(time > begin) & (time < begin + 20.0)]) for begin in begins)
            assert late < 1e-3  # m: quadratic damping is 0.1 % of the linear one below
            return math.log(late / early) / (begins[1] - begins[0])

        root: Any = brentq(growth, 0.95 * near, 1.05 * near, xtol=5e-4)
        return float(root)
