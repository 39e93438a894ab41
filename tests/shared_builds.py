"""FMUs built once a session for all of pytest-xdist's processes, each when a test first asks for it."""

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from fmus.block import Block
from fmus.registry import block_names

Build = Callable[..., Path]
Fmus = Mapping[str, Path]  # by name of block or component

LIKE_ANOTHER = (
    "AdrcDepthController", "PidDepthController", "SlidingModeDepthController", "SuperTwistingDepthController",
)  # fmt: skip
"""Blocks on the interface of MracDepthController, by whose FMU they are tested at every run."""

KINDS = (
    "DepthReference", "ExamplePlant", "L1DepthController", "RovDepthPlant", "ThrustAllocation", "WaveSource",
)  # fmt: skip
"""Blocks that stand for all others where a test concerns the layer around a block.

They have states and derivatives, every type, tables, no state, or no input.
"""


def one_of_a_kind(names: Iterable[str]) -> list[Any]:
    """Returns names as parameters of a test, in which blocks that are not among `KINDS` are marked slow."""
    like = {*block_names()} - {*KINDS}
    return slow_but([name for name in names if name not in like], names)


def slow_but(default: Collection[Any], values: Iterable[Any]) -> list[Any]:
    """Returns values as parameters of a test, in which all but the default ones are marked slow."""
    return [value if value in default else pytest.param(value, marks=pytest.mark.slow) for value in values]


def session_folder(factory: pytest.TempPathFactory, name: str) -> Path:
    """A folder of the session that all of its processes share."""
    base = factory.getbasetemp()
    root = base.parent if base.name.startswith("popen-") else base
    folder = root / name
    folder.mkdir(exist_ok=True)
    return folder


def built_once(path: Path, build: Callable[[Path], Any]) -> Path:
    """Returns `path`, written by `build(path)` in the first process that asks; the others wait."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = path.with_name(f"{path.name}.done")
    with FileLock(path.with_name(f"{path.name}.lock")):
        if not done.exists():
            build(path)
            done.touch()
    return path


def with_libraries(name: str, members: dict[str, bytes]) -> dict[str, bytes]:
    """Returns the members of a native FMU with a library for this platform, compiled from their sources."""
    from fmus.generate import native

    with native.compiled_libraries(name, members, ()) as libraries:
        return members | libraries()


def c_sources_of(block: Block, guid: str, **options: Any) -> dict[str, str]:
    """Traces a block and returns its C sources."""
    from fmus.generate.derivatives import Sensitivities
    from fmus.generate.native import c_sources
    from fmus.generate.trace import trace

    traced = trace(block)
    return c_sources(traced, Sensitivities(traced), guid, **options)


class LazyFmus(Mapping[str, Path]):
    """FMUs by name: `build(name, folder)` writes `folder/NAME.fmu` when the name is first looked up."""

    def __init__(self, names: Iterable[str], folder: Path, build: Callable[[str, Path], Path]) -> None:
        self._names, self._folder, self._build = list(names), folder, build

    def __getitem__(self, name: str) -> Path:
        if name not in self._names:
            raise KeyError(name)
        return built_once(self._folder / f"{name}.fmu", lambda path: self._build(name, path.parent))

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def once_for_each_option(build: Build, folder: Path) -> Build:
    """Calls `build(path, *arguments, **options)` once for a set of arguments; their hash names the file."""

    def built(*arguments: Any, **options: Any) -> Path:
        key = hashlib.sha256(repr((arguments, sorted(options.items()))).encode()).hexdigest()[:16]
        return built_once(folder / f"{key}.fmu", lambda path: build(path, *arguments, **options))

    return built
