"""Instances of a native FMU have nothing in common: its library holds no memory that can be written."""

import io
from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus.platforms import library_name
from tests.described_fmus import members

# writable until the loader has put its addresses in, constant from then on
OF_THE_LOADER = {
    ".data.rel.ro",
    ".dynamic",
    ".got",
    ".got.plt",
    ".relro_padding",
    ".init_array",
    ".fini_array",
}
# of the C library: neither these nor what they call keep anything between two calls, or change the process
ALLOWED = """
    bcmp calloc free memcmp memcpy memmove memset snprintf strcmp strcpy strlen strspn strtod vsnprintf
    acos acosh asin asinh atan atan2 atanh cbrt ceil cos cosh erf exp expm1 fabs floor fmax fmin fmod
    log log10 log1p pow sin sincos sinh sqrt tan tanh
"""


@pytest.mark.parametrize(
    ("block", "fmi"),
    [
        ("RovDepthPlant", 2),
        pytest.param("RovDepthPlant", 3, marks=pytest.mark.slow),
        pytest.param("L1DepthController", 2, marks=pytest.mark.slow),
    ],
)
def test_a_library_has_no_memory_of_its_own_and_calls_what_has_none(
    built: Mapping[str, Path], fmi3_built: Mapping[str, Path], block: str, fmi: int
) -> None:
    """FMI 2.0.5, 2.1: so instances may share it, and run in threads side by side."""
    import lief

    lief.logging.disable()
    content = members((built if fmi == 2 else fmi3_built)[block])
    library = lief.ELF.parse(io.BytesIO(content[library_name(block, "linux64", fmi)]))
    assert library
    writable = lief.ELF.Section.FLAGS.WRITE
    assert {section.name for section in library.sections if writable in section.flags_list} <= OF_THE_LOADER
    assert {str(symbol.name) for symbol in library.imported_symbols} <= set(ALLOWED.split())
