"""What a closed-loop step costs in an ensemble, beside the Simulator.

The plan of the Monte Carlo: other parameters, another seed and another constant input of each instance. CPU
time of whole runs in one thread, by turns, with the initial values and the recording of two signals.
"""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from statistics import median

from fmus.build import builder
from fmus.fmi.variable_types import FmiValue
from fmus.platforms import instruction_sets
from orchestration.many.ensemble import Ensemble
from orchestration.many.lane_library import LANES
from orchestration.run import Simulator
from orchestration.scenarios import scenario
from orchestration.sweep.plan import Plan, plan
from tests.speed.part import Goal, Options, Part, Table, spread

SCENARIO = "monte-carlo"
_TARGET = ("x86-64-v3", 64)
_SIZES = (1, 8, 64, 1024)
_Figures = dict[tuple[str, int], list[float]]


def varied(planned: Plan, count: int) -> dict[str, list[FmiValue]]:
    """Variable -> its values in the first samples of a plan."""
    samples = planned.block([i % planned.count for i in range(count)])
    return {name: [values[name] for values in samples] for name in samples[0]}


def nanoseconds(run: Callable[[], object], steps: int) -> float:
    """CPU time [ns] of this process for one of so many steps."""
    start = time.process_time()
    run()
    return 1e9 * (time.process_time() - start) / steps


def costs(sizes: tuple[int, ...], rounds: int) -> _Figures:
    """(instruction set, instances) -> ns a step and instance, a value a round."""
    chosen = scenario.load(scenario.find(SCENARIO))
    builder.build_missing([*chosen.system.components.values()])
    planned = plan(chosen)
    experiment = replace(chosen.experiment, record=("plant.depth", "controller.demanded_force"))
    steps = experiment.step_count
    figures: _Figures = {("Simulator", 1): []}
    with ExitStack() as stack:
        simulator = stack.enter_context(Simulator(chosen.system))
        ensembles = {kind: Ensemble(chosen.system, kind) for kind in instruction_sets()}
        for ensemble in ensembles.values():
            stack.callback(ensemble.close)
        simulator.run(experiment)
        for _ in range(rounds):
            figures["Simulator", 1].append(nanoseconds(lambda: simulator.run(experiment), steps))
            for kind, ensemble in ensembles.items():
                for count in sizes:
                    vary = varied(planned, count)
                    cost = nanoseconds(lambda: ensemble.run(experiment, vary), count * steps)  # noqa: B023
                    figures.setdefault((kind, count), []).append(cost)
    return figures


def measure(options: Options) -> Part:
    """Ensembles of some sizes on each instruction set that this processor has."""
    figures = costs((LANES,) if options.quick else _SIZES, options.rounds(5))
    scalar = median(figures["Simulator", 1])
    rows = [
        (kind, str(count), spread(taken, 0), f"{median(taken) / scalar:.2f}")
        for (kind, count), taken in figures.items()
    ]
    headings = ("", "instances", "ns a step and instance", "of a Simulator")
    goals = (
        [
            Goal(
                f"a closed-loop step in an ensemble of {_TARGET[1]}, {_TARGET[0]}",
                "80 ns",
                f"{median(figures[_TARGET]):.0f} ns",
                "did not exist",
                others=f"a `Simulator` {scalar:.0f} ns",
            )
        ]
        if _TARGET in figures
        else []
    )
    return Part([Table("ensemble", headings, rows)], goals)
