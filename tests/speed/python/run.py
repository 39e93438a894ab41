"""Runs of a scenario and their metrics, in either state: so many for each number on standard input.

Prints the CPU time [s] of the first metrics of this process; then that of a run with its recording, that of
its metrics, and a hash of the recording. A run and its metrics take turns, as in a sweep.
"""

import hashlib
import sys
import time

from fmus.build import builder
from orchestration.results import metrics
from orchestration.run import Simulator
from orchestration.scenarios import scenario

chosen = scenario.load(scenario.find(sys.argv[1]))
builder.build_missing([*chosen.system.components.values()])
with Simulator(chosen.system) as simulator:
    recording = simulator.run(chosen.experiment)
    start = time.thread_time()
    metrics.evaluate(recording, chosen.metrics)
    print(time.thread_time() - start, flush=True)
    for line in sys.stdin:
        run = evaluation = 0.0
        for _ in range(int(line)):
            start = time.thread_time()
            recording = simulator.run(chosen.experiment)
            middle = time.thread_time()
            metrics.evaluate(recording, chosen.metrics)
            run += (middle - start) / int(line)
            evaluation += (time.thread_time() - middle) / int(line)
        print(run, evaluation, hashlib.sha256(recording.values.tobytes()).hexdigest(), flush=True)
