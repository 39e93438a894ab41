"""A loop of vehicle, depth sensor, observer and law once more, from the equations alone.

Nothing of `controller_fmu`, `plant_fmu` or `fmus.numerics` is used. Depth and force are positive down.

    vehicle   M w' = F + w_d + (W - B(z)) (1 - w_f' / g) + M w_f' - D w_r - D_q |w_r| w_r
              z' = w,   w_r = w - v_c - w_f,   F' = (efficiency sat(u) - F) / T
    sensor    z, pressure head of the waves and noise every 40 ms, rounded to its resolution and held;
              ideal: z with the pressure head, and w, at every time
    observer  z_p = z_hat + T_o v,   z_hat = z_p + alpha (y - z_p),   v = v + beta / T_o (y - z_p)

Vehicle and law exchange at communication points, both at once (Jacobi), and hold in between what they
receive: what a law puts out depends on the measurement of the point before. The control that enters the
vehicle, or all that leaves it, may arrive late, on straight lines between communication points.
Source: Maalouf et al. (2013), (10) and section 4.1, with the errata of docs/fidelity.md.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

_GRAVITY = 9.81  # m/s2
State = tuple[float, ...]
Pair = tuple[float, float]
Water = tuple[float, float, float]
STILL: Water = (0.0, 0.0, 0.0)
Values = Mapping[str, float]


class Law(Protocol):
    """A law between communication points."""

    def control(self) -> float:
        """u [N]."""
        ...

    def advance(self, t: float, x: Pair, u: float) -> None:
        """One step from t [s] on, which begins with the measured depth and its rate x while u is demanded."""
        ...


@dataclass(frozen=True)
class Case:
    """plant, law: values by the names of the parameters; ideal: sensor and velocity.

    reference [m], force [N], current v_c [m/s], efficiency of both thrusters together, 0..1: of time [s]
    water: velocity w_f [m/s], acceleration w_f' [m/s2] and pressure head [m] of waves, of time and depth
    noise: of every sample of the sensor [m]; delays [s]
    """

    plant: Values
    law: Values
    ideal: bool
    reference: Callable[[float], float]
    force: Callable[[float], float]
    duration: float
    current: Callable[[float], float] = lambda t: 0.0
    efficiency: Callable[[float], float] = lambda t: 1.0
    water: Callable[[float, float], Water] = lambda t, depth: STILL
    noise: Sequence[float] = ()
    control_delay: float = 0.0
    measurement_delay: float = 0.0

    def reading(self, sample: int, depth: float) -> float:
        """What the sensor reads [m]."""
        noise = self.noise[sample] if self.noise else 0.0
        return rounded(depth + noise, self.plant["sensor_resolution"])

    @property
    def first_reading(self) -> float:
        depth = self.plant["initial_depth"]
        pressed = depth + self.water(0.0, depth)[2]
        return pressed if self.ideal else self.reading(0, pressed)


def largest_force(plant: Values) -> float:
    """Of both thrusters together [N]."""
    return 2.0 * plant["thruster_gain[1]"] * plant["thruster_voltage_limit[1]"]


def vehicle(
    p: Values,
    state: State,
    demanded: float,
    disturbance: float,
    current: float = 0.0,
    efficiency: float = 1.0,
    water: Water = STILL,
) -> State:
    """Rates of z, w and F."""
    z, w, force = state
    limit = largest_force(p)
    submerged = p["weight"] - p["net_weight"] + p["buoyancy_change"]
    lost = p["water_density"] * _GRAVITY * p["waterplane_area"] * max(0.0, -z)
    net_weight = p["weight"] - max(0.0, submerged - lost)
    through = w - current - water[0]
    drag = p["linear_damping"] * through + p["quadratic_damping"] * abs(through) * through
    apparent = net_weight * (1.0 - water[1] / _GRAVITY)
    acceleration = (force + disturbance + apparent - drag) / p["inertia"] + water[1]
    steady = efficiency * max(-limit, min(limit, demanded))
    return w, acceleration, (steady - force) / p["thruster_lag[1]"]


def run(case: Case, step: float, law: Law) -> dict[str, np.ndarray]:
    """Time, depth, reference and demanded force at communication points `step` s apart."""
    plant, period = case.plant, round(case.law["observer_period"] / step)
    state, observer = (plant["initial_depth"], 0.0, 0.0), (case.first_reading, 0.0)
    rows, depths, rates, controls = list[State](), list[float](), list[float](), list[float]()
    known, water = state[0], case.water(0.0, state[0])  # the waves know the depth of the point before
    for i in range(round(case.duration / step) + 1):
        t = i * step
        is_sampled = not case.ideal and i % period == 0
        pressed = state[0] + water[2]
        sent = case.reading(i // period, pressed) if is_sampled else pressed if case.ideal else depths[-1]
        depths.append(sent)
        rates.append(state[1])
        late = case.measurement_delay / step
        depth, rate = arrived(depths, late), arrived(rates, late)
        if is_sampled and i:
            observer = observed(case.law, observer, depth)
        controls.append(u := law.control())
        rows.append((t, state[0], case.reference(t), u))
        known, water = state[0], case.water(t, known)
        held = (
            arrived(controls, case.control_delay / step),
            case.force(t),
            case.current(t),
            case.efficiency(t),
            water,
        )
        state = advanced(lambda x, held=held: vehicle(plant, x, *held), state, step)
        law.advance(t, (depth, rate if case.ideal else observer[1]), u)
    return dict(zip(("time", "depth", "reference", "u"), np.array(rows).T, strict=True))


def arrived(sent: Sequence[float], steps: float) -> float:
    """What was sent so many steps before the last value, on a line between two values; at first the first."""
    position = max(0.0, len(sent) - 1 - steps)
    before = int(position)
    after = min(before + 1, len(sent) - 1)
    return sent[before] + (position - before) * (sent[after] - sent[before])


def rounded(depth: float, resolution: float) -> float:
    """The nearest multiple of the resolution; the depth itself for 0."""
    return resolution * math.floor(depth / resolution + 0.5) if resolution else depth


def observed(p: Values, estimate: Pair, measured: float) -> Pair:
    """Depth and its rate after a reading."""
    predicted = estimate[0] + p["observer_period"] * estimate[1]
    innovation = measured - predicted
    return (
        predicted + p["observer_alpha"] * innovation,
        estimate[1] + p["observer_beta"] / p["observer_period"] * innovation,
    )


def advanced(rates: Callable[[State], State], x: State, h: float) -> State:
    """x after h seconds: one step of the classical Runge-Kutta method."""
    a = rates(x)
    b = rates(tuple(p + 0.5 * h * q for p, q in zip(x, a, strict=True)))
    c = rates(tuple(p + 0.5 * h * q for p, q in zip(x, b, strict=True)))
    d = rates(tuple(p + h * q for p, q in zip(x, c, strict=True)))
    steps = zip(x, a, b, c, d, strict=True)
    return tuple(p + h / 6.0 * (k + 2.0 * m + 2.0 * n + q) for p, k, m, n, q in steps)


def projected(estimate: float, rate: float, bound: float, eps: float) -> float:
    """Proj(estimate, rate): the rate that keeps an estimate within its bound."""
    f = ((1.0 + eps) * estimate * estimate - bound * bound) / (eps * bound * bound)
    return rate * (1.0 - f) if f > 0.0 and estimate * rate > 0.0 else rate
