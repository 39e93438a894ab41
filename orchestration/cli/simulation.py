"""Commands that simulate: run, scenarios, identify, reproduce, bench."""

import os
from pathlib import Path
from typing import Annotated

import typer

from fmus import catalogue
from fmus.catalogue import Flavour
from orchestration import bench as benchmark
from orchestration import identify as identification
from orchestration import report, scenario
from orchestration import reproduce as reproduction
from orchestration.cli.shared import FlavourOption, OutFolder, bar, chosen_scenario, console

_IDENTIFIED = scenario.SHIPPED / "parameters" / "identified.toml"


def run(
    name: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="A shipped scenario, a .toml file or an .ssp package.")
    ],
    out: OutFolder = Path("results"),
    flavour: FlavourOption = Flavour.NATIVE,
    parameters: Annotated[
        str, typer.Option(metavar="NAME", help="Of a package: another of its parameter sets.")
    ] = "",
) -> None:
    """Run one scenario: recording (CSV), what was run and metrics (JSON), a figure."""
    with chosen_scenario(name, parameters, flavour) as chosen, bar(1, "step", chosen.name) as shown:

        def progress(done: int, total: int) -> None:
            shown.total = total
            shown.update(done - shown.n)

        result = reproduction.run(chosen, out, progress)
    figures = report.run_figure(chosen.title, result.recording, out / chosen.name)
    if result.metrics:
        console.print(report.metrics_table(chosen.title, result.metrics))
    for path in (out / f"{chosen.name}.csv", out / f"{chosen.name}.json", *figures):
        print(path)


def scenarios() -> None:
    """List the scenarios that ship with the package."""
    for name, path in scenario.shipped().items():
        print(f"{name:28} {scenario.load(path).title}")


def identify(
    seed: Annotated[int, typer.Option(help="Seed of the starting points.", min=0)] = 1,
    evaluations: Annotated[int, typer.Option(help="Pairs of runs allowed in all.", min=2)] = 80,
    starts: Annotated[int, typer.Option(help="Pairs of runs on drawn starting points.", min=1)] = 10,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Parameter file; by default the one the scenarios use.")
    ] = _IDENTIFIED,
) -> None:
    """Fit the gains that the paper does not publish to the nominal row of its Table 1."""
    reproduction.build_what_is_missing(
        scenario.load(scenario.find(name)) for name in identification.SCENARIOS
    )
    with bar(evaluations, "run", "identify") as shown:

        def progress(cost: float) -> None:
            shown.set_postfix(cost=f"{cost:.3g}")
            shown.update()

        fit = identification.identify(seed, evaluations, starts, progress)
    identification.write(fit, out)
    for name, measured in fit.metrics.items():
        console.print(report.metrics_table(name, measured))
    for name, value in fit.gains.items():
        print(f"{name} = {value}")
    print(out)


def reproduce(
    out: OutFolder = Path("results"),
    workers: Annotated[int, typer.Option(help="Processes.", min=1)] = os.cpu_count() or 1,
    flavour: FlavourOption = Flavour.NATIVE,
) -> None:
    """Run every scenario and give the paper's tables and figures back."""
    with bar(len(scenario.shipped()), "scenario", "reproduce") as shown:
        results = reproduction.run_all(out, workers, lambda name: shown.update() and None, flavour)
    written = reproduction.write_report(results, out)
    console.print(report.comparison_table({name: r.metrics for name, r in results.items()}))
    for path in written:
        print(path)


def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENARIO]...", help="Shipped scenarios (Jacobi, no events)."),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Of which the median is taken.", min=1)] = 7,
) -> None:
    """Measure the FMUs: FMI against bare C, native against python, a scenario against one C program."""
    chosen, blocks = names or ["nominal-extended"], catalogue.block_names()
    for name in chosen:
        scenario.find(name)
    with bar(len(blocks) + len(chosen), "part", "bench") as shown:
        layers = [shown.update() or benchmark.layer(name, rounds=rounds) for name in blocks]
        loops = [shown.update() or benchmark.loop(name, rounds=rounds) for name in chosen]
    for table in benchmark.tables(layers, loops):
        console.print(table)
    print(f"medians of {rounds} rounds on {benchmark.machine()}")
