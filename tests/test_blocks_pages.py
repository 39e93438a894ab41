"""The pages on blocks show the code as it is."""

import runpy
from pathlib import Path

from fmus.block.block_file import write_new_block

from .page_examples import examples

ROOT = Path(__file__).parent.parent


def test_the_reference_of_blocks_is_what_the_code_gives() -> None:
    """Printed by `python .ci/blocks_page.py`."""
    page = runpy.run_path(str(ROOT / ".ci" / "blocks_page.py"))["page"]()
    assert (ROOT / "docs" / "reference" / "blocks.md").read_text(encoding="utf-8") == page


def test_the_reference_of_controllers_is_what_the_code_gives() -> None:
    """Printed by `python .ci/controllers_page.py`."""
    page = runpy.run_path(str(ROOT / ".ci" / "controllers_page.py"))["page"]()
    assert (ROOT / "docs" / "reference" / "controllers.md").read_text(encoding="utf-8") == page


def test_the_tutorial_shows_the_block_that_new_writes(tmp_path: Path) -> None:
    shown = examples(ROOT / "docs" / "tutorials" / "your-own-controller.md")
    (block,) = [example.code for example in shown if example.file == "pid.py"]
    assert block == "# pid.py\n" + write_new_block("pid", tmp_path)[0].read_text(encoding="utf-8")
