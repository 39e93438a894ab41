"""Options that change a scenario: another FMU in a component's place, other values."""

import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.system.open_inputs import OpenInputs

CONTROLLER, PLANT = "controller", "plant"  # the components that have an option of their own


def _fmu_option(component: str) -> Any:
    """Returns the option --component, which replaces the component of that name."""
    return typer.Option(
        metavar="FMU",
        help=f"Put this {component}, an .fmu, a block, its .py file or a class FILE.py:Class, "
        "in place of the one in the scenario or the protocol.",
    )


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
        controller: Annotated[str, _fmu_option(CONTROLLER)] = "",
        settings: Annotated[
            list[str],
            typer.Option(
                "--set",
                metavar="NAME=VALUE",
                help="Set a parameter or an input, component.variable=value; "
                "or replace a component, component=FMU.",
            ),
        ] = [],  # noqa: B006  (Typer copies it)
        mapped: Annotated[
            list[str],
            typer.Option(
                "--map",
                metavar="NAME=VARIABLE",
                help="Take this variable of the controller for NAME of the scenario; "
                "component.NAME for others.",
            ),
        ] = [],  # noqa: B006
        open_inputs: Annotated[
            OpenInputs | None,
            typer.Option(help="Whether undriven inputs are an error, or keep their start values."),
        ] = None,
        plant: Annotated[str, _fmu_option(PLANT)] = "",
        parameters: Annotated[
            str,
            typer.Option(
                metavar="FILE",
                help="Take the values of this parameter file, .toml; --set has precedence. "
                "With run and an .ssp package: the name of one of its parameter sets.",
            ),
        ] = "",
    ) -> "Changes":
        """Returns the changes that these options make; ScenarioError for an option that is wrong."""
        from orchestration.system.quantities import StatedValue, stated

        chosen = {CONTROLLER: controller, PLANT: plant}
        changed: dict[str, str] = {name: fmu for name, fmu in chosen.items() if fmu}
        is_file = parameters.endswith(".toml")
        if is_file:
            from orchestration.scenarios.layers import stated_values
            from orchestration.scenarios.toml_file import read_toml

            values = stated_values(read_toml(Path(parameters)))
            for name, value in values.items():
                text = str(value) if isinstance(value, StatedValue) else json.dumps(value)
                changed[name] = stated(text, getattr(value, "place", f"{parameters}: "), parameters)
        for assignment in settings:
            name, value = _parts("--set", assignment, "component.variable=value or component=FMU")
            if "." not in name and name in changed:
                raise ScenarioError(f"{name} = {value}: expected one FMU, got {changed[name]} too")
            changed[name] = stated(value, "--set ")
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

    def overrides(self) -> dict[str, Any]:
        """Returns the entries that are laid over a scenario, without components and settings."""
        overrides: dict[str, Any] = {}
        if self.mapping:
            overrides["components"] = {name: {"names": dict(own)} for name, own in self.mapping.items()}
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
        """Returns the title of the results of a scenario of that title, or name if an FMU is replaced."""
        fmus = (f"{component} {fmu_name(fmu)}" for component, fmu in self.components.items())
        files = dict.fromkeys(file for x in self.settings.values() if (file := getattr(x, "file", "")))
        values = (f"{n}={x}" for n, x in self.settings.items() if "." in n and not getattr(x, "file", ""))
        return ", ".join([scenario, *fmus, *files, *values])

    def name(self, scenario: str) -> str:
        """Returns the name of the results: of the scenario, and of each FMU that replaces one of its FMUs."""
        return "-".join([scenario, *map(fmu_name, self.components.values())])


NO_CHANGES = Changes()


def fmu_name(fmu: str) -> str:
    """Returns the name of an FMU in results: its file's, or the class of my.py:Policy."""
    return fmu.rpartition(":")[2] if ".py:" in fmu else Path(fmu).stem


OF_LOOP = {
    "plant": "",
    "settings": "Set controller.variable=value; with --plant plant.variable=value.",
    "mapped": "Take this variable of the controller for NAME; with --plant, one of the plant for plant.NAME.",
}
"""The options of commands that take a controller and a vehicle, for `takes_changes`."""


def takes_changes(**helps: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Returns a decorator that puts options of `Changes.of_options` in place of a parameter `changes`.

    helps: name of an argument -> help of its option, "" for the usual one; by default all arguments. One that
    the command itself has is no option
    """
    known = inspect.signature(Changes.of_options).parameters
    names = helps or known

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command)
        own = signature.parameters.keys()
        declared = {name: [parameter] for name, parameter in signature.parameters.items()}
        declared["changes"] = [_explained(known[n], helps.get(n, "")) for n in names if n not in own]
        parameters = [parameter for group in declared.values() for parameter in group]

        @wraps(command)
        def with_options(**arguments: Any) -> None:
            chosen = {name: arguments[name] if name in own else arguments.pop(name) for name in names}
            command(**arguments, changes=Changes.of_options(**chosen))

        vars(with_options)["__signature__"] = signature.replace(parameters=parameters)
        with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return with_options

    return decorate


def _explained(parameter: inspect.Parameter, text: str) -> inspect.Parameter:
    """Returns the parameter of a command with this help of its option, if it is not empty."""
    kind, option = get_args(parameter.annotation)
    option = copy(option)
    option.help = text or option.help
    return parameter.replace(annotation=Annotated[kind, option])


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
