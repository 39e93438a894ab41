"""In each copy of an FMU that is broken at one place, the rule that it breaks is named."""

import stat
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import pytest

from fmus.documentation.reference_files import LS_REF

from .archives import Members, breaks, broken_rules, members, write
from .mutants import ARCHIVE_MUTANTS, XML, XML_MUTANTS

Change = Callable[[Members], Members]
EXPERIMENT = f"extra/{LS_REF}/L1Controller.exp"  # it would be run again for each


def _replaced(content: Members, old: str, new: str) -> Members:
    xml = content[XML].decode()
    assert old in xml
    other = {path: data for path, data in content.items() if path != EXPERIMENT}
    return other | {XML: xml.replace(old, new, 1).encode()}


MUTANTS = [
    *((rule, partial(_replaced, old=old, new=new)) for rule, old, new in XML_MUTANTS),
    *ARCHIVE_MUTANTS,
]


@pytest.fixture
def mutant(built: Mapping[str, Path], tmp_path: Path) -> Callable[[Change], Path]:
    return lambda change: write(change(members(built["L1Controller"])), tmp_path / "mutant.fmu")


@pytest.mark.parametrize(("rule", "change"), MUTANTS)
def test_the_rule_that_is_broken_finds_it(
    mutant: Callable[[Change], Path], rule: str, change: Change
) -> None:
    assert breaks(mutant(change), rule)


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "change"), MUTANTS)
def test_the_whole_check_names_the_rule_that_is_broken(
    mutant: Callable[[Change], Path], rule: str, change: Change
) -> None:
    broken = broken_rules(mutant(change))
    assert rule in broken, broken


def test_a_damaged_member_is_caught(built: Mapping[str, Path], tmp_path: Path) -> None:
    path = write(members(built["L1Controller"]), tmp_path / "mutant.fmu")
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo("sources/fmi2.c")
    data = bytearray(path.read_bytes())
    data[info.header_offset + 30 + len(info.filename) + info.compress_size // 2] ^= 0xFF
    path.write_bytes(data)
    (message,) = broken_rules(path)["archive-is-zip"]
    assert message.startswith("sources/fmi2.c is damaged")


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
