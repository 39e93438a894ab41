"""A whole scenario in every way in which it can run, down to the same equations as one C program."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fmus.build import builder
from fmus.platforms import host_platform
from fmus.registry import Flavour
from orchestration.errors import OrchestrationError
from orchestration.run import Simulator
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import prepare
from tests.speed.plan import read_result, write_plan
from tests.speed.programs import C_SOURCES, compile_equations, compile_program, output_of, workplace
from tests.speed.states import State

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
    """A whole scenario in each way [s], a value a round, and that of the C programs before.

    The FMUs are loaded before. A run in the master includes all the rest: checks, reset, parameters,
    initialisation, recording. The C programs time the communication loop with its recording alone; what that
    takes in the master is twice the difference of the whole run and one of half the steps.
    """

    scenario: str
    steps: int
    seconds: Mapping[str, Sequence[float]]
    before: Mapping[str, Sequence[float]] = field(default_factory=dict)


def loop(name: str, rounds: int = 7, before: State | None = None) -> Loop:
    """A scenario in every way, by turns; Python FMUs run once.

    Raises OrchestrationError if a host and the one C program do not give the same trajectories.
    """
    native = scenario.load(scenario.find(name))
    python = scenario.load(scenario.find(name), flavour=Flavour.PYTHON)
    builder.build_missing([*native.system.components.values(), *python.system.components.values()])
    with Simulator(python.system) as simulator:
        python_s = _seconds(simulator, python.experiment)
    with workplace() as folder, Simulator(native.system) as simulator:
        own = {"now": _compiled(native, folder / "now", C_SOURCES)}
        if before:
            fmus = {key: before.fmus / path.name for key, path in native.system.components.items()}
            old = replace(native, system=replace(native.system, components=fmus))
            own["before"] = _compiled(old, folder / "before", before.sources / "tests" / "speed" / "c")
        turns = [
            (*_of_master(simulator, native.experiment), *(x for path in own.values() for x in _in_c(path)))
            for _ in range(rounds)
        ]
        for path in own.values():
            _check_equal(path)
    master_s, loop_s, *in_c = zip(*turns, strict=True)
    now = {PYTHON: [python_s], MASTER: master_s, MASTER_LOOP: loop_s, HOST: in_c[0], MONOLITH: in_c[1]}
    steps = len(native.experiment.time_grid()) - 1
    return Loop(name, steps, now, dict(zip((HOST, MONOLITH), in_c[2:], strict=False)))


def _of_master(simulator: Simulator, experiment: Experiment) -> tuple[float, float]:
    """Seconds of a run in the master, and of its loop."""
    steps = len(experiment.time_grid()) - 1
    half = replace(experiment, stop_time=experiment.start_time + steps // 2 * experiment.step_size)
    whole_s, half_s = ([_seconds(simulator, x) for _ in range(_WARM)][-1] for x in (experiment, half))
    return whole_s, 2.0 * (whole_s - half_s)


def _seconds(simulator: Simulator, experiment: Experiment) -> float:
    start = time.perf_counter()
    simulator.run(experiment)
    return time.perf_counter() - start


def _in_c(folder: Path) -> list[float]:
    """Seconds of the C host and of the monolith."""
    programs = ("host", folder / "plan.txt"), ("monolith", "table.bin")
    return [float(output_of(folder, name, given, f"{name}.bin", _WARM)[-1]) for name, given in programs]


def _check_equal(folder: Path) -> None:
    host, monolith = (read_result(folder / f"{way}.bin", folder / "plan.txt") for way in ("host", "monolith"))
    if not np.array_equal(host, monolith):
        raise OrchestrationError("the C host and the monolith differ: expected equal trajectories")


def _compiled(chosen: Scenario, folder: Path, c_sources: Path) -> Path:
    """A folder with the C host and the monolith of a scenario, and the plan that both follow."""
    write_plan(prepare(chosen.system, chosen.experiment), folder, host_platform())
    sources = [folder / name / "sources" for name in chosen.system.components]
    compile_program(folder, "host", [str(C_SOURCES / "host.c")], includes=sources[:1])
    for i, include in enumerate(sources):
        compile_equations(folder, i, include, "-flto", c_sources=c_sources)
    parts = [f"part{i}.o" for i in range(len(sources))]
    compile_program(folder, "monolith", ["-flto", str(C_SOURCES / "monolith.c"), *parts], includes=[folder])
    return folder
