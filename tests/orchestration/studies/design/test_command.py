"""The command design, end to end."""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]


def test_every_corner_of_our_vehicle_settles_and_a_run_takes_the_file(
    command: Command, tmp_path: Path
) -> None:
    designed = command("design", "--plant", "RovDepthPlant", "--draws", "2", "--out", "out").stdout
    assert designed.splitlines()[-2:] == ["out/RovDepthPlant-l1.toml", "out/RovDepthPlant-pid.toml"]
    assert re.search(r"RovDepthPlant: 128 corners, 2 draws", designed)
    assert designed.count("131 of 131") == 3
    for ending, controller in (("l1", ()), ("pid", ("--controller", "PidDepthController"))):
        path = tmp_path / f"out/RovDepthPlant-{ending}.toml"
        written = tomllib.loads(path.read_text())
        assert all(entry["unit"] and entry["source"] for entry in written["parameters"].values())
        options = ("--parameters", path, "--formats", "none", "--out", f"run-{ending}")
        command("run", "nominal-extended", *controller, *options)
        (result,) = (tmp_path / f"run-{ending}").glob("*.json")
        rmse = json.loads(result.read_text())["metrics"]["rmse"]["value"]
        assert rmse == pytest.approx(written["design"]["checked"][-1]["rmse_cm"], abs=6e-4)  # 3 decimals
        assert written["design"]["checked"][-1]["worst_rmse_cm"] < 2.0


def test_a_place_that_does_not_settle_ends_the_command_and_writes_nothing(
    command: Command, tmp_path: Path
) -> None:
    """The rules do not know the dead zone."""
    zones = [f"plant.thruster_dead_zone[{i}]=11.9" for i in (1, 2)]
    settings = (part for zone in zones for part in ("--set", zone))
    done = command("design", "--plant", "RovDepthPlant", *settings, "--draws", "0", expect=1)
    assert re.search(r"L1: does not settle at the start values; \d+ more runs do not: no file", done.stderr)
    assert not list(tmp_path.rglob("*.toml"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--set", "controller.kp=1"), "controller.kp: expected plant.NAME"),
        (("--bandwidth", "9"), "no L1 for RovDepthPlant: .* at 9 rad/s"),
        (("--phase-margin", "60", "--bandwidth", "0.5"), "60 deg are asked for, .* a smaller --phase-margin"),
    ],
)
def test_a_design_that_cannot_be_made_is_refused(
    command: Command, options: tuple[str, ...], message: str
) -> None:
    assert re.search(message, command("design", "--plant", "RovDepthPlant", *options, expect=1).stderr)
