"""What the page of the comparison takes of fronts on each vehicle, and of what moves the ranking."""

import json
import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from front_points import LARGEST_SPREAD
from fronts import SPECIAL_CASES, STUDY
from scipy import stats

from orchestration.results.statistics import holm
from orchestration.studies.score.protocol import read_protocol

DATA = Path(__file__).parent.parent / "docs" / "explanation" / "fronts.json"
SENSITIVITY = DATA.with_name("sensitivity.json")
_SHOWN = ("error", "total_variation", "delay_margin", "change_at_half_the_step")
_ERRORS = ("least_errors_at_half", "least_errors")
_DIGITS = 4
LEVEL = 0.05  # of significance, of all pairs together


def reduced(documents: Sequence[Mapping[str, Any]]) -> str:
    """Returns files of `.ci/fronts.py` as JSON, a line for each law."""
    parts = list[str]()
    for document in documents:
        laws = [json.dumps(_law(law), separators=(",", ":")) for law in document["laws"]]
        rest = {key: value for key, value in document.items() if key != "laws"}
        parts.append(f'{json.dumps(rest)[:-1]}, "laws": [\n' + ",\n".join(laws) + "\n]}")
    return "[\n" + ",\n".join(parts) + "\n]\n"


def _law(law: Mapping[str, Any]) -> dict[str, Any]:
    points = [{**point, **{name: _rounded(point[name]) for name in _SHOWN}} for point in law["points"]]
    errors = {key: [[*map(_rounded, of_seed)] for of_seed in law[key]] for key in _ERRORS}
    spread = None if law["spread"] is None else _rounded(law["spread"])
    volumes = [*map(_rounded, law["hypervolumes"])]
    return {**law, **errors, "hypervolumes": volumes, "spread": spread, "points": points}


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Returns Spearman's correlation of two columns over the rows that have a value in both."""
    result: Any = stats.spearmanr(first, second, nan_policy="omit")
    return float(result.statistic)


def welch(first: Sequence[float], second: Sequence[float]) -> float:
    """Returns the p-value of Welch's test that two means are equal; not a number where nothing varies."""
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Any = stats.ttest_ind(first, second, equal_var=False)
    return float(result.pvalue) if np.ptp(first) + np.ptp(second) > 0.0 else math.nan


