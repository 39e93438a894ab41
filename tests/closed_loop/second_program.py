"""The vehicle and the L1 law once more, from the equations alone: sampled, and as one continuous system.

Nothing of `controller_fmu`, `plant_fmu` or `fmus.numerics` is used. Depth and force are positive down.

    vehicle   M w' = F + w_d + W - B(z) - D w - D_q |w| w,   z' = w,   F' = (sat(u) - F) / T
    sensor    z every 40 ms, held in between, without noise and resolution; ideal: z and w at every time
    observer  z_p = z_hat + T_o v,   z_hat = z_p + alpha (y - z_p),   v = v + beta / T_o (y - z_p)
    law       u = -k_m x + u_a + u_p,   x = (y, v),   u_p = -K_P e - K_I int e,   e = y - r
              x_hat' = A_m x_hat + B (u_d + k_m x + theta |x|_inf + sigma)
              theta' = G Proj(theta, -(x_tilde' P B) |x|_inf),   sigma' = G Proj(sigma, -(x_tilde' P B))
              u_a'   = -w (u_a + theta |x|_inf + sigma - k_g r)

u_d is the control that the vehicle receives. Source: Maalouf et al. (2013), (4)-(7), (10), (11), (13), with
the errata of docs/fidelity.md.

Sampled, vehicle and law exchange at communication points, both at once (Jacobi), and hold in between what
they receive. The law holds the measurement (`HELD`); or it goes as docs/explanation/theory.md describes the
step of the FMU (`BETWEEN_MEASUREMENTS`): the estimates follow from the interval between the last two
measurements, x on a line, and the filter then takes their mean.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov

_GRAVITY = 9.81  # m/s2
State = tuple[float, ...]
Pair = tuple[float, float]
Values = Mapping[str, float]


class LawStep(Enum):
    """How the law goes from one communication point to the next."""

    HELD = 1
    BETWEEN_MEASUREMENTS = 2


@dataclass(frozen=True)
class Case:
    """plant, law: values by the names of the parameters; extended: with the PI; ideal: sensor and velocity.

    reference [m], force [N]: of time [s]
    """

    plant: Values
    law: Values
    extended: bool
    ideal: bool
    reference: Callable[[float], float]
    force: Callable[[float], float]
    duration: float


class Equations:
    """The rates of the vehicle (z, w, F) and of the law (x_hat_1, x_hat_2, theta, sigma, u_a, int e)."""

    def __init__(self, case: Case) -> None:
        self.case, p = case, case.law
        m, d = p["model_inertia"], p["model_damping"]
        self.k_m = (p["depth_feedback_gain"], p["rate_feedback_gain"])
        self.a, self.b = (-self.k_m[0] / m, -(d + self.k_m[1]) / m), 1.0 / m
        a_m, b = np.array([[0.0, 1.0], self.a]), np.array([0.0, self.b])
        q = np.diag([p["lyapunov_weight[1]"], p["lyapunov_weight[2]"]])
        self.pb = (solve_continuous_lyapunov(a_m.T, -q) @ b).tolist()
        self.k_g = float(-1.0 / np.linalg.solve(a_m, b)[0])

    def vehicle(self, state: State, demanded: float, disturbance: float) -> State:
        p, (z, w, force) = self.case.plant, state
        limit = 2.0 * p["thruster_gain[1]"] * p["thruster_voltage_limit[1]"]
        submerged = p["weight"] - p["net_weight"] + p["buoyancy_change"]
        lost = p["water_density"] * _GRAVITY * p["waterplane_area"] * max(0.0, -z)
        net_weight = p["weight"] - max(0.0, submerged - lost)
        drag = p["linear_damping"] * w + p["quadratic_damping"] * abs(w) * w
        acceleration = (force + disturbance + net_weight - drag) / p["inertia"]
        return w, acceleration, (max(-limit, min(limit, demanded)) - force) / p["thruster_lag[1]"]

    def control(self, x: Pair, e: float, u_a: float, integral: float) -> float:
        p, u = self.case.law, u_a - self.k_m[0] * x[0] - self.k_m[1] * x[1]
        return u - p["proportional_gain"] * e - p["integral_gain"] * integral if self.case.extended else u

    def predictor(self, state: State, x: Pair, u: float) -> State:
        """Rates of (x_hat, theta, sigma) while the vehicle receives u."""
        p, (x_1, x_2, theta, sigma) = self.case.law, state
        norm = max(abs(x[0]), abs(x[1]))
        s = (x_1 - x[0]) * self.pb[0] + (x_2 - x[1]) * self.pb[1]
        eta = u + self.k_m[0] * x[0] + self.k_m[1] * x[1] + theta * norm + sigma
        return (
            x_2,
            self.a[0] * x_1 + self.a[1] * x_2 + self.b * eta,
            p["adaptation_gain"] * self._projected(theta, -s * norm, p["theta_bound[1]"]),
            p["adaptation_gain"] * self._projected(sigma, -s, p["sigma_bound"]),
        )

    def filter(self, u_a: float, known: float, r: float) -> float:
        """u_a', known = theta |x|_inf + sigma."""
        return -self.case.law["filter_bandwidth"] * (u_a + known - self.k_g * r)

    def _projected(self, estimate: float, rate: float, bound: float) -> float:
        eps = self.case.law["projection_tolerance"]
        f = ((1.0 + eps) * estimate * estimate - bound * bound) / (eps * bound * bound)
        return rate * (1.0 - f) if f > 0.0 and estimate * rate > 0.0 else rate


