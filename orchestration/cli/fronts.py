"""Command compare --fronts: the front of each law, written as numbers and drawn."""

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from orchestration.cli import shared
from orchestration.cli.interrupts import INTERRUPTED

if TYPE_CHECKING:
    from orchestration.score.protocol import Protocol


def write_fronts(
    protocol: "Protocol", names: Sequence[str], seeds: int, evaluations: int, workers: int, out: Path
) -> None:
    """Searches the fronts of laws and writes fronts.json and fronts.svg.

    Their journals are removed at the end; until then the same command continues.
    """
    from fmus.files import write_text_atomically
    from orchestration.results.figures import front_figure
    from orchestration.score.closed_loop import built_in
    from orchestration.score.fronts import LARGEST_ERROR, LARGEST_SPREAD, LEVELS, front_of_law

    names = [built_in(protocol, name).name for name in names or protocol.controllers]
    journals = {name: out / f"{name}.front.jsonl" for name in names}
    total = LEVELS * seeds * evaluations * sum(len(protocol.controllers[name].gains) for name in names)
    try:
        with shared.progress("fronts", total) as bar:
            how = range(1, seeds + 1), evaluations, workers
            laws = [
                front_of_law(protocol, name, *how, path, lambda done, _: bar.advance(done))
                for name, path in journals.items()
            ]
    except KeyboardInterrupt:
        shared.fail(f"interrupted: what is done is kept in {out}; the same command continues", INTERRUPTED)
    document = {
        "vehicle": protocol.vehicle.name,
        "protocol": protocol.version,
        "statement": protocol.statement,
        "cost": protocol.tables.cost.model_dump(),
        "effort": {"evaluations_per_gain_bound_and_seed": evaluations, "bounds": LEVELS, "seeds": seeds},
        "units": {"error": "cm", "total_variation": "N", "delay_margin": "s", "step": "s"},
        "hypervolume": f"in decades of both, from {LARGEST_ERROR:g} cm and the bound on the variation",
        "laws": laws,
    }
    write_text_atomically(out / "fronts.json", f"{json.dumps(document, indent=1)}\n")
    figures = front_figure(protocol.vehicle.name, laws, out / "fronts")
    for path in journals.values():
        path.unlink()
    for law in laws:
        differ = " (they differ)" if (law["spread"] or 0.0) > LARGEST_SPREAD else ""
        seeds_apart = "" if law["spread"] is None else f", seeds {100 * law['spread']:.2g} % apart{differ}"
        print(f"{law['title']}: hypervolume {median(law['hypervolumes']):.3g}{seeds_apart}")
    print(*(out / "fronts.json", *figures), sep="\n")
