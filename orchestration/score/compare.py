"""The comparison: every controller of the protocol with the gains that it comes with, and tuned.

Names of rows: "start/l1" has the start values of its FMU, which for L1 are the gains identified from the
paper; "tuned/l1" has those of gains/l1.toml. The tables are made for docs/explanation/comparison.md.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from fmus.platforms import usable_processors
from orchestration.score import score_view
from orchestration.score.closed_loop import Controller, built_in, tuned
from orchestration.score.protocol import Protocol
from orchestration.score.score import ScoreResult, runs_each, score_controllers
from orchestration.score.score_document import Score
from orchestration.score.score_view import Cell, ScoreTable

START, TUNED = "start", "tuned"
PAPERS = f"{TUNED}/l1-pi"  # the paper's controller, which the others are compared with plant by plant


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
    """Returns the score of all, with `full` on every plant, beside the paper's controller, tuned."""
    papers, *others = sorted(controllers(protocol), key=lambda controller: controller.name != PAPERS)
    return score_controllers(
        [papers], protocol, beside=others, full=full, seed=seed, workers=workers, progress=progress
    )


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
    plants = score_view.over_plants(rows)
    if plants:
        made[f"{TUNED} plants"] = plants
    return made


def tables(document: Score) -> dict[str, str]:
    """Returns the tables of the page in Markdown, by the name that stands before them there."""
    made = {name: _markdown(table) for name, table in shown_tables(document).items()}
    if document.differences:
        made[f"{TUNED} differences"] = _differences(document)
    return made


def with_tuned_differences(document: Score) -> Score:
    """Returns the score with the differences in RMSE between tuned controllers alone."""
    entries = [e for e in document.differences if e.other.startswith(f"{TUNED}/") and e.metric == "rmse"]
    return document.model_copy(update={"differences": entries})


def _markdown(table: ScoreTable) -> str:
    headings = ["Told", *(f"{c.title} [{c.unit}]" if c.unit else c.title for c in table.columns)]
    return _lines(
        headings,
        (
            [row.title, row.told, *map(_text, cells)]
            for row, cells in zip(table.rows, table.cells, strict=True)
        ),
    )


def _differences(document: Score) -> str:
    """Returns the table of the paper's controller minus each other tuned one, in RMSE."""
    titles = {row.name: row.title for row in document.rows}
    return _lines(
        ["Plants", "Median difference [cm]", "95 % interval [cm]", "p, Holm"],
        (
            [
                titles[entry.other],
                str(entry.pairs),
                f"{entry.median_difference:.3g}",
                f"{entry.interval[0]:.3g} to {entry.interval[1]:.3g}",
                f"{entry.p_holm:.1g}",
            ]
            for entry in with_tuned_differences(document).differences
        ),
    )


def _lines(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table of controllers in Markdown."""
    lines = [["Controller", *headings], [":---", *["---:"] * len(headings)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _text(cell: Cell) -> str:
    text = f"**{cell.text}**" if cell.is_best else cell.text
    return f"{text} !" if cell.failed else text
