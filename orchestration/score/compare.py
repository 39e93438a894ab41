"""The comparison: every controller of the protocol with the gains that it comes with, and tuned.

Names of rows: "start/l1" has the start values of its FMU, which for L1 are the gains identified from the
paper; "tuned/l1" has those of gains/l1.toml.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

from fmus.operating_system import usable_processors
from orchestration.score import score_view
from orchestration.score.closed_loop import Controller, built_in, tuned
from orchestration.score.protocol import Protocol
from orchestration.score.score import ScoreResult, differences, runs_each, score_controllers
from orchestration.score.score_document import Score
from orchestration.score.score_view import ScoreTable

START, TUNED = "start", "tuned"
PAPERS = f"{TUNED}/l1-pi"  # the paper's controller


def controllers(protocol: Protocol) -> list[Controller]:
    """Returns every controller of the protocol, tuned and with the start values of its FMU."""
    return [
        replace(chosen(protocol, name), name=f"{which}/{name}")
        for which, chosen in ((TUNED, tuned), (START, built_in))
        for name in protocol.controllers
    ]


def compare(
    protocol: Protocol,
    full: bool = False,
    seed: int | None = None,
    workers: int = usable_processors(),
    progress: Callable[[int], object] = lambda done: None,
) -> ScoreResult:
    """Returns the score of all, with `full` the differences of every pair of tuned controllers."""
    papers, *others = sorted(controllers(protocol), key=lambda controller: controller.name != PAPERS)
    result = score_controllers(
        [papers], protocol, beside=others, full=full, seed=seed, workers=workers, progress=progress
    )
    result.document.differences = differences(combinations(part(result.document, TUNED).rows, 2))
    return result


def run_count(protocol: Protocol, full: bool) -> int:
    """Returns the number of runs of a comparison."""
    return len(controllers(protocol)) * runs_each(protocol, full)


def for_page(result: ScoreResult) -> ScoreResult:
    """Returns the result with the gains of each row in its title, for a page that shows all rows together."""
    endings = {TUNED: "tuned", START: "as it comes"}
    rows = [
        row.model_copy(update={"title": f"{row.title}, {endings[row.name.partition('/')[0]]}"})
        for row in result.document.rows
    ]
    return replace(result, document=result.document.model_copy(update={"rows": rows}))


def part(document: Score, which: str) -> Score:
    """Returns the rows of one kind; each table of them marks the best of its columns."""
    rows = [row for row in document.rows if row.name.startswith(f"{which}/")]
    return document.model_copy(update={"rows": rows})


def shown_tables(document: Score) -> dict[str, ScoreTable]:
    """Returns the tables of the rows of each kind, by their names."""
    made = {f"{which} overview": score_view.overview(part(document, which)) for which in (TUNED, START)}
    rows = part(document, TUNED)
    made[f"{TUNED} rmse"] = score_view.of_metric(rows, "rmse")
    full = {"draws": score_view.over_draws(rows), "plants": score_view.over_plants(rows)}
    return made | {f"{TUNED} {name}": table for name, table in full.items() if table}


def with_papers_differences(document: Score) -> Score:
    """Returns the score with the differences in RMSE between the paper's controller and others alone."""
    entries = [e for e in document.differences if e.scored == PAPERS and e.metric == "rmse"]
    return document.model_copy(update={"differences": entries})
