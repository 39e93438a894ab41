"""Block -> the folder `documentation` of its FMU: a page that works offline, derived from the declaration."""

import re
from collections.abc import Iterable
from html import escape
from importlib import resources
from importlib.metadata import distributions, version
from string import Template

from fmus.block import Block
from fmus.block.guide import Source
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.native.toolchain import COMPILER, FMI_HEADERS

# name -> (installed project, file of its metadata, what the licence is for)
_LICENSES = {
    "l1-depth": (
        "l1-depth",
        "LICENSE",
        "what makes an FMU of the model and its documentation, and models that come with l1-depth",
    ),
    "fmi-headers": ("fmpy", "", "headers that the libraries are compiled with, of the Modelica Association"),
    "zig": (COMPILER[0], "ziglang/LICENSE", "what its compiler adds to the libraries"),
    "mingw-w64": (COMPILER[0], "ziglang/lib/libc/mingw/COPYING", "what it adds to the library for Windows"),
    "pythonfmu": ("pythonfmu", "LICENSE", "the libraries, and the package of that name in resources"),
}
_TABLES = (
    ("input", "Inputs"),
    ("output", "Outputs"),
    ("parameter", "Parameters"),
    ("calculatedParameter", "Calculated parameters, which follow from the parameters"),
)
_BUILDING = """<li>For another platform compile sources/{file} with the headers of FMI {fmi}.0, which belong
to the importer; FMI{fmi}_OVERRIDE_FUNCTION_PREFIX gives functions the names that a shared library has:
<code>cc -std=c99 -O2 -shared -fPIC -DFMI{fmi}_OVERRIDE_FUNCTION_PREFIX -I HEADERS -o {name}.so
sources/{file} -lm</code></li>"""
_HEADINGS = ("Name", "Unit or type", "Start", "Permitted", "Variability", "Meaning", "Source")


def documentation(
    block: Block, compiled: str = "", reals_only: bool = False, fmi: int = 2
) -> dict[str, bytes]:
    """Returns path inside the FMU -> content of the page and of the note on the reference results.

    compiled: the file of the folder sources that an importer compiles, if there is one
    reals_only: whether every variable is a Real
    fmi: the version of the standard
    """
    templates, experiment = resources.files("fmus.generate.documentation"), block.guide.experiment
    files = {"index.html": "page.html", "fmi-ls-ref.txt": "fmi-ls-ref.txt"}
    values = {
        "fmi": fmi,
        "interfaces": "co-simulation and model exchange" if compiled else "co-simulation",
        "name": escape(block.name),
        "description": escape(block.description),
        "release": escape(version("l1-depth")),
        "stop_time": block.stop_time,
        "step_size": block.step_size,
        "guide": _guide(block),
        "building": _BUILDING.format(file=compiled, name=block.name, fmi=fmi) if compiled else "",
        "variables": "\n".join(_tables(block, reals_only)),
        "reference_stop_time": experiment.stop_time or block.stop_time,
        "reference_step_size": experiment.step_size or block.step_size,
        "stimuli": _stimuli(block),
        "sources": _list(map(_source, block.guide.sources)),
    }
    return {
        f"documentation/{file}": Template((templates / template).read_text("utf-8"))
        .substitute(values)
        .encode()
        for file, template in files.items()
    }


def _guide(block: Block) -> str:
    """Returns the sections that the guide fills."""
    guide = block.guide
    sections = {
        "Equations": f"<pre>{escape(guide.equations.strip())}</pre>" if guide.equations else "",
        "Sign conventions": _list(map(escape, guide.conventions)),
        "Tuning": _list(map(escape, guide.tuning)),
        "Limits": _list(map(escape, guide.limits)),
    }
    return "\n".join(f"<h2>{title}</h2>\n{text}" for title, text in sections.items() if text)


def _list(items: Iterable[str]) -> str:
    """Returns an HTML list of items that are HTML already; nothing for none."""
    entries = "\n".join(f"<li>{item}</li>" for item in items)
    return f"<ul>\n{entries}\n</ul>" if entries else ""


def _source(source: Source) -> str:
    text = escape(source.text)
    return f'<a href="{escape(source.url)}">{text}</a>' if source.url else text


def _tables(block: Block, reals_only: bool) -> Iterable[str]:
    for causality, caption in _TABLES:
        if variables := block.of_causality(causality):
            yield _table(caption, _HEADINGS, (_cells(v, reals_only) for v in variables))


def _cells(v: BlockVariable, reals_only: bool) -> tuple[str, ...]:
    """Returns one row: what `_HEADINGS` says, as text."""
    kind = "whole number" if reals_only else v.type.lower()
    unit = kind if v.unit is None else v.unit
    number = str(v.start).lower() if isinstance(v.start, bool) else repr(v.cast(v.start).real)
    start, permitted = (number, v.expected.removesuffix(f" {v.unit}")) if v.settable else ("", "")
    return v.name, unit, start, permitted, v.variability, v.description, v.source


def _stimuli(block: Block) -> str:
    """Returns the table of the inputs that move during the reference experiment."""
    rows = [
        (name, ", ".join(f"{value} at {time} s" for time, value in points))
        for name, points in block.guide.experiment.stimuli
    ]
    headings = ("Input", "Straight lines through")
    return _table("What moves; every other input keeps its start value", headings, rows) if rows else ""


def _table(caption: str, headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(x)}</td>" for x in row) + "</tr>" for row in rows)
    return (
        f'<div class="scroll"><table>\n<caption>{escape(caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def licenses(*names: str, fmi: int = 2) -> dict[str, bytes]:
    """Returns path inside the FMU -> licence, and the file of FMI that says what each is for.

    fmi: the version of the standard, of whose headers the licence is
    """
    entry_point = "".join(f"{name}.txt: {_LICENSES[name][2]}\n" for name in names)
    texts = {"license": entry_point} | {name: _license(*_LICENSES[name][:2], fmi) for name in names}
    return {f"documentation/licenses/{name}.txt": text.encode() for name, text in texts.items()}


def _license(project: str, file: str, fmi: int) -> str:
    if file:  # a clone's own .egg-info, found first where it is the working directory, has no licence
        texts = (distribution.read_text(f"licenses/{file}") for distribution in distributions(name=project))
        text = next(filter(None, texts), "")
        if not text:
            raise ExportError(
                f"the installed {project} has no {file} among its licences, which an FMU must carry: "
                f"expected it as pip installs it (pip install --force-reinstall {project})"
            )
        return text
    header = (FMI_HEADERS / f"fmi{fmi}Functions.h").read_text("utf-8")
    return "".join(re.findall(r"Copyright.*?(?=\*/)", header, re.DOTALL)[:1])
