"""Pareto fronts: the error of a law against the total variation of u, within a bound on the delay margin.

    python .ci/fronts.py --laws l1,pid --workers 2

writes fronts.json and fronts.svg to results, for docs/explanation/comparison.md; --help shows the options.

Each seed searches the least error under a bound on the total variation, then under half of that bound, and
so on: the epsilon constraint (Haimes, Lasdon and Wismer, IEEE Trans. SMC 1(3), 1971). The first search begins
at the tuned gains, each other one at the best gains that the seed has evaluated until then. The front is of
all evaluations of all seeds that keep the other bounds of the cost and do not fail.
"""

import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from matplotlib.figure import Figure

from fmus.files import write_text_atomically
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, OF_LOOP, Changes, takes_changes
from orchestration.cli.commands import run_application
from orchestration.errors import ScenarioError
from orchestration.results.figures import GREY, LINES, MARKERS, WIDTH_IN, figure_style, write_figure
from orchestration.results.formats import FigureFormat
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.score import tune_problem
from orchestration.studies.score.closed_loop import ClosedLoop, built_in, tuned
from orchestration.studies.score.command import (
    PROCESSORS,
    BoundOption,
    CasesOption,
    ProtocolOption,
    SeedsOption,
    WorkersOption,
    chosen_protocol,
    scored_controllers,
)
from orchestration.studies.score.protocol import Protocol, with_cost
from orchestration.studies.score.protocol_format import DELAY_MARGIN
from orchestration.studies.score.score_rows import delay_margin_of
from orchestration.studies.score.tune import Evaluate, Problem, SeedSearch, searching
from orchestration.studies.score.tune_problem import LARGEST, beyond

LEVELS = 6
"""Bounds on the total variation, each half of the one before: from that of the protocol to a 32nd of it."""
LARGEST_ERROR = 10.0
"""RMSE [cm] of the point from which hypervolumes are measured: that of the paper's L1, untuned.

Below it what is beyond a bound costs more than the error falls with the variation (`tune_problem.beyond`).
"""
LARGEST_SPREAD = 0.05
"""Of the hypervolumes of the seeds, of their median: where it is less, the seeds found one front."""
_MOST_POINTS = 16  # of a front that is written: each is checked by some twenty runs
_APART = 1000  # of the seeds of searches that follow one another
_ANY = 1e12  # N, above every total variation: it is measured, and bounded by `bounded_cost`
_VARIATION = "total_variation"
Row = Mapping[str, Any]


class Point(NamedTuple):
    """A trade-off: error [cm], total variation of u [N], and the gains that have it."""

    error: float
    variation: float
    gains: Mapping[str, float] = {}


