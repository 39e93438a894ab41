"""Offline design with SciPy: P, k_g, the L1-norm condition and the bandwidth that it requires.

The L1 adaptive controller is stable with any fast adaptation if

    |G|_L1 L < 1,    G(s) = (s I - A_m)^-1 B_m (C(s) - 1)

where |.|_L1 is the largest row sum of integrals of |impulse response|, C(s) the low-pass filter and L a
Lipschitz constant of the uncertainty in |x|_inf. Source: Hovakimyan and Cao (2010).

With the extension u_p = -K_PI (y - r), K_PI = K_P + K_I / s, and the input gain omega the same argument gives

    G(s) = (s I - A_m + omega B_m K_PI c)^-1 B_m (C_omega(s) - 1),   C_omega = omega k D / (1 + omega k D)

which is not in the paper: docs/explanation/margins.md derives it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controller_fmu.l1.parameters import FilterOrder, Regressor
from fmus.extras import imports_of

with imports_of("study", "a design"):
    from scipy.linalg import expm, solve_continuous_lyapunov
    from scipy.optimize import brentq

# of the fastest mode: a change of sign is found to 1e-3 of a time constant
_STEPS_PER_TIME_CONSTANT = 20
# of a mode: e^-30 of its part of the impulse response is left out
_TIME_CONSTANTS = 30
# points at once: all points of a stiff system would fill the memory
_CHUNK = 4096
# times k_g: the end of the search for the largest proportional gain
_LARGEST_GAIN = 1e4
# in place of the infinite norm of an unstable system: the search for a root needs numbers
_UNSTABLE = 1e3


@dataclass(frozen=True)
class StateSpace:
    """State space system x' = A x + B u, y = C x.

    Parameters
    ----------
    a : array, shape (n, n)
        A.
    b : array, shape (n, inputs)
        B.
    c : array, shape (outputs, n)
        C.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


@dataclass(frozen=True)
class Extension:
    """Extension u_p = -K_P e - K_I int e dt, with e = C x - r.

    Parameters
    ----------
    output : tuple of float
        C.
    proportional_gain, integral_gain : float
        K_P, and K_I in its unit per s.
    """

    output: tuple[float, ...] = ()
    proportional_gain: float = 0.0
    integral_gain: float = 0.0


NO_EXTENSION = Extension()


def lyapunov_matrix(a_m: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Returns P of A_m' P + P A_m = -Q.

    Parameters
    ----------
    a_m, q : array, shape (n, n)
        A Hurwitz matrix A_m, and Q.

    Returns
    -------
    array, shape (n, n)

    Raises
    ------
    ValueError
        If A_m is not Hurwitz.

    Examples
    --------
    >>> lyapunov_matrix(np.array([[-2.0]]), np.array([[4.0]]))
    array([[1.]])
    """
    a_m = np.asarray(a_m, float)
    if np.linalg.eigvals(a_m).real.max() >= 0.0:
        raise ValueError(f"A_m must be Hurwitz, got eigenvalues {np.linalg.eigvals(a_m)}")
    return solve_continuous_lyapunov(a_m.T, -np.asarray(q, float))


def feedforward_gain(a_m: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Returns k_g = -1 / (C A_m^-1 B_m), which gives a steady gain of 1 from reference to output.

    Parameters
    ----------
    a_m : array, shape (n, n)
    b, c : array, shape (n,)
        B_m and C.

    Returns
    -------
    float

    Examples
    --------
    >>> feedforward_gain(np.array([[0.0, 1.0], [-4.0, -1.0]]), np.array([0.0, 1.0]), np.array([1.0, 0.0]))
    4.0
    """
    return float(-1.0 / (np.asarray(c) @ np.linalg.solve(np.asarray(a_m, float), np.asarray(b))))


def filter_realisation(order: FilterOrder, w: float, omega: float = 1.0) -> StateSpace:
    """Returns C_omega(s) in controllable form; C(s) for omega = 1.

    Parameters
    ----------
    order : FilterOrder
    w : float
        Bandwidth of C(s) [rad/s].
    omega : float
        Input gain.

    Returns
    -------
    StateSpace
        One input and one output.
    """
    if order == FilterOrder.FIRST:
        return StateSpace(np.array([[-omega * w]]), np.array([[1.0]]), np.array([[omega * w]]))
    square, cube = omega * 3.0 * w**2, omega * w**3
    companion = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-cube, -square, -3.0 * w]])
    return StateSpace(companion, np.array([[0.0], [0.0], [1.0]]), np.array([[cube, square, 0.0]]))


