"""Metrics of a made-up run whose voltages and depth are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestration.results.recording import Recording
from orchestration.scenarios.actuators import VOLTAGES, Actuators
from orchestration.score.protocol import Protocol
from orchestration.score.run_metrics import declared, failures, judged_signals, metrics_of

STEP = 0.02
TIME = STEP * np.arange(round(310.0 / STEP) + 1)
NAMES = ("reference", "depth", "one", "two")


def run(depth: np.ndarray, one: np.ndarray, two: np.ndarray) -> Recording:
    """Signals that metrics are computed of; limits 3 V and 12 V, gains 0.2 N/V and 0.3 N/V."""
    reference = np.interp(TIME, [0.0, 40.0, 140.0, 180.0, 250.0, 310.0], [0.0, 0.8, 0.8, 0.4, 0.4, 0.6])
    values = np.column_stack([reference, depth, one, two])
    recording = Recording(NAMES, ("m", "m", "V", "V"), TIME, values)
    return judged_signals(recording, NAMES, Actuators(VOLTAGES, (0.2, 0.3), ((-3.0, 3.0), (-12.0, 12.0))))


def test_u_and_power_are_of_what_the_vehicle_can_deliver() -> None:
    signals = run(np.zeros_like(TIME), np.full_like(TIME, -5.0), np.full_like(TIME, 4.0))
    assert signals["u"][0] == pytest.approx(-3.0 * 0.2 + 4.0 * 0.3)
    assert signals["power"][0] == 9.0 + 16.0
    assert signals["voltage"][0] == 5.0
    assert signals["saturated"][0] == 100.0


def test_metrics_of_a_depth_that_is_ahead_by_a_constant(protocol: Protocol) -> None:
    """z = r + 0.02 m; both voltages a square wave of 1 V and 2 V with a period of 2 s."""
    wave = 1.0 + (np.floor(TIME + 1e-9) % 2)
    reference = run(np.zeros_like(TIME), wave, wave)["reference"]
    metrics = metrics_of(run(reference + 0.02, wave, wave), declared(protocol.nominal, protocol))
    assert metrics["rmse"] == pytest.approx(2.0)
    assert metrics["peak_error"] == pytest.approx(2.0)
    assert metrics["iae"] == pytest.approx(0.02 * 310.0)
    assert metrics["ise"] == pytest.approx(0.02**2 * 310.0)
    assert metrics["itae"] == pytest.approx(0.02 * 310.0**2 / 2.0)
    assert metrics["overshoot"] == pytest.approx(2.5)
    assert metrics["settling_time"] == pytest.approx(37.0, abs=STEP)  # where r is 0.74 m
    assert metrics["total_variation"] == pytest.approx(310 * 0.5)  # a change every second; 0.5 N/V in all
    assert metrics["effort"] == pytest.approx(
        0.5 * 1.5 * 310.0, rel=1e-3
    )  # of 310 s, half a step each change
    assert metrics["energy"] == pytest.approx(2.0 * 2.5 * 310.0, rel=1e-3)
    assert metrics["peak_voltage"] == 2.0
    assert metrics["saturated"] == 0.0
    assert metrics["breach"] == 0.0
    assert failures(metrics, protocol) == []


def test_a_vehicle_that_stays_at_the_surface_failed(protocol: Protocol) -> None:
    zero = np.zeros_like(TIME)
    metrics = metrics_of(run(zero, zero, zero), declared(protocol.nominal, protocol))
    assert math.isnan(metrics["settling_time"])
    assert math.isnan(metrics["breach"])
    assert failures(metrics, protocol) == ["not settled"]


def test_overshoot_and_breach_are_failures_with_their_numbers(protocol: Protocol) -> None:
    zero = np.zeros_like(TIME)
    depth = np.where(TIME < 60.0, 0.9, np.where(TIME < 70.0, 0.0, 0.8))
    metrics = metrics_of(run(depth, zero, zero), declared(protocol.nominal, protocol))
    # 499 steps at 0 m, and what is above 0.05 m of the lines down from 0.9 m and up to 0.8 m
    assert metrics["breach"] == pytest.approx(STEP * (499 + 0.05 / 0.9 + 0.05 / 0.8))
    assert failures(metrics, protocol) == ["overshoot 12.5 %", "breach 9.98 s"]


def test_where_the_reference_does_not_move_there_is_neither_lag_nor_overshoot(protocol: Protocol) -> None:
    zero = np.zeros_like(TIME)
    holding = replace(protocol.nominal, target=replace(protocol.nominal.target, moves=False))
    metrics = metrics_of(
        run(zero + 0.8, zero, zero), declared(holding, protocol, ["lag", "overshoot", "rmse"])
    )
    assert math.isnan(metrics["lag"])
    assert math.isnan(metrics["overshoot"])
    assert set(metrics) == {"lag", "overshoot", "rmse"}
