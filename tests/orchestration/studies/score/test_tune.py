"""Tuning on costs that are known: what it finds, how often it asks, how it continues, when a cost is flat."""

import json
import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from fmus.fmi.description import describe
from orchestration.errors import OrchestrationError
from orchestration.scenarios.free_parameter import FreeParameter, parse
from orchestration.studies.score import tune_problem
from orchestration.studies.score.tune import (
    REFINEMENTS,
    Evaluate,
    Problem,
    SearchResult,
    Tuning,
    tune,
    with_units,
)

GAINS = (
    FreeParameter("kp", 0.1, 100.0, unit="N/m"),
    FreeParameter("kd", 0.1, 100.0),
    FreeParameter("offset", -2.0, 2.0),
)
OPTIMUM = {"kp": 7.0, "kd": 30.0, "offset": -0.5}
SEEDS = (1, 2, 3)


def known_cost(gains: Mapping[str, float]) -> dict[str, Any]:
    """A valley that is no sum of functions of one gain, with its least value of 2 at OPTIMUM."""
    a, b = (math.log(gains[name] / OPTIMUM[name]) for name in ("kp", "kd"))
    c = gains["offset"] - OPTIMUM["offset"]
    return {"cost": 2.0 + a**2 + 10.0 * (b - a) ** 2 + (c + 0.5 * a) ** 2, "metrics": {"nominal": a}}


def at_once(cost: Callable[..., dict[str, Any]]) -> Evaluate:
    """The cost as it is asked for, evaluated in this process."""
    return lambda gains: map(cost, gains)


def tuned(path: Path, cost: Callable[..., Any] = known_cost, evaluations_per_gain: int = 80) -> Tuning:
    return tune(Problem(GAINS, {"law": "known"}), SEEDS, evaluations_per_gain, path, at_once(cost))


class Interrupted:
    """The known cost, until it is interrupted."""

    def __init__(self, calls: int) -> None:
        self.calls = calls

    def __call__(self, gains: Mapping[str, float]) -> dict[str, Any]:
        self.calls -= 1
        if self.calls < 0:
            raise KeyboardInterrupt
        return known_cost(gains)


def test_the_search_finds_the_optimum_of_a_known_cost(tmp_path: Path) -> None:
    tuning = tuned(tmp_path / "journal")
    for search in tuning.searches:
        assert search.cost == pytest.approx(2.0, rel=1e-3)  # every seed, with 80 evaluations a gain
    assert tuning.best.gains == pytest.approx(OPTIMUM, rel=0.05)
    assert tuning.is_flat


def test_one_seed_gives_one_search_and_another_seed_another(tmp_path: Path) -> None:
    first, second = (tuned(tmp_path / name, evaluations_per_gain=4).searches for name in "ab")
    assert first == second
    assert len({search.curve for search in first}) == len(SEEDS)


@pytest.mark.parametrize("free", [1, 2, 3])
def test_every_free_gain_has_the_same_number_of_evaluations(tmp_path: Path, free: int) -> None:
    asked: list[dict[str, float]] = []

    def cost(gains: dict[str, float]) -> dict[str, float]:
        asked.append(gains)
        return {"cost": 1.0}

    tuning = tune(Problem(GAINS[:free]), SEEDS, 7, tmp_path / "journal", at_once(cost))
    assert len(asked) == tuning.evaluations == 7 * free * (len(SEEDS) + 1)
    assert {len(search.curve) for search in (*tuning.searches, *tuning.refinements)} == {7 * free}
    assert all(list(gains) == [gain.name for gain in GAINS[:free]] for gains in asked)


