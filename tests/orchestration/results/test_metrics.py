"""Metrics on made-up recordings whose numbers are known."""

import math

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.results import metrics
from orchestration.results.recording import Recording

TIME = np.linspace(0.0, 100.0, 10001)


def recording(**signals: np.ndarray) -> Recording:
    names = tuple(signals)
    return Recording(names, ("m",) * len(names), TIME, np.column_stack(list(signals.values())))


def test_settling_time_is_the_last_time_outside_the_band() -> None:
    z = 0.8 * (1.0 - np.exp(-TIME / 10.0))
    assert metrics.settling_time(recording(z=z), "z", 0.8, 0.04) == pytest.approx(
        10.0 * math.log(20.0), abs=0.011
    )  # one communication step
    assert metrics.settling_time(recording(z=z), "z", 0.8, 1.0) == 0.0
    late = np.where(TIME == 90.0, 0.0, z)
    assert metrics.settling_time(recording(z=late), "z", 0.8, 0.04) == 90.0
    assert metrics.settling_time(recording(z=late), "z", 0.8, 0.04, [0.0, 80.0]) < 31.0


def test_rmse_overshoot_mean_effort() -> None:
    run = recording(z=np.sin(TIME * 2 * math.pi), r=np.zeros_like(TIME))
    assert metrics.rmse(run, "z", "r", scale=100.0) == pytest.approx(100.0 / math.sqrt(2.0), rel=1e-3)
    assert metrics.overshoot(run, "z", 0.8) == pytest.approx(25.0)
    assert metrics.overshoot(run, "z", 2.0) == 0.0
    assert metrics.mean(run, "z", [10.0, 20.0]) == pytest.approx(0.0, abs=1e-12)
    assert metrics.effort(run, "z") == pytest.approx(100.0 * 2.0 / math.pi, rel=1e-3)


def test_total_variation_can_be_sampled() -> None:
    run = recording(z=np.sin(TIME * 2 * math.pi))
    assert metrics.total_variation(run, "z") == pytest.approx(400.0)
    assert metrics.total_variation(run, "z", every=0.5) == pytest.approx(0.0, abs=1e-9)
    assert metrics.total_variation(run, "z", every=0.25) == pytest.approx(400.0)


def test_both_lags_find_a_known_delay() -> None:
    w = 0.5
    late = 3.0 * np.cos(w * (TIME - 1.234))
    run = recording(z=late, r=3.0 * np.cos(w * TIME), offset=late + 0.1)
    # linear interpolation between points 0.01 s apart, and the tolerance of the search
    assert metrics.shift_lag(run, "z", "r", largest=5.0) == pytest.approx(1.234, abs=1e-3)
    assert metrics.phase_lag(run, "offset", w) == pytest.approx(1.234, abs=1e-9)


def test_unknown_names_offer_the_nearest() -> None:
    run = recording(z=TIME)
    with pytest.raises(ScenarioError, match=r"metric a: unknown function 'rms'; nearest is 'rmse'"):
        metrics.evaluate(run, {"a": {"function": "rms"}})
    with pytest.raises(ScenarioError, match=r"metric a: .*reference"):
        metrics.evaluate(run, {"a": {"function": "rmse", "signal": "z"}})
    with pytest.raises(OrchestrationError, match=r"'zz' was not recorded; nearest is 'z'"):
        metrics.evaluate(run, {"a": {"function": "mean", "signal": "zz"}})
    for wrong in ({"window": [0.0]}, {"window": 3}, {"signal": 5}):
        with pytest.raises((ScenarioError, OrchestrationError), match=r"metric a|was not recorded"):
            metrics.evaluate(run, {"a": {"function": "mean", "signal": "z", **wrong}})
    with pytest.raises(ScenarioError, match=r"target = 0: expected another"):
        metrics.evaluate(run, {"a": {"function": "overshoot", "signal": "z", "target": 0.0}})
    with pytest.raises(ScenarioError, match=r"expected to overlap the run"):
        metrics.mean(run, "z", [200.0, 300.0])
