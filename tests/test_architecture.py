"""The rules that keep the rooms apart, read from the imports themselves."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ROOMS = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
FILES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def imports(path: Path) -> set[str]:
    """Full names of everything that a file imports, lazily or not."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found


def importers(package: str) -> set[str]:
    return {
        str(path.relative_to(ROOT))
        for path in FILES
        if any(name == package or name.startswith(package + ".") for name in imports(path))
    }


@pytest.mark.parametrize("room", ["controller_fmu", "plant_fmu"])
def test_models_import_only_the_standard_library_and_the_declaration(room: str) -> None:
    allowed = {room, "fmus.block", "fmus.guide", "fmus.numerics"} | set(sys.stdlib_module_names)
    for path in (ROOT / room).rglob("*.py"):
        extra = {"numpy", "scipy.linalg", "scipy.optimize"} if path.name == "design.py" else set()
        for name in imports(path):
            assert name in allowed | extra or name.split(".")[0] in allowed, f"{path.name} imports {name}"


@pytest.mark.parametrize(
    ("package", "allowed"),
    [
        ("pythonfmu", {"fmus/export/slave.py"}),
        ("casadi", {"fmus/numerics.py", "fmus/export/symbolic.py"}),
        ("matplotlib", {"orchestration/results/figures.py"}),
        ("plotly", {"orchestration/report/render.py"}),
        ("PIL", {"fmus/documentation/icon.py"}),
    ],
)
def test_libraries_stay_in_their_room(package: str, allowed: set[str]) -> None:
    assert importers(package) == allowed


def test_orchestration_knows_no_model() -> None:
    for package in ("controller_fmu", "plant_fmu"):
        assert not {file for file in importers(package) if file.startswith("orchestration")}


def test_models_do_not_know_each_other() -> None:
    assert not {file for file in importers("plant_fmu") if file.startswith("controller_fmu")}
    assert not {file for file in importers("controller_fmu") if file.startswith("plant_fmu")}


def test_one_file_runs_the_compiler() -> None:
    named = {path.name for path in FILES if '"ziglang"' in path.read_text(encoding="utf-8")}
    assert named == {"toolchain.py"}


def test_every_package_is_installed() -> None:
    """The search for packages takes folders with an `__init__.py`; an editable install would not miss one."""
    for folder in {path.parent for path in FILES}:
        assert (folder / "__init__.py").is_file(), f"{folder} is in no wheel"
