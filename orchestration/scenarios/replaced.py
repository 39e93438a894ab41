"""Another FMU in the place of a component of a scenario: the entries that it inherits, and the others.

Entries of the layers below that name a variable of the replaced component stay if the new FMU has a variable
of that name which can take their part; the others are left out. Entries of the layer that replaces the
component, and of those above it, are its own: they stay as they are, and a wrong one is an error.
"""

import json
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from fmus.errors import listed
from fmus.fmi.description import start_value
from orchestration.errors import ScenarioError, ScenarioWarning
from orchestration.results.metrics import SIGNALS
from orchestration.scenarios.interface import Component, Interface
from orchestration.scenarios.layers import Data, driven_inputs, with_events
from orchestration.system.quantities import StatedValue
from orchestration.system.values import fmi_value

_MOST_NAMES = 6  # in a message
# kind of entry -> the part that it gives to its variable: see `Component.has_part`
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


@dataclass
class Replacement:
    """An FMU in the place of another.

    own: names in the interface's own layer, which another FMU may lack
    identified: parameters that a file has, chosen for another FMU
    left_out: (variable that an entry lacks, input that the entry drives or "")
    changing: variables of them that would change during the run
    taken: parameter -> value, of those identified
    """

    component: Component
    interface: Interface
    own: Collection[str]
    identified: Collection[str]
    left_out: list[tuple[str, str]] = field(default_factory=list)
    changing: set[str] = field(default_factory=set)
    taken: dict[str, Any] = field(default_factory=dict)

    def fitting(self, data: Data) -> Data:
        """Returns the entries that fit the new FMU."""
        result: Data = {}
        for kind, entries in data.items():
            keeps = partial(self._keeps, kind)
            if kind == "sweep":
                result[kind] = self.fitting(entries)
            elif kind == "events":
                result[kind] = with_events(entries, keeps)
            elif isinstance(entries, dict):
                result[kind] = {name: value for name, value in entries.items() if keeps(name, value)}
            elif kind == "connections":
                result[kind] = [entry for entry in entries if keeps(entry[1], entry[0])]
            elif kind == "record":
                result[kind] = [name for name in entries if keeps(name, None)]
            elif kind == "faults":
                result[kind] = [fault for fault in entries if keeps(fault["input"], None)]
            else:
                result[kind] = entries
        return result

    def _keeps(self, kind: str, name: str, value: Any) -> bool:
        if kind == "step_sizes":
            return name != self.component.name or bool(self.component.fmu)
        if kind not in _PARTS:
            return True
        names = [value[key] for key in SIGNALS if value and key in value] if kind == "metrics" else [name]
        given = value if kind in _WITH_VALUES else None
        driven = name if kind in ("connections", "signals") else ""
        changes = kind in ("signals", "events")
        if kind == "connections":
            changes = value.partition(".")[0] not in self.interface.components
        if not all(self._fits(_PARTS[kind], one, given, driven, changes) for one in names):
            return False
        # an output is lacking only if there is an input that it drives
        return kind != "connections" or self._fits("output", value, None, driven, False)

    def _fits(self, part: str, name: str, value: Any, driven: str, changes: bool) -> bool:
        """Whether the new FMU can have a part in an entry; notes it as left out or taken."""
        component, _, variable = name.partition(".")
        if component != self.component.name:
            return True
        if not self.component.has_part(variable, part, value):
            self.left_out.append((variable, driven))
            self.changing |= {variable} if changes else set()
            return False
        if part == "start" and name in self.identified:
            port = self.component.port(variable)
            is_text = port and isinstance(value, StatedValue)
            self.taken[variable] = fmi_value(port, value) if port and is_text else value
        return True

    def check(self, data: Data) -> None:
        """Checks that the new FMU is joined to the system, and warns of what may not be meant.

        data: of all layers
        Raises ScenarioError for an FMU whose variables have other names than what it inherits.
        """
        new, driven, prefix = self.component, driven_inputs(data), f"{self.component.name}."
        if not new.fmu:
            return
        may_be_open = data["experiment"].get("open_inputs") == "start"
        own = [prefix + name for name in self._variables("input") if prefix + name not in driven]
        undriven = [*([] if may_be_open else own), *self.interface.undriven(driven, new)]
        lacking = self.interface.lacking(new)
        needed = {name for names in lacking for name in names}
        unjoined = {name for name, target in self.left_out if target in (prefix + name, *undriven)}
        unjoined |= {names[0] for names in lacking if self.interface.joins(names, new, undriven)}
        unjoined |= {*self.interface.lacking_inputs(new)} if own else set()
        missing = [n for n, target in self.left_out if target not in driven and not self._may_lack(n, needed)]
        missing += [names[0] for names in lacking if not self._may_lack(names[0], needed)]
        names = sorted(unjoined) if unjoined and undriven else list(dict.fromkeys(missing))
        state = f"{new.name} is {Path(new.fmu).name}"
        if names:
            others = [name for group in lacking if group[0] == names[0] for name in group]
            mapped = [f"--map {prefix}{name}=NAME" for name in dict.fromkeys([names[0], *others])]
            lacks = f"{state}, which lacks {listed(names, _MOST_NAMES)}"
            hint = f"name those that stand for others by {' or '.join(mapped)}"
            hint += f" or in [components.{new.name}.names]"
            if unjoined and undriven:
                may_stay = "; --open-inputs start leaves its inputs at their start values" if own else ""
                outputs = ", ".join(self._variables("output")) or "(none)"
                got = f"nothing drives {', '.join(undriven)}; its outputs are {outputs}"
                raise ScenarioError(f"{lacks}; {got}: {hint}{may_stay}")
            optional_hint = f'list those that it may lack in [interface], optional = ["{prefix}{names[0]}"]'
            _warn(f"{lacks}: left out; {hint}; {optional_hint}")
        self._check_taken(data["parameters"], state)

    def _may_lack(self, variable: str, needed: Collection[str]) -> bool:
        """Whether entries of a variable are left out without a warning.

        needed: variables that the FMU should have
        """
        name = f"{self.component.name}.{variable}"
        marked = self.interface.optional.get(name, -1)
        if self.component.names.get(variable) == "" or marked > self.interface.layer:
            return True
        if variable in self.changing or variable in needed:
            return False
        return marked >= 0 or name in self.interface.names or name in self.own

    def _check_taken(self, parameters: Mapping[str, Any], state: str) -> None:
        """Warns (ScenarioWarning) of values that were chosen for another FMU, if this one lacks others."""
        values: dict[str, Any] = {n: parameters.get(f"{self.component.name}.{n}") for n in self.taken}
        ports = {n: port for n in values if (port := self.component.port(n))}
        own = {n: start_value(port.variable) for n, port in ports.items()}
        taken = [n for n, v in values.items() if v == self.taken[n] and fmi_value(ports[n], v) != own[n]]
        if taken and self.left_out:
            shown = listed([f"{n} = {values[n]!r}" for n in taken], _MOST_NAMES)
            restored = f"--set {self.component.name}.{taken[0]}={json.dumps(own[taken[0]])}"
            _warn(f"{state}, which takes {shown} of the scenario; its own by {restored}")

    def _variables(self, causality: str) -> list[str]:
        return [name for name, v in self.component.variables.items() if v.causality == causality]


