"""The libraries in a native FMU, all platforms, as an operating system's loader sees them."""

import hashlib
import os
import re
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from fmus.native import toolchain
from fmus.platforms import PLATFORMS, library_name
from tests.shared_builds import Fmus

pytestmark = pytest.mark.cross

BLOCKS = ("RovDepthPlant", "WaveSource")  # with tables and events, and with the most of the C library
LINUX = ["linux64", "aarch64-linux"]
APPLE = ["darwin64", "aarch64-darwin"]
LINKERS_OWN = {"_mh_dylib_header", "__dso_handle"}  # in every Mach-O that zig links
COLD = ("linux64", "aarch64-darwin")  # platforms for which the libraries are built with an empty cache
IMPORTS = {
    "linux64": r"lib[cm]\.so\.6",
    "aarch64-linux": r"lib[cm]\.so\.6|ld-linux-aarch64\.so\.1",
    "win64": r"KERNEL32\.dll|api-ms-win-crt-[a-z]+-l1-1-0\.dll",  # the C runtime of Windows 10 and later
    "darwin64": r"/usr/lib/libSystem\.B\.dylib",
    "aarch64-darwin": r"/usr/lib/libSystem\.B\.dylib",
}
MACHINES = {
    "linux64": ["ARCH.X86_64"],
    "aarch64-linux": ["ARCH.AARCH64"],
    "win64": ["MACHINE_TYPES.AMD64"],
    "darwin64": ["CPU_TYPE.X86_64", "CPU_TYPE.ARM64"],
    "aarch64-darwin": ["CPU_TYPE.ARM64"],
}
OLDEST_GLIBC = (2, 17)
OLDEST_MACOS = (11, 0, 0)
EMBEDDED_SIGNATURE, CODE_DIRECTORY, AD_HOC, SHA_256 = 0xFADE0CC0, 0xFADE0C02, 0x2, 2


def _read(fmu: Path, platform: str) -> bytes:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read(library_name(fmu.stem, platform))


class Library:
    """One library: its bytes, and what LIEF says of each slice (one but for a universal one)."""

    def __init__(self, fmu: Path, platform: str) -> None:
        import lief

        lief.logging.disable()
        self.name, self.platform, self.data = fmu.stem, platform, _read(fmu, platform)
        self.file = Path(library_name(fmu.stem, platform)).name
        if platform in APPLE:
            self._owner: Any = lief.MachO.parse(list(self.data))  # frees its slices when it is freed
            self.slices: list[Any] = [self._owner.at(i) for i in range(self._owner.size)]
        else:
            self.slices = [lief.parse(list(self.data))]

    def exports(self, binary: Any) -> set[str]:
        if self.platform == "win64":
            return {entry.name for entry in binary.get_export().entries}
        return {symbol.name.removeprefix("_") for symbol in binary.exported_symbols}

    def imports(self, binary: Any) -> list[str]:
        if self.platform == "win64":
            return [entry.name for library_imports in binary.imports for entry in library_imports.entries]
        return [symbol.name for symbol in binary.imported_symbols]

    def libraries(self, binary: Any) -> list[str]:
        """Without its own name, which a Mach-O has in the same list."""
        names = [needed if isinstance(needed, str) else needed.name for needed in binary.libraries]
        return [name for name in names if name != f"@rpath/{self.file}"]

    def machine(self, binary: Any) -> str:
        name = "cpu_type" if self.platform in APPLE else "machine_type"
        return str(getattr(binary.header, "machine" if self.platform == "win64" else name))


Libraries = Callable[[str, str], Library]  # by block and platform


@pytest.fixture(scope="session")
def libraries(built_everywhere: Fmus) -> Libraries:
    """Reads a library of a block's FMU, which is built when a test first wants one of it."""
    return cache(lambda name, platform: Library(built_everywhere[name], platform))


