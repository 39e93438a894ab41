"""Libraries that a library for Linux needs are in the FMU and sought there, or the documentation tells."""

from pathlib import Path

import lief
import pytest

from fmus.platforms import host_platform, library_name
from tests.described_fmus import members
from tests.mutants.mutant import broken_rules
from tests.shared_builds import Fmus

from .archives import Members, write

NAME = "DepthReference"
LIBRARY, NEEDED = library_name(NAME, host_platform()), "libother.so.1"
BESIDE = f"{LIBRARY.rpartition('/')[0]}/{NEEDED}"

pytestmark = pytest.mark.skipif(host_platform() != "linux64", reason="only ELF libraries are read")


def fmu(built: Fmus, folder: Path, added: Members, search_path: str = "") -> Path:
    """Our FMU, whose library needs another one."""
    content = members(built[NAME])
    library = lief.ELF.parse(list(content[LIBRARY]))
    assert library is not None
    library.add_library(NEEDED)
    if search_path:
        library.add(lief.ELF.DynamicEntryRunPath(search_path))
    library.write(str(folder / "library.so"))
    return write(content | {LIBRARY: (folder / "library.so").read_bytes()} | added, folder / "mutant.fmu")


def test_a_library_that_is_needed_and_not_there_is_caught(built: Fmus, tmp_path: Path) -> None:
    broken = broken_rules(fmu(built, tmp_path, {}))
    expected = "expected it in the FMU, or documentation/externalDependencies.txt"
    assert broken == {"libraries-are-complete": (f"{LIBRARY} needs {NEEDED}: {expected}",)}
    documented = fmu(built, tmp_path, {"documentation/externalDependencies.txt": b"libother 1"})
    assert broken_rules(documented) == {}


def test_a_library_that_is_there_and_not_sought_there_is_caught(built: Fmus, tmp_path: Path) -> None:
    broken = broken_rules(fmu(built, tmp_path, {BESIDE: b""}))
    expected = f"{LIBRARY} needs {NEEDED}, without RPATH: expected $ORIGIN"
    assert broken == {"libraries-have-an-rpath": (expected,)}
    assert broken_rules(fmu(built, tmp_path, {BESIDE: b""}, "$ORIGIN")) == {}
