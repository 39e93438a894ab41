"""Tests of `.ci/fronts.py` and its parts: known fronts and their areas, a front, a search that continues."""

import json
import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from orchestration.cli.commands import run_application
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.score.closed_loop import ClosedLoop, built_in, tuned, tuned_gains
from orchestration.studies.score.protocol import Protocol, read_protocol, with_cost
from orchestration.studies.score.tune import Problem
from orchestration.studies.score.tune_problem import LARGEST, problem_of
from orchestration.studies.vehicle import Vehicle

sys.path.insert(0, str(Path(__file__).parent.parent / ".ci"))
import fronts  # pyright: ignore[reportMissingImports]
from comparison_fronts import DATA  # pyright: ignore[reportMissingImports]
from front_points import (  # pyright: ignore[reportMissingImports]
    Point,
    bounded_cost,
    hypervolume,
    is_converged,
    least_errors,
    nondominated,
    points_of,
    spread,
    with_margin,
)
from front_search import (  # pyright: ignore[reportMissingImports]
    LEVELS,
    free_gains,
    front_of_law,
    known_gains,
    search_fronts,
)
from fronts import (  # pyright: ignore[reportMissingImports]
    SPECIAL_CASES,
    STUDY,
    SpecialCase,
    application,
    fronts_of_vehicle,
)

sys.path.pop(0)
REFERENCE = Point(10.0, 1000.0)


@pytest.mark.parametrize("vehicle", STUDY)
def test_the_cases_of_each_vehicle_are_cases_of_the_protocol(vehicle: str) -> None:
    _, cases = STUDY[vehicle]
    protocol = with_cost(read_protocol(), {"cases": cases} if cases else {})
    assert {*protocol.tables.cost.cases} <= {*protocol.tables.cases}


def test_only_points_that_no_other_betters_are_a_front() -> None:
    a, b, c = Point(3.0, 1.0), Point(2.0, 5.0), Point(1.0, 5.0)
    assert nondominated([b, c, a, Point(3.0, 1.0), Point(3.0, 2.0), Point(1.5, 9.0)]) == [a, c]
    assert nondominated([]) == []


@pytest.mark.parametrize(
    ("points", "area"),
    [
        ([], 0.0),
        ([Point(1.0, 100.0)], 1.0),  # a decade of error times one of variation
        ([Point(1.0, 10.0), Point(0.1, 100.0)], 1.0 * 1.0 + 1.0 * 2.0),
        ([Point(0.1, 100.0), Point(1.0, 10.0), Point(1.0, 100.0), Point(5.0, 11.0)], 3.0),  # two dominated
        ([Point(1.0, 10.0), Point(0.1, 100.0), Point(0.01, 1000.0), Point(20.0, 1.0)], 3.0),  # two outside
    ],
)
def test_the_hypervolume_of_a_known_front_is_its_area_in_decades(points: list[Point], area: float) -> None:
    assert hypervolume(points, REFERENCE) == pytest.approx(area, abs=1e-12)  # rounding of log10


def test_a_variation_below_the_least_counts_as_that_one() -> None:
    """A decade times one, whatever a law does with less."""
    assert hypervolume([Point(1.0, 1.0), Point(5.0, 0.1)], REFERENCE, 100.0) == pytest.approx(1.0)


def test_points_without_the_margin_go_before_they_hide_others() -> None:
    quick, sound, slow = Point(1.0, 5.0, {"k": 3}), Point(2.0, 5.0, {"k": 2}), Point(3.0, 1.0, {"k": 1})
    assert nondominated([quick, sound, slow]) == [slow, quick]
    assert with_margin([quick, sound, slow], lambda gains: gains["k"] < 3) == [slow, sound]
    assert with_margin([quick], lambda gains: False) == []


