"""The commands and the tests on a Python for Windows, which runs under Wine.

Windows itself has another C library and other processes: what holds here may not hold there.
"""

import re
import tomllib
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from fmus.generate import builder
from fmus.platforms import PLATFORMS
from orchestration import Recording

# Sines, exponentials and logarithms of Wine's C library differ from those of glibc in the last bit: the noise
# of the sensor has them, and the example. Measured: 9e-13 of the largest value of a signal.
OTHER_LIBRARY = 1e-11
# None of them is in these recordings.
SAME = ("nominal-extended-ideal.csv", "buoyancy-extended-ideal.csv", "buoyancy-l1-ideal.csv")
RUNS = tomllib.loads((Path(__file__).parent / "runs.toml").read_text(encoding="utf-8"))

pytestmark = pytest.mark.windows

Command = Callable[..., str]


def test_fmus_for_all_platforms_are_those_that_linux_builds(
    l1_depth: Command, user: Path, tmp_path: Path
) -> None:
    l1_depth("build", "--all-platforms", "RovDepthPlant", "PidDepthController")
    for name in ("RovDepthPlant", "PidDepthController"):
        here = builder.build_block(name, tmp_path, platforms=PLATFORMS)
        assert (user / "fmus-built" / here.name).read_bytes() == here.read_bytes()


def test_a_controller_of_the_user_runs_to_its_picture(
    l1_depth: Command, on_linux: Command, user: Path, tmp_path: Path
) -> None:
    commands = ["new", "pid"], ["run", "nominal-extended", "--controller", "pid.py", "--out", "mine"]
    for command in commands:
        assert l1_depth(*command) == on_linux(*command)
    picture = Path("mine/nominal-extended-Pid.png")
    assert (user / picture).read_bytes() == (tmp_path / picture).read_bytes()


def test_the_experiments_of_the_paper_are_those_of_linux(
    l1_depth: Command, on_linux: Command, user: Path, tmp_path: Path
) -> None:
    for reproduce in (l1_depth, on_linux):
        reproduce("reproduce", "--out", "paper")
    names = {path.name for path in (tmp_path / "paper").iterdir()}
    assert {path.name for path in (user / "paper").iterdir()} == names
    for name in names:
        there, here = ((folder / "paper" / name) for folder in (user, tmp_path))
        if name.startswith("figure") or name in SAME:
            assert there.read_bytes() == here.read_bytes(), name
        elif name.endswith(".csv"):
            theirs, ours = Recording.read(there), Recording.read(here)
            for signal in ours.names:
                largest = abs(ours[signal]).max()
                assert theirs[signal] == pytest.approx(ours[signal], rel=0, abs=OTHER_LIBRARY * largest), (
                    signal
                )


@pytest.mark.parametrize(
    ("command", "file", "text"),
    [
        ("inspect fmus-built/RovDepthPlant.fmu", "", "external_force"),
        ("check fmus-built/RovDepthPlant.fmu", "", "RovDepthPlant.fmu: 2"),
        ("run nominal-extended --out results", "results/nominal-extended.png", "total_variation"),
        ("score pid.py --out results", "results/score.html", "PID, rates known"),
        ("sweep monte-carlo --out results", "results/monte-carlo.sweep.parquet", "1000 samples, 0 failed"),
        ("report results", "report.html", "report.html"),
        ("live nominal-extended", "live.html", "live.html"),
    ],
)
def test_a_command_of_the_readme_succeeds(
    command: str, file: str, text: str, l1_depth: Command, user: Path
) -> None:
    """The files are those of earlier tests."""
    assert text in l1_depth(*command.split())
    assert (user / file).exists()


def test_the_default_tests_pass(default_tests: Future[CompletedProcess[str]]) -> None:
    done = default_tests.result()
    # for the times of tests, which `pytest -rP` shows
    print(done.stdout[-20_000:])
    assert done.returncode == 0
    passed = re.search(r"^(?:=+ )?(\d+) passed", done.stdout, re.M)
    assert passed
    assert int(passed[1]) >= RUNS["passed"]
