"""The check finds nothing in our FMUs, and ends with findings whatever a file holds."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus import catalogue
from fmus.compliance import report
from fmus.compliance.examine import all_rules, examine

Members = dict[str, bytes]
PYTHONFMU_ERRORS = {  # its binary looks at no GUID, and fmi2FreeFMUstate leaves the address
    "refuses-a-wrong-guid": ("fmi2Instantiate gave an instance for a wrong GUID: expected NULL",),
    "state-restores": ("fmi2FreeFMUstate left the state's address: expected NULL",),
}


def members(path: Path) -> Members:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(content: Members, path: Path) -> Path:
    """An archive as it is told to be, also with members that no tool should write."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def broken_rules(path: Path, timeout: float = 10) -> dict[str, tuple[str, ...]]:
    """Rule -> its messages, of the rules that the FMU breaks."""
    return {r.rule.name: r.messages for r in examine(path, timeout) if r.messages}


@pytest.mark.parametrize("name", catalogue.block_names())
def test_our_native_fmus_break_no_rule(built: Mapping[str, Path], name: str) -> None:
    assert broken_rules(built[name]) == {}


@pytest.mark.parametrize("name", catalogue.block_names())
def test_our_python_fmus_break_what_the_binary_of_pythonfmu_breaks(
    python_built: Mapping[str, Path], name: str
) -> None:
    assert broken_rules(python_built[name]) == PYTHONFMU_ERRORS


def test_documentation_lists_every_rule() -> None:
    text = (Path(__file__).parents[3] / "docs" / "reference" / "compliance.md").read_text(encoding="utf-8")
    assert report.markdown(all_rules()) in text


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x05\x06" + bytes(18)])
def test_garbage_is_a_finding_and_never_a_crash(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "garbage.fmu"
    path.write_bytes(content)
    assert {r.rule.name for r in examine(path) if r.messages} & {"archive-is-zip", "archive-has-description"}


def test_a_foreign_fmu_is_judged_to_the_end(foreign: Mapping[str, Path]) -> None:
    assert [r.rule for r in examine(foreign["Lag"], timeout=10)] == list(all_rules())
