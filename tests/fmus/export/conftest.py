"""Blocks as native FMUs, compiled when a test first wants them and driven call by call."""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

from fmus.export.c_source import c_sources

from .native_block import block_named
from .native_session import GUID, Session, compiled


@pytest.fixture(scope="module", params=["plain", pytest.param("sanitized", marks=pytest.mark.cross)])
def program(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Callable[[str], Path]:
    @cache
    def one(name: str) -> Path:
        sources = c_sources(block_named(name), GUID)
        return compiled(sources, tmp_path_factory.mktemp(name), request.param == "sanitized")

    return one


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
