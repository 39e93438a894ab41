"""The live page: a scenario that runs in the browser, with sliders for its values."""

import base64
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from fmus.errors import nearest
from fmus.fmi.description import start_value
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.report.web_program import program
from orchestration.results.metric_units import metric_units, shown
from orchestration.results.metrics import SIGNALS
from orchestration.results.page import packed, page
from orchestration.results.panels import panels_of
from orchestration.scenarios import free_parameter
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.vehicle import PLANT, description_file, description_of
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.quantities import Conversion, in_unit_of
from orchestration.system.system import Port
from orchestration.system.values import value_range

_TEMPLATE = Path(__file__).parent / "files" / "live.html"
_CONTROLLER = "controller"  # the component whose parameters are gains
_METRICS = ("settling_time", "rmse")  # functions of metrics that live.js has
_SPAN = 4.0  # of a gain: from a fourth of its value to four times its value
# Descriptions of vehicles vary no disturbances. The thrusters of the paper's vehicle can hold these.
_DISTURBANCES = {"external_force": (-1.0, 1.0), "current_velocity": (-0.1, 0.1)}


def live_page(runs: Mapping[str, Scenario], sliders: Sequence[str] = ()) -> str:
    """Returns a self-contained HTML page that makes these runs in the browser, with sliders for values.

    runs: label -> scenario; they differ in values of parameters and constant inputs alone
    sliders: NAME or NAME=LOW:HIGH, in addition to `default_sliders`
    Raises ScenarioError for other runs and for a slider that does not fit, and the errors of `program`.
    """
    first, *others = runs.values()
    prepared = first.prepared
    for other in others:
        _check_differs_in_values(first, other)
    asked = free_parameter.parse(sliders, "--slider")
    chosen = list(_with_limits(prepared, [*asked, *default_sliders(first)]))
    values = [{p.name: value for p, value in run.prepared.initial_settings} for run in runs.values()]
    names = [*dict.fromkeys(n for own in [*values, *(s.variables for s in chosen)] for n in own)]
    ports = [prepared.system.ports[name] for name in names]
    settings = [(port, _value(values[0], port)) for port in ports]
    groups: dict[str, list[FreeParameter]] = {}
    for slider in chosen:
        groups.setdefault(slider.name.partition(".")[0], []).append(slider)
    scored = {call.get(key) for call in first.metrics.values() for key in SIGNALS}
    signal_units = {name: prepared.system.ports[name].variable.unit or "" for name in prepared.recorded}
    metrics = _metrics_data(first, signal_units)
    return page(
        _TEMPLATE,
        ("live.js",),
        title=first.title,
        groups=groups,
        ports=prepared.system.ports,
        overridden=_overridden(prepared, chosen),
        metrics=metrics,
        data={
            "program": base64.b64encode(zlib.compress(program(prepared, settings), 9)).decode("ascii"),
            "points": packed(prepared.points),
            "signals": packed(prepared.signal_values),
            "columns": [
                {
                    "name": name,
                    "shown": name in scored or not scored & {*prepared.recorded},
                    "isSignal": name in first.experiment.signals,
                }
                for name in prepared.recorded
            ],
            "panels": [*map(asdict, panels_of(signal_units))],
            "metrics": metrics,
            "runs": [
                {"label": label, "values": [float(_value(own, port)) for port in ports]}
                for label, own in zip(runs, values, strict=True)
            ],
            "sliders": [_slider_data(s, names) for s in chosen],
        },
    )


def default_sliders(scenario: Scenario) -> Iterator[FreeParameter]:
    """Yields the gains of the scenario, the variations of the vehicle's description, and disturbances."""
    prepared, settable = scenario.prepared, _settable(scenario.prepared)
    ranges: dict[str, tuple[float, float]] = {}
    variables: dict[str, tuple[str, ...]] = {}
    for name in scenario.experiment.parameters:
        value = settable.get(name)
        if name.startswith(f"{_CONTROLLER}.") and not name.endswith(".internal_step") and value:
            low, high = sorted((value / _SPAN, value * _SPAN))
            ranges[name] = low, high
    if PLANT in scenario.system.components:
        description = description_of(description_file(str(scenario.system.components[PLANT])))
        for key, varied in description.vary.items():
            name = f"{PLANT}.{key}"
            variables[name] = tuple(varied["variables"])
            port = prepared.system.ports.get(variables[name][0])
            change = in_unit_of(port.variable, varied.get("unit", "")) if port else Conversion()
            ranges[name] = change(varied.get("low", -math.inf)), change(varied.get("high", math.inf))
        ranges |= {f"{PLANT}.{key}": limits for key, limits in _DISTURBANCES.items()}
    for name, (low, high) in ranges.items():
        own = variables.get(name, (name,))
        if len({settable.get(variable) for variable in own}) == 1 and own[0] in settable:
            least, most = value_range(prepared.system.ports[own[0]])
            yield FreeParameter(name, max(low, least), min(high, most), variables=own)


