"""Adapters of another FMU to a scenario: names that stand for others, and entries for some FMUs only.

[mapping.controller]            entries of the layers below that name controller.depth_reference
depth_reference = "setpoint"    mean controller.setpoint

[[when_replaced]]               further entries of a base, if another FMU in the place of its controller
component = "controller"        has one variable and lacks another, its own or a component.variable
has = ["control_force"]
lacks = ["voltage[1]", "plant.control_force"]

[[when_set]]                    further entries of a base, if a parameter has one of these values
parameter = "controller.reference_feedforward"
values = ["inside", "outside"]
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from fmus.errors import nearest
from orchestration.errors import ScenarioError
from orchestration.scenarios.layers import Data, Layer, components_of
from orchestration.scenarios.replaced import Describe, Replacement
from orchestration.scenarios.toml_file import KeyPath

_CONDITIONS = ("component", "has", "lacks", "parameter", "values")


def adapted(layers: Sequence[Layer], replaced: Mapping[str, Replacement], describe: Describe) -> list[Layer]:
    """Returns the layers with names that stand for others, each below its entries for replaced components."""
    _check_optional(layers)
    names = [_mapping(layers, index, replaced, describe) for index in range(len(layers))]
    above = [dict(item for x in names[index + 1 :] for item in x.items()) for index in range(len(layers))]
    fmus = components_of(layers)

    def applies(index: int, entry: Layer) -> bool:
        component = entry.data["component"]
        new = replaced.get(component)
        if (
            new is None
            or not new.fmu
            or new.layer <= index
            or new.fmu == components_of(layers[: index + 1]).get(component)
        ):
            return False
        return all(has(v, component, index) for v in entry.data.get("has", [])) and not any(
            has(v, component, index) for v in entry.data.get("lacks", [])
        )

    def has(variable: str, component: str, index: int) -> bool:
        """Whether the FMU of a component has a variable, by the name that a layer has for it."""
        name = variable if variable.partition(".")[0] in fmus else f"{component}.{variable}"
        owner, _, own = above[index].get(name, name).partition(".")
        return own in describe(fmus[owner])

    renamed = [_renamed(layer, above[index]) for index, layer in enumerate(layers)]
    return _with_entries(renamed, "when_replaced", applies)


def with_chosen_entries(layers: Sequence[Layer]) -> list[Layer]:
    """Returns the layers with their entries for a value that a parameter has, or that a sweep may give it.

    Parameters of such entries are no condition of others. ScenarioError for entries of a parameter that a
    sweep varies, other than signals: they would be those of all its samples.
    """
    parameters: Data = {}
    vary: Data = {}
    for layer in layers:
        parameters |= layer.data.get("parameters", {})
        vary |= layer.data.get("sweep", {}).get("vary", {})
    varied = {name for name, values in vary.items() if values is not False}

    def applies(index: int, entry: Layer) -> bool:
        name = entry.data["parameter"]
        others = sorted(entry.data.keys() - {"parameter", "values", "signals"})
        if name in varied and others:
            raise ScenarioError(
                f"{entry.at(())}: when_set: the sweep varies {name}: expected signals alone, got "
                f"{', '.join(others)}, which would be those of all samples"
            )
        return name in varied or parameters.get(name) in entry.data["values"]

    return _with_entries(layers, "when_set", applies)


def _with_entries(layers: Sequence[Layer], table: str, applies: Callable[[int, Layer], bool]) -> list[Layer]:
    """Returns the layers, each below those of its entries in a table that apply, without the table."""
    result: list[Layer] = []
    for index, layer in enumerate(layers):
        result.append(replace(layer, data={k: v for k, v in layer.data.items() if k != table}))
        for number, entries in enumerate(layer.data.get(table, [])):
            if applies(index, Layer(entries, layer.files, (table, number))):
                data = {key: value for key, value in entries.items() if key not in _CONDITIONS}
                result.append(Layer(data, layer.files, (table, number)))
    return result


def _check_optional(layers: Sequence[Layer]) -> None:
    parts = [part for x in layers for part in (x.data, *x.data.get("when_replaced", []))]
    known = {component for part in parts for component in part.get("components", {})}
    for layer in layers:
        for name in layer.data.get("optional", {}).keys() - known:
            where = layer.at(("optional", name))
            raise ScenarioError(f"{where}: optional.{name}: no component {name!r}; {nearest(name, known)}")


def _mapping(
    layers: Sequence[Layer], index: int, replaced: Mapping[str, Replacement], describe: Describe
) -> dict[str, str]:
    """Returns "component.variable" -> the name that stands for it, by one layer for those below.

    A mapping is of the last FMU of a component that stands in its layer or below. It may give names for
    variables of the replaced FMU that the layers do not name, so that one mapping serves many scenarios.
    """
    layer, names = layers[index], dict[str, str]()
    below = {name for lower in layers[:index] for name in names_in(lower.data)}
    for component, table in layer.data.get("mapping", {}).items():
        replacement = replaced.get(component)
        if replacement and replacement.layer > index:
            continue
        known = {name for name in below if name.startswith(f"{component}.")}
        for old, new in table.items():
            where, name = (
                f"{layer.at(('mapping', component, old))}: mapping.{component}",
                f"{component}.{old}",
            )
            if name not in known and not (
                replacement and old in describe(components_of(layers[:1])[component])
            ):
                raise ScenarioError(f"{where}: nothing names {name}; {nearest(name, known)}")
            if replacement and new not in replacement.ports:
                hint = nearest(new, replacement.ports)
                raise ScenarioError(f"{where}: {component} has no variable {new!r}; {hint}")
            names[name] = f"{component}.{new}"
    return names


def _variables(layers: Sequence[Layer], component: str, describe: Describe) -> Collection[str]:
    """Returns the variables of the FMU that the lowest layer has for a component."""
    fmus = (layer.data.get("components", {}).get(component) for layer in layers)
    return describe(next(fmu for fmu in fmus if fmu))


def names_in(value: Any) -> Iterator[str]:
    """Yields the keys and the texts of a layer."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from value
        value = list(value.values())
    for item in value if isinstance(value, list) else ():
        yield from names_in(item)


def _renamed(layer: Layer, names: Mapping[str, str]) -> Layer:
    """Returns the layer with other names of variables; ScenarioError for one with two values."""
    data = _with_names({k: v for k, v in layer.data.items() if k != "mapping"}, names, layer)
    if isinstance(data.get("record"), list):
        data["record"] = list(dict.fromkeys(data["record"]))
    return replace(layer, data=data)


def _with_names(value: Any, names: Mapping[str, str], layer: Layer, keys: KeyPath = ()) -> Any:
    """Returns the value with other names of variables, as keys and as texts; keys: where the layer has it."""
    if isinstance(value, list):
        return [_with_names(item, names, layer, (*keys, index)) for index, item in enumerate(value)]
    if not isinstance(value, dict):
        return names.get(value, value) if isinstance(value, str) else value
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
