"""Block -> the folder `documentation` of its FMU: a page that works offline, derived from the declaration."""

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from importlib.metadata import distributions, version
from string import Template

from fmus.block import Block
from fmus.block.guide import Source
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError, number_text
from fmus.generate.documentation.mathml import equations_table
from fmus.generate.documentation.wiring import Connection, connections, declared_variables, diagram
from fmus.native.toolchain import COMPILER, FMI_HEADERS

# name -> (installed project, file of its metadata, parts of the FMU under this licence)
_LICENSES = {
    "l1-depth": (
        "l1-depth",
        "LICENSE",
        "the layer around the model, the documentation, and models that come with l1-depth",
    ),
    "fmi-headers": ("fmpy", "", "headers that the libraries are compiled with, of the Modelica Association"),
    "zig": (COMPILER[0], "ziglang/LICENSE", "code that its compiler adds to the libraries"),
    "mingw-w64": (
        COMPILER[0],
        "ziglang/lib/libc/mingw/COPYING",
        "code that it adds to the library for Windows",
    ),
    "pythonfmu": ("pythonfmu", "LICENSE", "the libraries, and the package of that name in resources"),
}
_SIGNALS = {
    "input": "Inputs",
    "output": "Outputs",
    "calculatedParameter": "Calculated parameters, which follow from the parameters",
}
_ARRAYS = {
    2: "name[1..2] stands for name[1] and name[2], m[1..2,1..2] for m[1,1], m[1,2], m[2,1] and m[2,2].",
    3: "name[1..2] stands for the array name with two elements, m[1..2,1..2] for an array with two rows.",
}
_EXCHANGE = "<tr><td>Model exchange</td><td>{}</td></tr>"
_PATHS = "<p>Paths that begin with docs/ are in the repository of l1-depth.</p>"
_BUILDING = """<li>For another platform compile sources/{file} with the importer's headers of FMI {fmi}.0;
FMI{fmi}_OVERRIDE_FUNCTION_PREFIX exports the functions without a prefix:
<code>cc -std=c99 -O2 -shared -fPIC -DFMI{fmi}_OVERRIDE_FUNCTION_PREFIX -I HEADERS -o {name}.so
sources/{file} -lm</code></li>"""
_HEADINGS = ("Name", "Meaning", "Unit or type", "Start", "Permitted", "Variability", "Source")
_CONNECTED = ("Variable here", "Direction", "Variable there", "FMU there (one of these)")


def documentation(
    block: Block, compiled: str = "", reals_only: bool = False, fmi: int = 2, scalars: bool = False
) -> dict[str, bytes]:
    """Returns path inside the FMU -> content of the page and of the note on the reference results.

    compiled: the file of the folder sources that an importer compiles, if there is one
    reals_only: whether every variable is a Real
    fmi: the version of the standard
    scalars: whether the elements of arrays are variables of FMI 3.0
    """
    templates, experiment = resources.files("fmus.generate.documentation"), block.guide.experiment
    files = {"index.html": "page.html", "fmi-ls-ref.txt": "fmi-ls-ref.txt"}
    connected = connections(block)
    values = {
        "fmi": fmi,
        "interfaces": "co-simulation and model exchange" if compiled else "co-simulation",
        "exchange": _exchange(block) if compiled else "",
        "name": escape(block.name),
        "description": escape(block.description),
        "release": escape(version("l1-depth")),
        "stop_time": number_text(block.stop_time),
        "step_size": number_text(block.step_size),
        "diagram": diagram(block, connected),
        "wiring": _wiring(block, connected),
        "parameters": _parameters(block, reals_only),
        "signals": "\n".join(_signals(block, reals_only)),
        "guide": _guide(block),
        "arrays": _ARRAYS[2 if scalars else fmi],
        "building": _BUILDING.format(file=compiled, name=block.name, fmi=fmi) if compiled else "",
        "reference_stop_time": number_text(experiment.stop_time or block.stop_time),
        "reference_step_size": number_text(experiment.step_size or block.step_size),
        "stimuli": _stimuli(block),
        "sources": _list(map(_source, block.guide.sources)),
    }
    is_path_named = any("docs/" in text for text in map(str, values.values()))
    values["paths"] = _PATHS if is_path_named else ""
    return {
        f"documentation/{file}": Template((templates / template).read_text("utf-8"))
        .substitute(values)
        .encode()
        for file, template in files.items()
    }


