"""Packages of the scenarios that importers run, and what our master makes of them."""

import sys
from collections.abc import Callable
from ctypes.util import find_library
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from orchestration.cli.ramp_sources import build_ramp_source
from orchestration.exchange import ssp_write
from orchestration.master import simulate
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from tests.importers.comparison import DISTRIBUTIONS, SCENARIOS


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory, scenario_fmus: None) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("packages")
    return {
        name: ssp_write.package(scenario.load(scenario.find(name)), folder / f"{name}.ssp", build_ramp_source)
        for name in SCENARIOS
    }


@pytest.fixture(scope="session")
def ours(scenario_fmus: None) -> dict[str, Recording]:
    """The scenarios themselves, not the packages: packing and running are proven together."""
    loaded = {name: scenario.load(scenario.find(name)) for name in SCENARIOS}
    return {name: simulate(each.system, each.experiment) for name, each in loaded.items()}


@pytest.fixture
def installed() -> Callable[[str], str]:
    """The importer's name, if it is installed."""

    def check(importer: str) -> str:
        if not _is_installed(importer):
            pytest.fail(f"{importer} is not installed: .ci/run installs it")
        return importer

    return check


def _is_installed(importer: str) -> bool:
    try:
        version(DISTRIBUTIONS[importer])
    except PackageNotFoundError:
        return False
    return importer != "ecos" or sys.platform != "linux" or find_library("tbb") is not None
