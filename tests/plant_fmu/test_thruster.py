"""A thruster stays within its bounds and answers its lag exactly."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from plant_fmu.thruster import (
    T200_FORCE,
    T200_VOLTAGE,
    ThrusterParameters,
    corners,
    force_after,
    steady_force,
    submerged_share,
)

PAIRS = {name for name, value in vars(ThrusterParameters()).items() if isinstance(value, tuple)}


def changed(p: ThrusterParameters, **values: float | bool) -> ThrusterParameters:
    """Returns parameters with other values, without `thruster_`; both thrusters have one."""
    named: dict[str, Any] = {f"thruster_{name}": value for name, value in values.items()}
    return replace(p, **{name: (x, x) if name in PAIRS else x for name, x in named.items()})


REAL = changed(ThrusterParameters(), dead_zone=0.5, lag=0.1)
VOLTAGES = st.floats(-1e3, 1e3)
EFFICIENCIES = st.floats(0.0, 1.0)


@given(VOLTAGES, EFFICIENCIES, st.floats(0.0, 10.0))
def test_force_stays_within_gain_times_limit(voltage: float, efficiency: float, elapsed: float) -> None:
    bound = 0.25 * (12.0 - 0.5)
    steady = steady_force(REAL, 0, voltage, efficiency)
    assert abs(steady) <= bound
    for begin in (-bound, 0.0, bound):
        assert abs(force_after(REAL, 0, begin, steady, elapsed)) <= bound * (1.0 + 1e-15)


@given(st.floats(-0.5, 0.5))
def test_nothing_happens_in_the_dead_zone(voltage: float) -> None:
    assert steady_force(REAL, 0, voltage, 1.0) == 0.0


@given(VOLTAGES)
def test_it_is_odd(voltage: float) -> None:
    assert steady_force(REAL, 0, -voltage, 1.0) == -steady_force(REAL, 0, voltage, 1.0)


def test_the_lag_is_exact_in_one_step_or_many() -> None:
    force = 0.0
    for _ in range(10):
        force = force_after(REAL, 0, force, 1.0, 0.02)
    assert force == pytest.approx(1.0 - math.exp(-2.0), rel=1e-14)
    assert force_after(REAL, 0, 0.0, 1.0, 0.2) == pytest.approx(force, rel=1e-14)


def test_an_efficiency_is_a_fault() -> None:
    assert steady_force(REAL, 0, 8.5, 0.5) == pytest.approx(0.5 * 0.25 * 8.0)
    assert steady_force(REAL, 0, 8.5, 0.0) == 0.0


def test_an_ideal_thruster_gives_gain_times_voltage_at_once() -> None:
    ideal = changed(REAL, ideal=True)
    assert steady_force(ideal, 0, 100.0, 1.0) == 25.0
    assert force_after(ideal, 0, 0.0, 25.0, 1e-3) == 25.0
    assert force_after(changed(REAL, lag=0.0), 0, 0.0, 1.0, 1e-3) == 1.0


@given(VOLTAGES, EFFICIENCIES, st.floats(0.0, 1.0))
def test_what_the_paper_has_not_is_off_by_default(voltage: float, efficiency: float, elapsed: float) -> None:
    """Bit for bit: the force of gain, dead zone, saturation and lag alone."""
    behind = math.copysign(max(min(abs(voltage), 12.0) - 0.5, 0.0), voltage)
    steady = steady_force(REAL, 0, voltage, efficiency)
    assert steady == efficiency * 0.25 * behind
    assert force_after(REAL, 0, 0.5, steady, elapsed) == steady + (0.5 - steady) * math.exp(-elapsed / 0.1)


@given(st.floats(0.0, 20.0))
def test_in_reverse_it_gives_its_ratio_of_the_force(voltage: float) -> None:
    weaker = changed(REAL, reverse_ratio=0.8)
    assert steady_force(weaker, 0, voltage, 1.0) == steady_force(REAL, 0, voltage, 1.0)
    assert steady_force(weaker, 0, -voltage, 1.0) == pytest.approx(-0.8 * steady_force(REAL, 0, voltage, 1.0))


@pytest.mark.parametrize("voltage", [-6.0, -1.5, 0.0, 1.5, 3.0, 6.0])
def test_the_quadratic_curve_is_k_v_abs_v_over_the_curve_voltage(voltage: float) -> None:
    parabola = changed(REAL, dead_zone=0.0, curvature=1.0, curve_voltage=6.0)
    assert steady_force(parabola, 0, voltage, 1.0) == pytest.approx(0.25 * voltage * abs(voltage) / 6.0)
    half = changed(parabola, curvature=0.5)
    mean = 0.5 * (0.25 * voltage + 0.25 * voltage * abs(voltage) / 6.0)
    assert steady_force(half, 0, voltage, 1.0) == pytest.approx(mean)


def test_the_curve_begins_behind_the_dead_zone() -> None:
    parabola = changed(REAL, curvature=1.0, curve_voltage=2.0)
    assert steady_force(parabola, 0, 1.5, 1.0) == pytest.approx(0.25 * 1.0**2 / 2.0)


@pytest.mark.parametrize("end", [2.0, -2.0])
def test_a_rate_limit_is_a_ramp_until_the_lag_is_slower(end: float) -> None:
    """From 0 to 2 N at 1 N/s with a lag of 0.5 s: 1.5 s of ramp, then the lag from 1.5 N."""
    limited = changed(REAL, lag=0.5, rate_limit=1.0)
    signed = math.copysign(1.0, end)
    assert force_after(limited, 0, 0.0, end, 0.7) == pytest.approx(0.7 * signed)
    assert force_after(limited, 0, 0.0, end, 1.5) == pytest.approx(1.5 * signed)
    late = 2.0 - 0.5 * math.exp(-(2.1 - 1.5) / 0.5)
    assert force_after(limited, 0, 0.0, end, 2.1) == pytest.approx(late * signed)
    assert force_after(limited, 0, 1.8 * signed, end, 0.1) == pytest.approx(
        (2.0 - 0.2 * math.exp(-0.2)) * signed  # where the lag alone is slower
    )


def test_a_rate_limit_without_lag_is_a_ramp_to_the_force() -> None:
    limited = changed(REAL, lag=0.0, rate_limit=4.0)
    assert [force_after(limited, 0, 0.0, 1.0, t) for t in (0.0, 0.1, 0.25, 9.0)] == pytest.approx(
        [0.0, 0.4, 1.0, 1.0]
    )


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(1e-3, 0.5), st.floats(0.1, 50.0))
def test_the_force_changes_no_faster_than_the_limit(
    before: float, steady: float, elapsed: float, rate: float
) -> None:
    """And two steps give what one of both does."""
    limited = changed(REAL, rate_limit=rate)
    after = force_after(limited, 0, before, steady, elapsed)
    assert abs(after - before) <= rate * elapsed + 1e-14  # rounding of at most 3 N
    twice = force_after(
        limited, 0, force_after(limited, 0, before, steady, 0.4 * elapsed), steady, 0.6 * elapsed
    )
    assert twice == pytest.approx(after, abs=1e-13)  # rounding of at most 3 N


def test_a_propeller_loses_its_thrust_in_proportion_to_its_depth() -> None:
    depths = (-0.1, 0.0, 0.02, 0.06, 0.08, 5.0)
    airy = changed(REAL, depth=0.01, full_depth=0.08)
    assert [submerged_share(d - 0.01, airy) for d in depths] == pytest.approx(
        [0.0, 0.0, 0.25, 0.75, 1.0, 1.0]
    )
    assert [submerged_share(d, REAL) for d in depths] == [1.0] * 6
    assert submerged_share(-0.1, changed(airy, ideal=True)) == 1.0


def test_an_ideal_thruster_has_nothing_but_its_gain() -> None:
    ideal = changed(REAL, ideal=True, reverse_ratio=0.5, curvature=1.0, curve_voltage=3.0, rate_limit=1.0)
    assert steady_force(ideal, 0, -20.0, 1.0) == -5.0
    assert force_after(ideal, 0, 0.0, -5.0, 1e-3) == -5.0


T200 = changed(REAL, tabulated=True, scale=2.0)  # of which the start values are the table


@given(VOLTAGES, EFFICIENCIES)
def test_a_table_is_linear_between_its_points_and_held_outside(voltage: float, efficiency: float) -> None:
    """NumPy's interpolation, which has a slope computed in another order: so 1e-14 of the largest force."""
    expected = 2.0 * efficiency * float(np.interp(voltage, T200_VOLTAGE, T200_FORCE))
    assert steady_force(T200, 0, voltage, efficiency) == pytest.approx(expected, abs=1e-12)