def continuous(case: Case, times: np.ndarray) -> np.ndarray:
    """The depth at these times: vehicle and law as one differential equation, sensor and velocity ideal."""
    equations = Equations(case)

    def rates(t: float, state: np.ndarray) -> State:
        values = tuple(state.tolist())
        x, r, (theta, sigma, u_a) = values[:2], case.reference(t), values[5:8]
        u = equations.control(x, x[0] - r, u_a, values[8])
        known = theta * max(abs(x[0]), abs(x[1])) + sigma
        vehicle = equations.vehicle(values[:3], u, case.force(t))
        law = equations.predictor(values[3:7], x, u)
        return *vehicle, *law, equations.filter(u_a, known, r), x[0] - r

    z = case.plant["initial_depth"]
    start = [z, 0.0, 0.0, z, 0.0, 0.0, 0.0, 0.0, 0.0]
    solved = solve_ivp(
        rates, (times[0], times[-1]), start, t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.05
    )
    return solved.y[0]


def sampled(case: Case, step: float, law_step: LawStep) -> dict[str, np.ndarray]:
    """Time, depth, reference and demanded force at communication points `step` s apart."""
    equations = Equations(case)
    z, period = case.plant["initial_depth"], round(case.law["observer_period"] / step)
    vehicle, measured, observer = (z, 0.0, 0.0), (z, 0.0), (z, 0.0)
    law = _Law(equations, step, law_step, measured)
    rows = []
    for i in range(round(case.duration / step) + 1):
        t = i * step
        if case.ideal:
            measured = vehicle[0], vehicle[1]
        elif i % period == 0:
            observer = _observed(case.law, observer, vehicle[0]) if i else observer
            measured = vehicle[0], observer[1]
        u, r = law.control(), case.reference(t)
        rows.append((t, vehicle[0], r, u))
        force = case.force(t)
        vehicle = _advanced(lambda x, u=u, force=force: equations.vehicle(x, u, force), vehicle, step)
        law.advance(measured, r, u)
    return dict(zip(("time", "depth", "reference", "u"), np.array(rows).T, strict=True))


def _observed(p: Values, estimate: Pair, measured: float) -> Pair:
    predicted = estimate[0] + p["observer_period"] * estimate[1]
    innovation = measured - predicted
    return (
        predicted + p["observer_alpha"] * innovation,
        estimate[1] + p["observer_beta"] / p["observer_period"] * innovation,
    )


class _Law:
    """The law between communication points: what it puts out depends on the measurement before."""

    def __init__(self, equations: Equations, step: float, kind: LawStep, measured: Pair) -> None:
        self.equations, self.step, self.kind = equations, step, kind
        self.x, self.e, self.u_before = measured, 0.0, 0.0
        self.estimates: State = (*measured, 0.0, 0.0)
        self.u_a = self.integral = 0.0
        self.is_first = True

    def control(self) -> float:
        return self.equations.control(self.x, self.e, self.u_a, self.integral)

    def advance(self, x: Pair, r: float, u: float) -> None:
        self.u_a = self._held(x, u, r) if self.kind is LawStep.HELD else self._between(x, r)
        self.integral += self.step * (x[0] - r)
        self.x, self.e, self.u_before, self.is_first = x, x[0] - r, u, False

    def _held(self, x: Pair, u: float, r: float) -> float:
        """u_a after the step; the estimates go with it."""
        norm = max(abs(x[0]), abs(x[1]))

        def rates(state: State) -> State:
            estimates = self.equations.predictor(state[:4], x, u)
            return *estimates, self.equations.filter(state[4], state[2] * norm + state[3], r)

        *estimates, u_a = _advanced(rates, (*self.estimates, self.u_a), self.step)
        self.estimates = tuple(estimates)
        return u_a

    def _between(self, x: Pair, r: float) -> float:
        """u_a after the step; the estimates go to its beginning."""
        before, theta, sigma = self.x, 0.0, 0.0

        def rates(state: State) -> State:
            part = state[6] / self.step
            on_line = (before[0] + part * (x[0] - before[0]), before[1] + part * (x[1] - before[1]))
            return *self.equations.predictor(state[:4], on_line, self.u_before), state[2], state[3], 1.0

        if not self.is_first:
            *estimates, theta, sigma, _ = _advanced(rates, (*self.estimates, 0.0, 0.0, 0.0), self.step)
            self.estimates = tuple(estimates)
            theta, sigma = theta / self.step, sigma / self.step
        known = theta * max(abs(x[0]), abs(x[1])) + sigma
        return _advanced(lambda u: (self.equations.filter(u[0], known, r),), (self.u_a,), self.step)[0]


def _advanced(rates: Callable[[State], State], x: State, h: float) -> State:
    """x after h seconds: one step of the classical Runge-Kutta method."""
    a = rates(x)
    b = rates(tuple(p + 0.5 * h * q for p, q in zip(x, a, strict=True)))
    c = rates(tuple(p + 0.5 * h * q for p, q in zip(x, b, strict=True)))
    d = rates(tuple(p + h * q for p, q in zip(x, c, strict=True)))
    steps = zip(x, a, b, c, d, strict=True)
    return tuple(p + h / 6.0 * (k + 2.0 * m + 2.0 * n + q) for p, k, m, n, q in steps)
