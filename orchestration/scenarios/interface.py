"""The components of a scenario, and the table [interface] of a base, by which they are joined.

[interface]
required = [["plant.depth"], ["plant.voltage[1]", "plant.control_force"]]  # of each list, one has to be there
optional = ["plant.total_force"]                                        # what names these may be left out
instead = { "controller.demanded_force" = "controller.control_force" }  # stands for it where it is not there
between = { allocation = "ThrustAllocation" }                           # is there if an input needs it

[interface.inputs]                    # an input that nothing else drives takes the first source that is there
"controller.measured_depth" = ["plant.measured_depth", "plant.depth"]
"controller.roll" = [0.0]
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from fmus.errors import nearest
from fmus.fmi.description import has_start_value, start_value
from fmus.fmi.model_description import ScalarVariable
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios.layers import Data, Layer, driven_inputs, names_in
from orchestration.system.system import Port
from orchestration.system.values import fmi_value

Describe = Callable[[str], Mapping[str, ScalarVariable]]
"""Block, or path of an FMU -> its variables by name."""


@dataclass(frozen=True)
class Component:
    """A component with its last FMU.

    fmu: "" if it is removed; layer: index of the one that gives it this FMU
    former: FMUs in the layers below, the lowest first; empty if no layer replaces one
    given_names: index of a layer -> the names that it gives: name below it -> variable of the FMU, ""
    for one that the FMU lacks
    """

    name: str
    fmu: str
    layer: int
    former: tuple[str, ...]
    describe: Describe = field(repr=False)
    given_names: Mapping[int, Mapping[str, str]] = field(default_factory=dict)

    @cached_property
    def variables(self) -> Mapping[str, ScalarVariable]:
        """The variables of its FMU; FmuLoadError if it cannot be described."""
        return self.describe(self.fmu) if self.fmu else {}

    @cached_property
    def names(self) -> dict[str, str]:
        """The names by all layers, from the FMU's own layer upwards."""
        return {name: own for names in self.given_names.values() for name, own in names.items()}

    @cached_property
    def former_names(self) -> frozenset[str]:
        """The variables of the FMUs that this one replaces."""
        return frozenset(name for fmu in self.former if fmu for name in self.describe(fmu))

    def port(self, variable: str) -> Port | None:
        """Returns the port of a variable, by the FMU's name, None if the FMU lacks it."""
        own = self.variables.get(variable)
        return own and Port(self.name, own)

    def has_part(self, variable: str, part: str, value: Any = None) -> bool:
        """Whether the FMU's variable can have a part in a scenario, and takes the value if one is given.

        part: "input" or "output"; "start" of what has a start value, "setting" of what can be set, "change"
        of what can be set during a run; "signal" of any variable
        """
        port = self.port(variable)
        if port is None:
            return False
        own = port.variable
        is_settable = own.causality in ("parameter", "input")
        parts = {
            "start": has_start_value(own),
            "setting": is_settable,
            "change": is_settable and own.variability != "fixed",
            "signal": True,
        }
        with suppress(SystemDefinitionError):
            has_part = parts.get(part, own.causality == part)
            return has_part and (value is None or value is False or fmi_value(port, value) is not None)
        return False

    def check_names(self, names: Mapping[str, str], below: Collection[str]) -> None:
        """Refuses names that nothing uses, and variables that the FMU lacks.

        below: names in the layers below and in the interface
        """
        for name, own in names.items():
            keys = ("components", self.name, "names", name)
            if f"{self.name}.{name}" not in below and name not in self.former_names:
                known = sorted(one for one in below if one.startswith(f"{self.name}."))
                hint = nearest(f"{self.name}.{name}", known)
                message = f"names of {self.name}: nothing names {self.name}.{name}; {hint}"
                raise ScenarioError(message, keys, keys[:-1])
            if own and own not in self.variables:
                hint = nearest(own, self.variables)
                message = f"names of {self.name}: {self.name} has no variable {own!r}; {hint}"
                raise ScenarioError(message, keys, keys[:-1])


def components(layers: Sequence[Layer], describe: Describe) -> dict[str, Component]:
    """Returns the components by name, as the uppermost layer has them; FMUs are described when asked for."""
    fmus: dict[str, list[tuple[int, str]]] = {}
    for index, layer in enumerate(layers):
        for name, fmu in layer.data.get("components", {}).items():
            given = fmus.setdefault(name, [])
            if not given or given[-1][1] != (fmu or ""):
                given.append((index, fmu or ""))
    named = {name for layer in layers for name in layer.data.get("names", {})}
    for name in named - fmus.keys():
        message = f"names of {name}: no component {name!r}; {nearest(name, fmus)}"
        raise ScenarioError(message, ("components", name))
    result: dict[str, Component] = {}
    for name, given in fmus.items():
        layer, fmu = given[-1]
        names = {i: x.data["names"][name] for i, x in enumerate(layers) if name in x.data.get("names", {})}
        names = {i: one for i, one in names.items() if i >= layer}
        result[name] = Component(name, fmu, layer, tuple(old for _, old in given[:-1]), describe, names)
    return result


