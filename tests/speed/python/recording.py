"""Memory of a long recording, in either state: FIRST SECOND INPUT OUTPUT STEP_SIZE POINTS WAY FOLDER.

Two FMUs that exchange one signal each way. WAY: run, parquet or csv. Prints what the process holds at most,
less what it held before the run, and the raw size of the recording [bytes].
"""

import re
import sys
from pathlib import Path

from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

first, second, signal, level, step_size, points, way, folder = sys.argv[1:]
links = [(f"first.{level}", f"second.{signal}"), (f"second.{level}", f"first.{signal}")]
system = System({"first": Path(first), "second": Path(second)}, links)


def experiment(steps: int) -> Experiment:
    return Experiment(stop_time=steps * float(step_size), step_size=float(step_size))


def peak() -> float:
    """Of this process alone: what `resource` tells begins with the peak of the process that started it."""
    (line,) = re.findall(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.M)
    return 1024.0 * float(line)


simulate(system, experiment(1000)).write(Path(folder) / "short.parquet")  # what is imported once
before = peak()
recording = simulate(system, experiment(int(points) - 1))
if way != "run":
    recording.write(Path(folder) / f"long.{way}")
print(peak() - before, recording.values.nbytes + recording.time.nbytes)
