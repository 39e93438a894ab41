"""The smallest block with all that functions of FMI get and set: each type, an array, a state."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from fmus.block import Block, variable
from fmus.numerics import where


class Way(IntEnum):
    UP = 1
    DOWN = 2


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-6, max=1.0)
    factor: int = variable(1, "Factor of the rate")
    forward: Way = variable(Way.UP, "Way of a rate above 0")


@dataclass(frozen=True)
class Calculated:
    backward: Way = variable(Way.DOWN, "Way of a rate below 0")


@dataclass(frozen=True)
class Inputs:
    rate: float = variable(0.0, "Rate")
    is_on: bool = variable(True, "Whether the rate counts")


@dataclass(frozen=True)
class Continuous:
    level: float = variable(1.0, "Level")


@dataclass(frozen=True)
class Outputs:
    both: tuple[float, float] = variable((0.0, 0.0), "Level, and its double")
    side: Way = variable(Way.UP, "Side of the level")


def way(is_up: Any) -> Way:
    return where(is_up, 1.0, 2.0)  # type: ignore[return-value]


SMALLEST = Block(
    "Smallest", "An integrator",
    parameters=Parameters, calculated=Calculated, inputs=Inputs, continuous=Continuous, outputs=Outputs,
    step_size=0.1,
    calculate=lambda p: Calculated(way(p.forward == Way.DOWN)),
    requirements=lambda p, c: ((p.factor < 10, "factor below 10"),),
    derivative=lambda t, state, u, p, c: Continuous(where(u.is_on, p.factor * u.rate, 0.0)),
    output=lambda t, state, p, c: Outputs((state.level, 2.0 * state.level), way(state.level > 0.0)),
)  # fmt: skip
