"""Where scenarios find FMUs: in a folder of the user's, one for each installation."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from fmus import registry
from fmus.errors import ExportError, MissingExtraError
from fmus.extras import require
from fmus.fmi.description import describe
from fmus.generate import builder
from fmus.registry import FOLDER_VARIABLE, Flavour
from orchestration.errors import FmuLoadError


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The environment names the folder."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))


def test_the_environment_names_the_folder(tmp_path: Path) -> None:
    assert registry.fmu_path("ExamplePlant") == tmp_path / "native" / "ExamplePlant.fmu"
    assert registry.fmu_folder(Flavour.PYTHON) == tmp_path / "python"


def test_the_folder_is_outside_the_package_and_one_for_each_installation(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(FOLDER_VARIABLE)
    here = registry.fmu_folder()
    assert not here.is_relative_to(Path(registry.__file__).parent)
    monkeypatch.setattr(registry, "__file__", str(tmp_path / "fmus" / "registry.py"))
    assert registry.fmu_folder() != here


def test_only_files_of_blocks_in_that_folder_are_built(tmp_path: Path) -> None:
    python = registry.fmu_path("ExamplePlant", Flavour.PYTHON)
    paths = [tmp_path / "ExamplePlant.fmu", python, registry.fmu_path("Stranger")]
    assert registry.block_fmus(paths) == [("ExamplePlant", Flavour.PYTHON)]


def test_an_fmu_that_is_not_built_is_one_line_with_the_command() -> None:
    with pytest.raises(FmuLoadError, match=r"l1-depth build --cache --flavour native ExamplePlant writes "):
        describe(registry.fmu_path("ExamplePlant"))


def test_a_folder_that_cannot_be_written_is_one_line_with_the_variable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv(FOLDER_VARIABLE, str(file))
    with pytest.raises(
        ExportError, match=rf"cannot write FMUs to {re.escape(str(file))}.*set {FOLDER_VARIABLE}"
    ):
        builder.build_missing([registry.fmu_path("ExamplePlant")])


def test_the_registry_loads_nothing_heavy() -> None:
    code = "import sys, fmus.registry; print({'casadi', 'numpy', 'fmpy', 'PIL'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_missing_extra_is_one_line_with_the_command() -> None:
    with pytest.raises(MissingExtraError, match=r"^a sweep needs nonesuch: pip install 'l1-depth\[sweep\]'$"):
        require("nonesuch.part", "sweep", "a sweep")
    assert require("json", "sweep", "a sweep").dumps({}) == "{}"
