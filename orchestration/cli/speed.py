"""Command speed."""

import time
from statistics import median
from typing import Annotated

import typer

from orchestration.cli.shared import print_table, progress, shipped_scenarios

_SCENARIOS = ("nominal-extended", "example-extended")


def speed(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...",
            help=f"Names of shipped scenarios or .toml files; by default {' and '.join(_SCENARIOS)}.",
            autocompletion=shipped_scenarios,
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Take the median of so many runs.", min=1)] = 7,
) -> None:
    """Measure how fast this machine runs scenarios whose FMUs are loaded."""
    from rich.table import Table

    from orchestration.cli import chosen_scenario
    from orchestration.master import Simulator

    chosen = [chosen_scenario.load(name) for name in names or _SCENARIOS]
    table = Table(title=f"Median of {rounds} runs", title_justify="left")
    table.add_column("Scenario")
    for heading in ("Simulated, s", "Steps", "ms a run", "ns a step", "Times real time"):
        table.add_column(heading, justify="right")
    with progress("speed", rounds * len(chosen)) as bar:
        for scenario in chosen:
            experiment, elapsed = scenario.experiment, []
            with Simulator(scenario.system) as simulator:
                simulator.run(experiment)  # loads the FMUs
                for _ in range(rounds):
                    began = time.perf_counter()
                    simulator.run(experiment)
                    elapsed.append(time.perf_counter() - began)
                    bar.advance()
            simulated, seconds = experiment.stop_time - experiment.start_time, median(elapsed)
            steps = round(simulated / experiment.step_size)
            table.add_row(
                scenario.name,
                f"{simulated:g}",
                f"{steps}",
                f"{1e3 * seconds:.3g}",
                f"{1e9 * seconds / steps:.0f}",
                f"{simulated / seconds:.0f}",
            )
    print_table(table)
