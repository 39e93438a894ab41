"""The table [interface] of a base: data by which components are joined.

[interface]
required = [["plant.depth"], ["plant.voltage[1]", "plant.control_force"]]  # of each list, one has to be there
optional = ["plant.total_force"]                                        # what names these may be left out
instead = { "controller.demanded_force" = "controller.control_force" }  # stands for it where it is not there
between = { allocation = "ThrustAllocation" }                           # is there if an input needs it

[interface.inputs]                    # an input that nothing else drives takes the first source that is there
"controller.measured_depth" = ["plant.measured_depth", "plant.depth"]
"controller.roll" = [0.0]
"""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from fmus.fmi.description import start_value
from orchestration.errors import SystemDefinitionError
from orchestration.scenarios.components import Component, Describe
from orchestration.scenarios.layers import Data, Layer, driven_inputs, names_in
from orchestration.system.values import fmi_value


@dataclass(frozen=True)
class Interface:
    """The table of all layers in one; ports are "component.variable" by their names in the interface.

    layer: index of the lowest layer that has the table: its entries and those below are the interface's own
    """

    layer: int = -1
    required: Sequence[Sequence[str]] = ()
    optional: Mapping[str, int] = field(default_factory=dict)
    instead: Mapping[str, str] = field(default_factory=dict)
    between: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, Sequence[Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, layers: Sequence[Layer]) -> "Interface":
        """Returns the interface of layers: lists add up, of two entries for one name the upper one holds."""
        tables = [(i, x.data["interface"]) for i, x in enumerate(layers) if "interface" in x.data]
        joined: dict[str, dict[str, Any]] = {"instead": {}, "between": {}, "inputs": {}}
        for _, table in tables:
            joined = {key: entries | table.get(key, {}) for key, entries in joined.items()}
        optional = {name: i for i, table in tables for name in table.get("optional", [])}
        required = [names for _, table in tables for names in table.get("required", [])]
        return cls(tables[0][0] if tables else -1, required, optional, **joined)

    @cached_property
    def names(self) -> frozenset[str]:
        """All ports that the interface names."""
        tables = {key: getattr(self, key) for key in ("required", "optional", "instead", "inputs")}
        return frozenset(name for name in names_in(tables) if "." in name)

    @cached_property
    def components(self) -> frozenset[str]:
        """The components that the interface joins."""
        return frozenset(name.partition(".")[0] for name in self.names)


def output_of(source: Any) -> str:
    """Returns the output of a source of an input, "" of a constant and of a derivative."""
    return source.get("source", "") if isinstance(source, dict) else source if isinstance(source, str) else ""


