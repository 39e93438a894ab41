"""Rows of built-in controllers from earlier scores, in the user's cache folder.

A row is found by the content of all that it follows from: FMUs, parameters, protocol, seeds, this program and
the libraries, Python and machine that run it. The rows that were used last are kept: other content leaves
rows that nobody finds.
"""

import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

from pydantic import BaseModel

from fmus.user_cache import cache_folder, reason_for_distrust, write_cached
from orchestration.errors import OrchestrationError
from orchestration.score import tuned_gains
from orchestration.score.loop import Controller, Loop
from orchestration.score.score_document import Row
from orchestration.score.scored_run import Trace

_PROJECT = Path(__file__).parents[2]
_PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
_PROTOCOL = Path(__file__).with_name("protocol.toml")
_OF_OTHERS = ("controllers", "cost")  # tables of a protocol that a row does not follow from
MOST_ROWS = 150  # three scores of 17 controllers and a comparison of 34, with and without plants: 60 MB


class CachedRow(BaseModel):
    """A row, and what is drawn of its runs by case."""

    row: Row
    traces: dict[str, Trace]


def folder() -> Path:
    return cache_folder("score")


def key(controller: Controller, loop: Loop, full: bool) -> str:
    """The name of a row in the cache."""
    loaded = loop.scenario(loop.protocol.nominal)
    fmus = [_digest(fmu) for fmu in loaded.system.components.values()]
    runs = {name: table for name, table in loop.protocol.file.data.items() if name not in _OF_OTHERS}
    content = [asdict(controller), full, runs, _digests_of_sources(), _environment(), fmus]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


@cache
def _digests_of_sources() -> list[str]:
    files = (path for name in _PACKAGES for path in (_PROJECT / name).rglob("*"))
    return [_digest(path) for path in sorted(files) if path.is_file() and _is_followed(path)]


def _is_followed(source: Path) -> bool:
    """Not the shipped protocol, whose tables count one by one, nor tuned gains, which the controller has."""
    return source != _PROTOCOL and source.parent != tuned_gains.FOLDER and source.suffix != ".pyc"


@cache
def _environment() -> list[object]:
    """Returns what figures depend on besides the sources: Python, the C library and what is installed."""
    installed = sorted({(found.name, found.version) for found in distributions()})
    return [sys.version, platform.machine(), platform.libc_ver(), installed]


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def read(name: str) -> CachedRow | None:
    """Returns the row of that name; None if there is none, or none that can be read.

    Raises OrchestrationError, with what to do, if another user can have written it.
    """
    path = folder() / f"{name}.json"
    if reason := reason_for_distrust(path):
        raise OrchestrationError(reason)
    with suppress(OSError, ValueError):
        row = CachedRow.model_validate_json(path.read_text(encoding="utf-8"))
        with suppress(OSError):  # of a cache that can only be read
            os.utime(path)
        return row
    return None


def write(name: str, row: Row, traces: Mapping[str, Trace]) -> None:
    """Keep a row, and remove those whose last use is longest ago.

    A folder that cannot be written keeps none.
    """
    path = folder() / f"{name}.json"
    with suppress(OSError):
        write_cached(path, CachedRow(row=row, traces=dict(traces)).model_dump_json().encode())
        _remove_all_but_the_last(path.parent.glob("*.json"))


def _remove_all_but_the_last(paths: Iterable[Path]) -> None:
    """Other processes may remove rows at the same time."""
    used: dict[Path, float] = {}
    for path in paths:
        with suppress(FileNotFoundError):
            used[path] = path.stat().st_mtime
    for path in sorted(used, key=lambda path: used[path], reverse=True)[MOST_ROWS:]:
        path.unlink(missing_ok=True)
