"""The command diff: the effects on an importer when one FMU replaces another."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import typer

from orchestration.cli import shared
from orchestration.diff.change import Change, Level

PANEL = "FMUs"
_NOTES = {Level.MAJOR: "error", Level.MINOR: "warning", Level.PATCH: "notice"}


def diff(
    old: Annotated[
        Path, typer.Argument(metavar="OLD.fmu", help="The FMU that is replaced.", exists=True, dir_okay=False)
    ],
    new: Annotated[
        Path, typer.Argument(metavar="NEW.fmu", help="The FMU in its place.", exists=True, dir_okay=False)
    ],
    name: Annotated[
        str, typer.Option("--scenario", help="Run both in this scenario, not alone at sines.")
    ] = "",
    component: Annotated[
        str, typer.Option(help="Component of the scenario that the FMUs replace.")
    ] = "controller",
    format_name: Annotated[
        Literal["text", "json", "github"],
        typer.Option("--format", help="Format of what is printed; github: annotations."),
    ] = "text",
    fail_on: Annotated[
        Level, typer.Option(help="Fail for differences of this level and above.")
    ] = Level.PATCH,
    timeout: Annotated[float, typer.Option(min=0.1, help="Longest time of a call of an FMU [s].")] = 30.0,
) -> None:
    """Compare two FMUs of any origin: interfaces, results at the same inputs, speed, libraries, sources.

    The verdict is major if a model with the old FMU breaks, minor if it gives other results or there is more
    to use, else patch; speed has none. Exit status: 0; 1 for differences; 2 for wrong use.
    """
    from fmus.errors import FmuLoadError
    from orchestration.diff.behaviour import speed

    try:
        changes = _changes(old, new, timeout, name, component)
    except FmuLoadError as error:
        shared.fail(str(error), 2)
    level, told = changes[0].level if changes else None, speed(old, new, timeout)
    if format_name == "json":
        import json

        found = [change._asdict() for change in changes]
        result = {"old": str(old), "new": str(new), "verdict": level, "changes": found, "speed": told}
        print(json.dumps(result, indent=2))
    else:
        for change in changes:
            print(_line(change, new) if format_name == "github" else "  ".join(change))
        print(f"speed  {told}\n{old} -> {new}: {level or 'equal'}")
    if level and level <= fail_on:
        raise typer.Exit(1)


def _changes(old: Path, new: Path, timeout: float, name: str, component: str) -> list[Change]:
    """Returns all differences, the highest level first."""
    from orchestration.diff.behaviour import behaviour_changes
    from orchestration.diff.interface import file_changes, interface_changes, of_interfaces

    if old.read_bytes() == new.read_bytes():
        return []
    with TemporaryDirectory() as folder:
        before, after = (of_interfaces(fmu, Path(folder, str(i))) for i, fmu in enumerate((old, new)))
        changes = [Change(Level.MAJOR, "interface", f"{x} is gone") for x in before if x not in after]
        changes += [Change(Level.MINOR, "interface", f"{x} is new") for x in after if x not in before]
        shared = {kind: (before[kind], after[kind]) for kind in before if kind in after}
        for kind, pair in (shared or {"": (old, new)}).items():
            found = interface_changes(*pair) + behaviour_changes(*pair, timeout, name, component)
            second = f"{kind}: " if kind != next(iter(shared), kind) else ""
            # variables are the same in both interfaces
            changes += [c._replace(text=second + c.text) for c in found if c not in changes]
    return sorted(changes + file_changes(old, new), key=lambda change: change.level)


def _line(change: Change, new: Path) -> str:
    """Returns an annotation of GitHub, in which %, and ends of lines, are escaped."""
    text = change.text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return f"::{_NOTES[change.level]} file={new},title={change.level} {change.part}::{text}"
