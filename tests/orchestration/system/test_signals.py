"""Signals are what they say at every time, and a spectrum has the variance and the shape that it is given."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import welch
from scipy.stats import kstest

from orchestration.errors import ScenarioError
from orchestration.system.signals import Constant, Cosine, Ramps, Table, jonswap, sine, spectrum, sum_of_sines
from orchestration.system.time_grid import time_grid

POINTS = [[0.0, 0.0], [40.0, 0.8], [140.0, 0.8], [180.0, 0.4]]


def test_straight_ramps_interpolate_and_hold() -> None:
    r = Ramps(POINTS)
    assert [r(t) for t in (-1.0, 0.0, 20.0, 40.0, 100.0, 160.0, 500.0)] == pytest.approx(
        [0.0, 0.0, 0.4, 0.8, 0.8, 0.6, 0.4]
    )


@pytest.mark.parametrize("t", [0.0, 40.0, 140.0, 180.0])
def test_quintic_ramps_start_and_end_at_rest(t: float) -> None:
    r, h = Ramps(POINTS, smooth=True), 1e-3
    assert (r(t + h) - r(t - h)) / (2 * h) == pytest.approx(0.0, abs=1e-8)  # 10 s^3 / T at s = h / T
    assert (r(t + h) - 2 * r(t) + r(t - h)) / h**2 == pytest.approx(0.0, abs=1e-5)


@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0))
def test_quintic_ramps_are_monotonic_and_pass_the_middle(one: float, other: float) -> None:
    r = Ramps(POINTS, smooth=True)
    assert r(min(one, other)) <= r(max(one, other)) + 1e-15
    assert r(20.0) == pytest.approx(0.4)


def test_cosine_and_constant() -> None:
    assert Cosine(100.0, 0.2, 0.1, 5.0)(3.0) == pytest.approx(5.0 + 100.0 * math.cos(0.7))
    assert Constant(2.0)(99.0) == 2.0


def test_samples_are_joined_by_lines_or_hold() -> None:
    times, values = [0.0, 1.0, 3.0], np.array([2.0, 4.0, 0.0])
    asked = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0])
    assert Table(times, values).at(asked).tolist() == [2.0, 2.0, 3.0, 4.0, 2.0, 0.0, 0.0]
    assert Table(times, values, hold=True).at(asked).tolist() == [2.0, 2.0, 2.0, 4.0, 4.0, 0.0, 0.0]


def test_held_samples_change_at_their_communication_point_whatever_the_rounding() -> None:
    """3 * 0.1 is a little more than 0.3, 0.7 + 0.1 a little less than 0.8."""
    held = Table([0.0, 3 * 0.1, 0.8], [0.0, 1.0, 2.0], hold=True)
    assert [held(0.3), held(0.7 + 0.1)] == [1.0, 2.0]
    assert held(0.3 - 1e-6) == 0.0


@pytest.mark.parametrize("hold", [False, True])
def test_two_rows_of_one_time_are_a_jump_to_the_last(hold: bool) -> None:
    """Also three rows, and rows at both ends; before the first row the first one counts."""
    times = [-1.0, -1.0, 2.0, 2.0, 2.0, 4.0, 4.0]
    table = Table(times, [5.0, -3.0, 0.0, 9.0, 7.0, 1.0, -2.0], hold=hold)
    ramp = [-3.0, -3.0, 7.0, 7.0] if hold else [-3.0, -1.5, 7.0, 4.0]
    asked = np.array([-2.0, -1.0, 0.5, 2.0, 3.0, 4.0, 5.0])
    assert table.at(asked).tolist() == [5.0, *ramp, -2.0, -2.0]
    assert table(2.0 - 1e-6) == pytest.approx(-3.0 if hold else 0.0, abs=2e-6)
    assert Table([3.0, 3.0], [1.0, 2.0], hold=hold).at(np.array([2.9, 3.0])).tolist() == [1.0, 2.0]


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("start", [0.0, -3.0, 0.7, 36000.0, 1e6])
def test_a_jump_is_at_its_communication_point_whatever_the_rounding(start: float, hold: bool) -> None:
    points = time_grid(start, start + 1.0, 0.1)
    for index in range(1, len(points)):
        for jump in (
            points[index],
            np.nextafter(points[index], np.inf),
            np.nextafter(points[index], -np.inf),
        ):
            table = Table([start - 1.0, jump, jump, jump + 0.01, jump + 9.0], [0, 0, 1, 1, 1], hold=hold)
            assert table.at(points).tolist() == [0.0] * index + [1.0] * (len(points) - index)


def test_samples_are_copied() -> None:
    values = np.array([1.0, 2.0])
    samples = Table([0.0, 1.0], values)
    values[:] = 9.0
    assert samples(0.0) == 1.0


def test_numbers_are_copied() -> None:
    number: Any = np.array(1.0)
    signals = [Constant(number), Cosine(number, 0.0), Ramps([(0.0, number)])]
    number += 1.0
    assert [signal(0.0) for signal in signals] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ramps([[1.0, 0.0], [1.0, 2.0]]), r"ascending time"),
        (lambda: Ramps([[1.0]]), r"\[time, value\]"),
        (lambda: Ramps([[0.0, 0.0], ["1", 2.0]]), r"ramps: time = '1': expected a number"),  # type: ignore[list-item]
        (lambda: Ramps([[0.0, None]]), r"ramps: value = None: expected a number"),  # type: ignore[list-item]
        (lambda: Constant("1.0"), r"constant: value = '1.0': expected a number"),  # type: ignore[arg-type]
        (lambda: Constant(np.ones(1)), r"value = array\(\[1\.\]\): expected a number"),  # type: ignore[arg-type]
        (lambda: Cosine(1.0, 1j), r"cosine: angular_frequency = 1j: expected"),  # type: ignore[arg-type]
        (lambda: Cosine(10**400, 1.0), r"cosine: amplitude = 10+: expected a number"),
        (lambda: Table([0.0, 1.0], [0.0]), r"shapes \(2,\) and \(1,\)"),
        (lambda: Table([], []), r"expected times and as many values"),
        (lambda: Table([0.0, 1.0, 0.5], [0.0, 1.0, 2.0]), r"ascending times"),
        (lambda: Table([0.0, 1.0], [0.0, "on"]), r"table: expected numbers: .*'on'"),  # type: ignore[list-item]
        (lambda: Table([0.0, math.nan], [0.0, 1.0]), r"finite numbers"),
    ],
)
def test_bad_arguments_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make()


TIMES = np.linspace(0.0, 12.0, 97)


def test_a_sine_has_its_amplitude_frequency_phase_and_offset() -> None:
    expected = 5.0 + 2.0 * np.sin(2.0 * math.pi * 0.2 * TIMES + 0.3)
    assert sine(2.0, 0.2, 0.3, 5.0).at(TIMES) == pytest.approx(expected, abs=1e-14)


def test_a_sum_of_sines_is_the_sum_of_its_sines() -> None:
    both = sum_of_sines([2.0, 0.5], [0.2, 0.7], [0.3, -1.0], 1.0)
    parts = sine(2.0, 0.2, 0.3).at(TIMES) + sine(0.5, 0.7, -1.0).at(TIMES)
    assert both.at(TIMES) == pytest.approx(1.0 + parts, abs=1e-14)
    assert sum_of_sines([2.0], [0.2]).at(TIMES) == pytest.approx(sine(2.0, 0.2).at(TIMES))


@given(st.floats(0.0, 1e4), st.integers(0, 9))
def test_the_value_at_a_time_does_not_depend_on_the_other_times(t: float, before: int) -> None:
    """A checkpoint or a shorter step asks for other times: the same bits must come back."""
    waves = spectrum(1.0, 5.0)
    many = np.sort(np.append(np.linspace(0.0, t, before, endpoint=False), t))
    assert waves.at(many)[-1] == waves(t)


def test_jonswap_has_its_peak_at_one_and_that_of_pierson_and_moskowitz_times_gamma() -> None:
    ratio = np.linspace(0.5, 4.0, 3501)
    assert ratio[np.argmax(jonswap(ratio, 3.3))] == pytest.approx(1.0, abs=1e-3)
    one = np.array([1.0])
    assert jonswap(one, 3.3) == pytest.approx(3.3 * jonswap(one, 1.0))
    assert jonswap(one, 1.0) == pytest.approx(math.exp(-1.25))
    assert quad(lambda x: float(jonswap(np.array([x]), 1.0)[0]), 0.01, 60.0, limit=200)[0] == pytest.approx(
        1.0 / 5.0, rel=1e-6
    )  # of Pierson and Moskowitz, in closed form


@pytest.mark.parametrize("seed", [1, 2])
def test_every_seed_has_the_same_variance_which_a_long_record_shows(seed: int) -> None:
    waves = spectrum(0.7, 5.0, seed=seed, offset=0.2)
    assert np.sum(np.asarray(waves.amplitudes) ** 2) / 2.0 == pytest.approx(0.7**2, rel=1e-12)
    record = waves.at(np.arange(0.0, 20_000.0, 0.25))
    assert record.std() == pytest.approx(0.7, rel=0.01)  # neighbours beat in about 5 / 0.035 = 140 s
    assert record.mean() == pytest.approx(0.2, abs=1e-3)


def test_rayleigh_amplitudes_scatter_the_variance_from_seed_to_seed() -> None:
    """The squares are exponential: with shares s_i the variance scatters by sum s_i^2 about the same mean.

    2000 seeds: bounds are four standard deviations, of the mean and (4 %) of the variance of a sample.
    """
    seas = [
        [np.asarray(spectrum(1.0, 5.0, components=50, seed=seed, rayleigh_amplitudes=is_drawn).amplitudes)]
        for seed in range(2000)
        for is_drawn in (False, True)
    ]
    fixed, drawn = (0.5 * np.concatenate(seas[i::2]) ** 2 for i in (0, 1))
    expected = (fixed**2).sum(axis=1).mean()
    assert kstest((drawn / fixed).ravel(), "expon").pvalue > 1e-3
    assert drawn.sum(axis=1).mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(expected / 2000.0))
    assert drawn.sum(axis=1).var() == pytest.approx(expected, rel=0.16)


def test_the_spectrum_of_a_long_record_is_jonswap() -> None:
    record = spectrum(1.0, 5.0, components=250).at(np.arange(0.0, 20_000.0, 0.5))
    frequencies, density = welch(record, fs=2.0, nperseg=500)  # 4 mHz apart, the peak is 28 mHz wide
    inside = (frequencies > 0.12) & (frequencies < 0.6)
    ratio = 5.0 * frequencies[inside]
    total = quad(lambda x: float(jonswap(np.array([x]), 3.3)[0]), 0.5, 4.0)[0]
    expected = 5.0 * jonswap(ratio, 3.3) / total
    # 80 segments: each estimate is within 11 % (one deviation); the band sums are compared
    edges = [0, 20, 30, 45, len(ratio)]
    for begin, end in pairwise(edges):
        assert density[inside][begin:end].sum() == pytest.approx(expected[begin:end].sum(), rel=0.1)


def test_a_seed_gives_one_signal_and_another_seed_another() -> None:
    first, again, other = (spectrum(1.0, 5.0, seed=seed).at(TIMES) for seed in (3, 3, 4))
    assert first.tolist() == again.tolist()
    assert np.abs(first - other).max() > 0.5


def test_the_signal_of_a_seed_stays_what_it_was() -> None:
    """Results name the seed alone: NumPy's generator or our use of it must not change it."""
    assert spectrum(0.7071, 5.0)(100.0) == pytest.approx(-0.6889737121133298, rel=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sum_of_sines([1.0], [0.1, 0.2]), r"sines: .* got 1 amplitudes, 2 angular_frequencies, 1 ph"),
        (lambda: sum_of_sines([], []), r"sines: expected one of each or more"),
        (lambda: sine(math.nan, 0.1), r"sines: expected finite numbers"),
        (lambda: spectrum(-1.0, 5.0), r"spectrum: standard_deviation = -1.0: expected 0 or more"),
        (lambda: spectrum(1.0, 0.0), r"spectrum: peak_period = 0.0 s: expected more than 0"),
        (lambda: spectrum(1.0, 5.0, gamma=0.5), r"spectrum: gamma = 0.5: expected 1 or more"),
        (lambda: spectrum(1.0, 5.0, components=0), r"spectrum: components = 0: expected 1 to 10000"),
        (lambda: spectrum(1.0, 5.0, seed=-1), r"spectrum: seed = -1: expected 0 or more"),
    ],
)
def test_bad_arguments_of_sines_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make()
