"""Time derivatives of signals: of a reference trajectory, for a controller that takes its rate."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
    """The derivative of the signal of another input by time.

    At a kink it is the derivative after it, which holds over the next communication step.

    Parameters
    ----------
    of : str
        Input, "component.variable", that has a signal or a constant value.
    order : {1, 2}
        Order of the derivative, 1 or 2.

    Raises
    ------
    ScenarioError
        For another order.
    """

    of: str
    order: int = 1

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise ScenarioError(f"derivative: order = {self.order!r}: expected 1 or 2")


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
                    f'signals."{name}": of = {signal.of!r}: {_instead(name, signal.of, sources)}',
                    ("signals", name),
                    signal.of,
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
    """Returns the derivative of a signal, of order 1 or 2.

    name: begins the ScenarioError about a signal without a derivative
    """
    if not isinstance(signal, Constant | Cosine | Ramps | Sines | Table):
        known = "ramps, cosine, sines, constant or table"
        raise ScenarioError(
            f'signals."{name}": expected the derivative of {known}, got {type(signal).__name__}',
            ("signals", name),
        )
    return signal.derivative(order)


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
