"""One reproduction for all tests of its results."""

import json
import os
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from orchestration.scenarios import run_files
from orchestration.scenarios.run_files import Result
from tests.shared_builds import built_once, session_folder


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session_folder(tmp_path_factory, "reproduction")


@pytest.fixture(scope="session")
def results(folder: Path, scenario_fmus: None) -> dict[str, Result]:
    """Every shipped scenario, run through the FMUs and the master at its default settings."""

    def run_all(path: Path) -> None:
        results = run_files.run_all(folder, os.cpu_count() or 1)
        run_files.write_report(results, folder)
        path.write_bytes(pickle.dumps(results))

    return pickle.loads(built_once(folder / "results.pickle", run_all).read_bytes())


@pytest.fixture(scope="session")
def summary_document(results: dict[str, Result], folder: Path) -> dict[str, Any]:
    """What `l1-depth reproduce` writes to summary.json: case -> controller -> metric -> value and unit."""
    return json.loads((folder / "summary.json").read_text())


@pytest.fixture(scope="session")
def summary(summary_document: dict[str, Any]) -> dict[str, dict[str, dict[str, float]]]:
    """The values of summary.json: case -> controller -> metric."""
    return {
        case: {
            controller: {name: metric["value"] for name, metric in metrics.items()}
            for controller, metrics in controllers.items()
        }
        for case, controllers in summary_document.items()
    }


@pytest.fixture(scope="session")
def python_fmus(python_built: Mapping[str, Path]) -> None:
    """Scenarios of the example and of the vehicle find the FMUs of the python flavour that they name."""
    names = "DepthReference", "ExamplePlant", "L1Controller", "L1DepthController", "RovDepthPlant"
    assert all(python_built[name].is_file() for name in names)
