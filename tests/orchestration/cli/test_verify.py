"""The bill of materials in an FMU is valid and true; libraries are compiled again and compared with it."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

from fmus.build.builder import build_block
from fmus.files import write_archive
from fmus.native.sbom import MEMBER, RECIPE
from fmus.platforms import PLATFORMS, TARGETS, host_platform
from tests.described_fmus import members
from tests.orchestration.conftest import Done
from tests.shared_builds import Fmus

Command = Callable[..., Done]
NAME = "ExamplePlant"
LIBRARY = f"binaries/{host_platform()}/{NAME}.{TARGETS[host_platform()][1]}"


def bill_of(fmu: Path) -> dict[str, Any]:
    text = members(fmu)[MEMBER].decode()
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    return json.loads(text)


def test_the_bill_names_block_compiler_and_each_library(built: Fmus) -> None:
    bill, inside = bill_of(built[NAME]), members(built[NAME])
    assert bill["metadata"]["component"]["name"] == NAME
    assert bill["metadata"]["component"]["properties"][0]["value"] == "plant_fmu.example_plant"
    assert bill["metadata"]["properties"] == [{"name": "l1-depth:recipe", "value": RECIPE}]
    files = [part for part in bill["components"] if part["type"] == "file"]
    assert [file["name"] for file in files] == [LIBRARY]
    assert files[0]["hashes"][0]["content"] == hashlib.sha256(inside[LIBRARY]).hexdigest()
    names = {part["name"] for part in bill["components"]} - {LIBRARY}
    assert names == {"l1-depth", "fmi-headers", "compiler-rt of zig"}


@pytest.mark.cross
@pytest.mark.parametrize("fmi", [2, 3])
def test_libraries_of_all_platforms_are_compiled_to_the_same_bytes(
    command: Command, tmp_path: Path, fmi: int
) -> None:
    fmu = build_block(NAME, tmp_path, platforms=PLATFORMS, fmi=fmi)
    libc = {
        part["name"].split("/")[1]: part["properties"][2]["value"]
        for part in bill_of(fmu)["components"]
        if part["type"] == "file"
    }
    assert sorted(libc.values()) == [
        "Universal C Runtime",
        *["glibc 2.17"] * 2,
        *["libSystem of macOS 11.0"] * 2,
    ]
    lines = command("verify", fmu).stdout.splitlines()
    assert lines == [f"{path}: same" for path in sorted(members(fmu)) if path.startswith("binaries/")]


def verified(command: Command, folder: Path, inside: dict[str, bytes]) -> str:
    """What the command prints of an FMU that differs from what its sources give."""
    done = command("verify", write_archive(folder / "changed.fmu", inside), expect=1)
    assert "1 of 1 libraries differ or cannot be built: expected none" in done.stderr
    return done.stdout


def test_a_library_or_a_source_that_was_changed_is_different(
    command: Command, built: Fmus, tmp_path: Path
) -> None:
    assert command("verify", built[NAME]).stdout == f"{LIBRARY}: same\n"
    inside = members(built[NAME])
    patched = inside | {LIBRARY: inside[LIBRARY] + b"\0"}
    assert verified(command, tmp_path, patched) == f"{LIBRARY}: different\n"
    source = inside["sources/model.h"].replace(b"MODEL_STEP_SIZE ", b"MODEL_STEP_SIZE 2 * ")
    assert verified(command, tmp_path, inside | {"sources/model.h": source}) == f"{LIBRARY}: different\n"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({MEMBER: None}, f"compiler: the FMU states none: expected {RECIPE}"),
        ({MEMBER: b"[]"}, "compiler: the FMU states none"),
        ({MEMBER: RECIPE.replace("0.14", "0.13")}, "compiler: the FMU states ziglang 0.13.1"),
        ({"sources/buildDescription.xml": None}, "no source files in sources/buildDescription.xml"),
        ({"sources/fmi2.c": b"wrong"}, "zig cc failed: fmi2.c:1:1: error"),
    ],
)
def test_what_cannot_be_built_says_why(
    changes: dict[str, Any], reason: str, command: Command, built: Fmus, tmp_path: Path
) -> None:
    inside = members(built[NAME])
    for path, content in changes.items():
        if isinstance(content, str):
            inside[path] = inside[path].replace(RECIPE.encode(), content.encode())
        elif content is None:
            del inside[path]
        else:
            inside[path] = content
    assert verified(command, tmp_path, inside).startswith(f"{LIBRARY}: cannot be built: {reason}")


def test_a_compiler_of_the_build_description_is_named(command: Command, built: Fmus, tmp_path: Path) -> None:
    inside = members(built[NAME])
    del inside[MEMBER]
    path = "sources/buildDescription.xml"
    inside[path] = inside[path].replace(
        b"<SourceFileSet ", b'<SourceFileSet compiler="gcc" compilerOptions="-O3" '
    )
    assert "compiler: the FMU states gcc -O3: expected ziglang" in verified(command, tmp_path, inside)


def test_a_platform_that_is_none_of_ours_is_named(command: Command, built: Fmus, tmp_path: Path) -> None:
    inside = members(built[NAME])
    inside[f"binaries/linux32/{NAME}.so"] = inside.pop(LIBRARY)
    assert "cannot be built: no platform 'linux32': expected one of" in verified(command, tmp_path, inside)


def test_fmus_without_libraries_or_with_a_broken_description_are_refused(
    refused: Callable[..., str], built: Fmus, tmp_path: Path
) -> None:
    inside = members(built[NAME])
    broken = write_archive(tmp_path / "broken.fmu", inside | {"sources/buildDescription.xml": b"<"})
    assert "sources/buildDescription.xml: unclosed token" in refused("verify", broken)
    del inside[LIBRARY]
    assert "no libraries: expected some" in refused("verify", write_archive(tmp_path / "none.fmu", inside))
