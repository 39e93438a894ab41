"""Pareto fronts: the error of a law against the total variation of u, within a bound on the delay margin.

    python .ci/fronts.py

searches the laws on three vehicles (`STUDY`) and writes fronts.json and fronts.svg to results/VEHICLE, for
docs/explanation/comparison.md; --plant NAME is for one vehicle, --help shows the options. The journals stay:
the same command continues, and --laws adds laws.

Each seed searches the least error under a bound on the total variation, then under half of that bound, and
so on: the epsilon constraint (Haimes, Lasdon and Wismer, IEEE Trans. SMC 1(3), 1971). That is one budget; the
second one is as large and goes the same way back, so that a front after both has twice the evaluations. Each
search begins at the best gains that the seed has evaluated until then: at first the tuned ones, the start
values or those of the law's special case (`SPECIAL_CASES`). All laws have one step. A front is of the
evaluations that keep every bound and do not fail; those without the delay margin are taken out first.
"""

import json
import math
import re
import subprocess
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
from fmus.fmi.description import describe, start_value
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, OF_LOOP, PLANT, Changes, takes_changes
from orchestration.cli.commands import run_application
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.results.figures import GREY, LINES, MARKERS, WIDTH_IN, figure_style, write_figure
from orchestration.results.formats import FigureFormat
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.margins.fmu_margins import DELAYS
from orchestration.studies.score import tune_problem
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, built_in, tuned
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
from orchestration.studies.score.protocol import Protocol, on_vehicle, read_protocol, with_cost
from orchestration.studies.score.protocol_format import DELAY_MARGIN
from orchestration.studies.score.score_rows import delay_margin_of
from orchestration.studies.score.tune import Evaluate, Problem, SeedSearch, searching
from orchestration.studies.score.tune_problem import LARGEST, beyond
from orchestration.studies.vehicle import built

LEVELS = 5
"""Bounds on the total variation, each half of the one before: from that of the protocol to a 16th of it.

Gains as identified from the paper have 460 to 545 N in the nominal case. What is below the least bound counts
as that bound: nobody flies errors of centimetres for less.
"""
LARGEST_ERROR = 4.35
"""RMSE [cm] of the point from which hypervolumes are measured: published, of the paper's L1 with PI."""
LARGEST_SPREAD = 0.05
"""Of the least error within each bound: where each seed, and half of the evaluations, come that near, a front
is converged."""
SPECIAL_CASES: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "l1-pi": ("l1", {"proportional_gain": 0.0, "integral_gain": 0.0}),
    "l1-nonlinear-p": ("l1", {"large_error_gain": 0.0, "small_error_gain": 0.0}),
    "l1-pi-outside": ("l1-outside", {"proportional_gain": 0.0, "integral_gain": 0.0}),
    "pid-rates": ("pid", {"beta": 0.0}),
}
"""Law -> the law that it is with some of its gains."""
ALSO_FREE = {"theta_bound[1]": (0.01, 100.0), "sigma_bound": (0.1, 100.0)}
"""Bounds [N] of the unknown, free in all laws that adapt within them; `tune` leaves them as they are."""
STUDY: Mapping[str, tuple[Mapping[str, float], Sequence[str]]] = {
    "RovDepthPlant": ({}, ()),
    "RovHeavePitchPlant": (
        {"plant.thruster_efficiency[2]": 0.9},
        ("nominal", "buoyancy", "hold-step", "hold-sea"),
    ),
    "BlueRov2Plant": ({}, ()),
}
"""Vehicle -> its settings, and the cases of the cost in place of the protocol's."""
_TUTORIAL = Path(__file__).parent.parent / "docs" / "tutorials" / "python-controller.md"
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


def hypervolume(points: Iterable[Point], reference: Point, least: float = 0.0) -> float:
    """Returns the area between a front and a reference point, in decades of both: what the front betters.

    least: variation [N] that lower ones count as
    """
    within = [p._replace(variation=max(p.variation, least)) for p in points]
    front = [
        p for p in nondominated(within) if p.error < reference.error and p.variation < reference.variation
    ]
    edges = [*(p.variation for p in front), reference.variation]
    widths = (math.log10(right / left) for left, right in pairwise(edges))
    return sum(w * math.log10(reference.error / p.error) for w, p in zip(widths, front, strict=True))


