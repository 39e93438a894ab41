"""Units over the base units of FMI 2.0 (2.2.2): kg, m, s, A, K, mol, cd and rad.

Names are written as in the standard: "N.s/m", "1/s2", "kg/(m.s)", "rev/min", "degC". Pint knows what they
mean; it is an extra, and loaded for a name that the table below does not have.
"""

import re
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cache
from typing import Any

from fmus.errors import ExportError, nearest
from fmus.extras import require

# Coherent units, by their exponents over the base units. "1" is dimensionless.
BASE_UNITS: dict[str, dict[str, int]] = {
    "1": {}, "s": {"s": 1}, "1/s": {"s": -1}, "1/s2": {"s": -2}, "1/s3": {"s": -3}, "s2": {"s": 2},
    "Hz": {"s": -1},
    "m": {"m": 1}, "1/m": {"m": -1}, "m2": {"m": 2}, "m3": {"m": 3},
    "m/s": {"m": 1, "s": -1}, "m/s2": {"m": 1, "s": -2},
    "rad": {"rad": 1}, "rad/s": {"rad": 1, "s": -1}, "rad/s2": {"rad": 1, "s": -2},
    "kg": {"kg": 1}, "s/kg": {"s": 1, "kg": -1}, "1/kg": {"kg": -1}, "kg/m3": {"kg": 1, "m": -3},
    "kg.m2": {"kg": 1, "m": 2},
    "N": {"kg": 1, "m": 1, "s": -2}, "N.m": {"kg": 1, "m": 2, "s": -2}, "N/s": {"kg": 1, "m": 1, "s": -3},
    "N/s2": {"kg": 1, "m": 1, "s": -4},
    "N/m": {"kg": 1, "s": -2}, "N/(m.s)": {"kg": 1, "s": -3}, "N.s/m": {"kg": 1, "s": -1},
    "N.s2/m2": {"kg": 1, "m": -1}, "N.m.s": {"kg": 1, "m": 2, "s": -1}, "N.m.s2": {"kg": 1, "m": 2},
    "Pa": {"kg": 1, "m": -1, "s": -2}, "J": {"kg": 1, "m": 2, "s": -2}, "W": {"kg": 1, "m": 2, "s": -3},
    "A": {"A": 1}, "C": {"A": 1, "s": 1}, "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "N/V": {"m": -1, "s": 1, "A": 1}, "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "K": {"K": 1}, "mol": {"mol": 1}, "cd": {"cd": 1},
}  # fmt: skip
_PINT_NAMES = {
    "kilogram": "kg", "meter": "m", "second": "s", "ampere": "A",
    "kelvin": "K", "mole": "mol", "candela": "cd", "radian": "rad",
}  # fmt: skip
# where FMI and Modelica write a name otherwise than Pint, or mean another unit by it
_DEFINITIONS = ("@alias turn = rev", "@alias ohm = Ohm", "torque_newton_meter = newton * meter = Nm")
_BASES = tuple(_PINT_NAMES.values())
_GRAMMAR = re.compile(r"1|(1/)?[^\W\d_(%][\w.%/()-]*|(1/)?[%°][\w./()-]*|1/\([\w.%/()-]*")
_EXPONENT = re.compile(r"(?<=[^\W\d_])(-?\d+)")


@dataclass(frozen=True)
class UnitDefinition:
    """Unit: value in base units = factor * value in this unit + offset; exponents: of the base units."""

    exponents: dict[str, int] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0


@cache
def unit(name: str) -> UnitDefinition:
    """Returns the unit of a name; ExportError, with the nearest name, for one that FMI cannot express."""
    exponents, factor, offset = _converted(name)
    return UnitDefinition(exponents, float(factor), float(offset))


def display(unit_name: str, display_name: str) -> tuple[float, float]:
    """Returns (factor, offset): value in the display unit = factor * value in the unit + offset.

    Raises ExportError for units of different dimensions.
    """
    (exponents, factor, offset), (others, divisor, shift) = _converted(unit_name), _converted(display_name)
    if exponents != others:
        raise ExportError(f"display unit {display_name!r}: expected one of the dimension of {unit_name!r}")
    return float(factor / divisor), float((offset - shift) / divisor)


def per_second(name: str) -> str:
    """Returns the name of a unit divided by the second."""
    base, slash, power = name.rpartition("/s")
    if not slash or (power and not power.isdecimal()):
        return f"{name}/s"
    return f"{base}/s{int(power or 1) + 1}"


def rate(name: str) -> UnitDefinition:
    """Returns the unit of a derivative by time, named `per_second(name)`, of a variable of this unit."""
    of_variable = unit(name)
    exponents = {**of_variable.exponents, "s": of_variable.exponents.get("s", 0) - 1}
    return UnitDefinition({base: power for base, power in exponents.items() if power}, of_variable.factor)


@cache
def _converted(name: str) -> tuple[dict[str, int], Decimal, Decimal]:
    """Returns (exponents, factor, offset), exact but for irrational factors."""
    if name in BASE_UNITS:
        return BASE_UNITS[name], Decimal(1), Decimal(0)
    pint = require("pint", "units", f"unit {name!r}")
    try:
        if not _GRAMMAR.fullmatch(name):
            raise ValueError(name)
        parsed = _registry().parse_units(name)
        _check_plurals(name)
        origin, one = (_registry().Quantity(Decimal(i), parsed).to_base_units() for i in range(2))
        powers = {_PINT_NAMES[base]: power for base, power in origin.unit_items()}
    except pint.UndefinedUnitError as error:
        unknown = error.unit_names if isinstance(error.unit_names, str) else error.unit_names[0]
        known = nearest(unknown, [*BASE_UNITS, *dir(_registry())])
        part = "" if unknown == name else f": no unit {unknown!r}"
        raise ExportError(f"unknown unit {name!r}{part}; {known}") from None
    except ExportError:
        raise
    except (KeyError, TypeError) as error:  # bits and the like; decibels and other logarithms
        raise ExportError(f"unit {name!r}: expected one of powers of {', '.join(_BASES)}") from error
    except Exception as error:
        raise ExportError(f"unit {name!r}: expected a name as 'N.s/m', 'kg/(m.s)' or '1/s2'") from error
    if any(power != int(power) for power in powers.values()):
        raise ExportError(f"unit {name!r}: expected one of whole powers of {', '.join(_BASES)}")
    exponents = {base: int(powers[base]) for base in _BASES if base in powers}
    return exponents, one.magnitude - origin.magnitude, origin.magnitude


def _check_plurals(name: str) -> None:
    """Refuses the plural of a symbol, of at most four letters: Nms and Pas can be meant as products with s.

    Pint's rads is a dose of radiation.
    """
    if re.search(r"(?<![^\W\d])rads(?![^\W\d])", name):
        raise ExportError(f"unit {name!r}: no unit 'rads'; nearest is 'rad/s'")
    for symbol in re.findall(r"(?<![^\W\d])([^\W\d]{2,4})s(?![^\W\d])", name):
        one, several = (_registry().parse_unit_name(token)[:1] for token in (symbol, f"{symbol}s"))
        if one and one == several and not symbol.endswith(one[0][1]):
            raise ExportError(
                f"unit {name!r}: '{symbol}s' is a plural of {symbol!r}: expected {symbol!r} or '{symbol}.s'"
            )


@cache
def _registry() -> Any:
    exact: Any = Decimal
    registry = require("pint", "units", "a unit").UnitRegistry(
        non_int_type=exact,
        preprocessors=[lambda name: _EXPONENT.sub(r"**(\1)", name).replace(".", "*")],
    )
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry
