"""The delay of a signal is the one that its definition gives, on any signals and points."""

import math

import numpy as np
import pytest

from orchestration.results import delay
from orchestration.results.delay import shift_lag
from orchestration.results.recording import Recording

STEP, LARGEST = 0.05, 10.0
TIME = STEP * np.arange(1201)


def recording(time: np.ndarray, signal: np.ndarray, reference: np.ndarray) -> Recording:
    return Recording(("z", "r"), ("m", "m"), time, np.column_stack([signal, reference]))


def smooth(random: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Some waves of at least 15 s."""
    waves = random.uniform([-1, 0, 0], [1, 0.4, 6.3], (5, 3))
    return np.sum([a * np.cos(w * time + p) for a, w, p in waves], axis=0)


def distance(time: np.ndarray, signal: np.ndarray, reference: np.ndarray, delay: float) -> float:
    """The definition: mean square over the points from LARGEST on."""
    late = time >= LARGEST
    return float(np.mean((signal[late] - np.interp(time[late] - delay, time, reference)) ** 2))


@pytest.mark.parametrize("seed", range(3))
def test_no_delay_of_a_fine_search_is_nearer(seed: int) -> None:
    """Nor any between them: the distance there is that of the least but for rounding."""
    random = np.random.default_rng(seed)
    reference = smooth(random, TIME)
    signal = np.interp(TIME - random.uniform(1.0, 9.0), TIME, reference) + 0.1 * random.standard_normal(1201)
    lag = shift_lag(recording(TIME, signal, reference), "z", "r", LARGEST)
    searched = np.linspace(0.0, LARGEST, 2001)
    distances = [distance(TIME, signal, reference, delay) for delay in searched]
    assert distance(TIME, signal, reference, lag) <= min(distances) * (1.0 + 1e-12)
    assert lag == pytest.approx(searched[np.argmin(distances)], abs=5e-3)


def test_the_delay_of_a_line_is_exact() -> None:
    """2 sin of a reference 3.7 steps late, both lines between points: nothing is lost but rounding."""
    reference = np.sin(0.3 * TIME) + 100.0
    late = np.interp(TIME - 3.7 * STEP, TIME, reference)
    lag = shift_lag(recording(TIME, late, reference), "z", "r", LARGEST)
    assert lag == pytest.approx(3.7 * STEP, abs=1e-9)


def test_the_delay_does_not_depend_on_what_was_measured_before() -> None:
    """To the last bit: by a reference that is the same, another one, or judged from another time on."""
    random = np.random.default_rng(5)
    reference = smooth(random, TIME)
    references = [reference, reference + 0.1 * random.standard_normal(1201)]
    late = np.interp(TIME - 2.013, TIME, reference)

    def lag(which: int, largest: float) -> float:
        return shift_lag(recording(TIME, late, references[which]), "z", "r", largest)

    def alone(which: int, largest: float) -> float:
        delay._sums_of_reference.cache_clear()
        return lag(which, largest)

    cases = [(0, LARGEST), (1, LARGEST), (1, 5.0), (0, 5.0)]
    expected = [alone(*case) for case in cases]
    assert len({*expected}) == len(cases)
    assert [lag(*case) for case in cases for _ in range(2)] == [x for x in expected for _ in range(2)]
    run = recording(TIME, late, references[0])
    assert shift_lag(run, "z", "r", LARGEST) == expected[0]
    run.values[:, 1] = references[1]
    assert shift_lag(run, "z", "r", LARGEST) == expected[1]


def test_points_at_other_distances_have_the_same_delay() -> None:
    """One point more, by which the search is another one: within its error of 1e-4 s."""
    time = np.sort([*TIME, 33.33])
    reference = np.cos(0.2 * time)
    run = recording(time, np.cos(0.2 * (time - 4.56)), reference)
    equal = recording(TIME, np.cos(0.2 * (TIME - 4.56)), np.cos(0.2 * TIME))
    lag = shift_lag(run, "z", "r", LARGEST)
    assert lag == pytest.approx(shift_lag(equal, "z", "r", LARGEST), abs=3e-4)
    assert lag == pytest.approx(4.56, abs=1e-3)  # lines in place of waves
    assert shift_lag(recording(time, reference, reference), "z", "r", LARGEST) == 0.0
    assert shift_lag(equal, "r", "r", LARGEST) == pytest.approx(0.0, abs=1e-9)  # rounding of sums


@pytest.mark.parametrize("start", [0.0, -50.0, 100.0])
@pytest.mark.parametrize("power", [1.0, 1.01])
def test_a_run_is_judged_from_the_same_point_wherever_time_begins(start: float, power: float) -> None:
    """The signal is another one until then; points at equal distances, and at growing ones."""
    time = TIME**power
    reference = smooth(np.random.default_rng(2), time)
    signal = np.where(time < LARGEST, 5.0, np.interp(time - 2.0, time, reference))
    lag = shift_lag(recording(start + time, signal, reference), "z", "r", LARGEST)
    assert lag == pytest.approx(2.0, abs=2e-4)  # the search by steps ends at 1e-4 s


def test_a_delay_between_points_at_the_end_of_the_search_is_none() -> None:
    reference = np.sin(0.1 * TIME)
    run = recording(TIME, np.interp(TIME - 3.0, TIME, reference), reference)
    assert shift_lag(run, "z", "r", largest=3.02) == pytest.approx(3.0)
    assert math.isnan(shift_lag(run, "z", "r", largest=2.98))


def test_a_search_of_no_length_finds_no_delay() -> None:
    run = recording(TIME, np.sin(TIME - 1.0), np.sin(TIME))
    assert all(math.isnan(shift_lag(run, "z", "r", largest)) for largest in (0.0, 1e-10 * STEP))


@pytest.mark.filterwarnings("error")  # a mean of no points is one
def test_a_search_over_nearly_the_whole_run_judges_what_is_left_of_it() -> None:
    """No point of the rest of the run has a reference later by a part of the search to be nearer to."""
    run = recording(TIME, np.sin(TIME), np.sin(TIME))
    assert shift_lag(run, "z", "r", largest=0.99 * TIME[-1]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("lost", [math.nan, math.inf])
def test_a_signal_that_is_no_number_has_no_delay(lost: float) -> None:
    signal = np.where(TIME > 50.0, lost, np.sin(TIME))
    with np.errstate(invalid="ignore"):
        assert math.isnan(shift_lag(recording(TIME, signal, np.sin(TIME)), "z", "r", LARGEST))
