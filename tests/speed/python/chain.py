"""A chain of the FMUs in a folder by turns, in either state: FOLDER INPUT OUTPUT STEP_SIZE COUNT.

Each is driven by the one before. Prints CPU time [s] to load the chain, to prepare a run of it again, and of
a communication step.
"""

import sys
import time
from itertools import cycle, pairwise
from pathlib import Path

from orchestration.run import Simulator
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

STEPS = 2000


def seconds(simulator: Simulator, steps: int) -> float:
    start = time.thread_time()
    simulator.run(Experiment(steps * step_size, step_size, inputs={f"c0.{signal}": 1.0}))
    return time.thread_time() - start


fmus, signal, level = [*Path(sys.argv[1]).iterdir()], sys.argv[2], sys.argv[3]
step_size, names = float(sys.argv[4]), [f"c{i}" for i in range(int(sys.argv[5]))]
links = [(f"{a}.{level}", f"{b}.{signal}") for a, b in pairwise(names)]
start = time.thread_time()
with Simulator(System(dict(zip(names, cycle(fmus), strict=False)), links)) as simulator:
    seconds(simulator, 1)
    first = time.thread_time() - start
    again = seconds(simulator, 1)
    print(first - again, again, (seconds(simulator, STEPS) - again) / STEPS)
