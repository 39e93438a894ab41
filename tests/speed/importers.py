"""The overhead of a communication step, in this master and in every importer that is installed.

Every importer runs the two FMUs of pair.py in a process of its own, N and 2 N steps: the difference is N
steps without the cost of loading. A C program that only calls the FMUs' functions gives the time that these
need themselves, and the values that must come out.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from statistics import median

from fmus.platforms import host_platform
from tests.isolated import answer_of
from tests.speed import pair as pair_module
from tests.speed.loops import LOOPS, Measurement, measure_loop
from tests.speed.pair import STEP_SIZE, Pair
from tests.speed.part import Goal, Options, Part, Table, spread
from tests.speed.programs import C_SOURCES, compile_program, extracted, output_of, workplace

FLOOR = "a bare C loop"
_ENOUGH_S = 0.05  # far more than what loading varies by
_LONGEST_S = 120.0
_CLOSE = 1e-12  # relative; rounding, where an importer adds up times
_NEAR = 1e-2  # relative; another algorithm of first order, but the same work


_QUICK = ("ours", "ecos", "fmucontainer")


@dataclass(frozen=True)
class Entry:
    """One way to run the pair. Times of a communication step [s], a value a round.

    floor: the time in which a bare C loop calls the same functions
    remark: what is recorded, and what else is to be known
    problem: why there are no times
    """

    name: str
    version: str = ""
    times: Sequence[float] = ()
    floor: float = math.nan
    remark: str = ""
    problem: str = ""

    @property
    def per_step(self) -> float:
        """The median."""
        return median(self.times) if self.times else math.inf

    @property
    def overhead(self) -> float:
        return self.per_step - self.floor

    @property
    def ratio(self) -> float:
        return self.per_step / self.floor


def measure(options: Options) -> Part:
    """A communication step of the pair in every importer that is installed."""
    entries = compare(options.rounds(3), _QUICK if options.quick else LOOPS)
    floor, ours = (next(e for e in entries if e.name == name) for name in (FLOOR, LOOPS["ours"].name))
    others = sorted(
        (e for e in entries if not e.problem and e not in (floor, ours)), key=lambda e: e.per_step
    )
    now = f"{1e6 * ours.per_step:.3f} us, {ours.ratio:.1f} times the FMUs alone"
    peers = ", ".join(f"{e.name} {1e6 * e.per_step:.2g} us" for e in others[:2])
    return Part([table(entries)], [Goal("a communication step of two small FMUs", "none", now, others=peers)])


def table(entries: Iterable[Entry]) -> Table:
    """The fastest first; who gave no time last, with the reason."""
    rows = [
        (f"{e.name} {e.version}".strip(), *_numbers(e), e.problem or e.remark)
        for e in sorted(entries, key=lambda e: (bool(e.problem), e.per_step))
    ]
    headings = ("importer", "us a step", "of that without the FMUs", "times the FMUs", "remark")
    return Table("importers", headings, rows)


def _numbers(entry: Entry) -> tuple[str, ...]:
    if entry.problem:
        return "", "", ""
    return spread([1e6 * x for x in entry.times], 3), f"{1e6 * entry.overhead:.3f}", f"{entry.ratio:.1f}"


def compare(rounds: int = 3, loops: Iterable[str] = LOOPS) -> list[Entry]:
    """The bare loop and every other, medians over rounds in which all take turns."""
    with workplace() as folder:
        built = pair_module.build(folder)
        bare = Bare(built)
        measurements: dict[str, list[Measurement | str]] = {name: [] for name in loops}
        floors = []
        for _ in range(rounds):
            floors.append(bare.per_step())
            for name, own in measurements.items():
                if not own or isinstance(own[-1], Measurement):
                    own.append(measurement_of(name, built))
        floor = median(floors)
        entries = [entry(name, own, bare.level, floor) for name, own in measurements.items()]
    return [Entry(FLOOR, "", floors, floor, "records nothing"), *entries]


def measurement_of(name: str, built: Pair, enough: float = _ENOUGH_S) -> Measurement | str:
    """One measurement in a process of its own, or why there is none.

    enough: seconds that N steps should take at least
    """
    return answer_of(measure_loop, (name, built, enough), _LONGEST_S)


def entry(
    name: str, measurements: list[Measurement | str], level: Callable[[int], float], floor: float
) -> Entry:
    """The median of the measurements, if all of them did the work.

    level: steps -> the first level after them
    """
    loop = LOOPS[name]
    problems = [problem for problem in measurements if isinstance(problem, str)]
    if problems:
        return Entry(loop.name, problem=problems[0])
    complete = [m for m in measurements if isinstance(m, Measurement)]
    blank = Entry(loop.name, version(loop.distribution), floor=floor)
    difference = max(_difference(m, level) for m in complete)
    off = f"its level is off by {difference:.1e} of its value"
    if difference > _NEAR:
        return replace(blank, problem=f"{off}: expected other numbers")
    times = [m.per_step for m in complete]
    if median(times) <= 0.0:
        slower = "N steps took longer than 2 N steps: expected a machine that is less busy"
        return replace(blank, problem=slower)
    remark = f"records {loop.records}" + (f"; {off}" if difference > _CLOSE else "")
    return replace(blank, times=times, remark=remark)


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
        self._folder, self._ports = built.folder, built.references
        self._fmus: list[object] = []
        for name, path in built.fmus.items():
            guid, library = extracted(path, built.folder / name, host_platform())
            self._fmus += [library, guid]
        compile_program(
            built.folder, "pair", [str(C_SOURCES / "pair.c")], [built.folder / "first" / "sources"]
        )

    def per_step(self, steps: int = 1 << 18) -> float:
        """Seconds of a communication step."""
        return self._run(steps)[0] / steps

    def level(self, steps: int) -> float:
        """The first level after so many steps."""
        return self._run(steps)[1]

    def _run(self, steps: int) -> tuple[float, float]:
        (line,) = output_of(self._folder, "pair", STEP_SIZE, steps, 1, *self._ports, *self._fmus)
        seconds, level = map(float, line.split())
        return seconds, level
