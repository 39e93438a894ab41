"""Both flavours are one model: the same trajectories, and from them the same tables."""

import os
from typing import Any

import numpy as np
import pytest

from fmus import catalogue
from fmus.registry import Flavour
from orchestration.results import figures as report
from orchestration.scenarios import reproduce, scenario
from orchestration.scenarios.reproduce import Result

# Python and C make the same double-precision operations in the same order, none contracted. A constant
# that CasADi inverted (x / 6 as x * (1 / 6)) or an elementary function may differ in its last bit, 1e-16;
# the fast adaptation loop of the example enlarges that to some 1e-12 of an estimate's amplitude. 1e-9 leaves
# room for other C libraries and is still far below everything that is measured.
AGREEMENT = 1e-9


@pytest.fixture(scope="session")
def python_results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Result]:
    """Every shipped scenario, run through the FMUs of the python flavour."""
    folder = tmp_path_factory.mktemp("python_reproduction")
    for path in scenario.shipped().values():
        catalogue.build_missing(scenario.load(path, flavour=Flavour.PYTHON).system.components.values())
    return reproduce.run_all(folder, os.cpu_count() or 1, flavour=Flavour.PYTHON)


@pytest.mark.parametrize("name", scenario.shipped())
def test_trajectories_agree(results: dict[str, Result], python_results: dict[str, Result], name: str) -> None:
    native, python = results[name].recording, python_results[name].recording
    assert native.names == python.names
    assert np.array_equal(native.time, python.time)
    amplitude = np.abs(python.values).max(axis=0)
    assert np.all(np.abs(native.values - python.values) <= AGREEMENT * amplitude)
    assert native.provenance["fmus"] != python.provenance["fmus"]


def test_the_tables_are_the_same(
    results: dict[str, Result], python_results: dict[str, Result], summary: dict[str, Any]
) -> None:
    by_python = report.summary({name: result.metrics for name, result in python_results.items()})
    assert summary.keys() == by_python.keys()
    for ours, theirs in zip(flat(summary), flat(by_python), strict=True):
        assert ours == (pytest.approx(theirs, rel=1e-6) if isinstance(theirs, float) else theirs)


def flat(value: Any) -> list[Any]:
    """Every leaf of nested plain data, in order."""
    if isinstance(value, dict):
        return [leaf for key in value for leaf in [key, *flat(value[key])]]
    if isinstance(value, list):
        return [leaf for each in value for leaf in flat(each)]
    return [value]
