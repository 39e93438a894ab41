"""The rows of all tables: how each is measured in a state of the project.

What a command does once comes before the rounds that count: FMUs of scenarios, compiled loops, bytecode.
"""

import hashlib
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from distributed import get_task_stream

from fmus.fmi.description import describe, of_causality
from fmus.fmi.process import Parent
from fmus.platforms import host_platform
from orchestration import Constant, Experiment, OrchestrationError, Ramps, Simulator, System
from orchestration.scenarios import scenario
from orchestration.system.prepared_run import prepare
from tests.c_programs import compile_c
from tests.importers.comparison import packaged
from tests.importers.importers import IMPORTERS
from tests.importers.plan import HOST, read_result, write_plan
from tests.isolated import answer_of
from tests.local_cluster import local_cluster
from tests.speed.lag import STEP_SIZE
from tests.speed.states import COMMAND, FIVE, HERE, State

NOMINAL = "nominal-extended"
WORKERS = os.cpu_count() or 1
_FEW = 8  # samples: what the command needs to start, and one vector

# table -> "what, unit -> goal" -> number, or text that states should share
Rows = Mapping[str, Mapping[str, float | str]]


@dataclass(frozen=True)
class Measure:
    """Rows of tables that are measured together.

    read: (state, whether all is small) -> rows of tables
    compared: whether an earlier state is measured by turns
    """

    read: Callable[[State, bool], Rows]
    rounds: int = 4
    quick: bool = True
    compared: bool = True


def inside(table: str, function: str, some: Sequence[object], few: Sequence[object], rounds: int) -> Measure:
    """A function of inside.py with some arguments, or with a few where all is small."""
    return Measure(lambda state, quick: {table: state.answer(function, *(few if quick else some))}, rounds)


# what people wait for: (command line, what is said of it, goal [s], whether it is quick)
COMMANDS = (
    (f"run {NOMINAL} --formats none", "recording, metrics, provenance", 0.4, True),
    (f"run {NOMINAL}", "with its figure", 1.0, False),
    ("--help", "", 0.3, True),
    ("reproduce", "with its figures", 5.0, False),
    (f"build {' '.join(FIVE)} --out fmus", "of five FMUs, nothing changed", 0.3, False),
    ("check fmus/L1DepthController.fmu", "of one FMU", 1.5, True),
    ("score PidDepthController", "beside the controllers that ship, all anew", None, False),
    ("tune PidDepthController --free kp=1:100 --evaluations 20 --seeds 1 --restart", "", None, False),
)
FIRST_RUN = """
from orchestration import System, simulate
system = System({"controller": "fmus/L1DepthController.fmu", "plant": "fmus/RovDepthPlant.fmu"}, [
    ("controller.voltage[1]", "plant.voltage[1]"), ("controller.voltage[2]", "plant.voltage[2]"),
    ("plant.measured_depth", "controller.measured_depth")])
simulate(system, stop_time=10.0, step_size=0.02, open_inputs="start")
"""


def command(line: str, remark: str, goal: float | None, is_quick: bool) -> Measure:
    def read(state: State, quick: bool) -> Rows:
        assert state.fmus
        shown = "build" if line.startswith("build") else line.replace("fmus/", "")
        row = f"`l1-depth {shown}`{remark and f', {remark}'}, s{f' -> {goal:g}' if goal else ''}"
        return {"commands": {row: state.cost(*COMMAND, *line.split()).wall_s}}

    return Measure(read, quick=is_quick)


def first_run(state: State, quick: bool) -> Rows:
    assert state.fmus
    row = "`from orchestration import System, simulate`, a first `simulate`, s -> 0.35"
    return {"commands": {row: state.cost(sys.executable, "-P", "-c", FIRST_RUN).wall_s}}


def build_anew(row: str, *options: str) -> Callable[[State, bool], Rows]:
    """A build that finds nothing of its FMUs, but the compiler's own libraries, which another build left."""

    def read(state: State, quick: bool) -> Rows:
        folder = state.folder.parent / "anew"
        caches = {"XDG_CACHE_HOME": str(folder), "ZIG_GLOBAL_CACHE_DIR": str(folder / "zig")}
        kept = state.folder.parent / f"kept{len(options)}"
        build = (*COMMAND, "build", *options, "--out", "../anew/fmus")
        shutil.rmtree(folder, ignore_errors=True)
        if not kept.exists():
            state.cost(*build, "ThrustAllocation", **caches)
            shutil.move(folder / "zig", kept)
            shutil.rmtree(folder)
        shutil.copytree(kept, folder / "zig", symlinks=True)
        return {"commands": {row: state.cost(*build, *FIVE, **caches).wall_s}}

    return read


