"""Shared fixtures: isolation from the user's files, FMUs built once a session, tools, and C programs."""

import gc
import os
import shutil
import signal
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

from fmus import platforms
from fmus.block import Block
from fmus.block.instance import BlockInstance
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.cache import BuildRequest
from fmus.registry import FOLDER_VARIABLE, Flavour, block_names, fmu_folder
from tests import foreign_fmus, foreign_pythonfmu
from tests.c_programs import compile_c
from tests.shared_builds import (
    LIKE_ANOTHER,
    Build,
    LazyFmus,
    once_for_each_option,
    session_folder,
)

# `pytest --hypothesis-profile=thorough -m hypothesis`, as .ci/run, tries ten times as many examples
settings.register_profile("quick", deadline=None, max_examples=10)
settings.register_profile("thorough", deadline=None, max_examples=100)
settings.load_profile("quick")

_HOME = pytest.StashKey[str]()
_QUICK_S = 0.1

_LEFT_OUT: list[str] = []
if sys.platform == "win32":
    listed = tomllib.loads((Path(__file__).parent / "windows" / "runs.toml").read_text(encoding="utf-8"))
    systems = {"Windows", "Wine"} if "WINEPREFIX" in os.environ else {"Windows"}
    _LEFT_OUT += [name for entry in listed["left_out"] if entry["in"] in systems for name in entry["tests"]]
# not even imported
collect_ignore = [name.removeprefix("tests/") for name in _LEFT_OUT if "::" not in name]


def pytest_xdist_auto_num_workers() -> int:
    """Returns the number of processors plus one: many tests wait for another process."""
    return (os.cpu_count() or 1) + 1


def pytest_configure(config: pytest.Config) -> None:
    """Set the folders of the user's own files to an empty one; pytest-xdist's processes inherit it.

    The processes that tests start get the default signals.

    Two caches stay where they are: Zig's of compiled C libraries, found by the hash of their sources,
    and matplotlib's list of fonts. Compiled Python is kept, also where the environment says otherwise:
    hundreds of processes would compile every file anew.
    """
    gc.set_threshold(100_000)  # of Python's 700, an eighth of the time of some tests
    # functions of a block, which tests build in several flavours
    builder.reference_run, builder.icon = cache(builder.reference_run), cache(builder.icon)
    config.option.deselect = [*(config.option.deselect or ()), *_LEFT_OUT]
    is_worker = hasattr(config, "workerinput")
    _ignore_no_signal(is_worker)
    if is_worker:
        _collect_another_part_first(config)
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small, and processors are taken
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("ZIG_GLOBAL_CACHE_DIR", str(caches / "zig"))
    os.environ.setdefault("MPLCONFIGDIR", str(caches / "matplotlib"))
    home = config.stash[_HOME] = tempfile.mkdtemp(prefix="l1-depth-tests-")
    os.environ["HOME"] = home
    for name in ("CACHE", "CONFIG", "DATA", "STATE"):
        os.environ[f"XDG_{name}_HOME"] = f"{home}/{name.lower()}"
    # the place of caches in Windows
    os.environ["LOCALAPPDATA"] = f"{home}/cache"
    os.environ[FOLDER_VARIABLE] = f"{home}/fmus"


def _ignore_no_signal(is_worker: bool) -> None:
    """Sets a handler for signals that `nohup`, or a job in the background, ignores.

    An ignored signal stays ignored in the processes that tests start, a handler does not.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # the tests go on when the terminal of nohup is closed; a worker ends with its controller
    if hasattr(signal, "SIGHUP") and (is_worker or signal.getsignal(signal.SIGHUP) == signal.SIG_IGN):
        signal.signal(signal.SIGHUP, lambda *_: None)


def _collect_another_part_first(config: pytest.Config) -> None:
    """Starts each pytest-xdist process with different files, so it finds the other files compiled."""
    if config.args == config.getini("testpaths"):
        here = Path(__file__).parent
        # a file that is named is collected, whatever collect_ignore says
        ignored = {here / name for name in collect_ignore}
        found = (path for path in here.rglob("test_*.py") if ignored.isdisjoint({path, *path.parents}))
        files = sorted(map(str, found))
        worker: dict[str, Any] = config.workerinput  # type: ignore[attr-defined]
        start = len(files) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
        config.args = files[start:] + files[:start]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Excludes the half a million collected objects from garbage collection."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks tests that need more than pip installs by their fixture, others by the FMUs that they build.

    The order is fixed, because pytest-xdist expects the same order in all processes. The files of the upper
    folders come first: one of their tests can take a minute, for which all processes but one would wait.
    """
    items.sort(key=lambda item: (len(item.path.parts), item.path.parts))
    for item in items:
        fixtures: list[str] = getattr(item, "fixturenames", [])
        callspec = getattr(item, "callspec", None)
        if "browser" in fixtures:
            item.add_marker(pytest.mark.browser)
        elif "tool" in fixtures or "built_everywhere" in fixtures:
            item.add_marker(pytest.mark.cross)
        elif callspec and any(isinstance(v, str) and v in LIKE_ANOTHER for v in callspec.params.values()):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Runs a test in a process of pytest-xdist, which sends no report of a quick set-up or tear-down.

    Two thirds of the reports say nothing, and each costs both processes a millisecond.
    """
    if not hasattr(item.config, "workerinput"):
        return None
    for report in runtestprotocol(item, nextitem=nextitem, log=False):
        if report.when == "call" or not report.passed or report.duration > _QUICK_S:
            item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_unconfigure(config: pytest.Config) -> None:
    if _HOME in config.stash:
        shutil.rmtree(config.stash[_HOME], ignore_errors=True)


def _lazily_built(flavour: Flavour) -> LazyFmus:
    """Returns FMUs with stamps, so a command that runs them traces no block."""

    def build(name: str, folder: Path) -> Path:
        (files,) = builder.build_orders([BuildRequest(name, folder, flavour)])
        assert not isinstance(files, ExportError), files
        return files[0]

    return LazyFmus(block_names(), fmu_folder(flavour), build)


@pytest.fixture(scope="session")
def built() -> Mapping[str, Path]:
    """Every block's native FMU by name, freshly built where scenarios find it."""
    return _lazily_built(Flavour.NATIVE)


