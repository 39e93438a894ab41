"""Writes the pages and figures of docs/ that follow from the code or from results: python .ci/pages.py.

tests/test_pages.py compares the pages with what this program would write.
"""

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "explanation" / "identification"))
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
import blocks_page
import comparison_page
import compatibility_page
import controllers_page
import fmi2_page
import keys_page
import protocol_page
import tables as study
import vehicles_page

from orchestration.cli.explain import markdown_table
from tests.speed import tables as speed

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
_GALLERY = """# Gallery

Scripts that are notebooks: the site shows each with what it prints and draws.
Most need the FMUs of the scenarios, which `l1-depth build --cache` makes.
"""
RESULTS = {
    "speed": "performance.json",
    "study": "explanation/identification.json",
    "survey": "explanation/survey/results.json",
}
_PLACE = re.compile(rf"<!-- ({'|'.join(RESULTS)}): (.*) -->\n(?:\n(?:\|.*\n)+)?")


def commands_page() -> str:
    """Returns the page of all commands and options, from the program itself."""
    command = [sys.executable, "-m", "typer", "orchestration.cli.app", "utils", "docs", "--name", "l1-depth"]
    return of_commands(subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout)


def of_commands(printed: str) -> str:
    """Returns what Typer prints, with whole sentences in its list and without types of Python."""
    page = printed.replace("# `l1-depth`", "# Command line", 1)
    for name, sentence in re.findall(r"^## `l1-depth (\w+)`\n\n(.*)$", page, re.M):
        page = re.sub(rf"^\* `{name}`: .*$", f"* [`{name}`](#l1-depth-{name}): {sentence}", page, flags=re.M)
    page = re.sub(r"^(\* `[^-`<]+) <(?:str|path|list\[\w+\])>`", r"\1`", page, flags=re.M)
    page = re.sub(r" <(?:int|float)(?: range)?>`", " NUMBER`", page).replace(" <str>`", " TEXT`")
    # the default is that of the machine that makes the page
    return re.sub(r"(`--workers NUMBER`: .*\[default: )\d+", r"\1one for each core", page)


def gallery_page() -> str:
    """Returns the list of the scripts of the gallery, each with its first paragraph."""
    entries = []
    for script in sorted((DOCS / "gallery").glob("*.py")):
        lines = script.read_text(encoding="utf-8").partition("# %%\n")[0].splitlines()
        title, *text = (line.removeprefix("#").strip() for line in lines if not line.startswith("# %%"))
        paragraph = "\n".join(text).strip().partition("\n\n")[0]
        entries.append(f"## [{title.removeprefix('# ')}]({script.name})\n\n{paragraph}\n")
    return "\n".join([_GALLERY, *entries])


_COLOURS = 64  # of lines and letters, smoothed
WRITTEN = "<!-- Written by .ci/pages.py: change what it reads. -->\n\n"
PAGES: Mapping[str, Callable[[], str]] = {
    "explanation/comparison.md": comparison_page.page,
    "gallery/README.md": gallery_page,
    "reference/blocks.md": blocks_page.page,
    "reference/commands.md": commands_page,
    "reference/compatibility.md": compatibility_page.page,
    "reference/controllers.md": controllers_page.page,
    "reference/fmi2.md": fmi2_page.page,
    "reference/keys.md": keys_page.page,
    "reference/protocol.md": protocol_page.page,
    "reference/vehicles.md": vehicles_page.page,
}
"""Page, relative to docs/ -> the function that gives its text."""


@cache
def _tables(kind: str) -> dict[str, str]:
    """Returns tables by name, from a file of results."""
    document = json.loads((DOCS / RESULTS[kind]).read_text(encoding="utf-8"))
    if kind == "study":
        return study.tables(document)
    if kind == "speed":
        return {name: speed.markdown(rows) for name, rows in document.items()}
    return {name: markdown_table(head, rows) for name, (head, *rows) in document.items()}


def with_tables(page: str) -> str:
    """Returns a page with each table of results below the comment that names it: <!-- KIND: NAME -->."""

    def filled(place: re.Match[str]) -> str:
        kind, name = place.groups()
        return f"<!-- {kind}: {name} -->\n\n{_tables(kind)[name].strip()}\n"

    return _PLACE.sub(filled, page)


def pages_with_tables() -> Iterator[Path]:
    """Yields the pages that name tables of results."""
    for path in sorted(DOCS.rglob("*.md")):
        if _PLACE.search(path.read_text(encoding="utf-8")):
            yield path


def _write_paper_figures(folder: Path) -> None:
    """Writes figures 3, 5 and 6 of `l1-depth reproduce`, smaller than for print, with their captions."""
    with tempfile.TemporaryDirectory() as results:
        subprocess.run(["l1-depth", "reproduce", "--out", results], check=True, capture_output=True)
        for caption in Path(results).glob("figure_*.md"):
            (folder / caption.name).write_text(
                WRITTEN + caption.read_text(encoding="utf-8"), encoding="utf-8"
            )
            image = Image.open(caption.with_suffix(".png")).convert("RGB")
            smaller = image.resize((image.width * 3 // 5, image.height * 3 // 5), Image.Resampling.LANCZOS)
            smaller.quantize(_COLOURS).save(folder / f"{caption.stem}.png", optimize=True)


def main() -> None:
    """Writes everything."""
    for name, page in PAGES.items():
        (DOCS / name).write_text(WRITTEN + page(), encoding="utf-8")
    comparison_page.figures(DOCS / "explanation")
    _write_paper_figures(DOCS / "explanation")
    for path in pages_with_tables():
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
