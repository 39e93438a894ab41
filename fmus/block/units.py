"""Units that a block may state: all of `fmus.units`, and the units of Pint that FMI can express.

Pint is an extra. It is loaded for a name that `fmus.units` does not define.
"""

import re
from decimal import Decimal
from functools import cache
from typing import Any

from fmus.errors import ExportError, nearest
from fmus.extras import require
from fmus.units import BASES, SYMBOLS, UnitDefinition, si_unit

_PINT_BASES = ("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian")
_PINT_NAMES = dict(zip(_PINT_BASES, BASES, strict=True))
# names for which FMI and Modelica have another spelling, or another unit, than Pint
_DEFINITIONS = ("@alias turn = rev", "@alias ohm = Ohm", "torque_newton_meter = newton * meter = Nm")
_GRAMMAR = re.compile(r"1|(1/)?[^\W\d_(%][\w.%/()-]*|(1/)?[%°][\w./()-]*|1/\([\w.%/()-]*")
_EXPONENT = re.compile(r"(?<=[^\W\d_])(-?\d+)")


def unit(name: str) -> UnitDefinition:
    """Returns the unit of a name.

    Parameters
    ----------
    name : str
        Unit, such as "N.s/m" or "degC".

    Returns
    -------
    UnitDefinition
        Powers of FMI's base units, factor and offset.

    Raises
    ------
    ExportError
        For a name that is unknown, with the nearest one, or that FMI cannot express.

    Examples
    --------
    >>> unit("mm").factor
    0.001
    """
    return si_unit(name) or _by_pint(name)


def display(unit_name: str, display_name: str) -> tuple[float, float]:
    """Returns the change of a value to the unit in which tools show it.

    Parameters
    ----------
    unit_name, display_name : str
        Unit of the variable, and unit in which it is shown.

    Returns
    -------
    tuple of two floats
        Factor and offset: value in the display unit = factor * value in the unit + offset.

    Raises
    ------
    ExportError
        For units of different dimensions.

    Examples
    --------
    >>> display("m", "mm")
    (1000.0, 0.0)
    """
    own, shown = unit(unit_name), unit(display_name)
    if own.exponents != shown.exponents:
        raise ExportError(f"display unit {display_name!r}: expected one of the dimension of {unit_name!r}")
    return own.factor / shown.factor, (own.offset - shown.offset) / shown.factor


def per_second(name: str) -> str:
    """Returns the name of a unit divided by the second.

    Parameters
    ----------
    name : str
        Unit of a variable.

    Returns
    -------
    str
        Unit of its derivative by time.

    Examples
    --------
    >>> per_second("m"), per_second("m/s")
    ('m/s', 'm/s2')
    """
    base, slash, power = name.rpartition("/s")
    if not slash or (power and not power.isdecimal()):
        return f"{name}/s"
    return f"{base}/s{int(power or 1) + 1}"


def rate(name: str) -> UnitDefinition:
    """Returns the unit of a derivative by time, named `per_second(name)`, of a variable of this unit.

    Parameters
    ----------
    name : str
        Unit of the variable.

    Returns
    -------
    UnitDefinition

    Examples
    --------
    >>> rate("km/h").exponents == unit("m/s2").exponents
    True
    """
    of_variable = unit(name)
    exponents = {**of_variable.exponents, "s": of_variable.exponents.get("s", 0) - 1}
    return UnitDefinition({base: power for base, power in exponents.items() if power}, of_variable.factor)


@cache
def _by_pint(name: str) -> UnitDefinition:
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
        known = nearest(unknown, [*SYMBOLS, *dir(_registry())])
        part = "" if unknown == name else f": no unit {unknown!r}"
        raise ExportError(f"unknown unit {name!r}{part}; {known}") from None
    except ExportError:
        raise
    # bits and the like; decibels and other logarithms
    except (KeyError, TypeError) as error:
        raise ExportError(f"unit {name!r}: expected one of powers of {', '.join(BASES)}") from error
    except Exception as error:
        raise ExportError(f"unit {name!r}: expected a name as 'N.s/m', 'kg/(m.s)' or '1/s2'") from error
    if any(power != int(power) for power in powers.values()):
        raise ExportError(f"unit {name!r}: expected one of whole powers of {', '.join(BASES)}")
    exponents = {base: int(powers[base]) for base in BASES if base in powers}
    return UnitDefinition(exponents, float(one.magnitude - origin.magnitude), float(origin.magnitude))


def _check_plurals(name: str) -> None:
    """Refuses the plural of a symbol of at most four letters."""
    # Nms and Pas can be meant as products with s; Pint's rads is a dose of radiation.
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
        non_int_type=exact, preprocessors=[lambda name: _EXPONENT.sub(r"**(\1)", name).replace(".", "*")]
    )
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry
