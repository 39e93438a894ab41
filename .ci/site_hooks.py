"""What the site holds beside the pages of docs/: files that the project's programs make during its build."""

import functools
import os
import re
import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

sys.path.insert(0, str(Path(__file__).parent.parent))  # mkdocs loads this file alone
sys.path.insert(0, str(Path(__file__).parent))
import downloads

from fmus.files import write_archive

ROOT = Path(__file__).parent.parent
GALLERY = sorted((ROOT / "docs" / "gallery").glob("*.py"))

_KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}

Contents = dict[str, str | bytes]

# of the home page; a clone has neither the live page nor the archives
_OF_THE_SITE = """
Downloads: [all FMUs](downloads/fmus.zip) for all platforms, the closed loop as an
[SSP package](downloads/ssp.zip).

The experiment above, compiled to WebAssembly; a slider starts new runs
([more](reference/live.md), [the page alone](live.html)).

<iframe src="live.html" title="The nominal experiment with sliders" loading="lazy"
style="width: 100%; height: 56rem; border: 0"></iframe>
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, figures and downloads."""
    for path, content in _generated().items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to files that the site has elsewhere there, and show on the home page what it alone has.

    The gallery's list leads to its pages, which show what the scripts print and draw.
    """
    if page.url.startswith("gallery/"):
        markdown = re.sub(r"\]\((\w+)\.py\)", r"](\1.md)", markdown)
    markdown = markdown.replace("](../../orchestration/scenarios/", "](../downloads/")
    return markdown + _OF_THE_SITE if page.is_homepage else markdown


@functools.cache  # once, when `mkdocs serve` builds again and again
def _generated() -> Contents:
    with tempfile.TemporaryDirectory() as folder:
        working = Path(folder)
        return {
            **_downloads(working),
            **_schemas(),
            **_gallery(working),
            **_live(working),
            **_names(),
        }


def _downloads(working: Path) -> Contents:
    """downloads/KIND.zip of each kind, made here or found in the folder that L1_DEPTH_DOWNLOADS names."""
    made = os.environ.get("L1_DEPTH_DOWNLOADS")
    folder = Path(made) if made else working / "made"
    if not made:
        downloads.make(folder)
    return {f"downloads/{kind}.zip": _zipped(folder / kind, working) for kind in downloads.KINDS}


def _schemas() -> Contents:
    """downloads/NAME.schema.json of the files that editors check."""
    folder = ROOT / "orchestration" / "scenarios"
    return {f"downloads/{path.name}": path.read_bytes() for path in folder.glob("*.schema.json")}


def _zipped(folder: Path, working: Path) -> bytes:
    members = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    contents = {name: path.read_bytes() for name, path in members.items()}
    return write_archive(working / f"{folder.name}.zip", contents).read_bytes()


def _gallery(working: Path) -> Contents:
    """gallery/NAME.md and gallery/NAME.ipynb of each script, its pictures, and the page that lists them."""
    downloads.run("l1-depth", "build", "--cache", folder=working)
    downloads.run("l1-depth", "build", "L1DepthController", "RovDepthPlant", folder=working)
    contents: Contents = {}
    for script in GALLERY:
        name, notebook = script.stem, executed(script, working)
        contents[f"gallery/{name}.ipynb"] = nbformat.writes(notebook)
        page, resources = MarkdownExporter().from_notebook_node(notebook, {"unique_key": name})
        heading = notebook.cells[0].source.partition("\n\n")[0]
        title = heading.removeprefix("# ")
        link = f"[The notebook]({name}.ipynb) is `docs/gallery/{name}.py`."
        page = page.replace(f"{heading}\n", f"{heading}\n\n{link}\n", 1)
        contents[f"gallery/{name}.md"] = page.replace("![png]", f"![{title}]")
        contents |= {f"gallery/{picture}": data for picture, data in resources["outputs"].items()}
    return contents


def executed(script: Path, folder: Path) -> nbformat.NotebookNode:
    """Returns a script of the gallery as a notebook, with the outputs of its cells, which ran in a folder."""
    notebook = jupytext.read(script)
    notebook.metadata = nbformat.from_dict({"kernelspec": _KERNEL})
    for number, cell in enumerate(notebook.cells):
        cell.id = str(number)  # by default random; the site has the same bytes each time
    environment = os.environ | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    return NotebookClient(
        notebook,
        timeout=300,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
        extra_arguments=["--log-level=ERROR"],
    ).execute(env=environment)


def _live(working: Path) -> Contents:
    """live.html, which the home page embeds."""
    downloads.run("l1-depth", "live", "nominal-extended", folder=working)
    return {"live.html": (working / "live.html").read_bytes()}


def _names() -> Contents:
    """The page of every public name of `orchestration` and of its studies."""
    import orchestration
    from orchestration import studies

    head = (
        "# Python: systems and runs\n\nEvery name that `from orchestration import NAME` gives, and those "
        "of `orchestration.studies`. [A tutorial](../../tutorials/your-own-fmus.md) shows them at work.\n"
    )
    short = "    options: {show_root_full_path: false}\n"
    known = [*sorted(orchestration.__all__), *(f"studies.{name}" for name in studies.__all__)]
    names = [f"::: orchestration.{name}\n{short}" for name in known]
    return {"reference/api/orchestration.md": "\n".join([head, *names])}