@pytest.fixture(params=BLOCKS)
def block(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.mark.parametrize("platform", PLATFORMS)
def test_it_is_the_platforms_and_has_the_functions_of_fmi_and_nothing_else(
    libraries: Libraries, block: str, platform: str
) -> None:
    """FMI 2.0.5, 2.1, 3.2 and 4.2: with those of both interfaces."""
    header = (toolchain.FMI_HEADERS / "fmi2Functions.h").read_text("utf-8")
    functions = set(re.findall(r"^ *FMI2_Export \w+ +(\w+);", header, re.MULTILINE))
    library = libraries(block, platform)
    assert len(functions) == 44
    assert [library.machine(binary) for binary in library.slices] == MACHINES[platform]
    for binary in library.slices:
        assert library.exports(binary) - (LINKERS_OWN if platform in APPLE else set()) == functions


@pytest.mark.parametrize("platform", PLATFORMS)
def test_it_needs_nothing_but_the_systems_c_library(libraries: Libraries, block: str, platform: str) -> None:
    library = libraries(block, platform)
    for binary in library.slices:
        assert library.imports(binary)
        assert not [name for name in library.imports(binary) if re.match(r"_*(Py|casadi)", name)]
        for name in library.libraries(binary):
            assert re.fullmatch(IMPORTS[platform], name)


@pytest.mark.parametrize("platform", LINUX)
def test_it_runs_with_an_old_glibc(libraries: Libraries, block: str, platform: str) -> None:
    (binary,) = libraries(block, platform).slices
    versions = {a.name for need in binary.symbols_version_requirement for a in need.get_auxiliary_symbols()}
    assert versions
    for version in versions:
        assert version.startswith("GLIBC_")
        assert tuple(int(part) for part in version.removeprefix("GLIBC_").split(".")) <= OLDEST_GLIBC


@pytest.mark.parametrize("platform", LINUX)
def test_its_stack_and_its_tables_are_protected(libraries: Libraries, block: str, platform: str) -> None:
    """A library that wants an executable stack is refused by glibc 2.41 and later."""
    (binary,) = libraries(block, platform).slices
    (stack,) = [segment for segment in binary.segments if str(segment.type) == "TYPE.GNU_STACK"]
    assert not int(stack.flags) & 1
    assert any(str(segment.type) == "TYPE.GNU_RELRO" for segment in binary.segments)


def test_on_windows_it_can_be_placed_anywhere(libraries: Libraries, block: str) -> None:
    import lief

    (binary,) = libraries(block, "win64").slices
    characteristics = int(binary.optional_header.dll_characteristics)
    for flag in ("HIGH_ENTROPY_VA", "DYNAMIC_BASE", "NX_COMPAT"):
        assert characteristics & int(getattr(lief.PE.OptionalHeader.DLL_CHARACTERISTICS, flag)), flag
    assert binary.has_relocations


@pytest.mark.parametrize("platform", APPLE)
def test_on_macos_it_is_a_library_found_beside_its_importer(
    libraries: Libraries, block: str, platform: str
) -> None:
    library = libraries(block, platform)
    for binary in library.slices:
        assert str(binary.header.file_type) == "FILE_TYPE.DYLIB"
        (identity,) = [c for c in binary.commands if str(c.command) == "TYPE.ID_DYLIB"]
        assert identity.name == f"@rpath/{library.file}"
        assert str(binary.build_version.platform) == "PLATFORMS.MACOS"
        assert tuple(binary.build_version.minos) <= OLDEST_MACOS


@pytest.mark.parametrize("platform", APPLE)
def test_on_apple_silicon_every_page_has_the_signed_hash(
    libraries: Libraries, block: str, platform: str
) -> None:
    """The kernel kills a process when a page of its library has another one."""
    library = libraries(block, platform)
    signed = [binary for binary in library.slices if binary.has_code_signature]
    assert [library.machine(binary) for binary in signed] == ["CPU_TYPE.ARM64"]
    for binary in signed:
        thin = library.data[binary.fat_offset :][: binary.original_size]
        _check_signature(thin, binary.code_signature.data_offset, binary.code_signature.data_size)


def _check_signature(thin: bytes, offset: int, size: int) -> None:
    """As Apple's cs_blobs.h has it: big-endian, a super blob with a code directory in it."""
    blob = thin[offset : offset + size]
    magic, length, count = struct.unpack_from(">III", blob)
    assert magic == EMBEDDED_SIGNATURE
    assert length <= size
    places = [struct.unpack_from(">II", blob, 12 + 8 * i) for i in range(count)]
    (start,) = [offset_of_slot for slot, offset_of_slot in places if slot == 0]
    directory = blob[start:]
    magic, length, _, flags, hashes, _, _, n_pages, limit = struct.unpack_from(">9I", directory)
    hash_size, hash_type, _, page_bits = struct.unpack_from("BBBB", directory, 36)
    assert magic == CODE_DIRECTORY
    assert flags & AD_HOC
    assert (hash_size, hash_type) == (32, SHA_256)
    assert limit == offset  # everything before the signature is covered
    page = 1 << page_bits
    assert n_pages == -(-limit // page)
    assert hashes + hash_size * n_pages <= length
    for i in range(n_pages):
        digest = hashlib.sha256(thin[i * page : min((i + 1) * page, limit)]).digest()
        assert digest == directory[hashes + 32 * i : hashes + 32 * (i + 1)], f"page {i}"


@pytest.mark.parametrize("platform", ["aarch64-linux", *APPLE])
def test_on_arm_no_product_and_sum_are_fused_into_one_rounding(
    libraries: Libraries, block: str, platform: str
) -> None:
    """Compilers for ARM do so unless told not to, and the trajectory would be another than on x86-64."""
    library = libraries(block, platform)
    (arm,) = [binary for binary in library.slices if library.machine(binary) != "CPU_TYPE.X86_64"]
    code = bytes(arm.get_section("__text" if platform in APPLE else ".text").content)
    words = struct.unpack(f"<{len(code) // 4}I", code)
    assert any(word & 0xFFE0FC00 == 0x1E600800 for word in words)  # FMUL of doubles: this is the code
    fused = [word for word in words if word & 0xFF000000 == 0x1F000000]  # FMADD and its kin
    fused += [word for word in words if word & 0xBF20FC00 == 0x0E20CC00]  # FMLA, FMLS of vectors
    assert not fused


def test_the_universal_library_holds_both_slices_where_it_says(libraries: Libraries, block: str) -> None:
    data = libraries(block, "darwin64").data
    magic, count = struct.unpack_from(">II", data)
    assert (magic, count) == (0xCAFEBABE, 2)
    end = 8 + 20 * count
    for i in range(count):
        cpu, _, offset, size, align = struct.unpack_from(">5I", data, 8 + 20 * i)
        assert struct.unpack_from("<II", data, offset) == (0xFEEDFACF, cpu)
        assert offset % (1 << align) == 0
        assert align == 14  # a page of Apple silicon, the largest of the two
        assert offset >= end
        end = offset + size
    assert end <= len(data)


def test_the_arm_slice_is_the_library_for_apple_silicon(libraries: Libraries, block: str) -> None:
    data = libraries(block, "darwin64").data
    _, _, offset, size, _ = struct.unpack_from(">5I", data, 8 + 20)
    assert data[offset : offset + size] == libraries(block, "aarch64-darwin").data


@pytest.mark.parametrize("platform", PLATFORMS)
def test_it_tells_no_place_nor_time_of_its_making(libraries: Libraries, block: str, platform: str) -> None:
    library = libraries(block, platform)
    places = [str(Path.home()), str(Path.cwd()), sys.prefix, "/tmp", "l1-depth-build", ".pdb"]
    for path in places:
        assert path.encode() not in library.data
    assert not re.search(rb"(?<!\d)20[2-9]\d-[01]\d-[0-3]\d", library.data)
    if platform == "win64":
        # a time stamp is a digest of the content where the linker says so by this entry
        assert [type(entry).__name__ for entry in library.slices[0].debug] == ["Repro"]


@pytest.fixture(scope="session")
def built_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU built with another folder of temporary files, and for two platforms with a new cache of zig.

    A new cache for Windows takes a minute: zig compiles the C runtime for it.
    """
    folder = tmp_path_factory.mktemp("elsewhere")
    script = (
        "import sys, pathlib\nfrom fmus.generate import builder\n"
        "builder.build_block('RovDepthPlant', pathlib.Path(sys.argv[1]), platforms=sys.argv[2:])\n"
    )
    for subfolder, variables, platforms in (
        ("all", ("TMPDIR",), PLATFORMS),
        ("cold", ("TMPDIR", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"), COLD),
    ):
        environment = {name: str(folder / f"{subfolder} {name}") for name in variables}
        for path in environment.values():
            Path(path).mkdir()
        command = [sys.executable, "-c", script, str(folder / subfolder), *platforms]
        subprocess.run(command, env=os.environ | environment, check=True, timeout=300)
    return folder


@pytest.mark.parametrize(
    ("subfolder", "platform"),
    [*(("all", platform) for platform in PLATFORMS), *(("cold", platform) for platform in COLD)],
)
def test_it_is_the_same_byte_for_byte_wherever_it_is_built(
    built_everywhere: Fmus, built_elsewhere: Path, subfolder: str, platform: str
) -> None:
    built = built_everywhere["RovDepthPlant"]
    assert _read(built_elsewhere / subfolder / built.name, platform) == _read(built, platform)