class Joins:
    """The connections, constants and signals that an interface makes of components.

    parameters: "component.variable" -> all values that it may have in the scenario
    between: the components that may stand between those present
    """

    def __init__(
        self,
        interface: Interface,
        present: Mapping[str, Component],
        describe: Describe,
        parameters: Mapping[str, Sequence[Any]],
    ) -> None:
        between = {n: fmu for n, fmu in interface.between.items() if n not in present}
        self._interface, self._parameters = interface, parameters
        self.between = {name: Component(name, fmu, 0, (), describe) for name, fmu in between.items()}
        self._components = {**present, **self.between}

    def into(self, data: Data, layer: int, lost: Collection[str] | None = None) -> Data:
        """Returns the data with what joins the inputs that they do not drive.

        layer: index of the uppermost layer that the data have; names that layers above it give come later
        lost: inputs that lost what drove them, by the names of the data; None for all
        """
        driven = driven_inputs(data)
        result = {**data, "connections": [*data.get("connections", [])]}
        for table in ("components", "inputs", "signals"):
            result[table] = {**data.get(table, {})}
        for target in self._interface.inputs:
            written, component = self._written(target, layer), target.partition(".")[0]
            is_open = written not in driven if lost is None else written in lost
            if is_open and component not in self.between and self.has(target, "input"):
                self._join(target, result, layer)
        return result

    def _join(self, target: str, data: Data, layer: int) -> None:
        """Adds the first source of an input that is there."""
        written = self._written(target, layer)
        for source in self._interface.inputs[target]:
            if not self._holds(source):
                continue
            if isinstance(source, dict) and "derivative_of" in source:
                of = self._written(source["derivative_of"], layer)
                order = {"order": source["order"]} if "order" in source else {}
                data["signals"][written] = {"kind": "derivative", "of": of, **order}
            elif not (output := output_of(source)):
                data["inputs"][written] = source
            else:
                self._add(output.partition(".")[0], data, layer)
                data["connections"].append([self._written(output, layer), written])
            return

    def _add(self, component: str, data: Data, layer: int) -> None:
        """Adds a component that stands between others, with what drives it, if it is not there yet."""
        if component in self.between and component not in data["components"]:
            data["components"][component] = self.between[component].fmu
            for target in self._interface.inputs:
                if target.startswith(f"{component}."):
                    self._join(target, data, layer)

    def _written(self, name: str, layer: int) -> str:
        """Returns a name of the interface as the data of a layer have it."""
        component, own = self._own(name)
        is_renamed_above = component is None or (component.former and component.layer > layer)
        return name if is_renamed_above else f"{name.partition('.')[0]}.{own}"

    def _holds(self, source: Any) -> bool:
        """Whether a source is there, and its conditions hold."""
        output = output_of(source)
        if output and not self._is_joined(output):
            return False
        if not isinstance(source, dict):
            return True
        if "without" in source and self.has(source["without"]):
            return False
        if "where" in source and not self.has(source["where"]):
            return False
        return not any(self._keeps(name, value) for name, value in source.get("unless", {}).items())

    def _is_joined(self, output: str) -> bool:
        """Whether an output is there; of a component between others, whether its own inputs are joined."""
        component = output.partition(".")[0]
        if component not in self.between:
            return self.has(output, "output")
        inputs = self._interface.inputs.items()
        of_component = [sources for target, sources in inputs if target.startswith(f"{component}.")]
        return all(any(self._holds(source) for source in sources) for sources in of_component)

    def _keeps(self, name: str, value: Any) -> bool:
        """Whether a parameter is there and has a value in all runs of the scenario."""
        component, own = self._own(name)
        port = component and component.port(own)
        if not component or not port:
            return False
        given = self._parameters.get(name, self._parameters.get(f"{component.name}.{own}", ()))
        with suppress(SystemDefinitionError):  # of a wrong value, which is refused later
            values = [fmi_value(port, one) for one in given or [start_value(port.variable)]]
            return all(one == fmi_value(port, value) for one in values)
        return False

    def has(self, name: str, part: str = "signal") -> bool:
        """Whether a component has a variable, by its name in the interface."""
        component, own = self._own(name)
        return component is not None and component.has_part(own, part)

    def _own(self, name: str) -> tuple[Component | None, str]:
        """Returns the component of a name of the interface, and the variable of its FMU."""
        component, _, variable = name.partition(".")
        known = self._components.get(component)
        return known, known.names.get(variable, variable) if known else variable

    def names(self, component: Component) -> dict[str, str]:
        """Returns name in the interface -> variable that stands for it, of a component."""
        own = f"{component.name}."
        pairs = [(old, new) for old, new in self._interface.instead.items() if old.startswith(own)]
        instead = {old: self._own(new)[1] for old, new in pairs if self.has(new) and not self.has(old)}
        return {old.removeprefix(own): new for old, new in instead.items()} | component.names

    def lacking(self, component: Component) -> list[list[str]]:
        """Returns the required variables of a component of which none is there: lists of alternatives."""
        own = f"{component.name}."
        groups = [names for names in self._interface.required if all(name.startswith(own) for name in names)]
        groups = [names for names in groups if not any(map(self.has, names))]
        groups = [names for names in groups if not any({*names} < {*other} for other in groups)]
        return [[name.removeprefix(own) for name in names] for names in groups]

    def lacking_inputs(self, component: Component) -> list[str]:
        """Returns further inputs that a component lacks, and for which another one has an output."""
        required = {name for names in self._interface.required for name in names}
        own, inputs = f"{component.name}.", self._interface.inputs.items()
        lacking = [x for x in inputs if x[0].startswith(own) and not (x[0] in required or self.has(x[0]))]
        fed = [x for x, sources in lacking if any(output_of(one) and self._holds(one) for one in sources)]
        return [name.removeprefix(own) for name in fed]

    def joins(self, names: Sequence[str], component: Component, undriven: Collection[str]) -> bool:
        """Whether one of a component's variables would be an input, or drive one of the undriven inputs."""
        named = {f"{component.name}.{name}" for name in names}
        for target, sources in self._interface.inputs.items():
            other, own = self._own(target)
            is_open = other is not None and f"{other.name}.{own}" in undriven
            if target in named or (is_open and named & {*map(output_of, sources)}):
                return True
        return False

    def undriven(self, driven: Collection[str], component: Component) -> list[str]:
        """Returns the inputs of other components that the interface joins, and that nothing drives.

        driven: inputs, by the names of the FMUs
        """
        joined = [self._own(target) for target in self._interface.inputs]
        inputs = [f"{known.name}.{own}" for known, own in joined if known and known.has_part(own, "input")]
        others = (f"{component.name}.", *(f"{name}." for name in self.between))
        return [name for name in inputs if not name.startswith(others) and name not in driven]
