"""Faults on a connection, as data: which earlier sample arrives in place of each, and what is added to it.

Sample i is what a connection carries at communication point i. Under a fault the input is given

    sample[source[i]] + addition[i],   or addition[i] alone where source[i] is -1

with source[i] <= i, so that every kind of fault, and any number of them one after another, is two arrays.
Faults act from the first communication step on; initial values are exchanged without them.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from orchestration.errors import SystemDefinitionError
from orchestration.system.time_grid import within

Pattern = tuple[np.ndarray, np.ndarray]


class Effect:
    """What a fault does to samples while it lasts; `for_every_type`: not only to Real ones."""

    for_every_type: ClassVar[bool] = True

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        """(source, addition) of the samples `inside`, consecutive ones and at least one."""
        raise NotImplementedError


@dataclass(frozen=True)
class Freeze(Effect):
    """The value at the first communication point of the window holds."""

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        return np.full(inside.shape, inside[0]), np.zeros(inside.shape)


@dataclass(frozen=True)
class Stuck(Effect):
    """`value` arrives, whatever is sent."""

    value: float | bool

    def __post_init__(self) -> None:
        if not isinstance(self.value, bool):
            _check_number("value", self.value)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        return np.full(inside.shape, -1), np.full(inside.shape, float(self.value))


@dataclass(frozen=True)
class Offset(Effect):
    """`value` is added."""

    for_every_type = False
    value: float

    def __post_init__(self) -> None:
        _check_number("value", self.value)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        return inside, np.full(inside.shape, float(self.value))


@dataclass(frozen=True)
class Drift(Effect):
    """`rate` times the time since the first communication point of the window is added."""

    for_every_type = False
    rate: float

    def __post_init__(self) -> None:
        _check_number("rate", self.rate)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        return inside, self.rate * (times[inside] - times[inside[0]])


@dataclass(frozen=True)
class Noise(Effect):
    """Independent Gaussian numbers of this standard deviation are added."""

    for_every_type = False
    standard_deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        _check_number("standard_deviation", self.standard_deviation, "a finite number, 0 or more", 0.0)
        _check_number("seed", self.seed, "an integer, 0 or more", 0, of_type=int)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        return inside, self.standard_deviation * stream.standard_normal(len(inside))


@dataclass(frozen=True)
class DropOut(Effect):
    """Each sample is lost with this probability, independently; the last that arrived holds.

    The first sample of a run always arrives: before it there is nothing to hold.
    """

    probability: float
    seed: int = 0

    def __post_init__(self) -> None:
        _check_number("probability", self.probability, "0..1", 0.0, 1.0)
        _check_number("seed", self.seed, "an integer, 0 or more", 0, of_type=int)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        is_lost = stream.random(len(inside)) < self.probability
        before = max(inside[0] - 1, 0)
        return np.maximum.accumulate(np.where(is_lost, before, inside)), np.zeros(inside.shape)


@dataclass(frozen=True)
class Delay(Effect):
    """What was sent `delay` seconds ago arrives, of the nearest communication point; at first the first."""

    delay: float

    def __post_init__(self) -> None:
        _check_number("delay", self.delay, "a finite number of seconds, more than 0", math.ulp(0.0))

    def on(self, inside: np.ndarray, times: np.ndarray, stream: np.random.Generator) -> Pattern:
        middles = 0.5 * (times[1:] + times[:-1])
        return np.searchsorted(middles, times[inside] - self.delay), np.zeros(inside.shape)


KINDS: Mapping[str, type[Effect]] = {
    "freeze": Freeze,
    "stuck": Stuck,
    "offset": Offset,
    "drift": Drift,
    "noise": Noise,
    "drop-out": DropOut,
    "delay": Delay,
}


@dataclass(frozen=True)
class Fault:
    """An effect on what arrives at an input, "component.variable", from `start` on and before `end` [s].

    A connection is named by its input, so that one of several that an output feeds can fail alone.
    """

    input: str
    effect: Effect
    start: float = -math.inf
    end: float = math.inf

    def __post_init__(self) -> None:
        if not self.start < self.end:
            raise SystemDefinitionError(
                f"fault on {self.input}: end = {self.end!r} s: expected more than its start, {self.start!r} s"
            )

    def pattern(self, times: np.ndarray) -> Pattern:
        """(source, addition) of every sample, shapes (n,)."""
        source, addition = np.arange(len(times)), np.zeros(len(times))
        inside = within(times, self.start, self.end)
        if len(inside):
            source[inside], addition[inside] = self.effect.on(inside, times, self.stream())
        return source, addition

    def stream(self) -> np.random.Generator:
        """Random numbers that follow from seed, input and kind alone."""
        key = f"{type(self.effect).__name__} {self.input}".encode()
        seed = getattr(self.effect, "seed", 0)
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def compose(faults: Sequence[Fault], times: np.ndarray) -> Pattern:
    """(source, addition), shapes (n,), of the faults on one connection, in the order in which they act.

    times: of the samples, ascending [s].
    """
    source, addition = np.arange(len(times)), np.zeros(len(times))
    for fault in faults:
        later_source, later_addition = fault.pattern(times)
        is_sent = later_source >= 0
        addition = np.where(is_sent, addition[later_source], 0.0) + later_addition
        source = np.where(is_sent, source[later_source], -1)
    return source, addition


def _check_number(
    name: str,
    value: Any,
    expected: str = "a finite number",
    low: float = -sys.float_info.max,
    high: float = sys.float_info.max,
    of_type: type | tuple[type, ...] = (int, float),
) -> None:
    if isinstance(value, bool) or not isinstance(value, of_type) or not low <= value <= high:
        raise SystemDefinitionError(f"{name} = {value!r}: expected {expected}")
