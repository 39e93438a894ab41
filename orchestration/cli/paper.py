"""Commands reproduce and identify."""

from pathlib import Path
from typing import Annotated

import typer

from fmus.operating_system import usable_processors
from fmus.registry import Flavour
from orchestration.cli import shared


def reproduce(
    out: shared.OutFolder = Path("results"),
    workers: Annotated[int, typer.Option(help="Run so many scenarios at once.", min=1)] = usable_processors(),
    flavour: shared.FlavourOption = Flavour.NATIVE,
    formats: shared.FigureFormatsOption = "png",
) -> None:
    """Run the shipped scenarios, but not their sweeps, and give the tables and figures of the paper."""
    from orchestration.cli.chosen_scenario import build_missing_fmus
    from orchestration.scenarios import run_files
    from orchestration.scenarios.published import comparison_table

    written_formats = shared.figure_formats(formats)
    shared.check_writable(out)
    scenarios = run_files.reproduced(flavour)
    build_missing_fmus(scenarios.values())
    with shared.progress("reproduce", len(scenarios)) as bar:
        results = run_files.run_all(out, workers, lambda name: bar.advance(), flavour)
    written = run_files.write_report(results, out, written_formats)
    shared.print_table(comparison_table({name: result.metrics for name, result in results.items()}))
    print(*written, sep="\n")


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
    from orchestration.fit import identify as identification
    from orchestration.results.metric_units import metrics_table, values_table

    shared.check_writable(out.parent)
    scenarios = {name: chosen_scenario.load(name) for name in identification.SCENARIOS}
    with shared.progress("identify", evaluations) as bar:
        fit = identification.identify(
            seed, evaluations, starts, lambda cost: bar.advance(note=f"cost {cost:.3g}")
        )
    identification.write(fit, out)
    for name, metrics in fit.metrics.items():
        print(metrics_table(name, metrics, fit.metric_units, scenarios[name].metrics))
    units = {gain.name: gain.unit for gain in identification.GAINS}
    print(values_table("Fitted gains", "Gain", fit.gains, units))
    print(out)
