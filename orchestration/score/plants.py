"""The plants of `score --full`: drawn once, the same for every controller.

The numbers of plant i come from SeedSequence(seed, spawn_key=(i,)) alone, in the order of the protocol: what
is varied, then way, depth and hold of each depth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.scenarios.file_tables import Table
from orchestration.score.protocol import Case, Protocol, first_target
from orchestration.sweep.distributions import FUNCTIONS

Quantile = Callable[[float], FmiValue]


@dataclass(frozen=True)
class _Draws:
    """The draws of a plant, each a function of a uniform number in [0, 1)."""

    varied: list[tuple[list[str], Quantile]]
    way: Quantile
    hold: Quantile
    depths: list[Quantile]


def plants(protocol: Protocol, seed: int, count: int | None = None) -> list[Case]:
    """Returns the first `count` plants of a seed as cases, by default as many as the protocol has."""
    table = protocol.tables.plants
    draws = _Draws(
        [(entry.variables, _quantile(entry)) for entry in table.vary.values()],  # type: ignore[attr-defined]
        _quantile(table.trajectory.ways),
        _quantile(table.trajectory.holds),
        [_quantile(depth) for depth in table.trajectory.depths],
    )
    nominal = protocol.nominal
    return [_plant(nominal, draws, seed, number) for number in range(count or table.count)]


def _quantile(table: Table) -> Quantile:
    arguments = table.given()
    arguments.pop("variables", None)
    law = FUNCTIONS[arguments.pop("distribution")](**arguments)
    return lambda uniform: law.quantile([uniform])[0]


def _plant(nominal: Case, draws: _Draws, seed: int, number: int) -> Case:
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    values = dict(nominal.values)
    for variables, quantile in draws.varied:
        values |= dict.fromkeys(variables, quantile(random.random()))
    points = [[0.0, 0.0]]
    for depth in draws.depths:
        way, level, hold = (float(draw(random.random())) for draw in (draws.way, depth, draws.hold))
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
