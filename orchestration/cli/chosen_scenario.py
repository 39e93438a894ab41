"""The scenario that a command is given: loaded, and the FMUs of our blocks that it needs built."""

import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from fmus.fmi.description import start_value
from fmus.registry import Flavour
from orchestration.cli.changes import NO_CHANGES, Changes
from orchestration.errors import ScenarioError
from orchestration.scenarios import scenario
from orchestration.scenarios.changes import given_layers
from orchestration.scenarios.fmu_files import build_missing, files_of
from orchestration.scenarios.layers import file_layers
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.toml_file import placed


def load(
    name: str,
    flavour: Flavour = Flavour.NATIVE,
    changes: Changes = NO_CHANGES,
    names_actuators: bool = True,
) -> Scenario:
    """Loads the shipped scenario of that name, or the one in that .toml file, and checks it against its FMUs.

    Its name and title contain the components that the changes replace.
    names_actuators: whether a line names what follows from the actuators of another vehicle
    """
    arguments = (name, *changes.options(), *(() if flavour is Flavour.NATIVE else ("--flavour", flavour)))
    if changes.parameter_set:
        raise ScenarioError(
            f"--parameters {changes.parameter_set}: expected a file that ends in .toml, or an .ssp package "
            f"to take a parameter set from, got {name}"
        )
    path, overrides = scenario.find(name), changes.overrides()
    layers = file_layers(path)
    made = files_of(given_layers(layers, overrides, changes.settings), flavour)
    build_missing(made.values())
    chosen = scenario.load(path, overrides, flavour, layers=layers, settings=changes.settings, made=made)
    built = _of_files(changes, made)
    title = built.title(path.stem if built.components else chosen.title)
    resolved = {**chosen.resolved, "title": title}
    chosen = replace(
        chosen, name=built.name(chosen.name), title=title, resolved=resolved, arguments=arguments
    )
    build_missing({*chosen.system.components.values()} - {*made.values()})
    with placed(chosen.files):
        prepared = chosen.prepared
    open_inputs = [f"{port.name} = {start_value(port.variable)}" for port in prepared.system.open_inputs]
    is_of_user = changes.components or scenario.shipped().get(path.stem) != path
    if chosen.from_actuators and is_of_user and names_actuators:
        numbers = {n: "true" if x is True else f"{x:g}" for n, x in chosen.from_actuators.items()}
        values = ", ".join(f"{n} = {text}" for n, text in numbers.items() if "_table_" not in n)
        values += " and the points of its table" if any("_table_" in n for n in numbers) else ""
        print(f"l1-depth: of the actuators of plant: {values}; --set gives others", file=sys.stderr)
    if open_inputs:
        print(f"l1-depth: open inputs at their start values: {', '.join(open_inputs)}", file=sys.stderr)
    return chosen


def _of_files(changes: Changes, made: Mapping[str, Path]) -> Changes:
    """Returns the changes with the FMU of each block that is a Python file; made: by Python file."""
    files = {n: made[str(Path(fmu).absolute())] for n, fmu in changes.components.items() if fmu[-3:] == ".py"}
    return replace(changes, settings={**changes.settings, **{n: str(file) for n, file in files.items()}})


def build_missing_fmus(scenarios: Iterable[Scenario]) -> None:
    """Builds the FMUs of our blocks that these scenarios run and that are missing or stale."""
    build_missing({fmu for chosen in scenarios for fmu in chosen.system.components.values()})


@contextmanager
def opened(name: str, flavour: Flavour, changes: Changes = NO_CHANGES) -> Iterator[Scenario]:
    """Loads a scenario as `load`, or from an SSP package, whose FMUs exist only inside the context."""
    if name.endswith(".ssp"):
        if replace(changes, parameter_set="") != NO_CHANGES:
            raise ScenarioError(f"--set and --controller of a package: expected a scenario, got {name}")
        if flavour is not Flavour.NATIVE:
            raise ScenarioError(f"--flavour {flavour} of a package: expected none, it holds its own FMUs")
        from orchestration.exchange import ssp_read

        with ssp_read.opened(Path(name), changes.parameter_set) as chosen:
            yield chosen
        return
    yield load(name, flavour, changes)