def spread(hypervolumes: Sequence[float]) -> float:
    """Returns the range of the hypervolumes of the seeds, of their median; not a number of one seed."""
    middle = median(hypervolumes) if len(hypervolumes) > 1 else 0.0
    return (max(hypervolumes) - min(hypervolumes)) / middle if middle else math.nan


def least_errors(front: Iterable[Point], bounds: Sequence[float]) -> list[float]:
    """Returns the least error [cm] of a front within each bound; infinite without a point."""
    points = [*front]
    return [min((p.error for p in points if p.variation <= bound), default=math.inf) for bound in bounds]


def is_converged(half: Sequence[Sequence[float]], errors: Sequence[Sequence[float]]) -> bool:
    """Whether every seed, and half of the evaluations, come near the least error within every bound.

    half, errors: of each seed within each bound [cm], at half of the evaluations and at all
    """
    largest = (1.0 + LARGEST_SPREAD) * np.min(errors, axis=0)
    at_half, all_near = np.min(half, axis=0) <= largest, np.max(errors, axis=0) <= largest
    return bool(len(errors) > 1 and np.isfinite(largest).all() and at_half.all() and all_near.all())


def variation_of(row: Row) -> float:
    """Returns the largest total variation [N] of the cases of an evaluation; infinite if one failed to run.

    It is the number that `tune` bounds.
    """
    cases = row.get("metrics", {}).values()
    return max((case.get(_VARIATION, math.inf) for case in cases), default=math.inf)


def bounded_cost(row: Row, bound: float) -> float:
    """Returns the cost that `tune` has for an evaluation with a bound on its total variation."""
    cases = row.get("metrics", {}).values()
    excess = [beyond(case.get(_VARIATION, math.inf), bound) for case in cases]
    return min(row["cost"] + (sum(excess) / len(excess) if excess else 0.0), LARGEST)


def is_admitted(row: Row, largest: float) -> bool:
    """Whether an evaluation keeps every bound of the search and none of its runs failed."""
    return variation_of(row) <= largest and row["cost"] == row["error"] and not row["failed"]


def points_of(rows: Iterable[Row], largest: float) -> list[Point]:
    """Returns the evaluations that are admitted."""
    return [Point(row["error"], variation_of(row), row["gains"]) for row in rows if is_admitted(row, largest)]


def with_margin(points: Iterable[Point], has_margin: Callable[[Mapping[str, float]], bool]) -> list[Point]:
    """Returns the front of the points that have the delay margin: those without it hide no others."""
    left = [*points]
    while True:
        front = nondominated(left)
        lacking = [point for point in front if not has_margin(point.gains)]
        if not lacking:
            return front
        left = [point for point in left if point not in lacking]


class _Begin(SeedSearch):
    """The evaluations of the gains that searches begin at, which CMA-ES itself never evaluates."""

    def __init__(self, problem: Problem, begin: Sequence[Mapping[str, float]]) -> None:
        super().__init__(problem, 0, len(begin))
        self._begin_at = begin

    def ask(self) -> list[dict[str, Any]]:
        if self.rows:
            return []
        self.rows = [
            {"seed": 0, "evaluation": number, "gains": {**gains}}
            for number, gains in enumerate(self._begin_at)
        ]
        return self.rows

    def tell(self) -> None:
        """Learns nothing of them."""