def components_between(layers: Sequence[Layer]) -> dict[str, str]:
    """Returns the components that may stand between the layers' components -> their blocks."""
    tables = (layer.data.get("interface", {}).get("between", {}) for layer in layers)
    return {name: fmu for table in tables for name, fmu in table.items()}


class Interface:
    """The interface of all layers, and the components that it joins; ports are named as the interface does.

    present: the components of the layers, and those that may stand between them
    layer: index of the lowest layer that has the table: its entries and those below are the interface's own
    optional: port -> index of the uppermost layer that lists it; inputs: input -> its sources
    """

    def __init__(self, layers: Sequence[Layer], describe: Describe) -> None:
        tables = [(i, x.data["interface"]) for i, x in enumerate(layers) if "interface" in x.data]
        self.layer = tables[0][0] if tables else -1
        self.optional = {name: i for i, table in tables for name in table.get("optional", [])}
        self.required: list[list[str]] = [x for _, table in tables for x in table.get("required", [])]
        self._instead: dict[str, str] = {}
        self.inputs: dict[str, list[Any]] = {}
        for _, table in tables:
            self._instead |= table.get("instead", {})
            self.inputs |= table.get("inputs", {})
        given = components(layers, describe)
        between = {name: fmu for name, fmu in components_between(layers).items() if name not in given}
        self._between = {name: Component(name, fmu, 0, (), describe) for name, fmu in between.items()}
        self.present = {**given, **self._between}
        for name in sorted(self.names):
            if (component := name.partition(".")[0]) not in self.present:
                hint = nearest(component, self.present)
                raise ScenarioError(f"interface: no component {component!r} for {name!r}; {hint}", name)

    @cached_property
    def names(self) -> frozenset[str]:
        """All ports that the interface names."""
        tables = [*self.optional, *self.required, self._instead, self.inputs]
        return frozenset(name for name in names_in(tables) if "." in name)

    @cached_property
    def components(self) -> frozenset[str]:
        """The components that the interface names."""
        return frozenset(name.partition(".")[0] for name in self.names)

    def own_names(self, component: Component) -> dict[str, str]:
        """Returns name in the interface -> variable that stands for it, of a component."""
        pairs = [(old, new) for old, new in self._instead.items() if old.startswith(f"{component.name}.")]
        instead = {old: self._own(new) for old, new in pairs if self.has(new) and not self.has(old)}
        return {
            old.partition(".")[2]: new.partition(".")[2] for old, new in instead.items()
        } | component.names

    def joined(self, data: Data) -> Data:
        """Returns the data of all layers with what joins the inputs that they neither drive nor remove."""
        driven = driven_inputs(data) | {*data.get("removed", [])}
        result = {key: value for key, value in data.items() if key != "removed"}
        result["connections"] = [*data.get("connections", [])]
        for table in ("components", "inputs", "signals"):
            result[table] = {**data.get(table, {})}
        for target in self.inputs:
            if self._own(target) not in driven and not self._is_between(target):
                self._join(target, result)
        return result

    def recorded(self, names: Sequence[str]) -> list[str]:
        """Returns the names of a record of the interface's own layer, without ports that are not there."""
        return [x for x in names if x not in self.names or x in self._instead or self.has(x)]

    def _join(self, target: str, data: Data) -> None:
        """Adds the first source that is there of an input that is."""
        sources = self.inputs[target] if self.has(target, "input") else []
        for source in (source for source in sources if self._holds(source, data)):
            if isinstance(source, dict) and "derivative_of" in source:
                order = {"order": source["order"]} if "order" in source else {}
                of = self._own(source["derivative_of"])
                data["signals"][self._own(target)] = {"kind": "derivative", "of": of, **order}
            elif output := output_of(source):
                self._add(output.partition(".")[0], data)
                data["connections"].append([self._own(output), self._own(target)])
            else:
                data["inputs"][self._own(target)] = source
            return

    def _add(self, component: str, data: Data) -> None:
        """Adds a component that stands between others, with what drives it, if it is not there yet."""
        if component in self._between and component not in data["components"]:
            data["components"][component] = self._between[component].fmu
            for target in self._inputs_of(component):
                self._join(target, data)

    def _holds(self, source: Any, data: Data, behind: tuple[str, ...] = ()) -> bool:
        """Whether a source is there, and its conditions hold; behind: components that it would feed."""
        output = output_of(source)
        if output and not self._gives(output, data, behind):
            return False
        if not isinstance(source, dict):
            return True
        if "without" in source and self.has(source["without"]):
            return False
        if "where" in source and not self.has(source["where"]):
            return False
        return not any(self._keeps(name, value, data) for name, value in source.get("unless", {}).items())

    def _gives(self, output: str, data: Data, behind: tuple[str, ...]) -> bool:
        """Whether an output is there; of a component between others, whether its own inputs have sources."""
        component = output.partition(".")[0]
        if not self._is_between(output) or component in behind:
            return self.has(output, "output") and component not in behind
        inputs = [self.inputs[name] for name in self._inputs_of(component)]
        behind = (*behind, component)
        return all(any(self._holds(source, data, behind) for source in sources) for sources in inputs)

    def _keeps(self, name: str, value: Any, data: Data) -> bool:
        """Whether a parameter is there and has a value in all runs of the scenario."""
        port = self.port(self._own(name))
        if not port:
            return False
        varied = data.get("sweep", {}).get("vary", {}).get(port.name)
        values = varied.get("values") if isinstance(varied, dict) else []
        if values is None:
            return False
        values = [data.get("parameters", {}).get(port.name, start_value(port.variable)), *values]
        with suppress(SystemDefinitionError):
            # a wrong value is refused later, with its line
            return all(fmi_value(port, one) == fmi_value(port, value) for one in values)
        return False

    def port(self, name: str) -> Port | None:
        """Returns the port of "component.variable", by the name of its FMU, or None."""
        component, _, variable = name.partition(".")
        own = self.present.get(component)
        return own and own.port(variable)

    def has(self, name: str, part: str = "signal") -> bool:
        """Whether a component has a variable that can have a part: see `Component.has_part`."""
        component, _, own = self._own(name).partition(".")
        return component in self.present and self.present[component].has_part(own, part)

    def _own(self, name: str) -> str:
        """Returns a port by the name of its FMU."""
        component, _, variable = name.partition(".")
        names = self.present[component].names if component in self.present else {}
        return f"{component}.{names.get(variable, variable)}"

    def _is_between(self, name: str) -> bool:
        return name.partition(".")[0] in self._between

    def _inputs_of(self, component: str) -> list[str]:
        return [name for name in self.inputs if name.startswith(f"{component}.")]

    def lacking(self, component: Component) -> list[list[str]]:
        """Returns the required variables of a component of which none is there: lists of alternatives."""
        own = f"{component.name}."
        groups = [names for names in self.required if all(name.startswith(own) for name in names)]
        groups = [names for names in groups if not any(map(self.has, names))]
        groups = [names for names in groups if not any({*names} < {*other} for other in groups)]
        return [[name.removeprefix(own) for name in names] for names in groups]

    def lacking_inputs(self, component: Component) -> list[str]:
        """Returns further inputs that a component lacks, and for which another one has an output."""
        required = {name for names in self.required for name in names}
        lacking = [x for x in self._inputs_of(component.name) if not (x in required or self.has(x))]
        fed = [x for x in lacking if any(output_of(one) and self._holds(one, {}) for one in self.inputs[x])]
        return [name.partition(".")[2] for name in fed]

    def joins(self, names: Sequence[str], component: Component, undriven: Collection[str]) -> bool:
        """Whether one of a component's variables would be an input, or drive one of the undriven inputs."""
        named = {f"{component.name}.{name}" for name in names}
        sources = [x for target, given in self.inputs.items() if self._own(target) in undriven for x in given]
        return bool(named & {*self.inputs, *map(output_of, sources)})

    def undriven(self, driven: Collection[str], component: Component) -> list[str]:
        """Returns the inputs of other components that the interface joins, and that nothing drives.

        driven: inputs, by the names of the FMUs
        """
        others = [name for name in self.inputs if not self._is_between(name) and self.has(name, "input")]
        inputs = [name for name in map(self._own, others) if name not in driven]
        return [name for name in inputs if not name.startswith(f"{component.name}.")]


def output_of(source: Any) -> str:
    """Returns the output of a source of an input, "" of a constant and of a derivative."""
    return source.get("source", "") if isinstance(source, dict) else source if isinstance(source, str) else ""
