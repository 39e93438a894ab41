"""Tuning: one optimiser, the same number of evaluations for each free gain, several seeds, for every law.

The searches of all seeds go on together, a generation of each at a time, so that several processes have work.
A last search of as many evaluations begins at the best gains of them all: its improvement shows whether the
cost is flat there. While it is not, another one begins where that ended.

Source: Hansen, "The CMA evolution strategy: a tutorial" (arXiv 1604.00772), as the library `cmaes` has it;
restarts with twice the population after Auger and Hansen (CEC 2005).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from fmus.errors import nearest
from fmus.extras import imports_of, require
from fmus.fmi.description import of_causality
from fmus.fmi.model_description import ModelDescription
from orchestration.errors import OrchestrationError
from orchestration.many.journal import Journal
from orchestration.scenarios.free_parameter import FreeParameter, check_once

# the seeds of the last searches, apart from the seeds of the first ones, which count from 1
REFINEMENTS = (0, 1001, 1002, 1003)
# of the evaluations of a last search: their improvement shows whether the cost is flat
LAST_PART = 0.5
LARGEST_IMPROVEMENT = 0.02  # of the cost, in the last part
LARGEST_SPREAD = 0.05  # of the lowest cost: where most of the seeds come so near to it, they agree
_BEGIN = (0.25, 0.75)  # of the unit cube: the first mean of a search is drawn from there
_STEP = 0.25  # first standard deviation: half of the range lies within one of the mean
# first standard deviation of a search that begins at the best gains: a larger one would leave them
_FINE_STEP = 0.05

Evaluate = Callable[[Sequence[dict[str, float]]], Iterable[Mapping[str, Any]]]
"""Several {gain: value} -> in their order {"cost": a finite number, and what else is of interest}."""


@dataclass(frozen=True)
class Problem:
    """The problem of a tuning.

    gains: those that are free
    tuned: plain data that the cost depends on; a journal with other data is refused
    """

    gains: tuple[FreeParameter, ...]
    tuned: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SearchResult:
    """The result of the search of one seed.

    curve: the lowest cost after each evaluation; metrics: of the best gains
    """

    seed: int
    gains: Mapping[str, float]
    metrics: Mapping[str, Any]
    curve: tuple[float, ...]

    @property
    def cost(self) -> float:
        return self.curve[-1]


@dataclass(frozen=True)
class Tuning:
    """The searches of all seeds, and the last ones, each of which begins at the best gains until then."""

    problem: Problem
    searches: tuple[SearchResult, ...]
    refinements: tuple[SearchResult, ...]

    @property
    def best(self) -> SearchResult:
        return min((*self.searches, *self.refinements), key=lambda search: search.cost)

    @property
    def evaluations(self) -> int:
        return sum(len(search.curve) for search in (*self.searches, *self.refinements))

    @property
    def improvement(self) -> float:
        """The relative improvement of the cost in the last part of the last search."""
        *earlier, last = self.refinements
        first_part = last.curve[: int((1.0 - LAST_PART) * len(last.curve))]
        before = min([*(search.cost for search in (*self.searches, *earlier)), *first_part])
        return (before - self.best.cost) / before if before else 0.0

    @property
    def spread(self) -> float:
        """The spread of the seeds: their median cost above the lowest, relative to the lowest."""
        lowest = self.best.cost
        return (median(search.cost for search in self.searches) - lowest) / lowest if lowest else 0.0

    @property
    def flattening(self) -> tuple[float, ...]:
        """The median over the seeds of the lowest cost after each quarter of the evaluations."""
        quarters = [math.ceil(len(self.searches[0].curve) * i / 4) - 1 for i in range(1, 5)]
        return tuple(median(search.curve[i] for search in self.searches) for i in quarters)

    @property
    def fewest(self) -> int:
        """The fewest evaluations after which the end of a search is evidence: two generations."""
        return 2 * _generation(len(self.problem.gains))

    @property
    def is_long_enough(self) -> bool:
        """Whether the last search had enough evaluations to tell whether the cost is flat."""
        return len(self.refinements[-1].curve) >= self.fewest

    @property
    def is_flat(self) -> bool:
        """Whether more evaluations hardly lower the cost about the best gains, as far as can be told."""
        return self.is_long_enough and self.improvement <= LARGEST_IMPROVEMENT

    @property
    def seeds_agree(self) -> bool:
        """Whether half of the seeds come near the lowest cost; else the surface has valleys or ridges."""
        return self.spread <= LARGEST_SPREAD


def tune(
    problem: Problem,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    path: Path,
    evaluate: Evaluate,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    restart: bool = False,
) -> Tuning:
    """Searches the gains of least cost; the same seeds give the same gains, interrupted or not.

    path: of the journal with the finished evaluations; restart: discard it first
    progress: called with how many more evaluations are done, and the lowest cost until then
    """
    evaluations = evaluations_per_gain * len(problem.gains)
    if evaluations < 1 or not seeds:
        raise OrchestrationError("nothing to tune: expected a gain, a seed and an evaluation or more")
    with searching(problem, evaluations, path, evaluate, progress, restart) as run_searches:
        tuning = Tuning(problem, run_searches([SeedSearch(problem, seed, evaluations) for seed in seeds]), ())
        for seed in REFINEMENTS:
            last = run_searches([SeedSearch(problem, seed, evaluations, tuning.best.gains)])
            tuning = replace(tuning, refinements=(*tuning.refinements, *last))
            if tuning.improvement <= LARGEST_IMPROVEMENT:
                break
    return tuning


@contextmanager
def searching(
    problem: Problem,
    evaluations: int,
    path: Path,
    evaluate: Evaluate,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    restart: bool = False,
) -> Iterator[Callable[[Sequence["SeedSearch"]], tuple[SearchResult, ...]]]:
    """Opens the journal of a tuning, for a function that runs searches, a generation of each at a time."""
    lowest = math.inf

    def run_searches(searches: Sequence[SeedSearch]) -> tuple[SearchResult, ...]:
        nonlocal lowest
        while rows := [row for search in searches for row in search.ask()]:
            for row in _evaluated(rows, done, evaluate, journal):
                lowest = min(lowest, row["cost"])
                progress(1, lowest)
            for search in searches:
                search.tell()
        return tuple(search.result() for search in searches)

    gains = {gain.name: [gain.low, gain.high] for gain in problem.gains}
    about = {**problem.tuned, "gains": gains, "evaluations": evaluations, "optimiser": optimiser()}
    with Journal(path, about, "tuning") as journal:
        if restart:
            journal.discard()
        journal.begin()
        done = {_key(row): row for _, row in journal.rows() if "cost" in row}
        yield run_searches


def _key(row: Mapping[str, Any]) -> tuple[int, int]:
    """Returns what a row is found by: its seed, and the number of the evaluation from 0."""
    return row["seed"], row["evaluation"]


def _evaluated(
    rows: Sequence[dict[str, Any]],
    done: Mapping[tuple[int, int], dict[str, Any]],
    evaluate: Evaluate,
    journal: Journal,
) -> Iterator[dict[str, Any]]:
    """Yields the rows in their order, each with its cost, of the journal or evaluated and added there."""
    stored = [done.get(_key(row)) for row in rows]
    missing = [row["gains"] for row, finished in zip(rows, stored, strict=True) if finished is None]
    costs = iter(evaluate(missing))
    for row, finished in zip(rows, stored, strict=True):
        if finished and finished["gains"] != row["gains"]:
            raise OrchestrationError(
                f"{journal.path}: evaluation {row['evaluation']} of seed {row['seed']} has other gains than "
                "the search asks for: expected the same libraries as before; --restart discards it"
            )
        row.update(finished or next(costs))
        if not finished:
            journal.add([row])
        yield row


def optimiser() -> str:
    """Returns the name of the search and the version of its library."""
    with imports_of("study", "tuning"):
        return f"CMA-ES (cmaes {version('cmaes')})"


class SeedSearch:
    """The search of one seed by CMA-ES, with every evaluation that it asked for in `rows`.

    The same seed and the same costs give the same gains, so that a search continues from its costs alone.
    start: the gains that it begins at, in small steps; by default it begins anywhere
    cost: of a row, which the search minimises
    """

    def __init__(
        self,
        problem: Problem,
        seed: int,
        evaluations: int,
        start: Mapping[str, float] | None = None,
        cost: Callable[[Mapping[str, Any]], float] = itemgetter("cost"),
    ) -> None:
        self._gains, self._seed, self._cost = problem.gains, seed, cost
        self._start = [gain.share(start[gain.name]) for gain in problem.gains] if start else None
        self._random = np.random.default_rng(seed)
        self._remaining = evaluations
        self._points: list[np.ndarray] = []  # of the present generation, in the unit cube
        self.rows: list[dict[str, Any]] = []
        self._begin(_generation(len(problem.gains)))

    def _begin(self, population: int) -> None:
        cmaes = require("cmaes", "study", "tuning")
        # CMA-ES adapts a covariance: one gain gets a second coordinate
        size = max(len(self._gains), 2)
        anywhere = self._random.uniform(*_BEGIN, size)
        self._strategy = cmaes.CMA(
            mean=anywhere if self._start is None else np.array([*self._start, 0.5])[:size],
            sigma=_STEP if self._start is None else _FINE_STEP,
            bounds=np.tile([0.0, 1.0], (size, 1)),
            seed=int(self._random.integers(2**31)),
            population_size=population,
        )

    def ask(self) -> list[dict[str, Any]]:
        """Returns the evaluations of the next generation, to be completed with their costs; none at last."""
        count = min(self._strategy.population_size, self._remaining)
        self._remaining -= count
        self._points = [self._strategy.ask() for _ in range(count)]
        for point in self._points:
            gains = {gain.name: gain.rounded(float(x)) for gain, x in zip(self._gains, point, strict=False)}
            self.rows.append({"seed": self._seed, "evaluation": len(self.rows), "gains": gains})
        return self.rows[len(self.rows) - count :]

    def tell(self) -> None:
        """Takes the costs of the generation, unless the evaluations have cut it short."""
        # CMA-ES updates its distribution by whole generations only
        if len(self._points) < self._strategy.population_size:
            return
        costs = [self._cost(row) for row in self.rows[-len(self._points) :]]
        self._strategy.tell(list(zip(self._points, costs, strict=True)))
        # converged: the remaining evaluations search elsewhere
        if self._strategy.should_stop():
            self._begin(2 * self._strategy.population_size)

    def result(self) -> SearchResult:
        """Returns the best evaluation, and the lowest cost after each."""
        curve = tuple(accumulate((row["cost"] for row in self.rows), min))
        best = min(self.rows, key=lambda row: row["cost"])
        others = ("seed", "evaluation", "gains", "cost")
        metrics = {key: value for key, value in best.items() if key not in others}
        return SearchResult(self._seed, best["gains"], metrics, curve)


def _generation(gains: int) -> int:
    """Returns how many points the first generation of a search of so many gains has (Hansen, table 1)."""
    return 4 + math.floor(3.0 * math.log(max(gains, 2)))


def with_units(gains: Iterable[FreeParameter], description: ModelDescription) -> tuple[FreeParameter, ...]:
    """Returns the gains with the units of an FMU; OrchestrationError for one that it cannot take.

    A gain is a parameter of type Real, tunable or fixed, whose declared range holds the limits.
    """
    gains, parameters = list(gains), of_causality(description, "parameter")
    known = {v.name: v for v in parameters if v.type == "Real"}
    for gain in gains:
        if gain.name not in known:
            raise OrchestrationError(
                f"--free {gain.name}: expected a parameter of type Real; {nearest(gain.name, known)}"
            )
        if not gain.is_limited:
            raise OrchestrationError(f"--free {gain.name}: expected NAME=LOW:HIGH, such as {gain.name}=1:20")
    check_once(gains)
    if not gains:
        tunable = [name for name, v in known.items() if v.variability == "tunable"]
        raise OrchestrationError(
            f"nothing to tune: expected --free NAME=LOW:HIGH; tunable are {', '.join(tunable) or 'none'}"
        )
    return tuple(gain.within(known[gain.name]) for gain in gains)
