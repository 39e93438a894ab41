"""The files of a run: both are of one run, or the second shows that they are not."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.fmi.instance import FmuInstance
from orchestration.errors import OrchestrationError, ScenarioError, SimulationError
from orchestration.report.find import found_results
from orchestration.results import files
from orchestration.results.formats import RecordingFormat
from orchestration.results.recording import Recording
from orchestration.scenarios import run_files, scenario
from orchestration.scenarios.scenario import Scenario
from tests.foreign_fmus import Misdeed
from tests.orchestration.report.made_up import recording

HELD = {"function": "mean", "signal": "plant.depth"}


@pytest.fixture
def loaded(tmp_path: Path, stair: Callable[..., Path]) -> Scenario:
    """A scenario whose metrics are those of the made-up recording."""
    file = tmp_path / "dive.toml"
    file.write_text(
        f"components = {{ stair = '{stair()}' }}\nexperiment = {{ stop_time = 2.0, step_size = 1.0 }}\n"
    )
    return replace(scenario.load(file), metrics={"held": HELD})


@pytest.mark.parametrize("file_format", RecordingFormat)
def test_the_document_holds_the_digest_of_the_recording(
    loaded: Scenario, tmp_path: Path, file_format: RecordingFormat
) -> None:
    run_files.write_result(loaded, recording(), tmp_path, file_format)
    data = (tmp_path / f"dive.{file_format}").read_bytes()
    assert json.loads((tmp_path / "dive.json").read_text())["sha256"] == hashlib.sha256(data).hexdigest()


def test_a_metric_that_fails_leaves_the_files_of_the_run_before_and_keeps_the_recording(
    loaded: Scenario, tmp_path: Path
) -> None:
    run_files.write_result(loaded, recording(), tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.glob("dive.[cj]s*")}
    assert len(before) == 2
    failing = replace(loaded, metrics={"held": HELD, "bad": {**HELD, "signal": "plant.dept"}})
    with pytest.raises(ScenarioError, match=r"metric bad: 'plant.dept' was not recorded"):
        run_files.write_result(failing, recording(phase=0.5), tmp_path)
    assert {path: path.read_bytes() for path in before} == before
    partial = Recording.read(tmp_path / "dive.partial.csv")
    np.testing.assert_array_equal(partial.values, recording(phase=0.5).values)


def test_a_run_that_ends_between_its_files_is_not_shown(
    loaded: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(path: Path, content: object) -> None:
        raise KeyboardInterrupt

    run_files.write_result(loaded, recording(), tmp_path)
    found_results([tmp_path / "dive.csv"])
    monkeypatch.setattr(files, "write_json_atomically", killed)
    with pytest.raises(KeyboardInterrupt):
        run_files.write_result(loaded, recording(phase=0.5), tmp_path)
    with pytest.raises(OrchestrationError, match=r"of dive\.csv: it is of another run"):
        found_results([tmp_path / "dive.csv"])


def test_the_files_are_written_before_an_fmu_is_freed(
    tmp_path: Path, rogue: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also before a state that was saved in it is freed; of a run that fails, its partial recording."""
    calls: list[tuple[str, list[str]]] = []

    def status(instance: FmuInstance, function: str, *arguments: Any) -> int:
        assert function != "fmi2Terminate" or instance.time == 2.0  # which a warning says
        if "Terminate" in function or "Free" in function:
            calls.append((function, sorted(path.name for path in tmp_path.glob("dive.*[ns]*[nv]"))))
        return original(instance, function, *arguments)

    original = FmuInstance.status
    monkeypatch.setattr(FmuInstance, "status", status)
    text = (
        f"components = {{ r = '{rogue(saves_state=True)}' }}\ninputs = {{ \"r.u\" = 1.0 }}\n"
        "experiment = { stop_time = 2.0, step_size = 1.0 }\n"
    )
    (tmp_path / "dive.toml").write_text(text)
    run_files.run(scenario.load(tmp_path / "dive.toml"), tmp_path)
    names = ["fmi2FreeFMUstate", "fmi2Terminate", "fmi2FreeInstance"]
    assert calls == [(name, ["dive.csv", "dive.json"]) for name in names]
    calls.clear()
    failing = f'parameters = {{ "r.misdeed" = {int(Misdeed.ERROR)}, "r.misdeed_time" = 1.0 }}\n'
    (tmp_path / "dive.toml").write_text(text + failing)
    with pytest.raises(SimulationError, match="the rudder is stuck"):
        run_files.run(scenario.load(tmp_path / "dive.toml"), tmp_path)
    assert "fmi2FreeInstance" in dict(calls)
    assert all("dive.partial.csv" in files for _, files in calls)
