"""Blocks as native FMUs, compiled when a test first wants them and driven call by call."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fmus.build.native import c_sources
from tests.shared_builds import built_once, session_folder

from .native_block import block_named
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