# the same loop elsewhere, which writes nothing: package, steps, step [s], end [s]
OTHERS = {
    "Ecos": "from ecospy.EcosSimulation import EcosSimulation as S\n"
    "with S(ssp_path={0!r}, step_size={2!r}) as s: s.init(0.0), s.step({1})",
    "libcosim": "from libcosimpy.CosimExecution import CosimExecution as C\n"
    "C.from_ssp_file({0!r}, round({2} * 1e9)).step({1})",
    "FMPy": "from fmpy.ssp.simulation import simulate_ssp\nsimulate_ssp({0!r}, 0.0, {3!r}, {2!r})",
}


def elsewhere(name: str) -> Measure:
    def read(state: State, quick: bool) -> Rows:
        job = packaged(scenario.load(scenario.find(NOMINAL)), state.folder)
        program = OTHERS[name].format(str(job.package), job.reports, job.step_size, job.stop_time)
        row = f"the same loop in {name}, nothing written, s"
        return {"commands": {row: state.cost(sys.executable, "-c", program).wall_s}}

    return Measure(read, compared=False)


SHORT = "[experiment]\nstop_time = 5.0\n[metrics]\nholding_thrust = false\nlag = false\n"
WAYS = {
    f"by default, {WORKERS} workers": (),
    "ensembles, one thread": ("--workers", "1", "--where", "vectors"),
    "simulators, one thread": ("--workers", "1", "--where", "processor"),
    f"simulators, {WORKERS} threads": ("--workers", str(WORKERS), "--where", "processor"),
    f"simulators, {WORKERS} processes": ("--workers", str(WORKERS), "--where", "processes"),
}


def sweep(way: str) -> Measure:
    """A thousand samples of the Monte Carlo, and what a million would take from what one more takes."""

    def read(state: State, quick: bool) -> Rows:
        samples = 50 if quick else 1000
        few, many = (
            state.cost(*COMMAND, "sweep", _scenario(state, count), *WAYS[way], "--restart")
            for count in (_FEW, samples)
        )
        more = (many.cpu_s - few.cpu_s) / (samples - _FEW)
        million_s = 1e6 * (many.wall_s - few.wall_s) / (samples - _FEW)
        clock, cpu = ("", "") if WAYS[way] else (" -> 6", " -> 1.3 times the runs alone, and 2 s")
        rows = {
            f"on the clock, s{clock}": many.wall_s,
            f"CPU, s{cpu}": many.cpu_s,
            "CPU of a sample more, ms": 1e3 * more,
        }
        million = {f"{way}: on these cores, min": million_s / 60.0}
        if "processes" in WAYS[way]:
            million[f"{way}: on 16 cores, from CPU time, min"] = 1e6 * more / 16 / 60.0
        return {"sweeps": {f"{way}: {what}": x for what, x in rows.items()}, "million": million}

    # an earlier state knows the first way alone
    return Measure(read, 3, not WAYS[way], compared=not WAYS[way])


def _scenario(state: State, samples: int, others: str = "") -> str:
    file = state.folder / f"sweep-{samples}.toml"
    file.write_text(f'base = "monte-carlo"\n{others}[sweep]\nsamples = {samples}\n', encoding="utf-8")
    return str(file)


def growing(samples: int) -> Measure:
    """A sweep of many samples of 5 s, each of about a millisecond."""

    def read(state: State, quick: bool) -> Rows:
        count = min(samples, 200) if quick else samples
        spent = state.cost(*COMMAND, "sweep", _scenario(state, count, SHORT), "--restart")
        rows = {
            "peak memory, MB -> flat": spent.peak / 1e6,
            "CPU, s": spent.cpu_s,
            "on the clock, s": spent.wall_s,
        }
        return {"samples": {f"{count} samples: {name}": x for name, x in rows.items()}}

    return Measure(read, 1, samples <= 1000, compared=samples <= 1000)


def on_dask(state: State, quick: bool) -> Rows:
    """What a Dask cluster of this machine loses to scheduling, by its own record of its tasks."""
    samples = 50 if quick else 1000
    parts: dict[str, list[tuple[float, float]]] = {}
    with local_cluster(WORKERS) as (client, _):
        address: Any = client.scheduler
        stream: Any = get_task_stream(client)
        with stream:
            line = "sweep", _scenario(state, samples), "--where", address.address, "--restart"
            state.cost(*COMMAND, *line)
    for task in stream.data:
        computed = [part for part in task["startstops"] if part["action"] == "compute"]
        parts.setdefault(task["worker"], []).extend((part["start"], part["stop"]) for part in computed)
    share = lost([*parts.values()], WORKERS)
    busy = sum(stop - start for own in parts.values() for start, stop in own) / samples
    million = {
        "simulators on Dask: on 128 cores, without the network, min": 1e6 * busy / (1 - share) / 128 / 60
    }
    row = f"{WORKERS} workers of a Dask cluster: lost to scheduling, % -> 10"
    return {"sweeps": {row: 100.0 * share}, "million": million}


