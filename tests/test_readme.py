"""What the README shows runs as it stands."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_first_program_is_the_script_without_its_figure() -> None:
    """Which tests/orchestration/test_fmpy_master.py runs."""
    script = (ROOT / "docs" / "gallery" / "fmpy_master.py").read_text(encoding="utf-8")
    program = README.partition("```python\n")[2].partition("```")[0]
    assert (
        program.split()
        == "".join(
            line
            for cell in script.split("# %%\n")[1:3]
            for line in cell.splitlines(keepends=True)
            if "matplotlib" not in line
        ).split()
    )


def test_it_has_at_most_110_lines() -> None:
    assert 80 < len(README.splitlines()) <= 110


@pytest.mark.parametrize(
    "command", ["pip install -e '.[all]' && l1-depth reproduce", "pip install -e '.[test]' && pytest"]
)
def test_the_two_set_up_commands_are_there(command: str) -> None:
    assert f"```sh\n{command}\n```" in README