@pytest.mark.parametrize(
    ("half", "errors", "expected"),
    [
        ([[1.0, 2.0], [1.2, 2.1]], [[1.0, 2.0], [1.04, 2.0]], True),
        ([[1.0, 2.0]] * 3, [[1.0, 2.0], [1.0, 2.09], [1.5, 2.5]], True),  # half of the seeds, as in a tuning
        ([[1.0, 2.0]] * 3, [[1.0, 2.0], [1.0, 2.11], [1.0, 2.5]], False),  # one seed alone within one bound
        ([[1.06, 2.0], [1.06, 2.0]], [[1.0, 2.0], [1.0, 2.0]], False),  # the second budget has found more
        ([[1.0, 2.0]], [[1.0, 2.0]], False),  # one seed shows nothing
        ([[1.0, math.inf], [1.0, math.inf]], [[1.0, math.inf], [1.0, math.inf]], False),
    ],
)
def test_a_front_is_converged_where_seeds_and_budgets_agree_within_every_bound(
    half: list[list[float]], errors: list[list[float]], expected: bool
) -> None:
    assert is_converged(half, errors) == expected


def test_the_least_errors_are_those_within_the_bounds() -> None:
    front = [Point(3.0, 50.0), Point(2.0, 100.0), Point(1.0, 101.0)]
    assert least_errors(front, [200.0, 100.0, 20.0]) == [1.0, 2.0, math.inf]


def test_the_spread_is_the_range_over_the_median_and_one_seed_has_none() -> None:
    assert spread([2.1, 1.9, 2.0]) == pytest.approx(0.1)
    assert math.isnan(spread([2.0]))
    assert math.isnan(spread([0.0, 0.0]))  # no seed found anything


def row(error: float, *variations: float, cost: float | None = None, failed: int = 0) -> dict[str, Any]:
    cases = {str(i): {"total_variation": value} for i, value in enumerate(variations)}
    cost = error if cost is None else cost
    return {"cost": cost, "error": error, "metrics": cases, "failed": failed, "gains": {}}


def test_an_evaluation_beyond_the_bound_loses_against_one_with_a_larger_error_within_it() -> None:
    near, beyond = row(0.5, 50.0, 100.0), row(0.2, 90.0, 120.0)
    assert bounded_cost(near, 100.0) == 0.5
    # as `tune` has it: the mean over the cases of what each is beyond
    assert bounded_cost(beyond, 100.0) == pytest.approx(0.2 + 10.0 * 0.2 / 2)
    assert bounded_cost(beyond, 120.0) == 0.2
    assert bounded_cost({"cost": LARGEST, "failure": "ended"}, 100.0) == LARGEST


def test_a_front_admits_what_keeps_every_bound_and_does_not_fail() -> None:
    rows = [
        row(0.5, 100.0),
        row(0.4, 90.0, 100.1),  # beyond the largest variation in one case
        row(0.3, 90.0, cost=0.31),  # beyond another bound
        row(0.2, 90.0, failed=1),
        {"cost": LARGEST, "failure": "ended", "gains": {}},
    ]
    assert points_of(rows, 100.0) == [Point(0.5, 100.0, {})]


def known(gains: Mapping[str, float]) -> dict[str, Any]:
    """A law whose error times variation is at least 100, reached if the second gain is 1."""
    away = 1.0 + math.log(gains["b"]) ** 2
    evaluated = row(away * 100.0 / gains["a"], away * gains["a"])
    del evaluated["gains"]
    return evaluated


LARGEST_VARIATION = 640.0
PROBLEM = Problem((FreeParameter("a", 1.0, 1000.0), FreeParameter("b", 0.1, 10.0)), {"law": "known"})


def fronts_of(path: Path, law: Callable[..., Any] = known, **options: Any) -> list[list[list[Point]]]:
    """Returns of each seed its front at half of the budget and at all of it."""
    evaluate = lambda gains: map(law, gains)  # noqa: E731
    found = search_fronts(PROBLEM, (1, 2), 15, LARGEST_VARIATION, path, evaluate, **options)
    return [[nondominated(points_of(rows, LARGEST_VARIATION)) for rows in both] for both in found]