def uncompensated(
    a_m: np.ndarray,
    b: np.ndarray,
    order: FilterOrder,
    w: float,
    extension: Extension = NO_EXTENSION,
    omega: float = 1.0,
) -> StateSpace:
    """Returns G(s) from the uncertainty to the state x; the integral of an extension is one more state.

    Parameters
    ----------
    a_m : array, shape (n, n)
    b : array, shape (n,)
        B_m.
    order, w : FilterOrder, float
        Order and bandwidth [rad/s] of C(s).
    extension : Extension
        u_p, with the output C.
    omega : float
        Input gain.

    Returns
    -------
    StateSpace
        One input, n outputs.
    """
    low_pass = filter_realisation(order, w, omega)
    a_x, column = np.asarray(a_m, float), np.asarray(b, float).reshape(-1, 1)
    n = len(a_x)
    if extension.output:
        row = np.asarray(extension.output, float).reshape(1, -1)
        a_x = a_x - omega * extension.proportional_gain * column @ row
        if extension.integral_gain:
            a_x = np.block([[a_x, -omega * extension.integral_gain * column], [row, np.zeros((1, 1))]])
            column = np.vstack([column, [[0.0]]])
    m, size = len(low_pass.a), len(a_x)
    a = np.block([[a_x, column @ low_pass.c], [np.zeros((m, size)), low_pass.a]])
    return StateSpace(a, np.vstack([-column, low_pass.b]), np.eye(n, size + m))


def l1_norm(system: StateSpace) -> float:
    """Returns |G|_L1 = max over rows of sum over columns of the integral of |C e^(A t) B| dt.

    Parameters
    ----------
    system : StateSpace
        A stable system.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the system is not stable.

    Examples
    --------
    >>> one = np.array([[1.0]])
    >>> round(l1_norm(StateSpace(-2.0 * one, one, one)), 9)
    0.5
    """
    eigenvalues = np.linalg.eigvals(system.a)
    if eigenvalues.real.max() >= 0.0:
        raise ValueError(f"the system must be stable, got eigenvalues {eigenvalues}")
    # The integral over a step without a change of sign is exact: C A^-1 (e^(A t_2) - e^(A t_1)) B. With one,
    # the response is taken as a straight line.
    antiderivative = system.c @ np.linalg.inv(system.a)
    total = np.zeros((system.c.shape[0], system.b.shape[1]))
    state, start = system.b.astype(float), 0.0
    for end in np.unique(_TIME_CONSTANTS / -eigenvalues.real):
        # steps suit the fastest remaining mode: short ones until the slowest has died out would take long
        left = eigenvalues[_TIME_CONSTANTS / -eigenvalues.real >= end]
        count = int(np.ceil((end - start) * _STEPS_PER_TIME_CONSTANT * np.abs(left).max()))
        step, start = (end - start) / count, end
        for first in range(0, count, _CHUNK):
            states = _propagated(system.a, state, step, min(_CHUNK, count - first))
            response, integral = (np.einsum("on,tni->toi", row, states) for row in (system.c, antiderivative))
            before, after = response[:-1], response[1:]
            sizes = np.maximum(np.abs(before) + np.abs(after), np.finfo(float).tiny)
            crossing = 0.5 * step * (before**2 + after**2) / sizes
            total += np.where(before * after < 0.0, crossing, np.abs(np.diff(integral, axis=0))).sum(axis=0)
            state = states[-1]
    return float(total.sum(axis=1).max())


def _propagated(a: np.ndarray, state: np.ndarray, step: float, count: int) -> np.ndarray:
    """Returns e^(A t) times the state at t = 0, step, ... count step: shape (count + 1, n, inputs)."""
    states = np.empty((count + 1, *state.shape))
    states[0] = state
    done, over = 1, expm(a * step)
    while done <= count:  # twice as many points each time
        more = min(done, count + 1 - done)
        states[done : done + more] = np.einsum("mn,tni->tmi", over, states[:more])
        done += more
        over = over @ over
    return states


