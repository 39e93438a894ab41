"""Mutants of files that `description.toml` and `archive.toml` list."""

import tomllib
from functools import partial
from pathlib import Path
from typing import Any

from tests.mutants.base import CO_SIMULATION_ONLY, changed, written
from tests.mutants.mutant import Mutant


def _mutant(entry: dict[str, Any]) -> Mutant:
    only = CO_SIMULATION_ONLY if entry.get("co_simulation_only") else ()
    replaced = [(entry["old"], entry["new"])] if "old" in entry else []
    members = changed(*only, *replaced)
    kept = {path: data for path, data in members.items() if path not in entry.get("without", ())}
    added = {path: text.encode() for path, text in entry.get("members", {}).items()}
    rules = frozenset(entry["rules"].split())
    return Mutant(entry["name"], entry["clause"], rules, partial(written, kept | added))


LISTED_MUTANTS = tuple(
    _mutant(entry)
    for name in ("description.toml", "archive.toml")
    for entry in tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))["mutant"]
)
