"""A scenario as a Modelica package: a block for each FMU, and the closed loop of them.

A block calls its FMU through an external object (c/modelica_fmu.h). Its outputs depend on the inputs of
the communication point before, so the loop has no algebraic equation, as in the master's Jacobi.
The package needs the Modelica Standard Library 4, and the unpacked FMUs in its folder Resources.
"""

import json
import zipfile
from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter
from importlib import resources
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import ModelDescription, ScalarVariable

from orchestration.errors import OrchestrationError
from orchestration.exchange import modelica_templates
from orchestration.exchange.arrays import arrays, base, of_causality, start_value
from orchestration.exchange.signal_sources import straight_points
from orchestration.fmi.description import describe
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import CheckedSystem

PACKAGE = "L1Depth"
LOOP = "DepthControl"
_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_KINDS = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean"}


def texts(chosen: Scenario) -> dict[str, str]:
    """Path inside the package's folder -> Modelica text, of a scenario.

    Raises OrchestrationError for what the package cannot express: `Experiment.beyond_the_plain_loop`, inputs
    and outputs that are not Real, signals that are no straight ramps, a loop of initial values.
    """
    experiment = chosen.experiment
    prepared = prepare(chosen.system, experiment)
    checked = prepared.system
    special = experiment.beyond_the_plain_loop()
    if special:
        raise OrchestrationError(f"a Modelica package with {special}: expected none, it cannot carry them")
    blocks = {_identifier(d): d for d in checked.descriptions.values()}
    constant = {
        "FMU": modelica_templates.FMU,
        "startFMU": modelica_templates.START,
        "stepFMU": modelica_templates.STEP,
    }
    found = {
        "package.mo": modelica_templates.PACKAGE.format(package=PACKAGE, title=_quoted(chosen.title)),
        "package.order": "".join(f"{name}\n" for name in (LOOP, *blocks, *constant)),
        f"{LOOP}.mo": _loop(chosen, prepared),
    }
    found |= {f"{name}.mo": _block(name, each, experiment.step_size) for name, each in blocks.items()}
    return found | {f"{name}.mo": text.replace("{package}", PACKAGE) for name, text in constant.items()}


def write(chosen: Scenario, folder: Path) -> Path:
    """Write the package with its C headers and FMUs to `folder/L1Depth`; returns its package.mo."""
    root, written = folder / PACKAGE, texts(chosen)
    include = root / "Resources" / "Include"
    include.mkdir(parents=True, exist_ok=True)
    for path, text in written.items():
        (root / path).write_text(text, encoding="utf-8", newline="\n")
    own = resources.files("orchestration.exchange")
    sources = [own / "modelica_fmu.h", own / "load.h"]
    for source in sources + [resources.files(fmpy) / "c-code" / name for name in _HEADERS]:
        (include / source.name).write_bytes(source.read_bytes())
    for fmu in chosen.system.components.values():
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(root / "Resources" / "FMUs" / _identifier(describe(fmu)))
    return root / "package.mo"


def _identifier(description: ModelDescription) -> str:
    if description.coSimulation is None:
        raise OrchestrationError(f"{description.modelName}: expected an FMU for co-simulation")
    return str(description.coSimulation.modelIdentifier)


def _block(name: str, description: ModelDescription, step: float) -> str:
    given, inputs, outputs = (of_causality(description, c) for c in ("parameter", "input", "output"))
    for v in inputs + outputs:
        if v.type != "Real":
            raise OrchestrationError(
                f"{name}.{v.name}: expected an input or output of type Real, got {v.type}"
            )
    of_type = {kind: [v for v in given if _KINDS[v.type] == kind] for kind in ("Real", "Integer", "Boolean")}
    values = {}
    for kind, variables in of_type.items():
        values[f"{kind.lower()}_references"] = _references(variables)
        values[f"{kind.lower()}s"] = _array([_argument(v) for v in variables], kind)
    declarations = [_declaration(n, vs, "parameter ", _KINDS[vs[0].type]) for n, vs in arrays(given).items()]
    for kind, variables in (("Input", inputs), ("Output", outputs)):
        connector = f"Modelica.Blocks.Interfaces.Real{kind}"
        declarations += [_declaration(n, vs, "", connector) for n, vs in arrays(variables).items()]
    return modelica_templates.BLOCK.format(
        package=PACKAGE,
        name=name,
        description=_quoted(description.description or name),
        step=step,
        declarations="\n".join(declarations),
        inputs=_array([v.name for v in inputs], "Real"),
        starts=_array([_number(v, start_value(v)) for v in inputs], "Real"),
        n_inputs=len(inputs),
        n_outputs=len(outputs),
        input_references=_references(inputs),
        output_references=_references(outputs),
        outputs="\n".join(f"  {v.name} = y[{i}];" for i, v in enumerate(outputs, start=1)),
        **values,
    )


