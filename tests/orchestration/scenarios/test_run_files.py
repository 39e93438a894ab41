"""The files of a run: both are of one run, or the second shows that they are not."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.report import found_results
from orchestration.results.formats import RecordingFormat
from orchestration.results.recording import Recording
from orchestration.scenarios import run_files, scenario
from orchestration.scenarios.scenario import Scenario
from tests.orchestration.report.made_up import recording

HELD = {"function": "mean", "signal": "plant.depth"}


@pytest.fixture
def loaded(tmp_path: Path, stair: type) -> Scenario:
    """A scenario whose metrics are those of the made-up recording."""
    file = tmp_path / "dive.toml"
    file.write_text(
        f'components = {{ stair = "{stair()}" }}\nexperiment = {{ stop_time = 2.0, step_size = 1.0 }}\n'
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
    monkeypatch.setattr(run_files, "write_json_atomically", killed)
    with pytest.raises(KeyboardInterrupt):
        run_files.write_result(loaded, recording(phase=0.5), tmp_path)
    with pytest.raises(OrchestrationError, match=r"of dive\.csv, which is of another run"):
        found_results([tmp_path / "dive.csv"])
