"""Each sentence of FMI that a file alone can break is found by its rules and no others."""

import io
import zipfile
from pathlib import Path

import pytest

from tests.mutants.base import BASE, BASE_3, CO_SIMULATION_ONLY, changed, written
from tests.mutants.listed import LEGAL_FMUS
from tests.mutants.mutant import Mutant, broken_rules, unexpected
from tests.mutants.slaves import STATIC_MUTANTS


@pytest.mark.parametrize(
    "members",
    [BASE, changed(*CO_SIMULATION_ONLY), BASE_3],
    ids=["both interfaces", "co-simulation", "FMI 3.0"],
)
def test_what_the_mutants_start_from_breaks_no_rule(members: dict[str, bytes], tmp_path: Path) -> None:
    assert broken_rules(written(members, tmp_path)) == {}


@pytest.mark.parametrize("mutant", STATIC_MUTANTS, ids=lambda mutant: mutant.name)
def test_a_static_mutant_is_found_by_its_rules_and_no_others(mutant: Mutant, tmp_path: Path) -> None:
    broken = mutant.broken_rules(tmp_path)
    assert list(unexpected(mutant, broken)) == []
    assert [text for texts in broken.values() for text in texts if "None" in text] == []  # of what is missing


@pytest.mark.parametrize("name", LEGAL_FMUS)
def test_what_a_sentence_allows_is_no_error(name: str, tmp_path: Path) -> None:
    """The sentence stands beside each FMU in `tests/mutants/legal.toml`."""
    members, warnings = LEGAL_FMUS[name]
    assert set(broken_rules(written(members, tmp_path))) == warnings


class _Pipe(io.BytesIO):
    """A stream that a zip is written to without going back: sizes follow the data, with bit 3."""

    def seek(self, *_: int) -> int:
        raise io.UnsupportedOperation


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("streamed", [False, True])
def test_what_is_packed_as_fmi_allows_is_no_error(method: int, streamed: bool, tmp_path: Path) -> None:
    """2.3: stored or deflated; bit 3 for deflated members alone."""
    stream = _Pipe() if streamed else io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in BASE.items():
            archive.writestr(name, content)
    path = tmp_path / "Base.fmu"
    path.write_bytes(stream.getvalue())
    refused = {"archive-data-descriptors"} if streamed and method == zipfile.ZIP_STORED else set()
    assert set(broken_rules(path)) == refused
