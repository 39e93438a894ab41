"""PathSim with FMUs as blocks; its own steps are the communication steps.

It steps the FMUs one after another, each with what is newest, at the first and the last point too: other
numbers than Jacobi's, and a step more.
"""

from typing import Any

from pathsim import Connection, Simulation
from pathsim_fmi import CoSimulationFMU

from tests.speed.pair import STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    first, second = (CoSimulationFMU(str(path), name, dt=STEP_SIZE) for name, path in pair.fmus.items())
    links = [Connection(first, second), Connection(second, first)]
    simulation = Simulation([first, second], links, dt=STEP_SIZE, log=False)
    duration: Any = steps * STEP_SIZE  # declared as int
    simulation.run(duration)
    return float(first.outputs[0])
