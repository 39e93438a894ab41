"""The part of one step in a metric: rewards of an agent, whose sum over a run is the run's metric.

An input that is held over the step counts with the held value: `after` has it already, `before` has that of
the step before.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import ScenarioError

Values = Mapping[str, Any]  # name -> number, or array of one for each environment
Reward = Callable[[Values, Values, Any], Any]  # of the values before and after a step, and its size [s]


def squared_error(signal: str, reference: str, duration: float, scale: float = 1.0) -> Reward:
    """Returns scale^2 (signal - reference)^2 h / duration.

    Their sum is the square of the metric rmse, of the points after the first.
    """

    def increment(before: Values, after: Values, h: float) -> Any:
        return (scale * (after[signal] - after[reference])) ** 2 * (h / duration)

    return increment


def effort(signal: str) -> Reward:
    """Returns the trapezoidal rule of |signal|: their sum is the metric effort."""
    return lambda before, after, h: 0.5 * h * (np.abs(before[signal]) + np.abs(after[signal]))


def total_variation(signal: str) -> Reward:
    """Returns |change of the signal|: their sum is the metric total_variation."""
    return lambda before, after, h: np.abs(after[signal] - before[signal])


_OF_METRICS: dict[str, Callable[..., Reward]] = {
    "rmse": squared_error,
    "effort": effort,
    "total_variation": total_variation,
}


def reward_of(
    metrics: Mapping[str, Mapping[str, Any]], weights: Mapping[str, float], duration: float
) -> tuple[Reward, list[str]]:
    """Returns the weighted sum of what a step adds to metrics, and the names of the signals that it needs.

    metrics: as a scenario declares them; weights: metric -> factor, below 0 for what is to be small
    duration: of the run [s]
    Raises ScenarioError for a metric that is unknown, or that is no sum over the whole run.
    """
    increments: list[tuple[float, Reward]] = []
    names: list[str] = []
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
        names += [call[key] for key in ("signal", "reference") if key in call]
        more = {"duration": duration} if function == "rmse" else {}
        increments.append((weight, _OF_METRICS[function](**call, **more)))
    return _weighted(increments), list(dict.fromkeys(names))


def _weighted(increments: Iterable[tuple[float, Reward]]) -> Reward:
    terms = list(increments)
    return lambda before, after, h: sum(weight * increment(before, after, h) for weight, increment in terms)
