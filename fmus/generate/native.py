"""Block -> FMU of compiled C that needs nothing on the host.

`fmi2.c`, in an FMU of FMI 3.0 `fmi3.c`, is the only file to compile. It includes others of the hand-written
layer, and of the block the tables in `model.h` and the equations in `model_code.h`; but `model_lanes.h` has
the equations for groups of instances, which an ensemble compiles.

The GUID follows from the compiler with its flags and from all members but the libraries and those whose
digests stand in the bill of materials, such as the icon. It does not depend on which platforms were built.
"""

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib import resources
from importlib.metadata import version
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template
from xml.etree import ElementTree

from fmus.block import Block
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.files import xml_document
from fmus.fmi.integer_enumerations import REALS_ONLY, with_other_types
from fmus.fmi.variable_types import INTEGER_RANGE, TRANSFER_TYPE
from fmus.generate import fmi3
from fmus.generate.documentation.page import documentation, licenses
from fmus.generate.model_description import model_description
from fmus.generate.sensitivities import sensitivities
from fmus.generate.symbolic import Traced, indicator_count, traced
from fmus.guid import GUID, with_guid
from fmus.native import sbom
from fmus.native.toolchain import compiling
from fmus.platforms import PLATFORMS, check_platforms, host_platform, library_name

COMPILED = {2: ("fmi2.c",), 3: ("fmi3.c",)}
_WRITERS = ("l1-depth", "casadi")  # of the C
_WORD = 32  # bits of the set of items
_SETTABLE = {"fixed": "BEFORE_STEPPING", "continuous": "ALWAYS"} | dict.fromkeys(
    ("tunable", "discrete"), "AT_POINTS"
)
_EXTENTS = """
/* By value reference: how many elements the variable has that begins there, 0 inside an array. */
static const unsigned EXTENTS[] = {{{}}};
"""
_OF_BOTH = {"canNotUseMemoryManagementFunctions": "true", "providesDirectionalDerivative": "true"}
_OF_EXCHANGE = {"completedIntegratorStepNotNeeded": "true", **_OF_BOTH}
_CAPABILITIES = {"canInterpolateInputs": "true", "maxOutputDerivativeOrder": "0", **_OF_BOTH}


