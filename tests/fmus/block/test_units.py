"""What the name of a unit means over the base units of FMI 2.0 and which names mean nothing."""

import math
import re
import sys

import pytest

from fmus.block.units import _by_pint, display, per_second, rate, unit
from fmus.errors import ExportError, MissingExtraError
from fmus.units import SYMBOLS, UnitDefinition, si_unit


@pytest.mark.parametrize(
    "name", [*SYMBOLS, "cm", "us", "kN", "km/h", "N.s2/m2", "kg/(m.s)", "dl/min", "MOhm"]
)
def test_the_names_in_si_units_mean_what_pint_says(name: str) -> None:
    own, of_pint = unit(name), _by_pint({"1": "m/m", "°C": "degC"}.get(name, name))
    assert own.exponents == of_pint.exponents
    # a rounding for each symbol
    assert (own.factor, own.offset) == pytest.approx((of_pint.factor, of_pint.offset), rel=1e-15)


@pytest.mark.parametrize(
    "name", ["", "x", "12", "m/", "kg/m.s", "N/(m/s)", "ks2x", "3 m", "mmin", "kdeg", "(m"]
)
def test_other_names_are_left_to_pint(name: str) -> None:
    assert si_unit(name) is None


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("deg", UnitDefinition({"rad": 1}, 0.017453292519943295)),
        ("rev/min", UnitDefinition({"rad": 1, "s": -1}, 0.10471975511965977)),
        ("degC", UnitDefinition({"K": 1}, 1.0, 273.15)),
        ("degF", UnitDefinition({"K": 1}, 5.0 / 9.0, 459.67 * 5.0 / 9.0)),
        # a difference of temperatures has no offset
        ("degC/min", UnitDefinition({"K": 1, "s": -1}, 1.0 / 60.0)),
        ("Nm", UnitDefinition({"kg": 1, "m": 2, "s": -2})),
        ("m.s-2", UnitDefinition({"m": 1, "s": -2})),
        ("W/(m2.K)", UnitDefinition({"kg": 1, "s": -3, "K": -1})),
        ("l/min", UnitDefinition({"m": 3, "s": -1}, 1e-3 / 60.0)),
        ("kWh", UnitDefinition({"kg": 1, "m": 2, "s": -2}, 3.6e6)),
        ("mol/l", UnitDefinition({"mol": 1, "m": -3}, 1e3)),
        ("lm", UnitDefinition({"cd": 1, "rad": 2})),
        ("%", UnitDefinition({}, 0.01)),
        ("metres", UnitDefinition({"m": 1})),  # the plural of a name, not of a symbol
        ("days", UnitDefinition({"s": 1}, 86400.0)),
        ("ms", UnitDefinition({"s": 1}, 1e-3)),
    ],
)
def test_a_value_in_base_units_is_factor_times_value_plus_offset(name: str, expected: UnitDefinition) -> None:
    assert unit(name).exponents == expected.exponents
    assert unit(name).factor == pytest.approx(expected.factor, rel=1e-15)  # the rounding of the expectation
    assert unit(name).offset == pytest.approx(expected.offset, rel=1e-15)


def test_a_value_in_a_display_unit_is_factor_times_value_plus_offset() -> None:
    assert display("rad", "deg") == (57.29577951308232, 0.0)
    assert display("K", "degC") == (1.0, -273.15)
    assert display("degC", "degF") == pytest.approx((1.8, 32.0), rel=1e-15)
    with pytest.raises(ExportError, match="display unit 'm': expected one of the dimension of 'rad'"):
        display("rad", "m")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("kgg", "unknown unit 'kgg'; nearest is 'kg'"),
        ("N/(m.sek)", r"unknown unit 'N/\(m.sek\)': no unit 'sek'; nearest is 'sec'"),
        ("rads", "unit 'rads': no unit 'rads'; nearest is 'rad/s'"),  # Pint's unit of dose
        ("N.m/rads", "no unit 'rads'; nearest is 'rad/s'"),
        ("Nms/rad", r"unit 'Nms/rad': 'Nms' is a plural of 'Nm': expected 'Nm' or 'Nm\.s'"),
        ("Pas", r"expected 'Pa' or 'Pa\.s'"),
        ("kNms", r"expected 'kNm' or 'kNm\.s'"),
        ("MPas", r"expected 'MPa' or 'MPa\.s'"),
        ("byte", "expected one of powers of kg, m, s, A, K, mol, cd, rad"),
        ("dB", "expected one of powers of kg"),  # a logarithm has no factor
        ("G", "expected one of whole powers of kg"),  # of Gaussian units
        ("m**0.5", "unit 'm\\*\\*0.5': expected a name as 'N.s/m'"),
        ("m/", "expected a name as"),
        ("", "expected a name as"),
        ("3 m", "expected a name as"),
    ],
)
def test_a_unit_that_fmi_cannot_express_is_refused(name: str, message: str) -> None:
    with pytest.raises(ExportError, match=message):
        unit(name)


def test_a_unit_besides_those_of_the_table_names_the_extra_that_knows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pint", None)  # as if it were not installed
    assert display("rad/s", "rad/s") == (1.0, 0.0)
    message = re.escape("unit 'grad' needs pint: pip install 'l1-depth[units]'")
    with pytest.raises(MissingExtraError, match=message):
        display("rad", "grad")


@pytest.mark.parametrize(
    ("name", "rate_name", "exponents", "factor"),
    [
        ("1", "1/s", {"s": -1}, 1.0), ("m", "m/s", {"m": 1, "s": -1}, 1.0),
        ("m/s", "m/s2", {"m": 1, "s": -2}, 1.0), ("N/s2", "N/s3", {"kg": 1, "m": 1, "s": -5}, 1.0),
        ("N.s/m", "N.s/m/s", {"kg": 1, "s": -2}, 1.0), ("s", "s/s", {}, 1.0),
        ("rev/min", "rev/min/s", {"rad": 1, "s": -2}, 2.0 * math.pi / 60.0),
        ("degC", "degC/s", {"K": 1, "s": -1}, 1.0),
    ],
)  # fmt: skip
def test_a_derivative_has_the_unit_by_second(
    name: str, rate_name: str, exponents: dict[str, int], factor: float
) -> None:
    assert per_second(name) == rate_name
    of_rate = rate(name)
    assert (of_rate.exponents, of_rate.offset) == (exponents, 0.0)
    assert of_rate.factor == pytest.approx(factor, rel=1e-15)
