"""What the pages in docs/ show and claim: links lead somewhere, marked examples run, named tests exist."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs").rglob("*.md"))
TOOL_PAGES = [page for page in (ROOT / "docs" / "importing").glob("*.md") if page.name != "README.md"]
EXAMPLE = re.compile(r"<!-- run -->\n```(\w+)\n(.*?)```", re.DOTALL)


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT / "docs"))


def _anchors(page: Path) -> set[str]:
    """As GitHub makes them of headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_every_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith("http"):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in _anchors(target), link


@pytest.mark.parametrize("page", TOOL_PAGES, ids=_name)
def test_a_page_says_what_was_tested_and_what_was_not(page: Path) -> None:
    """Every claim of a test names a file that exists, or says that nothing was tested."""
    text = page.read_text(encoding="utf-8")
    (tested,) = re.findall(r"^## Tested here\n(.*?)^## Not tested\n", text, re.M | re.DOTALL)
    claims = [each for each in re.split(r"^- ", tested, flags=re.M)[1:] if not each.startswith("Nothing")]
    for claim in claims:
        named = re.findall(r"`(tests/\S+?\.py)`", claim)
        assert named, claim
        assert all((ROOT / path).is_file() for path in named), claim
    assert re.search(r"^## Not tested\n\n- \S", text, re.M)


def test_the_index_lists_every_page() -> None:
    index = (ROOT / "docs" / "importing" / "README.md").read_text(encoding="utf-8")
    assert {page.name for page in TOOL_PAGES} == set(re.findall(r"^\| .*?\((\S+\.md)\)", index, re.M))


@pytest.mark.parametrize("page", [p for p in PAGES if EXAMPLE.search(p.read_text("utf-8"))], ids=_name)
def test_the_marked_examples_run(page: Path, tmp_path: Path) -> None:
    """In their order, in one folder."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    for language, code in EXAMPLE.findall(page.read_text(encoding="utf-8")):
        command = {"sh": ["bash", "-ec", code], "python": [sys.executable, "-c", code]}[language]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=300
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stdout


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_every_command_shown_exists(page: Path) -> None:
    help_text = subprocess.run(
        [sys.executable, "-c", "from orchestration.cli import main; main()", "--help"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    shown = re.findall(r"(?:^ {4}|^|`)l1-depth (\w+)", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert set(shown) <= set(re.findall(r"\w+", help_text))
