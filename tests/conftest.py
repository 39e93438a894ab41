"""What tests share: FMUs built once a session, tools, C programs, and small helpers around blocks."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from fmus import catalogue, toolchain
from fmus.block import Block
from fmus.catalogue import Flavour
from fmus.instance import Instance


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every block's native FMU, freshly built, by name."""
    folder = tmp_path_factory.mktemp("built")
    return {name: catalogue.build(name, folder) for name in catalogue.block_names()}


@pytest.fixture(scope="session")
def built_everywhere(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every block's native FMU with the libraries of all platforms, by name."""
    folder = tmp_path_factory.mktemp("built everywhere")
    return {
        name: catalogue.build(name, folder, platforms=toolchain.PLATFORMS) for name in catalogue.block_names()
    }


@pytest.fixture(scope="session")
def python_built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every block's FMU of the python flavour, freshly built, by name."""
    folder = tmp_path_factory.mktemp("python_built")
    return {name: catalogue.build(name, folder, Flavour.PYTHON) for name in catalogue.block_names()}


@pytest.fixture(scope="session", autouse=True)
def _fmus_of_the_scenarios() -> None:
    """Scenarios find the present blocks' FMUs in the default folder, as after `l1-depth build`."""
    for name in catalogue.block_names():
        catalogue.build_if_stale(name)


def _tool(name: str) -> str:
    """Path of a program that the distribution gives; only a developer may be without it."""
    path = shutil.which(name) or shutil.which(name, path="/usr/lib/wine")
    if not path and os.environ.get("CI"):
        pytest.fail(f"{name} is not installed: expected what .ci/run installs")
    return path or pytest.skip(f"{name} is not installed")


@pytest.fixture(scope="session")
def tool() -> Callable[[str], str]:
    return _tool


_C_TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", ("-ldl", "-lm", "-lpthread")),
    "aarch64-linux": ("aarch64-linux-gnu.2.17", ("-ldl", "-lm", "-lpthread")),
    "win64": ("x86_64-windows-gnu", ()),
}


@pytest.fixture(scope="session")
def c_program(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, str], Path]:
    """Compiles a C program for a platform, without a warning, with the flags of the FMUs.

    zig then takes from its cache what it has built for them already: on Windows that is most of a minute.
    """
    root = Path(__file__).parent.parent
    headers = (root / "orchestration" / "c", Path(fmpy.__file__).parent / "c-code")

    def compiled(source: Path, platform: str) -> Path:
        target, libraries = _C_TARGETS[platform]
        folder = tmp_path_factory.mktemp("c program")
        includes = [f"-I{folder}" for folder in headers]
        warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
        options = ["-target", target, *toolchain.FLAGS, *warnings, *includes]
        name = source.with_suffix(".exe").name  # a name that Windows runs, and the others do not mind
        toolchain.zig(["cc", *options, "-o", name, str(root / source), *libraries], folder)
        return folder / name

    return compiled


class Driver:
    """An instance whose variables go by name."""

    def __init__(self, block: Block, **values: float) -> None:
        self.instance = Instance(block, "test")
        self.references = {v.name: v.value_reference for v in block.variables}
        for name, value in values.items():
            self[name] = value

    def __getitem__(self, name: str) -> float:
        return self.instance.get(self.references[name])

    def __setitem__(self, name: str, value: float) -> None:
        self.instance.set(self.references[name], value)

    def begin(self, t: float = 0.0) -> "Driver":
        self.instance.start(t)
        self.instance.begin_stepping()
        return self

    def step(self, h: float) -> "Driver":
        self.instance.do_step(self.instance.time, h)
        return self


@pytest.fixture(scope="session")
def driver() -> type[Driver]:
    return Driver
