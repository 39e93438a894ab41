"""The derivative of a traced expression by a step's length h, at h = 0, from the right.

    lim (d/dh) y(h)   as h falls to 0

Each operation is evaluated for a pair: its value just after h = 0, and the derivative there. A comparison of
equal numbers is decided by their derivatives: so a limit, a minimum or an absolute value takes the branch
that the step takes, where CasADi takes the mean of the slopes of both. What jumps at h = 0, such as the sign
of a number that leaves 0, has its value after the jump. Numbers that part with equal derivatives count as
equal in comparisons; where a root or a jump depends on how they part, as in sqrt(h^2), the result is NaN.

A choice such as where(h > 0.0, change / h, limit) takes `limit`, as the other is no number at h = 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, reduce

import casadi


@dataclass(frozen=True, eq=False)
class _Pair:
    """A number just after h = 0 and its derivative there.

    moves: whether it depends on h
    rests: whether it is known to be constant just after h = 0
    at_zero: of a condition, whether it holds at h = 0 itself
    code, arguments: of the operation that gave it
    """

    value: casadi.SX
    slope: casadi.SX
    moves: bool = False
    rests: casadi.SX = field(default_factory=lambda: casadi.SX(1.0))
    at_zero: casadi.SX | None = None
    code: int = casadi.OP_CONST
    arguments: tuple["_Pair", ...] = ()

    @property
    def holds_at_zero(self) -> casadi.SX:
        return self.value if self.at_zero is None else self.at_zero


_ZERO = casadi.SX(0.0)
_COMPARISONS = (casadi.OP_LT, casadi.OP_LE, casadi.OP_EQ, casadi.OP_NE)
_LOGIC = (casadi.OP_NOT, casadi.OP_AND, casadi.OP_OR)


def right_derivative(expression: casadi.SX, h: casadi.SX) -> casadi.SX:
    """Returns the derivative of each element by h, at h = 0, from the right."""
    known = casadi.vertcat(*(s for s in casadi.symvar(expression) if not casadi.is_equal(s, h)))
    function = casadi.Function("reached", [h, known], [expression])
    held: dict[int, _Pair] = {}  # by number of a cell in CasADi's memory
    result = casadi.SX.zeros(expression.numel(), 1)
    for i in range(function.n_instructions()):
        code, to = function.instruction_id(i), function.instruction_output(i)
        used = function.instruction_input(i)
        if code == casadi.OP_OUTPUT:
            result[to[1]] = held[used[0]].slope
        elif code == casadi.OP_INPUT:
            held[to[0]] = (
                _Pair(known[used[1]], _ZERO) if used[0] else _Pair(_ZERO, casadi.SX(1.0), True, _ZERO)
            )
        elif code == casadi.OP_CONST:
            held[to[0]] = _Pair(casadi.SX(function.instruction_constant(i)), _ZERO)
        else:
            held[to[0]] = _operate(code, tuple(held[number] for number in used))
    return result


def _operate(code: int, arguments: tuple[_Pair, ...]) -> _Pair:
    value = _plain(code, *(a.value for a in arguments))
    if not any(a.moves for a in arguments):
        return _Pair(value, _ZERO)
    at_zero = None
    if code in _COMPARISONS:
        at_zero = value
    elif code in _LOGIC:
        at_zero = _plain(code, *(a.holds_at_zero for a in arguments))
    rule = _choice if code == casadi.OP_ADD and _is_choice(*arguments) else _RULES.get(code)
    value, slope = rule(*arguments) if rule else (value, _chained(code, arguments))
    return _Pair(value, slope, True, _rests(code, arguments), at_zero, code, arguments)


def _rests(code: int, arguments: tuple[_Pair, ...]) -> casadi.SX:
    """Whether the result of an operation is known to be constant just after h = 0."""
    if code in _WHOLE:
        return casadi.SX(1.0)
    if code in (casadi.OP_FMIN, casadi.OP_FMAX):
        a, b = arguments
        a_is_taken, b_is_taken = (_is_less(b, a), _is_less(a, b))[:: 1 if code == casadi.OP_FMAX else -1]
        return casadi.if_else(
            a_is_taken, a.rests, casadi.if_else(b_is_taken, b.rests, _all(a.rests, b.rests))
        )
    if code == casadi.OP_IF_ELSE_ZERO:
        return casadi.if_else(arguments[0].value, arguments[1].rests, 1.0)
    return _all(*(a.rests for a in arguments))


def _all(*conditions: casadi.SX) -> casadi.SX:
    if any(condition.is_zero() for condition in conditions):
        return _ZERO
    return reduce(casadi.logic_and, (c for c in conditions if not c.is_one()), casadi.SX(1.0))


def _plain(code: int, *values: casadi.SX) -> casadi.SX:
    return (casadi.SX.unary if len(values) == 1 else casadi.SX.binary)(code, *values)


@cache
def _partial(code: int, count: int, index: int) -> casadi.Function:
    """Returns the partial derivative of an operation without corners."""
    symbols = [casadi.SX.sym("a") for _ in range(count)]
    derivative = casadi.jacobian(_plain(code, *symbols), symbols[index])
    return casadi.Function("partial", symbols, [casadi.densify(derivative)])


def _chained(code: int, arguments: tuple[_Pair, ...]) -> casadi.SX:
    """Returns the derivative of an operation without corners; 0 of what rests, even at an infinite slope."""
    slope = _ZERO
    for index, argument in enumerate(arguments):
        if argument.moves:
            partial = _partial(code, len(arguments), index)(*(a.value for a in arguments))
            part = partial * argument.slope
            if code in _STEEP:
                is_infinite = casadi.logic_not(casadi.fabs(partial) < math.inf)
                part = casadi.if_else(argument.slope == 0.0, _or_unknown(argument, is_infinite, _ZERO), part)
            slope += part
    return slope


ValueAndSlope = tuple[casadi.SX, casadi.SX]
Rule = Callable[..., ValueAndSlope]


def _is_less(a: _Pair, b: _Pair) -> casadi.SX:
    parts = casadi.logic_and(a.value == b.value, a.slope < b.slope)
    return casadi.logic_or(a.value < b.value, parts)


def _is_equal(a: _Pair, b: _Pair) -> casadi.SX:
    return casadi.logic_and(a.value == b.value, a.slope == b.slope)


def _condition(holds: Callable[[_Pair, _Pair], casadi.SX]) -> Rule:
    return lambda a, b: (holds(a, b), _ZERO)


def _one_of(condition: casadi.SX, a: _Pair, b: _Pair) -> ValueAndSlope:
    return casadi.if_else(condition, a.value, b.value), casadi.if_else(condition, a.slope, b.slope)


def _or_unknown(a: _Pair, jumps: casadi.SX, value: casadi.SX) -> casadi.SX:
    """Returns the value of what may jump at h = 0: NaN if it jumps where a has slope 0 and does not rest."""
    is_unknown = casadi.logic_and(jumps, casadi.logic_and(a.slope == 0.0, casadi.logic_not(a.rests)))
    return casadi.if_else(is_unknown, math.nan, value)


def _plain_sign(a: _Pair) -> casadi.SX:
    return casadi.if_else(a.value == 0.0, casadi.sign(a.slope), casadi.sign(a.value))


def _sign(a: _Pair) -> ValueAndSlope:
    return _or_unknown(a, a.value == 0.0, _plain_sign(a)), _ZERO


def _absolute(a: _Pair) -> ValueAndSlope:
    return casadi.fabs(a.value), _plain_sign(a) * a.slope


def _copysign(a: _Pair, b: _Pair) -> ValueAndSlope:
    leaves_zero = casadi.logic_and(b.value == 0.0, b.slope != 0.0)
    sign = casadi.if_else(leaves_zero, casadi.sign(b.slope), casadi.copysign(1.0, b.value))
    sign = _or_unknown(b, b.value == 0.0, sign)
    value, slope = _absolute(a)
    return sign * value, sign * slope


def _stepped(code: int, towards: float) -> Rule:
    """Returns the rule of floor or ceil: a whole number that moves on has the value beyond the jump."""

    def rule(a: _Pair) -> ValueAndSlope:
        value = _plain(code, a.value)
        leaves = casadi.logic_and(value == a.value, towards * a.slope > 0.0)
        value_after = casadi.if_else(leaves, value + towards, value)
        return _or_unknown(a, value == a.value, value_after), _ZERO

    return rule


def _fmod(a: _Pair, b: _Pair) -> ValueAndSlope:
    """Returns r = a - n b with a whole number n, between 0 and b; at 0 it jumps to |b| if a falls."""
    value = _plain(casadi.OP_FMOD, a.value, b.value)
    slope = a.slope - (a.value - value) / b.value * b.slope
    is_at_end = casadi.logic_and(value == 0.0, a.value != 0.0)
    jumps = casadi.logic_and(is_at_end, slope * a.value < 0.0)
    after = casadi.if_else(jumps, casadi.copysign(b.value, a.value), value)
    value = _or_unknown(_Pair(value, slope, rests=_all(a.rests, b.rests)), is_at_end, after)
    return value, a.slope - (a.value - value) / b.value * b.slope


def _remainder(a: _Pair, b: _Pair) -> ValueAndSlope:
    """Returns r = a - n b with a whole number n, between -b/2 and b/2, where it jumps to the other end."""
    value = _plain(casadi.OP_REMAINDER, a.value, b.value)
    slope = a.slope - (a.value - value) / b.value * b.slope
    outwards = slope * casadi.sign(value) - casadi.sign(b.value) * b.slope / 2.0
    is_at_end = 2.0 * casadi.fabs(value) == casadi.fabs(b.value)
    after = casadi.if_else(casadi.logic_and(is_at_end, outwards > 0.0), -value, value)
    value = _or_unknown(_Pair(value, outwards, rests=_all(a.rests, b.rests)), is_at_end, after)
    return value, a.slope - (a.value - value) / b.value * b.slope


def _if_holds(condition: _Pair, a: _Pair) -> ValueAndSlope:
    return (
        _plain(casadi.OP_IF_ELSE_ZERO, condition.value, a.value),
        _plain(casadi.OP_IF_ELSE_ZERO, condition.value, a.slope),
    )


def _is_choice(first: _Pair, second: _Pair) -> bool:
    """Whether a sum is of two terms, of which a condition makes the one or the other 0."""
    if not first.code == second.code == casadi.OP_IF_ELSE_ZERO:
        return False
    condition, opposite = first.arguments[0], second.arguments[0]
    return any(
        b.code == casadi.OP_NOT and b.arguments[0] is a
        for a, b in ((condition, opposite), (opposite, condition))
    )


def _choice(first: _Pair, second: _Pair) -> ValueAndSlope:
    """Returns the alternative after h = 0, or that of h = 0 itself where the one after is no number."""
    (condition, a), (_, b) = first.arguments, second.arguments
    value, slope = _one_of(condition.value, a, b)
    is_number = casadi.logic_and(casadi.fabs(value) < math.inf, casadi.fabs(slope) < math.inf)
    holds = casadi.if_else(is_number, condition.value, condition.holds_at_zero)
    return _one_of(holds, a, b)


_RULES: dict[int, Rule] = {
    casadi.OP_LT: _condition(_is_less),
    casadi.OP_LE: _condition(lambda a, b: casadi.logic_not(_is_less(b, a))),
    casadi.OP_EQ: _condition(_is_equal),
    casadi.OP_NE: _condition(lambda a, b: casadi.logic_not(_is_equal(a, b))),
    casadi.OP_FMIN: lambda a, b: _one_of(_is_less(b, a), b, a),
    casadi.OP_FMAX: lambda a, b: _one_of(_is_less(a, b), b, a),
    casadi.OP_FABS: _absolute,
    casadi.OP_SIGN: _sign,
    casadi.OP_COPYSIGN: _copysign,
    casadi.OP_FLOOR: _stepped(casadi.OP_FLOOR, -1.0),
    casadi.OP_CEIL: _stepped(casadi.OP_CEIL, 1.0),
    casadi.OP_FMOD: _fmod,
    casadi.OP_REMAINDER: _remainder,
    casadi.OP_IF_ELSE_ZERO: _if_holds,
}
_WHOLE = {*_COMPARISONS, *_LOGIC, casadi.OP_SIGN, casadi.OP_FLOOR, casadi.OP_CEIL}
"""What they give is constant just after h = 0."""
_STEEP = {
    casadi.OP_SQRT, casadi.OP_POW, casadi.OP_CONSTPOW, casadi.OP_ASIN, casadi.OP_ACOS, casadi.OP_ACOSH,
}  # fmt: skip
"""Finite at the end of their range, where their derivative is infinite."""
