"""Commands for other tools: package, export, importers."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from fmus import catalogue
from fmus.files import write_text_atomically
from fmus.registry import Flavour
from orchestration.cli.shared import OutFolder, bar, console, shipped_or_own
from orchestration.errors import OrchestrationError
from orchestration.exchange import handover, ssp_write
from orchestration.exchange.signal_sources import SOURCE


def package(
    name: Annotated[str, typer.Argument(metavar="SCENARIO", help="A shipped scenario or a .toml file.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Package to write; by default SCENARIO.ssp.")
    ] = None,
) -> None:
    """Write a scenario as an SSP 1.0 package, with a parameter set for each scenario of its system."""
    chosen = shipped_or_own(name, Flavour.NATIVE)
    catalogue.build_if_stale(SOURCE)
    print(ssp_write.package(chosen, out or Path(f"{chosen.name}.ssp")))


def export(
    tool: Annotated[handover.Tool, typer.Argument(help="For which tool.")],
    name: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="A shipped scenario or a .toml file.")
    ] = "nominal-extended",
    out: OutFolder = Path(),
) -> None:
    """Write a scenario's closed loop as a Modelica package or a Simulink script, its FMUs with it."""
    print(handover.write(tool, shipped_or_own(name, Flavour.NATIVE), out))


def importers(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file to write the table to as well.")
    ] = None,
) -> None:
    """Run packages in other importers and compare the depth with our master's."""
    from tests.importers import comparison

    count = len(comparison.DISTRIBUTIONS) * len(comparison.SCENARIOS)
    with bar(count, "run", "importers") as shown, tempfile.TemporaryDirectory() as folder:
        found = [shown.update() or each for each in comparison.outcomes(Path(folder))]
    console.print(comparison.table(found))
    if out:
        write_text_atomically(out, comparison.markdown(found))
        print(out)
    failed = sorted({each.importer for each in found if each.problem and each.version})
    if failed:
        raise OrchestrationError(f"{', '.join(failed)} failed: expected the same depth as our master's")
