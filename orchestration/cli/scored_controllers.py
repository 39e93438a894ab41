"""The controllers that a command is given, as the study runs them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from orchestration.cli.changes import CONTROLLER, Changes
from orchestration.errors import ScenarioError
from orchestration.score.loop import Controller
from orchestration.system.open_inputs import OpenInputs


def scored_controllers(
    names: Sequence[str],
    league: str,
    settings: Sequence[str],
    mapped: Sequence[str],
    open_inputs: OpenInputs | None,
) -> list[Controller]:
    """The FMUs, blocks and Python files of blocks; settings and mapping are of the only one."""
    from fmus.build import builder

    changes = Changes.of_options("", settings, mapped, open_inputs)
    if len(names) > 1 and (settings or mapped):
        raise ScenarioError(f"--set and --map with {len(names)} controllers: expected one")
    if changes.components:
        raise ScenarioError(f"--set {next(iter(changes.components))}: expected controller.variable=value")
    named = [f"--set {name}" for name in changes.settings]
    named += [f"--map {component}.{name}" for component, names in changes.mapping.items() for name in names]
    for option in named:
        if not option.partition(" ")[2].startswith(f"{CONTROLLER}."):
            raise ScenarioError(f"{option}: expected controller.NAME, the vehicle is the protocol's")
    own = {name.partition(".")[2]: value for name, value in changes.settings.items()}
    mapping: Mapping[str, str] = changes.mapping.get(CONTROLLER, {})
    return [
        Controller(
            name=Path(name).stem,
            fmu=str(builder.fmu_of_file(Path(name)) if name.endswith(".py") else name),
            league=league,
            parameters=own,
            mapping=mapping,
            open_inputs=str(open_inputs or OpenInputs.ERROR),
        )
        for name in names
    ]
