"""Five laws of depth control in the loop of `second_loop`, from their equations alone.

    PID             u = -k_p e - k_i int e - k_d (v - beta r') + beta D r'
    MRAC            u = -k_m x + f - theta |x|_inf - sigma,   f = M r'' + (D + k_m2) r' + k_m1 r,   x = (y, v)
                    x_m' = A_m x_m + B (f + u_d - u)
                    theta' = G Proj(theta, (x - x_m)' P B |x|_inf),   sigma' = G Proj(sigma, (x - x_m)' P B)
    sliding mode    u = M (r'' - 2 l e' - l^2 e) + D v - K sat(s / phi),   s = e' + 2 l e + l^2 int e
    super-twisting  u = M (r'' - l e') + D v - k_1 sqrt|s| g + nu,   nu' = -k_2 g,   s = e' + l e
                    g = s / (|s| + eps)
    ADRC            u = M (w_c^2 (r - z_1) + 2 w_c (r' - z_2) + r'' - z_3)
                    z_1' = z_2 + l_1 i,   z_2' = z_3 + u_d / M + l_2 i,   z_3' = l_3 i,   i = y - z_1
                    l of (s + w_o)^2 (s + q w_o)

y, v: measured depth and its rate, e = y - r, e' = v - r'; u_d: what the thrusters deliver. A law holds y, v,
r, r' and r'' over a step, and its states go on by the Runge-Kutta method; f drives x_m as part of the control
in force. An integral holds where its change would widen a saturation.
Sources: Astrom and Hagglund (2006); Ioannou and Sun (1996); Slotine and Li (1991); Levant (1993); Gao (2003).
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from tests.closed_loop.second_loop import (
    Case,
    Measured,
    Pair,
    State,
    advanced,
    largest_force,
    projected,
    unless_wider,
)


@dataclass(frozen=True)
class Known:
    """What a law knows at a communication point: y [m], v [m/s], r [m], r' [m/s], r'' [m/s2]."""

    depth: float
    rate: float
    reference: float
    reference_rate: float
    reference_acceleration: float

    @property
    def error(self) -> float:
        return self.depth - self.reference

    @property
    def error_rate(self) -> float:
        return self.rate - self.reference_rate


class HeldLaw:
    """A law whose states follow from what it knew at the beginning of the step."""

    state: State = (0.0,)

    def __init__(self, case: Case, step: float) -> None:
        self.case, self.step = case, step
        self.p, self.limit = case.law, largest_force(case.plant)
        self.known = self._known(0.0, (case.first_reading, 0.0))

    def _known(self, t: float, x: Pair) -> Known:
        case = self.case
        return Known(*x, case.reference(t), case.reference_rate(t), case.reference_acceleration(t))

    @property
    def start(self) -> State:
        return self.state

    def advance(self, t: float, measured: Measured, u: Any) -> None:
        withheld, now = max(-self.limit, min(self.limit, u)) - u, self._known(t, measured[0])
        self.state = advanced(lambda state: self.rates(state, now, u, withheld), self.state, self.step)
        self.known = now

    def at(self, t: float, measured: Measured, state: State) -> tuple[float, State]:
        self.known, self.state = self._known(t, measured[0]), state
        u = self.control()
        return u, self.rates(state, self.known, u, max(-self.limit, min(self.limit, u)) - u)

    @abstractmethod
    def control(self) -> float:
        """u [N]."""

    @abstractmethod
    def rates(self, state: State, now: Known, u: float, withheld: float) -> State:
        """Of the states while u is demanded; withheld: u_d - u."""


class Pid(HeldLaw):
    def control(self) -> float:
        p, k = self.p, self.known
        damped = k.rate - p["beta"] * k.reference_rate
        ahead = p["beta"] * p["model_damping"] * k.reference_rate
        return -p["kp"] * k.error - p["ki"] * self.state[0] - p["kd"] * damped + ahead

    def rates(self, state: State, now: Known, u: float, withheld: float) -> State:
        return (unless_wider(now.error, -now.error, withheld),)


