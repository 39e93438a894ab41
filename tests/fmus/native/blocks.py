"""A small block with everything that the C layer distinguishes, which compiles in a moment."""

from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from fmus.block import Block, variable
from fmus.generate import builder
from fmus.numerics import sign, where
from tests.shared_builds import slow_but

from .exchanged import BALL, GROWTH, TANK


class Mode(IntEnum):
    """With a gap between its items."""

    REST = 0
    RUN = 3


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-3, max=10.0)
    mode: Mode = variable(Mode.RUN, "Mode")
    enabled: bool = variable(True, "Whether the input acts")
    start: float = variable(1.0, "Initial state", variability="fixed")
    count: int = variable(0, "Initial number of steps", max=2**31 - 2, variability="fixed")
    gain: float = variable(2.0, "Gain", min=-100.0, max=100.0)
    limit: float = variable(4.0, "Above the gain", min=0.0)


@dataclass(frozen=True)
class Calculated:
    product: float = variable(0.0, "gain limit")
    ratio: float = variable(0.0, "gain / limit")


@dataclass(frozen=True)
class Inputs:
    force: float = variable(0.0, "Force")
    valve: float = variable(0.5, "Valve", min=0.0, max=1.0)
    level: int = variable(1, "Level", min=-5, max=5)
    wind: tuple[float, float] = variable((0.0, 0.0), "Two more forces")


@dataclass(frozen=True)
class State:
    x: float = 0.0
    steps: int = variable(0, "Internal steps", min=-(2**31))
    side: float = variable(1.0, "Sign of the state", min=-1.0, max=1.0)


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "The state times the product")
    square: float = variable(0.0, "The square of the state")
    steps: int = variable(0, "Number of internal steps")
    high: bool = variable(False, "Whether the state is above 1")


def requirements(p: Parameters, c: Calculated) -> tuple:
    return (p.gain < p.limit, "gain below limit"), (c.product > -50.0, "gain limit above -50")


def step(t: float, h: float, s: State, u: Inputs, p: Parameters, c: Calculated) -> State:
    force = where(p.enabled, u.force * u.valve, 0.0) + u.level * where(p.mode == Mode.RUN, 1.0, 0.0)
    force += u.wind[0] - 2.0 * u.wind[1]
    x = (1.0 - h * c.ratio) * s.x + h * (force + t)
    return State(x, s.steps + 1, sign(x))


def output(t: float, s: State, p: Parameters, c: Calculated) -> Outputs:
    return Outputs(c.product * s.x, s.x * s.x + t, s.steps, s.x > 1.0)


EVERYTHING = Block.of_module(
    __name__,
    "Everything",
    "Everything that the C layer distinguishes",
    calculate=lambda p: Calculated(p.gain * p.limit, p.gain / p.limit),
    initial_state=lambda t, u, p, c: State(p.start + u.force, p.count),
)


_either: Any = where  # of numbers that are no items


@dataclass(frozen=True)
class Choice:
    choice: float = variable(0.0, "Beyond 1000 the number of an item")


@dataclass(frozen=True)
class Chosen:
    chosen: Mode = variable(Mode.REST, "Item")


@dataclass(frozen=True)
class Chooser:
    choose: float = variable(0.0, "Beyond 1000 the number of an item, below -1000 a truth value")


@dataclass(frozen=True)
class Given:
    choice: float = 0.0


@dataclass(frozen=True)
class Choices:
    mode: Mode = variable(Mode.REST, "Item")
    is_on: bool = variable(False, "Truth value")


ITEMS = Block(
    name="Items",
    description="Items and truth values, which rare inputs and parameters make other numbers",
    parameters=Choice,
    calculated=Chosen,
    calculate=lambda p: Chosen(_either(p.choice < 1e3, 0.0, p.choice - 1e3)),
    inputs=Chooser,
    state=Given,
    outputs=Choices,
    step=lambda t, h, s, u, p, c: Given(u.choose),
    output=lambda t, s, p, c: Choices(
        _either(s.choice < 1e3, 0.0, s.choice - 1e3), _either(s.choice > -1e3, 0.0, -1e3 - s.choice)
    ),
)


SMALL = {block.name: block for block in (EVERYTHING, ITEMS, BALL, GROWTH, TANK)}
"""Blocks of this file and of `exchanged` by name."""


def in_fmi3(names: Collection[str]) -> list[Any]:
    """Returns names as parameters of a test of FMI 3.0, of which all but two blocks are marked slow.

    The layer is that of FMI 2.0, for which there are tests of more kinds.
    """
    return slow_but(("ExamplePlant", "RovDepthPlant"), names)


def block_named(name: str) -> Block:
    """A small block, or one that is installed."""
    return SMALL[name] if name in SMALL else builder.load_block(name)
