"""Metrics: pure functions that summarise a recording by a number.

Every function takes the recording, the names of signals, and its own arguments; a scenario names the
function and its arguments. Windows are [start, end] in seconds and default to the whole run.
For a recording of many runs they return shape (runs,), with the bits of each run alone.
"""

import math
import warnings
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError, ScenarioError, ScenarioWarning, about
from orchestration.results.delay import shift_lag
from orchestration.results.power import energy_residuals
from orchestration.results.recording import Recording, along_time, run_by_run

SIGNALS = ("signal", "reference", "flow")
"""Arguments of metrics that name signals."""
# of an amplitude, relative to the mean: a smaller amplitude is rounding
_ROUNDING = 1e-9


def _window(recording: Recording, window: list[float] | None) -> slice:
    """Returns the communication points of a window, whose times ascend."""
    if window is None:
        return slice(0, len(recording.time))
    start, end = window
    # communication points are rounded multiples of a step: the ends of a window must not miss them
    tolerance = 1e-9 * max(1.0, abs(end))
    first = int(np.searchsorted(recording.time, start - tolerance))
    last = int(np.searchsorted(recording.time, end + tolerance, side="right"))
    if not first < last:
        raise ScenarioError(
            f"window {window}: expected to overlap the run, {recording.time[0]:g}..{recording.time[-1]:g} s"
        )
    return slice(first, last)


@along_time
def settling_time(
    recording: Recording, signal: str, target: float, band: float, window: list[float] | None = None
) -> Any:
    """Returns the last time [s] in the window with |signal - target| > band; its beginning if never.

    Not a number if the signal is outside the band at the end of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    target : float
        In the unit of the signal.
    band : float
        Largest distance from the target of a settled signal, in its unit.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
    """
    inside = _window(recording, window)
    # negated: a value that is not a number is outside
    outside = ~(np.abs(recording[signal][..., inside] - target) <= band)
    time = np.asarray(recording.time[inside], like=outside)
    last = len(time) - 1 - np.argmax(outside[..., ::-1], axis=-1)
    return np.where(outside[..., -1], math.nan, np.where(outside.any(axis=-1), time[last], time[0]))


@along_time
def rmse(
    recording: Recording,
    signal: str,
    reference: str,
    window: list[float] | None = None,
    scale: float = 1.0,
) -> Any:
    """Returns scale * sqrt(mean((signal - reference)^2)) over the communication points of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal, reference : str
        "component.variable" of each.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.
    scale : float
        Factor of the result, such as 100.0 for cm of a signal in m.

    Returns
    -------
    float, or array of shape (runs,)
    """
    return scale * np.sqrt(np.mean(_error(recording, signal, reference, window)[1] ** 2, axis=-1))


@along_time
def recovery_time(recording: Recording, signal: str, target: float, band: float, window: list[float]) -> Any:
    """Returns the `settling_time` [s] since the beginning of the window, when a disturbance sets in.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    target : float
        In the unit of the signal.
    band : float
        Largest distance from the target of a settled signal, in its unit.
    window : list of two floats
        Start and end [s].

    Returns
    -------
    float, or array of shape (runs,)
    """
    begin = recording.time[_window(recording, window)][0]
    return settling_time(recording, signal, target, band, window) - float(begin)


@along_time
def std(recording: Recording, signal: str, window: list[float] | None = None, scale: float = 1.0) -> Any:
    """Returns scale * standard deviation about the mean, over the communication points of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    window : list of two floats, optional
        Start and end [s]; by default the whole run.
    scale : float
        Factor of the result, such as 100.0 for cm of a signal in m.

    Returns
    -------
    float, or array of shape (runs,)
    """
    return scale * recording[signal][..., _window(recording, window)].std(axis=-1)


@along_time
def overshoot(recording: Recording, signal: str, target: float, window: list[float] | None = None) -> Any:
    """Returns the largest excess of the signal over the target, in percent of the target, at least 0.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    target : float
        In the unit of the signal, not 0.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In percent.

    Raises
    ------
    ScenarioError
        For a target of 0.
    """
    if target == 0.0:
        raise ScenarioError("overshoot: target = 0: expected another, the overshoot is relative to it")
    farthest = (math.copysign(1.0, target) * recording[signal][..., _window(recording, window)]).max(axis=-1)
    excess = 100.0 * (farthest - abs(target)) / abs(target)
    return np.where(excess <= 0.0, 0.0, excess)