def test_the_table_of_the_t200_gives_the_published_forces() -> None:
    """In kgf at some pulses; forward thrust is up, and a positive voltage pushes down."""
    published = {1900: 5.25, 1660: 1.28, 1540: 0.08, 1500: 0.0, 1460: -0.07, 1300: -1.44, 1100: -4.07}
    for pulse, kgf in published.items():
        voltage = (1500 - pulse) * 12.0 / 400.0
        assert steady_force(T200, 0, voltage, 1.0) == pytest.approx(-2.0 * kgf * 9.80665, abs=1e-12)
    dead = [steady_force(T200, 0, (1500 - pulse) * 12.0 / 400.0, 1.0) for pulse in range(1472, 1529)]
    assert dead == [0.0] * 57


def test_a_table_takes_the_place_of_the_curve_alone() -> None:
    """Without effect: gain, dead zone, ratio, curvature. Limit and lag stay, and an ideal one has a line."""
    other = changed(T200, gain=9.0, dead_zone=5.0, reverse_ratio=0.1, curvature=1.0)
    assert steady_force(other, 0, -7.0, 1.0) == steady_force(T200, 0, -7.0, 1.0)
    assert steady_force(changed(T200, voltage_limit=3.0), 0, 12.0, 1.0) == steady_force(T200, 0, 3.0, 1.0)
    assert force_after(T200, 0, 0.0, 1.0, 0.1) == pytest.approx(1.0 - math.exp(-1.0))
    assert steady_force(changed(T200, ideal=True), 0, 8.0, 1.0) == 0.25 * 8.0


