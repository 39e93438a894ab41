"""Libraries that a library for Linux needs are in the FMU and sought there, or the documentation tells."""

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


def fmu(built: Fmus, folder: Path, added: Members, search_path: str = "") -> Path:
    """Our FMU, whose library needs another one."""
    import lief

    content = members(built[NAME])
    library = lief.ELF.parse(list(content[LIBRARY]))
    assert library is not None
    library.add_library(NEEDED)
    if search_path:
        library.add(lief.ELF.DynamicEntryRunPath(search_path))
    library.write(str(folder / "library.so"))
    return write(content | {LIBRARY: (folder / "library.so").read_bytes()} | added, folder / "mutant.fmu")


@pytest.mark.parametrize(
    ("added", "rule", "expected", "mended"),
    [
        ({}, "libraries-are-complete",
         f"{NEEDED}: expected it in the FMU, or documentation/externalDependencies.txt",
         ({"documentation/externalDependencies.txt": b"libother 1"}, "")),
        ({BESIDE: b""}, "libraries-have-an-rpath", f"{NEEDED}, without RPATH: expected $ORIGIN",
         ({BESIDE: b""}, "$ORIGIN")),
    ],
)  # fmt: skip
def test_a_library_that_is_needed_and_not_there_or_not_sought_there_is_caught(
    built: Fmus, tmp_path: Path, added: Members, rule: str, expected: str, mended: tuple[Members, str]
) -> None:
    assert broken_rules(fmu(built, tmp_path, added)) == {rule: (f"{LIBRARY} needs {expected}",)}
    assert broken_rules(fmu(built, tmp_path, *mended)) == {}
