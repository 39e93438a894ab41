"""A loop of vehicle, depth sensor, observer and law once more, from the equations alone.

Nothing of `controller_fmu`, `plant_fmu` or `fmus.numerics` is used. Depth and force are positive down.

    heave     M w' = F + w_d + (W - B(z)) (1 - w_f' / g) + M w_f' - D w_r - D_q |w_r| w_r
              z' = w,   w_r = w - v_c - w_f,   F' = (efficiency sat(u) - F) / T
    sensor    z, pressure head of the waves and noise every 40 ms, rounded to its resolution and held;
              ideal: z with the pressure head, and w, at every time
    observer  z_p = z_hat + T_o v,   z_hat = z_p + alpha (y - z_p),   v = v + beta / T_o (y - z_p)

Vehicle and law exchange at communication points, both at once (Jacobi), and hold in between what they
receive: what a law puts out depends on the measurement of the point before. The control that enters the
vehicle, or all that leaves it, may arrive late, on straight lines between communication points. Or vehicle
and law are one differential equation (`continuous`). A vehicle that pitches is in `second_plane`.
Source: Maalouf et al. (2013), (10) and section 4.1, with the errata of docs/fidelity.md.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.integrate import solve_ivp

_GRAVITY = 9.81  # m/s2
State = tuple[float, ...]
Pair = tuple[float, float]
Water = tuple[float, float, float]
STILL: Water = (0.0, 0.0, 0.0)
Values = Mapping[str, float]
Control = float | np.ndarray
"""Force [N], or force and moment [N.m]."""
Measured = Sequence[Pair]
"""Depth [m] and its rate, and what else a vehicle measures with its rate."""


class Law(Protocol):
    """A law between communication points."""

    def control(self) -> Control: ...

    def advance(self, t: float, measured: Measured, u: Control) -> None:
        """One step from t [s] on, which begins with what is measured while u is demanded."""
        ...


class ContinuousLaw(Protocol):
    """A law as a differential equation."""

    @property
    def start(self) -> State: ...

    def at(self, t: float, measured: Measured, state: State) -> tuple[Control, State]:
        """u and the rates of the law's states."""
        ...


class Held(NamedTuple):
    """What acts on a vehicle, as `Case` has it of time."""

    force: float
    moment: float
    current: float
    efficiency: Pair
    water: Water


class Body(Protocol):
    """A vehicle whose state begins with z and w."""

    @property
    def start(self) -> State: ...

    def sensed(self, state: State) -> Measured:
        """What its sensors would read in still water, and the rates."""
        ...

    def rates(self, state: State, demanded: Control, held: Held) -> State: ...


def largest_force(plant: Values) -> float:
    """Of both thrusters together [N]."""
    return 2.0 * plant["thruster_gain[1]"] * plant["thruster_voltage_limit[1]"]


def heave(p: Values, z: float, w: float, force: float, held: Held) -> float:
    """w' under this force of the thrusters."""
    submerged = p["weight"] - p["net_weight"] + p["buoyancy_change"]
    lost = p["water_density"] * _GRAVITY * p["waterplane_area"] * max(0.0, -z)
    net_weight = p["weight"] - max(0.0, submerged - lost)
    water_rate, water_acceleration, _ = held.water
    through = w - held.current - water_rate
    drag = p["linear_damping"] * through + p["quadratic_damping"] * abs(through) * through
    apparent = net_weight * (1.0 - water_acceleration / _GRAVITY)
    return (force + held.force + apparent - drag) / p["inertia"] + water_acceleration


class Heave:
    """States: z, w, F."""

    def __init__(self, case: "Case") -> None:
        self.p, self.limit = case.plant, largest_force(case.plant)
        self.start = (self.p["initial_depth"], 0.0, 0.0)

    def sensed(self, state: State) -> Measured:
        return ((state[0], state[1]),)

    def rates(self, state: State, demanded: Control, held: Held) -> State:
        z, w, force = state
        steady = 0.5 * sum(held.efficiency) * max(-self.limit, min(self.limit, float(demanded)))
        return w, heave(self.p, z, w, force, held), (steady - force) / self.p["thruster_lag[1]"]


