"""Measurements that need Python in a state of the project: inside.py FUNCTION ARGUMENT...

A function prints, as JSON, rows of one table with their units: numbers, or text that states should share.
"""

import hashlib
import json
import re
import sys
import time
import timeit
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import cycle, pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from orchestration import Experiment, Simulator, System, simulate
from orchestration.scenarios import scenario

Rows = dict[str, float | str]
LAG_STEP = 2.0**-7  # s


def cpu_s(call: Callable[[], object]) -> float:
    start = time.thread_time()
    call()
    return time.thread_time() - start


def run() -> Rows:
    """Measures runs of the nominal scenario and their metrics by turns, as in a sweep."""
    from orchestration.results import metrics

    chosen = scenario.load(scenario.find("nominal-extended"))
    with Simulator(chosen.system) as simulator:
        recording = simulator.run(chosen.experiment)

        def evaluate() -> object:
            return metrics.evaluate(recording, chosen.metrics)

        first = cpu_s(evaluate)
        turns = [(cpu_s(lambda: simulator.run(chosen.experiment)), cpu_s(evaluate)) for _ in range(5)]
    of_run, of_metrics = (1e3 * median(column) for column in zip(*turns, strict=True))
    return {
        "a run of the nominal scenario, ms -> 0.55 of before": of_run,
        "all its metrics, ms -> 0.2 of the run": of_metrics,
        "all its metrics, the first of a process, with what they import, ms": 1e3 * first,
        "its recording": hashlib.sha256(recording.values.tobytes()).hexdigest(),
    }


def ensemble(*sizes: str) -> Rows:
    """Measures a closed-loop step in ensembles, of the instruction sets of this processor, and without."""
    from fmus.platforms import instruction_sets
    from orchestration import Ensemble

    chosen = scenario.load(scenario.find("monte-carlo"))
    experiment = replace(chosen.experiment, record=("plant.depth", "controller.demanded_force"))
    rows: Rows = {}
    with Simulator(chosen.system) as simulator:
        simulator.run(experiment)
        steps = experiment.step_count
        rows["a Simulator, ns"] = 1e9 * cpu_s(lambda: simulator.run(experiment)) / steps
    for kind in instruction_sets():
        with closing(Ensemble(chosen.system, kind)) as instances:
            for size in map(int, sizes):
                inertias = [6.0 + i / size for i in range(size)]
                given = [
                    replace(experiment, parameters={**experiment.parameters, "plant.inertia": inertia})
                    for inertia in inertias
                ]
                taken = cpu_s(lambda: instances.run(given))  # noqa: B023
                goal = " -> 80" if (kind, size) == ("x86-64-v3", 64) else ""
                rows[f"{kind}, {size} at once, ns{goal}"] = 1e9 * taken / (steps * size)
    return rows


def recording(fmu: str, points: str, way: str) -> Rows:
    """Measures what a long run of two FMUs holds at most, less what is held before it."""
    links = [("first.level", "second.signal"), ("second.level", "first.signal")]
    system = System({"first": Path(fmu), "second": Path(fmu)}, links)

    def peak() -> float:
        # what `resource` tells begins with the peak of the process that started this one
        (line,) = re.findall(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.M)
        return 1024.0 * float(line)

    simulate(system, Experiment(1000 * LAG_STEP, LAG_STEP)).write(Path("short.parquet"))  # imports
    before = peak()
    result = simulate(system, Experiment((int(points) - 1) * LAG_STEP, LAG_STEP))
    if way != "run":
        result.write(Path(f"long.{way}"))
    raw = result.values.nbytes + result.time.nbytes
    names = {
        "run": "a run, times its raw size",
        "parquet": "with its Parquet file, times its raw size -> 1.3",
        "csv": "with its CSV file, times its raw size -> constant extra memory",
    }
    return {names[way]: (peak() - before) / raw}


