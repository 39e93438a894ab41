"""Plants of a row and evaluations of a tuning step together where that pays, with the same results."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from orchestration import Ensemble
from orchestration.many import ensemble
from orchestration.many.job import Done, Job, Run
from orchestration.many.runners import Isolated
from orchestration.studies.score import score_rows
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, built_in
from orchestration.studies.score.protocol import Protocol, read_protocol
from orchestration.studies.score.score import score_controllers
from orchestration.studies.score.score_document import ManyRuns
from orchestration.studies.score.tune_problem import LARGEST, costs, evaluations
from tests.foreign_fmus import Misdeed
from tests.orchestration.studies.score.controllers import rogue_doing
from tests.shared_builds import Build, built_once, session_folder

MINE = Controller("mine", "L1DepthController")  # three signals of each plant
Scored = Callable[..., tuple[ManyRuns, list[int]]]
COUNT = 19  # two groups and a part of one
VARY: Mapping[str, Any] = {
    "weight": {"variables": ["plant.weight"], "distribution": "loguniform", "low": 1e-3, "high": 30.0},
    "depth": {
        "variables": ["plant.initial_depth"],
        "distribution": "loguniform",
        "low": 1e-300,
        "high": 1e250,
    },
}


@pytest.fixture(scope="module")
def path(small_protocol: Callable[..., Path], protocol: Protocol) -> Path:
    """Plants of which some weigh less than their net weight, and some are too deep to go on."""
    data = protocol.file.data
    return small_protocol(
        plants={**data["plants"], "count": COUNT, "vary": {**protocol.vehicle.file.data["vary"], **VARY}},
        cases={"nominal": {**data["cases"]["nominal"], "parameters": {"plant.net_weight": 0.01}}},
        controllers={},
    )


@pytest.fixture(scope="module")
def _compiled(path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """The vehicle and its controller, once a session."""
    protocol = read_protocol(path)
    with ClosedLoop(MINE, protocol) as loop:
        system = loop.scenario(protocol.nominal).system
    built_once(
        session_folder(tmp_path_factory, "ensemble") / "vehicle", lambda path: Ensemble(system).close()
    )


@pytest.fixture
def plants_of(monkeypatch: pytest.MonkeyPatch) -> Scored:
    """What a row has of its plants, and how many runs were made at once in its process."""

    def score_plants(
        controller: Controller, path: Path, is_compiled: bool = True, crashes: bool = False
    ) -> tuple[ManyRuns, list[int]]:
        groups: list[int] = []
        made = Isolated._made

        def count(self: Isolated, runs: Sequence[Run]) -> list[Done]:
            groups.append(len(runs))
            if crashes and len(runs) > 1:
                self._running().kill()
            return made(self, runs)

        done: list[int] = []
        with monkeypatch.context() as patch:
            patch.setattr(ensemble, "is_compiled", lambda *_: is_compiled)
            patch.setattr(Isolated, "_made", count)
            # without other runs
            patch.setattr(score_rows, "_value_or", lambda default, *_: default)
            patch.setattr(score_rows, "repeated", lambda *_: {})
            result = score_controllers(
                [controller], read_protocol(path), full=True, seed=5, progress=done.append
            )
        assert sum(done) == 1 + read_protocol(path).tables.plants.count
        assert result.document.rows[0].plants is not None
        return result.document.rows[0].plants, groups

    return score_plants


@pytest.mark.slow
@pytest.mark.usefixtures("_compiled")
def test_plants_in_ensembles_have_the_metrics_and_failures_of_single_runs(
    plants_of: Scored, path: Path
) -> None:
    """Also those that cannot begin or go on, whose reasons are found by a simulator; and after a crash."""
    alone, groups = plants_of(MINE, path, is_compiled=False)
    assert groups == [1] * (1 + COUNT)
    reasons = " ".join(reason for of_plant in alone.failed.values() for reason in of_plant)
    for expected in ("expected net_weight below weight", "not finite any more", "not settled"):
        assert expected in reasons
    together, groups = plants_of(MINE, path)
    assert together.model_dump_json() == alone.model_dump_json()
    assert groups == [1, 8, 8, 3]
    crashed, groups = plants_of(MINE, path, crashes=True)
    assert crashed.model_dump_json() == alone.model_dump_json()
    assert sorted(groups) == [1] * (1 + COUNT) + [3, 8, 8]


@pytest.mark.slow
def test_plants_of_a_controller_of_another_tool_run_alone(
    plants_of: Scored, protocol: Protocol, small_protocol: Callable[..., Path], rogue: Build
) -> None:
    path = small_protocol(cases={"nominal": protocol.file.data["cases"]["nominal"]}, controllers={})
    result, groups = plants_of(rogue_doing(rogue(), Misdeed.ERROR), path)
    assert result.failure_rate == 1.0
    assert groups == [1] * (1 + 3)


GAINS = [
    *({"filter_bandwidth": 0.3 + 0.1 * i, "proportional_gain": 20.0 * i} for i in range(9)),
    {"filter_bandwidth": -1.0, "proportional_gain": 10.0},  # which the FMU refuses
]


@pytest.fixture
def used(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether the jobs that processes get are made in vectors."""
    vectors, use = list[bool](), Isolated.use

    def note(self: Isolated, job: Job, is_vectors: bool) -> None:
        vectors.append(is_vectors)
        use(self, job, is_vectors)

    monkeypatch.setattr(Isolated, "use", note)
    return vectors


@pytest.mark.slow
def test_the_costs_are_those_of_single_evaluations(
    protocol: Protocol, used: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of gains that fail, and of those that were in a group with them; the processes stay open."""
    controller = built_in(protocol, "l1-pi")
    monkeypatch.setattr(ensemble, "is_compiled", lambda *_: True)
    with evaluations(controller, protocol, 2, len(GAINS)) as evaluate:
        together = [*evaluate(GAINS)]
        assert [*evaluate(GAINS[:2])] == together[:2]
    assert used == [True, True]
    with ClosedLoop(controller, protocol) as loop:
        assert together[:-1] == [next(costs(loop, [gains])) for gains in GAINS[:-1]]
    assert together[-1]["cost"] == LARGEST
    assert "filter_bandwidth = -1.0: expected" in together[-1]["failure"]
    assert all(math.isfinite(cost["cost"]) for cost in together)
    assert len({cost["cost"] for cost in together}) == 10


@pytest.mark.slow
def test_gains_that_crash_a_controller_have_the_largest_cost_and_the_next_are_evaluated(
    small_protocol: Callable[..., Path], rogue: Build, used: list[bool]
) -> None:
    controller, protocol = rogue_doing(rogue(), Misdeed.SEGFAULT), read_protocol(small_protocol())
    with evaluations(controller, protocol, 1, 10_000) as evaluate:
        crashed, later = evaluate([{"misdeed_time": 1.0}, {"misdeed_time": 1e9}])
    assert used == [False]
    assert crashed == {"cost": LARGEST, "failure": "the worker process ended: SIGSEGV"}
    assert later["cost"] <= LARGEST
    assert "failure" not in later
