"""Its tests run scenarios, some of them from one package."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from fmus.files import write_archive
from orchestration.cli.package_fmus import build_ramp_source
from orchestration.errors import ScenarioError
from orchestration.exchange import ssp_read, ssp_write
from orchestration.scenarios import scenario
from tests.described_fmus import members


def refusal(package: Path, parameter_set: str = "") -> str:
    """The message of a package, or of a parameter set in it, that cannot be opened."""
    with pytest.raises(ScenarioError) as error, ssp_read.opened(package, parameter_set):
        pass
    return str(error.value)


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

    chosen = scenario.load(scenario.find("nominal-extended"))
    return ssp_write.package(chosen, tmp_path_factory.mktemp("ssp") / "loop.ssp", build_ramp_source, as_it_is)


@pytest.fixture
def edited(package: Path, tmp_path: Path) -> Callable[[str, str, str], Path]:
    """The package with one text of one of its files replaced."""

    def edit(member: str, old: str, new: str) -> Path:
        text = members(package)[member].decode()
        assert old in text
        changed = {member: text.replace(old, new, 1).encode()}
        return write_archive(tmp_path / "edited.ssp", members(package) | changed)

    return edit
