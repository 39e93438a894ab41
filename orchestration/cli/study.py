"""Command tune: gains for a controller by the same search as for every other one."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestration.cli.changes import CONTROLLER, Changes, MapOption, OpenInputsOption
from orchestration.cli.interrupts import INTERRUPTED
from orchestration.cli.shared import OutFolder, fail, print_table, progress

if TYPE_CHECKING:
    from orchestration.study.loop import Controller
    from orchestration.study.protocol import Protocol
    from orchestration.study.tune import Tuning


def tune(
    name: Annotated[
        str,
        typer.Argument(metavar="CONTROLLER", help="Of the protocol; or an .fmu, a block or its .py file."),
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
        int, typer.Option(metavar="NUMBER", help="Evaluate so many for each free gain and seed.", min=1)
    ] = 80,
    seeds: Annotated[int, typer.Option(metavar="NUMBER", help="Search from so many seeds.", min=1)] = 5,
    workers: Annotated[int, typer.Option(help="Run so many processes.", min=1)] = os.cpu_count() or 1,
    out: OutFolder = Path("results"),
    restart: Annotated[
        bool, typer.Option("--restart", help="Discard the evaluations of an earlier tuning of that name.")
    ] = False,
    league: Annotated[
        str, typer.Option(metavar="NAME", help="Of a controller that is not of the protocol.")
    ] = "position",
    settings: Annotated[
        list[str],
        typer.Option("--set", metavar="NAME=VALUE", help="Set this parameter for all evaluations."),
    ] = [],  # noqa: B006
    mapped: MapOption = [],  # noqa: B006
    open_inputs: OpenInputsOption = None,
) -> None:
    """Search the gains of least cost on practice cases of the protocol; an interrupted tuning continues."""
    from orchestration.scenarios.worker_pool import worker_pool
    from orchestration.study import tune_file, tune_problem, tune_space
    from orchestration.study.protocol import read_protocol
    from orchestration.study.tune import tune as search

    protocol = read_protocol()
    fixed = [f"{CONTROLLER}.{setting}" for setting in settings]
    controller = _controller(name, league, Changes.of_options("", fixed, mapped, open_inputs), protocol)
    problem = tune_problem.problem_of(controller, protocol, [tune_space.parse(text) for text in free])
    journal = out / f"{controller.name}.tune.jsonl"
    if restart:
        journal.unlink(missing_ok=True)
    total, done = evaluations * len(problem.gains) * seeds, 0
    with progress(f"tune {controller.name}", total) as bar, worker_pool(workers) as submit:

        def advance(count: int, cost: float) -> None:
            nonlocal done
            done += count
            bar.advance(count, f"best {cost:.4g} cm")

        try:
            tuning = search(problem, range(1, seeds + 1), evaluations, journal, submit, advance)
        except KeyboardInterrupt:
            fail(
                f"interrupted: {done} of {total} evaluations are done and kept; the same command continues",
                INTERRUPTED,
            )
    provenance = tune_problem.provenance(tuning, controller, protocol)
    path = out / f"{controller.name}.toml"
    tune_file.write(tuning, controller.parameters, provenance, path)
    journal.unlink()
    _print_gains(tuning, controller.name)
    print(path)


def _controller(name: str, league: str, changes: Changes, protocol: "Protocol") -> "Controller":
    """The controller of the protocol, or of an FMU, with what the options change."""
    from fmus import catalogue
    from orchestration.study.loop import Controller, built_in

    if name in protocol.controllers:
        chosen = built_in(protocol, name)
    else:
        fmu = str(catalogue.fmu_of_file(Path(name))) if name.endswith(".py") else name
        chosen = Controller(Path(name).stem, fmu, league)
    settings = {variable.partition(".")[2]: value for variable, value in changes.settings.items()}
    return replace(
        chosen,
        parameters={**chosen.parameters, **settings},
        mapping=changes.mapping.get(CONTROLLER, {}),
        open_inputs=str(changes.open_inputs or chosen.open_inputs),
    )


def _print_gains(tuning: "Tuning", name: str) -> None:
    from rich.table import Table

    table = Table(title=f"{name}: cost {tuning.best.cost:.4g} cm")
    for heading in ("Gain", "Value", "Limits", ""):
        table.add_column(heading, justify="left" if heading in ("Gain", "") else "right")
    for gain in tuning.problem.gains:
        value = tuning.best.gains[gain.name]
        limits = f"{gain.low:g} to {gain.high:g} {gain.unit}".rstrip()
        table.add_row(gain.name, f"{value:g}", limits, "at a limit" if gain.is_at_a_limit(value) else "")
    print_table(table)
    verdict = "flat" if tuning.is_flat else "not flat: more evaluations may lower it"
    print(
        f"The cost is {verdict}. In the last quarter of {len(tuning.best.curve)} evaluations it fell by at "
        f"most {100 * tuning.improvement:.2g} %; the {len(tuning.searches)} seeds differ by "
        f"{100 * tuning.spread:.2g} %."
    )
