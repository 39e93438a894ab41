"""A scenario as a MATLAB script that builds its closed loop in Simulink from the FMU files.

Names of the FMU block and its parameters: MathWorks, reference page of the FMU block (Simulink Extras).
"""

import re
from pathlib import Path
from shutil import copyfile

from fmus.fmi.description import of_causality, start_value
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import NUMBERS, FmiValue
from orchestration.errors import ScenarioError
from orchestration.exchange.limits import check_types, filled, prepare_plain, straight_points
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import Setting
from orchestration.system.system import CheckedSystem, Port

SCRIPT = "import_l1_depth"
_TARGET = "a Simulink model"
LONGEST_NAME = 55  # of a parameter of the FMU block, on that page


def text(scenario: Scenario) -> str:
    """Returns the script of a scenario.

    Raises ScenarioError for what it cannot express: more than `check_plain_exchange` allows, settings that
    are no numbers, signals that are no straight ramps, names that MATLAB cannot hold.
    """
    prepared, experiment = prepare_plain(scenario, _TARGET), scenario.experiment
    checked, settings = prepared.system, prepared.settings
    check_types([port for port, _ in settings], NUMBERS, _TARGET)
    _check_names(checked)
    drivers = [
        _drive(checked, port, "Constant", f"'Value', '{float(value)!r}'")
        for port, value in settings
        if port.variable.causality == "input"
    ]
    drivers += [
        _ramps(checked, name, straight_points(name, signal, experiment))
        for name, signal in experiment.signals.items()
    ]
    lines = [
        f"add_line(model, '{_block_port(checked, source)}', '{_block_port(checked, target)}', "
        "'autorouting', 'on');"
        for source, target in checked.connections
    ]
    shown = [checked.ports[name] for name in experiment.record]
    return filled(
        f"{SCRIPT}.m",
        model=_model_name(scenario.name),
        title=" ".join(scenario.title.split()),
        step=experiment.step_size,
        start=experiment.start_time,
        stop=experiment.stop_time,
        fmus="\n".join(_fmus(checked, settings, experiment.step_size)),
        drivers="\n".join(drivers),
        lines="\n".join(lines),
        scopes="\n".join(_scope(checked, port) for port in shown if port.variable.causality == "output"),
    )


def write(scenario: Scenario, folder: Path) -> Path:
    """Writes the script and the FMUs beside it; returns the script."""
    script = text(scenario)
    folder.mkdir(parents=True, exist_ok=True)
    for fmu in scenario.system.components.values():
        copyfile(fmu, folder / fmu.name)
    path = folder / f"{SCRIPT}.m"
    path.write_text(script, encoding="utf-8", newline="\n")
    return path


def _check_names(checked: CheckedSystem) -> None:
    for name in (*checked.components, *(path.name for path in checked.components.values())):
        if "'" in name:
            raise ScenarioError(f"{name}: expected a name without apostrophe, for MATLAB")
    for port in checked.ports.values():
        if len(port.variable.name) > LONGEST_NAME:
            raise ScenarioError(f"{port.name}: expected at most {LONGEST_NAME} characters, for Simulink")


def _model_name(name: str) -> str:
    """Returns an identifier of MATLAB, which holds 63 characters."""
    return ("l1_depth_" + re.sub(r"\W", "_", name, flags=re.ASCII))[:63]


def _fmus(checked: CheckedSystem, settings: tuple[Setting, ...], step_size: float) -> list[str]:
    lines = []
    for i, (name, path) in enumerate(checked.components.items()):
        count = [len(of_causality(checked.descriptions[name], c)) for c in ("input", "output")]
        left = 200 + 400 * i
        lines.append(
            f"add_fmu(model, '{name}', '{path.name}', '{step_size}', [{left} 40 {left + 240} 440], "
            f"{count[0]}, {count[1]});"
        )
        lines += [
            f"set_param([model '/{name}'], '{port.variable.name}', '{_value(port.variable, value)}');"
            for port, value in settings
            if port.component == name and port.variable.causality == "parameter"
            if value != start_value(port.variable)
        ]
    return lines


def _value(variable: ScalarVariable, value: FmiValue) -> str:
    if variable.type == "Boolean":
        return "on" if value else "off"
    return repr(float(value)) if variable.type == "Real" else str(int(value))


def _block_port(checked: CheckedSystem, port: Port) -> str:
    """Returns block and number of a port; ports have the order of the model description."""
    variables = of_causality(checked.descriptions[port.component], str(port.variable.causality))
    names = [variable.name for variable in variables]
    return f"{port.component}/{names.index(port.variable.name) + 1}"


def _block_name(port: Port) -> str:
    return port.name.replace(".", "_").replace("[", "_").replace("]", "")


def _drive(checked: CheckedSystem, port: Port, source: str, parameters: str) -> str:
    block = f"drive(model, '{_block_name(port)}', 'simulink/Sources/{source}', '{_block_port(checked, port)}'"
    return f"{block}, ...\n    {parameters});"


def _ramps(checked: CheckedSystem, name: str, points: list[tuple[float, float]]) -> str:
    table = "; ".join(f"{time!r} {value!r}" for time, value in points)
    interpolation = "'Interpolate', 'on', 'OutputAfterFinalValue', 'Holding final value'"
    parameters = f"'VariableName', '[{table}]', ...\n    {interpolation}"
    return _drive(checked, checked.ports[name], "From Workspace", parameters)


def _scope(checked: CheckedSystem, port: Port) -> str:
    return f"show(model, 'scope_{_block_name(port)}', '{_block_port(checked, port)}');"
