"""The command design, end to end."""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from orchestration.scenarios.vehicle import description_file
from tests.shared_builds import Fmus

Command = Callable[..., Any]


@pytest.fixture
def boat(built: Fmus, tmp_path: Path) -> Path:
    """Our vehicle with the ranges of its inertia and thrust alone."""
    path = tmp_path / "boat.fmu"
    path.write_bytes(built["RovDepthPlant"].read_bytes())
    described = dict(description_file("RovDepthPlant").data)
    described["vary"] = {name: described["vary"][name] for name in ("inertia", "thrust")}
    path.with_suffix(".vehicle.toml").write_text(tomli_w.dumps(described))
    return path


@pytest.mark.slow
def test_every_corner_of_our_vehicle_settles_and_a_run_takes_the_file(
    command: Command, boat: Path, tmp_path: Path
) -> None:
    designed = command("design", "--plant", boat, "--draws", "2", "--bandwidth", "0.7", "--out", "out").stdout
    assert designed.replace("\\", "/").splitlines()[-2:] == ["out/boat-l1.toml", "out/boat-pid.toml"]
    assert re.search(r"boat: 4 corners, 2 draws", designed)
    assert designed.count("7 of 7") == 3
    for ending, controller in (("l1", ()), ("pid", ("--controller", "PidDepthController"))):
        path = tmp_path / f"out/boat-{ending}.toml"
        written = tomllib.loads(path.read_text())
        assert all(entry["unit"] and entry["source"] for entry in written["parameters"].values())
        options = ("--parameters", path, "--formats", "none", "--out", f"run-{ending}")
        command("run", "nominal-extended", "--plant", boat, *controller, *options)
        (result,) = (tmp_path / f"run-{ending}").glob("*.json")
        rmse = json.loads(result.read_text())["metrics"]["rmse"]["value"]
        assert rmse == pytest.approx(written["design"]["checked"][-1]["rmse_cm"], abs=6e-4)  # 3 decimals
        assert written["design"]["checked"][-1]["worst_rmse_cm"] < 2.0


@pytest.mark.slow
def test_a_place_that_does_not_settle_ends_the_command_and_writes_nothing(
    command: Command, boat: Path, tmp_path: Path
) -> None:
    """The rules do not know the dead zone."""
    zones = [f"plant.thruster_dead_zone[{i}]=11.9" for i in (1, 2)]
    options = (*(part for zone in zones for part in ("--set", zone)), "--bandwidth", "0.5", "--out", "out")
    done = command("design", "--plant", boat, "--draws", "0", *options, expect=1)
    assert re.search(r"L1: does not settle at the start values and \d+ more: no file", done.stderr)
    assert not list(tmp_path.glob("out/*"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--set", "controller.kp=1"), "controller.kp: expected plant.NAME"),
        (("--bandwidth", "9"), "no L1 for RovDepthPlant: .* at 9 rad/s"),
    ],
)
def test_a_design_that_cannot_be_made_is_refused(
    command: Command, options: tuple[str, ...], message: str
) -> None:
    assert re.search(message, command("design", "--plant", "RovDepthPlant", *options, expect=1).stderr)
