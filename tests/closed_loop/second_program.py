"""The L1 law in the loop of `second_loop`, from the equations alone: sampled, and as one continuous system.

    law       u = -k_m x + u_a + u_p,   x = (y, v),   u_p = -K_P e - K_I int e,   e = y - r
              x_hat' = A_m x_hat + B (omega u_ap + theta |x|_inf + sigma),   u_ap = u_d + k_m x
              theta' = G Proj(theta, -(x_tilde' P B) |x|_inf),   sigma' = G Proj(sigma, -(x_tilde' P B))
              omega' = G Proj(omega - omega_0, -(x_tilde' P B) u_w),   u_w = u_a, or u_ap; omega = omega_0
              u_a'   = -w (omega u_a + theta |x|_inf + sigma - v)
    or        u_p = -a_1 |e|^alpha sgn(e) if |e| > delta, else -a_2 e / delta^(1 - alpha)
    v         k_g r; with the feedforward f inside f; with f outside (1 - omega) f, and u_a + f
              in place of u_a in u and u_w
    or        x_hat' = A_m x + A_s x_tilde + B (u_d + k_m x) + s,   x_tilde = x_hat - x
              s = -Phi^-1 e^(A_s Ts) x_tilde every Ts,   Phi = A_s^-1 (e^(A_s Ts) - I),   sigma = s_2 / B_2

u_d is the control that the vehicle receives, u_ap what of it is not u_m of the state at the same time.
Source: Maalouf et al. (2013), (4)-(7), (10), (11), (13), with the errata of docs/fidelity.md.

Sampled, the law holds the measurement (`HELD`), and drives the predictor by the control that the vehicle
received before that measurement: with the control of the step that follows it, the estimates would contain
the change of u in a step, and the RMSE of a disturbed hold would be up to 1.1 % smaller. Or it goes as
docs/explanation/theory.md describes the step of the FMU (`BETWEEN_MEASUREMENTS`): the estimates follow from
the interval between the last two measurements, x on a line, and the filter then takes their mean.
"""

import math
from dataclasses import dataclass
from enum import Enum
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
    run,
    unless_wider,
)


class LawStep(Enum):
    """How the law goes from one communication point to the next."""

    HELD = 1
    BETWEEN_MEASUREMENTS = 2


@dataclass(frozen=True, kw_only=True)
class L1Case(Case):
    """augmentation: none, pi or nonlinear_p; feedforward: none, inside or outside the filter.

    learns_from_all: whether u_w is u_ap; piecewise: the diagonal of A_s [1/s] and Ts [s] of the
    piecewise-constant law, if that adapts
    pitch_augmentation, priority (heave or pitch): of the law of both axes
    """

    augmentation: str
    pitch_augmentation: str = "none"
    priority: str = "heave"
    feedforward: str
    learns_from_all: bool
    piecewise: tuple[Pair, float] | None


