"""The plants of a row step together where that pays, and the row is the same to the last bit."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from orchestration import Ensemble
from orchestration.many import ensemble_checks
from orchestration.score.isolated_loop import IsolatedLoop, RunError
from orchestration.score.loop import Controller, Loop
from orchestration.score.protocol import Protocol, read_protocol
from orchestration.score.score import score
from orchestration.score.score_document import PlantsResult
from orchestration.score.scored_run import load_ensemble, scored_run, scored_runs
from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build, built_once, session_folder

MINE = Controller("mine", "L1DepthController", league="reference-rates")  # three signals of each plant
Scored = Callable[..., tuple[PlantsResult, Counter[str]]]
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
        plants={**data["plants"], "count": COUNT, "vary": {**data["plants"]["vary"], **VARY}},
        cases={"nominal": {**data["cases"]["nominal"], "parameters": {"plant.net_weight": 0.01}}},
        controllers={},
    )


@pytest.fixture(scope="module")
def _compiled(path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """The vehicle and its controller, once a session."""
    protocol = read_protocol(path)
    with Loop(MINE, protocol) as loop:
        system = loop.scenario(protocol.nominal).system
    built_once(
        session_folder(tmp_path_factory, "ensemble") / "vehicle", lambda path: Ensemble(system).close()
    )


@pytest.fixture
def plants_of(path: Path, monkeypatch: pytest.MonkeyPatch) -> Scored:
    """What a row has of its plants, and how often each function was called in its process."""

    def score_plants(
        controller: Controller, is_compiled: bool, crashes: bool = False
    ) -> tuple[PlantsResult, Counter[str]]:
        calls: Counter[str] = Counter()
        call = IsolatedLoop.call

        def count(self: IsolatedLoop, function: Callable[..., Any], *arguments: Any, runs: int = 1) -> Any:
            calls[function.__name__] += 1
            has_figures = function in (load_ensemble, scored_run, scored_runs)
            if not has_figures or (crashes and function is scored_runs):
                raise RunError("its process ended with SIGSEGV")  # and no time is taken for other figures
            return call(self, function, *arguments, runs=runs)

        done: list[int] = []
        with monkeypatch.context() as patch:
            patch.setattr(ensemble_checks, "is_compiled", lambda *_: is_compiled)
            patch.setattr(IsolatedLoop, "call", count)
            result = score([controller], read_protocol(path), full=True, progress=done.append)
        assert sum(done) == 1 + COUNT
        assert result.document.rows[0].plants is not None
        return result.document.rows[0].plants, calls

    return score_plants


@pytest.mark.usefixtures("_compiled")
def test_plants_in_ensembles_have_the_figures_and_failures_of_single_runs(plants_of: Scored) -> None:
    """Also those that cannot begin or go on, whose reasons are found by a simulator; and after a crash."""
    alone, calls = plants_of(MINE, is_compiled=False)
    assert calls["scored_run"] == 1 + COUNT
    assert "scored_runs" not in calls
    reasons = " ".join(reason for of_plant in alone.failed.values() for reason in of_plant)
    for expected in ("expected net_weight below weight", "not finite any more", "not settled"):
        assert expected in reasons
    together, calls = plants_of(MINE, is_compiled=True)
    assert together.model_dump_json() == alone.model_dump_json()
    assert calls["scored_runs"] == 3
    ended_early = sum(map(math.isnan, alone.figures["rmse"].values))
    assert calls["scored_run"] == 1 + ended_early < 1 + COUNT // 2
    crashed, calls = plants_of(MINE, is_compiled=True, crashes=True)
    assert crashed.model_dump_json() == alone.model_dump_json()
    assert calls["scored_run"] == 1 + COUNT


def test_plants_of_a_controller_of_another_tool_run_alone(plants_of: Scored, rogue: Build) -> None:
    mapping = {"depth_reference": "u", "control_force": "y"}
    parameters = {"misdeed": Misdeed.ERROR.name.lower(), "misdeed_time": 1.0}
    result, calls = plants_of(Controller("rogue", str(rogue()), "position", "", parameters, mapping), True)
    assert result.failure_rate == 1.0
    assert calls["scored_run"] == 1 + COUNT
    assert "scored_runs" not in calls
