"""Small blocks with one output each, which must work; `test_verify` has those that must not."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, make_dataclass, replace
from enum import IntEnum
from typing import Any

import numpy

from fmus import numerics as n
from fmus.block import Block, NoValues, variable
from fmus.numerics import Clock, sampled, where


class Mode(IntEnum):
    """What a block does."""

    HOLD = 1
    FOLLOW = 2
    INVERT = 3


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-3, max=1.0)
    mode: Mode = variable(Mode.FOLLOW, "Mode")
    gains: tuple[float, ...] = variable((1.0, -0.5), "Gains")


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.5, "A number", min=-10.0, max=10.0)
    v: tuple[float, ...] = variable((1.0, 2.0), "A vector", min=-10.0, max=10.0)
    is_on: bool = variable(False, "A switch")
    count: int = variable(0, "A whole number", min=-3, max=3)


@dataclass(frozen=True)
class Number:
    x: float = 0.25


@dataclass(frozen=True)
class Output:
    y: float = variable(0.0, "Output")


Rule = Callable[..., Any]  # (state, inputs, parameters, t, h) -> the next state


def block_of(rule: Rule, state: Any = NoValues, read: Callable[[Any], Any] = lambda state: state.x) -> Block:
    return Block(
        name="Small",
        description="A rule for the next state",
        parameters=Parameters,
        inputs=Inputs,
        state=state,
        outputs=Output,
        step=lambda t, h, state, inputs, p, c: rule(state, inputs, p, t, h),
        output=lambda t, state, p, c: Output(1.0 * read(state)),
    )


@dataclass(frozen=True)
class Chain:
    x: tuple[float, ...] = (0.0,) * 30


def filter_of_thirty_states(s: Chain, u: Inputs, p: Parameters, t: float, h: float) -> Chain:
    before = (u.u, *s.x[:-1])
    return Chain(tuple(x + h * (b - x) for x, b in zip(s.x, before, strict=True)))


@dataclass(frozen=True)
class Lowpass:
    """A sub-block: a state and functions of it."""

    x: float = 0.0

    def stepped(self, h: float, value: float, time_constant: float) -> "Lowpass":
        return Lowpass(self.x + h / time_constant * (value - self.x))


@dataclass(frozen=True)
class FilteredIntegral:
    derivative: Lowpass = Lowpass()
    pair: tuple[Lowpass, Lowpass] = (Lowpass(), Lowpass(1.0))
    x: float = 0.0


def sub_blocks(s: FilteredIntegral, u: Inputs, p: Parameters, t: float, h: float) -> FilteredIntegral:
    first, second = s.pair
    pair = first.stepped(h, u.u, 0.5), second.stepped(h, first.x, 2.0)
    return FilteredIntegral(s.derivative.stepped(h, second.x, 1.0), pair, s.x + h * s.derivative.x)


@dataclass(frozen=True)
class Counter:
    x: int = 0


@dataclass(frozen=True)
class Switch:
    is_on: bool = False
    x: float = 0.0


def hysteresis(s: Switch, u: Inputs, p: Parameters, t: float, h: float) -> Switch:
    is_on = where(s.is_on, u.u > -1.0, u.u > 1.0)
    return Switch(is_on, where(n.logical_and(is_on, n.logical_not(u.is_on)), s.x + h, s.x))


@dataclass(frozen=True)
class Choice:
    mode: Mode = Mode.HOLD
    x: float = 0.0


def remembered_mode(s: Choice, u: Inputs, p: Parameters, t: float, h: float) -> Choice:
    mode = where(u.is_on, p.mode, s.mode)
    is_mode = [mode == m for m in (Mode.FOLLOW, Mode.INVERT)]
    return Choice(mode, n.select(is_mode, [u.u, -u.u], default=s.x))


@dataclass(frozen=True)
class SampledMean:
    x: float = 0.0
    clock: Clock = Clock()


def newton(value: Any) -> Any:
    root = 1.0 + 0.0 * value
    for _ in range(6):
        root = 0.5 * (root + value / root)
    return root


def horner(coefficients: tuple[float, ...], value: Any) -> Any:
    head, *tail = coefficients
    return head + value * horner(tuple(tail), value) if tail else head


def one_dimensional(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Any:
    return n.interp(u.u, (-2.0, 0.0, 3.0), (1.0, 0.0, 4.0))


def two_dimensional(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Any:
    return n.interp2d(u.u, u.v[0], (0.0, 1.0), (0.0, 2.0, 3.0), ((0.0, 1.0, 5.0), (2.0, 3.0, 4.0)))


def solved(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Any:
    matrix = ((4.0, 1.0, u.u / 10.0), (1.0, 5.0, 1.0), (0.0, u.v[0] / 10.0, 6.0))
    return n.solve(matrix, (s.x, *u.v))[1]


def pendulum(s: Chain, u: Inputs, p: Parameters, t: float, h: float) -> Chain:
    rates = n.rk4_step(lambda t, x: (x[1], u.u - n.sin(x[0])), t, s.x[:2], h)
    return Chain((*rates, *s.x[2:]))


GAIN, MATRIX, NAMES = 3.0, numpy.array([[1.0, 2.0], [3.0, 4.0]]), {"slow": 0.5, "fast": 2.0}


def number_of(expression: Rule) -> Block:
    """A block whose next state is one number, that of the expression."""
    return block_of(lambda *arguments: Number(expression(*arguments)), Number)


WORKING: dict[str, Block] = {
    "tanh of fmus.numerics": number_of(lambda s, u, p, t, h: n.tanh(u.u)),
    "where": number_of(lambda s, u, p, t, h: where(u.u > 0.0, s.x, -1.0)),
    "an untaken division by zero": number_of(lambda s, u, p, t, h: where(u.u == 0.0, 1.0, lambda: s.x / u.u)),
    "an untaken root": number_of(lambda s, u, p, t, h: where(u.u < 0.0, 0.0, lambda: n.sqrt(u.u))),
    "a table": number_of(one_dimensional),
    "a table of two inputs": number_of(two_dimensional),
    "a filter of thirty states": block_of(filter_of_thirty_states, Chain, lambda s: s.x[-1]),
    "sub-blocks": block_of(sub_blocks, FilteredIntegral),
    "an Integer state": block_of(
        lambda s, u, p, t, h: Counter(where(s.x + u.count > 10, 0, s.x + u.count)), Counter
    ),
    "a Boolean state": block_of(hysteresis, Switch),
    "an Enumeration state": block_of(remembered_mode, Choice),
    "a sampled part": block_of(
        lambda s, u, p, t, h: sampled(t, 0.25, s, SampledMean(0.5 * (s.x + u.u))), SampledMean
    ),
    "a vector as input": number_of(lambda s, u, p, t, h: n.matmul(p.gains, u.v) + s.x / 2.0),
    "a system of equations": number_of(solved),
    "round": number_of(lambda s, u, p, t, h: n.round(2.0 * u.u) / 2.0),
    "a recursion of fixed depth": number_of(lambda s, u, p, t, h: horner((1.0, -2.0, 0.5), u.u)),
    "a loop of fixed length": number_of(lambda s, u, p, t, h: newton(abs(u.u) + 1.0)),
    "a list comprehension": number_of(lambda s, u, p, t, h: sum([x * x for x in u.v])),
    "a constant of the file": number_of(lambda s, u, p, t, h: GAIN * s.x + math.pi * u.u),
    "constants of NumPy": number_of(
        lambda s, u, p, t, h: where(MATRIX[0, 1] * u.u > 0.0, n.matmul(MATRIX, u.v)[0], s.x)
    ),
    "a key that is constant": number_of(lambda s, u, p, t, h: NAMES["slow"] * s.x),
    "a differential equation": block_of(pendulum, Chain, lambda s: s.x[0]),
    "replace": block_of(lambda s, u, p, t, h: replace(s, x=u.u), FilteredIntegral),
}


def one_block_of_all() -> Block:
    """Every working block as a sub-block, with one output each."""
    blocks = {f"b{i}": block for i, block in enumerate(WORKING.values())}
    state = make_dataclass(
        "All", [(name, b.state, field(default=b.state())) for name, b in blocks.items()], frozen=True
    )
    outputs = make_dataclass(
        "Outputs", [(name, float, variable(0.0, f"Output of {name}")) for name in blocks], frozen=True
    )
    return Block(
        "All",
        "Small blocks side by side",
        parameters=Parameters,
        inputs=Inputs,
        state=state,
        outputs=outputs,
        step=lambda t, h, s, u, p, c: state(
            *[b.step(t, h, getattr(s, name), u, p, c) for name, b in blocks.items()]
        ),
        output=lambda t, s, p, c: outputs(
            *[b.output(t, getattr(s, name), p, c).y for name, b in blocks.items()]
        ),
    )
