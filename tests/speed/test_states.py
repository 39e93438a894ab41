"""What compares states of this project; no time is a pass or a fail."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from orchestration.errors import OrchestrationError
from tests.speed.programs import C_SOURCES, compile_program
from tests.speed.states import ROOT, state
from tests.speed.steps import compared


@pytest.mark.slow
def test_steps_of_a_build_beside_itself_are_equal(built: Mapping[str, Path], tmp_path: Path) -> None:
    compile_program(tmp_path, "steps", [str(C_SOURCES / "steps.c")], includes=[])
    folder = built["ExamplePlant"].parent
    steps = compared("ExamplePlant", folder, folder, tmp_path, count=100, rounds=3)
    assert steps.are_equal
    assert len(steps.old) == len(steps.new) == 3
    assert min(*steps.old, *steps.new) > 0.0


def test_a_state_is_a_clone_or_a_revision(tmp_path: Path) -> None:
    assert state(str(ROOT), tmp_path / "clone").sources == ROOT
    with pytest.raises(OrchestrationError, match=r"no-such-revision: .*: expected a revision or a clone"):
        state("no-such-revision", tmp_path / "none")