@dataclass(frozen=True)
class Case:
    """plant, law: values by the names of the parameters; ideal: sensor and velocity.

    reference r [m], its rate and acceleration, force [N], moment [N.m], current v_c [m/s], efficiency of
    each thruster, 0..1: of time [s]
    water: velocity w_f [m/s], acceleration w_f' [m/s2] and pressure head [m] of waves, of time and depth
    noise: of every sample of the sensor [m]; delays [s]
    """

    plant: Values
    law: Values
    ideal: bool
    reference: Callable[[float], float]
    force: Callable[[float], float]
    duration: float
    reference_rate: Callable[[float], float] = lambda t: 0.0
    reference_acceleration: Callable[[float], float] = lambda t: 0.0
    moment: Callable[[float], float] = lambda t: 0.0
    current: Callable[[float], float] = lambda t: 0.0
    efficiency: Callable[[float], Pair] = lambda t: (1.0, 1.0)
    body: Callable[["Case"], Body] = Heave
    water: Callable[[float, float], Water] = lambda t, depth: STILL
    noise: Sequence[float] = ()
    control_delay: float = 0.0
    measurement_delay: float = 0.0

    def held(self, t: float, water: Water) -> Held:
        return Held(self.force(t), self.moment(t), self.current(t), self.efficiency(t), water)

    def reading(self, sample: int, depth: float) -> float:
        """What the sensor reads [m]."""
        noise = self.noise[sample] if self.noise else 0.0
        return rounded(depth + noise, self.plant["sensor_resolution"])

    @property
    def first_reading(self) -> float:
        body = self.body(self)
        water = self.water(0.0, body.start[0])
        return readings(self, body.sensed(body.start), water, None if self.ideal else 0)[0][0]


def run(case: Case, step: float, law: Law, parts: int = 1) -> dict[str, np.ndarray]:
    """Time, depth, reference, demand and state of the vehicle at communication points `step` s apart.

    parts: steps of the Runge-Kutta method of the vehicle from one point to the next
    """
    body, period = case.body(case), round(case.law["observer_period"] / step)
    state = body.start
    known, water = state[0], case.water(0.0, state[0])  # the waves know the depth of the point before
    first = readings(case, body.sensed(state), water, None if case.ideal else 0)
    sent, rates = [list[float]() for _ in first], [list[float]() for _ in first]
    observers = [(reading, 0.0) for reading, _ in first]
    states, controls = list[State](), list[Control]()
    for i in range(round(case.duration / step) + 1):
        t = i * step
        is_sampled = not case.ideal and i % period == 0
        now = readings(case, body.sensed(state), water, i // period if is_sampled else None)
        measured = list[Pair]()
        for k, (reading, rate) in enumerate(now):
            sent[k].append(reading if case.ideal or is_sampled else sent[k][-1])
            rates[k].append(rate)
            late = case.measurement_delay / step
            depth = arrived(sent[k], late)
            if is_sampled and i:
                observers[k] = observed(case.law, observers[k], depth)
            measured.append((depth, arrived(rates[k], late) if case.ideal else observers[k][1]))
        controls.append(u := law.control())
        states.append(state)
        known, water = state[0], case.water(t, known)
        demanded = arrived(controls, case.control_delay / step)
        held = case.held(t, water)
        for _ in range(parts):
            state = advanced(lambda x, u=demanded, h=held: body.rates(x, u, h), state, step / parts)
        law.advance(t, measured, u)
    time = step * np.arange(len(states))
    table = np.array(states)
    reference = np.array([case.reference(t) for t in time.tolist()])
    return {
        "time": time,
        "depth": table[:, 0],
        "reference": reference,
        "u": np.array(controls),
        "state": table,
    }


def continuous(case: Case, times: np.ndarray, law: ContinuousLaw) -> np.ndarray:
    """The states of the vehicle at these times, a column each; sensor and velocity are ideal."""
    body = case.body(case)
    n = len(body.start)

    def rates(t: float, state: np.ndarray) -> State:
        values = tuple(state.tolist())
        water = case.water(t, values[0])
        measured = readings(case, body.sensed(values[:n]), water, None)
        u, law_rates = law.at(t, measured, values[n:])
        held = case.held(t, water)
        return *body.rates(values[:n], u, held), *law_rates

    start = (*body.start, *law.start)
    span = (times[0], times[-1])
    return solve_ivp(rates, span, start, t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.05).y[:n].T


def readings(case: Case, sensed: Measured, water: Water, sample: int | None) -> Measured:
    """The depth under the pressure of waves, sampled by the sensor if there is a sample; others as sensed."""
    (depth, rate), *others = sensed
    pressed = depth + water[2]
    return (pressed if sample is None else case.reading(sample, pressed), rate), *others


def arrived(sent: Sequence[Any], steps: float) -> Any:
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


def unless_wider(rate: float, change_of_u: float, withheld: float) -> float:
    """The rate of an integral, 0 where the change that it makes to u would widen a saturation."""
    is_saturated = abs(withheld) > 1e-12  # N or N.m: else the rounding of an allocation
    return 0.0 if is_saturated and change_of_u * withheld < 0.0 else rate
