"""Commands that simulate: run, scenarios, identify, reproduce, bench."""

import math
import os
from pathlib import Path
from typing import Annotated

import typer

from fmus.registry import Flavour, block_names
from orchestration.cli.shared import (
    FlavourOption,
    OutFolder,
    bar,
    build_missing_fmus,
    chosen_scenario,
    console,
)
from orchestration.master.checkpoint import Checkpoints, read_checkpoint
from orchestration.results import figures as report
from orchestration.results.files import Format
from orchestration.scenarios import reproduce as reproduction
from orchestration.scenarios import scenario

_LAPS = 3  # rounds of the race: each takes half a minute
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
    file_format: Annotated[Format, typer.Option("--format", help="Of the recording.")] = Format.CSV,
    real_time: Annotated[
        float | None, typer.Option(metavar="FACTOR", help="Keep pace with the clock; 2 is twice as fast.")
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(metavar="S", help="Run FMUs in a process of their own; end it if a step takes longer."),
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Save the whole system there when interrupted.")
    ] = None,
    every: Annotated[
        float, typer.Option(metavar="S", help="With --checkpoint: also every so many simulated seconds.")
    ] = math.inf,
    resume: Annotated[Path | None, typer.Option(metavar="FILE", help="Go on from such a checkpoint.")] = None,
) -> None:
    """Run one scenario: recording (CSV or Parquet), what was run and metrics (JSON), a figure."""
    options = {
        "real_time": real_time,
        "timeout": timeout,
        "checkpoints": Checkpoints(checkpoint, every) if checkpoint else None,
        "resume": read_checkpoint(resume) if resume else None,
    }
    with chosen_scenario(name, parameters, flavour) as chosen, bar(1, "step", chosen.name) as shown:

        def progress(done: int, total: int) -> None:
            shown.total = total
            shown.update(done - shown.n)

        result = reproduction.run(chosen, out, progress, file_format, **options)
    figures = report.run_figure(chosen.title, result.recording, out / chosen.name)
    if result.metrics:
        console.print(report.metrics_table(chosen.title, result.metrics))
    pace = result.recording.provenance.get("real_time")
    if pace:
        missed, worst, where = pace["missed_deadlines"], pace["worst_lateness_s"], pace["worst_at_s"]
        print(f"{missed} deadlines missed, the worst by {1e3 * worst:.3g} ms at t = {where:g} s")
    for path in (out / f"{chosen.name}.{file_format}", out / f"{chosen.name}.json", *figures):
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
    from orchestration.scenarios import identify as identification

    build_missing_fmus(scenario.load(scenario.find(name)) for name in identification.SCENARIOS)
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
    build_missing_fmus(scenario.load(path, flavour=flavour) for path in scenario.shipped().values())
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
    """Measure FMI against bare C, this master against others, and a scenario against one C program."""
    from tests import speed as benchmark

    chosen, blocks = names or ["nominal-extended"], block_names()
    for name in chosen:
        scenario.find(name)
    laps = min(rounds, _LAPS)
    with bar(len(blocks) + len(chosen) + laps * len(benchmark.LOOPS), "part", "bench") as shown:
        layers = [shown.update() or benchmark.layer(name, rounds=rounds) for name in blocks]
        loops = [shown.update() or benchmark.loop(name, rounds=rounds) for name in chosen]
        entries = benchmark.race(laps, progress=shown.update)
    for table in benchmark.tables(layers, loops, entries):
        console.print(table)
    print(f"medians of {rounds} rounds, of importers {laps}, on {benchmark.machine()}")
