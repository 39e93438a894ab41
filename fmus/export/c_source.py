"""Block -> the C99 sources of its native FMU: the hand-written layer and what is generated of the block.

`fmi2.c` is the only file to compile; the others are included by it. Tables go to `model.h`, equations
to `model_code.h`.
"""

import re
import sys
from importlib import resources

import fmpy

from fmus.block import Block, ScalarVariable
from fmus.errors import ExportError
from fmus.export.symbolic import Traced
from fmus.fmi_types import TRANSFER_TYPE

COMPILED = ("fmi2.c",)
_FMI_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_WORD = 32  # bits of the set of items
_LARGEST_INTEGER = 2**31 - 1

_MODEL_H = """\
/* {name}: {description}. Generated. */

#ifndef MODEL_H
#define MODEL_H

#define MODEL_NAME "{name}"
#define MODEL_GUID "{guid}"
#define MODEL(function) {name}_##function

enum {{
    N_PARAMETERS = {parameters},
    N_CALCULATED = {calculated},
    N_INPUTS = {inputs},
    N_OUTPUTS = {outputs},
    N_STATES = {states},
    N_WHOLE_OUTPUTS = {n_whole},
    N_REQUIREMENTS = {requirements},
    INTERNAL_STEP = {internal_step},
    MODEL_WORK = {work}
}};

/* By value reference: name, type, when it can be set, start, min, max, items, what is expected. */
static const Variable VARIABLES[] = {{
{variables}
}};

/* Which outputs are no Reals: whole numbers, by their place among the outputs. */
static const int WHOLE_OUTPUTS[] = {{{whole}}};

/* What parameters must fulfil together. */
static const char *const REQUIRED[] = {{
{required}
}};

#endif
"""


def c_sources(block: Block, guid: str) -> dict[str, str]:
    """File name -> text of everything in the folder `sources` of the FMU.

    Raises ExportError for a block that cannot be traced.
    """
    layer = resources.files("fmus") / "native"
    headers = resources.files(fmpy) / "c-code"
    found = {
        each.name: each.read_text("utf-8") for each in layer.iterdir() if each.name.endswith((".c", ".h"))
    }
    found |= {name: (headers / name).read_text("utf-8") for name in _FMI_HEADERS}
    try:
        traced = Traced(block)
        return found | {"model.h": _model_h(traced, guid), "model_code.h": traced.c_code()}
    except (TypeError, AttributeError, RuntimeError, NotImplementedError) as error:
        raise ExportError(
            f"block {block.name!r} cannot be traced: {error}; expected numerics.where for a branch on a value"
        ) from error


def _model_h(traced: Traced, guid: str) -> str:
    block = traced.block
    count = {c: len(block.of_causality(c)) for c in ("parameter", "calculatedParameter", "input", "output")}
    whole = [place for place, v in enumerate(block.of_causality("output")) if v.type != "Real"]
    (internal_step,) = [v.value_reference for v in block.variables if v.name == "internal_step"]
    return _MODEL_H.format(
        name=block.name,
        description=" ".join(block.description.split()).replace("*/", "* /"),
        guid=guid,
        parameters=count["parameter"],
        calculated=count["calculatedParameter"],
        inputs=count["input"],
        outputs=count["output"],
        states=traced.step.numel_out(0),
        n_whole=len(whole),
        whole=", ".join(map(str, (*whole, 0))),  # never empty, which C99 has not
        requirements=len(traced.required),
        internal_step=internal_step,
        work=max(function.sz_w() for function in traced.functions()),
        variables=",\n".join(_row(v) for v in block.variables),
        required=",\n".join(f"    {_string(text)}" for text in (*traced.required, "")),
    )


def _row(v: ScalarVariable) -> str:
    (low, high), items = _range(v), sum(1 << item for item in _items(v))
    settable = "NEVER" if not v.settable else "BEFORE_STEPPING" if v.variability == "fixed" else "ALWAYS"
    cells = (
        _string(v.name),
        TRANSFER_TYPE[v.type].upper(),
        settable,
        float(v.start),
        low,
        high,
        hex(items),
        _string(v.expected),
    )
    return "    {" + ", ".join(str(cell) for cell in cells) + "}"


def _range(v: ScalarVariable) -> tuple[float, float]:
    """What the C layer lets pass: without declared limits, what the type can hold."""
    if v.enumeration:
        return float(min(_items(v))), float(max(_items(v)))
    if v.type == "Boolean":
        return 0.0, 1.0
    widest = _LARGEST_INTEGER if v.type == "Integer" else sys.float_info.max
    low = -widest if v.minimum is None else v.minimum
    high = widest if v.maximum is None else v.maximum
    return float(low), float(high)


def _items(v: ScalarVariable) -> list[int]:
    """Numbers of an enumeration's items, none of another type."""
    numbers = [int(item) for item in v.enumeration or ()]
    if not all(0 <= number < _WORD for number in numbers):
        raise ExportError(f"{v.name}: items {numbers}: expected numbers from 0 to {_WORD - 1}")
    return numbers


def _string(text: str) -> str:
    """A C string literal of the UTF-8 bytes: everything but plain printable ASCII as octal."""
    plain = set(range(32, 127)) - set(b'"\\?')  # ?? would begin a trigraph
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode()) + '"'


def header_license() -> dict[str, bytes]:
    """Path inside the FMU -> licence of FMI's headers, as they state it."""
    text = (resources.files(fmpy) / "c-code" / _FMI_HEADERS[0]).read_text("utf-8")
    stated = re.search(r"Copyright.*?(?=\*/)", text, re.DOTALL)
    return {"documentation/licenses/fmi-headers.txt": stated[0].encode()} if stated else {}
