"""A vehicle that pitches and the L1 law of both axes, in the loop of `second_loop`, from the equations alone.

    vehicle   M w' = sum F_i cos(theta) + ... as in heave,   z' = w
              I q' = -sum x_i F_i + M_ext - W BG sin(theta) - D_M q - D_Mq q |q|,   theta' = q
    thruster  V -> K V, or a table of forces times its scale, times efficiency; then a lag T, if any, and
              (b_1 s + a_0) / (s^3 + a_2 s^2 + a_1 s + a_0), if any
    sensors   z - x_s sin(theta) + z_s cos(theta) - z_s with the waves' pressure head, and theta
    voltages  of forces with sum F_i = u cos(theta) and -sum x_i F_i = moment, by gain or by the inverse
              table; both thrusters alike where a law has no moment
    L1        of the pitch is that of the depth with A = [[0, 1], [-K / I, -D / I]] and r = 0. Where the limit
              of a thruster allows only one of force and moment, the other gives way, by priority

theta is positive bow up, x_i forward, forces down; K: righting moment of a radian. u cos(theta) is (11) of
Maalouf et al. (2013), J' tau: the vertical force of a tilted vehicle is then cos(theta)^2 of u.
Sources: Fossen, Handbook of Marine Craft (2011); von Benzon et al. (2022) for the transfer function;
Hovakimyan and Cao (2010) for the law.
"""

import math
from dataclasses import replace

import numpy as np

from tests.closed_loop.second_loop import (
    STILL,
    Case,
    Control,
    Heave,
    Held,
    Measured,
    Pair,
    State,
    Values,
    heave,
)
from tests.closed_loop.second_program import Equations, L1Case, LawStep, law_of


class Plane:
    """States: z, w, theta, q, and of each thruster the lag and the three states of the transfer function."""

    def __init__(self, case: Case) -> None:
        p, law = case.plant, case.law
        self.p, self.law, names = p, law, range(1, 25)
        self.levers = (p["thruster_lever[1]"], p["thruster_lever[2]"])
        self.b_1, *self.a = (p[f"thruster_transfer[{i}]"] for i in range(1, 5))
        self.voltages = [p[f"thruster_table_voltage[{i}]"] for i in names]
        self.forces = [p[f"thruster_table_force[{i}]"] for i in names]
        self.start = (p["initial_depth"], 0.0, p["initial_pitch"], *(0.0,) * 9)

    def sensed(self, state: State) -> Measured:
        z, w, theta, q = state[:4]
        forward, below = self.p["sensor_forward"], self.p["sensor_below"]
        return (z - forward * math.sin(theta) + below * (math.cos(theta) - 1.0), w), (theta, q)

    def voltage(self, i: int, wanted: float) -> float:
        """Of the thruster that is to give this force; the table has none for forces about 0."""
        law, name = self.law, f"[{i + 1}]"
        if not law.get("thruster_tabulated"):
            return wanted / law[f"thruster_gain{name}"]
        return float(np.interp(wanted / law[f"thruster_scale{name}"], self.forces, self.voltages))

    def steady(self, i: int, voltage: float, p: Values) -> float:
        """Force of the thruster at rest, by the numbers of the vehicle or of the law."""
        name = f"[{i + 1}]"
        if p.get("thruster_tabulated"):
            return p[f"thruster_scale{name}"] * float(np.interp(voltage, self.voltages, self.forces))
        return p[f"thruster_gain{name}"] * voltage

    def wanted(self, demanded: Control) -> Pair:
        """Forces of the thrusters."""
        if not isinstance(demanded, np.ndarray):
            return 0.5 * demanded, 0.5 * demanded
        force, moment = demanded.tolist()
        first, second = self.law["thruster_lever[1]"], self.law["thruster_lever[2]"]
        fore = -(moment + second * force) / (first - second)
        return fore, force - fore

    def rates(self, state: State, demanded: Control, held: Held) -> State:
        p, (z, w, theta, q) = self.p, state[:4]
        forces, thrusters = list[float](), list[float]()
        for i, wanted in enumerate(self.wanted(demanded)):
            lagged, *x = state[4 + 4 * i : 8 + 4 * i]
            limit = p[f"thruster_voltage_limit[{i + 1}]"]
            voltage = max(-limit, min(limit, self.voltage(i, wanted)))
            entered = held.efficiency[i] * self.steady(i, voltage, p)
            lag = p[f"thruster_lag[{i + 1}]"]
            thrusters.append((entered - lagged) / lag if lag else 0.0)
            entered = lagged if lag else entered
            a_2, a_1, a_0 = self.a
            thrusters += [x[1], x[2], entered - a_0 * x[0] - a_1 * x[1] - a_2 * x[2]] if a_0 else [0.0] * 3
            forces.append(a_0 * x[0] + self.b_1 * x[1] if a_0 else entered)
        moment = -sum(x * f for x, f in zip(self.levers, forces, strict=True))
        righting = p["weight"] * p["metacentric_height"] * math.sin(theta)
        damping = (p["pitch_linear_damping"] + p["pitch_quadratic_damping"] * abs(q)) * q
        turned = (moment + held.moment - righting - damping) / p["pitch_inertia"]
        return w, heave(p, z, w, sum(forces) * math.cos(theta), held), q, turned, *thrusters


