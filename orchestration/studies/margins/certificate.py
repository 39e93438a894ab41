"""A certificate for the extension: the largest sector of u_p for which the loop returns to its hold.

The linear loop of the blocks' code contains the integral of the PI. The rest of u_p adds to each step

    x' = A x - b q,   v = c x,   q (q - k v) <= 0,   v = e

and, with a drag D_q |w| w in still water up to a speed w_max, a second such term, of the slope 2 D_q w_max.
A period is x' = A x - B q and v = C x + D q, with all q and v of its steps. If a matrix P > 0 satisfies

    x'^T P x' - x^T P x < 2 q^T T (q - K v)   for all x and q but 0,

V = x^T P x falls for every q in its sector, however it changes with time (circle criterion; K has the gains,
T the multipliers). P solves a Riccati equation. That it satisfies the inequality is checked in rational
numbers. Sources: Zames (1966); Megretski and Rantzer (1997); docs/explanation/theory.md.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from fmus.extras import imports_of
from fmus.fmi.variable_types import FmiValue
from orchestration.studies.margins.code_loop import CodeLoop, Step, is_bounded
from orchestration.studies.margins.fmu_margins import Metric
from orchestration.studies.margins.l1_design import Design

with imports_of("study", "a certificate"):
    from scipy.linalg import LinAlgError, matrix_balance, solve_discrete_are

FASTEST = 0.2  # m/s; the drag is in its sector up to this speed
_DECREASE = 1e-6  # of V, relative to the squares of the scaled states
_SMALL = 1e-3  # m/s; D_q times it changes the linear damping, for its derivative
_WEIGHTS = np.geomspace(0.1, 1e4, 51)  # multipliers of the drag; u_p has 1
# relative: at the end of a hold the state is at rest but for about a millionth
_UNMOVED = 1e-5
_FIRST, _LARGEST = 1e-3, 1e4  # the first k of a search, and one from which on none is tried
_RESOLUTION = 1e-3  # relative, of the end of a search
CERTIFICATE = "certificate"
_SOURCE = "circle criterion, docs/explanation/theory.md"


class Channel(NamedTuple):
    """Terms -b q with v = c x; b, c: (n,) for each step of a period."""

    b: list[np.ndarray]
    c: list[np.ndarray]

    @classmethod
    def between(cls, before: Sequence[Step], after: Sequence[Step], change: float) -> "Channel":
        """Returns the channel whose gain differs by `change` between two loops, a term of rank one."""
        terms = [np.linalg.svd((a.a - b.a) / change) for a, b in zip(before, after, strict=True)]
        return cls([u[:, 0] * s[0] for u, s, _ in terms], [vt[0] for _, _, vt in terms])


class Period(NamedTuple):
    """x' = a x - b q, v = c x + d q of a period, of the states that q moves."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


def period(steps: Sequence[Step], channels: Sequence[Channel]) -> Period:
    """Returns the period of some steps with some channels, its states scaled."""
    m, n = len(channels), len(steps[0].a)
    a, b, c, d = np.eye(n), np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0))
    for i, step in enumerate(steps):
        of_v = np.array([channel.c[i] for channel in channels])
        c, d = np.vstack([c, of_v @ a]), np.vstack([d, -of_v @ b])
        d = np.hstack([d, np.zeros((len(d), m))])
        b = np.hstack([step.a @ b, np.transpose([channel.b[i] for channel in channels])])
        a = step.a @ a
    _, (scales, _) = matrix_balance(a, permute=False, separate=True)
    return _moved(Period(a * scales / scales[:, np.newaxis], b / scales[:, np.newaxis], c * scales, d))


def _moved(whole: Period) -> Period:
    """Returns a period without a direction that nothing moves and no v sees: estimates whose sum alone has
    an effect have one, with the eigenvalue 1.
    """
    right, left = (np.linalg.svd(matrix - np.eye(len(matrix)))[2][-1] for matrix in (whole.a, whole.a.T))
    residues = (
        (whole.a - np.eye(len(whole.a))) @ right / np.linalg.norm(whole.a),
        left @ whole.b / np.linalg.norm(whole.b),
        whole.c @ right / np.linalg.norm(whole.c),
    )
    if max(float(np.abs(residue).max()) for residue in residues) > _UNMOVED:
        return whole
    basis = np.linalg.svd(left[np.newaxis])[2][1:].T
    return Period(basis.T @ whole.a @ basis, basis.T @ whole.b, whole.c @ basis, whole.d)


