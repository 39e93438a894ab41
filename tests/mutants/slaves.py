"""Mutants that run: slaves.toml lists them; each section is one compiled FMU, such as behaviour.c."""

import re
import tomllib
from collections.abc import Sequence
from functools import cache, partial
from importlib import resources
from pathlib import Path

import fmpy

from fmus.native.toolchain import compile_library
from fmus.platforms import host_platform, library_name
from tests.mutants.archive import ARCHIVE_MUTANTS
from tests.mutants.base import replaced, written
from tests.mutants.listed import LISTED_MUTANTS
from tests.mutants.mutant import Mutant

_FOLDER = Path(__file__).parent
_HEADERS = (
    *("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    *("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
)
_CLOCKED = re.compile(r' *<(?:Clock |Float64 name="(?:sample|last)"|ClockedState).*\n')  # which is not judged
_SLAVES = tomllib.loads((_FOLDER / "slaves.toml").read_text(encoding="utf-8"))
CHANGES: dict[str, list[tuple[str, str]]] = _SLAVES["Behaviour"]["changes"]
EXCHANGE_CHANGES: dict[str, list[tuple[str, str]]] = _SLAVES["Exchange"]["changes"]


@cache
def _library(slave: str) -> bytes:
    headers = resources.files(fmpy) / "c-code"
    source = f"{slave.lower()}.c"
    sources = {name: (headers / name).read_text("utf-8") for name in _HEADERS}
    sources[source] = (_FOLDER / source).read_text("utf-8")
    return compile_library(slave, sources, [source], host_platform())


def write_slave(
    folder: Path,
    mutation: str = "",
    flags: str = "",
    changes: Sequence[tuple[str, str]] = (),
    slave: str = "Behaviour",
    is_clocked: bool = False,
) -> Path:
    """The slave with a mutation; changes: of its model description. Without a mutation it is legal.

    is_clocked: whether it keeps its clock
    """
    xml = (_FOLDER / f"{slave.lower()}.xml").read_text("utf-8")
    fmi = 3 if 'fmiVersion="3.0"' in xml else 2
    xml = xml if is_clocked else _CLOCKED.sub("", xml)
    for old, new in changes:
        xml = replaced(xml, old, new)
    members = {
        "modelDescription.xml": xml.encode(),
        library_name(slave, host_platform(), fmi): _library(slave),
        "resources/mutation.txt": f"{mutation}\n{flags}\n".encode(),
    }
    return written(members, folder, f"{slave}.fmu")


def _mutant(slave: str, name: str, clause: str, rules: str, flags: str = "") -> Mutant:
    own = _SLAVES[slave].get("changes", {})
    changes = own.get(name, own.get(flags, ()))
    write = partial(write_slave, mutation=name, flags=flags, changes=changes, slave=slave)
    return Mutant(name, clause, frozenset(rules.split()), write, is_static=False)


# flags, changes and warnings of the slaves that are legal
LEGAL = [
    (flags, CHANGES.get((*names, flags)[0], ()), warned.split())
    for flags, warned, *names in _SLAVES["Behaviour"]["legal"]
]
RUN_MUTANTS = tuple(_mutant(slave, *row) for slave, own in _SLAVES.items() for row in own["mutants"])
STATIC_MUTANTS = (*LISTED_MUTANTS, *ARCHIVE_MUTANTS)
MUTANTS = (*STATIC_MUTANTS, *RUN_MUTANTS)
