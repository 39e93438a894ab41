"""The vehicle that the depth controllers assume, M z'' + D z' = u + d, with ideal sensor and thrusters."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from controller_fmu.depth_interface import DepthInputs, DepthMeasurement
from controller_fmu.observer import VelocitySource
from fmus.block import Block

INERTIA, DAMPING = 5.5, 2.5  # kg, N.s/m: start values of the controllers
WIDE = 1e4  # V: nothing saturates


def moved(h: float, z: float, v: float, force: float) -> tuple[float, float]:
    """Depth and rate h s later under a held force: exact."""
    steady, left = force / DAMPING, math.exp(-DAMPING * h / INERTIA)
    return z + steady * h + (v - steady) * INERTIA / DAMPING * (1.0 - left), steady + (v - steady) * left


def characteristic(force: Callable[[float, float, float], float]) -> np.ndarray:
    """Coefficients of the loop's polynomial, force(z, v, integral of z) being linear and r being 0."""
    of_depth, of_rate, of_integral = force(1.0, 0.0, 0.0), force(0.0, 1.0, 0.0), force(0.0, 0.0, 1.0)
    return np.array([1.0, (DAMPING - of_rate) / INERTIA, -of_depth / INERTIA, -of_integral / INERTIA])


def at(z: float = 0.0, v: float = 0.0, r: float = 0.0, rate: float = 0.0) -> DepthMeasurement:
    return DepthMeasurement(z, v, r, rate)


@dataclass(frozen=True)
class Loop:
    """What a controller and the vehicle did, one row for each communication point."""

    time: np.ndarray
    depth: np.ndarray
    rate: np.ndarray
    outputs: dict[str, np.ndarray]


def closed_loop(
    block: Block,
    parameters: Any,
    *,
    stop_time: float,
    h: float = 2e-3,
    depth: float = 0.0,
    reference: Callable[[float], tuple[float, float, float]] = lambda t: (0.0, 0.0, 0.0),
    disturbance: Callable[[float], float] = lambda t: 0.0,
) -> Loop:
    """The block's functions in a Jacobi loop with the vehicle; reference: r, r' and r'' at a time."""
    gain, calculated = sum(parameters.thruster_gain), block.calculate(parameters)
    z, v, rows = depth, 0.0, []
    assert getattr(parameters, "velocity_source", VelocitySource.MEASURED) == VelocitySource.MEASURED

    def inputs(t: float) -> DepthInputs:
        r, rate, acceleration = reference(t)
        return DepthInputs(r, rate, acceleration, z, v)

    state = block.initial_state(0.0, inputs(0.0), parameters, calculated)
    for k in range(round(stop_time / h)):
        t = k * h
        output = block.output(t, state, parameters, calculated)
        rows.append((t, z, v, output))
        state = block.step(t, h, state, inputs(t), parameters, calculated)
        z, v = moved(h, z, v, 0.5 * gain * sum(output.voltage) + disturbance(t))
    names = [name for name, value in vars(rows[0][3]).items() if isinstance(value, float)]
    columns = {name: np.array([getattr(row[3], name) for row in rows]) for name in names}
    time, depths, rates = (np.array([row[i] for row in rows]) for i in range(3))
    return Loop(time, depths, rates, columns)
