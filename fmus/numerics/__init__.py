"""Mathematics that means the same on a float and on a CasADi symbol.

Blocks call these functions instead of `math` and `if`, so that one source runs as Python and is
traced to C. Names are those of `math` and NumPy. On floats nothing but the standard library is
imported; CasADi is loaded when the first symbol arrives. Annotations say `float` and `bool` for both.
"""

from fmus.numerics.arrays import interp, interp2d, matmul, ramp_rates, ramps, solve, transpose
from fmus.numerics.choice import (
    all,
    any,
    choose,
    clip,
    logical_and,
    logical_not,
    logical_or,
    logical_xor,
    maximum,
    minimum,
    select,
    where,
)
from fmus.numerics.elementary import (
    absolute,
    acos,
    acosh,
    asin,
    asinh,
    atan,
    atan2,
    atanh,
    cbrt,
    ceil,
    copysign,
    cos,
    cosh,
    degrees,
    dist,
    erf,
    exp,
    exp2,
    expm1,
    floor,
    fmod,
    hypot,
    log,
    log1p,
    log2,
    log10,
    power,
    radians,
    remainder,
    round,
    sign,
    sin,
    sinh,
    sqrt,
    tan,
    tanh,
    trunc,
)
from fmus.numerics.stepping import Clock, rk4_step, sampled

__all__ = [
    "Clock", "absolute", "acos", "acosh", "all", "any", "asin", "asinh", "atan", "atan2", "atanh", "cbrt",
    "ceil", "choose", "clip", "copysign", "cos", "cosh", "degrees", "dist", "erf", "exp", "exp2", "expm1",
    "floor", "fmod", "hypot", "interp", "interp2d", "log", "log1p", "log2", "log10", "logical_and",
    "logical_not", "logical_or", "logical_xor", "matmul", "maximum", "minimum", "power", "radians",
    "ramp_rates", "ramps", "remainder", "rk4_step", "round", "sampled", "select", "sign", "sin", "sinh",
    "solve", "sqrt", "tan", "tanh", "transpose", "trunc", "where",
]  # fmt: skip
