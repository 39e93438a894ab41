"""Its tests run scenarios, some of them from one package."""

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from orchestration.cli.package_fmus import build_ramp_source
from orchestration.exchange import ssp_write
from orchestration.scenarios import scenario


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where scenarios find it."""


@pytest.fixture(scope="session")
def asked_starts() -> dict[str, dict]:
    """Component -> start values that its FMU was to be built with."""
    return {}


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory, asked_starts: dict[str, dict]) -> Path:
    """With FMUs as they are: `tests/importers` and a slow test run those with other start values."""

    def as_it_is(fmu: Path, starts: Mapping, folder: Path) -> Path:
        asked_starts[folder.name] = dict(starts)
        return fmu

    chosen, path = (
        scenario.load(scenario.find("nominal-extended")),
        tmp_path_factory.mktemp("ssp") / "loop.ssp",
    )
    return ssp_write.package(chosen, path, build_ramp_source, as_it_is)


@pytest.fixture
def edited(package: Path, tmp_path: Path) -> Callable[[str, str, str], Path]:
    """The package with one text of one of its files replaced."""

    def edit(member: str, old: str, new: str) -> Path:
        path = tmp_path / "edited.ssp"
        with zipfile.ZipFile(package) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                content = source.read(name)
                if name == member:
                    assert old in content.decode()
                    content = content.decode().replace(old, new, 1).encode()
                target.writestr(name, content)
        return path

    return edit
