"""Makes the site's page explanation/comparison.md from results, and writes what it reads of them.

    python .ci/comparison_page.py results/comparison.json results/VEHICLE/fronts.json results/wide/LAW.toml

writes comparison.json, fronts.json and widened.json in docs/explanation. The last has tunings in wider
ranges, of the laws that ended with a gain at a limit. `page` fills comparison_page.md, the text with the
places of its numbers, from them and sensitivity.json when the site is built, and `figures` draws.
"""

import io
import json
import math
import sys
import tomllib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import comparison_fronts
import numpy as np
from front_points import front_figure
from jinja2 import Environment, StrictUndefined

from orchestration.results.formats import FigureFormat
from orchestration.results.statistics import EQUIVALENCE, paired, profile, ratios_to_best
from orchestration.studies.score.closed_loop import GAINS
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.protocol_format import DELAY_MARGIN
from orchestration.studies.score.score import START, TUNED, part
from orchestration.studies.score.score_document import ManyRuns, MetricOverRuns, Row, Score
from orchestration.studies.score.tune import LARGEST_SPREAD
from orchestration.studies.score.tune_problem import LARGEST_CHANGE

PAGES = Path(__file__).parent.parent / "docs" / "explanation"
DATA = PAGES / "comparison.json"
WIDENED = PAGES / "widened.json"
TEMPLATE = Path(__file__).with_name("comparison_page.md")
REPEATS = 0.98  # a rank correlation above it
FACTOR = 2.0  # of the least RMSE
_DIGITS = 5
_OF_A_CASE = ("rmse", "total_variation")


def reduced(document: dict[str, Any]) -> dict[str, Any]:
    """Returns the document with the metrics of the tables, and of tuned controllers the RMSE run by run.

    Those with default gains keep the draws of the nominal case.
    """
    return {
        **document,
        "rows": [_row(row) for row in document["rows"]],
        "differences": [_rounded(entry) for entry in document["differences"] if entry["metric"] == "rmse"],
    }


def _row(row: dict[str, Any]) -> dict[str, Any]:
    is_tuned = row["name"].startswith(f"{TUNED}/")
    draws = {
        case: {**runs, "metrics": _values(runs["metrics"], ["rmse"], keeps_values=True)}
        for case, runs in row["draws"].items()
        if is_tuned or case == next(iter(row["cases"]))
    }
    metrics = _values(row["plants"]["metrics"], row["plants"]["metrics"], keeps_values=is_tuned)
    cases = {
        name: {**case, "metrics": {n: x for n, x in case["metrics"].items() if n in _OF_A_CASE}}
        for name, case in row["cases"].items()
    }
    plants = {**row["plants"], "metrics": metrics}
    return _rounded({**row, "cases": cases, "draws": draws, "plants": plants})


