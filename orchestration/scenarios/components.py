"""The components of a scenario as it runs them: which FMU each has, since which layer, and by which names."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from fmus.errors import nearest
from fmus.fmi.model_description import ScalarVariable
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios.layers import Layer
from orchestration.system.prepared_run import has_start_value
from orchestration.system.system import Port
from orchestration.system.values import fmi_value

Describe = Callable[[str], Mapping[str, ScalarVariable]]
"""Block, or path of an FMU -> its variables by name."""


@dataclass(frozen=True)
class Component:
    """A component with its last FMU.

    fmu: "" if it is removed; layer: index of the one that gives it this FMU
    former: FMUs that it has in the layers below, the lowest first; none if no layer replaces one
    given_names: index of a layer -> the names that it gives: name below it -> variable of the FMU, "" for one
    that the FMU has not
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
        """The names by all layers from that of the FMU on."""
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
        """Refuses names for what nothing names, and for variables that the FMU has not.

        below: what the layers below and the interface name
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
