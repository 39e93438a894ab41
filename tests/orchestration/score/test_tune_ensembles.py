"""Evaluations in processes and in vectors have the costs of evaluations one by one."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestration.many import ensemble
from orchestration.many.job import Job
from orchestration.many.runners import Isolated
from orchestration.score.closed_loop import ClosedLoop, built_in
from orchestration.score.protocol import Protocol, read_protocol
from orchestration.score.tune_problem import LARGEST, costs, evaluations
from tests.foreign_fmus import Misdeed
from tests.orchestration.score.controllers import rogue_doing
from tests.shared_builds import Build

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
