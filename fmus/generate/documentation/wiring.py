"""Connections of a block with the blocks of l1-depth, and a block diagram of it, from the declarations alone.

An output is connected with the input of the same name and unit, as by the terminals of the FMUs. An input
`measured_NAME` takes an output NAME, too. A block with such inputs gets measurements first.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from html import escape
from itertools import groupby

from fmus.block import Block
from fmus.block.block_file import from_sources
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.registry import BLOCKS, installed, load

_MEASURED = "measured_"
# pixels of the diagram; the last one is the width of a letter of a monospaced font of 12 px
_ROW, _HEADER, _EDGE, _PORT, _LETTER = 20, 34, 12, 6, 7.3


@dataclass(frozen=True)
class Connection:
    """Connection of a variable of a block with a variable that some FMUs have; is_input: of the block."""

    own: str
    is_input: bool
    other: str
    fmus: tuple[str, ...]


def declared_variables(variables: Iterable[BlockVariable]) -> dict[str, list[BlockVariable]]:
    """Returns the scalars of each declared variable by its name, which is `name[1..2]` for a vector."""
    declared = [list(scalars) for _, scalars in groupby(variables, key=lambda v: v.name.partition("[")[0])]
    return {re.sub(r"\d+(?=[],])", r"1..\g<0>", scalars[-1].name): scalars for scalars in declared}


def connections(block: Block) -> list[Connection]:
    """Returns the connections of a block with blocks of l1-depth, in the order of the declaration."""
    others: list[Block] = []
    for point in installed(BLOCKS).values():
        # Blocks of other packages are left out: an FMU must not depend on what else is installed. A block of
        # l1-depth that cannot be loaded is reported by its own build.
        if point.dist and point.dist.name == "l1-depth" and point.name != block.name:
            with from_sources(), suppress(ExportError):
                others.append(load(point, "block"))
    # Blocks that give the same signal replace each other: they are not connected.
    given = {v.name for v in block.of_causality("output")}
    others = [other for other in others if given.isdisjoint(v.name for v in other.of_causality("output"))]
    ends = [(target, True, source, other.name) for other in others for source, target in _pairs(other, block)]
    ends += [
        (source, False, target, other.name) for other in others for source, target in _pairs(block, other)
    ]
    order = list(declared_variables(block.variables))
    fmus: dict[tuple[str, bool, str], list[str]] = {}
    for own, is_input, other, name in sorted(ends, key=lambda end: order.index(end[0])):
        fmus.setdefault((own, is_input, other), []).append(name)
    return [Connection(*variables, tuple(names)) for variables, names in fmus.items()]


def _pairs(source: Block, target: Block) -> Iterator[tuple[str, str]]:
    """Yields (output of the source, input of the target) that belong together."""
    outputs = {name.partition("[")[0]: name for name in declared_variables(source.of_causality("output"))}
    units = {
        name: [v.unit for v in scalars] for name, scalars in declared_variables(source.variables).items()
    }
    inputs = declared_variables(target.of_causality("input"))
    measures = any(name.startswith(_MEASURED) for name in inputs)
    for name, scalars in inputs.items():
        plain = name.partition("[")[0].removeprefix(_MEASURED)
        names = (_MEASURED + plain, plain) if measures else (plain,)
        output = next((outputs[candidate] for candidate in names if candidate in outputs), None)
        if output and units[output] == [v.unit for v in scalars]:
            yield output, name


def diagram(block: Block, connected: Iterable[Connection]) -> str:
    """Returns the block as SVG: inputs at the left, outputs at the right, in groups of the same other FMU."""
    fmus = {one.own: one.fmus for one in connected}
    left = _rows(block.of_causality("input"), fmus, "optional")
    right = _rows(block.of_causality("output"), fmus, "not connected")
    longest = [max((len(text) for text, _ in rows), default=0) for rows in (left, right)]
    width = round(max(_LETTER * sum(longest), 1.3 * _LETTER * len(block.name)) + 6 * _EDGE)
    height = _HEADER + _ROW * max(len(left), len(right)) + _EDGE
    return "\n".join(
        (
            f'<svg class="diagram" viewBox="0 0 {width} {height}" width="{width}" role="img"'
            f' aria-label="Inputs and outputs of {escape(block.name)}">',
            f'<rect x="{_PORT}" y="1" width="{width - 2 * _PORT}" height="{height - 2}" rx="8"></rect>',
            f'<text class="name" x="{width / 2:g}" y="22" text-anchor="middle">{escape(block.name)}</text>',
            *_side(left, _PORT, _PORT + _EDGE, "start"),
            *_side(right, width - _PORT, width - _PORT - _EDGE, "end"),
            "</svg>",
        )
    )


def _side(rows: list[tuple[str, bool]], edge: int, x: int, anchor: str) -> Iterator[str]:
    """Yields the texts of one side, and a triangle for each port, in the direction of the signal."""
    for row, (text, is_port) in enumerate(rows):
        y = _HEADER + _ROW * row + 14
        kind = "port" if is_port else "group"
        yield f'<text class="{kind}" x="{x}" y="{y}" text-anchor="{anchor}">{escape(text)}</text>'
        if is_port:
            points = f"{edge - _PORT},{y - 10} {edge + _PORT},{y - 4} {edge - _PORT},{y + 2}"
            yield f'<polygon points="{points}"></polygon>'


def _rows(
    variables: Iterable[BlockVariable], fmus: Mapping[str, tuple[str, ...]], rest: str
) -> list[tuple[str, bool]]:
    """Returns (text, whether it is a port) of one side: the name of a group, then its ports.

    rest: name of the group of ports without a connection, the last one
    """
    groups: dict[str, list[str]] = {}
    for port in sorted(declared_variables(variables), key=lambda port: port not in fmus):
        names = fmus.get(port, (rest,))
        others = f" or {len(names) - 1} other{'s' * (len(names) > 2)}" if names[1:] else ""
        groups.setdefault(names[0] + others, []).append(port)
    return [
        row for name, ports in groups.items() for row in ((name, False), *((port, True) for port in ports))
    ]
