"""Derivatives by the length of a step beside difference quotients, also where numbers are at a limit."""

import random
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import casadi
import numpy as np
import pytest

from fmus import numerics as n
from fmus.block import Block
from fmus.block.scalars import flatten
from fmus.build import builder
from fmus.build.random_points import disturbed, drawn
from fmus.build.right_derivative import right_derivative
from fmus.build.symbolic import traced

Function = Callable[[Any], Any]
START, POINTS = 0.013, 40  # s; of each block

AT_A_CORNER: dict[str, tuple[Function, float]] = {
    "a limit that is left": (lambda h: n.clip(1.0 - 3.0 * h, -1.0, 1.0), -3.0),
    "a limit that holds": (lambda h: n.clip(1.0 + 3.0 * h, -1.0, 1.0), 0.0),
    "a limit that moves": (lambda h: n.clip(4.0 * h, -2.0 * h, 2.0 * h), 2.0),
    "the smaller of two that part": (lambda h: n.minimum(2.0 * h, h), 1.0),
    "the larger of two that part": (lambda h: n.maximum(-h, n.minimum(h, 2.0 * h)), 1.0),
    "an absolute value": (lambda h: abs(n.sin(-2.0 * h)), 2.0),
    "a choice by a sign": (lambda h: n.where(-h < 0.0, 5.0 * h, h), 5.0),
    "a choice by its opposite": (lambda h: n.where(n.logical_not(-h < 0.0), 5.0 * h, h), 1.0),
    "a choice by two conditions": (lambda h: n.where(n.logical_and(h > 0.0, -h <= 0.0), 5.0 * h, h), 5.0),
    "a choice between equals": (lambda h: n.where(2.0 * h == h + h, 5.0 * h, h), 5.0),
    "a sign that appears": (lambda h: n.sign(-h) * n.exp(2.0 * h), -2.0),
    "a copied sign": (lambda h: n.copysign(n.exp(2.0 * h), -h), -2.0),
    "a whole number that is left downwards": (lambda h: n.floor(3.0 - h) * h, 2.0),
    "a whole number that is left upwards": (lambda h: n.ceil(3.0 + h) * h, 4.0),
    "a remainder": (lambda h: n.fmod(2.5 + h, 1.0), 1.0),
    "a remainder of a modulus that grows": (lambda h: n.fmod(2.5 + h, 1.0 + h), -1.0),
    "a half remainder of a modulus that grows": (lambda h: n.remainder(2.5 + 2.25 * h, 1.0 + h), 0.25),
    "a half remainder of a modulus that shrinks": (lambda h: n.remainder(2.5, 1.0 - h), 3.0),
    "a whole number that is cut downwards": (lambda h: n.trunc(2.0 - h) * (2.0 - h), -1.0),
    "a whole number that is cut upwards": (lambda h: n.trunc(h - 2.0) * (h - 2.0), -1.0),
    "a whole number that is cut no more": (lambda h: n.trunc(2.0 + h) * (2.0 + h), 2.0),
    "a half that is rounded up": (lambda h: n.round(2.5 + h) * h, 3.0),
    "a half that is rounded down": (lambda h: n.round(3.5 - h) * h, 3.0),
    "a root of a limit that holds": (lambda h: n.sqrt(n.maximum(0.0, -h)) + h, 1.0),
    "a root of what rests": (lambda h: n.sqrt(0.0 * h) + h, 1.0),
    "a quotient that a condition guards": (lambda h: n.where(h > 0.0, lambda: n.sin(h) / h, 1.0), 0.0),
}  # fmt: skip


UNKNOWN: dict[str, Function] = {
    "a root": lambda h: n.sqrt((3.0 * h) ** 2 + (6.0 * h) ** 2),
    "a root of a limit": lambda h: n.sqrt(n.maximum(0.0, h * h)),
    "a sign": lambda h: n.sign(h * h) * n.exp(h),
    "a copied sign": lambda h: n.copysign(1.0, -h * h) * h,
    "a whole number": lambda h: n.floor(2.0 - h * h) * h,
    "a cut number": lambda h: n.trunc(2.0 - h * h) * h,
    "a rounded number": lambda h: n.round(2.5 + h * h) * h,
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_leaves_a_corner_with_slope_0_has_no_known_slope(name: str) -> None:
    """First derivatives do not tell to which side it leaves: that is no number, and not 0."""
    h = casadi.SX.sym("h")
    assert np.isnan(float(casadi.evalf(right_derivative(casadi.SX(UNKNOWN[name](h)), h))))


@pytest.mark.parametrize("name", AT_A_CORNER)
def test_a_corner_has_the_slope_of_its_right_side(name: str) -> None:
    function, slope = AT_A_CORNER[name]
    h = casadi.SX.sym("h")
    assert float(casadi.evalf(right_derivative(casadi.SX(function(h)), h))) == pytest.approx(slope, abs=1e-15)
    quotient = (function(2e-6) - function(1e-6)) / 1e-6
    assert quotient == pytest.approx(slope, abs=1e-5)  # a curvature of 4 at most


def points(block: Block, count: int) -> Iterator[tuple[Any, ...]]:
    """States, inputs, parameters and what is calculated; many are at 0 or at the end of their range."""
    rng = random.Random(block.name)
    while count:
        p = drawn(block, "parameter", block.parameters, rng.choice((0.0, 0.1)), rng)
        c = block.calculate(p)
        if all(holds for holds, _ in block.requirements(p, c)):
            u = drawn(block, "input", block.inputs, 0.5, rng)
            x = block.initial_state(START, u, p, c)
            yield x if rng.random() < 0.2 else disturbed(x, rng), u, p, c
            count -= 1


@pytest.mark.parametrize("name", builder.block_names())
def test_the_rates_of_a_block_are_the_slopes_of_its_steps(name: str) -> None:
    """The outputs of steps of h and 2 h, in Python, with h short enough that a tenth of it gives the same."""
    block, compared = builder.load_block(name), 0
    for x, u, p, c in points(block, POINTS):

        def reached(h: float) -> np.ndarray:
            return np.array(flatten(block.output(START + h, block.advance(START, h, x, u, p, c), p, c)))  # noqa: B023

        rates = np.array(traced(block).output_rate(START, *map(flatten, (x, u, p, c)))).ravel()
        with suppress(ArithmeticError, ValueError):  # a state that the block does not have
            coarse, fine, finest = ((reached(2.0 * h) - reached(h)) / h for h in (1e-6, 1e-7, 1e-9))
            is_settled = np.abs(coarse - fine) <= 1e-3 * (1.0 + np.abs(fine))
            # an estimate may be at its bound after the first of 1e-7 s; 1e-6: rounding over 1e-9 s
            rounding = 1e-6 * np.abs(reached(0.0))
            is_settled &= np.abs(finest - fine) <= 1e-3 * (1.0 + np.abs(fine)) + rounding
            assert rates[is_settled] == pytest.approx(fine[is_settled], rel=2e-3, abs=2e-3)
            compared += bool(is_settled.any())
    assert compared > 0.8 * POINTS