def search_fronts(
    problem: Problem,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    largest: float,
    path: Path,
    evaluate: Evaluate,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    begin: Sequence[Mapping[str, float]] = (),
    special: Sequence[Row] = (),
) -> list[tuple[list[Row], list[Row]]]:
    """Returns of each seed its evaluations at half of the budget and at all of it.

    Interrupted or not, they are the same.

    largest: total variation [N] that is admitted; path: of the journal, which holds what is done
    begin: gains, at the best of which all seeds begin; by default anywhere
    special: evaluations of the law's special case, with the gains that make the law that case
    """
    bounds = [largest * 0.5**level for level in range(LEVELS)]
    evaluations = evaluations_per_gain * len(problem.gains)
    rows = {seed: [*special] for seed in seeds}
    half = list[list[Row]]()
    gains_of_special = [row["gains"] for row in special]
    about = {_VARIATION: bounds, "begin": [*begin], "special": gains_of_special}
    problem = replace(problem, tuned={**problem.tuned, **about})

    def started(row: Row) -> dict[str, float]:
        return {gain.name: gain.limited(row["gains"][gain.name]) for gain in problem.gains}

    with searching(problem, evaluations, path, evaluate, progress) as run_searches:
        if begin:
            first = _Begin(problem, begin)
            run_searches([first])
            rows = {seed: [*known, *first.rows] for seed, known in rows.items()}
        for level, bound in enumerate([*bounds, *reversed(bounds)]):
            cost, searches = partial(bounded_cost, bound=bound), list[SeedSearch]()
            if level == LEVELS:
                half = [[*known] for known in rows.values()]
            for seed, of_seed in rows.items():
                start = started(min(of_seed, key=cost)) if of_seed else None
                searches.append(SeedSearch(problem, seed + _APART * level, evaluations, start, cost))
            run_searches(searches)
            for seed, search in zip(rows, searches, strict=True):
                rows[seed] += search.rows
    return list(zip(half, rows.values(), strict=True))


def known_gains(protocol: Protocol, name: str, gains: Sequence[FreeParameter]) -> list[dict[str, float]]:
    """Returns gains within their ranges: those tuned for the vehicle, and the start values of the FMU."""
    start = {v.name: start_value(v) for v in describe(built(protocol.controllers[name].fmu)).modelVariables}
    found: Any = [{**start, **tuned(protocol, name).parameters}, start]
    return [{gain.name: gain.limited(float(values[gain.name])) for gain in gains} for values in found]


def free_gains(protocol: Protocol, name: str) -> list[FreeParameter]:
    """Returns the gains of a controller of the protocol, and bounds within which it adapts."""
    table = protocol.controllers[name]
    gains = [FreeParameter(gain, range.low, range.high) for gain, range in table.gains.items()]
    if table.gains.keys() & {"adaptation_gain", "estimate_gain"}:
        known = {v.name for v in describe(built(table.fmu)).modelVariables}
        # of two numbers or of one
        names = {n.partition("[")[0] if n not in known else n: ends for n, ends in ALSO_FREE.items()}
        gains += [FreeParameter(gain, *ends) for gain, ends in names.items()]
    return gains


