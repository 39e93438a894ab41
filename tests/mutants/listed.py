"""Changed copies of the base that TOML files list: mutants, and unusual FMUs that are legal."""

import tomllib
from functools import partial
from pathlib import Path
from typing import Any

from tests.mutants.base import BASE, BASE_3, CO_SIMULATION_ONLY, Members, changed, written
from tests.mutants.mutant import Mutant


def _entries(name: str, key: str) -> list[dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))[key]


def _members(entry: dict[str, Any], base: Members = BASE) -> Members:
    only = CO_SIMULATION_ONLY if entry.get("co_simulation_only") else ()
    replaced = [(old, new) for old, new in entry.get("replaced", ())]
    replaced += [(entry["old"], entry["new"])] if "old" in entry else []
    members = changed(*only, *replaced, base=base)
    remaining = {path: data for path, data in members.items() if path not in entry.get("without", ())}
    return remaining | {path: text.encode() for path, text in entry.get("members", {}).items()}


LISTED_MUTANTS = tuple(
    Mutant(m["name"], m["clause"], frozenset(m["rules"].split()), partial(written, _members(m, base)))
    for name, base in (("description.toml", BASE), ("archive.toml", BASE), ("fmi3.toml", BASE_3))
    for m in _entries(name, "mutant")
)
# name -> (members, rules that warn)
LEGAL_FMUS = {
    fmu["name"]: (_members(fmu), set(fmu.get("warnings", "").split()))
    for fmu in _entries("legal.toml", "fmu")
}
