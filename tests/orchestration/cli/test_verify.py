"""The bill of materials in an FMU is valid and true; libraries are compiled again and compared with it."""

import hashlib
import io
import json
import os
import re
import stat
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import pytest

import fmus
from fmus.files import packed, write_archive
from fmus.fmi.description import describe
from fmus.generate import builder
from fmus.generate.archive import bill_of_materials, native_members
from fmus.generate.builder import build_block
from fmus.generate.trace import trace
from fmus.native import verify
from fmus.native.sbom import MEMBER, RECIPE, with_files
from fmus.native.toolchain import FMI_HEADERS
from fmus.platforms import PLATFORMS, TARGETS, host_platform, library_name
from tests.described_fmus import members
from tests.orchestration.conftest import Done
from tests.shared_builds import Fmus

Command = Callable[..., Done]
NAME = "ExamplePlant"
COMPILE = f"zig cc of {TARGETS[host_platform()][0][0]}/{NAME}.{TARGETS[host_platform()][1]}"
LIBRARY = f"binaries/{host_platform()}/{NAME}.{TARGETS[host_platform()][1]}"
OUTSIDE = Path(fmus.__file__).with_name("py.typed")  # an empty file
FROM_FMI = os.path.relpath(OUTSIDE, FMI_HEADERS)
LISTED = b'<fmiBuildDescription><SourceFile name="%b"/></fmiBuildDescription>'


def bill_of(fmu: Path) -> dict[str, Any]:
    return json.loads(members(fmu)[MEMBER])


@pytest.mark.slow  # the import of the validator takes a second
def test_the_bill_is_valid(built: Fmus) -> None:
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    text = members(built[NAME])[MEMBER].decode()
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None


def test_the_bill_names_block_compiler_and_each_library(built: Fmus) -> None:
    bill, inside = bill_of(built[NAME]), members(built[NAME])
    assert bill["metadata"]["component"]["name"] == NAME
    assert bill["metadata"]["component"]["properties"][0]["value"] == "plant_fmu.example_plant"
    assert bill["metadata"]["properties"] == [{"name": "l1-depth:recipe", "value": RECIPE}]
    files = {part["name"]: part for part in bill["components"] if part["type"] == "file"}
    assert {"model.png", LIBRARY} <= files.keys()
    for name, file in files.items():
        assert file["hashes"][0]["content"] == hashlib.sha256(inside[name]).hexdigest()
        assert ("properties" in file) is (name == LIBRARY)
    names = {part["name"] for part in bill["components"]} - files.keys()
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
        if part["name"].startswith("binaries/")
    }
    assert sorted(libc.values()) == [
        "Universal C Runtime",
        *["glibc 2.17"] * 2,
        *["libSystem of macOS 11.0"] * 2,
    ]
    paths = [path for path in sorted(members(fmu)) if path.startswith("binaries/")]
    lines = command("verify", fmu).stdout.splitlines()
    assert lines == [f"{path}: same" for path in (*paths, MEMBER, f"GUID {describe(fmu).guid}")]


def verified(command: Command, folder: Path, inside: dict[str, bytes]) -> str:
    """What the command prints of an FMU that differs from what its sources give."""
    done = command("verify", write_archive(folder / "changed.fmu", inside), expect=1)
    assert re.search("[1-3] of 3 parts differ or cannot be built: expected none", done.stderr)
    return done.stdout


@pytest.mark.slow
def test_a_library_or_a_source_that_was_changed_is_different(
    command: Command, built: Fmus, tmp_path: Path
) -> None:
    guid = f"GUID {describe(built[NAME]).guid}"
    assert command("verify", built[NAME]).stdout == f"{LIBRARY}: same\n{MEMBER}: same\n{guid}: same\n"
    inside = members(built[NAME])
    patched = inside | {LIBRARY: inside[LIBRARY] + b"\0"}
    expected = f"{LIBRARY}: different\n{MEMBER}: different\n{guid}: same\n"
    assert verified(command, tmp_path, patched) == expected
    source = inside["sources/model.h"].replace(b"MODEL_STEP_SIZE ", b"MODEL_STEP_SIZE 2 * ")
    expected = f"{LIBRARY}: different\n{MEMBER}: same\n{guid}: different\n"
    assert verified(command, tmp_path, inside | {"sources/model.h": source}) == expected