def front_of_law(
    protocol: Protocol,
    name: str,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    workers: int,
    path: Path,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    special: Sequence[Row] = (),
) -> tuple[dict[str, Any], list[Row]]:
    """Returns the front of a controller of the protocol as plain data, and the evaluations on it.

    Its step is that of the protocol, as of every law. Each point has its delay margin.
    """
    largest = protocol.tables.cost.bounds.get(_VARIATION, math.inf)
    if not math.isfinite(largest):
        raise ScenarioError(f"the cost bounds no {_VARIATION}: expected --bound {_VARIATION}=NUMBER")
    protocol = with_cost(protocol, {"bounds": {_VARIATION: _ANY}})
    parameters = {**built_in(protocol, name).parameters, **protocol.controllers[name].parameters}
    controller = replace(tuned(protocol, name), parameters=parameters, step=0.0)
    problem = tune_problem.problem_of(controller, protocol, free_gains(protocol, name))
    total = 2 * LEVELS * len(seeds) * evaluations_per_gain * len(problem.gains)
    with tune_problem.evaluations(controller, protocol, workers, total) as evaluate:
        how = largest, path, evaluate, progress, known_gains(protocol, name, problem.gains), special
        budgets = search_fronts(problem, seeds, evaluations_per_gain, *how)
    reference, bounds = Point(LARGEST_ERROR, largest), [largest * 0.5**level for level in range(LEVELS)]
    bound = protocol.tables.cost.bounds.get(DELAY_MARGIN, 0.0)
    with ClosedLoop(controller, protocol) as loop:
        margins = dict[str, float]()

        def has_margin(gains: Mapping[str, float]) -> bool:
            key = repr(gains)
            if bound and key not in margins:
                margins[key] = _margin(loop, gains, bound)
            return not bound or margins[key] >= bound

        fronts = [[with_margin(points_of(rows, largest), has_margin) for rows in both] for both in budgets]
        half, errors = (
            [least_errors(front, bounds) for front in of_budget] for of_budget in zip(*fronts, strict=True)
        )
        volumes = [hypervolume(front, reference, bounds[-1]) for _, front in fronts]
        front, points = nondominated(point for both in fronts for point in both[1]), list[dict[str, Any]]()
        for i in sorted({*np.linspace(0, len(front) - 1, min(len(front), _MOST_POINTS)).round().astype(int)}):
            error, variation, gains = front[i]
            point = {"error": error, _VARIATION: variation, DELAY_MARGIN: _margin(loop, gains)}
            change = tune_problem.change_at_half_the_step(gains, controller, protocol)
            points.append({**point, "gains": gains, "change_at_half_the_step": change})
    on_front = {repr(point.gains) for point in front}
    law = {
        "name": name,
        "title": controller.title,
        "gains": len(problem.gains),
        "hypervolumes": volumes,
        "spread": None if math.isnan(spread(volumes)) else spread(volumes),
        "least_errors_at_half": half,
        "least_errors": errors,
        "is_converged": is_converged(half, errors),
        "points": points,
    }
    rows = {repr(row["gains"]): row for _, found in budgets for row in found}
    return law, [row for key, row in rows.items() if key in on_front]


def _margin(loop: ClosedLoop, gains: Mapping[str, float], largest: float = DELAYS.largest) -> float:
    """Returns the delay margin [s] in the nominal case, as far as the largest delay; nan of a failed run."""
    try:
        return delay_margin_of(loop, loop.protocol.nominal, gains, largest)
    except OrchestrationError:
        return math.nan


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


def tutorial_mpc(protocol: Protocol, folder: Path) -> dict[str, Any]:
    """Returns a row without a front: the model predictive control of the tutorial, not searched."""
    (program,) = re.findall("```python\n(# mpc.py\n.*?)```", _TUTORIAL.read_text(encoding="utf-8"), re.S)
    path = folder / "mpc.py"
    path.write_text(program, encoding="utf-8")
    with ClosedLoop(Controller("mpc", f"{path}:Mpc"), protocol) as loop:
        (row,) = tune_problem.costs(loop, [{}])
        margin = _margin(loop, {})
    return {
        "title": "MPC of the tutorial",
        "error": row["error"],
        _VARIATION: variation_of(row),
        DELAY_MARGIN: margin,
    }


def fronts_of_vehicle(
    protocol: Protocol, laws: Sequence[str], seeds: int, evaluations: int, workers: int, out: Path
) -> dict[str, Any]:
    """Returns the fronts of laws on the vehicle of a protocol as a document, written after each law."""
    names = [name for name in protocol.controllers if name in {*laws, *(_special(law) for law in laws)}]
    gains = sum(len(free_gains(protocol, name)) for name in names)
    rows, found = dict[str, list[Row]](), list[dict[str, Any]]()
    document = {
        "vehicle": protocol.vehicle.name,
        "settings": dict(protocol.vehicle.settings),
        "revision": revision(),
        "protocol": protocol.version,
        "statement": protocol.statement,
        "cost": protocol.tables.cost.model_dump(),
        "effort": {
            "evaluations_per_gain_bound_and_seed": evaluations,
            "budgets": 2,
            "bounds": LEVELS,
            "seeds": [*range(1, seeds + 1)],
            "step": tune_problem.step_of(built_in(protocol, names[0]), protocol),
        },
        "units": {"error": "cm", _VARIATION: "N", DELAY_MARGIN: "s", "step": "s"},
        "hypervolume": f"in decades of both, from {LARGEST_ERROR:g} cm and the bound on the variation",
        "without_front": list[dict[str, Any]](),
        "laws": found,
    }

    def write() -> None:
        write_text_atomically(out / "fronts.json", f"{json.dumps(document, indent=1)}\n")

    with shared.progress("fronts", 2 * LEVELS * seeds * evaluations * gains, kept="evaluations") as bar:
        for name in names:
            of_special, changed = SPECIAL_CASES.get(name, ("", {}))
            (tuned_gains, _) = known_gains(protocol, name, free_gains(protocol, name))
            # gains that the special case does not have are its own choice: they change nothing there
            special = [
                {**row, "gains": {**tuned_gains, **row["gains"], **changed}}
                for row in rows.get(of_special, ())
            ]
            law, rows[name] = front_of_law(
                protocol,
                name,
                range(1, seeds + 1),
                evaluations,
                workers,
                out / f"{name}.front.jsonl",
                lambda done, _: bar.advance(done),
                special,
            )
            found.append(law)
            write()
    # its model has the numbers of the paper's vehicle
    if protocol.vehicle.is_of_base:
        document["without_front"].append(tutorial_mpc(protocol, out))
        write()
    return document


