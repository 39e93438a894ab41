"""The overhead of a communication step, in this master and in every importer that is installed.

Every importer runs the two FMUs of pair.py in a process of its own, N and 2 N steps: the difference is N
steps without the cost of loading. A C program that only calls the FMUs' functions gives the time that these
need themselves, and the values that must come out.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from statistics import median

import fmpy

from fmus.platforms import host_platform, library_name
from orchestration.fmi.description import describe
from tests.isolated import answer_of
from tests.speed import pair as pair_module
from tests.speed.loops.worker import measure_loop
from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, Pair
from tests.speed.programs import C_SOURCES, compile_program, output_of, workplace

FLOOR = "a bare C loop"


@dataclass(frozen=True)
class Runner:
    """What can run the pair: its name, the distribution it comes from, what it records in the comparison."""

    name: str
    distribution: str
    records: str


# by module of tests.speed.loops
LOOPS = {
    "ours": Runner("this master", "l1-depth", "every output"),
    "ours_plain": Runner("this master, its loop in Python", "l1-depth", "every output"),
    "prebound_ctypes": Runner("ctypes bound before the loop", "fmpy", "nothing"),
    "fmpy_slave": Runner("FMPy's FMU2Slave in a loop", "fmpy", "nothing"),
    "fmpy_ssp": Runner("fmpy.ssp", "fmpy", "every connector"),
    "libcosim": Runner("libcosim", "libcosimpy", "nothing"),
    "ecos": Runner("Ecos", "ecospy", "nothing"),
    "fmucontainer": Runner("fmucontainer", "fmu-manipulation-toolbox", "nothing"),
    "pathsim": Runner("PathSim-FMI", "pathsim-fmi", "nothing"),
    "sofirpy": Runner("SOFiRpy", "sofirpy", "nothing"),
}
# what pip does not install beside this project, or what cannot run these FMUs: as of November 2026
UNSUPPORTED = {
    "PyFMI": "2.5 on PyPI is source of 2018 whose set-up needs NumPy without declaring it",
    "OMSimulator": "3.0.0.post198 on PyPI downloads the engine from another server when it is installed",
    "FMI++, mosaik-fmi": "2.1.0 on PyPI is source that needs SWIG",
    "CoFmuPy": "1.0.0 wants FMPy 0.3.20 and PythonFMU 0.6.3, this project later ones",
    "energysim": "2.1.9.1 wants FMPy 0.2.14, this project a later one",
    "syssimx": "0.4.3 begins with a step of zero length, which FMI 2.0 forbids and these FMUs refuse",
    "PyCosimLibrary": "0.0.5 takes it for a failure that FMPy's doStep returns no status any more",
}
_ENOUGH_S = 0.05  # far more than what loading varies by
_LONGEST_S = 120.0
_CLOSE = 1e-12  # relative; rounding, where an importer adds up times
_NEAR = 1e-2  # relative; another algorithm of first order, but the same work


@dataclass(frozen=True)
class Entry:
    """One way to run the pair. Times of a communication step [s].

    floor: the time in which a bare C loop calls the same functions
    remark: what is recorded, and what else is to be known
    problem: why there are no times
    """

    name: str
    version: str = ""
    per_step: float = math.inf
    floor: float = math.nan
    remark: str = ""
    problem: str = ""

    @property
    def overhead(self) -> float:
        return self.per_step - self.floor

    @property
    def ratio(self) -> float:
        return self.per_step / self.floor


@dataclass(frozen=True)
class Measurement:
    """What one process measured: seconds of `steps` and of twice as many, and the first level after each."""

    steps: int
    seconds: tuple[float, float]
    levels: tuple[float, float]

    @property
    def per_step(self) -> float:
        return (self.seconds[1] - self.seconds[0]) / self.steps


def compare(
    rounds: int = 3, loops: Iterable[str] = LOOPS, progress: Callable[[], object] = lambda: None
) -> list[Entry]:
    """Every loop, medians over rounds in which all take turns; then what cannot run here.

    progress: called after each measurement.
    """
    with workplace() as folder:
        built = pair_module.build(folder)
        bare = Bare(built)
        measurements: dict[str, list[Measurement | str]] = {name: [] for name in loops}
        floors = []
        for _ in range(rounds):
            floors.append(bare.per_step())
            for name, own in measurements.items():
                if not own or isinstance(own[-1], Measurement):
                    own.append(measure(name, built))
                progress()
        floor = median(floors)
        entries = [entry(name, own, bare.level, floor) for name, own in measurements.items()]
    missing = [Entry(name, problem=why) for name, why in UNSUPPORTED.items()]
    return [Entry(FLOOR, "", floor, floor, "records nothing"), *entries, *missing]


def measure(name: str, built: Pair, enough: float = _ENOUGH_S) -> Measurement | str:
    """One measurement in a process of its own, or why there is none.

    enough: seconds that N steps should take at least
    """
    try:
        version(LOOPS[name].distribution)
    except PackageNotFoundError:
        return "not installed"
    answer = answer_of(measure_loop, (name, built, enough), _LONGEST_S)
    return answer if isinstance(answer, str) else Measurement(*answer)


def entry(
    name: str, measurements: list[Measurement | str], level: Callable[[int], float], floor: float
) -> Entry:
    """The median of the measurements, if all of them did the work.

    level: steps -> the first level after them
    """
    runner = LOOPS[name]
    problems = [problem for problem in measurements if isinstance(problem, str)]
    if problems:
        return Entry(runner.name, problem=problems[0])
    good = [m for m in measurements if isinstance(m, Measurement)]
    difference = max(_difference(m, level) for m in good)
    blank = Entry(runner.name, version(runner.distribution), floor=floor)
    if difference > _NEAR:
        return replace(
            blank, problem=f"its level is off by {difference:.1e} of its value: expected other numbers"
        )
    per_step = median(m.per_step for m in good)
    if per_step <= 0.0:
        return replace(
            blank, problem="N steps took longer than 2 N steps: expected a machine that is less busy"
        )
    remark = f"records {runner.records}"
    if difference > _CLOSE:
        remark += f"; its level is off by {difference:.1e} of its value"
    return replace(blank, per_step=per_step, remark=remark)


def _difference(measurement: Measurement, level: Callable[[int], float]) -> float:
    """The largest of a measurement's levels from the right ones, relative to these."""
    right = level(measurement.steps), level(2 * measurement.steps)
    differences = [
        abs(level - expected) / abs(expected)
        for level, expected in zip(measurement.levels, right, strict=True)
    ]
    return math.inf if any(map(math.isnan, differences)) else max(differences)


