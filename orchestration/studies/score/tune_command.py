"""Command tune: the gains of a controller, by the same search for every one."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import nearest
from fmus.registry import block_names
from orchestration.cli import shared
from orchestration.cli.changes import CONTROLLER, NO_CHANGES, OF_LOOP, Changes, takes_changes
from orchestration.errors import ScenarioError
from orchestration.studies.score.command import (
    PROCESSORS,
    BoundOption,
    CasesOption,
    ProtocolOption,
    RatesOption,
    SeedsOption,
    WorkersOption,
    chosen_protocol,
    scored_controllers,
)

if TYPE_CHECKING:
    from orchestration.studies.score.closed_loop import Controller
    from orchestration.studies.score.protocol import Protocol
    from orchestration.studies.score.tune import Tuning

PANEL = "Controllers compared"


@takes_changes(**OF_LOOP, open_inputs="")
def tune(
    name: Annotated[
        str,
        typer.Argument(
            metavar="CONTROLLER",
            help="A controller of the protocol, an .fmu, a block, its .py file or a class FILE.py:Class.",
        ),
    ],
    free: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="Search this parameter within these limits, in its logarithm if both are positive; "
            "by default the gains that the protocol has for the controller.",
        ),
    ] = [],  # noqa: B006  (Typer copies it)
    evaluations: Annotated[
        int, typer.Option(metavar="NUMBER", help="Evaluations for each free gain and each seed.", min=1)
    ] = 100,
    seeds: SeedsOption = 5,
    workers: WorkersOption = PROCESSORS,
    out: shared.OutFolder = Path("results"),
    restart: Annotated[
        bool, typer.Option("--restart", help="Discard the evaluations of an earlier tuning of that name.")
    ] = False,
    bounds: BoundOption = [],  # noqa: B006
    cases: CasesOption = "",
    plants: Annotated[
        int,
        typer.Option(
            metavar="NUMBER", help="Compute the cost over the worst fifth of this many plants.", min=0
        ),
    ] = 0,
    protocol_file: ProtocolOption = None,
    no_rates: RatesOption = False,
    changes: Changes = NO_CHANGES,
) -> None:
    """Search the gains of least cost over cases of the protocol; an interrupted tuning continues.

    Writes CONTROLLER.toml, a parameter file.
    For example, l1-depth tune pid.py --free kp=1:100 searches one gain of a block in a Python file.
    """
    from orchestration.scenarios.free_parameter import parse
    from orchestration.studies.score import tune_problem
    from orchestration.studies.score.closed_loop import ClosedLoop
    from orchestration.studies.score.protocol import with_cost
    from orchestration.studies.score.tune import tune as search
    from orchestration.studies.score.tune_problem import evaluations as started

    if plants:
        shared.refuse_without_effect("--plants", {"--cases": cases})
    cost = tune_problem.cost_of_options(bounds, cases, plants)
    protocol = with_cost(chosen_protocol(changes, protocol_file), cost)
    controller = _controller(name, no_rates, changes, protocol)
    gains = parse(free)
    problem = tune_problem.problem_of(controller, protocol, gains)
    shared.check_writable(out)
    total, journals = evaluations * len(problem.gains) * (seeds + 1), list[Path]()
    while True:
        milliseconds = 1e3 * tune_problem.step_of(controller, protocol)
        journals.append(out / f"{controller.name}.{milliseconds:g}ms.tune.jsonl")
        title = f"tune {controller.name}, {milliseconds:g} ms"
        with (
            shared.progress(title, total, kept="evaluations") as bar,
            started(controller, protocol, workers, total) as evaluate,
        ):
            how = range(1, seeds + 1), evaluations, journals[-1], evaluate
            tuning = search(
                problem, *how, lambda n, cost, bar=bar: bar.advance(n, f"best {cost:.4g} cm"), restart
            )
        finer = tune_problem.at_enough_steps(tuning.best.gains, controller, protocol)
        if finer is controller:
            break
        controller = finer
        problem = tune_problem.problem_of(controller, protocol, gains)
    provenance = tune_problem.provenance(tuning, controller, protocol)
    path = out / f"{controller.name}.toml"
    with ClosedLoop(controller, protocol) as loop:
        tune_problem.write(tuning, loop.parameters(), provenance, path)
    for journal in journals:
        journal.unlink()
    print_gains(tuning, controller.name)
    change = 100.0 * provenance["change_at_half_the_step"]
    print(f"Half the step of {milliseconds:g} ms changes the error by {change:.2g} %.")
    print(path)


def _controller(
    name: str,
    no_rates: bool,
    changes: Changes,
    protocol: "Protocol",
) -> "Controller":
    """Returns the controller of the protocol, or of an FMU, with the changes of the options."""
    from orchestration.studies.score.closed_loop import built_in

    known = [*protocol.controllers, *block_names()]
    if name not in known and not (name.endswith((".py", ".fmu")) or ".py:" in name):
        raise ScenarioError(f"no controller {name!r}; {nearest(name, known)}")
    if name in protocol.controllers:
        mapped = changes.mapping.get(CONTROLLER)
        options = {
            "--no-rates": no_rates,
            "--map": mapped,
            "--open-inputs": changes.open_inputs,
        }
        shared.refuse_without_effect(f"{name}, a controller of the protocol", options)
    (chosen,) = scored_controllers([name], no_rates, changes)
    if name not in protocol.controllers:
        return chosen
    of_protocol = built_in(protocol, name)
    return replace(of_protocol, parameters={**of_protocol.parameters, **chosen.parameters})


def print_gains(tuning: "Tuning", name: str) -> None:
    """Prints the gains of a tuning, and whether evaluations or limits keep the cost from being lower."""
    gains, best = tuning.problem.gains, tuning.best.gains
    stopped = [gain.name for gain in gains if gain.is_at_a_limit(best[gain.name])]
    print(f"{name}: cost {tuning.best.cost:.4g} cm")
    for gain in gains:
        ending = ", at a limit" if gain.name in stopped else ""
        print(f"{gain.name} = {best[gain.name]:g} {gain.unit}, of {gain.low:g} to {gain.high:g}{ending}")
    seeds, last = len(tuning.searches), len(tuning.refinements[-1].curve)
    if not tuning.is_long_enough:
        expected = f"expected {tuning.fewest} or more"
        print(f"{last} evaluations are too few to tell whether the cost is flat: {expected}.")
        return
    verdict = (
        "The cost is flat." if tuning.is_flat else "The cost is not flat: more evaluations may lower it."
    )
    if tuning.flattening[0] == tuning.flattening[-1]:
        # a cost that did not fall at all says nothing of how flat it is
        verdict = "The search found nothing better after its first quarter."
    if stopped:
        verdict = (
            f"The cost is limited by the range of {', '.join(stopped)}: a wider one in --free may lower it."
        )
    print(
        f"{verdict} In the last half of {last} evaluations the cost fell by "
        f"{100 * tuning.improvement:.2g} %; the {f'median of {seeds} seeds' if seeds > 1 else 'one seed'} is "
        f"{100 * tuning.spread:.2g} % above the lowest, and after each quarter of its evaluations "
        f"{', '.join(f'{cost:.4g}' for cost in tuning.flattening)} cm."
    )
