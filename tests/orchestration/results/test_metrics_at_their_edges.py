"""Metrics of values that are at a limit, and of times that are rounded or at the edge of a window."""

import math
import warnings

import numpy as np
import pytest

from orchestration.errors import ScenarioError, ScenarioWarning
from orchestration.results import metrics
from orchestration.results.recording import Recording

TENTHS = np.array([0.1 * i for i in range(11)])  # 0.30000000000000004 and 0.7000000000000001 among them


def recording(time: np.ndarray, **signals: np.ndarray) -> Recording:
    names = tuple(signals)
    return Recording(names, ("m",) * len(names), time, np.column_stack(list(signals.values())))


def test_a_value_at_the_edge_of_the_band_is_within_it() -> None:
    run = recording(np.arange(4.0), z=np.array([0.0, 1.25, 0.75, 1.25]))
    assert metrics.settling_time(run, "z", target=1.0, band=0.25) == 0.0


def test_a_signal_that_only_reaches_a_level_has_not_been_above_it() -> None:
    run = recording(np.arange(4.0), z=np.array([0.0, 0.5, 0.5, 0.0]))
    assert math.isnan(metrics.time_below(run, "z", limit=0.1, after=0.5))


def test_a_signal_at_a_limit_is_not_below_it() -> None:
    run = recording(np.arange(4.0), z=np.array([1.0, 0.5, 0.5, 0.5]))
    assert metrics.time_below(run, "z", limit=0.5, after=0.9) == 0.0


def test_a_sampled_variation_takes_the_points_of_its_period_whatever_their_rounding() -> None:
    """3 times 0.1 is more than 0.3, and 0.3 / 0.1 is 2.9999999999999996."""
    decimals = np.arange(11) / 10
    changing = recording(decimals, z=np.arange(11) % 2 * 1.0)
    assert metrics.total_variation(changing, "z", every=0.1) == 10.0
    line = recording(decimals[:4], z=np.arange(4.0))
    assert metrics.total_variation(line, "z", every=0.1) == 3.0


@pytest.mark.parametrize("window", [[0.3, 0.7], [0.30000000000000010, 0.7], [0.3, 0.6999999999999998]])
def test_a_window_has_the_points_at_its_ends_whatever_their_rounding(window: list[float]) -> None:
    run = recording(TENTHS, z=np.arange(11.0))
    assert metrics.peak(run, "z", window) == 7.0
    assert metrics.mean(run, "z", window) == 5.0


def test_what_a_disturbance_does_not_move_recovers_at_once_between_two_points_too() -> None:
    assert metrics.recovery_time(recording(TENTHS, z=np.ones(11)), "z", 1.0, 0.1, [0.45, 1.0]) == 0.0


@pytest.mark.parametrize("delay", [-5.0, -1.0, 4.0, 6.0])
def test_a_phase_lag_is_found_within_half_a_period(delay: float) -> None:
    time = np.linspace(0.0, 100.0, 2001)
    run = recording(time, z=np.cos(0.5 * (time - delay)))
    assert metrics.phase_lag(run, "z", 0.5) == pytest.approx(delay, abs=1e-9)  # a period is 12.6 s


@pytest.mark.parametrize(("largest", "is_complete"), [(0.9, True), (1.1, False)])
def test_a_delay_is_searched_in_a_run_that_ended_early_if_it_is_long_enough(
    largest: float, is_complete: bool
) -> None:
    """A run from 100 s that an FMU terminated at 101 s."""
    wave = np.cos(20.0 * TENTHS)
    run = Recording(
        ("z", "r"),
        ("m", "m"),
        100.0 + TENTHS,
        np.column_stack([wave, wave]),
        {"terminated": {"time_s": 101.0}},
    )
    call = {"function": "shift_lag", "signal": "z", "reference": "r", "largest": largest}
    assert math.isnan(metrics.evaluate(run, {"lag": call})["lag"]) != is_complete


def check(*windows: list[float]) -> None:
    metrics.check_run({f"m{i}": {"window": window} for i, window in enumerate(windows)}, 10.0, 20.0, ())


@pytest.mark.parametrize("window", [[0.0, 10.0], [20.0, 30.0]])
def test_a_window_that_only_touches_the_run_is_refused(window: list[float]) -> None:
    with pytest.raises(ScenarioError, match=r"expected to overlap 10..20 s"):
        check(window)


@pytest.mark.parametrize("window", [[9.0, 20.0], [10.0, 21.0]])
def test_a_window_that_begins_before_the_run_or_ends_after_it_is_warned_of(window: list[float]) -> None:
    with pytest.warns(ScenarioWarning, match="m1"):
        check([10.0, 20.0], window)


def test_a_window_of_the_whole_run_is_not_warned_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check([10.0, 20.0], [10.0 - 1e-9, 20.0 + 1e-9])