def test_the_front_of_a_known_law_is_found_over_all_bounds(tmp_path: Path) -> None:
    found = fronts_of(tmp_path / "journal")
    for half, front in found:
        # each bound is reached from below, the last of which is a 16th of the first
        for level in range(LEVELS):
            bound = LARGEST_VARIATION * 0.5**level
            assert any(0.8 * bound < point.variation <= bound for point in front)
        # the true front is error x variation = 100; 60 evaluations a bound leave some per cent
        assert all(1.0 <= p.error * p.variation / 100.0 < 1.3 for p in front if p.variation >= 40.0)
        assert hypervolume(half, Point(10.0, 640.0)) < hypervolume(front, Point(10.0, 640.0))
    volumes = [hypervolume(front, Point(10.0, LARGEST_VARIATION)) for _, front in found]
    assert spread(volumes) < 0.05
    # the area between the true front and the reference, from 40 N on
    width, height = math.log10(16.0), math.log10(10.0 / 2.5)
    exact = width**2 / 2 + height * width
    assert 0.9 * exact < min(volumes)  # steps between points lie inside it
    assert found[0] != found[1]


def journal(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().split("\n")[1:] if line]


def test_all_seeds_begin_near_the_best_of_the_gains_that_are_given(tmp_path: Path) -> None:
    begin = [{"a": 30.0, "b": 9.0}, {"a": 30.0, "b": 2.0}]
    fronts_of(tmp_path / "j", begin=begin)
    rows = journal(tmp_path / "j")
    # the search evaluates them, too: CMA-ES would not
    assert [row["gains"] for row in rows if row["seed"] == 0] == begin
    for seed in (1, 2):
        gains = next(row["gains"] for row in rows if row["seed"] == seed)
        for gain in PROBLEM.gains:
            # four steps of a twentieth of the range
            assert abs(gain.share(gains[gain.name]) - gain.share(begin[1][gain.name])) < 0.2


def test_a_law_is_never_behind_its_special_case(tmp_path: Path) -> None:
    """The law itself is blind here: it finds nothing beside what the special case has."""
    (_, special), _ = fronts_of(tmp_path / "special")
    begin = {f"{point.gains['a']} 0.05": point for point in special}

    def blind(gains: Mapping[str, float]) -> dict[str, Any]:
        point = begin.get(f"{gains['a']} {gains['b']}")
        return known(point.gains) if point else {"cost": LARGEST, "failure": "ended"}

    gains = [{**point.gains, "b": 0.05} for point in special]
    for half, front in fronts_of(tmp_path / "law", blind, begin=gains):
        assert [point[:2] for point in half] == [point[:2] for point in special]
        assert [point[:2] for point in front] == [point[:2] for point in special]
        assert {point.gains["b"] for point in front} == {0.05}  # beyond the range of the search
    # its searches begin there, within their ranges
    begins = [row["gains"] for row in journal(tmp_path / "law") if row["seed"]]
    assert sum(gains["b"] < 0.3 for gains in begins) > len(begins) / 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "special"),
    [
        pytest.param(name, case, id=f"{name}-{case.law}")
        for name, cases in SPECIAL_CASES.items()
        for case in cases
    ],
)
def test_a_special_case_has_the_run_of_the_law_that_contains_it(
    name: str, special: SpecialCase, protocol: Protocol
) -> None:
    law, case = tuned(protocol, name), tuned(protocol, special.law)
    own = protocol.controllers[name].parameters
    values = {**law.parameters, **special.of_law(case.parameters), **own, **special.gains}
    same = replace(law, parameters=values, step=case.step)
    with ClosedLoop(same, protocol) as one, ClosedLoop(case, protocol) as other:
        expected, run = (loop.run(protocol.nominal).values for loop in (other, one))
    # but for a gain of 1e-6 N/m that L1 needs: 2e-8 of a voltage
    tolerance = 1e-6 if special.law == "pid" and name.startswith("l1") else 0.0
    assert np.all(np.abs(run - expected) <= tolerance * np.abs(expected).max(axis=0))


