"""The pytest plugin: one test a rule with `--fmu`, and nothing at all without."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus.compliance.examine import all_rules

from .archives import PYTHONFMU_ERRORS, members, write

NAME = "DepthReference"
PLUGIN = "fmus.compliance.pytest_plugin"
HEAVY = ["lief", "fmpy", "lxml", "casadi", "numpy", "rich"]


def run_pytest(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """pytest in a folder, with this plugin and no other."""
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    command = [sys.executable, "-m", "pytest", "-p", PLUGIN, "-p", "no:cacheprovider", *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


def test_each_rule_is_a_test_and_a_good_fmu_fails_none(built: Mapping[str, Path], tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "--fmu", str(built[NAME]), "-v")
    told = [line.split("::")[-1] for line in done.stdout.splitlines() if "::" in line]
    assert [line.split()[0] for line in told if " " in line] == [each.name for each in all_rules()]
    assert f"{len(all_rules())} passed" in done.stdout
    assert done.returncode == 0


def test_a_broken_fmu_fails_the_tests_of_the_rules_that_it_breaks(
    python_built: Mapping[str, Path], tmp_path: Path
) -> None:
    done = run_pytest(tmp_path, "--fmu", str(python_built[NAME]), "-q", "-rf")
    failed = {
        line.split("::")[-1].split()[0] for line in done.stdout.splitlines() if line.startswith("FAILED")
    }
    assert failed == set(PYTHONFMU_ERRORS)
    assert all(message in done.stdout for (message,) in PYTHONFMU_ERRORS.values())
    assert done.returncode == 1


def test_a_warning_of_the_check_is_a_warning_of_pytest(built: Mapping[str, Path], tmp_path: Path) -> None:
    path = write(members(built[NAME]) | {"readme.txt": b""}, tmp_path / "warned.fmu")
    done = run_pytest(tmp_path, "--fmu", str(path), "-q")
    assert "BrokenRuleWarning: warned.fmu: archive-layout" in done.stdout
    assert done.returncode == 0


def test_fmus_come_after_the_tests_of_the_project(built: Mapping[str, Path], tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_own():\n    assert True\n")
    fmus = ("--fmu", str(built[NAME]), "--fmu", str(built["ExamplePlant"]))
    done = run_pytest(tmp_path, *fmus, "--collect-only", "-q")
    collected = [line for line in done.stdout.splitlines() if "::" in line]
    assert collected[0].endswith("test_own.py::test_own")
    assert len(collected) == 1 + 2 * len(all_rules())


def test_an_fmu_that_is_not_there_fails(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "--fmu", "none.fmu", "-q", "-x")
    assert "none.fmu" in done.stdout
    assert done.returncode == 1


def test_without_an_fmu_nothing_is_collected_and_nothing_heavy_imported(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(
        "import sys\n\n"
        "def pytest_unconfigure():\n"
        f"    print('imported:', [each for each in {HEAVY!r} if each in sys.modules])\n"
    )
    done = run_pytest(tmp_path, "-q", "-s")
    assert "no tests ran" in done.stdout
    assert "imported: []" in done.stdout
    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED


def test_a_missing_library_of_the_checks_is_a_line_that_names_the_command(tmp_path: Path) -> None:
    (tmp_path / "lief.py").write_text("raise ModuleNotFoundError(name='lief')")
    line = "a check of FMUs needs lief: pip install 'l1-depth[check]'"
    done = run_pytest(tmp_path, "--fmu", "none.fmu", "-q")
    assert f"ERROR: --fmu: {line}" in done.stderr
    command = [sys.executable, "-m", "fmus.compliance", "none.fmu"]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]),
    }
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (1, f"python -m fmus.compliance: {line}\n")
