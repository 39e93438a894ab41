"""Random parameters, inputs and states of a block, in their ranges."""

import math
import random
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from fmus.block import Block
from fmus.block.scalars import flatten, unflatten
from fmus.block.variables import BlockVariable

# both signs, and halves, whose rounding differs between functions
_SPECIAL = (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, 2.5, -2.5)
# A longer vector counts as a table, whose order the requirements of a block ask for.
_LONGEST_VECTOR = 9
# share of the states with declared limits that are drawn anywhere between them, and not near the state
_WITHIN = 0.5


def drawn(block: Block, causality: str, template: type, changed: float, rng: random.Random) -> Any:
    """Returns parameters or inputs with random values in place of some start values.

    changed: the share of drawn numbers; choices are all drawn, unless it is 0
    """
    # Requirements refuse most draws that change many numbers, but few that change choices. They ask for the
    # order of a table: all its numbers are multiplied by one factor.
    variables = block.of_causality(causality)
    counts = Counter(_vector(v) for v in variables)
    factors: dict[str, float] = {}

    def value(v: BlockVariable) -> Any:
        if counts[_vector(v)] > _LONGEST_VECTOR and v.type == "Real":
            if _vector(v) not in factors:
                factors[_vector(v)] = rng.uniform(0.5, 1.5) if rng.random() < changed else 1.0
            number = v.start * factors[_vector(v)]
            return number if v.refuse(number) is None else v.start
        is_choice = changed > 0.0 and v.type in ("Boolean", "Enumeration")
        return _draw(v, rng) if is_choice or rng.random() < changed else v.start

    return unflatten(template, list(map(value, variables)))


def permitted(block: Block, parameters: Any, holds: Callable[[Any], bool]) -> Any:
    """Returns parameters with start values in place of those that break the requirements.

    holds: whether parameters meet the requirements
    """
    values = flatten(parameters)

    def added(kept: list[Any], first: int, last: int) -> list[Any]:
        """Returns the kept values with as many of `values` in first..last as the requirements permit."""
        trial = [*kept[:first], *values[first:last], *kept[last:]]
        if trial == kept or holds(unflatten(parameters, trial)):
            return trial
        middle = (first + last) // 2
        return added(added(kept, first, middle), middle, last) if last - first > 1 else kept

    starts = [v.cast(v.start) for v in block.of_causality("parameter")]
    return unflatten(parameters, added(starts, 0, len(values)))


def _vector(v: BlockVariable) -> str:
    """Returns the name of the vector that a variable belongs to, or the name of any other variable."""
    return v.name.partition("[")[0]


def _draw(v: BlockVariable, rng: random.Random) -> Any:
    """Returns a permitted value: near the start value, anywhere in the range, at its ends, or special."""
    if v.enumeration:
        return rng.choice(list(v.enumeration))
    if v.type == "Boolean":
        return rng.random() < 0.5
    low, high = (v.minimum, v.maximum)
    low, high = (v.start - 10 if low is None else low), (v.start + 10 if high is None else high)
    if v.type == "Integer":
        return rng.randint(int(low), int(high))
    near = v.start * rng.uniform(0.5, 1.5) + (0.0 if v.start else rng.uniform(-1.0, 1.0))
    anywhere = (
        math.exp(rng.uniform(math.log(low), math.log(high))) if 0.0 < low < high else rng.uniform(low, high)
    )
    value = rng.choice((near, near, anywhere, rng.choice((low, high)), rng.choice(_SPECIAL)))
    return float(min(max(value, low), high))


def disturbed(block: Block, state: Any, rng: random.Random) -> Any:
    """Returns a state near another one, in the ranges of its numbers; the block may be unable to reach it."""

    def change(v: BlockVariable, x: Any) -> Any:
        if isinstance(x, IntEnum | bool):
            return rng.choice(list(type(x)) if isinstance(x, IntEnum) else (False, True))
        if is_limited(v) and rng.random() < _WITHIN:
            return _draw(v, rng)
        near = x * rng.uniform(0.5, 1.5), x + rng.uniform(-1.0, 1.0), rng.choice(_SPECIAL)
        moved = x + rng.choice((0, 0, -1, 1)) if isinstance(x, int) else rng.choice((x, x, *near))
        moved = moved if v.minimum is None else max(moved, v.minimum)
        return moved if v.maximum is None else min(moved, v.maximum)

    return unflatten(state, list(map(change, block.state_variables, flatten(state))))


def is_limited(v: BlockVariable) -> bool:
    """Whether a variable has a declared minimum or maximum."""
    return v.minimum is not None or v.maximum is not None
