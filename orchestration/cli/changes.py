"""Options that change a scenario: another FMU in a component's place, other values."""

import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

from fmus.fmi.variable_types import FmiValue
from orchestration.cli import shared
from orchestration.errors import ScenarioError
from orchestration.system.open_inputs import OpenInputs

CONTROLLER, PLANT = "controller", "plant"  # the components that have an option of their own


@dataclass(frozen=True)
class Changes:
    """The changes that the options of a command make.

    settings: component -> FMU, Python file or block in its place; "component.variable" -> value
    mapping: component -> name in the scenario -> variable; open_inputs: of the experiment, None as it is
    parameter_set: of an .ssp package
    """

    settings: Mapping[str, FmiValue] = field(default_factory=dict)
    mapping: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    open_inputs: OpenInputs | None = None
    parameter_set: str = ""

    @classmethod
    def of_options(
        cls,
        controller: str = "",
        settings: list[str] = [],  # noqa: B006  (Typer copies it)
        mapped: list[str] = [],  # noqa: B006
        open_inputs: OpenInputs | None = None,
        plant: str = "",
        parameters: str = "",
    ) -> "Changes":
        """Returns the changes that these options make; ScenarioError for an option that is wrong.

        controller FMU: Put this controller, an .fmu, a block, its .py file or a class FILE.py:Class, in the
            place of the scenario's.
        settings --set NAME=VALUE: Set a parameter or an input, component.variable=value; or replace a
            component, component=FMU.
        mapped --map NAME=VARIABLE: Take this variable of the controller for NAME of the scenario;
            component.NAME for others.
        open_inputs: Let inputs that nothing drives keep the start values of their FMUs.
        plant FMU: Put this plant, an .fmu, a block, its .py file or a class FILE.py:Class, in the place of
            the scenario's.
        parameters FILE: Take the values of this parameter file, .toml, below those of --set; of an .ssp
            package the parameter set of this name.
        """
        from orchestration.scenarios.changes import AssignedText

        chosen = {CONTROLLER: controller, PLANT: plant}
        changed: dict[str, str] = {name: fmu for name, fmu in chosen.items() if fmu}
        is_file = parameters.endswith(".toml")
        if is_file:
            from orchestration.scenarios.read_layers import parameter_values

            values = parameter_values(Path(parameters))
            changed |= {name: AssignedText(json.dumps(value)) for name, value in values.items()}
            for text in changed.values():
                if isinstance(text, AssignedText):
                    text.file = parameters
        for assignment in settings:
            name, value = _parts("--set", assignment, "component.variable=value or component=FMU")
            if "." not in name and name in changed:
                raise ScenarioError(f"{name} = {value}: expected one FMU, got {changed[name]} too")
            changed[name] = AssignedText(value)
        return cls(changed, _mapping(mapped), open_inputs, "" if is_file else parameters)

    @property
    def components(self) -> dict[str, str]:
        """The FMUs of components that are replaced."""
        return {name: str(fmu) for name, fmu in self.settings.items() if "." not in name}

    def of_component(self, component: str) -> tuple[dict[str, FmiValue], Mapping[str, str]]:
        """Returns variable -> value, and name -> variable, of a component."""
        own = {n: v for n, v in self.settings.items() if n.startswith(f"{component}.")}
        values = {name.partition(".")[2]: value for name, value in own.items()}
        return values, self.mapping.get(component, {})

    def check_of_plant(self, *mapped: str) -> None:
        """Refuses settings of other components than the plant, and mappings of others than it and these."""
        named = [(name, (PLANT,)) for name in self.settings]
        named += [(f"{x}.{name}", (PLANT, *mapped)) for x, names in self.mapping.items() for name in names]
        for name, components in named:
            if name.partition(".")[0] not in components:
                own = "NAME" if "." in name else name
                raise ScenarioError(f"{name}: expected {' or '.join(f'{one}.{own}' for one in components)}")

    def overrides(self, scenario: str) -> dict[str, Any]:
        """Returns what is laid over the scenario of that name, besides components and settings."""
        overrides: dict[str, Any] = {}
        if self.components:
            overrides["title"] = self.title(scenario)
        if self.mapping:
            overrides["mapping"] = {component: dict(names) for component, names in self.mapping.items()}
        if self.open_inputs:
            overrides["experiment"] = {"open_inputs": str(self.open_inputs)}
        return overrides

    def options(self) -> tuple[str, ...]:
        """Returns the options that make these changes."""
        assignments = [f"{name}={value}" for name, value in self.settings.items()]
        mapped = [f"{c}.{name}={own}" for c, names in self.mapping.items() for name, own in names.items()]
        options = [("--set", assignment) for assignment in assignments]
        options += [("--map", assignment) for assignment in mapped]
        options += [("--open-inputs", str(self.open_inputs))] if self.open_inputs else []
        return tuple(part for option in options for part in option)

    def title(self, scenario: str) -> str:
        """Returns the title of the results of the scenario of that name."""
        return ", ".join([scenario, *(f"{name} {fmu_name(fmu)}" for name, fmu in self.components.items())])

    def name(self, scenario: str) -> str:
        """Returns the name of the results: the scenario's, and that of each FMU that replaces one of it."""
        return "-".join([scenario, *map(fmu_name, self.components.values())])


NO_CHANGES = Changes()


def fmu_name(fmu: str) -> str:
    """Returns the name that results have of an FMU: that of its file, or of the class of my.py:Policy."""
    return fmu.rpartition(":")[2] if ".py:" in fmu else Path(fmu).stem


def takes_changes(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Returns a decorator that puts options of `Changes.of_options` in place of a parameter `changes`.

    names: of its arguments, by default all; one that is an argument of the command itself is no option. The
    docstring of the command may describe them otherwise
    """
    known = inspect.signature(shared.explained(Changes.of_options)).parameters

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command).parameters
        declared = {name: [parameter] for name, parameter in own.items()}
        declared["changes"] = [known[name] for name in names or known if name not in own]

        @wraps(command)
        def with_options(**arguments: Any) -> None:
            chosen = {
                name: arguments[name] if name in own else arguments.pop(name) for name in names or known
            }
            command(**arguments, changes=Changes.of_options(**chosen))

        parameters = [parameter for group in declared.values() for parameter in group]
        return shared.with_parameters(with_options, parameters)

    return decorate


OF_LOOP = ("plant", "settings", "mapped")
"""Arguments of `takes_changes` for commands that take a controller and a vehicle."""


def _parts(option: str, assignment: str, expected: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in assignment.partition("="))
    if not (name and equals and value):
        raise ScenarioError(f"{option} {assignment}: expected {expected}")
    return name, value


def _mapping(mapped: Sequence[str]) -> dict[str, dict[str, str]]:
    """Returns component -> name -> variable; a name without a component is the controller's."""
    mapping: dict[str, dict[str, str]] = {}
    for assignment in mapped:
        name, variable = _parts("--map", assignment, "NAME=VARIABLE or component.NAME=VARIABLE")
        component, own = name.split(".", 1) if "." in name else (CONTROLLER, name)
        mapping.setdefault(component, {})[own] = variable
    return mapping