def _argument(variable: ScalarVariable) -> str:
    return f"if {variable.name} then 1 else 0" if variable.type == "Boolean" else variable.name


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _references(variables: Iterable[ScalarVariable]) -> str:
    return _array([str(v.valueReference) for v in variables], "Integer")


def _array(elements: list[str], kind: str) -> str:
    """{a, b}, or a zero-length array of the type."""
    empty = {"Real": "fill(0.0, 0)", "Integer": "fill(0, 0)", "Boolean": "fill(0, 0)"}[kind]
    return "{" + ", ".join(elements) + "}" if elements else empty


def _number(variable: ScalarVariable, value: Any) -> str:
    if variable.type == "Boolean":
        return "true" if str(value).lower() in ("true", "1") else "false"
    return repr(float(value)) if variable.type == "Real" else str(int(value))


def _declaration(name: str, scalars: list[ScalarVariable], prefix: str, kind: str) -> str:
    first, vector = scalars[0], "[" in scalars[0].name
    each = "each " if vector else ""
    modifiers = []
    if first.type == "Real" and first.unit:
        units = [json.dumps(v.unit or "1") for v in scalars]
        same = len(set(units)) == 1
        modifiers.append(f"{each}unit = {units[0]}" if same else f"unit = {{{', '.join(units)}}}")
    items = first.declaredType.items if first.declaredType is not None else None
    modifiers += [
        f"{each}{limit} = {_number(first, value)}"
        for limit, value in (("min", first.min), ("max", first.max))
        if value is not None and prefix
    ]
    text = first.description or name
    if items:
        modifiers += [f"{each}min = 1", f"{each}max = {len(items)}"]
        text += ": " + ", ".join(f"{item.value} {item.name}" for item in items)
    subscript = f"[{len(scalars)}]" if vector else ""
    starts = [_number(v, start_value(v)) for v in scalars] if prefix else []
    value = f" = {_array(starts, kind) if vector else starts[0]}" if prefix else ""
    inside = f"({', '.join(modifiers)})" if modifiers else ""
    return f"  {prefix}{kind} {name}{subscript}{inside}{value} {_quoted(text)};"


def _loop(chosen: Scenario, prepared: PreparedRun) -> str:
    experiment, checked = chosen.experiment, prepared.system
    modifiers: dict[str, dict[str, dict[str, str]]] = {name: {} for name in checked.components}
    for port, value in prepared.settings:
        scalars = modifiers[port.component].setdefault(base(port.variable.name), {})
        scalars[port.variable.name] = _number(port.variable, value)
    follow = _followers(checked)
    lines = []
    for component, description in checked.descriptions.items():
        given = [f"communicationStep = {experiment.step_size}", f"startTime = {experiment.start_time}"]
        given += ["initialOutputsFollowInputs = true"] * (component in follow)
        given += [f"{n} = {_whole(description, n, values)}" for n, values in modifiers[component].items()]
        inside = ",\n    ".join(given)
        lines.append(f"  {_identifier(description)} {component}(\n    {inside});")
    equations = [f"  connect({source.name}, {target.name});" for source, target in checked.connections]
    for target, declared in chosen.resolved["signals"].items():
        name = base(target.partition(".")[2])
        lines.append(_ramps(name, target, declared))
        equations.append(f"  connect({name}.y[1], {target});")
    return modelica_templates.LOOP.format(
        package=PACKAGE, loop=LOOP, title=_quoted(chosen.title), components="\n".join(lines),
        equations="\n".join(equations), start=experiment.start_time, stop=experiment.stop_time,
        step=experiment.step_size,
    )  # fmt: skip


def _whole(description: ModelDescription, name: str, values: Mapping[str, str]) -> str:
    """The value of a scalar, or of every element of a vector: what is not given keeps its start value."""
    scalars = [v for v in description.modelVariables if base(v.name) == name]
    texts = [values.get(v.name, _number(v, start_value(v))) for v in scalars]
    return _array(texts, "Real") if "[" in scalars[0].name else texts[0]


def _ramps(name: str, target: str, declared: Mapping[str, Any]) -> str:
    table = "; ".join(f"{t!r}, {value!r}" for t, value in straight_points(target, declared))
    return (
        f"  Modelica.Blocks.Sources.CombiTimeTable {name}(\n    table = [{table}],\n"
        "    extrapolation = Modelica.Blocks.Types.Extrapolation.HoldLastPoint);"
    )


def _followers(checked: CheckedSystem) -> set[str]:
    """Components whose initial outputs that are passed on follow inputs that are connected."""
    fed = {target.name: source.component for source, target in checked.connections}
    needs: dict[str, set[str]] = {name: set() for name in checked.components}
    for source, _ in checked.connections:
        if any(name in fed for name in checked.initial_dependencies(source)):
            needs[source.component] |= {fed[n] for n in fed if n.startswith(f"{source.component}.")}
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as error:
        raise OrchestrationError(
            "the initial values form a loop: expected one that a pass settles"
        ) from error
    return {name for name, sources in needs.items() if sources}
