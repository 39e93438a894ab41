"""Integral sliding mode: the time to the boundary layer, and the poles inside it."""

from dataclasses import replace
from math import copysign, sin

import numpy as np
import pytest

from controller_fmu.baselines.sliding_mode import BLOCK, Parameters, control
from controller_fmu.observer import VelocitySource
from tests.controller_fmu.assumed_vehicle import INERTIA, WIDE, at, characteristic, closed_loop

START = Parameters(velocity_source=VelocitySource.MEASURED, voltage_limit=WIDE, boundary_layer=0.05)
LARGEST = 1.5  # N, of the disturbance
H = 1e-3


@pytest.mark.parametrize(("kind", "depth"), [("worst", 0.5), ("best", -0.5), ("sine", 0.5)])
def test_the_boundary_layer_is_reached_in_the_time_that_theory_gives(kind: str, depth: float) -> None:
    """M (|s(0)| - phi) / (K - d) s for a d that pushes s away, the longest, or back; it is not left again."""
    p, sign = START, copysign(1.0, depth)
    disturbance = {
        "worst": lambda t: sign * LARGEST,
        "best": lambda t: -sign * LARGEST,
        "sine": lambda t: LARGEST * sin(3.0 * t),
    }[kind]
    loop = closed_loop(BLOCK, p, h=H, stop_time=4.0, depth=depth, disturbance=disturbance)
    s = abs(loop.outputs["sliding_variable"])
    outside = INERTIA * (s[0] - p.boundary_layer)
    reached = loop.time[np.argmax(s <= p.boundary_layer)]
    slowest, fastest = (outside / (p.switching_gain - d) for d in (LARGEST, -LARGEST))
    step = 0.02 * slowest  # what holding the control for H changes
    assert fastest - step <= reached <= slowest + step
    if kind != "sine":
        assert reached == pytest.approx(slowest if kind == "worst" else fastest, abs=step)
    assert max(s[loop.time > reached]) <= 1.01 * p.boundary_layer


def test_inside_the_layer_the_loop_has_the_stated_poles() -> None:
    p = replace(START, error_bandwidth=0.7, switching_gain=3.0, boundary_layer=0.4)
    small = 1e-3  # s stays inside

    def force(z: float, v: float, integral: float) -> float:
        return control(at(small * z, small * v), small * integral, p) / small

    poles = -0.7, -0.7, -3.0 / (INERTIA * 0.4)
    assert characteristic(force) == pytest.approx(np.poly(poles), rel=1e-12)


def test_outside_the_layer_only_the_sign_of_s_counts() -> None:
    """u differs from that on the edge of the layer by the equivalent control alone."""
    p = replace(START, model_inertia=1e-9, model_damping=0.0)
    assert control(at(z=5.0), 0.0, p) == pytest.approx(-p.switching_gain)
    assert control(at(z=-0.05), 0.0, p) == pytest.approx(p.switching_gain)
