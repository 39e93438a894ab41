"""Command score, with a protocol of one case."""

import io
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from rich.console import Console

from orchestration.studies.score import score, score_rows
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.score import ScoreResult
from orchestration.studies.score.score_document import Score
from orchestration.studies.score.score_rendering import terminal_text

# of a path below a file
NO_FOLDER = "No such file or directory" if sys.platform == "win32" else "Not a directory"
COMPARISON = Path(__file__).parents[4] / "docs" / "explanation" / "comparison.json"


PROPORTIONAL = """
class Proportional:
    period = 0.04
    gain = 8.0

    def reset(self):
        pass

    def step(self, time, inputs):
        return {"control_force": self.gain * (inputs["depth_reference"] - inputs["measured_depth"])}
"""


@pytest.fixture
def protocol_file(tmp_path: Path, scenario_fmus: None) -> Path:
    data = dict(read_protocol().file.data)
    data["version"] = "of a test"
    data["cases"] = {"nominal": data["cases"]["nominal"]}
    data["cost"] = {**data["cost"], "cases": ["nominal"]}
    data["controllers"] = {}
    path = tmp_path / "protocol.toml"
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    return path


def test_score_prints_tables_and_writes_a_document_and_a_page(
    command: Callable[..., Any], protocol_file: Path, tmp_path: Path
) -> None:
    options = ("--set", "controller.augmentation=pi", "--protocol", protocol_file)
    text = command("score", "L1DepthController", *options).stdout
    assert re.match(r"Protocol of a test, seed \d+\. The vehicle is simulated;", text)
    assert text.replace("\\", "/").splitlines()[-3:] == [
        "Every case and metric:",
        "results/score.json",
        "results/score.html",
    ]
    document = json.loads((tmp_path / "results" / "score.json").read_text(encoding="utf-8"))
    assert document["protocol"]["version"] == "of a test"
    (row,) = document["rows"]
    assert row["parameters"] == {"augmentation": "pi"}
    assert row["cases"]["nominal"]["failed"] == []
    assert row["delay_margin"] > 0.0
    assert "not on a real vehicle" in (tmp_path / "results" / "score.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_python_class_is_scored_by_its_name_and_the_command_fails_where_it_fails_every_case(
    command: Callable[..., Any], protocol_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(PROPORTIONAL)
    arguments = "--set", "controller.gain=4.0", "--protocol", protocol_file, "--workers", "1"
    done = command("score", "own.py:Proportional", *arguments, expect=1)
    assert done.stderr == "l1-depth: Proportional failed every case, nominal with: not settled\n"
    (row,) = json.loads((tmp_path / "results" / "score.json").read_text(encoding="utf-8"))["rows"]
    assert (row["name"], row["parameters"]) == ("Proportional", {"gain": 4.0})
    assert row["cases"]["nominal"]["metrics"]["rmse"] > 1.0  # cm, with nothing against weight


def test_a_score_that_its_schema_refuses_is_not_written(
    refused: Callable[..., str], protocol_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(score_rows, "beyond_ranges", lambda loop: 1.0)
    message = refused("score", "L1DepthController", "--protocol", protocol_file)
    assert re.search(r"score of L1DepthController: unranked = 1.0: .* valid list", message)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["L1DepthControler"], "no block 'L1DepthControler'"),
        (["L1DepthController", "--set", "plant.inertia=9"], "--set plant.inertia: expected controller.NAME"),
        (["L1DepthController", "--set", "controller.gain=9"], "controller.gain"),
        (["L1DepthController", "--out", f"{__file__}/results"], f"{NO_FOLDER}: expected a folder"),
        (["a.fmu", "b.fmu", "--set", "controller.gain=9"], "--parameters with 2 controllers: expected one"),
    ],
)
def test_what_cannot_be_scored_is_refused(
    refused: Callable[..., str], protocol_file: Path, arguments: list[str], complaint: str
) -> None:
    assert complaint in refused("score", *arguments, "--protocol", protocol_file)