Verdicts = Callable[[Mapping[str, bytes]], dict[str, str]]


@pytest.fixture
def verdicts(monkeypatch: pytest.MonkeyPatch) -> Verdicts:
    """What is found in members whose libraries are those of their sources, of the name of a part."""

    def compiled(model: str, inside: Mapping[str, bytes], *_: object) -> bytes:
        return next(
            (inside[path] for path in inside if PurePosixPath(path).stem == model == NAME and path[0] == "b"),
            b"",
        )

    monkeypatch.setattr(verify, "_compiled", compiled)

    def found(inside: Mapping[str, bytes]) -> dict[str, str]:
        with zipfile.ZipFile(io.BytesIO(packed(inside))) as archive:
            parts = dict(verify.verified(archive))
        assert all(verdict in (verify.SAME, verify.DIFFERENT) for verdict in parts.values())
        return parts

    return found


def wrong(parts: Mapping[str, str]) -> set[str]:
    return {part.partition(" ")[0] for part, verdict in parts.items() if verdict != verify.SAME}


def test_a_changed_byte_of_any_member_and_a_missing_one_are_found(built: Fmus, verdicts: Verdicts) -> None:
    inside = members(built[NAME])
    assert not wrong(verdicts(inside))
    described = {part["name"] for part in bill_of(built[NAME])["components"] if part["type"] == "file"}
    for path in inside.keys() - {"sources/buildDescription.xml", "modelDescription.xml"}:
        content = inside[path]
        middle = len(content) // 2
        changed = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        found = wrong(verdicts(inside | {path: changed}))
        if path == MEMBER:
            assert found & {MEMBER, "GUID"}
        elif path in described:
            assert found == ({path, MEMBER} if path != LIBRARY else {MEMBER})
        else:
            assert found == {"GUID"}, path
        if path not in (LIBRARY, MEMBER):
            assert wrong(verdicts({name: inside[name] for name in inside if name != path})), path


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_changed_description_and_an_added_member_are_another_guid(
    fmi: int, built: Fmus, verdicts: Verdicts
) -> None:
    block = builder.load_block(NAME)
    _, inside = native_members(trace(block), fmi=fmi)
    path = library_name(NAME, host_platform(), fmi)
    library = {path: b"library"}
    inside |= library | bill_of_materials(block, library, fmi)
    assert not wrong(verdicts(inside))
    for old, new in {b' start="': b' start="1', b"</": b" </", b'"l1-depth ': b'"L1-depth '}.items():
        text = inside["modelDescription.xml"]
        assert old in text
        assert wrong(verdicts(inside | {"modelDescription.xml": text.replace(old, new, 1)})) == {"GUID"}
    build = inside["sources/buildDescription.xml"].replace(b"C99", b"C11")
    for added, content in {
        "resources/table.csv": b"",
        "sources/buildDescription.xml": build,
        "documentation/Index.html": inside["documentation/index.html"],
        "extra/a": b"1",
        "resources/": b"a folder with content",
        f"./{MEMBER}": inside[MEMBER],
    }.items():
        assert wrong(verdicts(inside | {added: content})) == {"GUID"}, added
    second = path.replace(NAME, "other")
    assert wrong(verdicts(inside | {second: b"foreign"})) == {second, "GUID"}