def _values(metrics: dict[str, Any], names: Sequence[str], keeps_values: bool) -> dict[str, Any]:
    kept = {name for name in names if name == "rmse" and keeps_values}
    return {
        name: {**metrics[name], "values": metrics[name]["values"] if name in kept else []} for name in names
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: item if key == "parameters" else _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def tuning(text: str) -> dict[str, Any]:
    """Returns cost and ranges of a file that `l1-depth tune` wrote."""
    file = tomllib.loads(text)
    gains = {name.partition(".")[2]: table for name, table in file["parameters"].items()}
    ranges = {gain: table["limits"] for gain, table in gains.items() if "limits" in table}
    return {"cost": file["tuning"]["cost"], "ranges": ranges}


def written(document: dict[str, Any]) -> str:
    """Returns the document as JSON, with a line for each row and each difference."""
    parts = [f"{json.dumps(key)}: {_part(value)}" for key, value in document.items()]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _part(value: Any) -> str:
    if not isinstance(value, list):
        return json.dumps(value)
    return "[\n" + ",\n".join(json.dumps(item, separators=(",", ":")) for item in value) + "\n]"


class Numbers:
    """What the page and its figure take from a comparison: tuned controllers, run by run."""

    def __init__(self, document: Score) -> None:
        self.document = document
        self.widened: dict[str, Any] = json.loads(WIDENED.read_text(encoding="utf-8"))
        self.rows = {row.name: row for row in document.rows}
        self.tuned = part(document, TUNED).rows
        self.start = part(document, START).rows
        self.cases = document.protocol.cases
        self.repeating = [name for name, case in self.cases.items() if case.repeats_nominal]
        self.repeated = [name for name in self.cases if name in self.tuned[0].draws]
        self.tests = [name for name in self.repeated if not self.cases[name].tuned_on]
        self.plants = self.plants_of(self.tuned[0]).count
        self.draws = self.tuned[0].draws[self.repeated[0]].count

    def row(self, name: str) -> Row:
        return self.rows[name]

    def plants_of(self, row: Row) -> ManyRuns:
        if row.plants is None:
            raise ValueError(f"{row.name} has no plants: expected a comparison with --full")
        return row.plants

    def correlation(self, case: str) -> float:
        """Returns the rank correlation with the nominal RMSE, the lesser of tuned and default gains."""
        pair, kinds = (next(iter(self.cases)), case), (self.tuned, self.start)
        errors = ([[row.cases[name].metrics["rmse"] for row in rows] for name in pair] for rows in kinds)
        return min(comparison_fronts.rank_correlation(*columns) for columns in errors)

    def errors(self, row: Row, case: str = "") -> MetricOverRuns:
        """Returns the RMSE of the draws of a case, by default of the plants."""
        return (row.draws[case] if case else self.plants_of(row)).metrics["rmse"]

    def leaders(self, case: str = "") -> tuple[Row, list[Row]]:
        """Returns the tuned controller of the least median RMSE, and those that are not found worse."""
        pairs = math.comb(len(self.tuned), 2)
        best, *others = sorted(self.tuned, key=lambda row: self.errors(row, case).median)
        least = self.errors(best, case).values
        worse = {r.name: paired(least, self.errors(r, case).values, pairs).verdict == "lower" for r in others}
        return best, [row for row in others if not worse[row.name]]

    def ratios(self, cases: Sequence[str]) -> np.ndarray:
        """Returns controllers x draws of cases: RMSE by the least one, infinite where the run failed."""
        values = [
            [
                math.nan if str(number) in row.draws[case].failed else value
                for case in cases
                for number, value in enumerate(row.draws[case].metrics["rmse"].values)
            ]
            for row in self.tuned
        ]
        return ratios_to_best(values, [not row.unranked for row in self.tuned])

    def profiles(self, cases: Sequence[str], factors: Sequence[float]) -> dict[str, list[float]]:
        shares = 100.0 * profile(self.ratios(cases), factors)
        return {row.name: share.tolist() for row, share in zip(self.tuned, shares, strict=True)}

    def verdicts(self) -> Counter[str]:
        """Returns how many pairs of tuned controllers are different, equal and open in RMSE on the plants."""
        words = {"lower": "different", "higher": "different"}
        return Counter(words.get(entry.verdict, entry.verdict) for entry in self.document.differences)

    def failing_in(self, least: float) -> dict[str, list[Row]]:
        """Returns case -> tuned controllers whose interval of the failure rate is wholly above `least`."""
        found = {
            case: [row for row in self.tuned if row.draws[case].failure_interval[0] > least]
            for case in self.repeated
        }
        return {case: rows for case, rows in found.items() if rows}

    def keeping(self, bound: float) -> list[list[Row]]:
        """Returns who keeps a bound [s] on the delay margin in all draws, and who in their median."""
        in_all = [row for row in self.tuned if min(row.delay_margins) >= bound]
        return [in_all, [row for row in self.tuned if row.delay_margin >= bound]]

    def limited(self) -> list[Row]:
        """Returns the tuned controllers a gain of which ended at a limit of its range."""
        return [
            row
            for row, file in self.tunings()
            if any(gain.get("at_a_limit") for gain in file["parameters"].values())
        ]

    def agreeing(self) -> list[Row]:
        """Returns the tuned controllers the seeds of whose search agree."""
        return [row for row, file in self.tunings() if file["tuning"]["seeds_agree"]]

    def tunings(self) -> list[tuple[Row, dict[str, Any]]]:
        """Returns the tuned controllers, each with the file of its gains."""
        paths = (GAINS / f"{row.name.partition('/')[2]}.toml" for row in self.tuned)
        files = (tomllib.loads(path.read_text(encoding="utf-8")) for path in paths)
        return list(zip(self.tuned, files, strict=True))

    def changes_in_wider_ranges(self) -> list[float]:
        """Returns the relative change of the least cost of each controller of `widened`."""
        costs = {row.name.partition("/")[2]: file["tuning"]["cost"] for row, file in self.tunings()}
        return [entry["cost"] / costs[law] - 1.0 for law, entry in self.widened.items()]

    def never_failing(self) -> list[Row]:
        return [row for row in self.tuned if not self.plants_of(row).failed]

    def worse_than_none(self) -> list[Row]:
        """Returns those whose failure rate is above all that no failure at all allows."""
        (_, limit) = next(self.plants_of(row) for row in self.never_failing()).failure_interval
        found = [row for row in self.tuned if self.plants_of(row).failure_interval[0] > limit]
        return sorted(found, key=lambda row: -self.plants_of(row).failure_rate)

    def median(self, values: Sequence[float]) -> str:
        """Returns the median of runs and its 95 % interval, as text."""
        found = paired(values, np.zeros(len(values)))
        return "{:.3g} ({:.3g} to {:.3g})".format(found.median_difference, *found.interval)


def share(runs: ManyRuns) -> str:
    """Returns a failure rate [%] and its 95 % interval, as text."""
    rate, low, high = (f"{100.0 * part:.3g}" for part in (runs.failure_rate, *runs.failure_interval))
    return f"{rate} % ({low} to {high} %)"


def margin(row: Row) -> str:
    """Returns the median of the delay margins [s] over the noise, and their range, as text."""
    low, middle, high = (
        f"{1e3 * value:.0f}" for value in (min(row.delay_margins), row.delay_margin, max(row.delay_margins))
    )
    return f"{middle} ({low} to {high})"


def _titles(rows: Sequence[Row]) -> str:
    return "; ".join(row.title for row in rows)  # some have commas


def page() -> str:
    """Returns the page of the committed results."""
    document, fronts = committed(), comparison_fronts.committed()
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    numbers = Numbers(document)
    changed, points = fronts.changed_by_the_step(LARGEST_CHANGE)
    return template.render(
        n=numbers,
        f=fronts,
        changed=changed,
        points=points,
        largest_change=f"{100.0 * LARGEST_CHANGE:g}",
        repeats=REPEATS,
        equivalence=f"{100.0 * EQUIVALENCE:g}",
        factor=FACTOR,
        profiles=numbers.profiles(numbers.tests, [FACTOR]),
        share=share,
        margin=margin,
        bound=read_protocol().tables.cost.bounds[DELAY_MARGIN],
        titles=_titles,
        limited=_titles(numbers.limited()),
        agreed=f"{100.0 * LARGEST_SPREAD:g}",
    )


def figure(document: Score) -> bytes:
    """Returns the figure of the page as PNG: error, failures and profile of each tuned controller."""
    from matplotlib.figure import Figure

    numbers = Numbers(document)
    rows = sorted(numbers.tuned, key=lambda row: -numbers.plants_of(row).metrics["rmse"].median)
    picture = Figure(figsize=(11.0, 6.0), layout="constrained")
    error, failed, profiles = picture.subplots(1, 3, sharey=True, width_ratios=[1.2, 1.0, 1.3])
    heights = np.arange(len(rows))
    plants = [numbers.plants_of(row) for row in rows]
    spread = [runs.metrics["rmse"] for runs in plants]
    error.hlines(heights, [m.median for m in spread], [m.p95 for m in spread], color="0.6")
    margins = [row.delay_margin for row in rows]
    drawn = error.scatter([m.median for m in spread], heights, c=margins, cmap="viridis", zorder=2)
    error.set(xscale="log", xlabel="RMSE on the plants [cm]:\nmedian, and line to the 95th percentile")
    error.set_yticks(heights, [row.title for row in rows])
    picture.colorbar(drawn, ax=error, location="top", label="Delay margin [s], median over the noise")
    ends = 100.0 * np.array([runs.failure_interval for runs in plants])
    failed.hlines(heights, ends[:, 0], ends[:, 1], color="0.6")
    failed.plot([100.0 * runs.failure_rate for runs in plants], heights, "ko", markersize=4)
    failed.set(xscale="symlog", xlim=(-0.1, 100.0), xlabel="Failed plants [%],\n95 % interval")
    factors = np.geomspace(1.0, 10.0, 91)
    shares = numbers.profiles(numbers.tests, factors.tolist())
    image = profiles.pcolormesh(factors, heights, [shares[row.name] for row in rows], cmap="cividis", vmin=0)
    profiles.set(xscale="log", xlabel="Factor of the least RMSE of a run")
    for axes, ticks in ((error, (0.2, 0.5, 1, 2, 5)), (failed, (0, 1, 10, 100)), (profiles, (1, 2, 5, 10))):
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    picture.colorbar(image, ax=profiles, location="top", label="Runs within the factor [%]")
    stream = io.BytesIO()
    picture.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()


def committed() -> Score:
    """Returns the comparison that the page is of."""
    return Score.model_validate_json(DATA.read_text(encoding="utf-8"))


def figures(folder: Path) -> list[Path]:
    """Writes the figures of the page to a folder; returns the files."""
    runs = folder / "figure_comparison.png"
    runs.write_bytes(figure(committed()))
    laws = {document["vehicle"]: document["laws"] for document in comparison_fronts.committed().documents}
    return [runs, *front_figure(laws, folder / "figure_fronts", [FigureFormat.SVG])]


def main(arguments: Sequence[str]) -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in map(Path, arguments)}
    documents = [json.loads(text) for path, text in texts.items() if path.suffix == ".json"]
    if tunings := {path.stem: tuning(text) for path, text in texts.items() if path.suffix == ".toml"}:
        WIDENED.write_text(json.dumps(tunings, indent=1) + "\n", encoding="utf-8")
    for document in documents:
        if "rows" in document:
            DATA.write_text(written(reduced(document)), encoding="utf-8")
    if fronts := [document for document in documents if "laws" in document]:
        comparison_fronts.DATA.write_text(comparison_fronts.reduced(fronts), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
