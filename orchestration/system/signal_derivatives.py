"""Time derivatives of signals: of a reference trajectory, for a controller that takes its rate."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from orchestration.errors import ScenarioError
from orchestration.system.signals import (
    ArraySignal,
    Constant,
    Cosine,
    Ramps,
    Signal,
    Sines,
    Table,
    sine,
    spectrum,
    sum_of_sines,
)


@dataclass(frozen=True)
class Derivative(ArraySignal):
    """The derivative of that order, 1 or 2, of the signal `of` another input.

    At a kink it is that of the time after it, which holds over the next communication step.
    """

    of: str
    order: int = 1

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise ScenarioError(f"derivative: order = {self.order!r}: expected 1 or 2")


@dataclass(frozen=True)
class _Values(ArraySignal):
    """A curve by its function of times."""

    function: Callable[[np.ndarray], np.ndarray]

    def at(self, times: np.ndarray) -> np.ndarray:
        return self.function(times)


def with_derivatives(
    signals: Mapping[str, Signal], inputs: Mapping[str, Any] = {}, connections: Iterable[Sequence[Any]] = ()
) -> dict[str, Signal]:
    """Returns the signals, each `Derivative` as a curve; ScenarioError where a signal has no derivatives.

    inputs: constant ones, whose derivatives are zero; connections: (source, target, ...) of the system
    """
    result: dict[str, Signal] = dict(signals)
    for name, signal in signals.items():
        if isinstance(signal, Derivative):
            of: Signal | None = signals.get(signal.of)
            if of is None and type(inputs.get(signal.of)) in (int, float):
                of = Constant(inputs[signal.of])
            if of is None:
                sources = {target: source for source, target, *_ in connections}
                raise ScenarioError(
                    f'signals."{name}": of = {signal.of!r}: {_instead(name, signal.of, sources)}'
                )
            result[name] = derivative(of, signal.order, name)
    return result


def _instead(name: str, of: str, sources: Mapping[str, str]) -> str:
    """Returns what to do for the derivative of an input without a signal.

    sources: input -> output that is connected to it
    """
    if of not in sources:
        return "expected an input that has a signal or a constant number"
    component = sources[of].partition(".")[0]
    return (
        f"expected an input that has a signal or a constant number, but {sources[of]} drives it: connect the "
        f'output of {component} that is its rate, [connections] "{name}" = "{component}.NAME", or give '
        f'[inputs] "{name}" = 0.0'
    )


def derivative(signal: Signal, order: int = 1, name: str = "derivative") -> Signal:
    """Returns the derivative of a signal, of order 1 or 2; `name` begins the error where there is none."""
    rates: dict[type, Callable[[Any, int], Signal]] = {
        Ramps: _of_ramps,
        Cosine: _of_cosine,
        Sines: _of_sines,
        Constant: lambda signal, order: Constant(0.0),
        Table: _of_table,
    }
    if type(signal) not in rates:
        known = "ramps, cosine, sines, constant or table"
        raise ScenarioError(
            f'signals."{name}": expected the derivative of {known}, got {type(signal).__name__}'
        )
    return rates[type(signal)](signal, order)


def _of_ramps(ramps: Ramps, order: int) -> Signal:
    if not ramps.smooth:
        times, values = zip(*ramps.points, strict=True)
        return _of_table(Table(times, values), order)

    def at(times: np.ndarray) -> np.ndarray:
        values = np.zeros(times.shape)
        for (t_0, x_0), (t_1, x_1) in pairwise(ramps.points):
            inside = slice(*np.searchsorted(times, (t_0, t_1)))
            s = (times[inside] - t_0) / (t_1 - t_0)
            values[inside] = (x_1 - x_0) / (t_1 - t_0) ** order * _quintic_rate(s, order)
        return values

    return _Values(at)


def _quintic_rate(s: np.ndarray, order: int) -> np.ndarray:
    """Returns the derivative by s of 10 s^3 - 15 s^4 + 6 s^5."""
    return 30.0 * (s * (1.0 - s)) ** 2 if order == 1 else 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


def _of_cosine(cosine: Cosine, order: int) -> Signal:
    omega = cosine.angular_frequency
    return Cosine(cosine.amplitude * omega**order, omega, cosine.phase + 0.5 * np.pi * order)


def _of_sines(sines: Sines, order: int) -> Signal:
    omega = np.asarray(sines.angular_frequencies)
    amplitudes, phases = np.asarray(sines.amplitudes), np.asarray(sines.phases)
    return Sines(amplitudes * omega**order, omega, phases + 0.5 * np.pi * order)


def _of_table(table: Table, order: int) -> Signal:
    times, values = np.asarray(table.times), np.asarray(table.values)
    if table.hold or order == 2 or len(times) == 1:
        return Constant(0.0)
    slopes = [0.0, *(np.diff(values) / np.diff(times)), 0.0]
    return Table([times[0] - 1.0, *times], slopes, hold=True)


KINDS: dict[str, Callable[..., Signal]] = {
    "ramps": Ramps,
    "cosine": Cosine,
    "sine": sine,
    "sum-of-sines": sum_of_sines,
    "spectrum": spectrum,
    "constant": Constant,
    "table": Table,
    "derivative": Derivative,
}
