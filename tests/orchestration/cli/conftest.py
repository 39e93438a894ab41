"""Scenarios that run for a fraction of a second."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where scenarios find it."""


@pytest.fixture
def misbehaving(rogue: Build, tmp_path: Path) -> Callable[..., str]:
    """Writes mine.toml, whose FMU, the rudder, misbehaves from a time on [s]."""

    def write(misdeed: Misdeed, time: float = 0.0, stop: float = 1.0) -> str:
        (tmp_path / "mine.toml").write_text(
            f"[components]\nrudder = '{rogue(saves_state=True, serialises_state=True)}'\n"
            f'[experiment]\nstop_time = {stop}\nstep_size = 0.1\n[inputs]\n"rudder.u" = 1.0\n'
            f'[parameters]\n"rudder.misdeed" = {int(misdeed)}\n"rudder.misdeed_time" = {time}\n'
        )
        return "mine.toml"

    return write
