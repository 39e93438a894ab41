"""Scenarios that run for a fraction of a second."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where scenarios find it."""


SHORT = """
base = "nominal-extended"
title = "Short"
[experiment]
stop_time = {stop}
step_size = 0.02
[metrics.settling_time]
function = "settling_time"
signal = "plant.depth"
target = 0.8
band = 0.04
[metrics.overshoot]
function = "overshoot"
signal = "plant.depth"
target = 0.8
[metrics.holding_thrust]
function = "mean"
signal = "plant.total_force"
[metrics.lag]
function = "shift_lag"
signal = "plant.depth"
reference = "controller.depth_reference"
largest = 0.1
"""


@pytest.fixture
def short_scenario(tmp_path: Path) -> Callable[..., Path]:
    """Writes a scenario of the vehicle that runs for a fraction of a second."""

    def write(stop: float = 0.2, more: str = "") -> Path:
        path = tmp_path / "short.toml"
        path.write_text(SHORT.format(stop=stop) + more)
        return path

    return write


@pytest.fixture
def misbehaving(rogue: Build, tmp_path: Path) -> Callable[..., str]:
    """Writes mine.toml, whose FMU, the rudder, misbehaves from a time on [s]."""

    def write(misdeed: Misdeed, time: float = 0.0, stop: float = 1.0) -> str:
        (tmp_path / "mine.toml").write_text(
            f'[components]\nrudder = "{rogue(saves_state=True, serialises_state=True)}"\n'
            f'[experiment]\nstop_time = {stop}\nstep_size = 0.1\n[inputs]\n"rudder.u" = 1.0\n'
            f'[parameters]\n"rudder.misdeed" = {int(misdeed)}\n"rudder.misdeed_time" = {time}\n'
        )
        return "mine.toml"

    return write