def chain(folder: str, *counts: str) -> Rows:
    """Measures chains of the FMUs in a folder by turns, each driven by the one before; CPU time."""
    fmus, costs, rows = [*Path(folder).iterdir()], [], Rows()
    for count in map(int, ("2", *counts)):  # the first pays for what is imported and compiled
        names = [f"c{i}" for i in range(count)]
        links = [(f"{a}.level", f"{b}.signal") for a, b in pairwise(names)]
        start = time.thread_time()
        with Simulator(System(dict(zip(names, cycle(fmus), strict=False)), links)) as simulator:

            def of_steps(steps: int) -> float:
                chosen = Experiment(steps * LAG_STEP, LAG_STEP, inputs={"c0.signal": 1.0})
                return cpu_s(lambda: simulator.run(chosen))

            of_steps(1)
            first = time.thread_time() - start
            again = of_steps(1)
            costs.append((first - again, again, (of_steps(2000) - again) / 2000))
    files = "each from a file of its own" if len(fmus) > 1 else "of one file"
    kinds = (f"load, {files}", 1e3, "ms"), ("prepare a run again", 1e3, "ms"), ("a step", 1e6, "us")
    for (what, scale, unit), column in zip(kinds, zip(*costs[1:], strict=True), strict=True):
        numbers = [int(count) for count in counts]
        slope, offset = np.polyfit(numbers, column, 1)
        worst = max(abs(slope * n + offset - x) / x for n, x in zip(numbers, column, strict=True))
        rows |= {f"{what}: {n} FMUs, {unit}": scale * x for n, x in zip(numbers, column, strict=True)}
        goal = " -> 2000" if what.endswith("one file") else ""
        rows[f"{what}: one FMU more, us{goal}"] = 1e6 * slope
        rows[f"{what}: the line holds within, %"] = 100.0 * worst
        rows[f"{what}: a thousand FMUs, extrapolated, {unit}"] = scale * (1000.0 * slope + offset)
    return rows


def stepping(repeats: str, *numbers: str) -> Rows:
    """Measures a loop of the caller's own, and environments: the best, as others use the processor too."""
    from orchestration.gym import FmuEnv, FmuVectorEnv
    from orchestration.scenarios.task import task_of

    def best(call: Callable[[], object], calls: int = 500) -> float:
        return min(timeit.repeat(call, number=calls, repeat=int(repeats))) / calls * 1e6

    voltages = ("plant.voltage[1]", "plant.voltage[2]")
    task = task_of("nominal-extended", {"rmse": -1.0}, bounds=dict.fromkeys(voltages, (-6.0, 6.0)))
    long = replace(task.experiment, stop_time=1e4, record=("plant.measured_depth",))
    task = replace(task, experiment=long)
    rows: Rows = {}
    with Simulator(task.system) as simulator:
        run: Any = simulator.start(task.experiment, external=voltages)
        read, write = run.reader("plant.measured_depth"), run.writer(voltages[0])
        step, save = run.step, run.save
        read_by_name = run.read if hasattr(run, "read") else run.get  # of an earlier state
        rows["step, us"] = best(step)
        rows["get one value, set one and step, by a reader and a writer, us"] = best(
            lambda: (write(-0.1 * read()), step())
        )
        state = save()
        rows["restore, us"] = best(lambda: run.restore(state))
        rows["save the whole system, without a step between, us"] = best(save)
        rows["step, and save, us"] = best(lambda: (step(), save()))
        rows["get by name, without a step, us"] = best(lambda: read_by_name("plant.measured_depth"))
        rows["set by name, without a step, us"] = best(lambda: run.set(voltages[0], 0.0))
    with closing(FmuEnv(task)) as env:
        env.reset()
        rows["FmuEnv, steps a second"] = 1e6 / best(lambda: env.step(np.zeros(2)))
    for number in map(int, numbers):
        for way, where in {"simulators": "processor", "ensemble": "vectors"}.items():
            with closing(FmuVectorEnv(task, number, where)) as envs:
                envs.reset()
                taken = best(lambda: envs.step(np.zeros((number, 2))), 100)  # noqa: B023
                rows[f"FmuVectorEnv of {number}, {way}, steps a second"] = number * 1e6 / taken
    return rows


print(json.dumps(globals()[sys.argv[1]](*sys.argv[2:])))
