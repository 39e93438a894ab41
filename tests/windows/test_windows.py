"""The commands and the tests on a Python for Windows, which runs under Wine.

Windows itself has another C library and other processes: what holds here may not hold there.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.generate import builder
from fmus.platforms import PLATFORMS
from orchestration import Recording
from tests.windows.wine_python import WinePython

ROOT = Path(__file__).parent.parent.parent
# of the extra `test`, what the tests import; and what is required on Windows alone
MORE = (
    "build",
    "cffi",
    "colorama",
    "filelock",
    "hypothesis",
    "pip",
    "psutil",
    "pytest",
    "pytest-xdist",
    "selenium",
)
# Sines, exponentials and logarithms of Wine's C library differ from those of glibc in the last bit: the noise
# of the sensor has them, and the example. Measured: 9e-13 of the largest value of a signal.
OTHER_LIBRARY = 1e-11
# None of them is in these recordings.
SAME = ("nominal-extended-ideal.csv", "buoyancy-extended-ideal.csv", "buoyancy-l1-ideal.csv")
# of the default tests, those that take five minutes together where nothing else runs
ROOMS = (
    "tests/plant_fmu",
    "tests/controller_fmu",
    "tests/closed_loop",
    "tests/fmus/block",
    "tests/orchestration/results",
    "tests/orchestration/scenarios",
    "tests/orchestration/system",
)

pytestmark = pytest.mark.windows

Command = Callable[..., str]


@pytest.fixture(scope="session")
def empty() -> WinePython:
    """The Python with the libraries alone."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    (names,) = extras["all"]
    chosen = [extras[name] for name in names.partition("[")[2].rstrip("]").split(",")]
    # zig for Windows does not start under Wine
    needed = {name for extra in chosen for name in extra if not name.startswith("ziglang")}
    kept = Path(os.environ["MPLCONFIGDIR"]).with_name("l1-depth-wine")
    return WinePython(kept, sorted({*project["dependencies"], *needed, *MORE}))


@pytest.fixture(scope="session")
def clone(empty: WinePython) -> Path:
    """The files that git has of this clone."""
    folder = empty.drive / "clone"
    shutil.rmtree(folder, ignore_errors=True)
    listed = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True)
    for name in filter(None, listed.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="session")
def python(empty: WinePython, clone: Path) -> WinePython:
    """The Python with the wheel, which `pip` for Windows installs as a user does."""
    build = [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", empty.drive, clone]
    subprocess.run(build, check=True)
    (wheel,) = empty.drive.glob("*.whl")
    install = ["-m", "pip", "install", "--no-index", "--quiet", "--no-warn-script-location"]
    for requirement, options in (
        (f"{wheel.name}[all]", ()),
        (wheel.name, ("--force-reinstall", "--no-deps")),
    ):
        done = empty.run("python.exe", *install, *options, f"C:\\{requirement}", cwd=empty.drive)
        assert done.returncode == 0, done.stdout
    return empty


@pytest.fixture(scope="session")
def user(python: WinePython) -> Path:
    """A folder of a user, whose name is not of ASCII."""
    folder = python.drive / "Jörg Müller"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


@pytest.fixture
def l1_depth(python: WinePython, user: Path) -> Command:
    """Runs the command; both outputs, with the separators of Linux."""

    def run(*arguments: str) -> str:
        done = python.run("Scripts/l1-depth.exe", *arguments, cwd=user)
        assert done.returncode == 0, done.stdout
        return done.stdout.replace("\\", "/")

    return run


@pytest.fixture
def on_linux(tmp_path: Path) -> Command:
    """Runs the command here, in `tmp_path`."""
    program = Path(sys.executable).with_name("l1-depth")

    def run(*arguments: str) -> str:
        return subprocess.check_output(
            [program, *arguments], cwd=tmp_path, stderr=subprocess.STDOUT, text=True
        )

    return run


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


@pytest.mark.parametrize("room", ROOMS)
def test_the_tests_of_a_room_pass(room: str, python: WinePython, clone: Path) -> None:
    done = python.run("python.exe", "-m", "pytest", "-q", "-n", "0", room, cwd=clone)
    # for the count of tests that a failure shows, and `pytest -rP`
    print(done.stdout[-20_000:])
    assert re.search(r"^\d+ passed", done.stdout, re.M)
    assert done.returncode == 0
