"""The pair in each importer: the first level after so many steps, and how long that takes.

Each loop does it as its importer's documentation says, with what that offers to be fast, and records only if
it cannot do without.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from ctypes import c_double, c_int, c_size_t, c_uint32, c_void_p
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from fmpy.fmi2 import FMU2Slave

from fmus.fmi.process import Parent
from orchestration.run import Simulator
from tests.importers.importers import IMPORTERS, ImporterJob, loaded_by_fmpy
from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, Pair

_MOST_STEPS = 1 << 18
_GROWTH = 4
_REPEATS = 3


def ours(pair: Pair, steps: int, compiled: bool = True) -> float:
    with Simulator(pair.system, compiled) as simulator:
        recording = simulator.run(pair.experiment(steps))
    return float(recording[f"first.{LEVEL}"][-1])


def ours_plain(pair: Pair, steps: int) -> float:
    return ours(pair, steps, compiled=False)


def by_package(importer: str) -> Callable[[Pair, int], float]:
    """The loop of one of `tests.importers`, asked for all steps at once."""

    def run(pair: Pair, steps: int) -> float:
        times = 0.0, steps * STEP_SIZE, STEP_SIZE
        job = ImporterJob(pair.package, f"first.{LEVEL}", *times, report_every=steps)
        _, values = IMPORTERS[importer].run(job)
        return float(values[-1])  # pyright: ignore[reportIndexIssue, reportArgumentType]

    return run


@contextmanager
def _instances(pair: Pair) -> Iterator[tuple[FMU2Slave, FMU2Slave, int, int]]:
    """Both FMUs loaded by FMPy, ready to step, and the value references of input and output."""
    with ExitStack() as stack:
        instances = []
        for path in pair.fmus.values():
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            instances.append(instance := loaded_by_fmpy(path, Path(folder)))
            stack.callback(instance.freeInstance)
            instance.setupExperiment(startTime=0.0)
            instance.enterInitializationMode()
            instance.exitInitializationMode()
        first, second = instances
        yield first, second, *pair.references


def fmpy_slave(pair: Pair, steps: int) -> float:
    """FMPy's `FMU2Slave` in a Python loop."""
    with _instances(pair) as (first, second, signal, level):
        (of_first,), (of_second,) = first.getReal([level]), second.getReal([level])
        for i in range(steps):
            first.setReal([signal], [of_second])
            second.setReal([signal], [of_first])
            first.doStep(i * STEP_SIZE, STEP_SIZE)
            second.doStep(i * STEP_SIZE, STEP_SIZE)
            (of_first,), (of_second,) = first.getReal([level]), second.getReal([level])
        return of_first


def prebound_ctypes(pair: Pair, steps: int) -> float:
    """The FMUs' functions called from Python with arguments that are bound before the loop."""
    with _instances(pair) as (first, second, signal, level):
        a, b = (c_void_p(int(instance.component or 0)) for instance in (first, second))
        inputs, outputs, one = (c_uint32 * 1)(signal), (c_uint32 * 1)(level), c_size_t(1)
        of_a, of_b = (c_double * 1)(), (c_double * 1)()
        h, never_back = c_double(STEP_SIZE), c_int(1)
        set_a, set_b = first.dll.fmi2SetReal, second.dll.fmi2SetReal
        get_a, get_b = first.dll.fmi2GetReal, second.dll.fmi2GetReal
        step_a, step_b = first.dll.fmi2DoStep, second.dll.fmi2DoStep
        bad = get_a(a, outputs, one, of_a) | get_b(b, outputs, one, of_b)
        for i in range(steps):
            t = c_double(i * STEP_SIZE)
            bad |= set_a(a, inputs, one, of_b) | set_b(b, inputs, one, of_a)
            bad |= step_a(a, t, h, never_back) | step_b(b, t, h, never_back)
            bad |= get_a(a, outputs, one, of_a) | get_b(b, outputs, one, of_b)
        if bad:
            raise RuntimeError("a call was refused")
        return of_a[0]


