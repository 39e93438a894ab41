"""Units by their names over the base units of FMI 2.0 (2.2.2): kg, m, s, A, K, mol, cd and rad.

Names are written as in the standard, "N.s/m", "1/s2", "kg/(m.s)", of symbols that may have SI prefixes.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
PREFIXES = dict(zip("nuµmcdhkMG", (1e-9, 1e-6, 1e-6, 1e-3, 0.01, 0.1, 1e2, 1e3, 1e6, 1e9), strict=True))
_PREFIXED = {*BASES, "g", "Hz", "N", "Pa", "J", "W", "C", "V", "Ohm", "bar", "l", "L"} - {"kg"}
_DEGREE, _TURN = math.pi / 180.0, 2.0 * math.pi
SYMBOLS = {
    **dict.fromkeys((*BASES, "1"), (1.0, "")),
    "%": (0.01, ""),
    "g": (1e-3, "kg"),
    "t": (1e3, "kg"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "d": (86400.0, "s"),
    "Hz": (1.0, "1/s"),
    "l": (1e-3, "m3"),
    "L": (1e-3, "m3"),
    "N": (1.0, "kg.m/s2"),
    "Pa": (1.0, "N/m2"),
    "bar": (1e5, "Pa"),
    "J": (1.0, "N.m"),
    "W": (1.0, "J/s"),
    "C": (1.0, "A.s"),
    "V": (1.0, "W/A"),
    "Ohm": (1.0, "V/A"),
    "deg": (_DEGREE, "rad"),
    "°": (_DEGREE, "rad"),
    "rev": (_TURN, "rad"),
    "rpm": (_TURN / 60.0, "rad/s"),
    "degC": (1.0, "K"),
    "°C": (1.0, "K"),
    "degF": (5.0 / 9.0, "K"),
}
"""Symbol -> the factor and the unit that it stands for; "" for a base unit and for a number without unit."""
# apart from the symbols: an offset has a meaning for a name alone, "degC", and not in "W/degC"
_OFFSETS = {"degC": 273.15, "°C": 273.15, "degF": 459.67 * 5.0 / 9.0}  # K
_POWER = re.compile(r"(1(?!\d)|%|°C?|[^\W\d_]+)(-?\d+)?")


@dataclass(frozen=True)
class UnitDefinition:
    """Unit: value in base units = factor * value in this unit + offset; exponents: of the base units."""

    exponents: dict[str, int] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0


def of_differences(units: Mapping[str, UnitDefinition]) -> dict[str, UnitDefinition]:
    """Returns the units for relative quantities, without offsets (FMI 2.0.5, 2.2.3)."""
    known = {name: unit for name in _OFFSETS if (unit := si_unit(name))}
    return {name: replace(unit, offset=0.0) for name, unit in {**known, **units}.items()}


@cache
def si_unit(name: str) -> UnitDefinition | None:
    """Returns the unit of symbols of `SYMBOLS` with SI prefixes; None for any other name."""
    exponents: dict[str, int] = dict.fromkeys(BASES, 0)
    factor = 1.0
    for i, part in enumerate(name.split("/")):
        # a product behind a division is in parentheses
        if not re.fullmatch(r"[^().]+|\([^()]+\)" if i else r"[^()]+|\([^()]+\)", part):
            return None
        for text in part.strip("()").split("."):
            if not (match := _POWER.fullmatch(text)) or not (symbol := _symbol(match[1])):
                return None
            power = int(match[2] or 1) * (-1 if i else 1)
            factor *= symbol.factor**power
            for base, exponent in symbol.exponents.items():
                exponents[base] += power * exponent
    return UnitDefinition({base: n for base, n in exponents.items() if n}, factor, _OFFSETS.get(name, 0.0))


def _symbol(text: str) -> UnitDefinition | None:
    """Returns the unit of a symbol with or without prefix, without its offset."""
    if text in SYMBOLS:
        factor, name = SYMBOLS[text]
        unit = si_unit(name) or UnitDefinition({text: 1} if text in BASES else {})
        return replace(unit, factor=factor * unit.factor)
    unit = _symbol(text[1:]) if text[:1] in PREFIXES and text[1:] in _PREFIXED else None
    return unit and replace(unit, factor=PREFIXES[text[0]] * unit.factor)
