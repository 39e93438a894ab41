"""Faults on a connection, as data: which earlier samples arrive in place of each, and what is added.

Sample i is what a connection carries at communication point i. Under a fault the input is given

    addition[i] + sum over j of weight[i, j] sample[source[i, j]],   without the terms whose source is -1

with source[i, j] <= i, so that every kind of fault, and any number of them in turn, is three arrays.
Faults act from the first communication step on; initial values are exchanged without them.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from orchestration.errors import SystemDefinitionError
from orchestration.system.time_grid import resolution_of, within


class Pattern(NamedTuple):
    """A pattern of arrival for n samples: `source` and `weight`, shapes (n, terms), and `addition`, (n,)."""

    source: np.ndarray
    weight: np.ndarray
    addition: np.ndarray

    @classmethod
    def of_one(cls, source: np.ndarray, addition: np.ndarray) -> "Pattern":
        """Returns the pattern of one sample, or none, and an addition in place of each: shapes (n,)."""
        return cls(source[:, np.newaxis], np.ones((len(source), 1)), addition)

    def after(self, earlier: "Pattern") -> "Pattern":
        """Returns this pattern applied to the samples that an earlier one gives."""
        is_sent = self.source >= 0
        source = np.where(is_sent[..., np.newaxis], earlier.source[self.source], -1)
        weight = self.weight[..., np.newaxis] * earlier.weight[self.source]
        carried = np.where(is_sent, self.weight * earlier.addition[self.source], 0.0).sum(axis=1)
        shape = len(source), -1
        return Pattern(source.reshape(shape), weight.reshape(shape), carried + self.addition)


class Effect:
    """The effect of a fault on samples while it lasts; `for_every_type`: not only on Real ones."""

    for_every_type: ClassVar[bool] = True

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        """Returns the pattern of the samples of the window.

        Parameters
        ----------
        inside : array of int
            Indices of the samples of the window, consecutive ones and at least one.
        times : array, shape (n,)
            Times of all samples of the run [s].
        stream : numpy.random.Generator
            Random numbers of the fault.

        Returns
        -------
        Pattern
            For the samples `inside`.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Freeze(Effect):
    """A freeze: the value at the first communication point of the window holds.

    Examples
    --------
    >>> Fault("controller.depth", Freeze(), start=1.0).pattern(np.arange(4.0)).source.ravel()
    array([0, 1, 1, 1])
    """

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        return Pattern.of_one(np.full(inside.shape, inside[0]), np.zeros(inside.shape))


@dataclass(frozen=True)
class Stuck(Effect):
    """A stuck signal: `value` arrives, whatever is sent.

    Parameters
    ----------
    value : float, int or bool
        In the unit of the input.

    Raises
    ------
    SystemDefinitionError
        For a number that is not finite.

    Examples
    --------
    >>> Fault("controller.depth", Stuck(2.0), start=1.0).pattern(np.arange(4.0)).addition
    array([0., 2., 2., 2.])
    """

    value: float | int | bool

    def __post_init__(self) -> None:
        if not isinstance(self.value, bool):
            _check_number("value", self.value)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        return Pattern.of_one(np.full(inside.shape, -1), np.full(inside.shape, float(self.value)))


@dataclass(frozen=True)
class Offset(Effect):
    """An offset: `value` is added.

    Parameters
    ----------
    value : float
        In the unit of the input.

    Raises
    ------
    SystemDefinitionError
        For a number that is not finite.

    Examples
    --------
    >>> Fault("controller.depth", Offset(0.1), start=1.0).pattern(np.arange(4.0)).addition
    array([0. , 0.1, 0.1, 0.1])
    """

    for_every_type = False
    value: float

    def __post_init__(self) -> None:
        _check_number("value", self.value)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        return Pattern.of_one(inside, np.full(inside.shape, float(self.value)))


