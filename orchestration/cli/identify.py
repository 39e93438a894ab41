"""Command identify."""

from pathlib import Path
from typing import Annotated

import typer

from orchestration.cli.shared import print_table, progress


def identify(
    seed: Annotated[int, typer.Option(help="Draw the starting points from this seed.", min=0)] = 1,
    evaluations: Annotated[int, typer.Option(help="Allow so many pairs of runs in all.", min=2)] = 80,
    starts: Annotated[int, typer.Option(help="Spend so many pairs of runs on starting points.", min=1)] = 10,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Write this parameter file.")] = Path(
        "identified.toml"
    ),
) -> None:
    """Fit the gains that the paper does not publish to the nominal row of its Table 1."""
    from orchestration.cli import chosen_scenario
    from orchestration.results.tables import metrics_table
    from orchestration.scenarios import identify as identification

    for name in identification.SCENARIOS:
        chosen_scenario.load(name)
    with progress("identify", evaluations) as bar:
        fit = identification.identify(
            seed, evaluations, starts, lambda cost: bar.advance(note=f"cost {cost:.3g}")
        )
    identification.write(fit, out)
    for name, metrics in fit.metrics.items():
        print_table(metrics_table(name, metrics, fit.metric_units))
    for name, value in fit.gains.items():
        print(f"{name} = {value}")
    print(out)
