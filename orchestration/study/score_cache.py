"""Rows of built-in controllers from earlier scores, in the user's cache folder.

A row is found by the content of all that it follows from: FMUs, parameters, protocol, seeds, and the sources
that compute figures.
"""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from platformdirs import user_cache_path
from pydantic import BaseModel

from fmus.files import write_text_atomically
from orchestration.study.loop import Controller, Loop
from orchestration.study.score_document import Row
from orchestration.study.scored_run import Trace

_PROJECT = Path(__file__).parents[1]
_COMPUTING = ("fmi", "master", "results", "scenarios", "study", "sweep", "system")
_SOURCES = (".py", ".c", ".h", ".toml")


class CachedRow(BaseModel):
    """A row, and what is drawn of its runs by case."""

    row: Row
    traces: dict[str, Trace]


def folder() -> Path:
    return user_cache_path("l1-depth", appauthor=False) / "score"


def key(controller: Controller, loop: Loop, full: bool) -> str:
    """The name of a row in the cache."""
    loaded = loop.scenario(loop.protocol.nominal)
    sources = sorted(
        path for name in _COMPUTING for path in (_PROJECT / name).rglob("*") if path.suffix in _SOURCES
    )
    files = [loop.protocol.file.path, *sources, *loaded.system.components.values()]
    content = [asdict(controller), full, [_digest(file) for file in files]]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def read(name: str) -> CachedRow | None:
    """The row of that name; None if there is none, or none that can be read."""
    with suppress(OSError, ValueError):
        return CachedRow.model_validate_json((folder() / f"{name}.json").read_text(encoding="utf-8"))
    return None


def write(name: str, row: Row, traces: Mapping[str, Trace]) -> None:
    """Keep a row; a folder that cannot be written keeps none."""
    path = folder() / f"{name}.json"
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(path, CachedRow(row=row, traces=dict(traces)).model_dump_json())
