"""Offline design with SciPy: P, k_g, the L1-norm condition and the bandwidth that it asks for.

The L1 adaptive controller is stable with any fast adaptation if

    |G|_L1 L < 1,    G(s) = (s I - A_m)^-1 B_m (C(s) - 1)

where |.|_L1 is the largest row sum of integrals of |impulse response|, C(s) the low-pass filter and L a
Lipschitz constant of the uncertainty in |x|_inf. Source: Hovakimyan and Cao (2010), section 2.1.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import brentq

from controller_fmu.l1.adaptation import Regressor
from controller_fmu.l1.lowpass import FilterOrder

_STEPS_PER_TIME_CONSTANT = 100  # of the fastest mode: trapezoidal error of |g| below 1e-4
_TIME_CONSTANTS = 30  # of the slowest mode: e^-30 of the impulse response is left out
_CHUNK = 4096


@dataclass(frozen=True)
class StateSpace:
    """x' = A x + B u, y = C x: shapes (n, n), (n, inputs), (outputs, n)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


def lyapunov_matrix(a_m: np.ndarray, q: np.ndarray) -> np.ndarray:
    """P of A_m' P + P A_m = -Q, shapes (n, n); ValueError if A_m is not Hurwitz."""
    a_m = np.asarray(a_m, float)
    if np.linalg.eigvals(a_m).real.max() >= 0.0:
        raise ValueError(f"A_m must be Hurwitz, got eigenvalues {np.linalg.eigvals(a_m)}")
    return solve_continuous_lyapunov(a_m.T, -np.asarray(q, float))


def feedforward_gain(a_m: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """k_g = -1 / (C A_m^-1 B_m): unit gain from reference to output in steady state."""
    return float(-1.0 / (np.asarray(c) @ np.linalg.solve(np.asarray(a_m, float), np.asarray(b))))


def filter_realisation(order: FilterOrder, w: float) -> StateSpace:
    """C(s) with one input and one output, in controllable form."""
    if order == FilterOrder.FIRST:
        return StateSpace(np.array([[-w]]), np.array([[1.0]]), np.array([[w]]))
    companion = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-(w**3), -3.0 * w**2, -3.0 * w]])
    return StateSpace(companion, np.array([[0.0], [0.0], [1.0]]), np.array([[w**3, 3.0 * w**2, 0.0]]))


def uncompensated(a_m: np.ndarray, b: np.ndarray, order: FilterOrder, w: float) -> StateSpace:
    """G(s) = (s I - A_m)^-1 B_m (C(s) - 1), from the uncertainty to the state."""
    low_pass = filter_realisation(order, w)
    a_m, column = np.asarray(a_m, float), np.asarray(b, float).reshape(-1, 1)
    n, m = len(a_m), len(low_pass.a)
    a = np.block([[a_m, column @ low_pass.c], [np.zeros((m, n)), low_pass.a]])
    return StateSpace(a, np.vstack([-column, low_pass.b]), np.hstack([np.eye(n), np.zeros((n, m))]))


def l1_norm(system: StateSpace) -> float:
    """|G|_L1 = max over rows of sum over columns of the integral of |C e^(A t) B| dt.

    Trapezoidal rule on a grid as fine as the fastest mode asks, until the slowest has died out.
    """
    eigenvalues = np.linalg.eigvals(system.a)
    slowest, fastest = -eigenvalues.real.max(), np.abs(eigenvalues).max()
    if slowest <= 0.0:
        raise ValueError(f"the system must be stable, got eigenvalues {eigenvalues}")
    step = 1.0 / (_STEPS_PER_TIME_CONSTANT * fastest)
    state = _propagated(system, step)
    over_a_chunk = expm(system.a * step * _CHUNK)
    total = np.zeros((system.c.shape[0], system.b.shape[1]))
    for _ in range(int(np.ceil(_TIME_CONSTANTS / slowest / (step * _CHUNK)))):
        response = np.abs(np.einsum("on,tni->toi", system.c, state))
        total += step * (response.sum(axis=0) - 0.5 * (response[0] + response[-1]))
        state = np.einsum("mn,tni->tmi", over_a_chunk, state)
    return float(total.sum(axis=1).max())


def _propagated(system: StateSpace, step: float) -> np.ndarray:
    """e^(A t) B at the points of one chunk, both ends included: shape (chunk + 1, n, inputs)."""
    states = np.empty((_CHUNK + 1, *system.b.shape))
    states[0] = system.b
    done, over = 1, expm(system.a * step)
    while done <= _CHUNK:  # twice as many points each time
        count = min(done, _CHUNK + 1 - done)
        states[done : done + count] = np.einsum("mn,tni->tmi", over, states[:count])
        done += count
        over = over @ over
    return states


def lipschitz_constant(kind: Regressor, theta_bound: tuple[float, float]) -> float:
    """L such that |theta' phi(x)| <= L |x|_inf for every theta within its bounds."""
    return theta_bound[0] if kind == Regressor.INFINITY_NORM else sum(theta_bound)


def l1_condition(a_m: np.ndarray, b: np.ndarray, order: FilterOrder, w: float, lipschitz: float) -> float:
    """|G|_L1 L, which must stay below 1."""
    return l1_norm(uncompensated(a_m, b, order, w)) * lipschitz


def smallest_bandwidth(
    a_m: np.ndarray, b: np.ndarray, order: FilterOrder, lipschitz: float, largest: float = 1e5
) -> float:
    """The filter bandwidth [rad/s] above which the L1-norm condition holds, to 0.1 %.

    Searched from a hundredth of the slowest mode of A_m, which is the answer if it does already.
    Raises ValueError if even `largest` does not satisfy the condition.
    """

    def excess(logarithm: float) -> float:
        return l1_condition(a_m, b, order, float(np.exp(logarithm)), lipschitz) - 1.0

    slowest = -np.linalg.eigvals(np.asarray(a_m, float)).real.max()
    low, high = np.log(0.01 * slowest), np.log(largest)
    if excess(low) < 0.0:
        return float(np.exp(low))
    decade = np.log(10.0)
    while excess(min(low + decade, high)) > 0.0:  # climb: a wide range of bandwidths is dear to evaluate
        low += decade
        if low >= high:
            raise ValueError(f"no bandwidth up to {largest} rad/s satisfies the L1-norm condition")
    root: Any = brentq(excess, low, min(low + decade, high), xtol=1e-3)
    return float(np.exp(root))
