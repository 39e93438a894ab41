"""Packages of the scenarios that importers run, and what our master makes of them."""

from collections.abc import Mapping

import pytest

from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from tests.importers.comparison import SCENARIOS, packaged
from tests.importers.importers import ImporterJob


@pytest.fixture(scope="session")
def loaded(scenario_fmus: None) -> Mapping[str, Scenario]:
    return {name: scenario.load(scenario.find(name)) for name in SCENARIOS}


@pytest.fixture(scope="session")
def jobs(tmp_path_factory: pytest.TempPathFactory, loaded: Mapping[str, Scenario]) -> dict[str, ImporterJob]:
    folder = tmp_path_factory.mktemp("packages")
    return {name: packaged(chosen, folder) for name, chosen in loaded.items()}


@pytest.fixture(scope="session")
def ours(loaded: Mapping[str, Scenario]) -> dict[str, Recording]:
    """The scenarios themselves, not the packages: packing and running are proven together."""
    return {name: simulate(chosen.system, chosen.experiment) for name, chosen in loaded.items()}
