"""One reproduction for all tests of its results."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from orchestration.scenarios import reproduce
from orchestration.scenarios.reproduce import Result


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduction")


@pytest.fixture(scope="session")
def results(folder: Path) -> dict[str, Result]:
    """Every shipped scenario, run through the FMUs and the master at its default settings."""
    return reproduce.run_all(folder, os.cpu_count() or 1)


@pytest.fixture(scope="session")
def summary(results: dict[str, Result], folder: Path) -> dict[str, Any]:
    """What `l1-depth reproduce` writes to summary.json."""
    reproduce.write_report(results, folder)
    return json.loads((folder / "summary.json").read_text())