def renamed(data: Data, component: str, names: Mapping[str, str]) -> Data:
    """Returns the data with other names of variables of a component; "": no variable has that name.

    Raises ScenarioError for a variable with two values.
    """
    written = {f"{component}.{name}": f"{component}.{own}" for name, own in names.items() if own}
    result = {key: _with_names(value, written, key) for key, value in data.items()} if written else data
    if written and isinstance(result.get("record"), list):
        result["record"] = list(dict.fromkeys(result["record"]))
    return result


def _with_names(value: Any, names: Mapping[str, str], table: str) -> Any:
    """Returns the value with other names of variables, as keys and as texts."""
    if isinstance(value, list):
        return [_with_names(item, names, table) for item in value]
    if not isinstance(value, dict):
        return names.get(value, value) if isinstance(value, str) else value
    result: Data = {}
    old_names: dict[str, str] = {}
    for key, item in value.items():
        name, own = names.get(key, key), _with_names(item, names, table)
        if name in result and result[name] != own:
            raise ScenarioError(
                f"{table}: {old_names[name]} and {key} both stand for {name}: expected one value, got "
                f"{result[name]!r} and {own!r}",
                (table, key),
            )
        result[name], old_names[name] = own, key
    return result


def _warn(message: str) -> None:
    warnings.warn(message, ScenarioWarning, stacklevel=5)
