"""The PID with two degrees of freedom: poles, zeros and the ramp that it follows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from controller_fmu.baselines.pid import BLOCK, Parameters, control
from controller_fmu.observer import VelocitySource
from tests.controller_fmu.assumed_vehicle import DAMPING, INERTIA, WIDE, at, characteristic, closed_loop

START = Parameters(velocity_source=VelocitySource.MEASURED, voltage_limit=WIDE)


@pytest.mark.parametrize("w", [0.5, 1.0, 2.0])
def test_the_gains_place_three_poles_at_w(w: float) -> None:
    p = replace(START, kp=3 * INERTIA * w**2, ki=INERTIA * w**3, kd=3 * INERTIA * w - DAMPING)
    assert w != 1.0 or p == START
    polynomial = characteristic(lambda z, v, integral: control(at(z, v), p.ki * integral, p))
    assert polynomial == pytest.approx(np.poly([-w, -w, -w]), rel=1e-12)


@pytest.mark.parametrize("beta", [0.0, 0.5, 1.0])
def test_beta_places_the_zeros_and_no_pole(beta: float) -> None:
    """The answer to the ramp r = t is the step response of the transfer function, divided by s."""
    p, h = replace(START, beta=beta), 5e-3
    loop = closed_loop(BLOCK, p, h=h, stop_time=12.0, reference=lambda t: (t, 1.0, 0.0))
    zeros = np.trim_zeros([beta * (p.kd + DAMPING), p.kp, p.ki], "f")
    poles = [INERTIA, DAMPING + p.kd, p.kp, p.ki]
    _, expected = signal.step(signal.TransferFunction(zeros, [*poles, 0.0]), T=loop.time)
    late = 2.0 * h * max(loop.rate)  # the control is a step late, and held for one
    assert loop.depth == pytest.approx(expected, abs=late)
