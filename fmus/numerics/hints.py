"""Hints: code for a block in place of an expression that has no meaning on a symbol."""

import ast
import re

from fmus import numerics

# a function of Python or NumPy -> the function of fmus.numerics with another name
COUNTERPARTS = {
    "abs": "absolute", "amax": "maximum", "amin": "minimum", "arccos": "acos", "arccosh": "acosh",
    "arcsin": "asin", "arcsinh": "asinh", "arctan": "atan", "arctan2": "atan2", "arctanh": "atanh",
    "around": "round", "deg2rad": "radians", "dot": "matmul", "fabs": "absolute", "fix": "trunc",
    "float_power": "power", "fmax": "maximum", "fmin": "minimum", "inner": "matmul", "int": "trunc",
    "max": "maximum", "min": "minimum", "piecewise": "select", "pow": "power",
    "rad2deg": "degrees", "rint": "round", "sorted": "minimum", "sumprod": "matmul", "vdot": "matmul",
}  # fmt: skip

# what to do -> functions of Python, its `math` or NumPy that have no counterpart
_ADVICE = {
    "compute it from constants alone": "comb factorial frexp gamma gcd lcm lgamma nextafter perm ulp",
    "leave it out": "bool float float64",
    "use tuples, their comprehensions, and Python's sum": "cross diag diff",
    "leave it out: a step whose results are not finite is refused": "isfinite isinf isnan",
    "use tuples": "array asarray",
    "leave it out, or call the function in a test": "print str",
    "use x + y": "add",
    "use two numbers": "complex",
    "use (*x, *y)": "concatenate",
    "use x / y": "divide",
    "use 1.0 - fmus.numerics.erf(x)": "erfc",
    "use x * y + z": "fma",
    "use sum": "fsum",
    "use fmus.numerics.where": "heaviside",
    "use fmus.numerics.solve": "inv",
    "use fmus.numerics.absolute(x - y) <= tolerance": "isclose",
    "use fmus.numerics.floor(fmus.numerics.sqrt(x))": "isqrt",
    "use x * fmus.numerics.exp2(i)": "ldexp",
    "use sum(x) / len(x)": "mean",
    "use x - y * fmus.numerics.floor(x / y)": "mod",
    "use fmus.numerics.fmod(x, 1.0) and fmus.numerics.trunc(x)": "modf",
    "use x * y": "multiply",
    "use -x": "negative",
    "use fmus.numerics.hypot(*x)": "norm",
    "use math.prod": "prod",
    "use a constant number of turns": "range",
    "use x * x": "square",
    "use x - y": "subtract",
    "use Python's sum": "sum",
}
INSTEAD = {name: advice for advice, names in _ADVICE.items() for name in names.split()}

_OPERATORS = {
    ast.And: "logical_and", ast.BitAnd: "logical_and", ast.Or: "logical_or", ast.BitOr: "logical_or",
    ast.BitXor: "logical_xor", ast.Not: "logical_not", ast.Invert: "logical_not", ast.MatMult: "matmul",
}  # fmt: skip


# pattern of code that needs a whole number, up to the expression inside -> what to do
_INDICES = {r"\brange\([^()]*": INSTEAD["range"], r"[\w)\]]\[[^\[\]]*": "use fmus.numerics.choose"}


def hint(expression: str, statement: str, default: str) -> str:
    """Returns the hint for an expression in a line of code; "" if none is known.

    default: the function of fmus.numerics if the expression does not show it
    """
    if statement.startswith("while "):
        return "use for with a constant number of turns, and fmus.numerics.where in it"
    if statement.startswith("assert "):
        return "use the requirements of the block"
    for before, use in _INDICES.items():
        if expression and re.search(before + re.escape(expression), statement):
            return use
    try:
        name = _name(ast.parse(expression, mode="eval").body)
    except SyntaxError:
        name = ""
    if name in INSTEAD:
        return INSTEAD[name]
    name = COUNTERPARTS.get(name, name)
    function = name if name in numerics.__all__ else default
    return f"use fmus.numerics.{function}" if function else ""


def _name(expression: ast.expr) -> str:
    """Returns the function that an expression calls, or the one that stands for an operator."""
    match expression:
        case ast.JoinedStr():
            return "str"
        case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name)):
            return name
        case ast.Compare(ops=[ast.In() | ast.NotIn()]):
            return "any"
        case ast.Compare(ops=[_, _, *_]):
            return "logical_and"
        case ast.BoolOp(op=operator) | ast.BinOp(op=operator) | ast.UnaryOp(op=operator):
            return _OPERATORS.get(type(operator), "")
    return ""