def lipschitz_constant(kind: Regressor, theta_bound: tuple[float, float]) -> float:
    """Returns L such that |theta' phi(x)| <= L |x|_inf for every theta within its bounds.

    Parameters
    ----------
    kind : Regressor
    theta_bound : tuple of two floats
        Bounds of |theta|.

    Returns
    -------
    float

    Examples
    --------
    >>> lipschitz_constant(Regressor.STATE, (5.0, 2.0))
    7.0
    """
    return theta_bound[0] if kind == Regressor.INFINITY_NORM else sum(theta_bound)


def l1_condition(
    a_m: np.ndarray,
    b: np.ndarray,
    order: FilterOrder,
    w: float,
    lipschitz: float,
    extension: Extension = NO_EXTENSION,
    omegas: Sequence[float] = (1.0,),
) -> float:
    """Returns the largest |G|_L1 L over the input gains, which must stay below 1.

    Parameters
    ----------
    a_m : array, shape (n, n)
    b : array, shape (n,)
        B_m.
    order, w : FilterOrder, float
        Order and bandwidth [rad/s] of C(s).
    lipschitz : float
        L.
    extension : Extension
    omegas : sequence of float
        Input gains.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If G is not stable.
    """
    systems = (uncompensated(a_m, b, order, w, extension, omega) for omega in omegas)
    return max(map(l1_norm, systems)) * lipschitz


def proportional_gain_range(
    a_m: np.ndarray,
    b: np.ndarray,
    order: FilterOrder,
    w: float,
    lipschitz: float,
    extension: Extension,
    omegas: Sequence[float] = (1.0,),
) -> tuple[float, float]:
    """Returns the lowest range of K_P that satisfies the L1-norm condition.

    Parameters
    ----------
    a_m, b, order, w, lipschitz, omegas
        See `l1_condition`.
    extension : Extension
        K_I and the output C; its K_P is replaced.

    Returns
    -------
    tuple of two floats
        Both ends, to 0.01 %. Both are NaN if no searched gain satisfies the condition: 0, and 5 gains a
        decade. The upper end is infinite if the condition holds up to 1e4 k_g.
    """

    def excess(gain: float) -> float:
        changed = replace(extension, proportional_gain=gain)
        try:
            return l1_condition(a_m, b, order, w, lipschitz, changed, omegas) - 1.0
        except ValueError:
            return _UNSTABLE

    def edge(below: float, above: float) -> float:
        root: Any = brentq(excess, below, above, xtol=1e-4 * above)
        return float(root)

    k_g = abs(feedforward_gain(a_m, b, np.asarray(extension.output)))
    low, before = None, 0.0
    for gain in (0.0, *(k_g * np.geomspace(1e-3, _LARGEST_GAIN, 36))):
        holds = excess(gain) < 0.0
        if holds and low is None:
            low = edge(before, gain) if gain else 0.0
        elif low is not None and not holds:
            return low, edge(before, gain)
        before = gain
    return (float("nan"), float("nan")) if low is None else (low, float("inf"))


def smallest_bandwidth(
    a_m: np.ndarray,
    b: np.ndarray,
    order: FilterOrder,
    lipschitz: float,
    largest: float = 1e5,
    extension: Extension = NO_EXTENSION,
    omegas: Sequence[float] = (1.0,),
) -> float:
    """Returns the filter bandwidth [rad/s] above which the L1-norm condition holds, to 0.1 %.

    Parameters
    ----------
    a_m, b, order, lipschitz, extension, omegas
        See `l1_condition`.
    largest : float
        Largest bandwidth of the search [rad/s].

    Returns
    -------
    float
        The search begins at a hundredth of the slowest mode of A_m, which is the result if the condition
        holds there.

    Raises
    ------
    ValueError
        If `largest` does not satisfy the condition.
    """

    def excess(logarithm: float) -> float:
        w = float(np.exp(logarithm))
        return l1_condition(a_m, b, order, w, lipschitz, extension, omegas) - 1.0

    slowest = -np.linalg.eigvals(np.asarray(a_m, float)).real.max()
    low, high = np.log(0.01 * slowest), np.log(largest)
    if excess(low) < 0.0:
        return float(np.exp(low))
    decade = np.log(10.0)
    # by decades: a wide range of bandwidths takes long to evaluate
    while excess(min(low + decade, high)) > 0.0:
        low += decade
        if low >= high:
            raise ValueError(f"no bandwidth up to {largest} rad/s satisfies the L1-norm condition")
    root: Any = brentq(excess, low, min(low + decade, high), xtol=1e-3)
    return float(np.exp(root))
