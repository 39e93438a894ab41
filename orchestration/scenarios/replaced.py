"""Components that a layer of a scenario replaces by another FMU: what they inherit, and what is left out.

Entries of the layers below that name a variable of the replaced component stay if the new FMU has a variable
of that name which can take their part; the others are left out. Entries of the layer that replaces the
component, and of those above it, are its own: they stay as they are, and a wrong one is an error.

[optional]                                      variables that another FMU may lack without a warning,
controller = ["measured_depth_rate", "u_m"]     unless they change during the run by this layer or one above
"""

import json
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from fmus.errors import listed
from fmus.fmi.description import start_value
from fmus.fmi.model_description import ScalarVariable
from orchestration.errors import ScenarioError, ScenarioWarning, SystemDefinitionError
from orchestration.results.metrics import SIGNALS
from orchestration.scenarios.layers import Data, Layer, source_of, with_events
from orchestration.system.prepared_run import has_start_value
from orchestration.system.quantities import StatedValue
from orchestration.system.system import Port
from orchestration.system.values import fmi_value

Describe = Callable[[str], Mapping[str, ScalarVariable]]
"""Block, or path of an FMU -> its variables by name."""

_MOST_NAMES = 6  # in a message
# kind of entry -> the part that it gives to its variable: see `_has_part`
_PARTS = {
    "parameters": "start",
    "inputs": "input",
    "signals": "input",
    "connections": "input",
    "faults": "input",
    "events": "change",
    "vary": "setting",
    "record": "signal",
    "metrics": "signal",
}
_WITH_VALUES = ("parameters", "inputs", "events")
_CHANGING = ("signals", "events")


@dataclass(frozen=True)
class Replacement:
    """A component whose FMU a layer replaces.

    fmu: "" if it is removed; layer: its index; ports: variable -> port of the new FMU
    optional: variable that it may lack -> the uppermost layer that says so
    alternatives: variable -> those that may stand in its place, by the entries for replaced components
    identified: parameters that a file has, chosen for another FMU
    left_out: (variable that an entry lacks, input that the entry drives or ""); taken: of those identified
    unchanged: variable left out -> the uppermost layer by which it would change during the run
    """

    component: str
    fmu: str
    layer: int
    ports: Mapping[str, Port]
    optional: Mapping[str, int]
    alternatives: Mapping[str, Sequence[str]]
    identified: Collection[str]
    left_out: list[tuple[str, str]] = field(default_factory=list)
    taken: dict[str, Any] = field(default_factory=dict)
    unchanged: dict[str, int] = field(default_factory=dict)

    def fits(self, part: str, name: str, value: Any, driven: str, changes: int | None) -> bool:
        """Whether the new FMU can have a part in an entry; notes it as left out or taken.

        changes: the layer of an entry by which it would change during the run
        """
        variable = name.partition(".")[2]
        port = self.ports.get(variable)
        if port is None or not _has_part(port, part, value):
            self.left_out.append((variable, driven))
            if changes is not None:
                self.unchanged[variable] = changes
            return False
        if part == "start" and name in self.identified:
            self.taken[variable] = fmi_value(port, value) if isinstance(value, StatedValue) else value
        return True

    def check(self, data: Data) -> None:
        """Checks that the new FMU is joined to the system, and warns of what may not be meant.

        data: of all layers
        Raises ScenarioError for an FMU whose variables have other names than what it inherits.
        """
        if not self.fmu:
            return
        state, prefix = f"{self.component} is {Path(self.fmu).name}", f"{self.component}."
        driven = {*data["inputs"], *data["signals"], *(t for _, t, *_ in data.get("connections", []))}
        may_be_open = data["experiment"].get("open_inputs") == "start"
        undriven = [n for n in self._names("input") if not (prefix + n in driven or may_be_open)]
        inputs = {name for name, target in self.left_out if target == prefix + name}
        outputs = {name for name, target in self.left_out if target and target not in driven} - inputs
        unjoined = sorted(outputs | inputs if undriven else outputs)
        optional = {n for n, layer in self.optional.items() if layer > self.unchanged.get(n, -1)}
        missing = dict.fromkeys(n for n, t in self.left_out if n not in optional and t not in driven)
        names = unjoined or list(missing)
        lacks = f"{state}, which lacks {listed(names, _MOST_NAMES)}"
        stand_ins = [*names[:1], *(n for name in names[:1] for n in self.alternatives.get(name, ()))]
        mapped = " or ".join(f"--map {prefix}{name}=NAME" for name in stand_ins)
        hint = f"name those that stand for others by {mapped} or in [mapping.{self.component}]"
        if unjoined:
            may_stay = "; --open-inputs start leaves its inputs at their start values" if undriven else ""
            inputs_of = f"nothing drives its {', '.join(undriven)}, its" if undriven else "its"
            outputs_of = f"outputs are {', '.join(self._names('output')) or '(none)'}"
            raise ScenarioError(f"{lacks}; {inputs_of} {outputs_of}: {hint}{may_stay}")
        if missing:
            optional_hint = f"list those that it may lack in [optional], {self.component} = [...]"
            _warn(f"{lacks}: left out; {hint}; {optional_hint}")
        own = {n: start_value(self.ports[n].variable) for n in self.taken}
        values = {n: data["parameters"].get(prefix + n) for n in own}
        taken = [n for n, v in values.items() if v == self.taken[n] and fmi_value(self.ports[n], v) != own[n]]
        if taken and self.left_out:
            shown = listed([f"{n} = {values[n]!r}" for n in taken], _MOST_NAMES)
            restored = f"--set {prefix}{taken[0]}={json.dumps(own[taken[0]])}"
            _warn(f"{state}, which takes {shown} of the scenario; its own by {restored}")

    def _names(self, causality: str) -> list[str]:
        return [name for name, port in self.ports.items() if port.variable.causality == causality]