def axis_of_pitch(case: L1Case) -> L1Case:
    """The law of the pitch as one of depth."""
    law = {name.removeprefix("pitch_"): case.law[name] for name in case.law if name.startswith("pitch_")}
    law = {**case.law, **law, "depth_feedback_gain": law["feedback_gain"]}
    plant = {**case.plant, "initial_depth": case.plant["initial_pitch"], "sensor_resolution": 0.0}
    still = {"noise": (), "reference": lambda t: 0.0, "water": lambda t, depth: STILL, "body": Heave}
    own = {"augmentation": case.pitch_augmentation, "feedforward": "none"}
    return replace(case, plant=plant, law=law, **own, **still)


class HeavePitch:
    """The law of both axes between communication points, of like thrusters with levers x and -x."""

    def __init__(self, case: L1Case, step: float, kind: LawStep) -> None:
        self.depth, self.pitch = (law_of(axis, step, kind) for axis in (case, axis_of_pitch(case)))
        self.lever, self.is_pitch_first = case.law["thruster_lever[1]"], case.priority == "pitch"
        plane, limit = Plane(case), case.law["voltage_limit"]
        self.low, self.high = (plane.steady(0, voltage, case.law) for voltage in (-limit, limit))

    def control(self) -> np.ndarray:
        """Force and moment, body axes: F_1 = h - m and F_2 = h + m within what a thruster gives."""
        force, moment = body_axes(self.depth.control(), self.pitch.control(), self.pitch.x[0]).tolist()
        h, m, low, high = 0.5 * force, 0.5 * moment / self.lever, self.low, self.high
        if not self.is_pitch_first:
            h = max(low, min(high, h))
        largest = 0.5 * (high - low) if self.is_pitch_first else min(high - h, h - low)
        m = max(-largest, min(largest, m))
        h = max(low + abs(m), min(high - abs(m), h))
        return np.array([2.0 * h, 2.0 * self.lever * m])

    def advance(self, t: float, measured: Measured, u: np.ndarray) -> None:
        force, moment = u.tolist()
        of_depth, of_pitch = self.depth.control(), self.pitch.control()
        self.depth.advance(t, measured[:1], of_depth, force / math.cos(self.pitch.x[0]))
        self.pitch.advance(t, measured[1:], of_pitch, moment)


class ContinuousHeavePitch:
    """The same as a differential equation."""

    def __init__(self, case: L1Case) -> None:
        self.depth, self.pitch = Equations(case), Equations(axis_of_pitch(case))
        self.start = (*self.depth.start, *self.pitch.start)

    def at(self, t: float, measured: Measured, state: State) -> tuple[np.ndarray, State]:
        n = len(self.depth.start)
        force, of_depth = self.depth.at(t, measured[:1], state[:n])
        moment, of_pitch = self.pitch.at(t, measured[1:], state[n:])
        return body_axes(force, moment, measured[1][0]), (*of_depth, *of_pitch)


def body_axes(force: float, moment: float, theta: float) -> np.ndarray:
    return np.array([force * math.cos(theta), moment])
