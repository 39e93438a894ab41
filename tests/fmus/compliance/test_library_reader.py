"""The reader of shared libraries agrees with LIEF, and ends whatever a library holds."""

import random
from typing import Any

import pytest

from fmus.compliance.library_reader import slices
from fmus.platforms import PLATFORMS, host_platform, library_name
from tests.described_fmus import members

NAME = "DepthReference"


OTHERS = [
    pytest.param(name, marks=pytest.mark.cross) for name in sorted(PLATFORMS) if name != host_platform()
]


@pytest.fixture(params=[host_platform(), *OTHERS])
def library(request: pytest.FixtureRequest) -> bytes:
    is_here = request.param == host_platform()
    fmus = request.getfixturevalue("built" if is_here else "built_everywhere")
    return members(fmus[NAME])[library_name(NAME, request.param)]


def test_exports_and_processor_are_those_that_lief_reads(library: bytes) -> None:
    import lief

    lief.logging.disable()
    universal: Any = lief.MachO.parse(list(library))
    parsed: list[Any] = (
        [*map(universal.at, range(len(universal)))] if universal else [lief.parse(list(library))]
    )
    for one, read in zip(parsed, slices("", library), strict=True):
        exports = {str(function.name).removeprefix("_") for function in one.exported_functions}
        names = {name for name in exports if name.startswith("fmi2")}
        assert {name for name in read.exports if name.startswith("fmi2")} == names != set()
        assert read.machine == f"{one.format.name} {one.abstract.header.architecture.name}"


def test_a_damaged_library_ends_the_reading(library: bytes) -> None:
    """Numbers of entries may be as large as four bytes can make them."""
    draw = random.Random(1)
    for _ in range(200):
        damaged = bytearray(library)
        for _ in range(8):
            place = draw.randrange(0, min(len(damaged), 2048) - 4)
            damaged[place : place + 4] = draw.choice([b"\xff" * 4, bytes(4), draw.randbytes(4)])
        assert len(slices("", bytes(damaged))) <= len(slices("", library))
