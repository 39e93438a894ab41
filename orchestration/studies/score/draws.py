"""Draws of a score: seeds and times of its cases, and the plants of `score --full`.

They are what a controller could learn by heart, and are the same for every controller. The numbers of case k
come from SeedSequence(seed, spawn_key=(0, k)) alone, one draw after another, and of plant i from
SeedSequence(seed, spawn_key=(1, i)), in the order of the protocol: varied values, then way, depth and hold
of each depth. Who tunes has the cases as the file gives them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.scenarios.file_tables import Table
from orchestration.studies.score.protocol import Case, Protocol, first_target
from orchestration.studies.vehicle import distribution_of

LARGEST_SEED = 2147483397  # that a sensor takes


def drawn_cases(protocol: Protocol, seed: int) -> list[Case]:
    """Returns the cases of a score, with seeds and times that follow from its seed."""
    return [draws[0] for draws in repeated_cases(protocol, seed, 1)]


def repeated_cases(protocol: Protocol, seed: int, count: int) -> list[list[Case]]:
    """Returns so many draws of each case; the first equal `drawn_cases`."""
    sources = (np.random.SeedSequence(seed, spawn_key=(0, number)) for number in range(len(protocol.cases)))
    generators = map(np.random.default_rng, sources)
    return [
        [_drawn(case, random) for _ in range(count)]
        for random, case in zip(generators, protocol.cases.values(), strict=True)
    ]


def _drawn(case: Case, random: np.random.Generator) -> Case:
    """Returns the case with seeds and times that are drawn."""
    layer = _with_seeds(case.layer, random)
    later = float(random.uniform(0.0, case.latest))
    return replace(case, layer=layer, later=later).with_seed(_seed(random))


def _with_seeds(value: Any, random: np.random.Generator) -> Any:
    """Returns the entries of a layer with a drawn number for each seed."""
    if isinstance(value, list):
        return [_with_seeds(item, random) for item in value]
    if not isinstance(value, Mapping):
        return value
    return {
        key: _seed(random) if key.split(".")[-1] == "seed" else _with_seeds(item, random)
        for key, item in value.items()
    }


def _seed(random: np.random.Generator) -> int:
    return int(random.integers(1, LARGEST_SEED, endpoint=True))


def plants(protocol: Protocol, seed: int, count: int | None = None) -> list[Case]:
    """Returns the first `count` plants of a seed as cases, by default as many as the protocol has."""
    return [_plant(protocol, seed, number) for number in range(count or protocol.tables.plants.count)]


def _plant(protocol: Protocol, seed: int, number: int) -> Case:
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, number)))
    nominal, trajectory = protocol.nominal, protocol.tables.plants.trajectory

    def drawn(table: Table) -> FmiValue:
        return distribution_of(table).quantile([random.random()])[0]

    values = dict(nominal.values)
    for name, entry in protocol.vary.items():
        values |= dict.fromkeys(entry.variables, protocol.law(name).quantile([random.random()])[0])
    points = [[0.0, 0.0]]
    for depth in trajectory.depths:
        way, level, hold = (float(drawn(table)) for table in (trajectory.ways, depth, trajectory.holds))
        points += [[points[-1][0] + way, level], [points[-1][0] + way + hold, level]]
    return replace(
        nominal,
        name=f"plant-{number}",
        title=f"Plant {number}",
        values=values,
        trajectory=_until(points, nominal.judged[1]),
        target=first_target(points),
        tuned_on=False,
    )


def _until(points: list[list[float]], end: float) -> list[list[float]]:
    """Returns the points of a trajectory before its end, and the one at its end."""
    times, depths = zip(*points, strict=True)
    last = float(np.interp(end, times, depths))
    return [*(point for point in points if point[0] < end), [end, last]]