def test_gains_stay_within_their_ranges_and_the_first_generation_fills_them(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    tuned(path, evaluations_per_gain=10)
    rows = [json.loads(line) for line in path.read_text().split("\n")[1:]]
    for gain in GAINS:
        values = [row["gains"][gain.name] for row in rows]
        assert gain.low <= min(values) < gain.rounded(0.3)
        assert gain.rounded(0.7) < max(values) <= gain.high


@pytest.mark.parametrize("cut_off", [0, 5], ids=["between lines", "in a line"])
def test_an_interrupted_tuning_continues_to_the_same_result(tmp_path: Path, cut_off: int) -> None:
    path = tmp_path / "journal"
    with pytest.raises(KeyboardInterrupt):
        tuned(path, Interrupted(40), 10)
    text = path.read_text()
    path.write_text(text[: len(text) - cut_off])  # as after a power failure
    done = len(path.read_text().split("\n")) - 1 - (cut_off > 0)
    rest = Interrupted(10 * len(GAINS) * (len(SEEDS) + 1) - done)  # not one evaluation is made twice
    assert done > 10
    assert tuned(path, rest, 10) == tuned(tmp_path / "other", known_cost, 10)
    assert rest.calls == 0


def test_one_tuning_at_a_time_uses_a_journal(tmp_path: Path) -> None:
    path = tmp_path / "mine.tune.jsonl"

    def cost(gains: Mapping[str, float]) -> dict[str, Any]:
        with pytest.raises(OrchestrationError, match=r"mine\.tune\.lock: another process runs this tuning"):
            tuned(path, evaluations_per_gain=2)
        return known_cost(gains)

    tuned(path, cost, 2)
    assert [*tmp_path.iterdir()] == [path]


def test_an_earlier_tuning_is_discarded_on_demand(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    tuned(path, evaluations_per_gain=2)
    tune(Problem(GAINS, {"law": "another"}), SEEDS, 2, path, at_once(known_cost), restart=True)
    assert json.loads(path.read_text().split("\n")[0])["law"] == "another"


def test_the_journal_of_another_tuning_is_refused_and_stays(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    tuned(path, evaluations_per_gain=2)
    before = path.read_text()
    with pytest.raises(OrchestrationError, match=r"another tuning \(evaluations differ\)"):
        tuned(path, evaluations_per_gain=3)
    assert path.read_text() == before


def test_a_journal_with_gains_that_the_search_did_not_ask_for_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    tuned(path, evaluations_per_gain=2)
    first, row, *others = path.read_text().split("\n")
    changed = json.loads(row)
    changed["gains"]["kp"] *= 1.001
    path.write_text("\n".join([first, json.dumps(changed), *others]))
    with pytest.raises(OrchestrationError, match="evaluation 0 of seed 1 has other gains"):
        tuned(path, evaluations_per_gain=2)


def test_progress_counts_what_is_done_with_the_lowest_cost(tmp_path: Path) -> None:
    calls: list[tuple[int, float]] = []
    path, evaluate = tmp_path / "journal", at_once(known_cost)
    tuning = tune(Problem(GAINS), SEEDS, 4, path, evaluate, lambda *done: calls.append(done))
    assert sum(done for done, _ in calls) == tuning.evaluations
    costs = [cost for _, cost in calls]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == tuning.best.cost


def ends_at(cost: float, falls_at: int = 50, before: float = 8.0) -> SearchResult:
    """A search of 100 evaluations whose cost falls once."""
    return SearchResult(1, {}, {}, (*[before] * falls_at, *[cost] * (100 - falls_at)))


def tuning_of(*searches: SearchResult, last: SearchResult) -> Tuning:
    return Tuning(Problem(GAINS), searches, (last,))


def test_a_last_search_begins_at_the_best_gains_in_small_steps(tmp_path: Path) -> None:
    tuning = tuned(tmp_path / "journal", evaluations_per_gain=10)
    start = min(tuning.searches, key=lambda search: search.cost)
    rows = [json.loads(line) for line in (tmp_path / "journal").read_text().split("\n")[1:]]
    first = [row["gains"] for row in rows if row["seed"] == 0][:7]  # a generation
    for gain in GAINS:
        away = [gain.share(gains[gain.name]) - gain.share(start.gains[gain.name]) for gains in first]
        assert 0.0 < max(map(abs, away)) < 0.25  # five of its steps
    assert tuning.best.cost == min(start.cost, tuning.refinements[-1].cost) < start.cost


def test_another_last_search_begins_where_one_ends_until_the_cost_is_flat(tmp_path: Path) -> None:
    """A cost that falls with each evaluation never is: four of them; the best of each is its last."""
    falling = iter(range(10_000, 0, -1))
    path = tmp_path / "journal"
    tuning = tune(Problem(GAINS), (1,), 10, path, at_once(lambda gains: {"cost": 1.02 ** next(falling)}))
    assert [search.seed for search in tuning.refinements] == [*REFINEMENTS]
    assert not tuning.is_flat
    assert len({search.cost for search in tuning.refinements}) == 4
    assert tuning.best == tuning.refinements[-1]
    flat = tune(Problem(GAINS), (1,), 10, tmp_path / "flat", at_once(lambda gains: {"cost": 1.0}))
    assert len(flat.refinements) == 1


def test_the_lowest_cost_must_not_fall_in_the_last_half_of_the_last_search() -> None:
    earlier = ends_at(8.0)
    assert tuning_of(earlier, last=ends_at(5.0, falls_at=49)).is_flat
    assert not tuning_of(earlier, last=ends_at(5.0, falls_at=50)).is_flat
    assert tuning_of(earlier, last=ends_at(5.0, falls_at=50)).improvement == pytest.approx(0.375)
    assert tuning_of(earlier, last=ends_at(5.0, falls_at=90, before=5.1)).is_flat  # by 1.96 %
    assert not tuning_of(earlier, last=ends_at(5.0, falls_at=90, before=5.11)).is_flat  # by 2.15 %
    assert tuning_of(ends_at(5.0), last=ends_at(5.0, falls_at=90)).is_flat  # a seed was there before
    assert tuning_of(ends_at(5.0), last=ends_at(6.0)).improvement == 0.0


def test_the_least_that_can_be_tuned_has_its_judgements(tmp_path: Path) -> None:
    """One gain, one seed, one evaluation: no part of the last search is the first one; it tells nothing."""
    tuning = tune(Problem(GAINS[:1]), [1], 1, tmp_path / "journal", at_once(lambda gains: {"cost": 4.0}))
    assert (tuning.improvement, tuning.evaluations, tuning.fewest) == (0.0, 2, 12)
    assert (tuning.is_flat, tuning.seeds_agree, tuning.is_long_enough) == (False, True, False)


def test_seeds_agree_if_most_come_near_the_lowest_cost() -> None:
    near, far, last = ends_at(5.24), ends_at(5.26), ends_at(5.0)
    assert tuning_of(ends_at(5.0), near, far, last=last).seeds_agree
    assert not tuning_of(ends_at(5.0), far, far, last=last).seeds_agree
    assert not tuning_of(near, near, near, last=ends_at(4.9)).seeds_agree
    assert tuning_of(ends_at(5.0), near, ends_at(7.0), last=last).spread == pytest.approx(0.048)


def test_the_file_holds_gains_for_scenarios_and_says_how_far_to_trust_them(tmp_path: Path) -> None:
    tuning = tuned(tmp_path / "journal", evaluations_per_gain=10)
    path = tmp_path / "gains.toml"
    tune_problem.write(tuning, {"law": "pi"}, {"protocol": "7"}, path)
    best = {f"controller.{name}": value for name, value in tuning.best.gains.items()}
    written = tomllib.loads(path.read_text())
    values = {name: entry["value"] for name, entry in written["parameters"].items()}
    assert values == {"controller.law": "pi", **best}
    assert written["tuning"]["is_flat"] is tuning.is_flat
    assert written["tuning"]["protocol"] == "7"
    assert written["tuning"]["evaluations"] == 10 * len(GAINS) * (len(SEEDS) + 1)
    assert [table["cost"] for table in written["tuning"]["seeds"]] == [s.cost for s in tuning.searches]
    entry = written["parameters"]["controller.kp"]
    assert (entry["unit"], entry["limits"]) == ("N/m", [0.1, 100.0])
    tables = [*written["tuning"]["seeds"], *written["tuning"]["refinements"]]
    for table, search in zip(tables, (*tuning.searches, *tuning.refinements), strict=True):
        assert (table["seed"], table["cost"]) == (search.seed, search.cost)
        assert table["evaluations"] == len(search.curve) == 10 * len(GAINS)
        assert table["gains"] == search.gains


def test_a_positive_range_is_searched_in_its_logarithm_and_another_one_is_not() -> None:
    assert [FreeParameter("k", 0.01, 100.0).rounded(x) for x in (0.0, 0.5, 1.0)] == [0.01, 1.0, 100.0]
    assert [FreeParameter("k", 0.0, 100.0).rounded(x) for x in (0.0, 0.5, 1.0)] == [0.0, 50.0, 100.0]
    assert FreeParameter("k", 1.0, 3.0).rounded(0.7) == 2.158  # 3^0.7 = 2.15767, to four digits
    assert FreeParameter("k", 1.00049, 3.0).rounded(0.0) == 1.00049  # rounding leaves no range


def test_a_gain_at_the_end_of_its_range_is_marked() -> None:
    gain = FreeParameter("k", 1.0, 100.0)
    assert [gain.is_at_a_limit(k) for k in (1.0, 1.04, 1.06, 10.0, 95.0, 96.0, 100.0)] == [
        True, True, False, False, False, True, True,
    ]  # fmt: skip


def test_an_option_names_gains_and_their_ranges() -> None:
    expected = [FreeParameter("kp", 1.0, 20.0), FreeParameter("a[1,2]"), FreeParameter("ki", -1.0, 2.0)]
    assert parse(["kp=1:20, a[1,2]", "ki=-1:2"]) == expected


@pytest.mark.parametrize("text", ["kp=", "kp=1", "kp=1:", "kp=a:b"])
def test_an_option_without_both_ends_of_its_range_is_refused(text: str) -> None:
    with pytest.raises(
        OrchestrationError, match=rf"--free {text}: expected NAME or NAME=LOW:HIGH, .* kp=1:20"
    ):
        parse([text])


@pytest.mark.parametrize("text", ["kp=2:1", "kp=1:1", "kp=0:inf", "kp=nan:1"])
def test_a_range_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(OrchestrationError, match="expected finite limits, the lower one first"):
        parse([text])


def test_gains_have_the_units_of_the_fmu(built: Mapping[str, Path]) -> None:
    description = describe(built["L1DepthController"])
    gains = with_units(parse(["integral_gain=0.001:0.1,observer_period=0.02:0.1"]), description)
    assert [gain.unit for gain in gains] == ["N/(m.s)", "s"]  # a tunable one, and a fixed one


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["proportional_gian=1:2"], "nearest is 'proportional_gain'"),
        (["augmentation=1:2"], "expected a parameter of type Real"),
        (["integral_gain"], "--free integral_gain: expected NAME=LOW:HIGH, such as integral_gain=1:20"),
        (["integral_gain=-1:1"], "expected limits within 0 to 1e6"),
        (["observer_alpha=0.1:1.5"], "expected limits within 0 to 1$"),
        (["integral_gain=1:2", "integral_gain=1:3"], "given twice"),
        ([], "tunable are .*proportional_gain"),
    ],
)
def test_a_gain_that_the_fmu_cannot_take_is_refused(
    built: Mapping[str, Path], options: list[str], message: str
) -> None:
    with pytest.raises(OrchestrationError, match=message):
        with_units(parse(options), describe(built["L1DepthController"]))
