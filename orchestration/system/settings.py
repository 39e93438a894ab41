"""An experiment of the settings that a user gives: known names, and times that the FMUs suggest."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.fmi.description import describe
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

_ATTRIBUTES = {"start_time": "startTime", "stop_time": "stopTime", "step_size": "stepSize"}


def experiment_of(system: System, settings: Mapping[str, Any], others: Iterable[str] = ()) -> Experiment:
    """The experiment of these settings.

    Stop time (with the start time) and step size that are not given are those of the FMUs' default
    experiments.
    others: names that may be meant as well
    Raises SystemDefinitionError for an unknown name, and for a time that is not given and of which the FMUs
    suggest none, or several.
    """
    known = [each.name for each in fields(Experiment)]
    for name in settings:
        if name not in known:
            raise SystemDefinitionError(f"no setting {name!r}; {nearest(name, [*known, *others])}")
    times: dict[str, float] = {}
    if "stop_time" not in settings:
        times = {
            "start_time": _suggested(system, "start_time", 0.0),
            "stop_time": _suggested(system, "stop_time"),
        }
    if "step_size" not in settings:
        times["step_size"] = _suggested(system, "step_size")
    return Experiment(**{**times, **settings})


def _suggested(system: System, name: str, default: float | None = None) -> float:
    found = {}
    for component, path in system.components.items():
        experiment: Any = describe(path).defaultExperiment
        stated = getattr(experiment, _ATTRIBUTES[name], None)
        if stated is not None:
            found[component] = float(stated)
    if len(set(found.values())) > 1:
        several = ", ".join(f"{component} {value:g} s" for component, value in found.items())
        raise SystemDefinitionError(
            f"expected {name}: it is not given, and the FMUs suggest several: {several}"
        )
    if not found and default is None:
        raise SystemDefinitionError(f"expected {name}: it is not given, and no FMU suggests one")
    return next(iter(found.values()), default or 0.0)