# dead zone, saturation and reverse; a reverse gain alone; a table, saturated within its points and not
WITH_CORNERS = {
    "curve": (changed(REAL, reverse_ratio=0.8, voltage_limit=6.0), [-6.0, -0.5, 0.5, 6.0]),
    "reverse": (changed(ThrusterParameters(), reverse_ratio=0.8), [-12.0, 0.0, 12.0]),
    "table": (
        changed(ThrusterParameters(), tabulated=True, voltage_limit=15.0),
        [-15.0, *T200_VOLTAGE, 15.0],
    ),
    "line": (ThrusterParameters(), [-12.0, 12.0]),
    "ideal": (changed(REAL, ideal=True, tabulated=True), []),
}


@pytest.mark.parametrize(("p", "expected"), WITH_CORNERS.values(), ids=WITH_CORNERS)
def test_an_indicator_changes_its_sign_at_each_corner_of_the_force(
    p: ThrusterParameters, expected: list[float]
) -> None:
    """And nowhere else: the voltages of the grid are no corners, which lie at least 0.12 V apart."""
    voltages = np.arange(-16.0, 16.0, 0.01) + 0.005
    signs = np.sign([corners(p, 0, float(voltage), 0.0, 0.0) for voltage in voltages])
    changes = voltages[:-1][(signs[1:] != signs[:-1]).any(axis=1)]
    assert changes + 0.005 == pytest.approx(expected, abs=1e-9)
    assert np.abs(signs).min() == 1.0


@pytest.mark.parametrize("p", [p for p, _ in WITH_CORNERS.values()], ids=WITH_CORNERS)
@given(st.floats(-16.0, 16.0), st.floats(0.0, 0.1))
def test_without_a_change_of_sign_the_force_is_straight(
    p: ThrusterParameters, voltage: float, width: float
) -> None:
    ends = voltage, voltage + width
    before, after = (np.sign(corners(p, 0, end, 0.0, 0.0)) for end in ends)
    assume((before == after).all())
    low, high, middle = (steady_force(p, 0, v, 1.0) for v in (*ends, voltage + 0.5 * width))
    assert middle == pytest.approx(0.5 * (low + high), abs=1e-12)


@given(st.floats(-4.0, 4.0), st.floats(-3.0, 3.0))
def test_an_indicator_changes_its_sign_where_the_limit_of_the_rate_ends(force: float, steady: float) -> None:
    """At R T from the steady force, from where the lag alone is slower."""
    p = changed(REAL, rate_limit=2.0, lag=0.5)
    *_, limited = corners(p, 0, 1.0, force, steady)
    assert (limited > 0.0) == (abs(force - steady) > 1.0)
    assert corners(REAL, 0, 1.0, force, steady)[-1] == 1.0
