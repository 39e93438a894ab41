"""Times on the grid of communication points: computed in floating point, so near is equal."""

import math

import numpy as np

# Of a step: times are computed in floating point, so a time this close to a communication point is on it.
GRID_TOLERANCE = 1e-9
_ROUNDING = 4.0 * np.finfo(float).eps  # of the latest time, not of a step, which may be short


def resolution(step: float, *times: float) -> float:
    """Returns the largest difference [s] of equal times: a small part of a step, above rounding."""
    return max(GRID_TOLERANCE * step, _ROUNDING * max(map(abs, times)))


def time_grid(start: float, stop: float, step: float) -> np.ndarray:
    """Returns start + i step [s], shape (n,), never accumulated; a last shorter step lands on `stop`."""
    times = start + np.arange(step_count(start, stop, step) + 1) * step
    times[-1] = stop
    return times


def step_count(start: float, stop: float, step: float) -> int:
    """Returns the number of steps of that grid."""
    return math.ceil((stop - start) / step - resolution(step, start, stop) / step)


def within(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """Returns the indices of ascending times [s] from `start` on and before `end`, shape (n,) -> (m,)."""
    near = resolution_of(times)
    return np.flatnonzero((times >= start - near) & (times < end - near))


def resolution_of(times: np.ndarray) -> float:
    """Returns the largest difference [s] of equal times among ascending ones [s], shape (n,)."""
    if len(times) < 2:
        return 0.0
    return resolution(float(np.diff(times).min()), float(times[0]), float(times[-1]))


def is_multiple(length: float, step: float) -> bool:
    """Whether a length is a multiple of a step, at least once."""
    ratio = length / step
    return math.isfinite(ratio) and ratio >= 0.5 and abs(ratio - round(ratio)) <= GRID_TOLERANCE * ratio
