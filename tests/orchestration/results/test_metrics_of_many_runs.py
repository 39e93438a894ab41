"""Metrics of many runs are those of each run alone, to the last bit; and metrics at their edges."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestration.errors import ScenarioError, ScenarioWarning
from orchestration.results import metrics
from orchestration.results.recording import Recording

RUNS, POINTS, STEP = 5, 1237, 0.02
WINDOW = {"window": [1.0, 20.0]}
SETTLING = {"signal": "z", "target": 0.5, "band": 0.7}
CALLS: dict[str, dict[str, Any]] = {
    "settling_time": SETTLING,
    "recovery_time": SETTLING | WINDOW,
    "rmse": {"signal": "z", "reference": "r", "scale": 100.0},
    "peak_error": {"signal": "z", "reference": "r"} | WINDOW,
    "std": {"signal": "z"} | WINDOW,
    "iae": {"signal": "z", "reference": "r"},
    "ise": {"signal": "z", "reference": "r"},
    "itae": {"signal": "z", "reference": "r"} | WINDOW,
    "overshoot": {"signal": "z", "target": -1.5},
    "mean": {"signal": "z"} | WINDOW,
    "peak": {"signal": "z", "scale": 2.0},
    "maximum": {"signal": "z"} | WINDOW,
    "minimum": {"signal": "z", "scale": 100.0},
    "effort": {"signal": "z"},
    "total_variation": {"signal": "z", "every": 0.1},
    "shift_lag": {"signal": "z", "reference": "r", "largest": 5.0},
    "time_below": {"signal": "z", "limit": 0.1, "after": 0.5},
    "time_above": {"signal": "z", "limit": 0.1} | WINDOW,
    "duty_cycle": {"signal": "z", "limit": 0.1},
    "energy_residual": {"signal": "z", "flow": "r"},
    "phase_lag": {"signal": "z", "angular_frequency": 0.3},
}


def recordings(one_reference: bool = True) -> Recording:
    """Noisy runs, late by other times; the second one leads, the last settles nowhere."""
    random, time = np.random.default_rng(3), STEP * np.arange(POINTS)
    delays = np.array([[1.3], [-0.4], [0.0], [0.31], [2.0]])
    z = np.sin(0.7 * (time - delays)) + 0.05 * random.standard_normal((RUNS, POINTS))
    z[-1, -1] = 9.0
    r = np.sin(0.7 * time) + (np.zeros((RUNS, 1)) if one_reference else 0.1 * random.random((RUNS, 1)))
    values = np.stack([z, np.broadcast_to(r, z.shape)])
    provenance = {"algorithm": "jacobi", "extrapolation": 0}
    return Recording(("z", "r"), ("", ""), time, values.transpose(1, 2, 0), provenance)


def alone(runs: Recording, run: int, call: dict[str, Any]) -> float:
    """The metric of a recording with a row for each point, as a run makes it."""
    recording = replace(runs, values=np.ascontiguousarray(runs.values[run]))
    return metrics.evaluate(recording, {"one": call})["one"]


def assert_bits_of_single_runs(runs: Recording, call: dict[str, Any]) -> None:
    """Also of those that are not a number."""
    expected = [alone(runs, run, call) for run in range(RUNS)]
    assert metrics.evaluate(runs, {"one": call})["one"].tobytes() == np.array(expected).tobytes()


@pytest.mark.parametrize("one_reference", [True, False])
@pytest.mark.parametrize("function", metrics.FUNCTIONS)
def test_every_metric_has_the_bits_of_single_runs(function: str, one_reference: bool) -> None:
    runs, call = recordings(one_reference), {"function": function, **CALLS[function]}
    assert_bits_of_single_runs(runs, call)


@pytest.mark.parametrize("function", ["shift_lag", "energy_residual"])
def test_points_at_other_distances_too(function: str) -> None:
    equal = recordings()
    runs = replace(equal, time=np.sort([*equal.time[:-1], 7.77]))
    assert_bits_of_single_runs(runs, {"function": function, **CALLS[function]})


def test_a_metric_that_is_infinite_or_cannot_be_computed_in_one_of_the_runs_is_an_error() -> None:
    runs = recordings()
    runs.values[1, 5, 0] = np.inf
    with pytest.raises(ScenarioError, match="expected a finite number"):
        metrics.evaluate(runs, {"peak": {"function": "peak", "signal": "z"}})
    for arguments in ({"signal": "z", "window": [90.0, 91.0]}, {"signal": "y"}):
        with pytest.raises(ScenarioError):
            metrics.evaluate(runs, {"mean": {"function": "mean", **arguments}})


def test_a_run_that_ended_too_early_for_a_metric_has_none_in_any_form() -> None:
    ended = replace(recordings(), provenance={"terminated": "plant"})
    late = {"function": "mean", "signal": "z", "window": [0.0, 900.0]}
    assert np.isnan(metrics.evaluate(ended, {"late": late})["late"]).tolist() == [True] * RUNS


TENTHS = np.array([0.1 * i for i in range(11)])  # 0.30000000000000004 and 0.7000000000000001 among them


def recording(time: np.ndarray, **signals: np.ndarray) -> Recording:
    names = tuple(signals)
    return Recording(names, ("m",) * len(names), time, np.column_stack(list(signals.values())))


def test_a_value_at_a_limit_is_within_the_band_and_neither_above_nor_below_the_limit() -> None:
    def run(*values: float) -> Recording:
        return recording(np.arange(4.0), z=np.array(values))

    assert metrics.settling_time(run(0.0, 1.25, 0.75, 1.25), "z", target=1.0, band=0.25) == 0.0
    assert math.isnan(metrics.time_below(run(0.0, 0.5, 0.5, 0.0), "z", limit=0.1, after=0.5))
    assert metrics.time_below(run(1.0, 0.5, 0.5, 0.5), "z", limit=0.5, after=0.9) == 0.0


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
    whole = recording(100.0 + TENTHS, z=wave, r=wave)
    run = replace(whole, provenance={"terminated": {"time_s": 101.0}})
    call = {"function": "shift_lag", "signal": "z", "reference": "r", "largest": largest}
    assert math.isnan(metrics.evaluate(run, {"lag": call})["lag"]) != is_complete


def check(*windows: list[float]) -> None:
    metrics.check_run({f"m{i}": {"window": window} for i, window in enumerate(windows)}, 10.0, 20.0, ())


@pytest.mark.filterwarnings("error")
def test_a_window_that_only_touches_the_run_is_refused_and_one_beyond_it_warned_of() -> None:
    for window in ([0.0, 10.0], [20.0, 30.0]):
        with pytest.raises(ScenarioError, match=r"expected to overlap 10..20 s"):
            check(window)
    for window in ([9.0, 20.0], [10.0, 21.0]):
        with pytest.warns(ScenarioWarning, match="m1"):
            check([10.0, 20.0], window)
    check([10.0, 20.0], [10.0 - 1e-9, 20.0 + 1e-9])  # without a warning