def nondominated(points: Iterable[Point]) -> list[Point]:
    """Returns the points that no other one betters in both, by their total variation."""
    front: list[Point] = []
    for point in sorted(points, key=lambda point: (point.variation, point.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def hypervolume(points: Iterable[Point], reference: Point) -> float:
    """Returns the area between a front and a reference point, in decades of both: what the front betters."""
    front = [
        p for p in nondominated(points) if p.error < reference.error and p.variation < reference.variation
    ]
    edges = [*(p.variation for p in front), reference.variation]
    widths = (math.log10(right / left) for left, right in pairwise(edges))
    return sum(w * math.log10(reference.error / p.error) for w, p in zip(widths, front, strict=True))


def spread(hypervolumes: Sequence[float]) -> float:
    """Returns the range of the hypervolumes of the seeds, of their median; not a number of one seed."""
    middle = median(hypervolumes) if len(hypervolumes) > 1 else 0.0
    return (max(hypervolumes) - min(hypervolumes)) / middle if middle else math.nan


def variation_of(row: Row) -> float:
    """Returns the mean total variation [N] over the cases of an evaluation; infinite if one failed to run."""
    cases = row.get("metrics", {}).values()
    return sum(case.get(_VARIATION, math.inf) for case in cases) / len(cases) if cases else math.inf


def bounded_cost(row: Row, bound: float) -> float:
    """Returns the cost of an evaluation with a bound on its total variation."""
    return min(row["cost"] + beyond(variation_of(row), bound), LARGEST)


def admitted(rows: Iterable[Row], largest: float) -> list[Point]:
    """Returns the evaluations that keep every bound, no run of which failed."""
    return [
        Point(row["error"], variation, row["gains"])
        for row in rows
        if (variation := variation_of(row)) <= largest and row["cost"] == row["error"] and not row["failed"]
    ]


def search_front(
    problem: Problem,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    largest: float,
    path: Path,
    evaluate: Evaluate,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    begin: Mapping[str, float] | None = None,
) -> list[list[Point]]:
    """Returns the front of each seed; interrupted or not, the same.

    largest: total variation [N] that is admitted; path: of the journal, which holds what is done
    begin: the gains that all seeds begin at, by default anywhere
    """
    bounds = [largest * 0.5**level for level in range(LEVELS)]
    evaluations, rows = evaluations_per_gain * len(problem.gains), {seed: list[Row]() for seed in seeds}
    problem = replace(problem, tuned={**problem.tuned, _VARIATION: bounds, "begin": begin})
    with searching(problem, evaluations, path, evaluate, progress) as run_searches:
        for level, bound in enumerate(bounds):
            cost, searches = partial(bounded_cost, bound=bound), list[SeedSearch]()
            for seed, found in rows.items():
                start = min(found, key=cost)["gains"] if found else begin
                searches.append(SeedSearch(problem, seed + _APART * level, evaluations, start, cost))
            run_searches(searches)
            for seed, search in zip(rows, searches, strict=True):
                rows[seed] += search.rows
    return [nondominated(admitted(found, largest)) for found in rows.values()]


def tuned_for(protocol: Protocol, name: str, gains: Sequence[FreeParameter]) -> dict[str, float] | None:
    """Returns the tuned gains of a controller for the vehicle, within their ranges; None if it has none."""
    found: Mapping[str, Any] = tuned(protocol, name).parameters
    if not all(gain.name in found for gain in gains):
        return None
    return {gain.name: gain.limited(float(found[gain.name])) for gain in gains}


def front_of_law(
    protocol: Protocol,
    name: str,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    workers: int,
    path: Path,
    progress: Callable[[int, float], None] = lambda done, cost: None,
) -> dict[str, Any]:
    """Returns the front of a controller of the protocol as plain data, at the step that its tuned gains need.

    Each point has its delay margin; one that is not quiet with a shorter delay than the bound is left out.
    """
    largest = protocol.tables.cost.bounds.get(_VARIATION, math.inf)
    if not math.isfinite(largest):
        raise ScenarioError(f"the cost bounds no {_VARIATION}: expected --bound {_VARIATION}=NUMBER")
    protocol = with_cost(protocol, {"bounds": {_VARIATION: _ANY}})
    controller = replace(tuned(protocol, name), parameters=protocol.controllers[name].parameters)
    problem = tune_problem.problem_of(controller, protocol)
    total = LEVELS * len(seeds) * evaluations_per_gain * len(problem.gains)
    with tune_problem.evaluations(controller, protocol, workers, total) as evaluate:
        how = largest, path, evaluate, progress, tuned_for(protocol, name, problem.gains)
        fronts = search_front(problem, seeds, evaluations_per_gain, *how)
    volumes = [hypervolume(front, Point(LARGEST_ERROR, largest)) for front in fronts]
    front, points = nondominated(point for front in fronts for point in front), list[dict[str, Any]]()
    for i in sorted({*np.linspace(0, len(front) - 1, min(len(front), _MOST_POINTS)).round().astype(int)}):
        error, variation, gains = front[i]
        at_gains = replace(controller, parameters={**controller.parameters, **gains})
        with ClosedLoop(at_gains, protocol) as loop:
            margin = delay_margin_of(loop, protocol.nominal)
        if margin >= protocol.tables.cost.bounds.get(DELAY_MARGIN, 0.0):
            point = {"error": error, _VARIATION: variation, DELAY_MARGIN: margin, "gains": gains}
            change = tune_problem.change_at_half_the_step(gains, controller, protocol)
            points.append({**point, "change_at_half_the_step": change})
    return {
        "name": name,
        "title": controller.title,
        "step": tune_problem.step_of(controller, protocol),
        "hypervolumes": volumes,
        "spread": None if math.isnan(spread(volumes)) else spread(volumes),
        "points": points,
    }


def front_figure(
    fronts: Mapping[str, Sequence[Mapping[str, Any]]],
    path: Path,
    formats: Sequence[FigureFormat] = (FigureFormat.SVG,),
) -> list[Path]:
    """Draws the fronts of all laws on each vehicle: error against total variation, delay margin as colour.

    fronts: vehicle -> laws, each as `fronts.json` has it
    """
    drawn = {vehicle: [law for law in laws if law["points"]] for vehicle, laws in fronts.items()}
    names = list(dict.fromkeys(law["name"] for laws in drawn.values() for law in laws))
    margins = [point["delay_margin"] for laws in drawn.values() for law in laws for point in law["points"]]
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, WIDTH_IN), layout="constrained")
        panels = list(figure.subplots(1, len(fronts), squeeze=False)[0])
        shown: dict[str, Any] = {}
        for panel, (vehicle, laws) in zip(panels, drawn.items(), strict=True):
            panel.set(xscale="log", yscale="log", xlabel="Total variation [N]", title=vehicle)
            for law in laws:
                index, columns = names.index(law["name"]), ("total_variation", "error", "delay_margin")
                x, y, colour = ([point[column] for point in law["points"]] for column in columns)
                panel.plot(x, y, color=GREY, linestyle=LINES[index % len(LINES)], linewidth=0.5)
                dots = panel.scatter(x, y, s=14.0, c=colour, marker=MARKERS[index % len(MARKERS)])
                dots.set_clim(min(margins), max(margins))
                share = law["spread"] if len(fronts) == 1 else None
                apart = "" if share is None else f", seeds {100.0 * share:.2g} % apart"
                shown[f"{law['title']}{apart}"] = dots
        panels[0].set_ylabel("RMSE [cm]")
        if shown:
            label = "Delay margin [s]"
            figure.colorbar(shown[next(iter(shown))], ax=panels, label=label, location="top", shrink=0.5)
            figure.legend([*shown.values()], [*shown], loc="outside lower center", ncols=2)
        return write_figure(figure, path, formats)


