"""What the commands share: options, the console, progress bars."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from tqdm import tqdm

from fmus import catalogue
from fmus.registry import Flavour
from orchestration.errors import ScenarioError
from orchestration.exchange import ssp_read
from orchestration.scenarios import scenario

_BEFORE_A_BAR_S = 2.0

console = Console(width=None if sys.stdout.isatty() else 130)

FlavourOption = Annotated[Flavour, typer.Option(help="How our own FMUs run: compiled, or on Python.")]
OutFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")]


@contextmanager
def bar(total: float, unit: str, description: str) -> Iterator[Any]:
    """A progress bar on standard error, if that is a terminal and the work takes over two seconds."""
    with tqdm(
        total=total, unit=unit, desc=description, delay=_BEFORE_A_BAR_S, disable=None, file=sys.stderr
    ) as shown:
        yield shown


@contextmanager
def chosen_scenario(name: str, parameters: str, flavour: Flavour) -> Iterator[scenario.Scenario]:
    """What `run` is asked to run, its FMUs in place."""
    if name.endswith(".ssp"):
        if flavour is not Flavour.NATIVE:
            raise ScenarioError(f"--flavour {flavour} of a package: expected none, it holds its own FMUs")
        with ssp_read.opened(Path(name), parameters) as chosen:
            yield chosen
        return
    if parameters:
        raise ScenarioError(
            f"--parameters {parameters}: expected an .ssp package to take it from, got {name}"
        )
    yield shipped_or_own(name, flavour)


def build_missing_fmus(scenarios: Iterable[scenario.Scenario]) -> None:
    """Build the blocks' FMUs that these scenarios run and that are missing or stale."""
    catalogue.build_missing({fmu for chosen in scenarios for fmu in chosen.system.components.values()})


def shipped_or_own(name: str, flavour: Flavour) -> scenario.Scenario:
    """A scenario by its name or its .toml file, its FMUs in place."""
    chosen = scenario.load(scenario.find(name), flavour=flavour)
    build_missing_fmus([chosen])
    return chosen
