"""The L1 law and the plant that it controls as linear equations, at rest at a constant depth.

The law, all of it linear but for projection, saturation and the nonlinear P:

    x_hat' = A_m x_hat + b (omega_hat (u_a + u_p) + eta),   eta' = -kappa (x_hat - x)' P b
    u_a    = -k D(s) (omega_hat u_a + eta),   u_p = -K_P c x - K_I int c x dt,   u = -k_m x + u_a + u_p

eta stands for theta_hat phi + sigma_hat, kappa for Gamma (|phi|^2 + 1) with phi the regressor at rest and
theta_hat taken as 0 there. In the limit of fast adaptation 1 / kappa is 0: (x_hat - x)' P b = 0.
Sources: Hovakimyan and Cao (2010); Maalouf et al. (2013), (3) to (7).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from controller_fmu.design import FilterOrder, lyapunov_matrix
from orchestration.studies.margins.linear_margins import Equation, LinearLoop

Pair = tuple[float, float]
CONTROL, PLANT_INPUT = "u", "plant input"


@dataclass(frozen=True)
class Observer:
    """The observer of the depth rate, by alpha, beta and its sampling period [s].

    sampled: by the bilinear equivalent of its difference equations, which has their frequency response but
    for (frequency x period)^2 / 12; else by the differential equations that they approximate
    """

    alpha: float
    beta: float
    period: float
    sampled: bool = False

    def equations(self) -> list[Equation]:
        """Returns the equations of its output m2, the rate, from the depth m1."""
        alpha, beta, t = self.alpha, self.beta, self.period
        if self.sampled:
            # m2 / m1 = (beta / T) q (q - 1) / (q^2 + (alpha + beta - 2) q + 1 - alpha)
            # with q = (2 + s T) / (2 - s T)
            square = 0.25 * t * t * (4.0 - 2.0 * alpha - beta)
            return [
                Equation({"observer": 1.0}, {"m2": -beta}),
                Equation(
                    {"m2": square, "m1": -0.5 * beta * t}, {"observer": 1.0, "m2": -alpha * t, "m1": beta}
                ),
            ]
        first, second = alpha / t, beta / t**2
        return [
            Equation({"observer": 1.0}, {"m2": 1.0, "m1": first, "observer": -first}),
            Equation({"m2": 1.0}, {"m1": second, "observer": -second}),
        ]


@dataclass(frozen=True)
class Law:
    """The law of the loop of second order; kappa: gain of the adaptation, infinite in its limit.

    observer: None where the second state is measured
    """

    a_m: tuple[Pair, Pair]
    b: Pair
    c: Pair
    k_m: Pair
    q: Pair
    filter_order: FilterOrder
    bandwidth: float
    omega_hat: float = 1.0
    proportional_gain: float = 0.0
    integral_gain: float = 0.0
    kappa: float = math.inf
    observer: Observer | None = None


@dataclass(frozen=True)
class Plant:
    """The plant x' = A x + b times the sum of f_i,   lag_i f_i' = gain_i u - f_i."""

    a: tuple[Pair, Pair]
    b: Pair
    gains: tuple[float, ...] = (1.0,)
    lags: tuple[float, ...] = (0.0,)

    def without_lag(self) -> "Plant":
        return replace(self, lags=tuple(0.0 for _ in self.lags))


def loop(law: Law, plant: Plant) -> LinearLoop:
    """Returns the loop, cut where the control enters the plant."""
    equations = (
        *plant_equations(plant),
        *measurement_equations(law.observer),
        *_prediction(law),
        *_control(law),
    )
    return LinearLoop(equations, source=PLANT_INPUT, target=CONTROL)


def plant_equations(plant: Plant) -> list[Equation]:
    """Returns the equations of x1 and x2, the state, and of the force of each actuator."""
    forces = [f"force {i}" for i in range(len(plant.gains))]
    rows = [
        Equation({f"x{i + 1}": 1.0}, {"x1": row[0], "x2": row[1], **dict.fromkeys(forces, plant.b[i])})
        for i, row in enumerate(plant.a)
    ]
    actuators = zip(forces, plant.lags, plant.gains, strict=True)
    return rows + [Equation({name: lag}, {name: -1.0, PLANT_INPUT: gain}) for name, lag, gain in actuators]


def measurement_equations(observer: Observer | None) -> list[Equation]:
    """Returns the equations of m1 and m2, the state as the law measures it."""
    rows = [Equation({}, {"m1": -1.0, "x1": 1.0})]
    if observer is None:
        return [*rows, Equation({}, {"m2": -1.0, "x2": 1.0})]
    return [*rows, *observer.equations()]


def _prediction(law: Law) -> list[Equation]:
    """Returns the equations of x_hat and eta."""
    p_b = lyapunov_matrix(np.array(law.a_m), np.diag(law.q)) @ np.array(law.b)
    rows = []
    for i, row in enumerate(law.a_m):
        driven = {"u_a": law.omega_hat * law.b[i], "u_p": law.omega_hat * law.b[i], "eta": law.b[i]}
        rows.append(Equation({f"x_hat{i + 1}": 1.0}, {"x_hat1": row[0], "x_hat2": row[1], **driven}))
    error = {"x_hat1": -p_b[0], "m1": p_b[0], "x_hat2": -p_b[1], "m2": p_b[1]}
    return [*rows, Equation({"eta": 1.0 / law.kappa}, error)]


def _control(law: Law) -> list[Equation]:
    w, v = law.bandwidth, {"u_a": law.omega_hat, "eta": 1.0}
    if law.filter_order == FilterOrder.FIRST:
        rows = [Equation({"u_a": 1.0}, {name: -w * gain for name, gain in v.items()})]
    else:
        rows = [
            Equation({"p1": 1.0}, {"p1": -3.0 * w, **{name: -gain for name, gain in v.items()}}),
            Equation({"p2": 1.0}, {"p1": 1.0}),
            Equation({"u_a": 1.0}, {"p1": 3.0 * w**2, "p2": w**3}),
        ]
    y = {"m1": law.c[0], "m2": law.c[1]}
    # without the gain the integral would be a pole at 0 that nothing observes
    if law.integral_gain:
        rows.append(Equation({"integral": 1.0}, y))
    integral = {"integral": -law.integral_gain} if law.integral_gain else {}
    proportional = {name: -law.proportional_gain * gain for name, gain in y.items()}
    rows.append(Equation({}, {"u_p": -1.0, **proportional, **integral}))
    total = {"u": -1.0, "m1": -law.k_m[0], "m2": -law.k_m[1], "u_a": 1.0, "u_p": 1.0}
    return [*rows, Equation({}, total)]
