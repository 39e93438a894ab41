"""Commands on FMUs: build, check, inspect."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from fmpy.model_description import ScalarVariable
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fmus import catalogue
from fmus.platforms import PLATFORMS, check_platforms
from fmus.registry import FOLDER_VARIABLE, Flavour, block_names, fmu_folder
from orchestration.cli.shared import FlavourOption, bar, console
from orchestration.errors import OrchestrationError
from orchestration.fmi.description import describe

_FOLDERS = {Flavour.NATIVE: Path("fmus-built"), Flavour.PYTHON: Path("fmus-built", "python")}
_PIPED_WIDTH = 260  # a line a variable, for grep


def build(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Blocks; all by default.")
    ] = None,
    flavour: FlavourOption = Flavour.NATIVE,
    platform: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME", help=f"Of a native FMU: {', '.join(PLATFORMS)}; this one by default."
        ),
    ] = None,
    all_platforms: Annotated[
        bool, typer.Option("--all-platforms", help="Of a native FMU: all of them.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder to write to; by default fmus-built, fmus-built/python for that flavour.",
        ),
    ] = None,
    cache: Annotated[
        bool,
        typer.Option(
            "--cache",
            help="Write to where scenarios find FMUs: a folder of the user's cache, or the one that the "
            f"environment variable {FOLDER_VARIABLE} names. `run` and `reproduce` build there by themselves.",
        ),
    ] = False,
    with_reference: Annotated[
        bool,
        typer.Option("--with-reference", help="Write the files of the FMI cross-check beside each FMU."),
    ] = False,
) -> None:
    """Write DIR/NAME.fmu for each block."""
    if all_platforms and platform:
        raise OrchestrationError(f"--platform {platform} and --all-platforms: expected one of them")
    if cache and out:
        raise OrchestrationError(f"--out {out} and --cache: expected one of them")
    folder = fmu_folder(flavour) if cache else out or _FOLDERS[flavour]
    named = check_platforms([each.strip() for each in platform.split(",")]) if platform else ()
    platforms = PLATFORMS if all_platforms else named
    chosen = names or block_names()
    for name in chosen:
        catalogue.load_block(name)
    with bar(len(chosen), "FMU", "build") as shown:
        for name in chosen:
            path = catalogue.build(name, folder, flavour, platforms)
            print(path)
            for each in catalogue.write_cross_check(name, path.parent) if with_reference else ():
                print(each)
            shown.update()


def check(
    fmus: Annotated[list[Path], typer.Argument(metavar="FMU...")],
    json: Annotated[str, typer.Option(metavar="FILE", help="Write the result as JSON; - prints it.")] = "",
    every: Annotated[bool, typer.Option("--all", help="Show every rule, not only those broken.")] = False,
) -> None:
    """Judge FMUs by the rules of FMI 2.0.5; fails if one is broken that is not a mere warning."""
    from fmus.compliance.__main__ import check as judged

    for path in fmus:
        if not path.is_file():
            describe(path)  # says which FMU is nearest
    count = judged(fmus, json or None, every=every)
    if count:
        raise OrchestrationError(f"{count} error{'s' * (count > 1)} found: expected none")


def inspect(fmu: Annotated[Path, typer.Argument(metavar="FMU")]) -> None:
    """Show what an FMU is and every variable with its unit, range and start value."""
    description = describe(fmu)
    print(f"{description.modelName}: {description.description or ''}")
    tool = description.generationTool or "an unknown tool"
    print(f"FMI {description.fmiVersion}, GUID {description.guid}, made by {tool}")
    table = Table()
    table.add_column("Variable", no_wrap=True)
    for heading in ("Causality", "Type", "Unit", "Start", "Permitted", "Description"):
        table.add_column(heading, overflow="fold")
    for v in description.modelVariables:
        limits = _permitted(v)
        kind = v.declaredType.name if v.declaredType else v.type
        cells = (v.name, v.causality, kind, v.unit, v.start, limits, v.description)
        table.add_row(*(escape(str(cell)) if cell is not None else "" for cell in cells))
    (console if sys.stdout.isatty() else Console(width=_PIPED_WIDTH)).print(table)


def _permitted(variable: ScalarVariable) -> str:
    """Enumeration items, or the range."""
    declared = variable.declaredType
    if declared is not None and declared.items:
        return ", ".join(f"{item.value} ({item.name})" for item in declared.items)
    if variable.min is None and variable.max is None:
        return ""
    return f"{variable.min or ''}..{variable.max or ''}"
