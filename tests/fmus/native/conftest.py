"""Blocks as native FMUs, compiled when a test first wants them and driven call by call."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fmus.generate import builder
from tests.shared_builds import Fmus, LazyFmus, built_once, c_sources_of, session_folder

from .blocks import EVERYTHING, SMALL, block_named
from .exchanged import Exchanged
from .fmi3_instance import Fmi3Instance
from .session import GUID, Session, compiled

Open = Callable[[str], Session]


@pytest.fixture(scope="session", params=["plain", pytest.param("sanitized", marks=pytest.mark.cross)])
def program(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Callable[[str], Path]:
    """The program of a block by its name, compiled once a session."""
    folder = session_folder(tmp_path_factory, f"{request.param} programs")

    def build(path: Path) -> None:
        compiled(c_sources_of(block_named(path.parent.name), GUID), path.parent, request.param == "sanitized")

    return lambda name: built_once(folder / name / "session", build)


@pytest.fixture
def open_session(program: Callable[[str], Path]) -> Iterator[Open]:
    """Starts a session of a block by its name; at the end no instance has left memory behind."""
    opened: list[Session] = []

    def one(name: str) -> Session:
        opened.append(Session(program(name), block_named(name)))
        return opened[-1]

    yield one
    for session in opened:
        if session.is_alive:
            session("free")
            assert session.live() == 0
            session.close()


@pytest.fixture
def session(open_session: Open) -> Session:
    """A session of the block `EVERYTHING`."""
    return open_session(EVERYTHING.name)


@pytest.fixture
def plant(open_session: Open) -> Session:
    """A session of the block ExamplePlant."""
    return open_session("ExamplePlant")


@pytest.fixture(scope="session")
def small_built(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    """FMUs of FMI 2.0 of the small blocks by name."""
    folder = session_folder(tmp_path_factory, "small")
    return LazyFmus(SMALL, folder, lambda name, to: builder.build_block(SMALL[name], to))


@pytest.fixture(scope="session")
def fmi3_built(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    """FMUs of FMI 3.0 by name: of every installed block, and of the small ones."""
    folder, names = session_folder(tmp_path_factory, "fmi 3"), [*builder.block_names(), *SMALL]
    return LazyFmus(names, folder, lambda name, to: builder.build_block(block_named(name), to, fmi=3))


@pytest.fixture
def open_fmi3(fmi3_built: Fmus, tmp_path: Path) -> Iterator[Callable[..., Fmi3Instance]]:
    """Instances of FMUs of FMI 3.0, by the name of the block and the options of `Fmi3Instance`."""
    opened: list[Fmi3Instance] = []

    def one(name: str, *arguments: Any, **options: Any) -> Fmi3Instance:
        folder = tmp_path / f"fmi3 {len(opened)}"
        opened.append(Fmi3Instance(fmi3_built[name], folder, *arguments, **options))
        return opened[-1]

    yield one
    for instance in opened:
        instance.fmu.freeInstance()


@pytest.fixture
def exchange(built: Fmus, small_built: Fmus, tmp_path: Path) -> Iterator[Callable[[str], Exchanged]]:
    """Instances of FMUs of FMI 2.0 for model exchange, by the name of the block."""
    opened: list[Exchanged] = []

    def one(name: str) -> Exchanged:
        path = small_built[name] if name in small_built else built[name]
        opened.append(Exchanged(path, tmp_path / f"exchanged {len(opened)}"))
        return opened[-1]

    yield one
    for instance in opened:
        instance.model.freeInstance()
