"""The part of one step in a metric: rewards of an agent, whose sum over a run is the run's metric.

An input that is held over the step counts with the held value, which `after` has; `before` has the value of
the previous step.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import ScenarioError

Values = Mapping[str, Any]  # name -> number, or array of one for each environment
Reward = Callable[[Values, Values, Any], Any]  # of the values before and after a step, and its size [s]


def squared_error(signal: str, reference: str, duration: float, scale: float = 1.0) -> Reward:
    """Returns scale^2 (signal - reference)^2 h / duration.

    The sum is the square of the metric rmse over the points after the first.

    Parameters
    ----------
    signal, reference : str
        "component.variable" of each.
    duration : float
        Duration of the run [s].
    scale : float
        Factor of the difference.

    Returns
    -------
    Reward
        Function of the values before and after a step, and its size h [s].
    """
    return lambda before, after, h: (scale * (after[signal] - after[reference])) ** 2 * (h / duration)


def effort(signal: str) -> Reward:
    """Returns the trapezoidal rule of |signal|; the sum is the metric effort.

    Parameters
    ----------
    signal : str
        "component.variable".

    Returns
    -------
    Reward
        Function of the values before and after a step, and its size [s].
    """
    return lambda before, after, h: 0.5 * h * (np.abs(before[signal]) + np.abs(after[signal]))


def total_variation(signal: str) -> Reward:
    """Returns |change of the signal|; the sum is the metric total_variation.

    Parameters
    ----------
    signal : str
        "component.variable".

    Returns
    -------
    Reward
        Function of the values before and after a step, and its size [s].
    """
    return lambda before, after, h: np.abs(after[signal] - before[signal])


_OF_METRICS: dict[str, Callable[..., Reward]] = {
    "rmse": squared_error,
    "effort": effort,
    "total_variation": total_variation,
}


def reward_of(
    metrics: Mapping[str, Mapping[str, Any]], weights: Mapping[str, float], duration: float
) -> tuple[Reward, list[str]]:
    """Returns the weighted sum of the increments of metrics, and the names of the signals that it needs.

    Parameters
    ----------
    metrics : mapping
        Name -> function and its arguments, as a scenario declares them.
    weights : mapping
        Metric -> factor, negative for a metric to reduce.
    duration : float
        Duration of the run [s].

    Returns
    -------
    tuple
        Reward, and list of names.

    Raises
    ------
    ScenarioError
        For a metric that is unknown, or not a sum over the whole run.
    """
    terms: list[tuple[float, Reward]] = []
    names: dict[str, None] = {}
    for name, weight in weights.items():
        if name not in metrics:
            raise ScenarioError(f"reward: no metric {name!r}; {nearest(name, metrics)}")
        call = {key: value for key, value in metrics[name].items() if key not in ("function", "unit")}
        function = metrics[name]["function"]
        if function not in _OF_METRICS or not call.keys() <= {"signal", "reference", "scale"}:
            raise ScenarioError(
                f"reward: metric {name}: expected a sum over the whole run: {', '.join(_OF_METRICS)} "
                f"without a window, got {dict(metrics[name])}"
            )
        names |= dict.fromkeys(call[key] for key in ("signal", "reference") if key in call)
        # a mean square is a sum only when it is divided by the duration of the whole run
        more = {"duration": duration} if function == "rmse" else {}
        terms.append((weight, _OF_METRICS[function](**call, **more)))
    return lambda before, after, h: sum(weight * term(before, after, h) for weight, term in terms), [*names]