def content(block: Block, reals_only: bool = False, fmi: int = 2) -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of the FMU without its libraries.

    reals_only: whether every variable is a Real, for importers that know no other type
    fmi: the version of the standard, 2 or 3
    """
    files, sources = COMPILED[fmi], c_sources(block, GUID, reals_only, fmi)
    if fmi == 3:
        description = fmi3.model_description(block, GUID)
    else:
        description = model_description(block, GUID, _CAPABILITIES, _OF_EXCHANGE, files)
    members = {
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        **documentation(block, *files, reals_only=reals_only, fmi=fmi),
        **licenses("l1-depth", "fmi-headers", "zig", "mingw-w64", fmi=fmi),
        "sources/buildDescription.xml": _build_description(block.name, fmi),
        **bill_of_materials(block, {}, fmi),
        "modelDescription.xml": with_other_types(description, REALS_ONLY) if reals_only else description,
    }
    return with_guid(members, recipe=sbom.RECIPE)


def _build_description(name: str, fmi: int) -> bytes:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for file in COMPILED[fmi]:
        ElementTree.SubElement(files, "SourceFile", name=file)
    unprefixed = {"name": f"FMI{fmi}_OVERRIDE_FUNCTION_PREFIX", "optional": "true"}
    unprefixed["description"] = "for a shared library: functions without the prefix of a static one"
    ElementTree.SubElement(files, "PreprocessorDefinition", unprefixed)
    return xml_document(root)


@contextmanager
def compiled_libraries(
    name: str, members: dict[str, bytes], platforms: Sequence[str], fmi: int = 2
) -> Iterator[Callable[[], dict[str, bytes]]]:
    """Starts compiling libraries beside this process; yields a function that waits for them.

    It returns path inside the FMU -> library, made from the FMU's sources; by default for this platform.
    Raises ExportError for an unknown platform.
    """
    sources = {Path(path).name: members[path].decode() for path in members if path.startswith("sources/")}
    with ExitStack() as stack:
        ends = {
            library_name(name, platform, fmi): stack.enter_context(
                compiling(name, sources, COMPILED[fmi], platform)
            )
            for platform in check_platforms(platforms) or (host_platform(),)
        }
        yield lambda: {path: end() for path, end in ends.items()}


def bill_of_materials(block: Block, files: Mapping[str, bytes], fmi: int = 2) -> dict[str, bytes]:
    """Returns path inside the FMU -> bill of materials of its libraries, with digests of other files.

    files: path inside the FMU -> content
    fmi: the version of the standard
    """
    module = {"name": "l1-depth:module", "value": block.output.__module__}
    subject = sbom.component(
        block.name, block.version, block.license, description=block.description, properties=[module]
    )
    own, casadi = (sbom.component(name, version(name), None, type="application") for name in _WRITERS)
    layer = sbom.component("l1-depth", version("l1-depth"), "MIT", description="sources, but for model*.h")
    headers = sbom.component("fmi-headers", f"{fmi}.0", "BSD-2-Clause")
    platforms = {library_name(block.name, platform, fmi): platform for platform in PLATFORMS}
    known = {path: (platforms.get(path, ""), content) for path, content in files.items()}
    return {sbom.MEMBER: sbom.bill_of_materials(subject, [layer, headers], [own, casadi], known)}


def c_sources(block: Block, guid: str, reals_only: bool = False, fmi: int = 2) -> dict[str, str]:
    """Returns file name -> text of the FMU's folder `sources`: all but FMI's own headers (2.3).

    reals_only: every variable is a Real, what is an item, truth value or Integer one that is a whole number
    Raises ExportError for a block that cannot be traced.
    """
    layer = resources.files("fmus") / "native"
    texts = dict(_included(layer, COMPILED[fmi][0]))
    template = Template((layer / "model.h.in").read_text("utf-8"))
    functions = traced(block)
    model = template.substitute(_tables(functions, reals_only, fmi), guid=guid)
    return texts | {"model.h": model} | functions.c_code(sensitivities(block).functions(fmi))


def _included(layer: Traversable, name: str) -> Iterator[tuple[str, str]]:
    """Yields names and texts of a hand-written file and of those that it includes; some more than once."""
    file = layer / name
    if file.is_file():
        text = file.read_text("utf-8")
        yield name, text
        for included in re.findall(r'^#include "(.+)"', text, re.MULTILINE):
            yield from _included(layer, included)


def _tables(functions: Traced, reals_only: bool, fmi: int) -> dict[str, object]:
    """Returns the values for the placeholders of `model.h.in`."""
    block = functions.block
    others = fmi3.other_variables(block) if fmi == 3 else ()
    described = (*block.variables, *block.states, *others)
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
        "continuous": len(block.states) // 2,
        "indicators": indicator_count(block),
        "step_size": repr(float(block.step_size)),
        "fmi": fmi,
        "others": len(others),
        "extents": _EXTENTS.format(", ".join(map(str, fmi3.extents(block)))) if fmi == 3 else "",
        "has_derivative": int(block.derivative is not None),
        "nominals": ", ".join(repr(float(v.nominal or 1.0)) for v in block.states) or "0",
        "variables": ",\n".join(_row(v, reals_only) for v in described),
        "access": ", ".join(_access(v, reals_only, fmi) for v in described),
        "required": ",\n".join(f"    {_string(text)}" for text in (*functions.required, "")),
    }


def _row(v: BlockVariable, reals_only: bool) -> str:
    is_converted = reals_only and v.type != "Real"
    items = [0, 1] if is_converted and v.type == "Boolean" else _items(v)
    values = (float(v.start), *_range(v), hex(sum(1 << item for item in items)), int(is_converted))
    cells = (_string(v.name), *values, _string(v.expected))
    return f"    {{{', '.join(map(str, cells))}}}"


def _access(v: BlockVariable, reals_only: bool, fmi: int) -> str:
    settable = _SETTABLE[v.variability] if v.settable else "NEVER"
    kind = v.type if fmi == 3 else TRANSFER_TYPE[v.type]
    is_continuous = int(v.variability == "continuous")
    return f"{{{'REAL' if reals_only else kind.upper()}, {settable}, {is_continuous}}}"


def _range(v: BlockVariable) -> tuple[float, float]:
    """Returns the range that the C layer lets pass: without declared limits, that of the type."""
    if items := [0, 1] if v.type == "Boolean" else _items(v):
        return float(min(items)), float(max(items))
    low, high = INTEGER_RANGE if v.type == "Integer" else (-sys.float_info.max, sys.float_info.max)
    return float(low if v.minimum is None else v.minimum), float(high if v.maximum is None else v.maximum)


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
