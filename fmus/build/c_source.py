"""Block -> the C99 sources of its native FMU: the hand-written layer and what is generated of the block.

`fmi2.c` is the only file to compile. It includes the others, with tables in `model.h` and equations in
`model_code.h`; but `model_lanes.h` has the equations for groups of instances, which an ensemble compiles.
"""

import sys
from importlib import resources
from string import Template

from fmus.block import Block, BlockVariable
from fmus.build.symbolic import Traced, traced
from fmus.errors import ExportError
from fmus.fmi.variable_types import INTEGER_RANGE, TRANSFER_TYPE

COMPILED = ("fmi2.c",)
_WORD = 32  # bits of the set of items


def c_sources(block: Block, guid: str, reals_only: bool = False) -> dict[str, str]:
    """Returns file name -> text of the FMU's folder `sources`: all but FMI's own headers (2.3).

    reals_only: every variable is a Real, what is an item, truth value or Integer one that is a whole number
    Raises ExportError for a block that cannot be traced.
    """
    layer = resources.files("fmus") / "native"
    files = [file for file in layer.iterdir() if file.name.endswith((".c", ".h"))]
    texts = {file.name: file.read_text("utf-8") for file in files}
    template = Template((layer / "model.h.in").read_text("utf-8"))
    functions = traced(block)
    model = template.substitute(_tables(functions, reals_only), guid=guid)
    return texts | {"model.h": model} | functions.c_code()


def _tables(functions: Traced, reals_only: bool) -> dict[str, object]:
    """Returns the values for the placeholders of `model.h.in`."""
    block = functions.block
    not_real = [index for index, v in enumerate(block.of_causality("output")) if v.type != "Real"]
    return {
        "name": block.name,
        "description": " ".join(block.description.split()).replace("*/", "* /"),
        "parameters": len(block.of_causality("parameter")),
        "calculated": len(block.of_causality("calculatedParameter")),
        "inputs": len(block.of_causality("input")),
        "outputs": len(block.of_causality("output")),
        "states": functions.step.numel_out(0),
        "n_whole": len(not_real),
        "whole": ", ".join(map(str, (*not_real, 0))),  # never empty, which C99 has not
        "requirements": len(functions.required),
        "internal_step": next(v.value_reference for v in block.variables if v.name == "internal_step"),
        "variables": ",\n".join(_row(v, reals_only) for v in block.variables),
        "access": ", ".join(_access(v, reals_only) for v in block.variables),
        "required": ",\n".join(f"    {_string(text)}" for text in (*functions.required, "")),
    }


def _row(v: BlockVariable, reals_only: bool) -> str:
    is_converted = reals_only and v.type != "Real"
    items = [0, 1] if is_converted and v.type == "Boolean" else _items(v)
    values = (float(v.start), *_range(v), hex(sum(1 << item for item in items)), int(is_converted))
    cells = (_string(v.name), *values, _string(v.expected))
    return f"    {{{', '.join(map(str, cells))}}}"


def _access(v: BlockVariable, reals_only: bool) -> str:
    settable = "NEVER" if not v.settable else "BEFORE_STEPPING" if v.variability == "fixed" else "ALWAYS"
    return f"{{{'REAL' if reals_only else TRANSFER_TYPE[v.type].upper()}, {settable}}}"


def _range(v: BlockVariable) -> tuple[float, float]:
    """Returns the range that the C layer lets pass: without declared limits, that of the type."""
    if items := [0, 1] if v.type == "Boolean" else _items(v):
        return float(min(items)), float(max(items))
    widest = INTEGER_RANGE[1] if v.type == "Integer" else sys.float_info.max
    low = -widest if v.minimum is None else v.minimum
    high = widest if v.maximum is None else v.maximum
    return float(low), float(high)


def _items(v: BlockVariable) -> list[int]:
    """Returns the numbers of an enumeration's items, none of another type."""
    numbers = [int(item) for item in v.enumeration or ()]
    if not all(0 <= number < _WORD for number in numbers):
        raise ExportError(f"{v.name}: items {numbers}: expected numbers from 0 to {_WORD - 1}")
    return numbers


def _string(text: str) -> str:
    """Returns a C string literal of the UTF-8 bytes: everything but plain printable ASCII as octal."""
    plain = set(range(32, 127)) - set(b'"\\?')  # ?? would begin a trigraph
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode()) + '"'
