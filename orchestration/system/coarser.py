"""The experiment with which the error of another one is estimated: the same at twice the step."""

import math
from dataclasses import replace

from orchestration.errors import SystemDefinitionError
from orchestration.system.experiment import Experiment
from orchestration.system.time_grid import GRID_TOLERANCE

_LARGEST_TOLERANCE = 0.99  # an experiment takes less than 1


def coarser(experiment: Experiment) -> Experiment:
    """The experiment with twice the step, to the last communication point that every component has in both.

    A tolerance becomes as many times larger as the error: 2 to the power of the order of the exchange.
    Raises SystemDefinitionError for a run of less than two steps.
    """
    start, step = experiment.start_time, 2.0 * experiment.step_size
    step_sizes = {name: 2.0 * size for name, size in experiment.step_sizes.items()}
    longest = step * math.lcm(*(experiment.period(name) for name in step_sizes))
    count = math.floor((experiment.stop_time - start) / longest * (1.0 + GRID_TOLERANCE))
    if not count:
        raise SystemDefinitionError(
            f"error estimate: expected a run of at least {longest:g} s, two steps of every component, got "
            f"{experiment.stop_time - start:g} s"
        )
    stop = start + count * longest
    tolerance = experiment.tolerance and 2.0 ** (1 + experiment.extrapolation) * experiment.tolerance
    return replace(
        experiment,
        stop_time=stop,
        step_size=step,
        step_sizes=step_sizes,
        tolerance=tolerance and min(tolerance, _LARGEST_TOLERANCE),
        events=tuple(event for event in experiment.events if event.time <= stop),
        faults=tuple(fault for fault in experiment.faults if fault.start < stop),
        error_estimate=False,
    )
