"""In each copy of an FMU that is broken at one place, the rule that it breaks is named."""

import stat
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from fmus.documentation.reference_files import LS_REF

from .archives import Members, broken_rules, members, write
from .mutants import ARCHIVE_MUTANTS, XML, XML_MUTANTS

EXPERIMENT = f"extra/{LS_REF}/L1Controller.exp"  # it would be run again for each


@pytest.mark.parametrize(("rule", "old", "new"), XML_MUTANTS)
def test_a_broken_description_is_caught(
    built: Mapping[str, Path], tmp_path: Path, rule: str, old: str, new: str
) -> None:
    content = {path: data for path, data in members(built["L1Controller"]).items() if path != EXPERIMENT}
    xml = content[XML].decode()
    assert old in xml
    content[XML] = xml.replace(old, new, 1).encode()
    broken = broken_rules(write(content, tmp_path / "mutant.fmu"))
    assert rule in broken, broken


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
