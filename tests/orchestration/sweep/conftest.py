"""Scenarios to sweep, around an FMU that does what a sample asks of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestration.scenarios import scenario
from orchestration.sweep.plan import Plan, plan

SCENARIO = """
[components]
r = '{fmu}'
[experiment]
stop_time = {stop_time}
step_size = 0.01
[inputs]
"r.u" = 2.0
[metrics.mean]
function = "mean"
signal = "r.y"
[metrics.effort]
function = "effort"
signal = "r.y"
"""
DRAWN = """
[sweep]
samples = 12
seed = 7
[sweep.vary."r.u"]
distribution = "uniform"
low = 1.0
high = 3.0
[sweep.vary."r.misdeed_time"]
distribution = "normal"
mean = 100.0
std = 1.0
"""

MakeFile = Callable[..., Path]


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where the shipped sweeps find it."""


@pytest.fixture
def sweep_file(rogue: Callable[..., Path], tmp_path: Path) -> MakeFile:
    """Writes a scenario of one rogue FMU with y' = u, and a sweep of it."""

    def write(sweep: str = DRAWN, stop_time: float = 1.0, name: str = "mine") -> Path:
        path = tmp_path / f"{name}.toml"
        path.write_text(SCENARIO.format(fmu=rogue(), stop_time=stop_time) + sweep)
        return path

    return write


@pytest.fixture
def planned(sweep_file: MakeFile) -> Callable[..., Plan]:
    """The plan of `sweep_file`."""

    def make(*arguments: Any, **options: Any) -> Plan:
        return plan(scenario.load(sweep_file(*arguments, **options)))

    return make