def _special(law: str) -> str:
    return SPECIAL_CASES.get(law, ("", {}))[0]


@takes_changes(**OF_LOOP)
def main(
    laws: Annotated[str, typer.Option(metavar="NAME,...", help="Search the fronts of these laws only.")] = "",
    bounds: BoundOption = [],  # noqa: B006  (Typer copies it)
    cases: CasesOption = "",
    seeds: SeedsOption = 5,
    evaluations: Annotated[
        int,
        typer.Option(
            metavar="NUMBER",
            help="Evaluations for each free gain, each seed, each bound and each of two budgets.",
            min=1,
        ),
    ] = 100,
    workers: WorkersOption = PROCESSORS,
    out: shared.OutFolder = Path("results"),
    changes: Changes = NO_CHANGES,
    protocol_file: ProtocolOption = None,
) -> None:
    """Search each law's Pareto front of error and total variation; write fronts.json and fronts.svg.

    They are of three vehicles, or of the one that --plant names. The same command continues.
    """
    scored_controllers([], False, changes)
    shared.check_writable(out)
    options = tune_problem.cost_of_options(bounds, cases)
    for vehicle in [changes.components[PLANT]] if PLANT in changes.components else STUDY:
        settings, of_study = STUDY.get(vehicle, ({}, ()))
        # the base's own vehicle is that of the protocol
        is_other = vehicle != read_protocol().vehicle.name
        given = replace(changes, settings={PLANT: vehicle, **settings, **changes.settings})
        protocol = chosen_protocol(given if is_other else NO_CHANGES, protocol_file)
        protocol = with_cost(on_vehicle(protocol), {"cases": of_study} if of_study else {})
        protocol = with_cost(protocol, options)
        names = [built_in(protocol, n).name for n in tune_problem.listed(laws) or protocol.controllers]
        folder = out / vehicle
        folder.mkdir(parents=True, exist_ok=True)
        document = fronts_of_vehicle(protocol, names, seeds, evaluations, workers, folder)
        figures = front_figure({vehicle: document["laws"]}, folder / "fronts")
        for law in document["laws"]:
            word = "converged" if law["is_converged"] else "not converged"
            print(f"{law['title']}: hypervolume {median(law['hypervolumes']):.3g}, {word}")
        print(*(folder / "fronts.json", *figures), sep="\n")


def revision() -> str:
    """Returns the last commit of the packages that run, with "-dirty" if they differ from it."""
    root = Path(__file__).parent.parent
    packages = [
        "--",
        *(str(root / name) for name in ("controller_fmu", "fmus", "orchestration", "plant_fmu")),
    ]

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments, *packages]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    return git("log", "-1", "--format=%h", "--abbrev=12") + ("-dirty" if git("status", "--porcelain") else "")


def application() -> typer.Typer:
    """Returns the command line of this script."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    return app


if __name__ == "__main__":
    sys.exit(run_application(application, sys.argv[1:], Path(__file__).name))
