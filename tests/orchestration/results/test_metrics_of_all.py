"""Metrics of many runs at once are those of each run alone, to the last bit."""

from typing import Any

import numpy as np
import pytest

from orchestration.results import metrics
from orchestration.results.metrics_of_all import evaluate_all
from orchestration.results.recording import Recording
from orchestration.results.recordings import OF_ALL, Recordings

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
    "effort": {"signal": "z"},
    "total_variation": {"signal": "z", "every": 0.1},
    "shift_lag": {"signal": "z", "reference": "r", "largest": 5.0},
    "time_below": {"signal": "z", "limit": 0.1, "after": 0.5},
    "energy_residual": {"signal": "z", "flow": "r"},
    "phase_lag": {"signal": "z", "angular_frequency": 0.3},
}


def recordings(one_reference: bool = True) -> Recordings:
    """Noisy runs, late by other times; the second one leads, the last settles nowhere."""
    random, time = np.random.default_rng(3), STEP * np.arange(POINTS)
    delays = np.array([[1.3], [-0.4], [0.0], [0.31], [2.0]])
    z = np.sin(0.7 * (time - delays)) + 0.05 * random.standard_normal((RUNS, POINTS))
    z[-1, -1] = 9.0
    r = np.sin(0.7 * time) + (np.zeros((RUNS, 1)) if one_reference else 0.1 * random.random((RUNS, 1)))
    values = np.stack([z, np.broadcast_to(r, z.shape)])
    provenance = {"algorithm": "jacobi", "extrapolation": 0}
    return Recordings(Recording(("z", "r"), ("", ""), time, values[:, 0].T, provenance), values)


def alone(runs: Recordings, run: int, call: dict[str, Any]) -> float:
    """The metric of a recording with a row for each point, as a run makes it."""
    values = np.ascontiguousarray(runs.values[:, run].T)
    first = runs.first
    recording = Recording(first.names, first.units, first.time, values, first.provenance)
    return metrics.evaluate(recording, {"one": call})["one"]


def assert_bits_of_single_runs(runs: Recordings, call: dict[str, Any]) -> None:
    """Also of those that are not a number."""
    rows = evaluate_all(runs, {"one": call})
    expected = [alone(runs, run, call) for run in range(RUNS)]
    assert np.array([row["one"] for row in rows if row]).tobytes() == np.array(expected).tobytes()


@pytest.mark.parametrize("one_reference", [True, False])
@pytest.mark.parametrize("function", metrics.FUNCTIONS)
def test_every_metric_has_the_bits_of_single_runs(function: str, one_reference: bool) -> None:
    runs, call = recordings(one_reference), {"function": function, **CALLS[function]}
    assert_bits_of_single_runs(runs, call)


def test_the_metrics_of_sweeps_are_computed_at_once() -> None:
    at_once = {function.__name__ for function in OF_ALL}
    assert at_once == metrics.FUNCTIONS.keys() - {"time_below", "energy_residual", "phase_lag"}


@pytest.mark.parametrize("function", ["shift_lag", "energy_residual"])
def test_points_at_other_distances_too(function: str) -> None:
    equal = recordings()
    time = np.sort([*equal.time[:-1], 7.77])
    runs = Recordings(
        Recording(("z", "r"), ("", ""), time, equal.first.values, equal.first.provenance), equal.values
    )
    call = {"function": function, **CALLS[function]}
    assert_bits_of_single_runs(runs, call)


def test_a_run_without_a_finite_metric_has_none_and_the_others_have_theirs() -> None:
    runs = recordings()
    runs.values[0, 1, 5] = np.inf
    call = {"function": "peak", "signal": "z"}
    rows = evaluate_all(runs, {"peak": call})
    assert [row is None for row in rows] == [False, True, False, False, False]
    assert rows[0] == {"peak": alone(runs, 0, call)}


def test_a_metric_that_cannot_be_computed_is_one_of_no_run() -> None:
    """A window outside the run, and a signal that was not recorded."""
    for arguments in ({"signal": "z", "window": [90.0, 91.0]}, {"signal": "y"}):
        assert evaluate_all(recordings(), {"mean": {"function": "mean", **arguments}}) == [None] * RUNS
