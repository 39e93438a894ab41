"""Runs of a scenario and their metrics, in either state: so many for each number on standard input.

Prints CPU time [s] of a run with its recording, that of its metrics, and a hash of the recording.
"""

import hashlib
import sys
import time

from fmus import catalogue
from orchestration.master import Simulator
from orchestration.results import metrics
from orchestration.scenarios import scenario

chosen = scenario.load(scenario.find(sys.argv[1]))
catalogue.build_missing([*chosen.system.components.values()])
with Simulator(chosen.system) as simulator:
    recording = simulator.run(chosen.experiment)
    metrics.evaluate(recording, chosen.metrics)
    print("ready", flush=True)
    for line in sys.stdin:
        start = time.thread_time()
        for _ in range(int(line)):
            recording = simulator.run(chosen.experiment)
        middle = time.thread_time()
        for _ in range(int(line)):
            metrics.evaluate(recording, chosen.metrics)
        end = time.thread_time()
        run, evaluation = (middle - start) / int(line), (end - middle) / int(line)
        print(run, evaluation, hashlib.sha256(recording.values.tobytes()).hexdigest(), flush=True)
