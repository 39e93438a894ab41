"""Tests of the runner of the pages' examples: it fails if a page is wrong."""

import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from .page_examples import examples, run

Page = Callable[[str], Path]


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Page:
    """Writes a tutorial with a text; ''' stands for the fence. Its folder becomes the current folder."""
    folder = tmp_path / "tutorials"
    folder.mkdir()
    monkeypatch.chdir(folder)

    def written(text: str) -> Path:
        path = folder / "page.md"
        path.write_text(textwrap.dedent(text).replace("'''", "```"), encoding="utf-8")
        return path

    return written


GOOD = """
    '''python
    x = 20
    '''
    '''toml
    # deep/one.toml
    a = 1
    '''
    '''sh
    cat deep/one.toml
    '''
    '''text
    # deep/one.toml
    a = 1
    '''
    '''python
    print("depth", x + 1, "m of a lot")
    '''
    '''text
    depth 21 m ...
    '''
"""


def test_a_page_that_is_right_runs(page: Page) -> None:
    run(page(GOOD))


@pytest.mark.parametrize(
    ("right", "wrong", "complaint"),
    [
        ("depth 21 m", "depth 22 m", r"page.md:20: expected\ndepth 22 m"),
        ("cat deep", "cat shallow", r"page.md:10: exit status 1"),
        ("cat deep/one.toml", "cat no | sort", r"exit status 1"),
        ("# deep/one.toml\n    a = 1\n    '''\n    '''sh", "a = 1\n    '''\n    '''sh", "toml can neither"),
    ],
)
def test_a_page_that_is_wrong_does_not(page: Page, right: str, wrong: str, complaint: str) -> None:
    assert right in GOOD
    with pytest.raises(AssertionError, match=complaint):
        run(page(GOOD.replace(right, wrong)))


LINKS = """
    [code](deep/one.c), [page](other.md), [above](../two.c), [away](https://example.org/three.c)

    '''sh
    test "$(ls deep)" = one.c
    '''
"""


def test_a_file_to_which_the_page_links_is_saved(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = page(LINKS)
    (path.parent / "deep").mkdir()
    (path.parent / "deep" / "one.c").write_text("int one;\n")
    (folder := tmp_path / "reader").mkdir()
    monkeypatch.chdir(folder)
    run(path)
    assert [name.name for name in folder.iterdir()] == ["deep"]


def test_an_error_tells_the_line_of_the_page(page: Page) -> None:
    with pytest.raises(NameError) as error:
        run(page(GOOD.replace("x + 1", "y + 1")))
    assert error.traceback[-1].lineno + 1 == 17  # pytest counts from 0


def test_output_without_an_example_is_refused(page: Page) -> None:
    with pytest.raises(AssertionError, match="no example before"):
        run(page("'''text\n1\n'''\n"))


def test_on_other_pages_only_what_is_marked_runs_and_its_output_is_compared(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    unmarked, marked = (
        "```sh\nfalse\n```\n```text\n1\n```\n",
        "<!-- run -->\n```sh\ntrue\n```\n```text\n2\n```\n",
    )
    path.write_text(unmarked + marked + unmarked, encoding="utf-8")
    assert [example.code for example in examples(path)] == ["true\n", "2\n"]
