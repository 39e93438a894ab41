"""Tests of the site of docs/ and of the archive for users without Python, each made by one command."""

import hashlib
import html
import json
import re
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from fmus.platforms import PLATFORMS
from tests.shared_builds import built_once, session_folder

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / ".ci"))
import downloads  # noqa: E402  # pyright: ignore[reportMissingImports]
import release  # noqa: E402  # pyright: ignore[reportMissingImports]

# of the scenario in the archive; all blocks would take minutes
BLOCKS = ("L1DepthController", "RovDepthPlant")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked archive, of two blocks in place of all.

    A broken link of its site fails here, as does a notebook that fails.
    """
    folder = session_folder(tmp_path_factory, "release")
    run = downloads.run

    def run_for_two(*command: str, **options: Any) -> list[str]:
        return run(*command, *(BLOCKS if command[-1] == "--all-platforms" else ()), **options)

    def make(path: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(downloads, "run", run_for_two)
            release.write(path)
        with zipfile.ZipFile(path) as packed:
            packed.extractall(folder)

    built_once(folder / "l1-depth.zip", make)
    return folder / "l1-depth"


def test_the_archive_holds_fmus_for_all_platforms(archive: Path) -> None:
    assert {path.stem for path in (archive / "fmus").iterdir()} == {*BLOCKS}
    for path in (archive / "fmus").iterdir():
        with zipfile.ZipFile(path) as fmu:
            folders = {Path(name).parts[1] for name in fmu.namelist() if name.startswith("binaries/")}
        assert folders == set(PLATFORMS)


def test_the_archive_holds_what_each_tool_reads(archive: Path) -> None:
    for name in ("ssp/nominal-extended.ssp", "documentation/index.html", "LICENSE"):
        assert (archive / name).stat().st_size > 0
    assert version("l1-depth") in (archive / "README.txt").read_text(encoding="utf-8")


def test_the_checksums_are_those_of_all_files(archive: Path) -> None:
    lines = (archive / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    listed = {name: checksum for checksum, name in (line.split("  ", 1) for line in lines)}
    files = {path.relative_to(archive).as_posix(): path for path in archive.rglob("*") if path.is_file()}
    assert listed.keys() == files.keys() - {"SHA256SUMS"}
    assert all(hashlib.sha256(files[name].read_bytes()).hexdigest() == listed[name] for name in listed)


def test_the_gallery_has_seven_notebooks_that_ran(archive: Path) -> None:
    """Each page shows what the notebook beside it printed and drew."""
    notebooks = sorted((archive / "documentation" / "gallery").glob("*.ipynb"))
    assert [path.stem for path in notebooks] == sorted(
        path.stem for path in (ROOT / "docs" / "gallery").glob("*.py")
    )
    assert len(notebooks) == 7
    for path in notebooks:
        cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if "outputs" in cell]
        assert [cell["execution_count"] for cell in cells] == [*range(1, len(cells) + 1)]
        outputs = [output for cell in cells for output in cell["outputs"]]
        page = html.unescape(path.with_suffix(".html").read_text(encoding="utf-8"))
        assert f'href="{path.name}"' in page
        assert sum("image/png" in output.get("data", {}) for output in outputs) == len(
            re.findall(rf'<img [^>]*src="{path.stem}_\d+_\d+\.png"', page)
        )
        printed = "".join("".join(output.get("text", "")) for output in outputs)
        assert printed
        assert all(line in page for line in printed.splitlines())
        if path.stem == "lqg":
            extended, tuned, lqg = map(float, re.findall(r"RMSE (\S+) cm", printed))
            assert tuned < lqg < 1.0 < extended


def test_the_site_loads_nothing_from_another_server(archive: Path) -> None:
    for page in (archive / "documentation").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\ssrc=\"?([^\s\">]+)", text)
        loaded += re.findall(r"<link[^>]*\shref=\"?([^\s\">]+)", text)
        assert loaded
        assert not [address for address in loaded if re.match(r"(https?:)?//", address)]


def test_the_pages_of_python_have_each_argument_as_an_item(archive: Path) -> None:
    """As a table of NumPy's sections, or as a list; Markdown would run the lines of a list together."""
    folder = archive / "documentation" / "reference" / "api"
    pages = {path.stem: path.read_text(encoding="utf-8") for path in folder.glob("*.html")}
    text = " ".join(pages["orchestration"].split())
    assert re.search(r"<code>step_sizes</code>.{0,900}its own step size \[s\]", text)
    assert re.search(r"<code>progress</code>.{0,900}Called with the number of samples", text)
    assert re.search(r"<code>standard_deviation</code>.{0,900}Standard deviation of the signal", text)
    assert not [name for name, text in pages.items() if "<details" in text]


def test_the_page_of_commands_has_whole_sentences_and_no_types_of_python(archive: Path) -> None:
    page = (archive / "documentation" / "reference" / "commands.html").read_text(encoding="utf-8")
    assert not re.findall(r"\.\.\.</li>", page)
    assert "[default: one for each core; x&gt;=1]" in page
    assert not re.findall(r"list\[|&lt;(?:str|path|int|float)\b", page)