def _metrics_data(scenario: Scenario, signal_units: Mapping[str, str]) -> list[dict[str, Any]]:
    """Returns the settling times and RMSEs of recorded signals, which the page computes for its runs."""
    units = metric_units(scenario.metrics, signal_units)
    return [
        {"name": name, "in_unit": units[name], "absent": shown(math.nan, call), **call}
        for name, call in scenario.metrics.items()
        if call["function"] in _METRICS and {call[key] for key in SIGNALS if key in call} <= {*signal_units}
    ]


def _overridden(prepared: PreparedRun, sliders: Sequence[FreeParameter]) -> dict[str, str]:
    """Returns slider -> a note, for each slider whose variable an event sets."""
    times: dict[str, float] = {}
    for point, settings in sorted(prepared.changes.items()):
        for port, _ in settings:
            times.setdefault(port.name, prepared.points[point])
    return {
        slider.name: f"until {min(times[name] for name in names):g} s, then an event sets it"
        for slider in sliders
        if (names := [name for name in slider.variables if name in times])
    }


def _check_differs_in_values(first: Scenario, other: Scenario) -> None:
    experiments = [repr(replace(x.experiment, parameters={}, inputs={})) for x in (first, other)]
    if first.system != other.system or experiments[0] != experiments[1]:
        raise ScenarioError(
            f"{other.title} beside {first.title}: expected the same system and experiment but for values of "
            "parameters and constant inputs"
        )


def _with_limits(prepared: PreparedRun, sliders: Sequence[FreeParameter]) -> Iterator[FreeParameter]:
    """Yields the sliders with units and finite limits; a variable of an earlier slider has no second one."""
    settable, taken = _settable(prepared), set[str]()
    for slider in sliders:
        variables = slider.variables or (slider.name,)
        if taken & {*variables}:
            continue
        taken |= {*variables}
        if variables[0] not in settable:
            expected = (
                f"expected a parameter or a constant input of type Real; {nearest(slider.name, settable)}"
            )
            raise ScenarioError(f"--slider {slider.name}: {expected}")
        port, value = prepared.system.ports[variables[0]], settable[variables[0]]
        low, high = value_range(port)
        around = min(value, 0.0) * 2.0, max(value, 0.0) * 2.0 or 1.0
        low = slider.low if math.isfinite(slider.low) else max(low, around[0])
        high = slider.high if math.isfinite(slider.high) else min(high, around[1])
        limited = replace(slider, low=low, high=high, variables=variables).within(port.variable, "--slider")
        # The range includes the value of the scenario, where the slider begins.
        yield replace(limited, low=min(limited.low, value), high=max(limited.high, value), start=value)


def _settable(prepared: PreparedRun) -> dict[str, float]:
    """Returns the values of Real parameters and constant inputs, by name."""
    given = {port.name: value for port, value in prepared.settings}
    return {
        name: float(_value(given, port))
        for name, port in prepared.system.ports.items()
        if port.variable.type == "Real" and (port.variable.causality == "parameter" or name in given)
    }


def _value(values: Mapping[str, FmiValue], port: Port) -> Any:
    return values.get(port.name, start_value(port.variable))


def _slider_data(slider: FreeParameter, names: Sequence[str]) -> dict[str, Any]:
    indices = [names.index(name) for name in slider.variables]
    limits = {"low": slider.low, "high": slider.high, "isLogarithmic": slider.is_logarithmic}
    return {"name": slider.name, "value": slider.start, "indices": indices, **limits}
