"""Command package, which writes scenarios for other tools."""

from pathlib import Path
from typing import Annotated

import typer

from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes
from orchestration.cli.shared import ScenarioArgument
from orchestration.exchange.ssp_xml import SspVersion


@takes_changes()
def package(
    name: ScenarioArgument,
    out: Annotated[
        # a Path would lose the slash at its end
        str,
        typer.Option(metavar="FILE", help="Write this package, or SCENARIO.ssp in this folder."),
    ] = "",
    version: Annotated[SspVersion, typer.Option("--ssp", help="Version of SSP.")] = SspVersion.V1,
    changes: Changes = NO_CHANGES,
) -> None:
    """Write a scenario as an SSP package, with a parameter set for each scenario of its system.

    For example, l1-depth package nominal-extended writes nominal-extended.ssp.
    """
    from orchestration.cli import chosen_scenario
    from orchestration.cli.package_fmus import build_ramp_source, build_started
    from orchestration.exchange import ssp_write

    chosen = chosen_scenario.load(name, changes=changes)
    is_folder = out.endswith(("/", "\\")) or Path(out).is_dir()
    path = Path(out, f"{chosen.name}.ssp") if is_folder else Path(out)
    print(ssp_write.package(chosen, path, build_ramp_source, build_started, version))