@dataclass(frozen=True)
class Drift(Effect):
    """A drift: `rate` times the time since the first communication point of the window is added.

    Parameters
    ----------
    rate : float
        In the unit of the input per s.

    Raises
    ------
    SystemDefinitionError
        For a number that is not finite.

    Examples
    --------
    >>> Fault("controller.depth", Drift(0.1), start=1.0).pattern(np.arange(4.0)).addition
    array([0. , 0. , 0.1, 0.2])
    """

    for_every_type = False
    rate: float

    def __post_init__(self) -> None:
        _check_number("rate", self.rate)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        return Pattern.of_one(inside, self.rate * (times[inside] - times[inside[0]]))


@dataclass(frozen=True)
class Noise(Effect):
    """Noise: independent Gaussian numbers of this standard deviation are added.

    Parameters
    ----------
    standard_deviation : float
        In the unit of the input, 0 or more.
    seed : int
        Seed of the random numbers, 0 or more.

    Raises
    ------
    SystemDefinitionError
        For a value out of its range.

    Examples
    --------
    >>> Fault("controller.depth", Noise(0.01, seed=1), start=1.0).pattern(np.arange(4.0)).addition[:2]
    array([ 0.       , -0.0176075])
    """

    for_every_type = False
    standard_deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        _check_number("standard_deviation", self.standard_deviation, "a finite number, 0 or more", 0.0)
        _check_number("seed", self.seed, "an integer, 0 or more", 0, of_type=int)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        return Pattern.of_one(inside, self.standard_deviation * stream.standard_normal(len(inside)))


@dataclass(frozen=True)
class DropOut(Effect):
    """Drop-outs: each sample is lost with this probability, independently; the last that arrived holds.

    The first sample of a run always arrives: before it there is nothing to hold.

    Parameters
    ----------
    probability : float
        Probability 0 to 1 of each sample.
    seed : int
        Seed of the random numbers, 0 or more.

    Raises
    ------
    SystemDefinitionError
        For a value out of its range.

    Examples
    --------
    >>> Fault("controller.depth", DropOut(0.5, seed=1), start=1.0).pattern(np.arange(4.0)).source.ravel()
    array([0, 0, 2, 2])
    """

    probability: float
    seed: int = 0

    def __post_init__(self) -> None:
        _check_number("probability", self.probability, "0..1", 0.0, 1.0)
        _check_number("seed", self.seed, "an integer, 0 or more", 0, of_type=int)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        is_lost = stream.random(len(inside)) < self.probability
        before = max(inside[0] - 1, 0)
        held = np.maximum.accumulate(np.where(is_lost, before, inside))
        return Pattern.of_one(held, np.zeros(inside.shape))


@dataclass(frozen=True)
class Delay(Effect):
    """A delay: the sample of the communication point nearest to `delay` seconds ago; at first the first.

    Parameters
    ----------
    delay : float
        Delay [s], more than 0.

    Raises
    ------
    SystemDefinitionError
        For a value out of its range.

    Examples
    --------
    >>> Fault("controller.depth", Delay(2.0), start=1.0).pattern(np.arange(4.0)).source.ravel()
    array([0, 0, 0, 1])
    """

    delay: float

    def __post_init__(self) -> None:
        _check_number("delay", self.delay, "a finite number of seconds, more than 0", math.ulp(0.0))

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        middles = 0.5 * (times[1:] + times[:-1])
        # of two samples that are as near but for rounding, the earlier one
        nearest = np.searchsorted(middles, times[inside] - self.delay - resolution_of(times))
        return Pattern.of_one(nearest, np.zeros(inside.shape))


@dataclass(frozen=True)
class InterpolatedDelay(Effect):
    """A delay with interpolation: the value of `delay` seconds ago, on a line between two samples, arrives.

    Before there is one, the first sample arrives.

    Parameters
    ----------
    delay : float
        Delay [s], 0 or more.

    Raises
    ------
    SystemDefinitionError
        For a value out of its range.

    Examples
    --------
    >>> Fault("controller.depth", InterpolatedDelay(0.25), start=1.0).pattern(np.arange(4.0)).weight[3]
    array([0.25, 0.75])
    """

    for_every_type = False
    delay: float

    def __post_init__(self) -> None:
        _check_number("delay", self.delay, "a finite number of seconds, 0 or more", 0.0)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        # as a fractional index: interpolation between any two samples, also of a shorter last step
        sent = np.interp(times[inside] - self.delay, times, np.arange(len(times)))
        before = np.floor(sent).astype(int)
        source = np.column_stack([before, np.minimum(before + 1, inside)])
        weight = np.column_stack([1.0 - (sent - before), sent - before])
        return Pattern(source, weight, np.zeros(inside.shape))


