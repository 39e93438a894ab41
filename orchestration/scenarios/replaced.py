"""Components that a layer of a scenario replaces by another FMU: what they inherit, and what is dropped.

Entries of the layers below that name a variable of the replaced component stay if the new FMU has a variable
of that name which can take their part; the others are dropped, and named. Entries of the layer that replaces
the component, and of those above it, are its own: they stay as they are, and a wrong one is an error.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmus.fmi.model_description import ModelDescription
from orchestration.errors import ScenarioError, ScenarioWarning
from orchestration.scenarios.layers import Data, Layer
from orchestration.system.system import Port

Describe = Callable[[str], ModelDescription]
"""Block, or path of an FMU -> its model description."""


@dataclass(frozen=True)
class Replacement:
    """A component whose FMU a layer replaces.

    fmu: "" if it is removed; layer: its index; ports: variable -> port of the new FMU
    dropped: kind of entry -> names; kept: parameters that the new FMU has too -> value
    """

    component: str
    fmu: str
    layer: int
    ports: Mapping[str, Port]
    dropped: dict[str, list[str]] = field(default_factory=dict)
    kept: dict[str, Any] = field(default_factory=dict)

    def warn(self, parameters: Mapping[str, Any]) -> None:
        """Name in one warning what was dropped, and the parameters that were kept.

        parameters: of the scenario; one that a layer above gives is not the inherited one.
        """
        parts = []
        if self.dropped:
            listed = "; ".join(f"{kind} {', '.join(names)}" for kind, names in self.dropped.items())
            parts.append(f"dropped{', as it lacks them' if self.fmu else ''}: {listed}")
        kept = [f"{name} = {value!r}" for name, value in self.kept.items() if parameters.get(name) == value]
        if kept:
            parts.append(f"kept, as it has them: parameters {', '.join(kept)}")
        if parts:
            state = f"is {Path(self.fmu).name}" if self.fmu else "is removed"
            warnings.warn("; ".join([f"{self.component} {state}", *parts]), ScenarioWarning, stacklevel=4)

    def lost_inputs(self) -> list[str]:
        """The inputs that a connection or a signal drives, and the new FMU has not."""
        targets = (shown.partition(" -> ")[2] for shown in self.dropped.get("connections", []))
        names = (*targets, *self.dropped.get("signals", []))
        return [name for name in names if name.startswith(f"{self.component}.")]

    def names(self, causality: str) -> list[str]:
        """The variables of the new FMU that have this causality."""
        return [name for name, port in self.ports.items() if port.variable.causality == causality]


def replacements(layers: Sequence[Layer], describe: Describe) -> dict[str, Replacement]:
    """The components whose FMU is not that of the layer which gave them first, by name."""
    fmus: dict[str, Any] = {}
    changed: dict[str, int] = {}
    for index, layer in enumerate(layers):
        for component, fmu in layer.data.get("components", {}).items():
            if fmus.get(component, fmu) != fmu:
                changed[component] = index
            fmus[component] = fmu
    return {
        component: Replacement(
            component, fmus[component] or "", index, _ports(component, fmus[component], describe)
        )
        for component, index in changed.items()
    }


def _ports(component: str, fmu: Any, describe: Describe) -> dict[str, Port]:
    if fmu is False:
        return {}
    return {v.name: Port(component, v) for v in describe(fmu).modelVariables}


def warn_of_dropped(replaced: Mapping[str, Replacement], data: Data) -> None:
    """One warning for each component names what it lacks; ScenarioError if it is not joined to the system."""
    for replacement in replaced.values():
        _check_joined(replacement, data)
    for replacement in replaced.values():
        replacement.warn(data["parameters"])


def _check_joined(replaced: Replacement, data: Data) -> None:
    """Refuse an FMU whose variables have other names than the connections and signals that it inherits."""
    prefix = f"{replaced.component}."
    driven = {*data["inputs"], *data["signals"], *(target for _, target, *_ in data.get("connections", []))}
    missing: set[str] = set()
    for shown in replaced.dropped.get("connections", []):
        source, _, target = shown.partition(" -> ")
        missing |= {source} if source.startswith(prefix) and target not in driven else set()
    may_be_open = data["experiment"].get("open_inputs") == "start"
    undriven = [n for n in replaced.names("input") if not (prefix + n in driven or may_be_open)]
    if undriven:
        missing |= set(replaced.lost_inputs())
    if not (replaced.fmu and missing):
        return
    lacks = sorted(name.removeprefix(prefix) for name in missing)
    may_stay = "; --open-inputs start leaves its inputs at their start values" if undriven else ""
    raise ScenarioError(
        f"{replaced.component} is {Path(replaced.fmu).name}, which lacks {', '.join(lacks)}; nothing drives "
        f"its {', '.join(undriven) or '(no input)'}, its outputs are {', '.join(replaced.names('output'))}: "
        f"name those that stand for others by --map {prefix}{lacks[0]}=NAME or in "
        f"[mapping.{replaced.component}]{may_stay}"
    )


def without_removed(data: Data, table: str, layers: Sequence[Layer], describe: Describe) -> dict[str, Any]:
    """The values of a table without those that are `false`, inherited, and of no Boolean variable."""

    def is_removed(name: str, value: Any) -> bool:
        is_inherited = sum(name in layer.data.get(table, {}) for layer in layers) > 1
        return value is False and is_inherited and not _is_boolean(name, data["components"], describe)

    return {name: value for name, value in data[table].items() if not is_removed(name, value)}


def _is_boolean(name: str, components: Mapping[str, str], describe: Describe) -> bool:
    component, _, variable = name.partition(".")
    variables = describe(components[component]).modelVariables if component in components else []
    return any(v.name == variable and v.type == "Boolean" for v in variables)