def pathsim(pair: Pair, steps: int) -> float:
    """PathSim with FMUs as blocks; its own steps are the communication steps.

    It steps the FMUs one after another, each with what is newest, at the first and the last point too: other
    numbers than Jacobi's, and a step more.
    """
    from pathsim import Connection, Simulation
    from pathsim_fmi import CoSimulationFMU

    first, second = (CoSimulationFMU(str(path), name, dt=STEP_SIZE) for name, path in pair.fmus.items())
    links = [Connection(first, second), Connection(second, first)]
    duration: Any = steps * STEP_SIZE  # declared as int
    Simulation([first, second], links, dt=STEP_SIZE, log=False).run(duration)
    return float(first.outputs[0])


def sofirpy(pair: Pair, steps: int) -> float:
    """SOFiRpy's `simulate`, one row recorded at the end."""
    from sofirpy import simulate

    def link(source: str) -> list[dict[str, str]]:
        return [
            {"parameter_name": SIGNAL, "connect_to_system": source, "connect_to_external_parameter": LEVEL}
        ]

    stop_time = steps * STEP_SIZE
    links: Any = {"first": link("second"), "second": link("first")}
    result = simulate(
        stop_time,
        STEP_SIZE,
        fmu_paths=pair.fmus,
        connections_config=links,
        parameters_to_log={"first": [LEVEL]},
        logging_step_size=stop_time,
    )
    return float(result[f"first.{LEVEL}"].iloc[-1])


@dataclass(frozen=True)
class Loop:
    """What runs the pair: its name, its function, the distribution it needs, what it records."""

    name: str
    run: Callable[[Pair, int], float]
    distribution: str
    records: str = "nothing"


LOOPS = {
    "ours": Loop("this master", ours, "l1-depth", "every output"),
    "ours_plain": Loop("this master, its loop in Python", ours_plain, "l1-depth", "every output"),
    "prebound_ctypes": Loop("ctypes bound before the loop", prebound_ctypes, "fmpy"),
    "fmpy_slave": Loop("FMPy's FMU2Slave in a loop", fmpy_slave, "fmpy"),
    "fmpy_ssp": Loop("fmpy.ssp", by_package("fmpy_ssp"), "fmpy", "every connector"),
    "libcosim": Loop("libcosim", by_package("libcosim"), "libcosimpy"),
    "ecos": Loop("Ecos", by_package("ecos"), "ecospy"),
    "fmucontainer": Loop("fmucontainer", by_package("fmucontainer"), "fmu-manipulation-toolbox"),
    "pathsim": Loop("PathSim-FMI", pathsim, "pathsim-fmi"),
    "sofirpy": Loop("SOFiRpy", sofirpy, "sofirpy"),
}


@dataclass(frozen=True)
class Measurement:
    """What one process measured: seconds of `steps` and of twice as many, and the first level after each."""

    steps: int
    seconds: tuple[float, float]
    levels: tuple[float, float]

    @property
    def per_step(self) -> float:
        return (self.seconds[1] - self.seconds[0]) / self.steps


def measure_loop(parent: Parent) -> None:
    """Measure what is sent: (loop, pair, enough); send the `Measurement`.

    The number of steps grows until as many more take `enough` seconds, or are many.
    """
    name, pair, enough = parent.receive()
    os.chdir(tempfile.gettempdir())  # some leave files behind
    run = LOOPS[name].run
    steps = 1 << 10
    run(pair, 16)  # what is imported or compiled once is paid for here
    while True:
        single, double = _timed(run, pair, steps), _timed(run, pair, 2 * steps)
        if double[0] - single[0] >= enough or steps >= _MOST_STEPS:
            break
        steps *= _GROWTH
    repeated = [(single, double)]
    repeated += [(_timed(run, pair, steps), _timed(run, pair, 2 * steps)) for _ in range(_REPEATS - 1)]
    seconds = median(once[0] for once, _ in repeated), median(twice[0] for _, twice in repeated)
    parent.send(Measurement(steps, seconds, (single[1], double[1])))


def _timed(run: Callable[[Pair, int], float], pair: Pair, steps: int) -> tuple[float, float]:
    start = time.perf_counter()
    level = run(pair, steps)
    return time.perf_counter() - start, level
