"""Commands score and compare: controllers in every case of the protocol, beside the built-in ones or all."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import MissingExtraError
from fmus.files import write_text_atomically
from fmus.operating_system import usable_processors
from orchestration.cli import shared
from orchestration.cli.changes import CONTROLLER, NO_CHANGES, OF_LOOP, PLANT, Changes, fmu_name, takes_changes
from orchestration.errors import ScenarioError
from orchestration.system.open_inputs import OpenInputs

if TYPE_CHECKING:
    from orchestration.studies.score.closed_loop import Controller
    from orchestration.studies.score.protocol import Protocol
    from orchestration.studies.score.score import ScoreResult

PANEL = "Controllers compared"
FullOption = Annotated[
    bool,
    typer.Option(
        "--full", help="Run 300 plants and most cases 24 times, too, with intervals and comparisons."
    ),
]
SeedOption = Annotated[
    int | None,
    typer.Option(
        metavar="NUMBER",
        help="Seed of noise, times and plants; the same seed repeats a score. By default it is random.",
        min=0,
    ),
]
RatesOption = Annotated[
    bool, typer.Option("--no-rates", help="Connect the reference alone, not its derivatives.")
]
BoundOption = Annotated[
    list[str],
    typer.Option("--bound", metavar="METRIC=NUMBER", help="Limit a metric, or delay_margin [s] from below."),
]
CasesOption = Annotated[
    str, typer.Option("--cases", metavar="NAME,...", help="Compute the cost over these protocol cases.")
]
SeedsOption = Annotated[int, typer.Option(metavar="NUMBER", help="Number of seeds of the search.", min=1)]
PROCESSORS = usable_processors()
WorkersOption = Annotated[int, typer.Option(help="Number of processes.", min=1)]
ProtocolOption = Annotated[
    Path | None,
    typer.Option("--protocol", metavar="FILE", help="Follow this protocol, not the one that ships."),
]


@takes_changes(**OF_LOOP, open_inputs="", parameters="")
def score(
    controllers: Annotated[
        list[str],
        typer.Argument(
            metavar="CONTROLLER",
            help="An .fmu, a block, its .py file or a class FILE.py:Class; or several.",
        ),
    ],
    no_rates: RatesOption = False,
    full: FullOption = False,
    seed: SeedOption = None,
    out: shared.OutFolder = Path("results"),
    changes: Changes = NO_CHANGES,
    protocol_file: ProtocolOption = None,
    timeout: Annotated[
        float | None,
        typer.Option(metavar="S", help="End a run that takes longer; by default the protocol's."),
    ] = None,
    workers: WorkersOption = PROCESSORS,
) -> None:
    """Score a controller on the simulated vehicle: a summary, score.json and an interactive page.

    For example, l1-depth score PidDepthController writes results/score.json and results/score.html.
    """
    from orchestration.studies.score import score as scoring
    from orchestration.studies.score.score_rendering import terminal_text

    protocol = chosen_protocol(changes, protocol_file)
    chosen = scored_controllers(controllers, no_rates, changes)
    shared.check_writable(out)
    total = scoring.run_count(len(chosen), protocol, full)
    with shared.progress("score", total) as bar:
        result = scoring.score_controllers(
            chosen,
            protocol,
            full=full,
            seed=seed,
            timeout=timeout,
            workers=workers,
            progress=bar.advance,
        )
    print(terminal_text(result.document, shared.console()), flush=True)
    scored = result.document.scored
    write_score(result, result, out / "score.json", f"Score of {', '.join(row.title for row in scored)}")
    if all(case.failed for row in scored for case in row.cases.values()):
        name, case = next(iter(scored[0].cases.items()))
        titles = " and ".join(row.title for row in scored)
        shared.fail(f"{titles} failed every case, {name} with: {', '.join(case.failed)}")


@takes_changes(**OF_LOOP)
def compare(
    full: FullOption = False,
    seed: SeedOption = None,
    workers: WorkersOption = PROCESSORS,
    out: shared.OutFolder = Path("results"),
    changes: Changes = NO_CHANGES,
    protocol_file: ProtocolOption = None,
) -> None:
    """Score all controllers of the protocol, each with its default gains and with tuned gains.

    Writes comparison.json and an interactive page.
    For example, l1-depth compare --full --seed 1 compares over drawn plants, too.
    """
    from orchestration.studies.score import score as scoring
    from orchestration.studies.score.score_rendering import terminal_text

    protocol = chosen_protocol(changes, protocol_file)
    scored_controllers([], False, changes)
    shared.check_writable(out)
    with shared.progress("compare", scoring.run_count(len(protocol.controllers), protocol, full)) as bar:
        result = scoring.compare(protocol, full=full, seed=seed, workers=workers, progress=bar.advance)
    tuned = scoring.part(result.document, scoring.TUNED)
    print(terminal_text(tuned, shared.console()), flush=True)
    write_score(result, scoring.for_page(result), out / "comparison.json", "Comparison of the controllers")


def write_score(result: "ScoreResult", on_page: "ScoreResult", file: Path, title: str) -> None:
    """Writes a score and its page, or prints which extra the page needs; an earlier page is removed."""
    from orchestration.studies.score.score_rendering import html_page

    page = file.with_suffix(".html")
    page.unlink(missing_ok=True)
    write_text_atomically(file, result.document.model_dump_json(indent=1) + "\n")
    print(file)
    try:
        write_text_atomically(page, html_page(on_page, title))
        print(page)
    except MissingExtraError as error:
        print(f"l1-depth: no page: {error}", file=sys.stderr)


def chosen_protocol(changes: Changes, file: Path | None = None) -> "Protocol":
    """Returns the protocol of a file, by default the one that ships, on the vehicle that --plant names."""
    from orchestration.studies.score import protocol as protocols
    from orchestration.studies.vehicle import Vehicle

    if changes.parameter_set:
        raise ScenarioError(f"--parameters {changes.parameter_set}: expected a file that ends in .toml")
    vehicle = Vehicle.of_changes(changes) if PLANT in changes.components else None
    return protocols.read_protocol(file or protocols.FILE, vehicle)


def scored_controllers(names: Sequence[str], no_rates: bool, changes: Changes) -> list["Controller"]:
    """Returns the FMUs, blocks and Python files of blocks; settings and mapping belong to the only one."""
    from orchestration.studies.score.closed_loop import Controller

    replaced = changes.components.keys() - {PLANT}
    if replaced:
        name = min(replaced)
        own = "variable" if name in (CONTROLLER, PLANT) else name
        raise ScenarioError(f"--set {name}: expected {CONTROLLER}.{own}=value")
    named = [f"--set {name}" for name in changes.settings if "." in name]
    named += [f"--map {component}.{name}" for component, names in changes.mapping.items() for name in names]
    known = ({CONTROLLER} if names else set()) | ({PLANT} & changes.components.keys())
    for option in named:
        if option.partition(" ")[2].partition(".")[0] not in known:
            raise ScenarioError(f"{option}: expected controller.NAME, or --plant beside plant.NAME")
    own, mapping = changes.of_component(CONTROLLER)
    if len(names) > 1 and (own or mapping):
        raise ScenarioError(
            f"--set, --map and --parameters with {len(names)} controllers: expected one; score them one by "
            "one with the same --seed"
        )
    return [
        Controller(
            name=fmu_name(name),
            fmu=name,
            reference_rates=not no_rates,
            parameters=own,
            mapping=mapping,
            open_inputs=str(changes.open_inputs or OpenInputs.ERROR),
        )
        for name in names
    ]
