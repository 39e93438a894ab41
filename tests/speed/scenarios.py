"""A whole scenario in every way in which it can run, down to the same equations as one C program."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from fmus import catalogue
from fmus.platforms import host_platform
from fmus.registry import Flavour
from orchestration.errors import OrchestrationError
from orchestration.master import Simulator
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import prepare
from tests.speed.plan import read_result, write_plan
from tests.speed.programs import C_SOURCES, compile_equations, compile_program, output_of, workplace

PYTHON, MASTER, MASTER_LOOP, HOST, MONOLITH = (
    "python FMUs in this master",
    "native FMUs in this master: reset, parameters, initialisation, recording",
    "of that, its communication loop with recording",
    "native FMUs in a host written in C, communication loop",
    "the same equations as one C program, loop",
)
_WARM = 3  # runs in one process, of which the last counts


@dataclass(frozen=True)
class Loop:
    """A whole scenario in each way [s].

    The FMUs are loaded before. A run in the master includes all the rest: checks, reset, parameters,
    initialisation, recording. The C programs time the communication loop with its recording alone; what that
    takes in the master is twice the difference of the whole run and one of half the steps.
    """

    scenario: str
    steps: int
    seconds: dict[str, float]


def loop(name: str, rounds: int = 7) -> Loop:
    """A scenario in every way, medians over rounds; Python FMUs run once.

    Raises OrchestrationError if the host and the one C program do not give the same trajectories.
    """
    native = scenario.load(scenario.find(name))
    python = scenario.load(scenario.find(name), flavour=Flavour.PYTHON)
    catalogue.build_missing([*native.system.components.values(), *python.system.components.values()])
    with Simulator(python.system) as simulator:
        python_s = _seconds(simulator, python.experiment)
    with workplace() as folder:
        _compile(native, folder)
        master_s, half_s, host_s, monolith_s = _medians(native, folder, rounds)
        plan = folder / "plan.txt"
        of_host, of_monolith = (read_result(folder / f"{way}.bin", plan) for way in ("host", "monolith"))
    if not np.array_equal(of_host, of_monolith):
        raise OrchestrationError(f"{name}: the C host and the monolith differ: expected equal trajectories")
    in_c = {HOST: host_s, MONOLITH: monolith_s}
    seconds = {PYTHON: python_s, MASTER: master_s, MASTER_LOOP: 2.0 * (master_s - half_s), **in_c}
    return Loop(name, len(native.experiment.time_grid()) - 1, seconds)


def _medians(chosen: Scenario, folder: Path, rounds: int) -> list[float]:
    """Seconds of a run in the master, of one of half the steps, of the C host and of the monolith."""
    experiment = chosen.experiment
    steps = len(experiment.time_grid()) - 1
    half = replace(experiment, stop_time=experiment.start_time + steps // 2 * experiment.step_size)
    with Simulator(chosen.system) as simulator:
        taken = [
            (
                [_seconds(simulator, experiment) for _ in range(_WARM)][-1],
                [_seconds(simulator, half) for _ in range(_WARM)][-1],
                float(output_of(folder, "host", folder / "plan.txt", "host.bin", _WARM)[-1]),
                float(output_of(folder, "monolith", "table.bin", "monolith.bin", _WARM)[-1]),
            )
            for _ in range(rounds)
        ]
    return [median(column) for column in zip(*taken, strict=True)]


def _seconds(simulator: Simulator, experiment: Experiment) -> float:
    start = time.perf_counter()
    simulator.run(experiment)
    return time.perf_counter() - start


def _compile(chosen: Scenario, folder: Path) -> None:
    """The C host and the monolith of a scenario, with the plan that both follow."""
    write_plan(prepare(chosen.system, chosen.experiment), folder, host_platform())
    sources = [folder / name / "sources" for name in chosen.system.components]
    compile_program(folder, "host", [str(C_SOURCES / "host.c")], includes=sources[:1])
    for i, include in enumerate(sources):
        compile_equations(folder, i, include, "-flto")
    parts = [f"part{i}.o" for i in range(len(sources))]
    compile_program(folder, "monolith", ["-flto", str(C_SOURCES / "monolith.c"), *parts], includes=[folder])
