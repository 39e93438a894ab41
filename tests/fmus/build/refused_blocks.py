"""Rules of small blocks that must be refused, each with the message."""

import math
import random
import time
from typing import Any

import numpy

from fmus import numerics as n
from fmus.numerics import where

from .small_blocks import Chain, Counter, Inputs, Mode, Number, Parameters, Rule, Switch

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