def test_laws_that_are_not_searched_come_from_a_file_of_the_same_effort(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A law begins at its own points there, and at those of its special cases."""
    known_fronts = json.loads(DATA.read_text(encoding="utf-8"))
    of_vehicle = next(d for d in known_fronts if d["vehicle"] == protocol.vehicle.name)
    count = of_vehicle["effort"]["evaluations_per_gain_bound_and_seed"]
    with pytest.raises(OrchestrationError, match=rf"--known: effort .*: {count},.*: expected .*: 1,"):
        fronts_of_vehicle(protocol, ["l1-pi"], 5, 1, 1, tmp_path, known_fronts)
    begun = list[Any]()

    def searched(protocol: Protocol, name: str, *options: Any) -> dict[str, Any]:
        begun.extend(options[-1])
        return {"name": name, "points": []}

    monkeypatch.setattr(fronts, "front_of_law", searched)
    monkeypatch.setattr(fronts, "tutorial_mpc", lambda *_: {})
    laws = {law["name"]: law for law in of_vehicle["laws"]}
    found = fronts_of_vehicle(protocol, ["l1-pi"], 5, count, 1, tmp_path, known_fronts)["laws"]
    assert [law["name"] for law in found] == [*laws]
    assert [law for law in found if law["name"] != "l1-pi"] == [laws["l1"], laws["pid"]]
    gains = {name: [point["gains"] for point in law["points"]] for name, law in laws.items()}
    own, of_l1, of_pid = (len(gains[name]) for name in ("l1-pi", "l1", "pid"))
    assert len(begun) == own + of_l1 + of_pid
    assert begun[:own] == gains["l1-pi"]
    assert [start["proportional_gain"] for start in begun[own : own + of_l1]] == [0.0] * of_l1
    assert [start["proportional_gain"] for start in begun[-of_pid:]] == [g["kp"] for g in gains["pid"]]


def test_tuned_gains_are_carried_to_another_vehicle_by_its_inertia(protocol: Protocol) -> None:
    """Forces are proportional to the inertia; an adaptation gain, whose model has 1 / M, to its square."""
    ratio = 32.18 / 5.5
    other = read_protocol(vehicle=Vehicle.of("BlueRov2Plant"))
    for name, factors in {
        "pid": {"kp": ratio, "observer_alpha": 1.0},
        "l1": {"adaptation_gain": ratio**2},
    }.items():
        table = protocol.controllers[name]
        gains, own = problem_of(built_in(protocol, name), protocol).gains, tuned_gains(name, table.fmu)
        assert tuned(protocol, name).parameters == {**table.parameters, **own}
        assert known_gains(protocol, name, gains)[0] == {gain.name: own[gain.name] for gain in gains}
        carried, _ = known_gains(other, name, gains)
        for gain, factor in factors.items():
            assert carried[gain] == pytest.approx(float(own[gain]) * factor)


def test_what_tune_leaves_is_free_in_every_law_that_has_it(protocol: Protocol) -> None:
    free = {name: {gain.name for gain in free_gains(protocol, name)} for name in protocol.controllers}
    for name, gains in free.items():
        adapts = name.startswith(("l1", "mrac")) and name != "l1-piecewise"
        assert ("sigma_bound" in gains) == adapts, name
        assert bool(gains & {"theta_bound", "theta_bound[1]"}) == adapts, name
        assert ("disturbance_ratio" in gains) == name.startswith("adrc"), name
        assert gains >= protocol.controllers[name].gains.keys()


@pytest.mark.parametrize("calls", [7, 100])
def test_an_interrupted_front_continues_to_the_same_one_bit_for_bit(tmp_path: Path, calls: int) -> None:
    left = calls

    def interrupted(gains: Mapping[str, float]) -> dict[str, Any]:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        return known(gains)

    path = tmp_path / "journal"
    with pytest.raises(KeyboardInterrupt):
        fronts_of(path, interrupted)
    left = 15 * 2 * LEVELS * 2 * 2 - calls  # not one evaluation is made twice
    assert fronts_of(path, interrupted) == fronts_of(tmp_path / "other")
    assert left == 0
    assert path.read_bytes() == (tmp_path / "other").read_bytes()


def test_a_front_without_a_bound_on_the_variation_is_refused(protocol: Protocol, tmp_path: Path) -> None:
    cost = {**protocol.file.data["cost"], "cases": ["nominal"], "bounds": {"overshoot": 5.0}}
    path = tmp_path / "protocol.toml"
    path.write_text(tomli_w.dumps({**protocol.file.data, "cost": cost}))
    with pytest.raises(ScenarioError, match="expected --bound total_variation=NUMBER"):
        front_of_law(read_protocol(path), "l1-pi", [1], 1, 1, Path("journal"))


@pytest.fixture(scope="module")
def protocol(scenario_fmus: None) -> Protocol:
    """The protocol that ships; blocks are built."""
    return read_protocol()


@pytest.mark.parametrize("content", ['{"a": 1}', "[1]", "{"])
def test_a_file_that_holds_no_fronts_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(content)
    with pytest.raises(OrchestrationError, match=r"--known .*other\.json: .*expected a fronts\.json"):
        fronts.known_fronts(tmp_path / "other.json")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--laws", "pidd"], "nearest is 'pid'"),
        (["--cases", "nominel"], "nearest is 'nominal'"),
        (["--bound", "overshot=3"], "nearest is 'overshoot'"),
        (["--bound", "overshoot=0"], "cost.bounds.overshoot"),
        (["--bound", "overshoot"], "expected METRIC=NUMBER"),
    ],
)
def test_what_has_no_front_is_refused(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OrchestrationError, match=re.escape(message)):
        run(*arguments)
    assert not Path("results").exists()


def run(*arguments: str) -> None:
    """Runs the command line of the script."""
    application()([*arguments], standalone_mode=False)


def test_a_failure_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.py").write_text("import nunpy\n")
    with pytest.raises(SystemExit) as end:
        run_application(application, ["--plant", "bad.py"], "fronts.py")
    assert end.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "bad.py:1: ModuleNotFoundError: No module named 'nunpy'" in line


@pytest.mark.slow
def test_the_front_of_a_law_is_written_with_its_margins_and_drawn(
    scenario_fmus: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ("--plant", "RovDepthPlant", "--seeds", "2", "--evaluations", "4", "--workers", "1")
    run("--laws", "adrc", *options, "--out", "here")
    folder = Path("here", "RovDepthPlant")
    files = [str(folder / name) for name in ("fronts.json", "fronts.svg")]
    assert capsys.readouterr().out.splitlines()[-2:] == files
    document = json.loads((folder / "fronts.json").read_text())
    assert document["effort"] == {
        "evaluations_per_gain_bound_and_seed": 4,
        "budgets": 2,
        "bounds": LEVELS,
        "seeds": [1, 2],
        "step": 0.02,
    }
    (law,) = document["laws"]
    assert re.match("[0-9a-f]{12}", law["revision"])
    points = [Point(p["error"], p["total_variation"]) for p in law["points"]]
    assert len(points) > 1
    assert nondominated(points) == points
    assert all(p["delay_margin"] >= 0.1 for p in law["points"])
    assert (np.array(law["least_errors_at_half"]) >= law["least_errors"]).all()
    assert min(column[0] for column in law["least_errors"]) == points[-1].error
    (mpc,) = document["without_front"]
    assert mpc["error"] < 1.0  # cm
    assert law["spread"] == pytest.approx(spread(law["hypervolumes"]))
    assert law["is_converged"] == is_converged(law["least_errors_at_half"], law["least_errors"])
    gains = ["control_bandwidth", "observer_bandwidth", "disturbance_ratio"]
    assert list(law["points"][0]["gains"]) == gains
    assert all(math.isfinite(p["change_at_half_the_step"]) for p in law["points"])
