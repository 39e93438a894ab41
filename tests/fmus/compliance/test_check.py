"""The check finds nothing in our FMUs, and ends with findings whatever a file holds."""

from pathlib import Path

import pytest

from fmus.compliance.examine import examine
from fmus.compliance.rule import all_rules, of_version
from fmus.generate import builder
from tests.mutants.mutant import broken_rules as static_broken_rules
from tests.shared_builds import KINDS, Fmus, slow_but

from .archives import PYTHONFMU_ERRORS, broken_rules

OURS = "L1DepthController"  # of all types
WITHOUT_A_STATE_OR_AN_INPUT = "ThrustAllocation", "WaveSource"


@pytest.mark.parametrize("name", slow_but([OURS], builder.block_names()))
def test_our_native_fmus_break_no_rule(built: Fmus, name: str) -> None:
    assert broken_rules(built[name]) == {}


@pytest.mark.parametrize("name", WITHOUT_A_STATE_OR_AN_INPUT)
def test_the_files_of_our_native_fmus_break_no_rule(built: Fmus, name: str) -> None:
    assert static_broken_rules(built[name]) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_our_python_fmus_break_what_the_binary_of_pythonfmu_breaks_and_are_judged_to_the_end(
    python_built: Fmus, name: str
) -> None:
    results = examine(python_built[name])
    assert [r.rule.name for r in results] == [rule.name for rule in of_version(all_rules(), 2)]
    assert {r.rule.name for r in results if r.outcome == "error"} == PYTHONFMU_ERRORS


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x05\x06" + bytes(18)])
def test_garbage_is_a_finding_and_never_a_crash(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "garbage.fmu"
    path.write_bytes(content)
    assert {r.rule.name for r in examine(path) if r.messages} & {"archive-is-zip", "archive-has-description"}
