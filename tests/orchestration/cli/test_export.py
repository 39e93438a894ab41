"""The command that writes a scenario for other tools."""

import subprocess
import sys
from pathlib import Path

import pytest

from orchestration.cli.exchange import Tool


def _export(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    code = "from orchestration.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, "export", *arguments],
        cwd=folder, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("tool", "written"),
    [(Tool.MODELICA, "L1Depth/package.mo"), (Tool.SIMULINK, "import_l1_depth.m")],
)
def test_the_command_names_the_file_to_open(tool: Tool, written: str, tmp_path: Path) -> None:
    done = _export(tool, "--out", "here", folder=tmp_path)
    assert (done.returncode, done.stdout.split()) == (0, [f"here/{written}"])
    assert (tmp_path / "here" / written).is_file()


@pytest.mark.parametrize("tool", Tool)
def test_a_scenario_that_cannot_be_expressed_ends_with_one_line(tool: Tool, tmp_path: Path) -> None:
    done = _export(tool, "example-extended", folder=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip().endswith("expected straight ramps, the only ones a table gives")
    assert not list(tmp_path.iterdir())