@takes_changes(**OF_LOOP)
def main(
    laws: Annotated[str, typer.Option(metavar="NAME,...", help="Search the fronts of these laws only.")] = "",
    bounds: BoundOption = [],  # noqa: B006  (Typer copies it)
    cases: CasesOption = "",
    seeds: SeedsOption = 5,
    evaluations: Annotated[
        int,
        typer.Option(
            metavar="NUMBER", help="Evaluations for each free gain, each seed and each bound.", min=1
        ),
    ] = 40,
    workers: WorkersOption = PROCESSORS,
    out: shared.OutFolder = Path("results"),
    changes: Changes = NO_CHANGES,
    protocol_file: ProtocolOption = None,
) -> None:
    """Search each law's Pareto front of error and total variation; write fronts.json and fronts.svg.

    Their journals are removed at the end; until then the same command continues.
    """
    protocol = with_cost(chosen_protocol(changes, protocol_file), tune_problem.cost_of_options(bounds, cases))
    scored_controllers([], False, changes)
    shared.check_writable(out)
    names = [built_in(protocol, name).name for name in tune_problem.listed(laws) or protocol.controllers]
    journals = {name: out / f"{name}.front.jsonl" for name in names}
    total = LEVELS * seeds * evaluations * sum(len(protocol.controllers[name].gains) for name in names)
    with shared.progress("fronts", total, kept="evaluations") as bar:
        how = range(1, seeds + 1), evaluations, workers
        found = [
            front_of_law(protocol, name, *how, path, lambda done, _: bar.advance(done))
            for name, path in journals.items()
        ]
    document = {
        "vehicle": protocol.vehicle.name,
        "settings": dict(protocol.vehicle.settings),
        "protocol": protocol.version,
        "statement": protocol.statement,
        "cost": protocol.tables.cost.model_dump(),
        "effort": {"evaluations_per_gain_bound_and_seed": evaluations, "bounds": LEVELS, "seeds": seeds},
        "units": {"error": "cm", "total_variation": "N", "delay_margin": "s", "step": "s"},
        "hypervolume": f"in decades of both, from {LARGEST_ERROR:g} cm and the bound on the variation",
        "laws": found,
    }
    write_text_atomically(out / "fronts.json", f"{json.dumps(document, indent=1)}\n")
    figures = front_figure({protocol.vehicle.name: found}, out / "fronts")
    for path in journals.values():
        path.unlink()
    for law in found:
        differ = " (they differ)" if (law["spread"] or 0.0) > LARGEST_SPREAD else ""
        seeds_apart = "" if law["spread"] is None else f", seeds {100 * law['spread']:.2g} % apart{differ}"
        print(f"{law['title']}: hypervolume {median(law['hypervolumes']):.3g}{seeds_apart}")
    print(*(out / "fronts.json", *figures), sep="\n")


def application() -> typer.Typer:
    """Returns the command line of this script."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    return app


if __name__ == "__main__":
    sys.exit(run_application(application, sys.argv[1:], Path(__file__).name))
