"""The command line in this process: what a test claims of it seldom needs another."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from selenium import webdriver

from orchestration import Ensemble, System
from orchestration.cli.commands import run_command
from tests.orchestration.many.instances import CONNECTIONS
from tests.orchestration.results.opened import chromium
from tests.shared_builds import built_once, session_folder


@dataclass(frozen=True)
class Done:
    """What a command printed."""

    stdout: str
    stderr: str


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Done]:
    """Runs `l1-depth` with arguments in `tmp_path`; `expect` is its exit status.

    Nothing may be left in the folder of temporary files.
    """
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))

    def run(*arguments: object, expect: int = 0) -> Done:
        try:
            status = run_command([str(argument) for argument in arguments])
        except SystemExit as end:
            status = end.code
        captured = capsys.readouterr()
        assert status == expect, captured.err
        assert not list(temporary.iterdir())
        return Done(captured.out, captured.err)

    return run


@pytest.fixture
def refused(command: Callable[..., Done]) -> Callable[..., str]:
    """The one line on standard error of a command that must fail with status 1."""

    def run(*arguments: object) -> str:
        done = command(*arguments, expect=1)
        assert done.stderr.startswith("l1-depth: ")
        assert done.stderr.count("\n") == 1
        return done.stderr

    return run


@pytest.fixture(scope="session")
def vehicle_fmus(built: Mapping[str, Path]) -> None:
    """Scenarios of the vehicle with L1 control find their FMUs; `scenario_fmus` builds all blocks."""
    assert all(built[name].is_file() for name in ("L1DepthController", "RovDepthPlant"))


@pytest.fixture(scope="session")
def browser(
    tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator["webdriver.Chrome"]:
    """Debian's Chromium, steered by its own driver."""
    with chromium(tool("chromium"), tool("chromedriver"), tmp_path_factory.mktemp("browser")) as driver:
        yield driver


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


@pytest.fixture(scope="session")
def system(built: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> System:
    """The vehicle and its controller, compiled for groups of instances once a session."""
    vehicle = System({"plant": built["RovDepthPlant"], "controller": built["L1DepthController"]}, CONNECTIONS)
    built_once(
        session_folder(tmp_path_factory, "ensemble") / "vehicle", lambda path: Ensemble(vehicle).close()
    )
    return vehicle
