"""Libraries that a library for Linux needs are in the FMU, or the documentation tells."""

from pathlib import Path

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


def fmu(built: Fmus, folder: Path, added: Members) -> Path:
    """Our FMU, whose library needs another one."""
    import lief

    content = members(built[NAME])
    library = lief.ELF.parse(list(content[LIBRARY]))
    assert library is not None
    library.add_library(NEEDED)
    library.write(str(folder / "library.so"))
    return write(content | {LIBRARY: (folder / "library.so").read_bytes()} | added, folder / "mutant.fmu")


def test_a_library_that_is_needed_and_not_there_is_caught(built: Fmus, tmp_path: Path) -> None:
    expected = f"{NEEDED}: expected it in the FMU, or documentation/externalDependencies.txt"
    found = {"libraries-are-complete": (f"{LIBRARY} needs {expected}",)}
    assert broken_rules(fmu(built, tmp_path, {})) == found
    for mended in {BESIDE: b""}, {"documentation/externalDependencies.txt": b"libother 1"}:
        assert broken_rules(fmu(built, tmp_path, mended)) == {}