class Bare:
    """The C program c/pair.c on a pair."""

    def __init__(self, built: Pair) -> None:
        self._folder, self._levels = built.folder, dict[int, float]()
        description = describe(built.fmus["first"])
        reference = {v.name: v.valueReference for v in description.modelVariables}
        self._ports = reference[SIGNAL], reference[LEVEL]
        self._fmus: list[str] = []
        for name, path in built.fmus.items():
            extracted, described = built.folder / name, describe(path)
            fmpy.extract(str(path), extracted)
            library = extracted / library_name(str(described.modelName), host_platform())
            self._fmus += [str(library), str(described.guid)]
        compile_program(
            built.folder, "pair", [str(C_SOURCES / "pair.c")], [built.folder / "first" / "sources"]
        )

    def per_step(self, steps: int = 1 << 18) -> float:
        """Seconds of a communication step."""
        (line,) = self._run(steps)
        return float(line.split()[0]) / steps

    def level(self, steps: int) -> float:
        """The first level after so many steps."""
        if steps not in self._levels:
            (line,) = self._run(steps)
            self._levels[steps] = float(line.split()[1])
        return self._levels[steps]

    def _run(self, steps: int) -> list[str]:
        return output_of(self._folder, "pair", STEP_SIZE, steps, 1, *self._ports, *self._fmus)
