"""Evaluations in ensembles have the costs of evaluations one by one, and are made where that pays."""

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fmus.registry import fmu_path
from orchestration.errors import EnsembleError, ScenarioError
from orchestration.many import ensemble_checks
from orchestration.score import figures_of_all as together_module
from orchestration.score import loop as loop_module
from orchestration.score import tune_ensembles
from orchestration.score.loop import Controller, Loop, built_in
from orchestration.score.protocol import Protocol
from orchestration.score.tune_cost import LARGEST, cost_of
from orchestration.score.tune_ensembles import ensembles, evaluations

GAINS = [
    *({"filter_bandwidth": 0.3 + 0.1 * i, "proportional_gain": 20.0 * i} for i in range(9)),
    {"filter_bandwidth": -1.0, "proportional_gain": 10.0},  # which the FMU refuses
]


@pytest.mark.slow
def test_the_costs_are_those_of_single_evaluations(
    protocol: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of gains that fail, or whose figures do, and of those that were in a group with them."""

    def fails(*arguments: object) -> None:
        raise ScenarioError("no figure")

    controller = built_in(protocol, "l1-pi")
    with ensembles(controller, protocol, 2, len(GAINS), is_asked_for=True) as evaluate:
        together = [*evaluate(GAINS)]
        monkeypatch.setattr(together_module, "figures_of", fails)
        assert [*evaluate(GAINS[:2])] == together[:2]  # of which the loop has the figures
        monkeypatch.setattr(loop_module, "figures_of", fails)
        assert [*evaluate(GAINS[:2])] == [{"cost": LARGEST, "failure": "no figure"}] * 2
        monkeypatch.undo()
    with Loop(controller, protocol) as loop:
        assert together[:-1] == [cost_of(loop, gains) for gains in GAINS[:-1]]
    assert together[-1]["cost"] == LARGEST
    assert "filter_bandwidth = -1.0: expected" in together[-1]["failure"]
    assert all(math.isfinite(cost["cost"]) for cost in together)
    assert len({cost["cost"] for cost in together}) == 10


def test_few_evaluations_are_not_worth_a_compilation(
    protocol: Protocol, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Processes evaluate them, and those of a controller not built here or with a fault in its cases."""

    @contextmanager
    def processes(controller: Controller, protocol: Protocol, count: int) -> Iterator[Any]:
        def evaluate(gains: Sequence[Mapping[str, float]]) -> list[dict[str, Any]]:
            return [{"cost": float(count)} for _ in gains]

        yield evaluate

    monkeypatch.setattr(tune_ensembles, "processes", processes)
    monkeypatch.setattr(ensemble_checks, "is_compiled", lambda *_: False)
    with evaluations(built_in(protocol, "l1-pi"), protocol, 3, 10) as evaluate:
        assert [*evaluate([{}, {}])] == [{"cost": 3.0}] * 2
    mine = shutil.copy(fmu_path(built_in(protocol, "l1-pi").fmu), tmp_path)
    with (
        pytest.raises(EnsembleError, match="was not built here"),
        ensembles(Controller("mine", str(mine)), protocol, 1, 10_000, is_asked_for=True),
    ):
        pass
    tables = protocol.tables
    frozen = tables.model_copy(update={"cost": tables.cost.model_copy(update={"cases": ["frozen"]})})
    with (
        pytest.raises(EnsembleError, match="faults: an Ensemble does not run it"),
        ensembles(built_in(protocol, "l1-pi"), replace(protocol, tables=frozen), 1, 10_000),
    ):
        pass
