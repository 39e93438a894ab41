"""Options that change a scenario: another FMU in a component's place, other values."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from fmus.fmi_types import FmiValue
from orchestration.errors import ScenarioError

CONTROLLER = "controller"  # the component that --controller replaces

ControllerOption = Annotated[
    str,
    typer.Option(
        metavar="FMU",
        help="Put this controller, an .fmu, a block or its .py file, in the place of the scenario's.",
    ),
]
SetOption = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Set a parameter or an input, component.variable=value; or replace a component, component=FMU.",
    ),
]


@dataclass(frozen=True)
class Changes:
    """components: component -> FMU or block in its place; settings: "component.variable" -> value."""

    components: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, FmiValue] = field(default_factory=dict)

    @classmethod
    def of_options(cls, controller: str, assignments: Sequence[str]) -> "Changes":
        """From the values of --controller and --set; ScenarioError says what is wrong with one."""
        components, settings = ({CONTROLLER: controller} if controller else {}), {}
        for assignment in assignments:
            name, equals, value = (part.strip() for part in assignment.partition("="))
            if not (name and equals and value):
                raise ScenarioError(f"--set {assignment}: expected component.variable=value or component=FMU")
            if "." in name:
                settings[name] = _value(value)
            else:
                components[name] = value
        return cls(components, settings)

    def title(self, scenario: str) -> str:
        """The title of the results of the scenario of that name."""
        return ", ".join([scenario, *(f"{name} {Path(fmu).stem}" for name, fmu in self.components.items())])

    def name(self, scenario: str) -> str:
        """The name of the results: that of the scenario, and of each FMU that replaces one of it."""
        return "-".join([scenario, *(Path(fmu).stem for fmu in self.components.values())])


NO_CHANGES = Changes()


def _value(text: str) -> FmiValue:
    """A number, true, false or a text, as TOML writes it; a text needs no quotes."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, bool | int | float | str) else text
