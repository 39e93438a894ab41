"""Tests that the programs and commands of README run unchanged."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from fmus.generate import builder
from orchestration.scenarios import scenario
from orchestration.system.prepared_run import prepare

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """Returns the last fenced block of a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)[-1]


def test_the_first_program_is_the_script_without_its_figure() -> None:
    """tests/orchestration/test_fmpy_master.py runs the script."""
    script = (ROOT / "docs" / "gallery" / "fmpy_master.py").read_text(encoding="utf-8")
    program = README.partition("```python\n")[2].partition("```")[0]
    assert (
        program.split()
        == "".join(
            line
            for cell in script.split("# %%\n")[1:3]
            for line in cell.splitlines(keepends=True)
            if "matplotlib" not in line
        ).split()
    )


def test_the_python_example_runs(tmp_path: Path) -> None:
    builder.build_block("ExamplePlant", tmp_path / "fmus-built")
    done = subprocess.run(
        [sys.executable, "-c", block("python")], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert "plant.output" in done.stdout


def test_the_scenario_example_fits_the_fmus(tmp_path: Path, scenario_fmus: None) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(block("toml"))
    mine = scenario.load(path)
    experiment = mine.experiment
    assert prepare(mine.system, experiment).settings
    assert experiment.events[0].time == 90.0


@pytest.mark.parametrize(
    "command", ["pip install -e . && l1-depth reproduce", "pip install -e '.[test]' && pytest"]
)
def test_the_two_set_up_commands_are_there(command: str) -> None:
    assert f"```sh\n{command}\n```" in README


def test_the_extras_are_installed_before_the_commands_that_need_them() -> None:
    use = README.partition("## Use\n")[2]
    first = use.partition("```sh\n")[2].partition("\n")[0]
    assert first == "pip install -e '.[all]'"