@pytest.fixture(scope="session")
def python_built() -> Mapping[str, Path]:
    """Every block's FMU of the python flavour by name, freshly built where scenarios find it."""
    return _lazily_built(Flavour.PYTHON)


@pytest.fixture(scope="session")
def fmi3_built(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Every block's native FMU of FMI 3.0 by name."""
    folder = session_folder(tmp_path_factory, "fmi 3")
    return LazyFmus(block_names(), folder, lambda name, to: builder.build_block(name, to, fmi=3))


@pytest.fixture(scope="session")
def built_everywhere(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Every block's native FMU with the libraries of all platforms, by name."""
    return LazyFmus(
        block_names(),
        session_folder(tmp_path_factory, "built everywhere"),
        lambda name, folder: builder.build_block(name, folder, platforms=platforms.PLATFORMS),
    )


@pytest.fixture(scope="session")
def scenario_fmus(built: Mapping[str, Path]) -> None:
    """Builds the FMUs of scenarios, as `l1-depth build --cache` does."""
    assert all(built[name].is_file() for name in built if name not in LIKE_ANOTHER)


@pytest.fixture(scope="session")
def tool() -> Callable[[str], str]:
    """Path of a program from the operating system's packages."""

    def find(name: str) -> str:
        path = shutil.which(name) or shutil.which(name, path="/usr/lib/wine")
        return path or pytest.fail(f"{name} is not installed: .ci/run installs it")

    return find


@pytest.fixture(scope="session")
def c_program(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, str], Path]:
    """Compiles a C program for a platform."""
    return lambda source, platform: compile_c(source, platform, tmp_path_factory.mktemp("c program"))


class Driver:
    """An instance whose variables are addressed by name."""

    def __init__(self, block: Block, **values: float) -> None:
        self.instance = BlockInstance(block, "test")
        self.references = {v.name: v.value_reference for v in block.variables}
        for name, value in values.items():
            self[name] = value

    def __getitem__(self, name: str) -> float:
        return self.instance.get(self.references[name])

    def __setitem__(self, name: str, value: float) -> None:
        self.instance.set(self.references[name], value)

    def begin(self, t: float = 0.0) -> "Driver":
        self.instance.start(t)
        self.instance.exit_initialization_mode()
        return self

    def step(self, h: float, count: int = 1) -> "Driver":
        for _ in range(count):
            self.instance.do_step(self.instance.time, h)
        return self


@pytest.fixture(scope="session")
def driver() -> type[Driver]:
    return Driver


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """PythonFMU's FMUs by name."""
    folder = session_folder(tmp_path_factory, "foreign")
    return LazyFmus(foreign_pythonfmu.NAMES, folder, foreign_pythonfmu.build)


def _built_once_for_each_option(name: str) -> Any:
    @pytest.fixture(scope="session", name=name)
    def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
        return once_for_each_option(getattr(foreign_fmus, name), session_folder(tmp_path_factory, name))

    return build


# they build FMUs in C; the options are those of the functions of these names in `foreign_fmus`
linear = _built_once_for_each_option("linear")
function = _built_once_for_each_option("function")
motor = _built_once_for_each_option("motor")
stair = _built_once_for_each_option("stair")
forker = _built_once_for_each_option("forker")
rogue = _built_once_for_each_option("rogue")
mirror = _built_once_for_each_option("mirror")


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only place where temporary folders can be."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path