def _guide(block: Block) -> str:
    """Returns the sections that the guide fills, without the advice on parameters."""
    guide = block.guide
    sections = {
        "Equations": equations_table(guide.equations) if guide.equations.strip() else "",
        "Sign conventions": _list(map(escape, guide.conventions)),
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


def _exchange(block: Block) -> str:
    # half of them are derivatives
    states = len(block.states) // 2
    integrated = f"The importer integrates the continuous states ({states})."
    return _EXCHANGE.format(integrated if states else "The importer calls the FMU at its time events.")


def _wiring(block: Block, connected: Sequence[Connection]) -> str:
    """Returns the section on connections; nothing for a block that fits no other one."""
    if not connected:
        return ""
    ways = {True: "comes from", False: "goes to"}
    rows = [(one.own, ways[one.is_input], one.other, ", ".join(one.fmus)) for one in connected]
    table = _table(f"Connect {block.name} as follows", _CONNECTED, rows)
    rest = "<p>Unconnected inputs keep their start values.</p>"
    return f"<h2>Connections with other FMUs</h2>\n{table}\n{rest}"


def _parameters(block: Block, reals_only: bool) -> str:
    """Returns two tables: the parameters that the advice names, in its order, then the others."""
    words: list[str] = re.findall(r"\w+", " ".join(block.guide.tuning))
    parameters = declared_variables(block.of_causality("parameter"))
    places = {name: name.partition("[")[0] for name in parameters}
    places = {name: words.index(plain) for name, plain in places.items() if plain in words}
    first = sorted(places, key=places.__getitem__)
    others = [name for name in parameters if name not in places]
    tables = {"Parameters in the order above": first, "Other parameters" if first else "Parameters": others}
    parts = [_list(map(escape, block.guide.tuning))]
    for caption, names in tables.items():
        if names:
            rows = (_cells(name, parameters[name], reals_only) for name in names)
            parts.append(_table(caption, _HEADINGS, rows))
    return "\n".join(parts)


def _signals(block: Block, reals_only: bool) -> Iterable[str]:
    for causality, caption in _SIGNALS.items():
        if variables := declared_variables(block.of_causality(causality)):
            rows = (_cells(name, scalars, reals_only) for name, scalars in variables.items())
            yield _table(caption, _HEADINGS, rows)


def _cells(name: str, scalars: list[BlockVariable], reals_only: bool) -> tuple[str, ...]:
    """Returns one row as text; a cell lists the values of the elements of an array if they differ."""
    columns = [list(column) for column in zip(*(_texts(v, reals_only) for v in scalars), strict=True)]
    return name, *(", ".join(texts if len({*texts}) > 1 else texts[:1]) for texts in columns)


def _texts(v: BlockVariable, reals_only: bool) -> tuple[str, ...]:
    kind = "whole number" if reals_only else v.type.lower()
    unit = kind if v.unit is None else v.unit
    number = str(v.start).lower() if isinstance(v.start, bool) else f"{v.cast(v.start).real:.12g}"
    # the table has a column for the unit; a unit "1" is not in the text
    expected = v.expected if unit == "1" else v.expected.removesuffix(f" {unit}").removesuffix(" in")
    start, permitted = (number, expected) if v.settable else ("", "")
    return v.description, unit, start, permitted, v.variability, v.source


def _stimuli(block: Block) -> str:
    """Returns the table of the inputs that move during the reference experiment."""
    rows = [
        (name, ", ".join(f"{number_text(value)} at {number_text(time)} s" for time, value in points))
        for name, points in block.guide.experiment.stimuli
    ]
    headings = ("Input", "Lines between the points")
    return _table("Inputs that vary; the others keep their start values", headings, rows) if rows else ""


def _table(caption: str, headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    names = [escape(heading) for heading in headings]
    head = "".join(f"<th>{name}</th>" for name in names)
    body = []
    for row in rows:
        # narrow screens show a row as a paragraph, with the headings in it
        cells = (f'<td data-heading="{n}">{escape(text)}</td>' for n, text in zip(names, row, strict=True))
        body.append(f"<tr>{''.join(cells)}</tr>")
    lines = "\n".join(body)
    return (
        f'<div class="scroll"><table class="rows">\n<caption>{escape(caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{lines}\n</tbody>\n</table></div>"
    )


def licenses(*names: str, fmi: int = 2) -> dict[str, bytes]:
    """Returns path inside the FMU -> licence, and the file of FMI that lists the licences.

    fmi: the version of the standard, of whose headers the licence is
    """
    entry_point = "".join(f"{name}.txt: {_LICENSES[name][2]}\n" for name in names)
    texts = {"license": entry_point} | {name: _license(*_LICENSES[name][:2], fmi) for name in names}
    return {f"documentation/licenses/{name}.txt": text.encode() for name, text in texts.items()}


def _license(project: str, file: str, fmi: int) -> str:
    if file:
        # In a clone as the working directory, its .egg-info is found first, which has no licence.
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