class Mrac(HeldLaw):
    """States: x_m (2), theta, sigma."""

    def __init__(self, case: Case, step: float) -> None:
        super().__init__(case, step)
        m, self.damping = self.p["model_inertia"], self.p["model_damping"] + self.p["rate_gain"]
        self.a, self.b = (-self.p["depth_gain"] / m, -self.damping / m), 1.0 / m
        q = np.diag([self.p["lyapunov_weight[1]"], self.p["lyapunov_weight[2]"]])
        p = solve_continuous_lyapunov(np.array([[0.0, 1.0], self.a]).T, -q)
        self.pb = (p @ [0.0, self.b]).tolist()
        self.state = (case.first_reading, 0.0, 0.0, 0.0)

    def ahead(self) -> float:
        """f [N]."""
        p, k = self.p, self.known
        accelerating = p["model_inertia"] * k.reference_acceleration
        return accelerating + self.damping * k.reference_rate + p["depth_gain"] * k.reference

    def control(self) -> float:
        p, k, (_, _, theta, sigma) = self.p, self.known, self.state
        feedback = p["depth_gain"] * k.depth + p["rate_gain"] * k.rate
        return -feedback + self.ahead() - theta * max(abs(k.depth), abs(k.rate)) - sigma

    def rates(self, state: State, now: Known, u: float, withheld: float) -> State:
        p, (x_1, x_2, theta, sigma) = self.p, state
        norm, eps, gain = max(abs(now.depth), abs(now.rate)), p["projection_tolerance"], p["estimate_gain"]
        s = (now.depth - x_1) * self.pb[0] + (now.rate - x_2) * self.pb[1]
        return (
            x_2,
            self.a[0] * x_1 + self.a[1] * x_2 + self.b * (self.ahead() + withheld),
            gain * projected(theta, s * norm, p["theta_bound"], eps),
            gain * projected(sigma, s, p["sigma_bound"], eps),
        )


class SlidingMode(HeldLaw):
    def control(self) -> float:
        p, k, w = self.p, self.known, self.p["error_bandwidth"]
        s = k.error_rate + 2.0 * w * k.error + w * w * self.state[0]
        layer = max(-1.0, min(1.0, s / p["boundary_layer"]))
        acceleration = k.reference_acceleration - 2.0 * w * k.error_rate - w * w * k.error
        equivalent = p["model_inertia"] * acceleration
        return equivalent + p["model_damping"] * k.rate - p["switching_gain"] * layer

    def rates(self, state: State, now: Known, u: float, withheld: float) -> State:
        return (unless_wider(now.error, -now.error, withheld),)


class SuperTwisting(HeldLaw):
    def direction(self, k: Known) -> Pair:
        """sqrt|s| and g."""
        s = k.error_rate + self.p["error_bandwidth"] * k.error
        return math.sqrt(abs(s)), s / (abs(s) + self.p["smoothing"])

    def control(self) -> float:
        p, k, (root, g) = self.p, self.known, self.direction(self.known)
        acceleration = k.reference_acceleration - p["error_bandwidth"] * k.error_rate
        equivalent = p["model_inertia"] * acceleration + p["model_damping"] * k.rate
        return equivalent - p["root_gain"] * root * g + self.state[0]

    def rates(self, state: State, now: Known, u: float, withheld: float) -> State:
        rate = -self.p["twisting_gain"] * self.direction(now)[1]
        return (unless_wider(rate, rate, withheld),)


class Adrc(HeldLaw):
    def __init__(self, case: Case, step: float) -> None:
        super().__init__(case, step)
        self.state = (case.first_reading, 0.0, 0.0)

    def control(self) -> float:
        p, k, (z_1, z_2, z_3) = self.p, self.known, self.state
        w = p["control_bandwidth"]
        acceleration = w * w * (k.reference - z_1) + 2.0 * w * (k.reference_rate - z_2)
        return p["model_inertia"] * (acceleration + k.reference_acceleration - z_3)

    def rates(self, state: State, now: Known, u: float, withheld: float) -> State:
        z_1, z_2, z_3 = state
        w, innovation = self.p["observer_bandwidth"], now.depth - z_1
        acceleration = (u + withheld) / self.p["model_inertia"]
        _, *gains = np.poly([-w, -w, -w * self.p["disturbance_ratio"]]).tolist()
        by_innovation = [gain * innovation for gain in gains]
        return (z_2 + by_innovation[0], z_3 + acceleration + by_innovation[1], by_innovation[2])


LAWS: Mapping[str, type[HeldLaw]] = {
    "PidDepthController": Pid,
    "MracDepthController": Mrac,
    "SlidingModeDepthController": SlidingMode,
    "SuperTwistingDepthController": SuperTwisting,
    "AdrcDepthController": Adrc,
}