def _warn(message: str) -> None:
    warnings.warn(message, ScenarioWarning, stacklevel=4)


def alternatives(layers: Sequence[Layer]) -> dict[str, dict[str, list[str]]]:
    """Returns component -> variable -> those in its place, by the entries for replaced components."""
    result: dict[str, dict[str, list[str]]] = {}
    for entry in (entry for layer in layers for entry in layer.data.get("when_replaced", [])):
        for lacking in entry.get("lacks", []):
            known = result.setdefault(entry["component"], {}).setdefault(lacking, [])
            known += [name for name in entry.get("has", []) if "." not in name and name not in known]
    return result


def replacements(
    layers: Sequence[Layer],
    describe: Describe,
    alternatives: Mapping[str, Mapping[str, Sequence[str]]] = {},
) -> dict[str, Replacement]:
    """Returns the components whose FMU is not that of the layer which gave them first, by name."""
    fmus: dict[str, Any] = {}
    changed: dict[str, int] = {}
    optional: dict[str, dict[str, int]] = {}
    identified = {name for x in layers for file in x.files[1:] for name in file.data.get("parameters", {})}
    for index, layer in enumerate(layers):
        for component, fmu in layer.data.get("components", {}).items():
            if fmus.get(component, fmu) != fmu:
                changed[component] = index
            fmus[component] = fmu or ""
        for component, names in layer.data.get("optional", {}).items():
            optional.setdefault(component, {}).update(dict.fromkeys(names, index))
    result: dict[str, Replacement] = {}
    for name, index in changed.items():
        variables = describe(fmus[name]) if fmus[name] else {}
        ports = {variable: Port(name, v) for variable, v in variables.items()}
        others = alternatives.get(name, {})
        result[name] = Replacement(name, fmus[name], index, ports, optional.get(name, {}), others, identified)
    return result


def without_misfits(layers: Sequence[Layer], replaced: Mapping[str, Replacement]) -> list[Layer]:
    """Returns the layers without inherited entries that do not fit."""
    above = [{n: r for n, r in replaced.items() if r.layer > index} for index in range(len(layers))]
    constants = {name for layer in layers for name in layer.data.get("inputs", {})}
    return [
        replace(layer, data=_fitting(layer.data, above[index], index, constants)) if above[index] else layer
        for index, layer in enumerate(layers)
    ]


def _fitting(data: Data, replaced: Mapping[str, Replacement], index: int, constants: Collection[str]) -> Data:
    """Returns the entries of the layer of an index that fit the FMUs which replace components of it.

    constants: inputs that a layer holds constant: one that another layer connects would change
    """

    def fits(part: str, name: str, value: Any = None, driven: str = "", changes: int | None = None) -> bool:
        new = replaced.get(name.partition(".")[0])
        return new is None or new.fits(part, name, value, driven, changes)

    def is_kept(kind: str, name: str, value: Any) -> bool:
        if kind == "step_sizes":
            return name not in replaced or bool(replaced[name].fmu)
        names = [value[key] for key in SIGNALS if value and key in value] if kind == "metrics" else [name]
        driven = name if kind in ("connections", "signals") else ""
        given = value if kind in _WITH_VALUES else None
        is_moved = kind in _CHANGING or (kind == "connections" and name in constants)
        changes = index if is_moved else None
        if kind in _PARTS and not all(fits(_PARTS[kind], n, given, driven, changes) for n in names):
            return False
        # an output is lacking only if there is an input that it drives
        return kind != "connections" or not value or fits("output", source_of(value), driven=driven)

    result: Data = {}
    for kind, entries in data.items():
        if kind == "sweep":
            result[kind] = _fitting(entries, replaced, index, constants)
        elif kind == "events":
            result[kind] = with_events(entries, partial(is_kept, kind))
        elif isinstance(entries, dict):
            result[kind] = {name: value for name, value in entries.items() if is_kept(kind, name, value)}
        elif kind == "connections":
            result[kind] = [entry for entry in entries if is_kept(kind, entry[1], entry[0])]
        elif kind in ("record", "faults"):
            result[kind] = [x for x in entries if is_kept(kind, x["input"] if kind == "faults" else x, None)]
        else:
            result[kind] = entries
    return result


def _has_part(port: Port, part: str, value: Any) -> bool:
    """Whether a variable can have a part in a scenario, and takes the value if one is given."""
    variable = port.variable
    is_settable = variable.causality in ("parameter", "input")
    parts = {
        "start": has_start_value(variable),
        "setting": is_settable,
        "change": is_settable and variable.variability != "fixed",
        "signal": True,
    }
    with suppress(SystemDefinitionError):
        has_part = parts.get(part, variable.causality == part)
        return has_part and (value is None or value is False or fmi_value(port, value) is not None)
    return False
