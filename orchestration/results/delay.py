"""The lag of a signal: the delay of its reference with the least distance to it.

The reference is a line between communication points, so the mean square of signal - delayed reference is a
parabola in the delay within each communication step. For a delay of k + f steps, 0 <= f <= 1, its sum is

    A_k + 2 f B_k + f^2 C_k,   A_k = sum (s_i - r_(i-k))^2,   C_k = sum (r_(i-k) - r_(i-k-1))^2,
    2 B_k = A_(k+1) - A_k - C_k,

which gives its least value. All A_k come from one correlation by FFT and one cumulative sum.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from orchestration.errors import ScenarioError
from orchestration.results.recording import Recording, along_time, on_host

_PARTS = 60  # of the search: a signal leads if it is nearer at one part of lead than at 0
_LAG_ERROR_S = 1e-4  # of the search for points that are not equally spaced
_MOST_POINTS = 2**17  # of a reference whose sums are kept
_NEAR, _EQUAL = 1e-9, 1e-6  # of a communication step: rounding of a delay, and of the distance of points


@along_time
def shift_lag(recording: Recording, signal: str, reference: str, largest: float) -> Any:
    """Returns the delay [s], 0..largest, of the reference with the least RMSE to the signal.

    Points count from `largest` seconds after the start, so that every delay has the same points. The result
    is NaN if the least RMSE is at an edge of the search, and 0 if the signal neither lags nor leads.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal, reference : str
        "component.variable" of each.
    largest : float
        Longest delay of the search [s].

    Returns
    -------
    float, or array of shape (runs,)

    Raises
    ------
    ScenarioError
        For a run that is shorter than `largest`.
    """
    time, values, target = recording.time, np.atleast_2d(recording[signal]), recording[reference]
    if not time[-1] >= time[0] + largest:
        raise ScenarioError(
            f"largest = {largest:g}: expected less than the {time[-1] - time[0]:g} s of the run"
        )
    if target.ndim > 1 and (target == target[0]).all():
        # one reference for all runs: its sums are computed once
        target = on_host(target[0])
    step = float(time[-1] - time[0]) / (len(time) - 1)
    gaps = np.diff(time)
    gaps -= step
    if np.abs(gaps, out=gaps).max() <= _EQUAL * step:
        steps = largest / step
        nearest = step * on_host(_nearest_delays(values, target, math.ceil(steps - _NEAR), steps))
    else:
        values = on_host(values)
        runs = zip(values, np.broadcast_to(on_host(target), values.shape), strict=True)
        nearest = np.array([_searched_delay(time, *run, largest) for run in runs])
    is_lag = nearest <= largest - 2.0 * _LAG_ERROR_S
    for run in (nearest * _PARTS < largest).nonzero()[0]:
        of_run = target if target.ndim == 1 else on_host(target[run])
        is_lag[run] &= not _leads(time, on_host(values[run]), of_run, largest)
    return np.where(is_lag, nearest, math.nan).reshape(recording[signal].shape[:-1])


def _nearest_delays(signals: np.ndarray, reference: np.ndarray, count: int, largest: float) -> np.ndarray:
    """Returns the delay of least distance of each signal, 0..largest in steps; NaN if all are equal.

    signals: shape (runs, n); reference: the same, or shape (n,)
    count: number of steps with delays of the search
    """
    if count < 1:
        return np.full(len(signals), math.nan)
    points, length = signals.shape[-1], _length(signals.shape[-1])
    sums = _sums_of_reference if reference.size <= _MOST_POINTS else _sums_of_reference.__wrapped__
    of_reference = sums(on_host(reference).tobytes(), points, count)
    level, spectrum, squares, changes = (np.asarray(one, like=signals) for one in of_reference)
    padded = np.zeros_like(signals, shape=(len(signals), length), order="C")
    np.subtract(signals[:, count:], level, out=padded[:, count:points])
    spectra = np.fft.rfft(padded)
    spectra *= spectrum
    # CuPy's function has no argument `out`
    out: dict[str, Any] = {"out": padded} if isinstance(padded, np.ndarray) else {}
    products = np.fft.irfft(spectra, length, **out)[:, : count + 1]
    distances = squares - 2.0 * products
    ends = np.asarray(np.minimum(largest - np.arange(count), 1.0), like=signals)
    slopes = distances[:, 1:] - distances[:, :-1] - changes
    parts = (-0.5 * slopes / np.where(changes > 0.0, changes, 1.0)).clip(0.0, ends)
    best = np.argmin(distances[:, :-1] + parts * (slopes + parts * changes), axis=-1)
    part = np.take_along_axis(parts, best[:, None], axis=-1)[:, 0]
    return np.where(changes.any(axis=-1), best + part, math.nan)


def _length(points: int) -> int:
    """Returns the length of a Fourier transform of `points` in which no delay wraps around."""
    return 1 << (points - 1).bit_length()


# most runs have the reference of the run before
@lru_cache(1)
def _sums_of_reference(reference: bytes, points: int, first: int) -> tuple[np.ndarray, ...]:
    """Returns sums over the points of references from `first` on, each of shape (1, ...) or (runs, ...).

    They are the mean; the conjugate of the spectrum of the reference less the mean; sums of r_(i-k)^2,
    k = 0..first; and sums of (r_(i-k) - r_(i-k-1))^2, k = 0..first - 1.
    """
    # sums of squares lose fewer digits to rounding without the mean
    values = np.frombuffer(reference).reshape(-1, points)
    level = values.mean(axis=-1, keepdims=True)
    centred = values - level
    sums: Any = np.zeros((len(centred), points + 1), complex)
    sums.real[:, 1:] = centred**2
    sums.imag[:, 1:-1] = np.diff(centred) ** 2
    # both sums at once take the time of one
    np.cumsum(sums, axis=-1, out=sums)
    by_delay: Any = (sums[:, -first - 1 :] - sums[:, : first + 1])[:, ::-1]
    return level, np.fft.rfft(centred, _length(points)).conj(), by_delay.real, by_delay.imag[:, 1:]


def _searched_delay(time: np.ndarray, signal: np.ndarray, reference: np.ndarray, largest: float) -> float:
    """Returns the nearest delay [s] by search, for points that are not equally spaced.

    Each grid of delays spans the parts beside the nearest delay of the grid before.
    """
    late = slice(int(np.searchsorted(time, time[0] + largest)), None)

    def distance(delay: float) -> float:
        return float(np.mean((signal[late] - np.interp(time[late] - delay, time, reference)) ** 2))

    low, high = 0.0, largest
    while True:
        grid = np.linspace(low, high, _PARTS + 1)
        distances = [distance(delay) for delay in grid]
        is_flat = (low, high) == (0.0, largest) and min(distances) == max(distances)
        if is_flat or not np.isfinite(distances).all():
            return math.nan
        best = int(np.argmin(distances))
        if high - low <= _PARTS * _LAG_ERROR_S:
            return float(grid[best])
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, _PARTS)]


def _leads(time: np.ndarray, signal: np.ndarray, reference: np.ndarray, largest: float) -> bool:
    """Whether the signal is nearer to the later reference than to the present one; false without points."""
    lead = largest / _PARTS
    first, end = np.searchsorted(time, (time[0] + largest, time[-1] - lead))
    if end <= first:
        return False
    ahead = np.interp(time[first:end] + lead, time, reference)
    now = reference[first:end]
    return bool(np.mean((signal[first:end] - ahead) ** 2) < np.mean((signal[first:end] - now) ** 2))