class Equations:
    """The rates of the law (x_hat, theta, sigma, omega, u_a, int e)."""

    def __init__(self, case: L1Case) -> None:
        self.case, p = case, case.law
        m, d = p["model_inertia"], p["model_damping"]
        self.k_m = (p["depth_feedback_gain"], p["rate_feedback_gain"])
        stiffness = p.get("model_stiffness", 0.0)
        self.a, self.b = (-(stiffness + self.k_m[0]) / m, -(d + self.k_m[1]) / m), 1.0 / m
        a_m, b = np.array([[0.0, 1.0], self.a]), np.array([0.0, self.b])
        q = np.diag([p["lyapunov_weight[1]"], p["lyapunov_weight[2]"]])
        self.pb = (solve_continuous_lyapunov(a_m.T, -q) @ b).tolist()
        self.k_g = float(-1.0 / np.linalg.solve(a_m, b)[0])

    def control(self, x: Pair, e: float, u_a: float, integral: float, f: float) -> float:
        """f: of the reference of the measurement."""
        u = self.learnt(u_a, f) - self.k_m[0] * x[0] - self.k_m[1] * x[1]
        return u + self.extension(e, integral)

    def learnt(self, u_a: float, f: float) -> float:
        """u_w of the paper: what of the control precedes the extension."""
        return u_a + f if self.case.feedforward == "outside" else u_a

    def extension(self, e: float, integral: float) -> float:
        """u_p."""
        p = self.case.law
        if self.case.augmentation == "pi":
            return -p["proportional_gain"] * e - p["integral_gain"] * integral
        if self.case.augmentation == "none":
            return 0.0
        alpha, delta = p["nonlinear_exponent"], p["nonlinear_threshold"]
        if abs(e) > delta:
            return -p["large_error_gain"] * math.copysign(abs(e) ** alpha, e)
        return -p["small_error_gain"] * e / delta ** (1.0 - alpha)

    def feedforward(self, t: float) -> float:
        """f = M r'' + (D + k_m2) r' + k_m1 r."""
        case, damping = self.case, self.case.law["model_damping"] + self.k_m[1]
        accelerating = case.law["model_inertia"] * case.reference_acceleration(t)
        return accelerating + damping * case.reference_rate(t) + self.k_m[0] * case.reference(t)

    def demand(self, t: float, omega: float) -> float:
        """What the filter drives eta_hat to."""
        f = self.feedforward(t)
        demands = {"none": self.k_g * self.case.reference(t), "inside": f, "outside": (1.0 - omega) * f}
        return demands[self.case.feedforward]

    def predictor(self, state: State, x: Pair, u: float, u_w: float) -> State:
        """Rates of (x_hat, theta, sigma, omega) while the vehicle receives u, u_w of which precedes u_p."""
        p, (x_1, x_2, theta, sigma, omega) = self.case.law, state
        norm, eps = max(abs(x[0]), abs(x[1])), p["projection_tolerance"]
        s = (x_1 - x[0]) * self.pb[0] + (x_2 - x[1]) * self.pb[1]
        u_ap = u + self.k_m[0] * x[0] + self.k_m[1] * x[1]
        u_w = u_ap if self.case.learns_from_all else u_w
        away, box = omega - p["input_gain"], p["input_gain_uncertainty"]
        return (
            x_2,
            self.a[0] * x_1 + self.a[1] * x_2 + self.b * (omega * u_ap + theta * norm + sigma),
            p["adaptation_gain"] * projected(theta, -s * norm, p["theta_bound[1]"], eps),
            p["adaptation_gain"] * projected(sigma, -s, p["sigma_bound"], eps),
            p["adaptation_gain"] * projected(away, -s * u_w, box, eps) if box else 0.0,
        )

    def filter(self, u_a: float, known: float, omega: float, demand: float) -> float:
        """u_a', known = theta |x|_inf + sigma."""
        return -self.case.law["filter_bandwidth"] * (omega * u_a + known - demand)

    @property
    def start(self) -> State:
        """(x_hat, theta, sigma, omega, u_a, int e)."""
        return self.case.first_reading, 0.0, 0.0, 0.0, self.case.law["input_gain"], 0.0, 0.0

    def at(self, t: float, measured: Measured, state: State) -> tuple[float, State]:
        """u, and the rates of the states without a sampled law."""
        (*_, theta, sigma, omega, u_a, integral), x, f = state, measured[0], self.feedforward(t)
        e = x[0] - self.case.reference(t)
        u = self.control(x, e, u_a, integral, f)
        law = self.predictor(state[:5], x, u, self.learnt(u_a, f))
        known = theta * max(abs(x[0]), abs(x[1])) + sigma
        return u, (*law, self.filter(u_a, known, omega, self.demand(t, omega)), e)


def sampled(case: L1Case, step: float, law_step: LawStep) -> dict[str, np.ndarray]:
    """Time, depth, reference and demanded force at communication points `step` s apart."""
    return run(case, step, law_of(case, step, law_step))


def law_of(case: L1Case, step: float, kind: LawStep) -> "_Law":
    """The law between communication points."""
    return (_PiecewiseLaw if case.piecewise else _Law)(Equations(case), step, kind)