def test_a_file_without_a_block_is_refused_before_any_other_fmu_is_looked_at(
    refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.py").write_text(PROPORTIONAL)
    monkeypatch.setattr(score, "tuned", lambda protocol, name: pytest.fail(name))
    complaint = refused("score", "PidDepthController", "own.py")
    assert "no block at the top level of the file" in complaint
    assert "own.py:Proportional for its class Proportional" in complaint


@pytest.mark.parametrize("arguments", ["compare", "margins nominal-l1", "reproduce"])
def test_what_cannot_be_written_is_refused_before_it_runs(
    refused: Callable[..., str], arguments: str
) -> None:
    """The runs of most take minutes."""
    complaint = refused(*arguments.split(), "--out", f"{__file__}/results/file")
    assert f"{NO_FOLDER}: expected a folder that can be written" in complaint


def test_compare_prints_at_most_40_lines_and_writes_the_scores(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The comparison that ships, without its runs."""
    document = Score.model_validate_json(COMPARISON.read_text(encoding="utf-8"))
    monkeypatch.setattr(score, "compare", lambda protocol, **options: ScoreResult(document, {}))
    lines = command("compare").stdout.splitlines()
    assert len(lines) <= 40
    assert len([line for line in lines if line.startswith("  L1 with PI ")]) == 1  # the tuned one alone
    assert (
        Score.model_validate_json(Path("results", "comparison.json").read_text(encoding="utf-8")) == document
    )


@pytest.mark.parametrize("width", [60, 81, 130, 300])
def test_no_word_of_a_score_is_cut_on_a_terminal(width: int) -> None:
    document = Score.model_validate_json(COMPARISON.read_text(encoding="utf-8"))
    text = terminal_text(document, Console(width=width, file=io.StringIO()))
    assert "\N{HORIZONTAL ELLIPSIS}" not in text


@pytest.mark.parametrize("failed", [0, 8, 9, 10, 20])
@pytest.mark.parametrize("width", [80, 130])
@pytest.mark.parametrize("controllers", [17, 34])
def test_a_score_takes_at_most_40_lines_and_no_number_hides_one_reason(
    controllers: int, width: int, failed: int
) -> None:
    """The rows of a comparison, with as many failed cases of the controller that is scored."""
    document = Score.model_validate_json(COMPARISON.read_text(encoding="utf-8"))
    del document.rows[controllers:]
    scored = document.rows[0]
    scored.scored, scored.unranked = True, []
    for number, (name, case) in enumerate(scored.cases.items()):
        case.failed = [f"late in {name}"] if number < failed else []
    lines = [
        line[i : i + width]
        for line in terminal_text(document, Console(width=width)).splitlines()
        for i in range(0, max(len(line), 1), width)
    ]
    assert len(lines) <= 40 - len(("score.json", "score.html", "failed every case"))
    text = "\n".join(lines)
    shown = text.count("late in ")
    hidden = re.search(r"and (\d+) more reasons", text)
    assert shown + int(hidden[1] if hidden else 0) == failed
    assert hidden is None or int(hidden[1]) > 1
    more = re.search(r"and (\d+) more controllers", text)
    assert (more is None) == (controllers == 17)


@pytest.mark.slow
def test_compare_writes_a_document_and_a_page_of_all_rows(
    command: Callable[..., Any], protocol_file: Path, tmp_path: Path
) -> None:
    text = protocol_file.read_text(encoding="utf-8").replace("[controllers]", "")
    l1 = {"title": "L1", "fmu": "L1DepthController"}
    protocol_file.write_text(text + tomli_w.dumps({"controllers": {"l1-pi": l1}}), encoding="utf-8")
    done = command("compare", "--protocol", protocol_file)
    written = [f"results/comparison.{ending}" for ending in ("json", "html")]
    assert done.stdout.splitlines()[-2:] == written
    document = json.loads((tmp_path / written[0]).read_text(encoding="utf-8"))
    assert [row["name"] for row in document["rows"]] == ["tuned/l1-pi", "start/l1-pi"]
    page = (tmp_path / written[1]).read_text(encoding="utf-8")
    assert "<h1>Comparison of the controllers</h1>" in page
    assert "L1, tuned</th>" in page
    assert "L1, default gains</th>" in page