@along_time
def mean(recording: Recording, signal: str, window: list[float] | None = None) -> Any:
    """Returns the mean over the communication points of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the unit of the signal.
    """
    return recording[signal][..., _window(recording, window)].mean(axis=-1)


@along_time
def effort(recording: Recording, signal: str, window: list[float] | None = None) -> Any:
    """Returns the integral of |signal| dt, by the trapezoidal rule.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the unit of the signal times s.
    """
    inside = _window(recording, window)
    values = recording[signal][..., inside]
    return np.trapezoid(np.abs(values), np.asarray(recording.time[inside], like=values))


@along_time
def peak(recording: Recording, signal: str, window: list[float] | None = None, scale: float = 1.0) -> Any:
    """Returns scale * largest |signal| at the communication points of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    window : list of two floats, optional
        Start and end [s]; by default the whole run.
    scale : float
        Factor of the result, such as 100.0 for cm of a signal in m.

    Returns
    -------
    float, or array of shape (runs,)
    """
    return scale * np.abs(recording[signal][..., _window(recording, window)]).max(axis=-1)


@along_time
def maximum(recording: Recording, signal: str, window: list[float] | None = None, scale: float = 1.0) -> Any:
    """Returns scale * largest value at the communication points of the window, with its sign.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    window : list of two floats, optional
        Start and end [s]; by default the whole run.
    scale : float
        Factor of the result, such as 100.0 for cm of a signal in m.

    Returns
    -------
    float, or array of shape (runs,)
    """
    return scale * recording[signal][..., _window(recording, window)].max(axis=-1)


@along_time
def minimum(recording: Recording, signal: str, window: list[float] | None = None, scale: float = 1.0) -> Any:
    """Returns scale * least value at the communication points of the window, with its sign.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    window : list of two floats, optional
        Start and end [s]; by default the whole run.
    scale : float
        Factor of the result, such as 100.0 for cm of a signal in m.

    Returns
    -------
    float, or array of shape (runs,)
    """
    return scale * recording[signal][..., _window(recording, window)].min(axis=-1)


@along_time
def peak_error(
    recording: Recording, signal: str, reference: str, window: list[float] | None = None, scale: float = 1.0
) -> Any:
    """Returns scale * largest |signal - reference| at the communication points of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal, reference : str
        "component.variable" of each.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.
    scale : float
        Factor of the result, such as 100.0 for cm of a signal in m.

    Returns
    -------
    float, or array of shape (runs,)
    """
    return scale * np.abs(_error(recording, signal, reference, window)[1]).max(axis=-1)


@along_time
def iae(recording: Recording, signal: str, reference: str, window: list[float] | None = None) -> Any:
    """Returns the integral of the absolute error, |signal - reference| dt, by the trapezoidal rule.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal, reference : str
        "component.variable" of each.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the unit of the signal times s.
    """
    time, error = _error(recording, signal, reference, window)
    return np.trapezoid(np.abs(error), time)


@along_time
def ise(recording: Recording, signal: str, reference: str, window: list[float] | None = None) -> Any:
    """Returns the integral of the squared error, (signal - reference)^2 dt, by the trapezoidal rule.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal, reference : str
        "component.variable" of each.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the square of the unit of the signal times s.
    """
    time, error = _error(recording, signal, reference, window)
    return np.trapezoid(error**2, time)


@along_time
def itae(recording: Recording, signal: str, reference: str, window: list[float] | None = None) -> Any:
    """Returns the integral of the absolute error times time, t |signal - reference| dt, trapezoidal rule.

    The time t counts from the beginning of the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal, reference : str
        "component.variable" of each.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the unit of the signal times s2.
    """
    time, error = _error(recording, signal, reference, window)
    return np.trapezoid((time - time[0]) * np.abs(error), time)


