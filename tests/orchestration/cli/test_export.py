"""The command that writes a scenario for other tools."""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.exchange import ssp_write
from orchestration.results.recording import Recording

Command = Callable[..., Any]


@pytest.mark.parametrize(
    ("out", "written"),
    [
        ((), "short.ssp"),
        (("--out", "there"), "there/short.ssp"),
        (("--out", "there/"), "there/short.ssp"),
        (("--out", "new/"), "new/short.ssp"),
        (("--out", "new"), "new"),
    ],
)
def test_a_package_is_written_to_a_file_or_into_a_folder(
    command: Command,
    short_scenario: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    out: tuple[str, ...],
    written: str,
) -> None:
    monkeypatch.setattr(ssp_write, "package", lambda scenario, path, *rest: path)
    (tmp_path / "there").mkdir()
    assert command("package", short_scenario(), *out).stdout == f"{Path(written)}\n"


@pytest.mark.slow
def test_a_package_runs_with_another_of_its_parameter_sets(
    command: Command, short_scenario: Command, tmp_path: Path
) -> None:
    more = '[parameters]\n"controller.augmentation" = "none"\n'
    assert command("package", short_scenario(more=more), "--out", "loop.ssp").stdout == "loop.ssp\n"
    printed = command("run", "loop.ssp", "--parameters", "short", "--out", "from package").stdout
    assert "from package/short.csv" in printed
    command("run", "short.toml", "--out", "from scenario")
    packaged, own = (
        Recording.read(tmp_path / folder / "short.csv") for folder in ("from package", "from scenario")
    )
    np.testing.assert_array_equal(packaged["plant.depth"], own["plant.depth"])


@pytest.mark.slow
def test_what_options_change_is_packaged(
    command: Command, short_scenario: Command, built: Mapping[str, Path], tmp_path: Path
) -> None:
    shutil.copy(built["L1DepthController"], tmp_path / "my.fmu")
    short_scenario()
    options = ("--controller", "my.fmu", "--set", "plant.buoyancy_change=0.2")
    assert command("package", "short.toml", *options).stdout == "short-my.ssp\n"
    command("run", "short-my.ssp", "--out", "from package")
    command("run", "short.toml", *options)
    packaged, own = (
        Recording.read(tmp_path / folder / "short-my.csv") for folder in ("from package", "results")
    )
    np.testing.assert_array_equal(packaged["plant.depth"], own["plant.depth"])
