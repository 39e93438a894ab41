"""The Modelica block that calls an FMU: its parameters, connectors and external object."""

import json
from collections.abc import Iterable

from fmpy.model_description import ModelDescription, ScalarVariable

from fmus.fmi_types import TRANSFER_TYPE, FmiValue
from orchestration.errors import ScenarioError
from orchestration.exchange import modelica_templates
from orchestration.fmi.description import of_causality, start_value

_EMPTY = {"Real": "fill(0.0, 0)", "Integer": "fill(0, 0)", "Boolean": "fill(0, 0)"}


def block(package: str, name: str, description: ModelDescription, step_size: float) -> str:
    """The text of the block of an FMU, whose inputs and outputs are Real and whose parameters are numbers."""
    parameters, inputs, outputs = (of_causality(description, c) for c in ("parameter", "input", "output"))
    arguments = {}
    for kind in ("Real", "Integer", "Boolean"):
        of_kind = [variable for variable in parameters if TRANSFER_TYPE[variable.type] == kind]
        arguments[f"{kind.lower()}_references"] = _references(of_kind)
        arguments[f"{kind.lower()}s"] = array([_argument(variable) for variable in of_kind], kind)
    declarations = [_parameter(name, scalars) for name, scalars in vectors(parameters).items()]
    for kind, variables in (("RealInput", inputs), ("RealOutput", outputs)):
        declarations += [_connector(kind, name, scalars) for name, scalars in vectors(variables).items()]
    return modelica_templates.BLOCK.format(
        package=package,
        name=name,
        description=quoted(description.description or name),
        step=step_size,
        declarations="\n".join(declarations),
        inputs=array([variable.name for variable in inputs], "Real"),
        starts=array([number(variable, start_value(variable)) for variable in inputs], "Real"),
        n_inputs=len(inputs),
        n_outputs=len(outputs),
        input_references=_references(inputs),
        output_references=_references(outputs),
        outputs="\n".join(f"  {v.name} = y[{i}];" for i, v in enumerate(outputs, start=1)),
        **arguments,
    )


def vectors(variables: Iterable[ScalarVariable]) -> dict[str, list[ScalarVariable]]:
    """Name without subscript -> its scalars: Modelica has `voltage[2]` where FMI has `voltage[1]` and [2]."""
    scalars: dict[str, list[ScalarVariable]] = {}
    for variable in variables:
        scalars.setdefault(vector_name(variable.name), []).append(variable)
    return scalars


def vector_name(name: str) -> str:
    """The name without its subscript."""
    return name.partition("[")[0]


def quoted(text: str) -> str:
    """A Modelica string."""
    return json.dumps(text, ensure_ascii=False)


def array(elements: list[str], kind: str) -> str:
    """{a, b}, or an array of the type without elements."""
    return "{" + ", ".join(elements) + "}" if elements else _EMPTY[kind]


def number(variable: ScalarVariable, value: FmiValue) -> str:
    """A value as Modelica writes one of the variable's type."""
    if variable.type == "Boolean":
        return "true" if str(value).lower() in ("true", "1") else "false"
    return repr(float(value)) if variable.type == "Real" else str(int(value))


def _argument(variable: ScalarVariable) -> str:
    return f"if {variable.name} then 1 else 0" if variable.type == "Boolean" else variable.name


def _references(variables: Iterable[ScalarVariable]) -> str:
    return array([str(variable.valueReference) for variable in variables], "Integer")


def _parameter(name: str, scalars: list[ScalarVariable]) -> str:
    first, is_vector = scalars[0], "[" in scalars[0].name
    kind = TRANSFER_TYPE[first.type]
    each = "each " if is_vector else ""
    modifiers = _unit_modifier(scalars)
    modifiers += [
        f"{each}{limit} = {number(first, value)}"
        for limit, value in (("min", first.min), ("max", first.max))
        if value is not None
    ]
    comment = first.description or name
    items = first.declaredType.items if first.declaredType is not None else None
    if items:
        modifiers += [f"{each}min = 1", f"{each}max = {len(items)}"]
        comment += ": " + ", ".join(f"{item.value} {item.name}" for item in items)
    starts = [number(variable, start_value(variable)) for variable in scalars]
    start = array(starts, kind) if is_vector else starts[0]
    return f"  parameter {kind} {name}{_size(scalars)}{_in_brackets(modifiers)} = {start} {quoted(comment)};"


def _connector(kind: str, name: str, scalars: list[ScalarVariable]) -> str:
    modifiers, comment = _in_brackets(_unit_modifier(scalars)), quoted(scalars[0].description or name)
    return f"  Modelica.Blocks.Interfaces.{kind} {name}{_size(scalars)}{modifiers} {comment};"


def _unit_modifier(scalars: list[ScalarVariable]) -> list[str]:
    first = scalars[0]
    if first.type != "Real" or not first.unit:
        return []
    units = [json.dumps(variable.unit or "1") for variable in scalars]
    if len(set(units)) > 1:
        return [f"unit = {{{', '.join(units)}}}"]
    return [f"{'each ' if '[' in first.name else ''}unit = {units[0]}"]


def _size(scalars: list[ScalarVariable]) -> str:
    return f"[{len(scalars)}]" if "[" in scalars[0].name else ""


def _in_brackets(modifiers: list[str]) -> str:
    return f"({', '.join(modifiers)})" if modifiers else ""


def identifier(description: ModelDescription) -> str:
    """The name of the FMU's library, which is that of its block; ScenarioError without co-simulation."""
    if description.coSimulation is None:
        raise ScenarioError(f"{description.modelName}: expected an FMU for co-simulation")
    return str(description.coSimulation.modelIdentifier)
