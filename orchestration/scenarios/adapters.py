"""What joins another FMU to a scenario: names that stand for others, and entries for some FMUs only.

[mapping.controller]            entries of the layers below that name controller.depth_reference
depth_reference = "setpoint"    mean controller.setpoint

[[when_replaced]]               further entries of a base, if another FMU in the place of its controller
component = "controller"        has one variable and lacks another
has = ["control_force"]
lacks = ["voltage[1]"]

[[when_set]]                    further entries of a base, if a parameter has one of these values
parameter = "controller.reference_feedforward"
values = ["inside", "outside"]
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from fmus.errors import nearest
from orchestration.errors import ScenarioError
from orchestration.scenarios.layers import Data, Layer, source_of
from orchestration.scenarios.replaced import Replacement
from orchestration.scenarios.toml_file import KeyPath

_CONDITIONS = ("component", "has", "lacks", "parameter", "values")
_OWN = ("mapping", "when_replaced")  # tables of this module, which a resolved scenario has not

Mappings = list[dict[str, str]]
"""For each layer: "component.variable" of the layers below -> the name that stands for it."""


def mappings(layers: Sequence[Layer], replaced: Mapping[str, Replacement]) -> Mappings:
    """The mappings of each layer that are of the component's last FMU."""
    result: Mappings = []
    for index, layer in enumerate(layers):
        names: dict[str, str] = {}
        for component, table in layer.data.get("mapping", {}).items():
            replacement = replaced.get(component)
            if replacement is None or replacement.layer <= index:
                _check_mapping(component, table, layers[:index], replacement, layer)
                names |= {f"{component}.{old}": f"{component}.{new}" for old, new in table.items()}
        result.append(names)
    return result


def _check_mapping(
    component: str,
    table: Mapping[str, str],
    below: Sequence[Layer],
    replaced: Replacement | None,
    layer: Layer,
) -> None:
    known = {f"{component}.{name}" for lower in below for name in _variables(lower.data, component)}
    for old, new in table.items():
        where = f"{layer.at(('mapping', component, old))}: mapping.{component}: "
        name = f"{component}.{old}"
        if name not in known:
            raise ScenarioError(f"{where}nothing names {name}; {nearest(name, known)}")
        if replaced is not None and new not in replaced.ports:
            raise ScenarioError(f"{where}{component} has no variable {new!r}; {nearest(new, replaced.ports)}")


def _variables(value: Any, component: str) -> Iterator[str]:
    """Names of variables of a component, wherever a layer has them."""
    if isinstance(value, dict):
        if value.get("component") == component:
            yield from (*value.get("has", []), *value.get("lacks", []))
        for key, item in value.items():
            yield from _variables(key, component)
            yield from _variables(item, component)
    elif isinstance(value, list):
        for item in value:
            yield from _variables(item, component)
    elif isinstance(value, str) and value.startswith(f"{component}."):
        yield value.removeprefix(f"{component}.")


def adapted(layers: Sequence[Layer], replaced: Mapping[str, Replacement], names: Mappings) -> list[Layer]:
    """The layers with their entries for the replaced components, and with the names that stand for others.

    Entries are a layer of their own above that which has them, so that they join what it inherits.
    """
    result: list[Layer] = []
    fmus: dict[str, Any] = {}  # of the layers so far
    for index, layer in enumerate(layers):
        fmus |= layer.data.get("components", {})
        above: dict[str, str] = {}
        for mapping in names[index + 1 :]:
            above |= mapping
        own = {key: value for key, value in layer.data.items() if key not in _OWN}
        result.append(_renamed(layer, own, above))
        for number, entries in enumerate(layer.data.get("when_replaced", [])):
            component = entries["component"]
            replacement = replaced.get(component)
            is_other = replacement and replacement.layer > index and replacement.fmu != fmus.get(component)
            if replacement and is_other and _applies(entries, replacement, above):
                where = layer.at(("when_replaced", number, "connections"))
                has_record = any(lower.data.get("record") for lower in result)
                result.append(_renamed(layer, _joining(entries, has_record, where), above))
    return result


