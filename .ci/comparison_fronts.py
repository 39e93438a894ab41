"""What the page of the comparison takes of fronts on each vehicle, and of what moves the ranking."""

import json
import math
from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from pathlib import Path
from statistics import median
from typing import Any

from scipy import stats

from orchestration.studies.score.protocol import read_protocol

DATA = Path(__file__).parent.parent / "docs" / "explanation" / "fronts.json"
SENSITIVITY = DATA.with_name("sensitivity.json")
_SHOWN = ("error", "total_variation", "delay_margin", "change_at_half_the_step")
_DIGITS = 4


def reduced(documents: Sequence[Mapping[str, Any]]) -> str:
    """Returns files of `.ci/fronts.py` as JSON, without the gains of each point, a line for each law."""
    parts = list[str]()
    for document in documents:
        laws = [json.dumps(_law(law), separators=(",", ":")) for law in document["laws"]]
        rest = {key: value for key, value in document.items() if key != "laws"}
        parts.append(f'{json.dumps(rest)[:-1]}, "laws": [\n' + ",\n".join(laws) + "\n]}")
    return "[\n" + ",\n".join(parts) + "\n]\n"


def _law(law: Mapping[str, Any]) -> dict[str, Any]:
    points = [{name: _rounded(point[name]) for name in _SHOWN} for point in law["points"]]
    volumes = [_rounded(volume) for volume in law["hypervolumes"]]
    spread = None if law["spread"] is None else _rounded(law["spread"])
    return {**law, "hypervolumes": volumes, "spread": spread, "points": points}


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Returns Spearman's correlation of two columns over the rows that have a value in both."""
    result: Any = stats.spearmanr(first, second, nan_policy="omit")
    return float(result.statistic)


class Fronts:
    """The fronts of all laws on each vehicle.

    A law is better than another one on a vehicle if the least hypervolume of its seeds is above the largest
    of the other's.
    """

    def __init__(self, documents: Sequence[Mapping[str, Any]], sensitivity: Mapping[str, Any]) -> None:
        self.documents, self.sensitivity = documents, sensitivity
        self.vehicles = [document["vehicle"] for document in documents]
        self.laws = {d["vehicle"]: {law["name"]: law for law in d["laws"]} for d in documents}
        self.titles = {name: law["title"] for laws in self.laws.values() for name, law in laws.items()}

    @property
    def pairs(self) -> int:
        """How many pairs of laws there are."""
        return math.comb(len(self.titles), 2)

    def options(self, document: Mapping[str, Any]) -> str:
        """Returns the options of the command that has made a document."""
        protocol, cost = read_protocol(), document["cost"]
        ours = protocol.tables.cost
        plant = "" if document["vehicle"] == protocol.vehicle.name else f" --plant {document['vehicle']}"
        settings = "".join(f' --set "{name}={value}"' for name, value in document["settings"].items())
        bounds = [(n, value) for n, value in cost["bounds"].items() if ours.bounds.get(n) != value]
        cases = "" if cost["cases"] == ours.cases else f" --cases {','.join(cost['cases'])}"
        return plant + settings + "".join(f" --bound {n}={value:g}" for n, value in bounds) + cases

    def volume(self, vehicle: str, law: str) -> float:
        """Returns the median of the hypervolumes of the seeds."""
        return median(self.laws[vehicle][law]["hypervolumes"])

    def rank(self, vehicle: str, law: str) -> int:
        """Returns 1 for the law of the largest hypervolume."""
        return 1 + sum(self.volume(vehicle, other) > self.volume(vehicle, law) for other in self.titles)

    def by_rank(self) -> list[str]:
        """Returns the laws by the sum of their ranks."""
        return sorted(self.titles, key=lambda law: sum(self.rank(v, law) for v in self.vehicles))

    def is_better(self, vehicle: str, first: str, second: str) -> bool:
        one, other = (self.laws[vehicle][name]["hypervolumes"] for name in (first, second))
        return min(one) > max(other)

    def _verdicts(self, first: str, second: str) -> list[int]:
        better = self.is_better
        return [better(v, first, second) - better(v, second, first) for v in self.vehicles]

    def everywhere(self) -> list[tuple[str, str]]:
        """Returns the pairs of which the first law is better on every vehicle."""
        return [pair for pair in permutations(self.titles, 2) if min(self._verdicts(*pair)) == 1]

    def reversed(self) -> list[tuple[str, str]]:
        """Returns the pairs of which one law is better on one vehicle and worse on another."""
        return [pair for pair in combinations(self.titles, 2) if {1, -1} <= {*self._verdicts(*pair)}]

    def verdict(self, first: str, second: str) -> str:
        """Returns in words on which vehicles the first law has the better front."""
        words = {1: "better", -1: "worse", 0: "open"}
        found = [words[verdict] for verdict in self._verdicts(first, second)]
        if len({*found}) == 1:
            return f"{found[0]} on all"
        return ", ".join(f"{word} on {vehicle}" for word, vehicle in zip(found, self.vehicles, strict=True))

    def leaders(self, vehicle: str) -> list[str]:
        """Returns the law of the largest hypervolume first, then those that are not worse."""
        order = sorted(self.titles, key=lambda law: self.rank(vehicle, law))
        return [law for law in order if not self.is_better(vehicle, order[0], law)]

    def correlation(self) -> float:
        """Returns the least rank correlation of the hypervolumes of two vehicles."""
        columns = [[self.volume(vehicle, law) for law in self.titles] for vehicle in self.vehicles]
        return min(rank_correlation(*pair) for pair in combinations(columns, 2))

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
    return Fronts(fronts, sensitivity)