class Fronts:
    """The fronts of laws on each vehicle.

    A law is better than another one on a vehicle if both fronts are converged and its mean hypervolume over
    the seeds is larger by Welch's test, corrected for all pairs on all vehicles; than one that it contains,
    if its least error within a bound is lower by more than `LARGEST_SPREAD`.
    """

    def __init__(self, documents: Sequence[Mapping[str, Any]], sensitivity: Mapping[str, Any]) -> None:
        self.documents, self.sensitivity = documents, sensitivity
        self.vehicles = [document["vehicle"] for document in documents]
        self.laws = {d["vehicle"]: {law["name"]: law for law in d["laws"]} for d in documents}
        self.titles = {name: law["title"] for laws in self.laws.values() for name, law in laws.items()}
        self.p_values = holm(
            {
                (vehicle, *pair): welch(*(laws[name]["hypervolumes"] for name in pair))
                for vehicle, laws in self.laws.items()
                for pair in combinations([name for name in laws if laws[name]["is_converged"]], 2)
            }
        )

    def options(self, document: Mapping[str, Any]) -> list[str]:
        """Returns the options of the commands that have made a document."""
        effort, names = document["effort"], [law["name"] for law in document["laws"]]
        laws = "" if names == [*read_protocol().controllers] else f" --laws {','.join(names)}"
        evaluations = effort["evaluations_per_gain_bound_and_seed"]
        vehicle = document["vehicle"]
        own = f"--plant {vehicle} --seeds {len(effort['seeds'])} --evaluations {evaluations}"
        again = ",".join(law["name"] for law in document["laws"] if law.get("again"))
        known = f" --laws {again} --known results/{vehicle}/fronts.json --out {self.folder(document)}"
        return [own + laws, *([own + known] if again else [])]

    def folder(self, document: Mapping[str, Any]) -> str:
        """Returns the folder that the last of these commands writes the vehicle's folder to."""
        return "results/again" if any(law.get("again") for law in document["laws"]) else "results"

    def missing(self) -> str:
        """Returns in words which fronts are not there."""
        controllers = read_protocol().controllers
        counts = {vehicle: len(controllers) - len(self.laws.get(vehicle, ())) for vehicle in STUDY}
        if len({*counts.values()}) == 1 and any(counts.values()):
            return f"{next(iter(counts.values()))} laws on each vehicle"
        return ", ".join(f"{count} laws on {vehicle}" for vehicle, count in counts.items() if count)

    def behind(self) -> list[str]:
        """Returns where a seed of a law has less than one of a special case, of which all seeds begin."""
        return [
            f"{law} on {vehicle} is behind {special}"
            for vehicle, laws in self.laws.items()
            for law, cases in SPECIAL_CASES.items()
            for special in (case.law for case in cases)
            if law in laws
            and special in laws
            and min(laws[law]["hypervolumes"]) < max(laws[special]["hypervolumes"])
        ]

    def verdict(self, first: str, second: str) -> str:
        """Returns in words on which vehicles the first law has the better front."""
        words = {v: self._word(v, first, second) for v in self.vehicles}
        vehicles = {word: [v for v in words if words[v] == word] for word in words.values()}
        return "; ".join(f"{word} on {', '.join(own)}" for word, own in vehicles.items())

    def _word(self, vehicle: str, first: str, second: str) -> str:
        laws = self.laws[vehicle]
        if not all(name in laws for name in (first, second)):
            return "not searched"
        if not all(laws[name]["is_converged"] for name in (first, second)):
            return "not converged"
        for one, other, word in ((first, second, "better"), (second, first, "worse")):
            if other in {case.law for case in SPECIAL_CASES.get(one, ())}:
                # it begins at those points: no test is needed to see that it is not worse
                pairs = zip(*(self.least_errors(vehicle, name) for name in (one, other)), strict=True)
                return word if any(a < (1.0 - LARGEST_SPREAD) * b for a, b in pairs) else "equal"
        p = self.p_values.get((vehicle, first, second), self.p_values.get((vehicle, second, first), math.nan))
        if not p < LEVEL:
            return "open"
        one, other = (sum(laws[name]["hypervolumes"]) for name in (first, second))
        return "better" if one > other else "worse"

    def bounds(self, document: Mapping[str, Any]) -> list[float]:
        """Returns the bounds on the total variation [N] of a document, the largest first."""
        largest = document["cost"]["bounds"]["total_variation"]
        return [largest * 0.5**level for level in range(document["effort"]["bounds"])]

    def least_errors(self, vehicle: str, law: str) -> list[float]:
        """Returns the least error [cm] of all seeds within each bound."""
        return np.min(self.laws[vehicle][law]["least_errors"], axis=0).tolist()

    def changed_by_the_step(self, limit: float) -> tuple[int, int]:
        """Returns how many points half the step changes by more than a part of the cost, and of how many."""
        points = [p for laws in self.laws.values() for law in laws.values() for p in law["points"]]
        return sum(abs(p["change_at_half_the_step"]) > limit for p in points), len(points)

    def guesses(self, least: float) -> list[str]:
        """Returns the guessed numbers with a larger index than that on any vehicle, the largest first."""
        names = dict.fromkeys(name for found in self.sensitivity.values() for name in found["indices"])
        largest = {
            name: max(index["mean"] for v in self.sensitivity if (index := self.index(v, name)))
            for name in names
        }
        return sorted((name for name in names if largest[name] > least), key=lambda name: -largest[name])

    def index(self, vehicle: str, number: str) -> dict[str, float] | None:
        """Returns the total Sobol' index of a number, None where the vehicle has none."""
        return self.sensitivity[vehicle]["indices"].get(number)

    def share(self, vehicle: str, number: str) -> str:
        """Returns the index of a number and the range of its repetitions, as text."""
        index = self.index(vehicle, number)
        return "{mean:.2f} ({low:.2f} to {high:.2f})".format(**index) if index else ""


def committed() -> Fronts:
    """Returns the fronts and indices that the page is of."""
    fronts, sensitivity = (json.loads(path.read_text(encoding="utf-8")) for path in (DATA, SENSITIVITY))
    found = Fronts(fronts, sensitivity)
    if behind := found.behind():
        raise ValueError(f"{DATA}: {'; '.join(behind)}: expected no law behind its own special case")
    return found
