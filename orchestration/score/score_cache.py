"""Rows of built-in controllers from earlier scores, in the store.

A row is found by the content of all that it follows from: FMUs, parameters, protocol, seeds, this program and
the libraries, Python and machine that run it.
"""

import json
import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

from pydantic import BaseModel

from fmus import store
from orchestration.errors import OrchestrationError
from orchestration.score.closed_loop import GAINS, ClosedLoop, Controller
from orchestration.score.run_metrics import Trace
from orchestration.score.score_document import Row

KIND = "score"
_PROJECT = Path(__file__).parents[2]
_PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
_PROTOCOL = Path(__file__).with_name("protocol.toml")
_OF_OTHERS = ("controllers", "cost")  # tables of a protocol that a row does not follow from


class CachedRow(BaseModel):
    """A row, and what is drawn of its runs by case."""

    row: Row
    traces: dict[str, Trace]


def key(controller: Controller, loop: ClosedLoop, full: bool) -> str:
    """Returns the key of a row in the store."""
    loaded = loop.scenario(loop.protocol.nominal)
    fmus = [store.digest(fmu.read_bytes()) for fmu in loaded.system.components.values()]
    runs = {name: table for name, table in loop.protocol.file.data.items() if name not in _OF_OTHERS}
    content = [asdict(controller), full, runs, _sources(), _environment(), fmus]
    return store.digest(json.dumps(content, sort_keys=True, default=str).encode())


@cache
def _sources() -> list[tuple[str, str]]:
    """Returns path and digest of what metrics follow from in this program.

    Of the shipped protocol the tables count one by one, and of tuned gains those that the controller has.
    """
    return [
        (path, digest)
        for name in _PACKAGES
        for path, digest, _ in store.digests(_PROJECT / name)
        if (source := _PROJECT / name / path) != _PROTOCOL and source.parent != GAINS
    ]


@cache
def _environment() -> list[object]:
    """Returns what metrics depend on besides the sources: Python, the C library and what is installed."""
    installed = sorted({(found.name, found.version) for found in distributions()})
    return [sys.version, platform.machine(), platform.libc_ver(), installed]


def read(name: str) -> CachedRow | None:
    """Returns the row of a key, if it is stored.

    Raises OrchestrationError, with what to do, if another user can have written it.
    """
    if reason := store.reason_for_distrust(store.folder(KIND) / name):
        raise OrchestrationError(reason)
    with suppress(ValueError):  # of another version of Pydantic
        return CachedRow.model_validate_json(store.get(KIND, name) or b"")
    return None


def write(name: str, row: Row, traces: Mapping[str, Trace]) -> None:
    """Stores a row."""
    store.put(KIND, name, CachedRow(row=row, traces=dict(traces)).model_dump_json().encode())