def with_chosen_entries(layers: Sequence[Layer]) -> list[Layer]:
    """The layers with their entries for a value that a parameter has, or that a sweep may give it.

    Parameters of such entries are no condition of others. ScenarioError for entries of a parameter that a
    sweep varies, other than signals: they would be those of all its samples.
    """
    parameters: Data = {}
    for layer in layers:
        parameters |= layer.data.get("parameters", {})
    vary: Data = {}
    for layer in layers:
        vary |= layer.data.get("sweep", {}).get("vary", {})
    varied = {name for name, values in vary.items() if values is not False}
    result: list[Layer] = []
    for layer in layers:
        result.append(replace(layer, data={k: v for k, v in layer.data.items() if k != "when_set"}))
        for number, entries in enumerate(layer.data.get("when_set", [])):
            name = entries["parameter"]
            others = sorted(entries.keys() - {"parameter", "values", "signals"})
            if name in varied and others:
                raise ScenarioError(
                    f"{layer.at(('when_set', number))}: when_set: the sweep varies {name}: expected signals "
                    f"alone, got {', '.join(others)}, which would be those of all samples"
                )
            if name in varied or parameters.get(name) in entries["values"]:
                where = layer.at(("when_set", number, "connections"))
                has_record = any(lower.data.get("record") for lower in result)
                result.append(replace(layer, data=_joining(entries, has_record, where)))
    return result


def _applies(entries: Data, replaced: Replacement, names: Mapping[str, str]) -> bool:
    def is_there(variable: str) -> bool:
        name = f"{replaced.component}.{variable}"
        return names.get(name, name).removeprefix(f"{replaced.component}.") in replaced.ports

    return all(map(is_there, entries.get("has", []))) and not any(map(is_there, entries.get("lacks", [])))


def _joining(entries: Data, has_record: bool, where: str) -> Data:
    """Entries as a layer that joins those below: lists as tables, but for a record where there is none.

    where: begins the ScenarioError about two connections to one input
    """
    joining = {key: value for key, value in entries.items() if key not in _CONDITIONS}
    if "connections" in joining:
        table: Data = {}
        for source, target, *transformation in joining["connections"]:
            if target in table:
                raise ScenarioError(
                    f"{where}: {source_of(table[target])} and {source} are connected to "
                    f"{target}: expected one connection to an input"
                )
            table[target] = {"source": source, **transformation[0]} if transformation else source
        joining["connections"] = table
    if has_record and "record" in joining:
        joining["record"] = dict.fromkeys(joining["record"], True)
    return joining


def _renamed(layer: Layer, data: Data, names: Mapping[str, str]) -> Layer:
    """The layer with these data, and other names of variables; ScenarioError for one with two values."""
    renamed = _with_names(data, names, layer)
    if isinstance(renamed.get("record"), list):
        renamed["record"] = list(dict.fromkeys(renamed["record"]))
    return replace(layer, data=renamed)


def _with_names(value: Any, names: Mapping[str, str], layer: Layer, keys: KeyPath = ()) -> Any:
    """The value with other names of variables, as keys and as texts; keys: where the layer has it."""
    if isinstance(value, dict):
        result: Data = {}
        old_names: dict[str, str] = {}
        for key, item in value.items():
            name, renamed = names.get(key, key), _with_names(item, names, layer, (*keys, key))
            if name in result and result[name] != renamed:
                raise ScenarioError(
                    f"{layer.at((*keys, key))}: {'.'.join(map(str, keys))}: {old_names[name]} and {key} both "
                    f"stand for {name}: expected one value, got {result[name]!r} and {renamed!r}"
                )
            result[name], old_names[name] = renamed, key
        return result
    if isinstance(value, list):
        return [_with_names(item, names, layer, (*keys, index)) for index, item in enumerate(value)]
    return names.get(value, value) if isinstance(value, str) else value