def lost(parts: Sequence[Sequence[tuple[float, float]]], workers: int) -> float:
    """Share of the time of so many workers in which they run nothing, once each has run something.

    Until all of them are done: what one waits for the others at the end is lost too.
    parts: of each worker that ran something, (start, end) [s] of what it ran
    """
    start = max(min(end for _, end in own) for own in parts)
    last = max(end for own in parts for _, end in own)
    busy = sum(max(0.0, end - max(begin, start)) for own in parts for begin, end in own)
    return 1.0 - busy / (workers * (last - start))


def in_c(state: State, system: System, experiment: Experiment) -> tuple[float, str]:
    """Seconds of the loop in a host written in C, the fastest of three, and a hash of what it recorded."""
    with tempfile.TemporaryDirectory(dir=state.folder) as name:
        folder = Path(name)
        host = compile_c(HOST, host_platform(), folder)
        plan = write_plan(prepare(system, experiment), folder / "plan", host_platform())
        command = [str(host), str(plan), str(folder / "result"), "3"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise OrchestrationError(f"the host in C failed: {done.stderr.strip()}")
        recorded = hashlib.sha256(read_result(folder / "result", plan).tobytes()).hexdigest()
        return min(map(float, done.stdout.split())), recorded


def nominal_in_c(state: State, quick: bool) -> Rows:
    chosen = scenario.load(scenario.find(NOMINAL))
    fmus = {name: state.fmus / path.name for name, path in chosen.system.components.items()}
    seconds, _ = in_c(state, replace(chosen.system, components=fmus), chosen.experiment)
    return {"runs": {"its communication loop in a host written in C, on the clock, ms": 1e3 * seconds}}


def step_in_c(block: str, goal: str) -> Measure:
    """A communication step of a block in that host: all inputs set, one of them moving, all outputs read."""

    def read(state: State, quick: bool) -> Rows:
        path, count = state.fmus / f"{block}.fmu", 500 if quick else 20_000
        description: Any = describe(path)
        step = float(description.defaultExperiment.stepSize)
        inputs = of_causality(description, "input")
        signals: dict[str, Any] = {f"fmu.{v.name}": Constant(float(v.start or 0.0)) for v in inputs}
        signals[next(iter(signals))] = Ramps([(0.0, 0.0), (count * step, 1.0)])
        experiment = Experiment(count * step, step, signals=signals)
        seconds, recorded = in_c(state, System({"fmu": path}), experiment)
        return {
            "steps": {f"`{block}`, ns -> {goal}": 1e9 * seconds / count, f"outputs of `{block}`": recorded}
        }

    return Measure(read, 15)


def lag(state: State) -> Path:
    """The FMU of lag.py, the same for all states, which this state of the project builds."""
    fmu = state.folder.parent / "lag" / "Lag.fmu"
    if not fmu.exists():
        state.cost(*COMMAND, "build", str(HERE / "lag.py"), "--out", "../lag")
    return fmu


def pair(state: State) -> scenario.Scenario:
    """Two lags that drive each other."""
    file = state.folder / "pair.toml"
    file.write_text(
        'connections = [["first.level", "second.signal"], ["second.level", "first.signal"]]\n'
        f'[components]\nfirst = "{lag(state)}"\nsecond = "{lag(state)}"\n'
        f"[experiment]\nstop_time = 1.0\nstep_size = {STEP_SIZE!r}\n",
        encoding="utf-8",
    )
    return scenario.load(file)


def pair_in_c(state: State, quick: bool) -> Rows:
    steps = 1 << (10 if quick else 18)
    two = pair(state)
    seconds, _ = in_c(state, two.system, replace(two.experiment, stop_time=steps * STEP_SIZE))
    return {"importers": {"a host written in C, records every output, us": 1e6 * seconds / steps}}


def importer(name: str, distribution: str, records: str) -> Measure:
    """A communication step of two lags in an importer, in a process of its own."""

    def read(state: State, quick: bool) -> Rows:
        two = pair(state)
        job = replace(packaged(two, state.folder), outputs=(("first", "level"),))
        answer = answer_of(time_steps, (name, two, job, 0.0 if quick else 0.05), 120.0)
        if isinstance(answer, str):
            raise OrchestrationError(f"{name}: {answer}")
        seconds, steps, level = answer
        check_level(name, level, steps)
        return {"importers": {f"{name} {version(distribution)}, records {records}, us": 1e6 * seconds}}

    return Measure(read, 3, name not in ("libcosim", "fmpy_ssp"), compared=False)


def check_level(name: str, level: float, steps: int) -> None:
    """Raises OrchestrationError unless the level is that of two lags after so many steps."""
    if not math.isclose(level, steps * STEP_SIZE * 0.1, rel_tol=steps * sys.float_info.epsilon):
        raise OrchestrationError(f"{name}: a level of {level!r} after {steps} steps: expected other numbers")


def time_steps(parent: Parent) -> None:
    """Receives (importer, scenario, job, enough); sends (seconds of a step, steps, the level after them).

    The number of steps grows until as many more take `enough` seconds: loading cancels.
    """
    name, two, job, enough = parent.receive()
    os.chdir(tempfile.gettempdir())  # some leave files behind

    def run(steps: int) -> tuple[float, float]:
        start, stop_time = time.perf_counter(), steps * STEP_SIZE
        if name == "this master":
            with Simulator(two.system) as simulator:
                values = simulator.run(replace(two.experiment, stop_time=stop_time))["first.level"]
        else:
            _, reported = IMPORTERS[name].run(replace(job, stop_time=stop_time, report_every=steps))
            values = np.asarray(reported)[:, 0]
        return time.perf_counter() - start, float(values[-1])

    steps = 1 << 10
    run(16)  # what is imported or compiled once is paid for here
    while True:
        (once, _), (twice, level) = run(steps), run(2 * steps)
        if twice - once >= enough or steps >= 1 << 18:
            break
        steps *= 4
    parent.send(((twice - once) / steps, 2 * steps, level))


def many_lags(state: State, quick: bool) -> Rows:
    """Chains of FMUs of one file, and of a file each."""
    folder, numbers = state.folder / "lags", (2, 4) if quick else (25, 50, 100)
    one = lag(state).parent
    if not folder.exists():
        folder.mkdir()
        for i in range(numbers[-1]):
            shutil.copy(one / "Lag.fmu", folder / f"{i}.fmu")
    rows = state.answer("chain", one, *((2, 4) if quick else (50, 100, 200, 400)))
    own = state.answer("chain", folder, *numbers)
    rows |= {row: x for row, x in own.items() if row.startswith("load")}
    return {"scale": {row: x for row, x in rows.items() if " FMUs," not in row or "thousand" in row}}


def memory(way: str) -> Measure:
    def read(state: State, quick: bool) -> Rows:
        points = 100_000 if quick else 10_000_000
        return {"memory": state.answer("recording", lag(state), points, way)}

    return Measure(read, 1)


# part -> its tables, what measures them
PARTS: dict[str, tuple[tuple[str, ...], list[Measure]]] = {
    "commands": (
        ("commands",),
        [
            *(command(*row) for row in COMMANDS),
            Measure(first_run),
            Measure(build_anew("`l1-depth build` of five FMUs, anew, s -> 4")),
            Measure(
                build_anew("`l1-depth build --all-platforms` of them, anew, s -> 15", "--all-platforms"),
                2,
                quick=False,
            ),
            *map(elsewhere, OTHERS),
        ],
    ),
    "runs": (("runs",), [inside("runs", "run", (), (), 12), Measure(nominal_in_c, 7)]),
    "steps": (
        ("steps",),
        [step_in_c("RovDepthPlant", "0.45 of before"), step_in_c("L1DepthController", "0.65 of before")],
    ),
    "sweeps": (("sweeps", "million"), [*map(sweep, WAYS), Measure(on_dask, 1, compared=False)]),
    "samples": (("samples",), [growing(1000), growing(20_000), growing(100_000)]),
    "ensemble": (("ensemble",), [inside("ensemble", "ensemble", (1, 8, 64, 1024), (8,), 5)]),
    "scale": (("scale",), [Measure(many_lags, 3)]),
    "memory": (("memory",), [memory(way) for way in ("run", "parquet", "csv")]),
    "stepping": (("stepping",), [inside("stepping", "stepping", (100, 16, 64), (1, 16), 1)]),
    "importers": (
        ("importers",),
        [
            Measure(pair_in_c, 3, compared=False),
            importer("this master", "l1-depth", "every output"),
            importer("fmucontainer", "fmu-manipulation-toolbox", "nothing"),
            importer("ecos", "ecospy", "nothing"),
            importer("libcosim", "libcosimpy", "nothing"),
            importer("fmpy_ssp", "fmpy", "every connector"),
        ],
    ),
}
