"""Libraries are read and not run; one that is damaged is a finding, and the rest is judged."""

import sys
from pathlib import Path

import pytest

from fmus.compliance.check import main
from fmus.compliance.examine import examine
from fmus.platforms import host_platform, library_name
from tests.described_fmus import members
from tests.mutants.slaves import write_slave

from .archives import write

NAME = "Behaviour"
ELSEWHERE = f"binaries/aarch64-linux/{NAME}.so"
BEGINS = {
    "ELF": b"\x7fELF\2\1\1",
    "PE": b"MZ",
    "Mach-O": b"\xcf\xfa\xed\xfe",
    "universal": b"\xca\xfe\xba\xbe",
}


@pytest.mark.parametrize("begin", BEGINS.values(), ids=BEGINS)
def test_a_damaged_library_is_one_error_and_the_behaviour_is_judged(begin: bytes, tmp_path: Path) -> None:
    content = members(write_slave(tmp_path)) | {ELSEWHERE: begin + bytes(range(256))}
    names = ["library-format", "library-exports", "steps-and-terminates"]
    results = {r.rule.name: r for r in examine(write(content, tmp_path / "damaged.fmu"), names=names)}
    expected = f"{ELSEWHERE} is not a shared library: expected one for aarch64-linux"
    assert results["library-format"].messages == (expected,)
    assert {results[name].outcome for name in names[1:]} == {"passed"}


def test_without_the_library_that_reads_them_the_check_ends_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    content = members(write_slave(tmp_path))
    content[ELSEWHERE] = content.pop(library_name(NAME, host_platform()))
    content[ELSEWHERE] = b"\x7fELF"
    monkeypatch.setitem(sys.modules, "elftools.elf.elffile", None)
    with pytest.raises(ImportError, match=r"needs elftools: pip install 'l1-depth\[check\]'"):
        main([str(write(content, tmp_path / "elsewhere.fmu"))])
    assert capsys.readouterr().out == ""