class _Law:
    """The law between communication points: what it puts out depends on the measurement before."""

    def __init__(self, equations: Equations, step: float, kind: LawStep) -> None:
        self.equations, self.step, self.kind = equations, step, kind
        self.limit = largest_force(equations.case.plant)
        measured = equations.case.first_reading, 0.0
        self.x, self.e = measured, measured[0] - equations.case.reference(0.0)
        self.before = 0.0, 0.0  # u and u_w that the vehicle received before the measurement
        self.f = equations.feedforward(0.0)
        self.estimates: State = (*measured, 0.0, 0.0, equations.case.law["input_gain"])
        self.u_a = self.integral = 0.0
        self.is_first = True

    def control(self) -> float:
        return self.equations.control(self.x, self.e, self.u_a, self.integral, self.f)

    def advance(self, t: float, measured: Measured, u: Any, given: float | None = None) -> None:
        """given: what of u the thrusters deliver, if the limit is not that of both together.

        The filter, too, holds where its change would widen a saturation (docs/explanation/theory.md).
        """
        x = measured[0]
        r, e = self.equations.case.reference(t), x[0] - self.equations.case.reference(t)
        delivered = max(-self.limit, min(self.limit, u)) if given is None else given
        before = delivered, self.equations.learnt(self.u_a, self.f)
        change = self.adapted(x, t) - self.u_a
        self.u_a += unless_wider(change, change, delivered - u)
        self.integral += self.step * unless_wider(e, -e, delivered - u)
        self.x, self.e, self.before, self.is_first = x, x[0] - r, before, False
        self.f = self.equations.feedforward(t)

    def adapted(self, x: Pair, t: float) -> float:
        """u_a after the step from t on."""
        return self._held(x, t) if self.kind is LawStep.HELD else self._between(x, t)

    def _held(self, x: Pair, t: float) -> float:
        """u_a after the step; the estimates go with it, under the control that led to the measurement."""
        norm = max(abs(x[0]), abs(x[1]))

        def rates(state: State) -> State:
            *estimates, theta, sigma, omega, u_a = state
            demand = self.equations.demand(t, omega)
            return (
                *self.equations.predictor((*estimates, theta, sigma, omega), x, *self.before),
                self.equations.filter(u_a, theta * norm + sigma, omega, demand),
            )

        *estimates, u_a = advanced(rates, (*self.estimates, self.u_a), self.step)
        self.estimates = tuple(estimates)
        return u_a

    def _between(self, x: Pair, t: float) -> float:
        """u_a after the step; the estimates go to its beginning."""
        before, theta, sigma = self.x, 0.0, 0.0

        def rates(state: State) -> State:
            part = state[7] / self.step
            on_line = (before[0] + part * (x[0] - before[0]), before[1] + part * (x[1] - before[1]))
            return *self.equations.predictor(state[:5], on_line, *self.before), state[2], state[3], 1.0

        if not self.is_first:
            *estimates, theta, sigma, _ = advanced(rates, (*self.estimates, 0.0, 0.0, 0.0), self.step)
            self.estimates = tuple(estimates)
            theta, sigma = theta / self.step, sigma / self.step
        known = theta * max(abs(x[0]), abs(x[1])) + sigma
        return self.filtered(known, t)

    def filtered(self, known: float, t: float) -> float:
        """u_a after the step from t on, with known = theta |x|_inf + sigma and omega held."""
        equations, omega = self.equations, self.estimates[4]
        demand = equations.demand(t, omega)
        return advanced(lambda u: (equations.filter(u[0], known, omega, demand),), (self.u_a,), self.step)[0]


class _PiecewiseLaw(_Law):
    """With the piecewise-constant law: the matched part of s goes through the filter, all of it into x_hat.

    x is held from one measurement to the next.
    """

    def adapted(self, x: Pair, t: float) -> float:
        equations, (rates, period) = self.equations, self.equations.case.piecewise or ((0.0, 0.0), 0.0)
        if self.is_first:
            self.x_hat, self.s, self.due = x, (0.0, 0.0), round(period / self.step)
        else:
            u = self.before[0] + equations.k_m[0] * self.x[0] + equations.k_m[1] * self.x[1]
            self.x_hat = advanced(lambda x_hat: self._rates(x_hat, u, rates), self.x_hat, self.step)
            self.due -= 1
        if not self.due:
            first, second = (-math.exp(a * period) * a / (math.exp(a * period) - 1.0) for a in rates)
            self.s = (first * (self.x_hat[0] - x[0]), second * (self.x_hat[1] - x[1]))
            self.due = round(period / self.step)
        return self.filtered(self.s[1] / equations.b, t)

    def _rates(self, x_hat: State, u: float, rates: Pair) -> State:
        a, x = self.equations.a, self.x
        error = x_hat[0] - x[0], x_hat[1] - x[1]
        return (
            x[1] + rates[0] * error[0] + self.s[0],
            a[0] * x[0] + a[1] * x[1] + rates[1] * error[1] + self.equations.b * u + self.s[1],
        )
