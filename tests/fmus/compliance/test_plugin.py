"""The pytest plugin: one test a rule with `--fmu`, and nothing at all without."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fmus.compliance.rule import all_rules
from fmus.compliance.sentences import rule_table
from tests.described_fmus import members
from tests.shared_builds import Fmus

from .archives import write

NAME = "DepthReference"
XML = "modelDescription.xml"
PLUGIN = "fmus.compliance.pytest_plugin"
HEAVY = ["lief", "fmpy", "lxml", "casadi", "numpy", "rich"]


def run_pytest(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """pytest in a folder, with this plugin and no other."""
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    command = [sys.executable, "-m", "pytest", "-p", PLUGIN, "-p", "no:cacheprovider", *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


@pytest.fixture(scope="module")
def judged(built: Fmus, tmp_path_factory: pytest.TempPathFactory) -> subprocess.CompletedProcess[str]:
    """pytest with a test of the project's own, and a good, a broken, a warned and a missing FMU."""
    folder = tmp_path_factory.mktemp("judged")
    (folder / "test_own.py").write_text("def test_own():\n    assert True\n")
    content = members(built[NAME])
    twice = content[XML].replace(b'name="smooth"', b'name="internal_step"')
    write(content | {XML: twice}, folder / "broken.fmu")
    write(content | {"readme.txt": b""}, folder / "warned.fmu")
    names = (str(built[NAME]), "broken.fmu", "warned.fmu", "none.fmu")
    return run_pytest(folder, "-v", "-rf", *(argument for name in names for argument in ("--fmu", name)))


def outcomes(done: subprocess.CompletedProcess[str], fmu: str) -> dict[str, str]:
    """Rule -> outcome of its test, in the order in which they ran."""
    tests = re.findall(rf"{re.escape(fmu)}::(\S+) (PASSED|FAILED|SKIPPED)", done.stdout)
    return dict(tests)


def test_each_rule_is_a_test_and_a_good_fmu_fails_none(judged: subprocess.CompletedProcess[str]) -> None:
    good = outcomes(judged, f"{NAME}.fmu")
    assert list(good) == [rule.name for rule in all_rules() if rule.name not in rule_table()["off"]]
    assert set(good.values()) == {"PASSED", "SKIPPED"}  # skipped: what the FMU does not claim or hold


@pytest.mark.slow
def test_a_good_fmu_is_exit_status_0(built: Fmus, tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "-q", "-k", "archive", "--fmu", str(built[NAME]))
    assert " passed" in done.stdout
    assert done.returncode == 0


def test_a_broken_fmu_fails_the_tests_of_the_rules_that_it_breaks(
    judged: subprocess.CompletedProcess[str],
) -> None:
    broken = outcomes(judged, "broken.fmu")
    assert {rule for rule, outcome in broken.items() if outcome == "FAILED"} == {
        "variable-names-are-unique", "values-belong-to-references",
    }  # fmt: skip
    assert "2 variables are called 'internal_step': expected one" in judged.stdout
    assert judged.returncode == 1


def test_a_warning_of_the_check_is_a_warning_of_pytest_and_fails_nothing(
    judged: subprocess.CompletedProcess[str],
) -> None:
    assert "BrokenRuleWarning: warned.fmu: archive-layout" in judged.stdout
    assert "FAILED" not in outcomes(judged, "warned.fmu").values()


def test_fmus_come_after_the_tests_of_the_project(judged: subprocess.CompletedProcess[str]) -> None:
    lines = [line for line in judged.stdout.splitlines() if "::" in line]
    assert lines[0].startswith("test_own.py::test_own PASSED")


def test_an_fmu_that_is_not_there_fails(judged: subprocess.CompletedProcess[str]) -> None:
    assert set(outcomes(judged, "none.fmu").values()) == {"FAILED"}


def test_without_an_fmu_nothing_is_collected_and_nothing_heavy_imported(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(
        "import sys\n\n"
        "def pytest_unconfigure():\n"
        f"    print('imported:', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    done = run_pytest(tmp_path, "-q", "-s")
    assert "no tests ran" in done.stdout
    assert "imported: []" in done.stdout
    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED


def test_a_missing_library_of_the_checks_is_a_line_that_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['lief'] = None")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    line = "a check of FMUs needs lief: pip install 'l1-depth[check]'"
    done = run_pytest(tmp_path, "--fmu", "none.fmu", "-q")
    assert f"ERROR: --fmu: {line}" in done.stderr
    command = [sys.executable, "-m", "fmus.compliance", "none.fmu"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (1, f"python -m fmus.compliance: {line}\n")
