"""Small blocks with one output each, which must work or must be refused."""

import math
import random
import time
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
        "Small",
        "A rule for the next state",
        parameters=Parameters,
        inputs=Inputs,
        state=state,
        outputs=Output,
        step=lambda t, h, state, inputs, p, c: rule(state, inputs, p, t, h),
        output=lambda t, state, p, c: Output(1.0 * read(state)),
    )


# What works


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


def one_dimensional(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    return Number(n.interp(u.u, (-2.0, 0.0, 3.0), (1.0, 0.0, 4.0)))


def two_dimensional(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    return Number(n.interp2d(u.u, u.v[0], (0.0, 1.0), (0.0, 2.0, 3.0), ((0.0, 1.0, 5.0), (2.0, 3.0, 4.0))))


def solved(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    matrix = ((4.0, 1.0, u.u / 10.0), (1.0, 5.0, 1.0), (0.0, u.v[0] / 10.0, 6.0))
    return Number(n.solve(matrix, (s.x, *u.v))[1])


def pendulum(s: Chain, u: Inputs, p: Parameters, t: float, h: float) -> Chain:
    rates = n.rk4_step(lambda t, x: (x[1], u.u - n.sin(x[0])), t, s.x[:2], h)
    return Chain((*rates, *s.x[2:]))


GAIN, MATRIX, NAMES = 3.0, numpy.array([[1.0, 2.0], [3.0, 4.0]]), {"slow": 0.5, "fast": 2.0}

WORKING: dict[str, Block] = {
    "tanh of fmus.numerics": block_of(lambda s, u, p, t, h: Number(n.tanh(u.u)), Number),
    "where": block_of(lambda s, u, p, t, h: Number(where(u.u > 0.0, s.x, -1.0)), Number),
    "an untaken division by zero": block_of(
        lambda s, u, p, t, h: Number(where(u.u == 0.0, 1.0, lambda: s.x / u.u)), Number
    ),
    "an untaken root": block_of(
        lambda s, u, p, t, h: Number(where(u.u < 0.0, 0.0, lambda: n.sqrt(u.u))), Number
    ),
    "a table": block_of(one_dimensional, Number),
    "a table of two inputs": block_of(two_dimensional, Number),
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
    "a vector as input": block_of(lambda s, u, p, t, h: Number(n.matmul(p.gains, u.v) + s.x / 2.0), Number),
    "a system of equations": block_of(solved, Number),
    "round": block_of(lambda s, u, p, t, h: Number(n.round(2.0 * u.u) / 2.0), Number),
    "a recursion of fixed depth": block_of(
        lambda s, u, p, t, h: Number(horner((1.0, -2.0, 0.5), u.u)), Number
    ),
    "a loop of fixed length": block_of(lambda s, u, p, t, h: Number(newton(abs(u.u) + 1.0)), Number),
    "a list comprehension": block_of(lambda s, u, p, t, h: Number(sum([x * x for x in u.v])), Number),
    "a constant of the file": block_of(lambda s, u, p, t, h: Number(GAIN * s.x + math.pi * u.u), Number),
    "constants of NumPy": block_of(
        lambda s, u, p, t, h: Number(where(MATRIX[0, 1] * u.u > 0.0, n.matmul(MATRIX, u.v)[0], s.x)), Number
    ),
    "a key that is constant": block_of(lambda s, u, p, t, h: Number(NAMES["slow"] * s.x), Number),
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


# What is refused

COUNT, MEMORY = 0, [0.0]


def branches(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    if s.x > 0.0:
        return Number(u.u)
    return s


def counts_globally(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    global COUNT  # noqa: PLW0603
    COUNT += 1
    return Number(s.x + COUNT)


def remembers(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    MEMORY.append(MEMORY[-1] + 1.0)
    return Number(s.x + MEMORY[-1])


class Remembers:
    """A controller as an object, whose state is hidden from the block."""

    def __init__(self) -> None:
        self.integral: Any = 0.0

    def __call__(self, s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
        self.integral = self.integral + h * u.u
        return Number(self.integral)


def changes_its_argument(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    object.__setattr__(s, "x", s.x + u.u)
    return s


def catches_the_division_by_zero(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    try:
        return Number(s.x / u.u)
    except ZeroDivisionError:
        return Number(0.0)


def loops(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    x = s.x
    while x > 1.0:
        x = x - 1.0
    return Number(x)


def raises(s: Number, u: Inputs, p: Parameters, t: float, h: float) -> Number:
    if u.u < 0.0:
        raise ValueError("negative")
    return s


UNKNOWN = "but the value is not known before the FMU runs"

REFUSED: dict[str, tuple[Rule, str]] = {
    "math": (
        lambda s, u, p, t, h: Number(math.tanh(u.u)),
        f"math.tanh(u.u): a number is needed, {UNKNOWN}; use fmus.numerics.tanh",
    ),
    "NumPy": (
        lambda s, u, p, t, h: Number(numpy.sin(u.u)),
        f"numpy.sin(u.u): NumPy's functions are of numbers, {UNKNOWN}; use fmus.numerics.sin",
    ),
    "NumPy in place of an operator": (
        lambda s, u, p, t, h: Number(numpy.add(s.x, u.u)),
        f"numpy.add(s.x, u.u): NumPy's functions are of numbers, {UNKNOWN}; use x + y",
    ),
    "if": (branches, f"s.x > 0.0: a truth value is needed, {UNKNOWN}; use fmus.numerics.where"),
    "and": (
        lambda s, u, p, t, h: Number(where(u.u > 0.0 and u.is_on, 1.0, 0.0)),
        f"u.u > 0.0 and u.is_on: a truth value is needed, {UNKNOWN}; use fmus.numerics.logical_and",
    ),
    "a chain of comparisons": (
        lambda s, u, p, t, h: Number(where(0.0 < u.u < 1.0, 1.0, 0.0)),
        f"0.0 < u.u < 1.0: a truth value is needed, {UNKNOWN}; use fmus.numerics.logical_and",
    ),
    "max": (
        lambda s, u, p, t, h: Number(max(u.v)),
        f"max(u.v): a truth value is needed, {UNKNOWN}; use fmus.numerics.maximum",
    ),
    "Python's round": (
        lambda s, u, p, t, h: Number(round(u.u)),
        f"round(u.u): Python's is of a number, {UNKNOWN}; use fmus.numerics.round",
    ),
    "a random number": (
        lambda s, u, p, t, h: Number(s.x + random.random()),
        "random.random(): random gives another value at each call; use the time and the state",
    ),
    "a clock": (
        lambda s, u, p, t, h: Number(s.x + time.time()),
        "time.time(): time gives another value at each call; use the time and the state",
    ),
    "a global counter": (
        counts_globally,
        "the global COUNT is assigned, but an FMU has no memory beside its state",
    ),
    "a list that is changed": (remembers, "at one call and"),
    "a key that varies": (
        lambda s, u, p, t, h: Number({Mode.HOLD: 1.0}[p.mode]),
        f"{{Mode.HOLD: 1.0}}[p.mode]: a key is needed, {UNKNOWN}; use fmus.numerics.select",
    ),
    "an index that varies": (
        lambda s, u, p, t, h: Number((1.0, 2.0)[u.count]),
        f"(1.0, 2.0)[u.count]: an integer is needed, {UNKNOWN}; use fmus.numerics.choose",
    ),
    "while": (
        loops,
        f"x > 1.0: a truth value is needed, {UNKNOWN}; use for with a constant number of turns, and "
        "fmus.numerics.where in it",
    ),
    "a range that varies": (
        lambda s, u, p, t, h: Number(sum(s.x for _ in range(u.count))),
        f"range(u.count): an integer is needed, {UNKNOWN}; use a constant number of turns",
    ),
    "an exception": (raises, f"u.u < 0.0: a truth value is needed, {UNKNOWN}; use fmus.numerics.where"),
    "a text": (
        lambda s, u, p, t, h: Number(1.0 if f"{u.u}" else 0.0),
        f"a text is needed, {UNKNOWN}; leave it out, or call the function in a test",
    ),
    "a division by zero": (
        lambda s, u, p, t, h: Number(where(u.u == 0.0, 0.0, s.x / u.u)),
        "s.x / u.u, where compiled code gives numbers; exclude such values with min, max or requirements, or "
        "give an alternative of fmus.numerics.where that is not always legal as a function: lambda: ...",
    ),
    "an exception that is caught": (
        catches_the_division_by_zero,
        "step gives x = 0.0 in Python and inf when it is traced",
    ),
    "an argument that is changed": (
        changes_its_argument,
        "a function changes its arguments, or gives what an earlier call has kept; an FMU has no memory "
        "beside its state",
    ),
    "a list that an object changes": (
        Remembers(),
        "step gives what an earlier call has kept; an FMU has no memory beside its state",
    ),
    "a table that descends": (
        lambda s, u, p, t, h: Number(n.interp(u.u, (1.0, 0.0), (0.0, 1.0))),
        "ValueError: points (1.0, 0.0): expected ascending numbers, of parameters by requirements",
    ),
    "a product of other sizes": (
        lambda s, u, p, t, h: Number(n.matmul([[1.0, 2.0, 3.0]], u.v)[0]),
        "ValueError: matmul of 1 x 3 and a vector of 2: expected as many columns as rows",
    ),
    "a system that is not square": (
        lambda s, u, p, t, h: Number(n.solve(((1.0, 2.0, 0.0), (0.0, 1.0, 1.0)), u.v)[0]),
        "ValueError: solve of 2 x 3 and a vector of 2: expected a square matrix with as many rows",
    ),
    "the operator of matrices": (
        lambda s, u, p, t, h: Number(u.v @ p.gains),  # type: ignore[operator]
        "TypeError: unsupported operand type(s) for @: 'tuple' and 'tuple'; use fmus.numerics.matmul",
    ),
    "an array as a number": (
        lambda s, u, p, t, h: Number(numpy.eye(2)[0]),  # type: ignore[arg-type]
        "step returns Number.x as a ndarray: expected one number",
    ),
    "a state of another shape": (lambda s, u, p, t, h: Chain(), "step returns Chain: expected Number(...)"),
}
REFUSED_STATES: dict[str, tuple[Rule, Any, str]] = {
    "a fraction in an Integer state": (
        lambda s, u, p, t, h: Counter(s.x + 0.5 * u.count),  # type: ignore[arg-type]
        Counter,
        "expected a whole number, as Counter declares it with 0; write 0.0 for any number",
    ),
    "a fraction in a Boolean state": (
        lambda s, u, p, t, h: Switch(0.5 * u.u, s.x),  # type: ignore[arg-type]
        Switch,
        "expected 0 or 1, as Switch declares it with False; write 0.0 for any number",
    ),
}
