"""Both flavours are one model: the same trajectories, and from them the same tables."""

import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.registry import Flavour
from orchestration.master import simulate
from orchestration.results.recording import Recording
from orchestration.scenarios import reproduce, scenario
from orchestration.scenarios.paper_tables import summary as summary_of
from orchestration.scenarios.reproduce import Result
from tests.shared_builds import built_once, session_folder

# Python and C make the same double-precision operations in the same order, none contracted. A constant
# that CasADi inverted (x / 6 as x * (1 / 6)) or an elementary function may differ in its last bit, 1e-16;
# the fast adaptation loop of the example enlarges that to some 1e-12 of an estimate's amplitude. 1e-9 leaves
# room for other C libraries and is still far below everything that is measured.
AGREEMENT = 1e-9


def assert_same_trajectories(native: Recording, python: Recording) -> None:
    assert native.names == python.names
    assert np.array_equal(native.time, python.time)
    amplitude = np.abs(python.values).max(axis=0)
    assert np.all(np.abs(native.values - python.values) <= AGREEMENT * amplitude)
    assert native.provenance["fmus"] != python.provenance["fmus"]


@pytest.mark.parametrize("name", ["nominal-extended", "example-extended"])
def test_the_first_two_seconds_agree(scenario_fmus: None, python_fmus: None, name: str) -> None:
    """Of each pair of blocks; the whole of every scenario is compared below."""

    def first_two_seconds(flavour: Flavour) -> Recording:
        chosen = scenario.load(scenario.find(name), flavour=flavour)
        return simulate(chosen.system, replace(chosen.experiment, stop_time=2.0))

    assert_same_trajectories(first_two_seconds(Flavour.NATIVE), first_two_seconds(Flavour.PYTHON))


@pytest.fixture(scope="session")
def python_results(tmp_path_factory: pytest.TempPathFactory, python_fmus: None) -> dict[str, Result]:
    """Every shipped scenario, run through the FMUs of the python flavour."""
    folder = session_folder(tmp_path_factory, "python reproduction")

    def run_all(path: Path) -> None:
        results = reproduce.run_all(folder, os.cpu_count() or 1, flavour=Flavour.PYTHON)
        path.write_bytes(pickle.dumps(results))

    return pickle.loads(built_once(folder / "results.pickle", run_all).read_bytes())


@pytest.mark.slow
@pytest.mark.parametrize("name", reproduce.reproduced())
def test_trajectories_agree(results: dict[str, Result], python_results: dict[str, Result], name: str) -> None:
    assert_same_trajectories(results[name].recording, python_results[name].recording)


@pytest.mark.slow
def test_the_tables_are_the_same(
    results: dict[str, Result], python_results: dict[str, Result], summary_document: dict[str, Any]
) -> None:
    by_python = summary_of({name: result.metrics_with_units for name, result in python_results.items()})
    assert summary_document.keys() == by_python.keys()
    for ours, theirs in zip(flat(summary_document), flat(by_python), strict=True):
        assert ours == (pytest.approx(theirs, rel=1e-6) if isinstance(theirs, float) else theirs)


def flat(value: Any) -> list[Any]:
    """Every leaf of nested plain data, in order."""
    if isinstance(value, dict):
        return [leaf for key in value for leaf in [key, *flat(value[key])]]
    if isinstance(value, list):
        return [leaf for item in value for leaf in flat(item)]
    return [value]
