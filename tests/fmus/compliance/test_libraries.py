"""Libraries of every platform are judged without being run; what cannot be run here is said."""

import struct
from collections.abc import Mapping
from pathlib import Path

import pytest
from elftools.elf.dynamic import Dynamic

from fmus import files
from fmus.compliance.examine import examine
from fmus.generate import builder
from fmus.generate.archive import native_members
from fmus.generate.trace import trace
from fmus.platforms import host_platform, library_name
from tests.described_fmus import members
from tests.shared_builds import with_libraries

from .archives import broken_rules, write

pytestmark = pytest.mark.cross


NAME = "DepthReference"
OTHERS = [
    platform for platform in ("linux64", "win64", "darwin64", "aarch64-linux") if platform != host_platform()
]


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU for every platform but this one."""
    return builder.build_block(NAME, tmp_path_factory.mktemp("elsewhere"), platforms=OTHERS)


def test_an_fmu_without_a_library_for_this_platform_is_judged_but_for_its_behaviour(elsewhere: Path) -> None:
    results = {result.rule.name: result for result in examine(elsewhere)}
    behaviour = {name for name, result in results.items() if result.rule.stage == "behaviour"}
    reasons = {results[name].not_judged or results[name].not_applicable for name in behaviour}
    assert reasons == {f"no library {NAME} for {host_platform()} (there is {', '.join(sorted(OTHERS))})"}
    assert {results[name].outcome for name in behaviour} == {"not judged"}
    assert {results[name].outcome for name in set(results) - behaviour} == {"passed", "not applicable"}


@pytest.mark.parametrize("platform", OTHERS)
@pytest.mark.parametrize("missing", ["fmi2DoStep", "fmi2GetVersion"])
def test_a_library_that_lacks_a_function_is_caught_on_every_platform(
    elsewhere: Path, tmp_path: Path, platform: str, missing: str
) -> None:
    content = members(elsewhere)
    path = library_name(NAME, platform)
    renamed = missing[:-1].encode() + b"q"  # in the table of names alone: as long, and unknown
    assert missing.encode() in content[path]
    content[path] = content[path].replace(missing.encode() + b"\0", renamed + b"\0")
    broken = broken_rules(write(content, tmp_path / "mutant.fmu"))
    assert any(path in message and missing in message for message in broken["library-exports"]), broken


def without_export_information(library: bytes) -> bytes:
    """A library for macOS whose LC_DYLD_INFO_ONLY is unknown to the loader: the symbol table is left."""
    command, size = 0x80000022, 48
    assert struct.pack("<II", command, size) in library
    return library.replace(struct.pack("<II", command, size), struct.pack("<II", 0x7F, size))


def test_a_library_of_macos_exports_by_its_symbol_table_too(elsewhere: Path, tmp_path: Path) -> None:
    content, path = members(elsewhere), library_name(NAME, "darwin64")
    library = content[path] = without_export_information(content[path])
    assert set(broken_rules(write(content, tmp_path / "table.fmu"))) == set()
    content[path] = library.replace(b"fmi2DoStep\0", b"fmi2DoSteq\0")
    broken = broken_rules(write(content, tmp_path / "mutant.fmu"))
    assert set(broken["library-exports"]) == {f"{path} does not export fmi2DoStep"}


def test_a_library_compiled_without_a_function_is_caught(tmp_path: Path) -> None:
    _, content = native_members(trace(builder.load_block(NAME)))
    source, name = content["sources/fmi2.c"], b"fmi2Status fmi2CancelStep("
    assert source.count(name) == 1
    content["sources/fmi2.c"] = source.replace(name, b"fmi2Status fmi2End(")
    broken = broken_rules(files.write_archive(tmp_path / "mutant.fmu", with_libraries(NAME, content)))
    assert broken["library-exports"] == (
        f"{library_name(NAME, host_platform())} does not export fmi2CancelStep",
    )
    assert set(broken) == {"library-exports"}  # its cause alone


@pytest.mark.parametrize("platform", OTHERS)
def test_a_library_of_another_platform_is_caught(elsewhere: Path, tmp_path: Path, platform: str) -> None:
    content = members(elsewhere)
    other = next(name for name in OTHERS if name != platform)
    content[library_name(NAME, platform)] = content[library_name(NAME, other)]
    (message,) = broken_rules(write(content, tmp_path / "mutant.fmu"))["library-format"]
    assert library_name(NAME, platform) in message


@pytest.mark.parametrize("platform", OTHERS)
@pytest.mark.parametrize("length", [0, 3, 100])
def test_a_library_cut_short_is_caught(elsewhere: Path, tmp_path: Path, platform: str, length: int) -> None:
    content = members(elsewhere)
    path = library_name(NAME, platform)
    content[path] = content[path][:length]
    broken = broken_rules(write(content, tmp_path / "mutant.fmu"))
    assert {"library-format", "library-exports"} & set(broken), broken


def test_a_processor_that_nobody_knows_is_caught(elsewhere: Path, tmp_path: Path) -> None:
    content = members(elsewhere)
    path = library_name(NAME, "aarch64-linux")
    content[path] = content[path][:18] + b"\xfe\xfe" + content[path][20:]  # e_machine of ELF
    (message,) = broken_rules(write(content, tmp_path / "mutant.fmu"))["library-format"]
    assert message.startswith(f"{path} is ELF")
    assert message.endswith("expected ELF AArch64")


def test_a_library_without_sections_is_read_as_fast_as_one_with_them(
    elsewhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pyelftools looks for a table in all entries of the loader's segment, which took most of the time."""
    content, looked_for, look = members(elsewhere), list[str](), Dynamic.get_table_offset
    path = library_name(NAME, "aarch64-linux")
    library = bytearray(content[path])
    library[0x28:0x30], library[0x3A:0x40] = bytes(8), bytes(6)  # place, size and number of the sections
    content[path] = bytes(library)
    monkeypatch.setattr(
        Dynamic, "get_table_offset", lambda self, tag: looked_for.append(tag) or look(self, tag)
    )
    assert broken_rules(write(content, tmp_path / "stripped.fmu")) == {}
    assert "DT_SYMTAB" in looked_for
    assert len(looked_for) == len({*looked_for})


def test_an_fmu_of_sources_alone_is_not_without_implementation(elsewhere: Path, tmp_path: Path) -> None:
    sources = {path: data for path, data in members(elsewhere).items() if not path.startswith("binaries/")}
    assert broken_rules(write(sources, tmp_path / "sources.fmu")) == {}


def test_an_fmu_without_libraries_and_sources_is_caught(
    python_built: Mapping[str, Path], tmp_path: Path
) -> None:
    content = {
        path: data
        for path, data in members(python_built[NAME]).items()
        if not path.startswith(("binaries/", "sources/"))
    }
    assert "has-an-implementation" in broken_rules(write(content, tmp_path / "nothing.fmu"))
