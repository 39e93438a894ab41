"""What tests share: FMUs built once a session, tools, C programs, and small helpers around blocks."""

import itertools
import os
import shutil
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import pytest
from pythonfmu.builder import FmuBuilder

from fmus import catalogue, platforms
from fmus.block import Block
from fmus.export import toolchain
from fmus.instance import Instance
from fmus.registry import FOLDER_VARIABLE, Flavour
from tests import foreign_fmus


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
        name: catalogue.build(name, folder, platforms=platforms.PLATFORMS) for name in catalogue.block_names()
    }


@pytest.fixture(scope="session")
def python_built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every block's FMU of the python flavour, freshly built, by name."""
    folder = tmp_path_factory.mktemp("python_built")
    return {name: catalogue.build(name, folder, Flavour.PYTHON) for name in catalogue.block_names()}


@pytest.fixture(scope="session", autouse=True)
def _fmus_of_the_scenarios(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Scenarios find the blocks' FMUs in a temporary folder, as after `l1-depth build --cache`."""
    os.environ[FOLDER_VARIABLE] = str(tmp_path_factory.mktemp("fmus"))
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
    headers = (root / "tests" / "speed" / "c", Path(fmpy.__file__).parent / "c-code")

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
        self.instance.exit_initialization_mode()
        return self

    def step(self, h: float) -> "Driver":
        self.instance.do_step(self.instance.time, h)
        return self


@pytest.fixture(scope="session")
def driver() -> type[Driver]:
    return Driver


# Foreign FMUs, knowing nothing of this project: written by PythonFMU's own builder, or in C.

_HEAD = """
    import ctypes

    from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real

    from pythonfmu.enums import Fmi2Status

    # PythonFMU 0.7 frees this dictionary at the second instance (docs/fidelity.md)
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))

    INPUT, OUTPUT = Fmi2Causality.input, Fmi2Causality.output
"""

_SOURCES = {
    # x' = -x + u, exact for held u; y = x
    "Lag": """
        import math

        class Lag(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.u, self.y = 0.0, 1.0
                self.register_variable(Real("u", causality=INPUT, start=0.0))
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                self.y = self.u + (self.y - self.u) * math.exp(-h)
                return True
    """,
    # passes every type through, at once
    "Types": """
        class Types(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.a, self.b = 0, False
                common = {"variability": Fmi2Variability.discrete}
                self.register_variable(Integer("a", causality=INPUT, start=0, **common))
                self.register_variable(Boolean("b", causality=INPUT, start=False, **common))
                self.register_variable(Integer("c", causality=OUTPUT, getter=lambda: self.a + 1, **common))
                self.register_variable(Boolean("d", causality=OUTPUT, getter=lambda: not self.b, **common))

            def do_step(self, t, h):
                return True
    """,
    "Discards": """
        class Discards(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.y = 0.0
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                self.y = t + h
                if t > 0.45:
                    self.log("the battery is empty", Fmi2Status.discard)
                    return False
                return True
    """,
    "Raises": """
        class Raises(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.y = 0.0
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                if t > 0.45:
                    raise RuntimeError("the hull is breached")
                self.y = t + h
                return True
    """,
}  # fmt: skip


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """PythonFMU's FMUs by name."""
    folder = tmp_path_factory.mktemp("foreign")
    made: dict[str, Any] = {}
    for name, source in _SOURCES.items():
        script = folder / f"{name.lower()}_slave.py"
        script.write_text(textwrap.dedent(_HEAD) + textwrap.dedent(source))
        made[name] = FmuBuilder.build_FMU(script, folder)
    return made


Build = Callable[..., Path]


def _built_once(build: Build, folder: Path) -> Build:
    """Builds an FMU for each set of options that is new."""
    found: dict[str, Path] = {}
    numbers = itertools.count()

    def built(*arguments: Any, **options: Any) -> Path:
        key = repr((arguments, sorted(options.items())))
        if key not in found:
            found[key] = build(folder / f"{next(numbers)}.fmu", *arguments, **options)
        return found[key]

    return built


@pytest.fixture(scope="session")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds linear FMUs: the options are those of `foreign_fmus.linear`."""
    return _built_once(foreign_fmus.linear, tmp_path_factory.mktemp("linear"))


@pytest.fixture(scope="session")
def function(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds FMUs that compute y = expression of u, in C: `foreign_fmus.function`."""
    return _built_once(foreign_fmus.function, tmp_path_factory.mktemp("function"))


@pytest.fixture(scope="session")
def rogue(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds FMUs that misbehave on demand: the options are those of `foreign_fmus.rogue`."""
    return _built_once(foreign_fmus.rogue, tmp_path_factory.mktemp("rogue"))
