"""Tests that the core names no satellite: each can be removed with its folder, and the rest works."""

import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from fmus import registry
from orchestration.cli.commands import command_function, command_names, run_command

ROOT = Path(__file__).parents[1]
PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
SATELLITES = ("fmus.compliance", "orchestration.studies", "orchestration.report", "orchestration.gym")
SATELLITES += ("orchestration.places", "orchestration.diff", "fmus.prove")
POINTS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"]


def naming(satellite: str) -> re.Pattern[str]:
    """Returns a pattern for the name of a module, also as `from PACKAGE import NAME`."""
    package, _, name = satellite.rpartition(".")
    return re.compile(rf"\b{re.escape(satellite)}\b|from {re.escape(package)} import [^\n]*\b{name}\b")


def files(folder: Path, *roots: str) -> list[Path]:
    return [file for root in roots for file in sorted((folder / root).rglob("*.py"))]


@pytest.mark.parametrize("satellite", SATELLITES)
def test_no_file_outside_a_satellite_names_it(satellite: str) -> None:
    own = ROOT / satellite.replace(".", "/")
    others = [file for file in files(ROOT, *PACKAGES) if not file.is_relative_to(own)]
    assert not [file for file in others if naming(satellite).search(file.read_text("utf-8"))]


def copied_without(satellites: tuple[str, ...], folder: Path) -> Path:
    """Returns a copy of the project without satellites, their tests, and other tests that use them."""
    leave_out = shutil.ignore_patterns("__pycache__", ".*_cache")
    for name in (*PACKAGES, "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=leave_out)
    for name in ("pyproject.toml", "README.md", "CHANGELOG.md", "docs", ".ci"):  # which tests read
        (folder / name).symlink_to(ROOT / name)
    for satellite in satellites:
        for parent in (folder, folder / "tests"):
            shutil.rmtree(parent / satellite.replace(".", "/"))
        commands = [
            name for name, where in POINTS["l1_depth.commands"].items() if where.startswith(satellite)
        ]
        called = rf'|(command|refused|started)\([^)]*"({"|".join(commands)})"' if commands else ""
        uses = re.compile(naming(satellite).pattern + called)
        for file in files(folder, "tests/fmus", "tests/orchestration"):
            if file.name.startswith("test_") and uses.search(file.read_text("utf-8")):
                file.unlink()
    return folder


def python(folder: Path, *arguments: str) -> str:
    """Returns the output of Python with the copy before the project on its path."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("satellite", SATELLITES)
def test_without_a_satellite_all_else_is_imported_and_its_commands_are_gone(
    satellite: str, tmp_path: Path
) -> None:
    copy = copied_without((satellite,), tmp_path)
    modules = [".".join(file.relative_to(copy).with_suffix("").parts) for file in files(copy, *PACKAGES)]
    modules = [name.removesuffix(".__init__") for name in modules if not name.endswith("__main__")]
    python(copy, "-c", f"import importlib\nfor name in {modules}: importlib.import_module(name)")
    shown = python(copy, "-c", "from orchestration.cli import main; main()", "--help")
    for name, where in POINTS["l1_depth.commands"].items():
        assert bool(re.search(rf"^│ {name} ", shown, re.M)) is not where.startswith(satellite)


@pytest.mark.slow
def test_without_any_satellite_the_tests_of_the_master_pass(tmp_path: Path) -> None:
    """Those of systems and their runs; the test above imports each module without one satellite."""
    copy = copied_without(SATELLITES, tmp_path)
    python(copy, "-m", "pytest", "-q", "-n", "2", "tests/orchestration/run", "tests/orchestration/system")


def test_a_command_of_another_package_is_run_and_one_that_is_gone_or_takes_a_name_is_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    offered = [
        EntryPoint("others", "orchestration.cli.run:scenarios", registry.COMMANDS),
        EntryPoint("gone", "orchestration.nowhere.command:gone", registry.COMMANDS),
        EntryPoint("run", "orchestration.cli.run:scenarios", registry.COMMANDS),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: offered)
    names = command_names()
    assert "others" in names
    assert "gone" not in names
    assert names.count("run") == 1
    assert command_function("run")[0].__name__ == "run"
    assert run_command(["others"]) == 0
    assert "nominal-l1" in capsys.readouterr().out


def test_a_command_that_cannot_be_loaded_is_named_and_stops_no_other(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for name, text in {"lacking": "import nunpy", "broken": "raise OSError('no dongle')"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    offered = [
        EntryPoint("others", "orchestration.cli.run:scenarios", registry.COMMANDS),
        EntryPoint("lacks", "lacking.commands:lacks", registry.COMMANDS),
        EntryPoint("breaks", "broken.commands:breaks", registry.COMMANDS),
        EntryPoint("empty", "orchestration.cli.run:no_such_function", registry.COMMANDS),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: offered)
    assert run_command(["--help"]) == 0
    shown = capsys.readouterr()
    assert re.search("^│ others ", shown.out, re.M)
    warned = shown.err.splitlines()
    assert [line.split("'")[1] for line in warned] == ["breaks", "empty", "lacks"]
    assert "cannot be loaded: OSError: no dongle" in warned[0]
    assert "cannot be loaded: ModuleNotFoundError: No module named 'nunpy'" in warned[2]
    with pytest.raises(SystemExit) as end:
        run_command(["breaks"])
    assert end.value.code == 1
    assert capsys.readouterr().err.startswith("l1-depth: command 'breaks': its entry point broken.commands")
    assert run_command(["others"]) == 0


def test_the_help_has_its_panels_in_one_order(capsys: pytest.CaptureFixture[str]) -> None:
    """The order does not depend on the origin of the commands."""
    assert run_command(["--help"]) == 0
    panels = re.findall(r"^╭─ (.*?) ─", capsys.readouterr().out, re.M)
    assert panels[1:] == [
        "FMUs",
        "Scenarios",
        "Controllers compared",
        "Vehicles",
        "The paper",
        "Other tools",
    ]
