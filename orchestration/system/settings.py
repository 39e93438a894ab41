"""The times of an experiment that a user does not give: those that the FMUs suggest."""

from typing import Any

from orchestration.errors import SystemDefinitionError
from orchestration.fmi.description import describe
from orchestration.system.system import System

_ATTRIBUTES = {"start_time": "startTime", "stop_time": "stopTime", "step_size": "stepSize"}


def suggested_times(
    system: System,
    stop_time: float | None = None,
    step_size: float | None = None,
    start_time: float | None = None,
) -> tuple[float, float, float]:
    """(stop time, step size, start time) [s]; each that is None is taken from the FMUs' default experiments.

    The suggested start time belongs to the suggested stop time; with a given stop time it is 0.
    Raises SystemDefinitionError for a time that is not given and for which the FMUs suggest none, or several.
    """
    if start_time is None:
        start_time = _suggested(system, "start_time", 0.0) if stop_time is None else 0.0
    if stop_time is None:
        stop_time = _suggested(system, "stop_time")
    if step_size is None:
        step_size = _suggested(system, "step_size")
    return stop_time, step_size, start_time


def _suggested(system: System, name: str, default: float | None = None) -> float:
    times: dict[str, float] = {}
    for component, path in system.components.items():
        experiment: Any = describe(path).defaultExperiment
        suggested = getattr(experiment, _ATTRIBUTES[name], None)
        if suggested is not None:
            times[component] = float(suggested)
    if len(set(times.values())) > 1:
        listed = ", ".join(f"{component} {time:g} s" for component, time in times.items())
        raise SystemDefinitionError(
            f"expected {name}: it is not given, and the FMUs suggest several: {listed}"
        )
    if not times and default is None:
        raise SystemDefinitionError(f"expected {name}: it is not given, and no FMU suggests one")
    return next(iter(times.values()), default or 0.0)
