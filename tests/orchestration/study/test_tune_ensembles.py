"""Evaluations in ensembles have the costs of evaluations one by one, and are made where that pays."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest

from orchestration.errors import EnsembleError
from orchestration.master import ensemble_choice
from orchestration.study import tune_ensembles
from orchestration.study.loop import Controller, Loop, built_in
from orchestration.study.protocol import Protocol
from orchestration.study.tune_cost import LARGEST, cost_of
from orchestration.study.tune_ensembles import ensembles, evaluations

GAINS = [
    *({"filter_bandwidth": 0.3 + 0.1 * i, "proportional_gain": 20.0 * i} for i in range(9)),
    {"filter_bandwidth": -1.0, "proportional_gain": 10.0},  # which the FMU refuses
]


@pytest.mark.slow
def test_the_costs_are_those_of_single_evaluations(protocol: Protocol) -> None:
    """Also of gains that fail, and of those that were in a group with them."""
    controller = built_in(protocol, "l1-pi")
    with ensembles(controller, protocol, 2, len(GAINS), is_asked_for=True) as evaluate:
        together = [*evaluate(GAINS)]
    with Loop(controller, protocol) as loop:
        assert together[:-1] == [cost_of(loop, gains) for gains in GAINS[:-1]]
    assert together[-1]["cost"] == LARGEST
    assert "filter_bandwidth = -1.0: expected" in together[-1]["failure"]
    assert all(math.isfinite(cost["cost"]) for cost in together)
    assert len({cost["cost"] for cost in together}) == 10


def test_few_evaluations_are_not_worth_a_compilation(
    protocol: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes evaluate them, and those of a controller of another tool or with a fault in its cases."""

    @contextmanager
    def processes(controller: Controller, protocol: Protocol, count: int) -> Iterator[Any]:
        def evaluate(gains: Sequence[Mapping[str, float]]) -> list[dict[str, Any]]:
            return [{"cost": float(count)} for _ in gains]

        yield evaluate

    monkeypatch.setattr(tune_ensembles, "processes", processes)
    monkeypatch.setattr(ensemble_choice, "is_compiled", lambda *_: False)
    with evaluations(built_in(protocol, "l1-pi"), protocol, 3, 10) as evaluate:
        assert [*evaluate([{}, {}])] == [{"cost": 3.0}] * 2
    tables = protocol.tables
    frozen = tables.model_copy(update={"cost": tables.cost.model_copy(update={"cases": ["frozen"]})})
    with (
        pytest.raises(EnsembleError, match="faults: an Ensemble does not run it"),
        ensembles(built_in(protocol, "l1-pi"), replace(protocol, tables=frozen), 1, 10_000),
    ):
        pass
