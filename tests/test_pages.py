"""The pages that .ci/pages.py writes say what the code and the results say."""

import runpy
from pathlib import Path

import pytest

from .page_text import own_pages

ROOT = Path(__file__).parents[1]
PROGRAM = runpy.run_path(str(ROOT / ".ci" / "pages.py"))
REMEDY = "python .ci/pages.py writes it anew"


# what Typer prints changes with its version
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if "commands" in n else []) for n in PROGRAM["PAGES"]],
)
def test_a_page_says_what_the_code_says(name: str) -> None:
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert text == PROGRAM["WRITTEN"] + PROGRAM["PAGES"][name](), REMEDY


def test_only_pages_that_are_written_say_so() -> None:
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    own = {path.relative_to(ROOT / "docs").as_posix() for path in own_pages(ROOT / "docs")}
    captions = {f"explanation/figure_{number}.md" for number in (3, 5, 6)}
    assert pages - own == {*PROGRAM["PAGES"]} | captions


def test_tables_of_results_are_in_the_pages() -> None:
    pages = [*PROGRAM["pages_with_tables"]()]
    assert len(pages) >= 4
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert PROGRAM["with_tables"](text) == text, f"{path}: {REMEDY}"


def test_a_table_takes_the_place_of_an_older_one() -> None:
    page = "# Page\n\n<!-- speed: machine -->\n\n| old |\n| --- |\n\nText.\n"
    once = PROGRAM["with_tables"](page)
    assert "| old |" not in once
    assert once.endswith("|\n\nText.\n")
    assert PROGRAM["with_tables"](once) == once
