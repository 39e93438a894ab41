"""A scenario as a Modelica package: a block for each FMU, and the system of them.

A block calls its FMU through an external object (modelica_fmu.h). Its outputs depend on the inputs of
the communication point before, so the system has no algebraic equation, as in the master's Jacobi.
The package needs the Modelica Standard Library 4, and the unpacked FMUs in its folder Resources.
"""

import json
from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter
from importlib import resources
from pathlib import Path

from fmus.files import extract_archive
from fmus.fmi.description import describe, of_causality, start_value
from fmus.fmi.model_description import ModelDescription, ScalarVariable
from fmus.fmi.variable_types import NUMBERS, TRANSFER_TYPE, FmiValue
from fmus.platforms import FMPY
from orchestration.errors import ScenarioError
from orchestration.exchange.limits import check_types, filled, prepare_plain, straight_points
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import PreparedRun, Setting
from orchestration.system.system import CheckedSystem

PACKAGE = "L1Depth"
SYSTEM = "System"
_TARGET = "a Modelica package"
_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_CLASSES = ("FMU", "startFMU", "stepFMU")  # the same in every package


def texts(scenario: Scenario) -> dict[str, str]:
    """Returns the Modelica text of a scenario for each path inside the package's folder.

    Raises ScenarioError for what the package cannot express: more than `check_plain_exchange` allows, inputs
    and outputs that are not Real, parameters of text, signals that are no straight ramps, a loop of initial
    values.
    """
    prepared = prepare_plain(scenario, _TARGET)
    checked, experiment = prepared.system, scenario.experiment
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
    """Writes the package with its C headers and FMUs to `folder/L1Depth`; returns its package.mo."""
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
    """Returns the model of the components, their connections and the signals."""
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
    """Returns modifiers of parameters and inputs of a component; an element without value keeps its start."""
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
    """Returns the components with a connected output whose initial value follows a connected input.

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


def block(name: str, description: ModelDescription, step_size: float) -> str:
    """Returns the text of the block of an FMU, whose inputs and outputs are Real, its parameters numbers."""
    parameters, inputs, outputs = (of_causality(description, c) for c in ("parameter", "input", "output"))
    arguments = {}
    for kind in ("Real", "Integer", "Boolean"):
        of_kind = [variable for variable in parameters if TRANSFER_TYPE[variable.type] == kind]
        arguments[f"{kind.lower()}_references"] = _references(of_kind)
        arguments[f"{kind.lower()}s"] = _array([_argument(variable) for variable in of_kind], kind)
    declarations = [_parameter(vector, scalars) for vector, scalars in vectors(parameters).items()]
    for kind, variables in (("RealInput", inputs), ("RealOutput", outputs)):
        declarations += [_connector(kind, vector, scalars) for vector, scalars in vectors(variables).items()]
    return filled(
        "block.mo",
        name=name,
        description=quoted(description.description or name),
        step=step_size,
        declarations="\n".join(declarations),
        inputs=_array([variable.name for variable in inputs]),
        starts=_array([number(variable, start_value(variable)) for variable in inputs]),
        n_inputs=len(inputs),
        n_outputs=len(outputs),
        input_references=_references(inputs),
        output_references=_references(outputs),
        outputs="\n".join(f"  {v.name} = y[{i}];" for i, v in enumerate(outputs, start=1)),
        **arguments,
    )


def vectors(variables: Iterable[ScalarVariable]) -> dict[str, list[ScalarVariable]]:
    """Returns name without subscript -> its scalars, row by row.

    Modelica has `voltage[2]` where FMI has `voltage[1]` and [2], `a[2, 2]` where FMI has `a[1,1]` to [2,2].
    """
    scalars: dict[str, list[ScalarVariable]] = {}
    for variable in variables:
        scalars.setdefault(vector_name(variable.name), []).append(variable)
    return scalars


def vector_name(name: str) -> str:
    """Returns the name without its subscript."""
    return name.partition("[")[0]


def quoted(text: str) -> str:
    """Returns a Modelica string."""
    return json.dumps(text, ensure_ascii=False)


def number(variable: ScalarVariable, value: FmiValue) -> str:
    """Returns a value as Modelica writes one of the variable's type."""
    if variable.type == "Boolean":
        return "true" if str(value).lower() in ("true", "1") else "false"
    return repr(float(value)) if variable.type == "Real" else str(int(value))