@dataclass(frozen=True)
class Scale(Effect):
    """A scale: `factor` times the value arrives, by a wrong gain of an actuator or a sensor.

    Parameters
    ----------
    factor : float
        Factor of the value, 1 without a fault.

    Raises
    ------
    SystemDefinitionError
        For a number that is not finite.

    Examples
    --------
    >>> Fault("controller.depth", Scale(1.1), start=1.0).pattern(np.arange(4.0)).weight.ravel()
    array([1. , 1.1, 1.1, 1.1])
    """

    for_every_type = False
    factor: float

    def __post_init__(self) -> None:
        _check_number("factor", self.factor)

    def on(self, inside: np.ndarray, times: np.ndarray, stream: "np.random.Generator") -> Pattern:
        one = Pattern.of_one(inside, np.zeros(inside.shape))
        return one._replace(weight=np.full(one.weight.shape, float(self.factor)))


KINDS: Mapping[str, type[Effect]] = {
    "freeze": Freeze,
    "stuck": Stuck,
    "offset": Offset,
    "drift": Drift,
    "noise": Noise,
    "drop-out": DropOut,
    "delay": Delay,
    "interpolated-delay": InterpolatedDelay,
    "scale": Scale,
}


@dataclass(frozen=True)
class Fault:
    """A fault: an effect on what arrives at an input, "component.variable", from `start` until `end` [s].

    Parameters
    ----------
    input : str
        "component.variable". It names the connection: one of several that an output feeds can fail alone.
    effect : Effect
        Freeze, Stuck, Offset, Drift, Noise, DropOut, Delay, InterpolatedDelay or Scale.
    start, end : float
        Times [s]; by default the whole run.

    Raises
    ------
    SystemDefinitionError
        For an end that is not after the start.

    Examples
    --------
    >>> Fault("controller.depth", Offset(0.1), start=20.0)
    Fault(input='controller.depth', effect=Offset(value=0.1), start=20.0, end=inf)
    """

    input: str
    effect: Effect
    start: float = -math.inf
    end: float = math.inf

    def __post_init__(self) -> None:
        if not self.start < self.end:
            raise SystemDefinitionError(
                f"fault on {self.input}: end = {self.end!r} s: expected more than its start, "
                f"{self.start!r} s",
                self.input,
            )

    def pattern(self, times: np.ndarray) -> Pattern:
        """Returns the pattern of every sample.

        Parameters
        ----------
        times : array, shape (n,)
            Times of the samples [s], ascending.

        Returns
        -------
        Pattern
        """
        everywhere = Pattern.of_one(np.arange(len(times)), np.zeros(len(times)))
        inside = within(times, self.start, self.end)
        if not len(inside):
            return everywhere
        window = self.effect.on(inside, times, self.stream())
        terms = window.source.shape[1]
        source, weight = np.full((len(times), terms), -1), np.ones((len(times), terms))
        source[:, :1], everywhere.addition[inside] = everywhere.source, window.addition
        source[inside], weight[inside] = window.source, window.weight
        return Pattern(source, weight, everywhere.addition)

    def stream(self) -> "np.random.Generator":
        """Returns random numbers that follow from seed, input and kind alone.

        Returns
        -------
        numpy.random.Generator
        """
        key = f"{type(self.effect).__name__} {self.input}".encode()
        seed = getattr(self.effect, "seed", 0)
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def compose(faults: Sequence[Fault], times: np.ndarray) -> Pattern:
    """Returns the pattern of the faults on one connection, in the order in which they act.

    times: of the samples, ascending [s].
    """
    pattern = Pattern.of_one(np.arange(len(times)), np.zeros(len(times)))
    for fault in faults:
        pattern = fault.pattern(times).after(pattern)
    return pattern


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
