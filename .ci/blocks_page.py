"""Page reference/blocks.md, what a block may contain, from the code."""

import inspect
from dataclasses import MISSING, dataclass, fields
from enum import IntEnum
from typing import Any

from fmus import numerics
from fmus.block import Block, NoValues, variable
from fmus.block.guide import Guide
from fmus.block.units import unit
from fmus.units import SYMBOLS, UnitDefinition
from orchestration.cli.explain import markdown_table

_HEAD = """\
# Blocks

What a block may contain. Its classes and functions are checked when it is built; a mistake is one sentence
with file, line, class and variable. [Your own controller](../tutorials/your-own-controller.md) shows a block
at work. [Build a block](../how-to/blocks.md) has recipes for each part. [Python: blocks](api/blocks.md) has
every name with its types.
"""
_FURTHER = [
    "deg", "deg/s", "rev/min", "mm", "km/h", "knot", "h", "l/min", "kN", "Nm", "bar", "kPa", "kWh", "A.h",
    "degC", "degF", "%",
]  # fmt: skip
_KINDS: dict[Any, str] = {
    type: "a class with `@dataclass(frozen=True)`",
    str: "a text",
    str | None: "a text",
    float: "a number [s]",
    Guide: "a `Guide`, from `fmus.block.guide`",
}


class Mode(IntEnum):
    """Items are numbers from 0 to 31."""

    SLOW = 1
    FAST = 2


@dataclass(frozen=True)
class _Types:
    real: float = variable(0.0, "")
    integer: int = variable(0, "")
    boolean: bool = variable(False, "")
    enumeration: Mode = variable(Mode.SLOW, "")
    vector: tuple[float, ...] = variable((0.0, 0.0), "")
    matrix: tuple[tuple[float, ...], ...] = variable(((0.0, 0.0), (0.0, 0.0)), "")


def page() -> str:
    """The whole page."""
    parts = [
        _HEAD,
        f"## Block\n\n```text\n{_text(Block)}\n```\n\n{_block_fields()}",
        f"## Block of a module\n\n{_function('Block.of_module', Block.of_module)}",
        f"## Variables\n\n{_function('variable', variable)}\n\n{_types()}",
        f"## Mathematics\n\n{_paragraph(numerics)}\n\n{_functions()}",
        f"## Units\n\n{_units()}",
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _function(name: str, function: Any) -> str:
    """Signature and docstring."""
    return f"```text\n{name}{_signature(function)}\n\n{_text(function)}\n```"


def _text(thing: Any) -> str:
    return inspect.cleandoc(thing.__doc__)


def _paragraph(thing: Any) -> str:
    """The docstring behind its first line."""
    return " ".join(_text(thing).partition("\n\n")[2].split())


def _summary(thing: Any) -> str:
    return " ".join(_text(thing).partition("\n\n")[0].split())


def _signature(function: Any) -> str:
    signature = inspect.signature(function)
    plain = [p.replace(annotation=inspect.Parameter.empty) for p in signature.parameters.values()]
    return str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))


def _block_fields() -> str:
    rows = []
    for member in fields(Block):
        default = member.default
        is_required = default is MISSING
        shown = "" if is_required or callable(default) or default is None else f"`{default!r}`"
        kind = _KINDS.get(member.type, "a function")
        shown = "no variables" if default is NoValues else shown
        shown = "" if member.name == "guide" else shown
        rows.append((f"`{member.name}`", kind, "required" if is_required else shown or "may be left out"))
    return markdown_table(("Field", "What it is", "Default"), rows)


def _types() -> str:
    @dataclass(frozen=True)
    class Outputs:
        y: float = variable(0.0, "")

    variables = Block(
        "Types", "", parameters=_Types, outputs=Outputs, output=lambda *_: Outputs()
    ).of_causality("parameter")
    rows = []
    for member in fields(_Types):
        scalars = [v for v in variables if v.name.partition("[")[0] == member.name]
        names = ", ".join(f"`{v.name}`" for v in scalars)
        start = "Mode.SLOW" if member.name == "enumeration" else repr(member.default)
        rows.append((f"`{start}`", scalars[0].type, names))
    table = markdown_table(("Start value of `NAME`", "FMI type", "Variables"), rows)
    for member in fields(_Types):
        table = table.replace(f"`{member.name}", "`NAME")
    return f"{table}\n\n`Mode` is an `IntEnum`: {_summary(Mode)[0].lower()}{_summary(Mode)[1:]}"


def _functions() -> str:
    rows = []
    for name in numerics.__all__:
        function = getattr(numerics, name)
        rows.append((f"`{name}{_signature(function)}`", _summary(function).removeprefix("Returns ")))
    return markdown_table(("Function", "Returns"), rows)


def _units() -> str:
    known = ", ".join(f"`{name}`" for name in SYMBOLS)
    rows = [
        (f"`{name}`", _powers(unit(name)), f"{unit(name).factor!r}", f"{unit(name).offset!r}")
        for name in _FURTHER
    ]
    table = markdown_table(("Unit", "Base units of FMI", "Factor", "Offset"), rows)
    return (
        f"Products of powers of these symbols, most with SI prefixes: {known}.\n\n"
        "With Pint, all others that these base units can express (`pip install 'l1-depth[units]'`).\n"
        "The value in base units is factor times value plus offset. Some of them:\n\n"
        f"{table}\n\nThe error for an unknown unit names the nearest known one."
    )


def _powers(meaning: UnitDefinition) -> str:
    return " ".join(f"{base}^{power}" for base, power in meaning.exponents.items()) or "1"
