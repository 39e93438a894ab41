"""The cache of rows: the rows that were used last stay, and no others."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest

from fmus import store
from orchestration.score import score_rows
from orchestration.score.closed_loop import ClosedLoop, built_in, tuned
from orchestration.score.protocol import Protocol, read_protocol
from orchestration.score.score_document import Row


def row(name: str) -> Row:
    return Row(name=name, title=name, league="position", scored=False, fmu={})


def test_rows_whose_last_use_is_longest_ago_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setitem(store.MOST, score_rows.STORED, 3)
    folder = store.folder(score_rows.STORED)
    for age, name in ((300.0, "used again"), (200.0, "forgotten"), (100.0, "recent")):
        score_rows.store_row(name, row(name), {"nominal": {"time": [0.0]}})
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    read = score_rows.stored_row("used again")
    assert read == (row("used again"), {"nominal": {"time": [0.0]}})
    score_rows.store_row("new", row("new"), {})
    assert {path.name for path in folder.iterdir()} == {"used again", "recent", "new"}
    assert score_rows.stored_row("forgotten") is None


def test_a_row_with_plants_or_other_parameters_is_another_one(small_protocol: Callable[..., Path]) -> None:
    protocol = read_protocol(small_protocol())
    controller = tuned(protocol, "l1-pi")
    with ClosedLoop(controller, protocol) as loop:
        keys = {
            score_rows.row_key(one, loop, full)
            for one in (controller, replace(controller, parameters={}))
            for full in (False, True)
        }
    assert len(keys) == 4


@pytest.mark.parametrize(
    "source", ["run/loop.c", "exchange/load.h", "results/metrics.py", "scenarios/base/vehicle.toml"]
)
def test_a_row_follows_from_sources_of_every_kind(source: str) -> None:
    content = (Path(score_rows.__file__).parents[1] / source).read_bytes()
    assert hashlib.sha256(content).hexdigest() in dict(score_rows._sources()).values()


@pytest.fixture
def name_of_row(protocol: Protocol) -> Callable[[], str]:
    """The key of one row, computed anew at each call."""
    loop = ClosedLoop(built_in(protocol, "l1-pi"), protocol)

    def key() -> str:
        score_rows._sources.cache_clear()
        score_rows._environment.cache_clear()
        return score_rows.row_key(loop.controller, loop, False)

    return key


@pytest.mark.parametrize(
    "source",
    [
        "orchestration/many/lane_library.py",
        "fmus/native/vectors/lanes.c",
        "fmus/numerics/elementary.py",
        "controller_fmu/design.py",
        "orchestration/gym.py",
        "orchestration/run/loop.c",
    ],
)
def test_a_row_is_found_by_the_sources_of_all_packages(
    name_of_row: Callable[[], str], source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, read = name_of_row(), store.read_with_time
    assert name_of_row() == before

    def changed(file: str) -> tuple[bytes, float]:
        return (b"changed", 0.0) if file.replace(os.sep, "/").endswith(source) else read(file)

    monkeypatch.setattr(store, "read_with_time", changed)
    assert name_of_row() != before


def test_a_row_is_found_by_the_versions_of_the_libraries(
    name_of_row: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before, installed = name_of_row(), [*metadata.distributions()]
    assert "scipy" in {library.name for library in installed}
    others = [library for library in installed if library.name != "scipy"]
    monkeypatch.setattr(score_rows, "distributions", lambda: others)
    assert name_of_row() != before


@pytest.mark.parametrize("part", ["sys.version", "platform.machine", "platform.libc_ver"])
def test_a_row_is_found_by_python_and_by_the_machine(
    name_of_row: Callable[[], str], part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = name_of_row()
    monkeypatch.setattr(part, "another" if part == "sys.version" else lambda: "another")
    assert name_of_row() != before
