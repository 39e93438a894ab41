"""Metrics of a recording of many runs are those of each run alone, to the last bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestration.errors import ScenarioError
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
    "effort": {"signal": "z"},
    "total_variation": {"signal": "z", "every": 0.1},
    "shift_lag": {"signal": "z", "reference": "r", "largest": 5.0},
    "time_below": {"signal": "z", "limit": 0.1, "after": 0.5},
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
    time = np.sort([*equal.time[:-1], 7.77])
    runs = replace(equal, time=time)
    call = {"function": function, **CALLS[function]}
    assert_bits_of_single_runs(runs, call)


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
