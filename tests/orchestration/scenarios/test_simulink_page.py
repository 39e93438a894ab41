"""The page for Simulink: its ports, connections and values are those of the scenario."""

import re
from pathlib import Path

import pytest

from fmus.fmi.description import describe, of_causality, start_value
from orchestration.scenarios import scenario
from orchestration.system.prepared_run import check_for
from orchestration.system.signals import Ramps
from orchestration.system.values import fmi_value

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "importing" / "simulink.md"


@pytest.fixture(scope="module")
def chosen() -> scenario.Scenario:
    return scenario.load(scenario.find("nominal-extended"))


def drivers_of(chosen: scenario.Scenario) -> dict[str, str]:
    """Returns "port, input" -> driver, for the inputs that are not 0, in the words of the page."""
    components, experiment = chosen.system.components, chosen.experiment
    ports = {
        (causality, f"{component}.{variable.name}"): f"`{component}/{number}`, `{variable.name}`"
        for component, path in components.items()
        for causality in ("input", "output")
        for number, variable in enumerate(of_causality(describe(path), causality), start=1)
    }
    drivers = {target: ports["output", source] for source, target, *_ in chosen.system.connections}
    drivers |= {name: f"Constant {value:g}" for name, value in experiment.inputs.items() if value}
    for name, signal in experiment.signals.items():
        assert isinstance(signal, Ramps)
        points = "; ".join(f"{time:g} {value:g}" for time, value in signal.points)
        drivers[name] = f"From Workspace `[{points}]`"
    return {port: drivers[n] for (kind, n), port in ports.items() if kind == "input" and n in drivers}


def settings_of(chosen: scenario.Scenario) -> list[str]:
    """Returns "`parameter` = number" of what the scenario sets to another value than the FMU's start."""
    checked = check_for(chosen.system, chosen.experiment)
    changed = []
    for name, value in chosen.experiment.parameters.items():
        number = fmi_value(checked.ports[name], value)
        if number != start_value(checked.ports[name].variable):
            changed.append(f"`{name.partition('.')[2]}` = {number:g}")
    return changed


@pytest.mark.usefixtures("scenario_fmus")
def test_ports_connections_and_values_are_those_of_the_scenario(chosen: scenario.Scenario) -> None:
    text = PAGE.read_text(encoding="utf-8")
    listed = re.findall(r"^\| (`\w+/\d+`) \| (`\S+`) \| (.+) \|$", text, re.MULTILINE)
    assert {f"{port}, {name}": driver for port, name, driver in listed} == drivers_of(chosen)
    assert re.findall(r"`\w+` = [\d.]+", text) == settings_of(chosen)
    assert f"until {chosen.experiment.stop_time:g} s" in text
    assert f"to {chosen.experiment.step_size:g}, and a fixed-step" in text
