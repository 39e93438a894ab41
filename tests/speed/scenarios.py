"""A whole scenario in every way in which it can run, down to the same equations as one C program."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
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
from tests.speed import monolith
from tests.speed.plan import read_result, write_plan
from tests.speed.programs import C_SOURCES, compile_equations, compile_program, output_of, workplace


@dataclass(frozen=True)
class Loop:
    """A whole scenario [s]: in this project's master by flavour, in a C host, and as one C program.

    The FMUs are loaded before. A run in the master includes all the rest: checks, reset, parameters,
    initialisation, recording. The C programs time the communication loop with its recording alone; what that
    takes in the master is twice the difference of the whole run and one of half the steps.
    """

    scenario: str
    steps: int
    master_python: float
    master_native: float
    master_loop: float
    host: float
    monolith: float

    @property
    def ways(self) -> dict[str, float]:
        """Seconds of each way in which the scenario was run."""
        return {
            "python FMUs, this master": self.master_python,
            "native FMUs, this master": self.master_native,
            "native FMUs, its loop alone": self.master_loop,
            "native FMUs, a host in C": self.host,
            "the same equations, one C program": self.monolith,
        }


def loop(name: str, rounds: int = 7) -> Loop:
    """A scenario in every way, medians over rounds; Python FMUs run once.

    Raises OrchestrationError if the host and the one C program do not give the same trajectories.
    """
    native = scenario.load(scenario.find(name))
    python = scenario.load(scenario.find(name), flavour=Flavour.PYTHON)
    catalogue.build_missing([*native.system.components.values(), *python.system.components.values()])
    (by_python,) = _in_the_master(python, 1)
    with workplace() as folder:
        _compile(native, folder)
        with Simulator(native.system) as simulator:
            simulator.run(native.experiment)  # loads
            taken = [
                (*_of_the_master(simulator, native.experiment), *_programs(folder)) for _ in range(rounds)
            ]
        _check_agreement(name, folder)
    master, half, host, single = (median(each) for each in zip(*taken, strict=True))
    alone = 2.0 * (master - half)
    return Loop(name, len(native.experiment.time_grid()) - 1, by_python, master, alone, host, single)


def _in_the_master(chosen: Scenario, rounds: int) -> list[float]:
    with Simulator(chosen.system) as simulator:
        return [_timed(lambda: simulator.run(chosen.experiment)) for _ in range(rounds)]


def _of_the_master(simulator: Simulator, experiment: Experiment) -> tuple[float, float]:
    """Seconds of a run, and of one of half the steps; each the last of some, as of the C programs."""
    steps = len(experiment.time_grid()) - 1
    half = replace(experiment, stop_time=experiment.start_time + steps // 2 * experiment.step_size)
    whole_s, half_s = (
        [_timed(partial(simulator.run, each)) for _ in range(_WARM)][-1] for each in (experiment, half)
    )
    return whole_s, half_s


def _compile(chosen: Scenario, folder: Path) -> None:
    """The C host and the monolith of a scenario, with the plan that both follow."""
    plan = write_plan(prepare(chosen.system, chosen.experiment), folder, host_platform())
    sources = [folder / name / "sources" for name in chosen.system.components]
    compile_program(folder, "host", [str(C_SOURCES / "host.c")], includes=sources[:1])
    (folder / "main.c").write_text(monolith.program(plan), encoding="utf-8")
    for i, include in enumerate(sources):
        compile_equations(folder, i, include, "-flto")
    parts = [f"part{i}.o" for i in range(len(sources))]
    compile_program(folder, "monolith", ["-flto", "main.c", *parts], includes=[])


_WARM = 3  # runs in one process, of which the last counts


def _programs(folder: Path) -> tuple[float, float]:
    """Seconds of the C host and of the monolith."""
    host = output_of(folder, "host", folder / "plan.txt", "host.bin", _WARM)
    single = output_of(folder, "monolith", "table.bin", "monolith.bin", _WARM)
    return float(host[-1]), float(single[-1])


def _check_agreement(name: str, folder: Path) -> None:
    plan = folder / "plan.txt"
    if not np.array_equal(read_result(folder / "host.bin", plan), read_result(folder / "monolith.bin", plan)):
        raise OrchestrationError(f"{name}: the C host and the monolith differ: expected equal trajectories")


def _timed(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start
