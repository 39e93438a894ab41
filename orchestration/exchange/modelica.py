"""A scenario as a Modelica package: a block for each FMU, and the system of them.

A block calls its FMU through an external object (modelica_fmu.h). Its outputs depend on the inputs of
the communication point before, so the system has no algebraic equation, as in the master's Jacobi.
The package needs the Modelica Standard Library 4, and the unpacked FMUs in its folder Resources.
"""

from graphlib import CycleError, TopologicalSorter
from importlib import resources
from pathlib import Path

from fmus.files import extract_archive
from fmus.fmi.description import describe
from fmus.fmi.model_description import ModelDescription
from fmus.fmi.variable_types import NUMBERS
from fmus.platforms import FMPY
from orchestration.errors import ScenarioError
from orchestration.exchange.limits import (
    check_plain_connections,
    check_plain_exchange,
    check_types,
    straight_points,
)
from orchestration.exchange.modelica_blocks import (
    block,
    identifier,
    number,
    quoted,
    value,
    vector_name,
    vectors,
)
from orchestration.exchange.template_files import filled
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import PreparedRun, Setting, prepare
from orchestration.system.system import CheckedSystem

PACKAGE = "L1Depth"
SYSTEM = "System"
_TARGET = "a Modelica package"
_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_CLASSES = ("FMU", "startFMU", "stepFMU")  # the same in every package


def texts(scenario: Scenario) -> dict[str, str]:
    """Path inside the package's folder -> Modelica text, of a scenario.

    Raises ScenarioError for what the package cannot express: more than `check_plain_exchange` allows, inputs
    and outputs that are not Real, parameters of text, signals that are no straight ramps, a loop of initial
    values.
    """
    experiment = scenario.experiment
    check_plain_exchange(experiment, _TARGET)
    prepared = prepare(scenario.system, experiment)
    checked = prepared.system
    check_plain_connections(checked, _TARGET)
    ports = checked.ports.values()
    check_types([p for p in ports if p.variable.causality in ("input", "output")], ("Real",), _TARGET)
    check_types([p for p in ports if p.variable.causality == "parameter"], NUMBERS, _TARGET)
    blocks = {identifier(description): description for description in checked.descriptions.values()}
    files = {
        "package.mo": filled("package.mo", title=quoted(scenario.title)),
        "package.order": "".join(f"{name}\n" for name in (SYSTEM, *blocks, *_CLASSES)),
        f"{SYSTEM}.mo": _system(scenario.title, prepared),
    }
    files |= {f"{name}.mo": block(name, fmu, experiment.step_size) for name, fmu in blocks.items()}
    return files | {f"{name}.mo": filled(f"{name}.mo") for name in _CLASSES}


def write(scenario: Scenario, folder: Path) -> Path:
    """Write the package with its C headers and FMUs to `folder/L1Depth`; returns its package.mo."""
    root, files = folder / PACKAGE, texts(scenario)
    include = root / "Resources" / "Include"
    include.mkdir(parents=True, exist_ok=True)
    for path, text in files.items():
        (root / path).write_text(text, encoding="utf-8", newline="\n")
    own = resources.files("orchestration.exchange")
    sources = [own / "modelica_fmu.h", own / "load.h"]
    for source in sources + [FMPY / "c-code" / name for name in _HEADERS]:
        (include / source.name).write_bytes(source.read_bytes())
    for fmu in scenario.system.components.values():
        extract_archive(fmu, root / "Resources" / "FMUs" / identifier(describe(fmu)))
    return root / "package.mo"


def _system(title: str, prepared: PreparedRun) -> str:
    """The model of the components, their connections and the signals."""
    checked, experiment = prepared.system, prepared.experiment
    following = _components_that_follow(checked)
    components = []
    for component, description in checked.descriptions.items():
        modifiers = [f"communicationStep = {experiment.step_size}", f"startTime = {experiment.start_time}"]
        modifiers += ["initialOutputsFollowInputs = true"] * (component in following)
        modifiers += _settings(component, description, prepared.settings)
        instance = f"  {identifier(description)} {component}"
        components.append(f"{instance}(\n    {f',{chr(10)}    '.join(modifiers)});")
    equations = [f"  connect({source.name}, {target.name});" for source, target in checked.connections]
    for target, signal in experiment.signals.items():
        name = vector_name(target.partition(".")[2])
        components.append(_table(name, straight_points(target, signal, experiment)))
        equations.append(f"  connect({name}.y[1], {target});")
    return filled(
        f"{SYSTEM}.mo", title=quoted(title), components="\n".join(components),
        equations="\n".join(equations), start=experiment.start_time, stop=experiment.stop_time,
        step=experiment.step_size,
    )  # fmt: skip


def _settings(component: str, description: ModelDescription, settings: tuple[Setting, ...]) -> list[str]:
    """Modifiers of a component's parameters and inputs; an element without value keeps its start."""
    own = [(port.variable, setting) for port, setting in settings if port.component == component]
    given = {variable.name: number(variable, setting) for variable, setting in own}
    declared = vectors(description.modelVariables)
    return [f"{name} = {value(declared[name], given)}" for name in vectors(v for v, _ in own)]


def _table(name: str, points: list[tuple[float, float]]) -> str:
    table = "; ".join(f"{time!r}, {value!r}" for time, value in points)
    return (
        f"  Modelica.Blocks.Sources.CombiTimeTable {name}(\n    table = [{table}],\n"
        "    extrapolation = Modelica.Blocks.Types.Extrapolation.HoldLastPoint);"
    )


def _components_that_follow(checked: CheckedSystem) -> set[str]:
    """Components with a connected output whose initial value follows a connected input.

    Raises ScenarioError if they form a loop.
    """
    sources = {target.name: source.component for source, target in checked.connections}
    needed: dict[str, set[str]] = {name: set() for name in checked.components}
    for source, _ in checked.connections:
        if any(name in sources for name in checked.initial_dependencies(source)):
            inputs = [name for name in sources if name.startswith(f"{source.component}.")]
            needed[source.component] |= {sources[name] for name in inputs}
    try:
        TopologicalSorter(needed).prepare()
    except CycleError as error:
        raise ScenarioError(
            f"{_TARGET} with a loop of initial values: expected values that one pass gives"
        ) from error
    return {name for name, components in needed.items() if components}
