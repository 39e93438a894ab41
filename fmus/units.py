"""Unit names and their exponents over the SI base units, as FMI's `BaseUnit` wants them."""

from fmus.errors import ExportError, nearest

# Every unit used here is coherent: factor 1, offset 0. "1" is dimensionless.
BASE_UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "s": {"s": 1},
    "1/s": {"s": -1},
    "1/s2": {"s": -2},
    "m": {"m": 1},
    "m2": {"m": 2},
    "m/s": {"m": 1, "s": -1},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "kg": {"kg": 1},
    "s/kg": {"s": 1, "kg": -1},
    "1/kg": {"kg": -1},
    "kg/m3": {"kg": 1, "m": -3},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N/m": {"kg": 1, "s": -2},
    "N/(m.s)": {"kg": 1, "s": -3},
    "N.s/m": {"kg": 1, "s": -1},
    "N.s2/m2": {"kg": 1, "m": -1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "N/V": {"m": -1, "s": 1, "A": 1},
}


def base_units(unit: str) -> dict[str, int]:
    """Exponents of a unit over kg, m, s, A, rad; ExportError names the nearest known unit."""
    if unit not in BASE_UNITS:
        raise ExportError(f"unknown unit {unit!r}; {nearest(unit, BASE_UNITS)}")
    return BASE_UNITS[unit]
