"""In each copy of an FMU that is broken at one place, the rule that it breaks is named."""

import stat
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from fmus.platforms import host_platform, library_name

from .test_check import Members, broken_rules, members, write

XML, LIBRARY = "modelDescription.xml", library_name("L1Controller", host_platform())

XML_MUTANTS = [
    ("description-is-readable", "</fmiModelDescription>", ""),
    (
        "description-is-readable",
        '<fmiModelDescription ',
        '<!DOCTYPE x [<!ENTITY a "b">]><fmiModelDescription ',
    ),
    ("description-is-utf-8", "encoding='UTF-8'", "encoding='US-ASCII'"),
    ("fmi-version", 'fmiVersion="2.0"', 'fmiVersion="2.1"'),
    ("guid-is-given", 'guid="', 'guid="" was="'),
    (
        "generation-date",
        'variableNamingConvention="',
        'generationDateAndTime="2026-01-01T00:00:00" variableNamingConvention="',
    ),
    ("schema", "<LogCategories>", "<Nonsense/><LogCategories>"),
    ("log-categories-are-unique", 'Category name="logStatusDiscard"', 'Category name="logStatusWarning"'),
    ("default-experiment", 'stopTime="', 'stopTime="-1" was="'),
    ("model-identifier", 'modelIdentifier="L1Controller"', 'modelIdentifier="1 bad"'),
    ("library-names", 'modelIdentifier="L1Controller"', 'modelIdentifier="Other"'),
    ("capabilities-agree", 'canGetAndSetFMUstate="true"', 'canGetAndSetFMUstate="false"'),
    ("source-files-exist", '<File name="fmi2.c"', '<File name="none.c"'),
    ("type-names", 'SimpleType name="FilterOrder"', 'SimpleType name="Augmentation"'),
    ("type-names", 'SimpleType name="FilterOrder"', 'SimpleType name="internal_step"'),
    ("enumeration-items", 'Item name="pi" value="2"', 'Item name="pi" value="1"'),
    ("variable-names-are-unique", 'name="filter_order"', 'name="internal_step"'),
    ("variable-names-are-legal", 'name="internal_step"', 'name="internal step"'),
    ("variable-names-are-short", 'name="internal_step"', f'name="{"x" * 56}"'),
    (
        "causality-and-variability",
        'causality="parameter" variability="fixed"',
        'causality="parameter" variability="discrete"',
    ),
    ("initial-is-legal", 'variability="fixed" initial="exact"', 'variability="fixed" initial="approx"'),
    ("start-is-given", ' start="0.001"', ""),
    ("numbers-are-finite", 'max="10.0" unit="s"', 'max="INF" unit="s"'),
    ("range-is-not-empty", 'min="1e-07" max="10.0"', 'min="11.0" max="10.0"'),
    ("start-is-in-range", 'start="0.001"', 'start="11.0"'),
    ("nominal-is-positive", 'start="0.001"', 'nominal="0" start="0.001"'),
    ("declared-type-fits", 'declaredType="FilterOrder"', 'declaredType="FilterOrde"'),
    ("enumeration-start-is-an-item", '"Regressor" start="2"', '"Regressor" start="7"'),
    ("unit-names-are-unique", 'Unit name="rad/s"', 'Unit name="s"'),
    ("units-are-defined", 'unit="s" start="0.001"', 'unit="sec" start="0.001"'),
    ("unit-exponents", 'BaseUnit rad="1" s="-1"', 'BaseUnit rad="1" s="-2"'),
    ("unit-factors", '<BaseUnit s="1"', '<BaseUnit factor="0" s="1"'),
    ("alias-settable-once", 'valueReference="6"', 'valueReference="5"'),
    ("alias-units", 'valueReference="5"', 'valueReference="0"'),
    ("dependencies-are-legal", 'dependencies=""', 'dependencies="9999"'),
    ("dependencies-kind", 'dependencies=""', 'dependencies="" dependenciesKind="fixed"'),
    ("instantiates-and-frees", 'guid="', 'guid="{00000000-0000-0000-0000-000000000000}" was="'),
    ("output-derivatives", 'maxOutputDerivativeOrder="1"', 'maxOutputDerivativeOrder="2"'),
    (
        "alias-constants",
        'name="u_m" valueReference="50" description="State feedback -k_m x" '
        'causality="output" variability="continuous" initial="calculated"',
        'name="u_m" valueReference="49" causality="output" variability="constant" initial="exact"',
    ),
    ("outputs-are-listed", '<Unknown index="50" dependencies="" />', ""),
    ("outputs-are-listed", '<Unknown index="50" dependencies="" />', '<Unknown index="1" />'),
    ("structure-indices", '<Unknown index="50" dependencies="" />', '<Unknown index="999" />'),
    ("structure-indices", '<Unknown index="50" dependencies="" />', '<Unknown index="51" />'),
    ("initial-unknowns-are-complete", '<Unknown index="34" dependencies="12" />', ""),
    (
        "initial-unknowns-ascend",
        '<Unknown index="34" dependencies="12" />\n      <Unknown index="35" dependencies="13" />',
        '<Unknown index="35" dependencies="13" />\n      <Unknown index="34" dependencies="12" />',
    ),
    (
        "derivatives-are-marked",
        "<InitialUnknowns>",
        '<Derivatives><Unknown index="50" /></Derivatives><InitialUnknowns>',
    ),
    ("derivative-is-of-a-variable", '<Real unit="1" />', '<Real unit="1" derivative="999" />'),
    (
        "one-independent-variable",
        'causality="parameter" variability="fixed" initial="exact">\n      <Enumeration',
        'causality="independent" variability="continuous">\n      <Enumeration',
    ),
    ("variables-have-a-type", 'valueReference="0"', 'valueReference="-1"'),
    ("start-values-are-as-declared", 'start="0.001"', 'start="0.002"'),
    ("variables-can-be-read", 'valueReference="49"', 'valueReference="999"'),
    ("fmpy-validation", "<LogCategories>", "<Nonsense/><LogCategories>"),
    ("fmutool-generic-check", "<LogCategories>", "<Nonsense/><LogCategories>"),
    ("fmutool-semantic-check", 'name="filter_order"', 'name="internal_step"'),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "old", "new"), XML_MUTANTS)
