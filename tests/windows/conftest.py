"""A Python for Windows with the wheel, a clone of the tests, and the commands there and here."""

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.windows.wine_python import WinePython

ROOT = Path(__file__).parent.parent.parent
# of the extra `test`, what the tests import; and what is required on Windows alone
MORE = (
    "build",
    "cffi",
    "colorama",
    "cyclonedx-python-lib[json-validation]",
    "filelock",
    "fmu-manipulation-toolbox",
    "hypothesis",
    "pip",
    "psutil",
    "pyssp-standard",
    "pytest",
    "pytest-xdist",
    "selenium",
)

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
def default_tests(python: WinePython, clone: Path) -> Iterator[Future[subprocess.CompletedProcess[str]]]:
    """The default tests, which run beside the commands: those take one processor."""
    with ThreadPoolExecutor() as pool:
        yield pool.submit(python.run, "python.exe", "-m", "pytest", "-q", "-n", "2", cwd=clone)


@pytest.fixture(scope="session", autouse=True)
def start_default_tests(request: pytest.FixtureRequest) -> None:
    """Starts them first where they are to run."""
    if any("default_tests" in getattr(item, "fixturenames", ()) for item in request.session.items):
        request.getfixturevalue("default_tests")


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