def _error(
    recording: Recording, signal: str, reference: str, window: list[float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (time, signal - reference) of the window."""
    inside = _window(recording, window)
    error = (recording[signal] - recording[reference])[..., inside]
    return np.asarray(recording.time[inside], like=error), error


@run_by_run
def energy_residual(recording: Recording, signal: str, flow: str, window: list[float] | None = None) -> float:
    """Returns the energy that the exchange of an effort, the signal, and a flow at points creates.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    flow : str
        "component.variable" of the flow: signal times flow is a power.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the unit of signal times flow times s.
    """
    inside = _window(recording, window)
    return float(energy_residuals(recording, signal, flow)[inside.start : inside.stop - 1].sum())


@run_by_run
def time_below(
    recording: Recording, signal: str, limit: float, after: float, window: list[float] | None = None
) -> float:
    """Returns how long [s] the signal is below the limit once it has been above `after`.

    The signal is lines between points.

    Not a number if it is never above `after` in the window.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    limit, after : float
        In the unit of the signal.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
    """
    inside = _window(recording, window)
    time, values = recording.time[inside], recording[signal][inside]
    passed = np.flatnonzero(values > after)
    if not len(passed) or np.isnan(values).any():
        return math.nan
    return _seconds_below(time[passed[0] :], values[passed[0] :], limit)


def _seconds_below(time: np.ndarray, values: np.ndarray, limit: float) -> float:
    """Returns how long [s] straight lines between points are below a limit."""
    low, high = np.minimum(values[:-1], values[1:]), np.maximum(values[:-1], values[1:])
    span = np.where(high > low, high - low, 1.0)
    share = np.where(high > low, ((limit - low) / span).clip(0.0, 1.0), low < limit)
    return float((share * np.diff(time)).sum())  # not BLAS, whose threads wait for each other


@run_by_run
def time_above(recording: Recording, signal: str, limit: float, window: list[float] | None = None) -> float:
    """Returns how long [s] the signal is above the limit. The signal is lines between points.

    Not a number if a value of the signal is not a number.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    limit : float
        In the unit of the signal.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
    """
    inside = _window(recording, window)
    values = recording[signal][inside]
    # a comparison with such a value is false, and would count it as not above
    if np.isnan(values).any():
        return math.nan
    return _seconds_below(recording.time[inside], -values, -limit)


@run_by_run
def duty_cycle(
    recording: Recording, signal: str, limit: float = 0.5, window: list[float] | None = None
) -> float:
    """Returns the share of the time [%] in which the signal is above the limit, as a Boolean is when true.

    The signal keeps its value until the next communication point.

    Not a number if the window has a single point, or if a value of the signal is not a number.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    limit : float
        In the unit of the signal; by default between false, 0, and true, 1.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In percent.
    """
    inside = _window(recording, window)
    durations, values = np.diff(recording.time[inside]), recording[signal][inside]
    if not len(durations) or np.isnan(values).any():
        return math.nan
    return float(100.0 * durations[values[:-1] > limit].sum() / durations.sum())


@along_time
def total_variation(
    recording: Recording, signal: str, every: float | None = None, window: list[float] | None = None
) -> Any:
    """Returns the sum of |change| between communication points, or between points `every` seconds apart.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    every : float, optional
        Time between the points [s].
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
        In the unit of the signal.
    """
    inside = _window(recording, window)
    time, values = recording.time[inside], recording[signal][..., inside]
    if every is not None:
        # the last interval may be a part of one
        count = math.ceil((time[-1] - time[0]) / every - 1e-6)
        sampling_times = time[0] + every * np.arange(count + 1)
        indices = np.searchsorted(time, sampling_times - 1e-6 * every).clip(max=len(time) - 1)
        # in C order, unlike values[..., indices]: sums then have the bits of each run alone
        values = np.take(values, np.asarray(indices, like=values), axis=-1)
    return np.abs(np.diff(values)).sum(axis=-1)


@run_by_run
def phase_lag(
    recording: Recording, signal: str, angular_frequency: float, window: list[float] | None = None
) -> float:
    """Returns the delay [s] of the fundamental behind cos(angular_frequency t), by least squares.

    It is within half a period; a longer delay appears reduced by whole periods. Not a number without an
    oscillation.

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    signal : str
        "component.variable".
    angular_frequency : float
        In rad/s.
    window : list of two floats, optional
        Start and end [s]; by default the whole run.

    Returns
    -------
    float, or array of shape (runs,)
    """
    inside = _window(recording, window)
    angle = angular_frequency * recording.time[inside]
    basis = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
    (cosine, sine, offset), *_ = np.linalg.lstsq(basis, recording[signal][inside], rcond=None)
    if not math.hypot(cosine, sine) > _ROUNDING * abs(offset):
        return math.nan
    return float(np.arctan2(sine, cosine) / angular_frequency)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    function.__name__: function
    for function in (
        shift_lag,
        settling_time,
        rmse,
        recovery_time,
        std,
        overshoot,
        mean,
        effort,
        peak,
        maximum,
        minimum,
        peak_error,
        iae,
        ise,
        itae,
        energy_residual,
        time_below,
        time_above,
        duty_cycle,
        total_variation,
        phase_lag,
    )
}


def evaluate(recording: Recording, declared: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the metrics that a scenario declares: a float of one run, of many an array, shape (runs,).

    Parameters
    ----------
    recording : Recording
        One run, or many with a first axis of runs.
    declared : mapping
        Name -> {"function": ..., its arguments, perhaps a unit}, as `Scenario.metrics`.

    Returns
    -------
    dict
        Name -> value. If an FMU terminated the run, a metric that needs a later time is not a number.

    Raises
    ------
    ScenarioError
        For a metric that cannot be computed, or is infinite, in any of the runs.

    Examples
    --------
    >>> time = np.array([0.0, 1.0, 2.0])
    >>> recording = Recording(("plant.depth",), ("m",), time, np.array([[0.0], [0.9], [0.8]]))
    >>> metrics = evaluate(recording, {"deepest": {"function": "maximum", "signal": "plant.depth"}})
    >>> float(metrics["deepest"])
    0.9
    """
    return {name: _one(recording, name, call) for name, call in declared.items()}


def _one(recording: Recording, name: str, call: Mapping[str, Any]) -> Any:
    function = call["function"]
    if function not in FUNCTIONS:
        raise ScenarioError(f"metric {name}: unknown function {function!r}; {nearest(function, FUNCTIONS)}")
    for signal in (call[key] for key in SIGNALS if call.get(key) in recording.strings):
        raise ScenarioError(f"metric {name}: {signal} is a String: expected a signal that is a number")
    if _ended_too_early(recording, call):
        return math.nan if recording.run_count is None else np.full(recording.run_count, math.nan)
    arguments = {key: value for key, value in call.items() if key not in ("function", "unit")}
    try:
        value = FUNCTIONS[function](recording, **arguments)
    except OrchestrationError as error:
        raise ScenarioError(f"metric {name}: {error}") from error
    except (TypeError, ValueError, ArithmeticError, IndexError) as error:
        raise ScenarioError(f"metric {name}: {dict(call)}: {error}") from error
    if np.isinf(value).any():
        raise ScenarioError(f"metric {name} is {value}: expected a finite number; check {dict(call)}")
    return value


def _ended_too_early(recording: Recording, call: Mapping[str, Any]) -> bool:
    if "terminated" not in recording.provenance:
        return False
    start, end = recording.time[[0, -1]]
    needed = max(call.get("window", [end, end])[1], start + call.get("largest", 0.0))
    return bool(end < needed - 1e-9 * max(1.0, abs(needed)))


def check_run(
    declared: Mapping[str, Mapping[str, Any]], start: float, stop: float, record: Collection[str]
) -> None:
    """Refuses a window outside the run, or a signal that is not recorded (an empty record is all).

    Warns (ScenarioWarning) of windows of which the run has a part.
    """
    for name, call in declared.items():
        window = call.get("window", [start, stop])
        with about(("metrics", name)):
            if not window[0] <= window[1]:
                raise ScenarioError(f"metric {name}: window {window!r}: expected [start, end] in s")
            if window[0] >= stop or window[1] <= start:
                raise ScenarioError(
                    f"metric {name}: window {window}: expected to overlap {start:g}..{stop:g} s; "
                    f"{name} = false drops it"
                )
    check_recorded(declared, record)
    windows = {name: call["window"] for name, call in declared.items() if "window" in call}
    rounding = 1e-9 * max(1.0, abs(start), abs(stop))
    truncated = {
        name: window
        for name, window in windows.items()
        if window[0] < start - rounding or window[1] > stop + rounding
    }
    if truncated:
        listing = ", ".join(f"{name} {window}" for name, window in truncated.items())
        warnings.warn(
            f"windows of metrics reach beyond the run, {start:g}..{stop:g} s, and are cut to it: {listing}",
            ScenarioWarning,
            stacklevel=3,
        )


def check_recorded(declared: Mapping[str, Mapping[str, Any]], record: Collection[str]) -> None:
    """Refuses a metric with a signal that is not among the recorded ones (an empty record is all)."""
    for name, call in declared.items():
        for signal in (call[key] for key in SIGNALS if record and key in call):
            if signal not in record:
                raise ScenarioError(
                    f"metric {name}: {signal!r} is not recorded; {nearest(signal, record)}; "
                    "record = [...] names all variables to record, above the first [table]",
                    ("metrics", name),
                )
