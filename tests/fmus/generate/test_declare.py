"""A mistake in the declaration of a block is one sentence with file, line, class and variable."""

import tomllib
from pathlib import Path

import pytest

from fmus.errors import ExportError
from fmus.generate import builder

CASES = tomllib.loads(Path(__file__).with_name("declaration.toml").read_text(encoding="utf-8"))
BLOCK: str = CASES["block"]


@pytest.mark.parametrize(("right", "wrong", "message"), CASES["mistakes"])
def test_a_mistake_is_named_with_the_line_of_the_file(
    right: str, wrong: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "lag.py"
    text = BLOCK.replace(right, wrong)
    path.write_text(text, encoding="utf-8")
    before = text.partition(wrong)[0]
    starts = [before, before.rpartition("\ndef ")[0] + "\n", before.rpartition("\nLAG")[0] + "\n"]
    lines = {start.count("\n") + 1 for start in starts}  # of the mistake, its function or its block
    with pytest.raises(ExportError) as refused, builder.loaded(str(path)):
        pass
    assert message in str(refused.value)
    assert any(f"{path}:{line}: " in str(refused.value) for line in lines), str(refused.value)


def test_the_block_without_a_mistake_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "lag.py"
    path.write_text(BLOCK)
    with builder.loaded(str(path)) as (traced,):
        assert traced.block.name == "Lag"


def test_a_step_size_may_be_a_whole_number_of_seconds(tmp_path: Path) -> None:
    path = tmp_path / "lag.py"
    path.write_text(BLOCK.replace('"A lag"', '"A lag", step_size=1'))
    with builder.loaded(str(path)) as (traced,):
        assert {v.name: v.start for v in traced.block.variables}["internal_step"] == 1.0
