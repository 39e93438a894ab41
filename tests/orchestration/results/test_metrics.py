"""Metrics on made-up recordings whose numbers are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.results import metrics
from orchestration.results.metric_units import metrics_table, with_units
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


def test_recovery_time_is_the_settling_time_after_the_disturbance() -> None:
    z = 1.0 + 0.1 * np.where(TIME >= 20.0, np.exp(-(TIME - 20.0) / 10.0), 0.0)
    expected = pytest.approx(10.0 * math.log(5.0), abs=0.011)  # one communication step
    assert metrics.recovery_time(recording(z=z), "z", 1.0, 0.02, [20.0, 100.0]) == expected
    assert metrics.recovery_time(recording(z=z), "z", 1.0, 0.2, [20.0, 100.0]) == 0.0
    assert math.isnan(metrics.recovery_time(recording(z=z), "z", 1.0, 0.02, [20.0, 30.0]))


def test_std_is_about_the_mean_of_the_window() -> None:
    run = recording(z=np.where(TIME < 5.0, 50.0, 3.0 + np.sin(TIME * 2 * math.pi)))
    assert metrics.std(run, "z", [10.0, 20.0], scale=100.0) == pytest.approx(100.0 / math.sqrt(2.0), rel=1e-3)


def test_rmse_overshoot_mean_effort() -> None:
    run = recording(z=np.sin(TIME * 2 * math.pi), r=np.zeros_like(TIME))
    assert metrics.rmse(run, "z", "r", scale=100.0) == pytest.approx(100.0 / math.sqrt(2.0), rel=1e-3)
    assert metrics.overshoot(run, "z", 0.8) == pytest.approx(25.0)
    assert metrics.overshoot(run, "z", 2.0) == 0.0
    assert metrics.mean(run, "z", [10.0, 20.0]) == pytest.approx(0.0, abs=1e-12)
    assert metrics.effort(run, "z") == pytest.approx(100.0 * 2.0 / math.pi, rel=1e-3)


def test_integrals_of_an_error_are_those_of_its_formula() -> None:
    """Of e = 2 exp(-t / 10), e^2 and t e from 0 to 100; the trapezoidal rule errs by h^2 / 1200."""
    run = recording(z=1.0 - 2.0 * np.exp(-TIME / 10.0), r=np.ones_like(TIME))
    end = math.exp(-10.0)
    assert metrics.iae(run, "z", "r") == pytest.approx(20.0 * (1.0 - end), rel=1e-6)
    assert metrics.ise(run, "z", "r") == pytest.approx(20.0 * (1.0 - end**2), rel=1e-6)
    assert metrics.itae(run, "z", "r") == pytest.approx(200.0 * (1.0 - 11.0 * end), rel=1e-6)
    assert metrics.peak_error(run, "z", "r", scale=100.0) == 200.0


def test_integrals_of_a_window_begin_there() -> None:
    """e = t - 20 is -5 .. 5 over 15 .. 25: time counts from 15 on, and the rule is exact for lines."""
    run = recording(z=TIME, r=np.full_like(TIME, 20.0))
    window = [15.0, 25.0]
    assert metrics.iae(run, "z", "r", window) == pytest.approx(25.0)
    assert metrics.ise(run, "z", "r", window) == pytest.approx(250.0 / 3.0, rel=1e-5)  # h^2 / 6 * 10
    assert metrics.itae(run, "z", "r", window) == pytest.approx(125.0, rel=1e-5)
    assert metrics.peak_error(run, "z", "r", window) == pytest.approx(5.0)
    assert metrics.peak(run, "z", window) == 25.0
    assert metrics.peak(recording(z=-TIME), "z", scale=2.0) == 200.0


def test_time_below_counts_from_the_first_crossing_and_between_points() -> None:
    """1 - |t - 50| / 50 is above 0.5 from 25 s, and below 0.105 from 94.75 s, between two points of 1 s."""
    every_second = TIME[::100]
    triangle = 1.0 - np.abs(every_second - 50.0) / 50.0
    run = Recording(("z",), ("m",), every_second, triangle[:, None])
    assert metrics.time_below(run, "z", limit=0.105, after=0.5) == pytest.approx(5.25)
    assert metrics.time_below(run, "z", 0.105, 0.5, [0.0, 97.0]) == pytest.approx(2.25)
    assert metrics.time_below(run, "z", limit=-1.0, after=0.5) == 0.0
    assert math.isnan(metrics.time_below(run, "z", limit=0.1, after=2.0))
    flat = recording(z=np.where(TIME < 50.0, 1.0, 0.0))
    assert metrics.time_below(flat, "z", limit=0.5, after=0.9) == pytest.approx(50.0, abs=0.01)


def test_a_signal_that_is_no_number_has_no_metric() -> None:
    """What is not known is neither a good run nor a bad one."""
    lost = np.where(TIME < 60.0, np.sin(TIME), np.nan)
    run = recording(z=lost, r=np.sin(TIME))
    assert math.isnan(metrics.overshoot(run, "z", 1.0))
    assert math.isnan(metrics.time_below(run, "z", limit=3.0, after=0.5))
    uneven = Recording(("z", "r"), ("m", "m"), TIME**1.01, np.column_stack([lost, np.sin(TIME)]))
    for points in (run, uneven):
        assert math.isnan(metrics.shift_lag(points, "z", "r", largest=1.0))


def test_maximum_and_minimum_keep_the_sign() -> None:
    """-50 .. 50, and -30 .. -10 in the window: the peak is a magnitude, these are not."""
    run = recording(z=TIME - 50.0)
    assert (metrics.minimum(run, "z"), metrics.maximum(run, "z")) == (-50.0, 50.0)
    window = [20.0, 40.0]
    assert (metrics.minimum(run, "z", window), metrics.maximum(run, "z", window)) == (-30.0, -10.0)
    assert metrics.maximum(run, "z", window, scale=100.0) == -1000.0


def test_time_above_counts_between_points_too() -> None:
    """The triangle 1 - |t - 50| / 50 is above 0.105 from 5.25 s to 94.75 s, both between points of 1 s."""
    every_second = TIME[::100]
    triangle = 1.0 - np.abs(every_second - 50.0) / 50.0
    run = Recording(("z",), ("m",), every_second, triangle[:, None])
    assert metrics.time_above(run, "z", limit=0.105) == pytest.approx(89.5)
    assert metrics.time_above(run, "z", 0.105, [0.0, 50.0]) == pytest.approx(44.75)
    assert metrics.time_above(run, "z", limit=2.0) == 0.0
    assert metrics.time_above(run, "z", limit=-1.0) == 100.0
    assert metrics.time_above(recording(z=np.ones_like(TIME)), "z", limit=1.0) == 0.0


def test_a_duty_cycle_is_the_share_of_a_pulse_that_holds_from_point_to_point() -> None:
    """On for 3 s of every 10 s; the point at which it goes off ends the pulse, in steps of any length."""
    on = (TIME % 10.0 < 3.0 - 1e-9).astype(float)  # 1e-9 s: the rounding of TIME
    pulses = recording(z=on)
    # the trapezoidal rule would give each edge half a step of 0.01 s: 30.0 % to the rounding of the sum
    assert metrics.duty_cycle(pulses, "z") == pytest.approx(30.0, rel=1e-9)
    assert metrics.duty_cycle(pulses, "z", window=[0.0, 4.0]) == pytest.approx(75.0, rel=1e-9)
    assert metrics.duty_cycle(recording(z=on * 12.0), "z", limit=12.0) == 0.0
    uneven = Recording(("z",), ("",), np.array([0.0, 1.0, 4.0, 5.0]), np.array([[0.0], [1.0], [0.0], [1.0]]))
    assert metrics.duty_cycle(uneven, "z") == 60.0


def test_a_share_of_time_is_not_a_number_without_time_or_with_such_a_value() -> None:
    run = recording(z=np.where(TIME == 50.0, math.nan, 1.0))
    assert math.isnan(metrics.duty_cycle(run, "z"))
    assert math.isnan(metrics.time_above(run, "z", limit=0.5))
    assert metrics.duty_cycle(run, "z", window=[0.0, 49.0]) == 100.0
    assert metrics.time_above(run, "z", 0.5, [0.0, 49.0]) == pytest.approx(49.0)
    assert math.isnan(metrics.duty_cycle(run, "z", window=[7.0, 7.0]))
    declared = {"on": {"function": "duty_cycle"}}
    assert metrics_table("One", {"on": math.nan}, {"on": "%"}, declared).splitlines()[-1].split() == [
        "on",
        "no",
        "time",
        "passes",
        "%",
    ]


def test_total_variation_can_be_sampled() -> None:
    run = recording(z=np.sin(TIME * 2 * math.pi))
    assert metrics.total_variation(run, "z") == pytest.approx(400.0)
    assert metrics.total_variation(run, "z", every=0.5) == pytest.approx(0.0, abs=1e-9)
    assert metrics.total_variation(run, "z", every=0.25) == pytest.approx(400.0)
    # the last interval is a part of one
    assert metrics.total_variation(recording(z=TIME), "z", every=0.3 * TIME[-1]) == pytest.approx(TIME[-1])


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


def never_moves() -> Recording:
    """A vehicle that stays at 0 while it is commanded down and up again."""
    return recording(z=np.zeros_like(TIME), r=0.8 * (TIME < 60.0))


def test_what_does_not_settle_has_no_settling_time() -> None:
    run = never_moves()
    assert math.isnan(metrics.settling_time(run, "z", 0.8, 0.04))
    assert math.isnan(metrics.settling_time(run, "z", 0.8, 0.04, [0.0, 50.0]))
    lost = np.where(TIME > 99.0, np.nan, 0.8)
    assert math.isnan(metrics.settling_time(recording(z=lost), "z", 0.8, 0.04))


def test_a_delay_at_an_edge_of_the_search_is_none() -> None:
    wave = {delay: 3.0 * np.cos(0.5 * (TIME - delay)) for delay in (-1.0, 0.0, 4.9, 5.1)}
    run = recording(r=wave[0.0], leads=wave[-1.0], late=wave[4.9], later=wave[5.1])
    assert metrics.shift_lag(run, "late", "r", largest=5.0) == pytest.approx(4.9, abs=1e-3)  # as above
    assert metrics.shift_lag(run, "r", "r", largest=5.0) == pytest.approx(0.0, abs=1e-9)  # rounding
    for signal in ("leads", "later"):
        assert math.isnan(metrics.shift_lag(run, signal, "r", largest=5.0))
    assert math.isnan(metrics.shift_lag(never_moves(), "z", "r", largest=30.0))
    assert math.isnan(metrics.shift_lag(never_moves(), "r", "z", largest=30.0))  # equally far at every delay
    with pytest.raises(ScenarioError, match=r"largest = 200: expected less than the 100 s of the run"):
        metrics.shift_lag(run, "r", "r", largest=200.0)


def test_a_signal_that_does_not_oscillate_has_no_phase() -> None:
    assert math.isnan(metrics.phase_lag(recording(z=np.full_like(TIME, 0.8)), "z", 0.5))
    assert math.isnan(metrics.phase_lag(never_moves(), "z", 0.5))


def test_the_overshoot_of_a_negative_target_is_beyond_it() -> None:
    up = recording(z=-0.8 * (1.0 - np.exp(-TIME / 10.0)))
    assert metrics.overshoot(up, "z", -0.8) == 0.0
    assert metrics.overshoot(up, "z", -0.5) == pytest.approx(60.0, rel=1e-3)  # 0.8 of 0.5, reached to 5e-5


def test_what_did_not_happen_is_null_in_a_file_and_a_word_in_a_table() -> None:
    declared = {"settling_time": {"function": "settling_time", "signal": "z", "target": 0.8, "band": 0.04}}
    values = metrics.evaluate(never_moves(), declared)
    assert with_units(values, {"settling_time": "s"}) == {"settling_time": {"value": None, "unit": "s"}}
    table = metrics_table("A run", values, {"settling_time": "s"}, declared)
    assert table.splitlines() == [
        "A run",
        "Metric               Value  Unit",
        "settling_time  not settled  s",
    ]


def test_where_an_fmu_terminated_the_run_metrics_of_later_times_are_not_a_number() -> None:
    signals = {"z": TIME, "r": TIME}
    ended = replace(recording(**signals), provenance={"terminated": {"component": "a", "time_s": 100.0}})
    calls = {
        "within": {"function": "mean", "signal": "z", "window": [0.0, 100.0]},
        "without": {"function": "mean", "signal": "z"},
        "across": {"function": "mean", "signal": "z", "window": [90.0, 110.0]},
        "behind": {"function": "mean", "signal": "z", "window": [110.0, 120.0]},
        "lag": {"function": "shift_lag", "signal": "z", "reference": "r", "largest": 200.0},
    }
    values = metrics.evaluate(ended, calls)
    assert {name for name, value in values.items() if math.isnan(value)} == {"across", "behind", "lag"}
    assert values["within"] == values["without"] == pytest.approx(50.0)
    with pytest.raises(ScenarioError, match="metric behind: window"):
        metrics.evaluate(recording(**signals), calls)