def lyapunov_of(whole: Period, gains: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """Returns P for the gains of all v and their multipliers; None if it is not found."""
    weighted = (weights * gains)[:, np.newaxis]
    of_q = weighted * whole.d
    try:
        p = solve_discrete_are(
            whole.a,
            -whole.b,
            _DECREASE * np.eye(len(whole.a)),
            of_q + of_q.T - 2.0 * np.diag(weights),
            s=(weighted * whole.c).T,
        )
    except LinAlgError:
        return None
    p = 0.5 * (p + p.T)
    is_found = np.linalg.eigvalsh(p).min() > 0.0 > np.linalg.eigvalsh(excess(whole, gains, weights, p)).max()
    return p if is_found else None


def excess(whole: Period, gains: Any, weights: Any, p: Any) -> Any:
    """Returns the matrix of x'^T P x' - x^T P x - 2 q^T T (q - K v) in (x, q)."""
    a, b, c, d = whole
    weighted = (weights * gains)[:, np.newaxis]
    cross, of_q = (weighted * c).T - a.T @ p @ b, weighted * d
    last = b.T @ p @ b + of_q + of_q.T - 2 * np.diag(weights)
    return np.vstack([np.hstack([a.T @ p @ a - p, cross]), np.hstack([cross.T, last])])


def is_proved(whole: Period, gains: np.ndarray, weights: np.ndarray, p: np.ndarray) -> bool:
    """Whether P > 0 and the inequality hold, in rational numbers, for these matrices of doubles."""
    exact = np.vectorize(Fraction, otypes=[object])
    *matrices, gains, weights, p = (exact(x) for x in (*whole, gains, weights, p))
    return _is_positive(p) and _is_positive(-excess(Period(*matrices), gains, weights, p))


def _is_positive(matrix: np.ndarray) -> bool:
    """Whether all pivots of a symmetric matrix of rational numbers are positive."""
    rows = matrix.copy()
    for i in range(len(rows)):
        if rows[i, i] <= 0:
            return False
        for j in range(i + 1, len(rows)):
            rows[j, i:] = rows[j, i:] - rows[i, i:] * (rows[j, i] / rows[i, i])
    return True


def largest_sector(steps: Sequence[Step], channel: Channel, *others: tuple[Channel, float]) -> float:
    """Returns the largest k that is proved for a channel, beside others in sectors of given gains."""
    whole = period(steps, [channel, *(other for other, _ in others)])

    def found(k: float, weight: float) -> tuple[np.ndarray, ...] | None:
        gains = np.tile([k, *(gain for _, gain in others)], len(steps))
        weights = np.tile([1.0, *(weight for _ in others)], len(steps))
        p = lyapunov_of(whole, gains, weights)
        return None if p is None else (gains, weights, p)

    best, proof = 0.0, None
    for weight in _WEIGHTS if others else (1.0,):
        # a multiplier is worth its search only if it gives more than the best before
        candidate = found(best * (1.0 + _RESOLUTION) + 1e-9, weight)
        if candidate:
            best = min(_largest(lambda k, weight=weight: found(k, weight) is not None, best), _LARGEST)
            proof = found(best, weight)
    return best if proof and is_proved(whole, *proof) else 0.0


def limit(holds: Callable[[float], bool], known: float = 0.0) -> float:
    """Returns up to which number a condition holds, from a known one or from 0 on; infinite if it holds up to
    the largest that is tried, not a number if it holds at neither.
    """
    start = next((number for number in (known, 0.0) if holds(number)), None)
    return math.nan if start is None else _largest(holds, start)


def _largest(holds: Callable[[float], bool], least: float) -> float:
    """Returns up to which number a condition holds that holds at `least`; infinite without an end."""
    low, high = least, max(least, _FIRST)
    while holds(high):
        if high >= _LARGEST:
            return math.inf
        low, high = high, 2.0 * high
    while high - low > _RESOLUTION * max(high, _FIRST):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def without_p(design: Design) -> dict[str, FmiValue]:
    """Returns values of parameters that leave of the extension the integral of the PI alone, or nothing."""
    name = design.controller
    plain: dict[str, FmiValue] = {f"{name}.augmentation": "pi", f"{name}.proportional_gain": 0.0}
    return plain | ({f"{name}.integral_gain": 0.0} if design.frozen_gains else {})


def certificate_metrics(
    loop: CodeLoop, design: Design, runs_hold: Callable[[float], bool] | None
) -> Iterator[Metric]:
    """Yields the proved sectors, the gains of the scenario beside them, and what is beyond.

    loop: with `without_p`; runs_hold: whether runs with a K_P hold quietly; None if none are made
    """
    dampings = {linear: loop.values[loop.parameters[drag]] for linear, drag in loop.drag.items()}
    changed = {f"{design.controller}.proportional_gain": 1.0}
    damped = {
        key: loop.values[loop.parameters[key]] + _SMALL * of_square for key, of_square in dampings.items()
    }
    before, after, slower = loop.steps({}, changed, damped)
    channel = Channel.between(before, after, 1.0)
    used = max((design.law.proportional_gain, *design.frozen_gains))
    assumption = "about the hold: adaptation, thrusters and free surface linear, no saturation"

    def metric(title: str, value: float, remark: str = "", source: str = _SOURCE) -> Metric:
        return Metric(CERTIFICATE, title, value, design.gain_unit, assumption, source, remark)

    def judged(k: float) -> str:
        return f"the scenario has {used:.4g}, {'inside' if used <= k else 'not proved'}"

    proved = largest_sector(before, channel)
    yield metric("sector of u_p that is proved", proved, judged(proved))
    for of_square in dampings.values():
        by_drag = Channel.between(before, slower, _SMALL * of_square)
        proved = largest_sector(before, channel, (by_drag, 2.0 * of_square * FASTEST))
        yield metric(f"the same with drag up to {FASTEST:g} m/s", proved, judged(proved))

    def is_stable(k: float) -> bool:
        return is_bounded([step.a - k * np.outer(b, c) for step, b, c in zip(before, *channel, strict=True)])

    yield metric("K_P up to which the linear loop is stable", limit(is_stable), source="eigenvalues")
    if runs_hold:
        yield metric("K_P up to which runs are quiet", limit(runs_hold, used), source="measured")