def test_a_broken_description_is_caught(
    built: Mapping[str, Path], tmp_path: Path, rule: str, old: str, new: str
) -> None:
    content = members(built["L1Controller"])
    xml = content[XML].decode()
    assert old in xml
    content[XML] = xml.replace(old, new, 1).encode()
    broken = broken_rules(write(content, tmp_path / "mutant.fmu"))
    assert rule in broken, broken


def _changed(**changes: bytes | None) -> Callable[[Members], Members]:
    def change(content: Members) -> Members:
        return {k: v for k, v in {**content, **changes}.items() if v is not None}

    return change


ARCHIVE_MUTANTS = [
    ("archive-has-description", _changed(**{XML: None})),
    ("archive-paths-are-portable", _changed(**{"../escape": b""})),
    ("archive-paths-are-unique", _changed(**{"MODELDESCRIPTION.xml": b""})),
    ("archive-layout", _changed(**{"readme.txt": b""})),
    ("platform-names", _changed(**{"binaries/amiga/x": b""})),
    ("library-format", _changed(**{LIBRARY: b"no library"})),
    ("source-files-exist", _changed(**{"sources/fmi2.c": None})),
    ("library-names", _changed(**{LIBRARY: None, f"{LIBRARY}.so": b""})),
    ("runs-on-this-platform", _changed(**{LIBRARY: None})),
]


@pytest.mark.parametrize(("rule", "change"), ARCHIVE_MUTANTS)
def test_a_broken_archive_is_caught(
    built: Mapping[str, Path], tmp_path: Path, rule: str, change: Callable[[Members], Members]
) -> None:
    content = change(members(built["L1Controller"]))
    assert rule in broken_rules(write(content, tmp_path / "mutant.fmu"))


def test_a_damaged_member_is_caught(built: Mapping[str, Path], tmp_path: Path) -> None:
    path = write(members(built["L1Controller"]), tmp_path / "mutant.fmu")
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo("sources/fmi2.c")
    data = bytearray(path.read_bytes())
    data[info.header_offset + 30 + len(info.filename) + info.compress_size // 2] ^= 0xFF
    path.write_bytes(data)
    (told,) = broken_rules(path)["archive-is-zip"]
    assert told.startswith("sources/fmi2.c is damaged")


def test_a_symbolic_link_is_caught(built: Mapping[str, Path], tmp_path: Path) -> None:
    path = write(members(built["L1Controller"]), tmp_path / "mutant.fmu")
    link = zipfile.ZipInfo("resources/link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(link, "/etc/passwd")
    broken = broken_rules(path)
    assert broken == {
        "archive-members-are-plain": ("resources/link is a symbolic link: expected a plain file",)
    }


def test_another_compression_is_caught(built: Mapping[str, Path], tmp_path: Path) -> None:
    path = write(members(built["L1Controller"]), tmp_path / "mutant.fmu")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("resources/data", b"data")
    assert set(broken_rules(path)) == {"archive-members-are-plain"}