def test_a_bill_covers_no_more_than_it_lists_and_lists_no_more_than_there_is(
    built: Fmus, verdicts: Verdicts
) -> None:
    """A page or an added member that is listed in the bill would be left out of the GUID."""
    inside = members(built[NAME])
    bill = json.loads(inside[MEMBER])
    for path in ("documentation/index.html", "resources/table.csv"):
        changed = inside | {path: b"<html>another</html>"}
        listed = {path: ("", changed[path])} | {
            part["name"]: (host_platform() if part["name"] == LIBRARY else "", inside[part["name"]])
            for part in bill["components"]
            if part["type"] == "file"
        }
        assert path in wrong(verdicts(changed | {MEMBER: with_files(inside[MEMBER], listed)}))
    for change in (
        {"bomFormat": "another"},
        {"more": 1},
        {"metadata": bill["metadata"] | {"component": {"name": NAME, "licenses": []}}},
        {"components": [*bill["components"], {"type": "library", "name": "hidden"}]},
        {
            "components": [
                *bill["components"],
                {"type": "file", "name": "absent", "hashes": [{"content": "0"}]},
            ]
        },
        {"components": [*bill["components"], {"type": "file", "name": 7, "hashes": [{"content": "0"}]}]},
        {"components": None},
    ):
        text = (json.dumps(bill | change, indent=1) + "\n").encode()
        assert wrong(verdicts(inside | {MEMBER: text})) & {MEMBER, "GUID"}, change
    assert wrong(verdicts(inside | {MEMBER: inside[MEMBER] + b" "})) == {MEMBER}
    description = inside["modelDescription.xml"]
    guid = description.split(b'guid="')[1].partition(b'"')[0]
    for replacement in (b'guid=""', b""):
        text = description.replace(b'guid="' + guid + b'"', replacement)
        assert "GUID" in wrong(verdicts(inside | {"modelDescription.xml": text}))


def test_members_of_one_name_and_links_are_refused(
    refused: Callable[..., str], built: Fmus, tmp_path: Path
) -> None:
    """Importers may read the one or the other."""
    twice = write_archive(tmp_path / "twice.fmu", members(built[NAME]))
    with zipfile.ZipFile(twice, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("sources/fmi2.c", members(twice)["sources/fmi2.c"])
    assert "sources/fmi2.c: expected one member of this name, and no symbolic link" in refused(
        "verify", twice
    )
    linked = write_archive(tmp_path / "linked.fmu", members(built[NAME]))
    link = zipfile.ZipInfo("resources/table")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(linked, "a") as archive:
        archive.writestr(link, "/etc/passwd")
    assert "resources/table: expected one member" in refused("verify", linked)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({MEMBER: None}, f"compiler: the FMU states none: expected {RECIPE}"),
        ({MEMBER: b"[]"}, "compiler: the FMU states none"),
        ({MEMBER: RECIPE.replace("0.14", "0.13")}, "compiler: the FMU states ziglang 0.13.1"),
        ({"sources/buildDescription.xml": None}, "no source files in sources/buildDescription.xml"),
        ({"sources/fmi2.c": b"wrong"}, f"{COMPILE} failed: fmi2.c:1:1: error"),
        ({"sources/fmi2.c": b"/* \xff */"}, "'utf-8' codec can't decode byte 0xff"),
        ({"sources/old/fmi2.c": b""}, "sources/old/fmi2.c: expected a file there, named by letters, digits"),
        (
            {"sources/other.c": b""},
            "sources/other.c: neither listed in sources/buildDescription.xml nor incl",
        ),
        ({"sources/FMI2.C": b""}, "sources/FMI2.C: neither listed in"),
        ({"sources/-o.c": b""}, "sources/-o.c: expected a file there"),
        ({"sources/buildDescription.xml": LISTED % b"-v"}, "sources/-v: expected a file there"),
        ({"sources/buildDescription.xml": LISTED % b"../fmi2.c"}, "sources/../fmi2.c: expected a file there"),
        ({"sources/fmi2.c": f'%:include "{OUTSIDE}"\n'.encode()}, f"sources include {OUTSIDE}: exp"),
        ({"sources/fmi2.c": f"#inc\\\nlude <{FROM_FMI}>\n".encode()}, f"sources include {OUTSIDE}: expected"),
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
