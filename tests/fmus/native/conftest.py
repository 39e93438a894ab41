"""Blocks as native FMUs, compiled when a test first wants them and driven call by call."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fmus.build import builder
from fmus.build.native import c_sources
from tests.shared_builds import Fmus, LazyFmus, built_once, session_folder

from .exchanged import BALL, TANK
from .fmi3_instance import Fmi3Instance
from .native_block import EVERYTHING, block_named
from .native_session import GUID, Session, compiled


@pytest.fixture(scope="session", params=["plain", pytest.param("sanitized", marks=pytest.mark.cross)])
def program(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Callable[[str], Path]:
    """The program of a block, compiled once a session."""
    folder = session_folder(tmp_path_factory, f"{request.param} programs")

    def build(path: Path) -> None:
        compiled(c_sources(block_named(path.parent.name), GUID), path.parent, request.param == "sanitized")

    return lambda name: built_once(folder / name / "session", build)


@pytest.fixture
def open_session(program: Callable[[str], Path]) -> Iterator[Callable[[str], Session]]:
    opened: list[Session] = []

    def one(name: str) -> Session:
        opened.append(Session(program(name)))
        return opened[-1]

    yield one
    for session in opened:
        if session.is_alive:
            session("free", 0)
            assert session("live").values == ["0"]
            session.close()


@pytest.fixture(scope="session")
def fmi3_built(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    """FMUs of FMI 3.0 by name: of every installed block, and of the small ones."""

    def build(name: str, folder: Path) -> Path:
        return builder.build_block(block_named(name), folder, fmi=3)

    names = [*builder.block_names(), EVERYTHING.name, BALL.name, TANK.name]
    return LazyFmus(names, session_folder(tmp_path_factory, "fmi 3"), build)


@pytest.fixture
def open_fmi3(fmi3_built: Fmus, tmp_path: Path) -> Iterator[Callable[..., Fmi3Instance]]:
    opened: list[Fmi3Instance] = []

    def one(name: str, *arguments: Any, **options: Any) -> Fmi3Instance:
        folder = tmp_path / f"fmi3 {len(opened)}"
        opened.append(Fmi3Instance(fmi3_built[name], folder, *arguments, **options))
        return opened[-1]

    yield one
    for instance in opened:
        instance.fmu.freeInstance()
