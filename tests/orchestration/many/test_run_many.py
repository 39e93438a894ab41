"""Many runs are those of `simulate`, in the order given, wherever they are made."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from orchestration import Failure, Recording, run_many, simulate
from orchestration.errors import EnsembleError
from orchestration.many import ensemble
from orchestration.many.job import ENDED, Job, Run, changed, differences
from orchestration.many.places import place_of
from orchestration.many.runners import Simulated
from orchestration.results import metrics
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.signals import Constant
from orchestration.system.system import System

INERTIAS = (5.0, 5.5, 6.0, -1.0, 6.5, 5.2, 5.1, 5.3, 5.4)  # the fourth is refused


@pytest.fixture
def nominal(vehicle_fmus: None) -> Scenario:
    loaded = scenario.load(scenario.find("nominal-extended"))
    return replace(loaded, experiment=replace(loaded.experiment, stop_time=1.0))


@pytest.fixture
def experiments(nominal: Scenario) -> list[Experiment]:
    given = nominal.experiment
    return [replace(given, parameters={**given.parameters, "plant.inertia": m}) for m in INERTIAS]


def rmse(runs: Recording) -> Sequence[float]:
    return metrics.rmse(runs, "plant.depth", "controller.depth_reference").tolist()


@pytest.mark.parametrize(
    "place",
    [
        {"where": "processor", "workers": 1},
        {"where": "vectors", "workers": 1},
        pytest.param({"where": "processes", "workers": 2}, marks=pytest.mark.cluster),
    ],
)
def test_recordings_come_in_the_order_given_with_the_bytes_of_simulate(
    nominal: Scenario, experiments: list[Experiment], place: dict[str, Any]
) -> None:
    made = list(run_many(nominal.system, experiments, **place))
    assert len(made) == len(INERTIAS)
    for inertia, experiment, recording in zip(INERTIAS, experiments, made, strict=True):
        if inertia < 0.0:
            assert isinstance(recording, Failure)
            assert "plant.inertia = -1.0: expected" in recording.reason
            continue
        alone = simulate(nominal.system, experiment)
        assert recording.names == alone.names
        assert recording.provenance == alone.provenance
        assert recording.time.tobytes() == alone.time.tobytes()
        assert recording.values.tobytes() == alone.values.tobytes()


@pytest.mark.parametrize("where", ["processor", "vectors"])
def test_a_reduction_takes_the_place_of_recordings(
    nominal: Scenario, experiments: list[Experiment], where: str
) -> None:
    made = list(run_many(nominal.system, experiments, reduce=rmse, where=where))
    expected = [
        metrics.rmse(simulate(nominal.system, one), "plant.depth", "controller.depth_reference")
        for one, inertia in zip(experiments, INERTIAS, strict=True)
        if inertia > 0.0
    ]
    assert [value for value in made if not isinstance(value, Failure)] == expected


@pytest.mark.cluster
def test_a_process_steps_runs_together(
    nominal: Scenario, experiments: list[Experiment], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ensemble, "is_compiled", lambda *_: True)

    def counts(runs: Recording) -> list[int]:
        return [len(runs.values)] * len(runs.values)

    valid = [*experiments[:3], *experiments[4:]]
    made = run_many(nominal.system, valid, reduce=counts, where="processes", workers=1)
    assert list(made) == [8] * 8


@pytest.mark.parametrize(
    ("where", "problem"),
    [
        ("vektors", "no place 'vektors' for runs; nearest is 'vectors'"),
        ("ftp://a:1", "no place 'ftp://a:1' for runs; .*; the address of a scheduler is tcp://HOST:PORT"),
    ],
)
def test_a_place_that_is_not_installed_is_refused(where: str, problem: str) -> None:
    with pytest.raises(EnsembleError, match=problem):
        place_of(where)


def test_a_reduction_that_fails_for_one_run_is_a_failure_of_that_run_alone(
    nominal: Scenario, experiments: list[Experiment]
) -> None:
    first = simulate(nominal.system, experiments[0])["plant.depth"]

    def not_the_first(runs: Recording) -> list[float]:
        if any(np.array_equal(run, first) for run in runs["plant.depth"]):
            raise ValueError("the first")
        return runs["plant.depth"][:, -1].tolist()

    for where in ("processor", "vectors"):
        made = list(run_many(nominal.system, experiments, reduce=not_the_first, where=where))
        assert made[0] == Failure("ValueError: the first")
        assert [type(value) for value in made[1:3]] == [float, float]


def test_experiments_that_differ_in_more_than_values_step_in_vectors_of_their_own(
    nominal: Scenario, experiments: list[Experiment]
) -> None:
    mixed = [*experiments[:2], replace(experiments[2], stop_time=0.5)]
    for where in ("vectors", "processor"):
        made = run_many(nominal.system, mixed, where=where)
        assert [len(one.time) for one in made] == [51, 51, 26]
    tolerant = [replace(one, tolerance=1e-4) for one in mixed]
    with pytest.raises(EnsembleError, match="tolerance: an Ensemble does not run it"):
        list(run_many(nominal.system, tolerant, where="vectors"))


@pytest.mark.slow
def test_a_foreign_fmu_that_crashes_is_a_failure_and_leaves_no_process(rogue: Callable[..., Path]) -> None:
    before = set(psutil.Process().children(recursive=True))
    good = Experiment(1.0, 0.1, inputs={"r.u": 2.0})
    bad = replace(good, parameters={"r.misdeed": "segfault", "r.misdeed_time": 0.5})
    made = list(run_many(System({"r": rogue()}), [good, bad, good], workers=1))
    assert made[1] == Failure("the worker process ended: SIGSEGV", ENDED)
    assert made[0].values.tolist() == made[2].values.tolist()
    assert set(psutil.Process().children(recursive=True)) <= before


def test_no_experiments_are_no_runs(nominal: Scenario) -> None:
    assert list(run_many(nominal.system, [])) == []


def test_runs_end_when_nobody_asks_for_the_next(
    nominal: Scenario, experiments: list[Experiment], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Run] = []
    run_one = Simulated.run_one
    monkeypatch.setattr(Simulated, "run_one", lambda self, run: (made.append(run), run_one(self, run))[1])
    threads = threading.active_count()
    runs = run_many(nominal.system, experiments * 20, where="processor", workers=2)
    next(runs)
    runs.close()  # type: ignore[attr-defined]
    assert 1 <= len(made) < len(experiments * 20)
    assert threading.active_count() == threads


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"parameters": {"p.a": 2.0, "p.b": -0.0}},
        {"parameters": {"p.a": 1.0}},
        {"inputs": {"p.u": 1.0}, "stop_time": 2.0},
        {"signals": {"p.v": Constant(3.0)}},
    ],
)
def test_an_experiment_is_what_its_differences_make_of_the_base(changes: dict[str, Any]) -> None:
    """Also where an entry is missing, or is 0 of another sign."""
    base = Experiment(1.0, 0.1, parameters={"p.a": 1.0, "p.b": 0.0}, signals={"p.v": Constant(1.0)})
    other = replace(base, **changes)
    assert repr(changed(base, differences(base, other))) == repr(other)
    assert differences(base, replace(base)) == ({}, {})


@pytest.mark.parametrize(
    "change", [{"timeout": 2.0}, {"not_in_vectors": "it has noise"}, {"system": System({})}]
)
def test_a_job_with_another_limit_or_system_is_not_made_with_what_is_loaded(change: dict[str, Any]) -> None:
    job = Job(System({"p": Path("p.fmu")}), Experiment(1.0, 0.1), timeout=1.0)
    assert job.is_like(replace(job, base=Experiment(2.0, 0.1)))
    assert not job.is_like(replace(job, **change))
    assert not replace(job, **change).is_like(job)
