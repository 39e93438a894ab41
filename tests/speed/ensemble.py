"""What a closed-loop step costs in an ensemble, beside the Simulator: `python -m tests.speed.ensemble`.

The plan of the Monte Carlo: other parameters, another seed and another constant input of each instance. CPU
time of whole runs in one thread, by turns, with the initial values and the recording of two signals.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Annotated

import typer
from rich.table import Table

from fmus import catalogue
from fmus.fmi_types import FmiValue
from fmus.lanes import LANES
from fmus.platforms import instruction_sets
from orchestration.master import Simulator
from orchestration.master.ensemble import Ensemble
from orchestration.scenarios import scenario
from orchestration.sweep.plan import Plan, plan
from tests.printing import print_tables


def varied(planned: Plan, count: int) -> dict[str, list[FmiValue]]:
    """Variable -> its values in the first samples of a plan."""
    samples = planned.block([i % planned.count for i in range(count)])
    return {name: [values[name] for values in samples] for name in samples[0]}


def nanoseconds(run: Callable[[], object], steps: int) -> float:
    """CPU time [ns] of this process for one of so many steps."""
    start = time.process_time()
    run()
    return 1e9 * (time.process_time() - start) / steps


def main(
    name: Annotated[str, typer.Argument(help="A scenario with a sweep.")] = "monte-carlo",
    counts: Annotated[list[int] | None, typer.Option("--instances", help="How many.")] = None,
    rounds: Annotated[int, typer.Option(help="Measurements of which the median is taken.", min=1)] = 5,
    markdown: Annotated[bool, typer.Option(help="Print the table of docs/performance.md.")] = False,
) -> None:
    """Measure ensembles of some sizes on each instruction set that this processor has."""
    chosen = scenario.load(scenario.find(name))
    catalogue.build_missing([*chosen.system.components.values()])
    planned = plan(chosen)
    experiment = replace(chosen.experiment, record=("plant.depth", "controller.demanded_force"))
    steps, sizes = experiment.step_count, counts or [1, 8, 64, 1024]
    figures: dict[tuple[str, int], list[float]] = {}
    ensembles = {kind: Ensemble(chosen.system, kind) for kind in instruction_sets()}
    with Simulator(chosen.system) as simulator:
        simulator.run(experiment)
        for _ in range(rounds):
            figures.setdefault(("Simulator", 1), []).append(
                nanoseconds(lambda: simulator.run(experiment), steps)
            )
            for kind, ensemble in ensembles.items():
                for count in sizes:
                    vary = varied(planned, count)
                    cost = nanoseconds(lambda: ensemble.run(experiment, vary), count * steps)  # noqa: B023
                    figures.setdefault((kind, count), []).append(cost)
    table = Table("", "Instances", "ns a step and instance", "of a Simulator", title="Ensembles")
    scalar = median(figures["Simulator", 1])
    for (kind, count), costs in figures.items():
        table.add_row(kind, str(count), f"{median(costs):.0f}", f"{median(costs) / scalar:.2f}")
    print_tables([table], markdown)
    print(f"{name}, {steps} steps, groups of {LANES} instances; medians of {rounds} rounds, one thread")
    for ensemble in ensembles.values():
        ensemble.close()


if __name__ == "__main__":
    typer.run(main)