def value(scalars: list[ScalarVariable], given: Mapping[str, str] = {}) -> str:
    """Returns the value of a scalar, or of every element of an array; the start value where none is given."""
    elements = [given.get(variable.name) or number(variable, start_value(variable)) for variable in scalars]
    return _rows(scalars, elements) if _is_array(scalars) else elements[0]


def _array(elements: list[str], kind: str = "Real") -> str:
    """Returns {a, b}, or an array of the type without elements."""
    return f"{{{', '.join(elements)}}}" if elements else f"fill({'0.0' if kind == 'Real' else '0'}, 0)"


def _argument(variable: ScalarVariable) -> str:
    return f"if {variable.name} then 1 else 0" if variable.type == "Boolean" else variable.name


def _references(variables: Iterable[ScalarVariable]) -> str:
    return _array([str(variable.valueReference) for variable in variables], "Integer")


def _is_array(scalars: list[ScalarVariable]) -> bool:
    return "[" in scalars[0].name


def _columns(scalars: list[ScalarVariable]) -> int:
    """Returns the number of columns of a matrix; 0 for a vector."""
    return sum("[1," in variable.name for variable in scalars)


def _rows(scalars: list[ScalarVariable], elements: list[str]) -> str:
    """Returns {a, b} for a vector, {{a, b}, {c, d}} for a matrix."""
    columns = _columns(scalars)
    rows = (
        [_array(elements[i : i + columns]) for i in range(0, len(elements), columns)] if columns else elements
    )
    return _array(rows)


def _parameter(name: str, scalars: list[ScalarVariable]) -> str:
    first, prefix = scalars[0], "each " if _is_array(scalars) else ""
    limits = {"min": first.min, "max": first.max}
    modifiers = [
        f"{prefix}{name} = {number(first, limit)}" for name, limit in limits.items() if limit is not None
    ]
    comment = first.description or name
    items = first.declaredType.items if first.declaredType is not None else None
    if items:
        modifiers += [f"{prefix}min = 1", f"{prefix}max = {len(items)}"]
        comment += ": " + ", ".join(f"{item.value} {item.name}" for item in items)
    declared = _declared(name, scalars, modifiers)
    return f"  parameter {TRANSFER_TYPE[first.type]} {declared} = {value(scalars)} {quoted(comment)};"


def _connector(kind: str, name: str, scalars: list[ScalarVariable]) -> str:
    comment = quoted(scalars[0].description or name)
    return f"  Modelica.Blocks.Interfaces.{kind} {_declared(name, scalars, [])} {comment};"


def _declared(name: str, scalars: list[ScalarVariable], modifiers: list[str]) -> str:
    """Returns the name with its size and its modifiers, the unit first."""
    columns = _columns(scalars)
    shape = f"{len(scalars) // columns}, {columns}" if columns else str(len(scalars))
    size = f"[{shape}]" if _is_array(scalars) else ""
    modifiers = _unit_modifier(scalars) + modifiers
    return f"{name}{size}({', '.join(modifiers)})" if modifiers else f"{name}{size}"


def _unit_modifier(scalars: list[ScalarVariable]) -> list[str]:
    first = scalars[0]
    if first.type != "Real" or not first.unit:
        return []
    units = [json.dumps(variable.unit or "1") for variable in scalars]
    if len(set(units)) > 1:
        return [f"unit = {_rows(scalars, units)}"]
    return [f"{'each ' if _is_array(scalars) else ''}unit = {units[0]}"]


def identifier(description: ModelDescription) -> str:
    """Returns the name of the FMU's library, which is that of its block; ScenarioError if it is no name."""
    name = description.coSimulation.modelIdentifier if description.coSimulation else ""
    if not (name.isascii() and name.isidentifier()):
        raise ScenarioError(f"{description.modelName}: modelIdentifier {name!r}: expected a C identifier")
    return name
