"""Command compare --fronts: the front of each law, written as numbers and drawn."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmus.errors import nearest
from orchestration.cli import shared
from orchestration.cli.interrupts import INTERRUPTED
from orchestration.cli.tune import listed, with_cost
from orchestration.errors import ScenarioError

if TYPE_CHECKING:
    from orchestration.score.protocol import Protocol


def write_fronts(
    protocol: "Protocol",
    bounds: Sequence[str],
    cases: str,
    names: str,
    seeds: int,
    evaluations: int,
    workers: int,
    out: Path,
) -> None:
    """Searches the fronts of laws and writes fronts.json and fronts.svg.

    Their journals are removed at the end; until then the same command continues.
    """
    from orchestration.results.figures import front_figure
    from orchestration.score import fronts
    from orchestration.score.tune_problem import evaluations as started

    protocol = with_cost(protocol, bounds, cases)
    for name in listed(names):
        if name not in protocol.controllers:
            raise ScenarioError(f"--laws {name}; {nearest(name, protocol.controllers)}")
    laws = [fronts.law_of(protocol, name) for name in listed(names) or protocol.controllers]
    counts = [fronts.evaluations_of(law.problem, seeds, evaluations) for law in laws]
    journals, documents = list[Path](), list[dict[str, Any]]()
    try:
        with shared.progress("fronts", sum(counts)) as bar:
            for law, count in zip(laws, counts, strict=True):
                journals.append(out / f"{law.controller.name}.front.jsonl")
                with started(law.controller, law.protocol, workers, count) as evaluate:
                    of_seeds = fronts.search_front(
                        law.problem,
                        range(1, seeds + 1),
                        evaluations,
                        law.largest,
                        journals[-1],
                        evaluate,
                        lambda done, _: bar.advance(done),
                    )
                documents.append(fronts.document_of(law, of_seeds))
    except KeyboardInterrupt:
        shared.fail(f"interrupted: what is done is kept in {out}; the same command continues", INTERRUPTED)
    effort = {"evaluations_per_gain_bound_and_seed": evaluations, "seeds": seeds}
    fronts.write(documents, protocol, effort, out / "fronts.json")
    figures = front_figure(protocol.vehicle.name, documents, out / "fronts")
    for journal in journals:
        journal.unlink()
    _print_fronts(documents)
    for path in (out / "fronts.json", *figures):
        print(path)


def _print_fronts(laws: Sequence[Mapping[str, Any]]) -> None:
    """Prints the hypervolume of each law, and how far its seeds are apart."""
    from rich.table import Table

    from orchestration.score.fronts import LARGEST_SPREAD

    table = Table(title="Fronts: hypervolume, the area that a front betters, in decades of both numbers")
    for heading in ("Law", "Step [ms]", "Points", "Median", "Spread of seeds [%]", ""):
        table.add_column(heading, justify="left" if heading in ("Law", "") else "right")
    for law in laws:
        volumes, spread = sorted(law["hypervolumes"]), law["spread"]
        table.add_row(
            law["title"],
            f"{1e3 * law['step']:g}",
            str(len(law["points"])),
            f"{volumes[len(volumes) // 2]:.3g}",
            "-" if spread is None else f"{100 * spread:.2g}",
            "seeds differ" if spread is not None and spread > LARGEST_SPREAD else "",
        )
    shared.print_table(table)
