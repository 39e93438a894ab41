"""A scenario's signals as components: a system that is handed on without its scenario drives itself.

Each signal becomes an instance of the block `DepthReference`, named as the input that it drives.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmus.registry import Flavour, fmu_path
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.fmi.description import describe
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

SOURCE = "DepthReference"
_SPARE_S = 10.0  # between the points that are not needed


def with_sources(chosen: Scenario, flavour: Flavour = Flavour.NATIVE) -> tuple[System, Experiment]:
    """The scenario's system and experiment, every signal replaced by a component with its parameters.

    Raises ScenarioError for a signal that is no ramp.
    """
    components = dict(chosen.system.components)
    connections = list(chosen.system.connections)
    parameters = dict(chosen.experiment.parameters)
    for target, declared in chosen.resolved.get("signals", {}).items():
        name = target.partition(".")[2]
        if name in components:
            raise ScenarioError(f"signal {target}: expected no component of the name {name!r}")
        components[name] = fmu_path(SOURCE, flavour)
        connections.append((f"{name}.{_output(components[name])}", target))
        values = _ramp_parameters(declared, target, components[name])
        parameters |= {f"{name}.{variable}": value for variable, value in values.items()}
    giving = {target: source for source, target in connections}  # a signal is recorded where it is given
    record = tuple(giving.get(name, name) for name in chosen.experiment.record)
    experiment = replace(chosen.experiment, parameters=parameters, signals={}, record=record)
    return System(components, tuple(connections)), experiment


def _output(fmu: Path) -> str:
    (output,) = [v.name for v in describe(fmu).modelVariables if v.causality == "output"]
    return output


def straight_points(target: str, declared: Mapping[str, Any]) -> list[tuple[float, float]]:
    """(time [s], value) of a signal of straight ramps, as a table that is interpolated needs them.

    Raises OrchestrationError for another signal.
    """
    if declared["kind"] != "ramps" or declared.get("smooth"):
        raise OrchestrationError(f"signal {target}: expected straight ramps, the only ones a table gives")
    return [(float(t), float(value)) for t, value in declared["points"]]


def _ramp_parameters(declared: Mapping[str, Any], target: str, fmu: Path) -> dict[str, Any]:
    if declared["kind"] != "ramps":
        raise ScenarioError(
            f"signal {target}: expected kind = 'ramps', the only one that a block gives; "
            f"got {declared['kind']!r}"
        )
    points = [(float(t), float(value)) for t, value in declared["points"]]
    room = sum(v.name.startswith("point_time[") for v in describe(fmu).modelVariables)
    if len(points) > room:
        raise ScenarioError(f"signal {target}: expected at most {room} points, got {len(points)}")
    while len(points) < room:
        points.append((points[-1][0] + _SPARE_S, points[-1][1]))
    found: dict[str, Any] = {"smooth": True} if declared.get("smooth") else {}
    for i, (t, value) in enumerate(points, start=1):
        found |= {f"point_time[{i}]": t, f"point_depth[{i}]": value}
    return found
