"""Connections of a block with the blocks of l1-depth, and a block diagram of it, from the declarations alone.

An output is connected with the input of its name and unit, as the terminals of the FMU say. An input
`measured_NAME` takes an output NAME, too, and a block that has such inputs is given measurements first.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape
from itertools import groupby

from fmus.block import Block
from fmus.block.block_file import from_sources
from fmus.block.variables import BlockVariable
from fmus.registry import BLOCKS, installed, load

_MEASURED = "measured_"
_ROW, _HEADER, _EDGE, _PORT = 20, 34, 12, 6  # pixels of the diagram
_LETTER = 7.3  # width of a letter of a monospaced font of 12 px


@dataclass(frozen=True)
class Connection:
    """Output of one block and input of another, with the names of blocks that have the other end of it."""

    output: str
    input: str
    others: tuple[str, ...]


def arrays(variables: Iterable[BlockVariable]) -> dict[str, list[BlockVariable]]:
    """Returns the scalars of each declared variable by its name, which is `name[1..2]` for a vector."""
    declared = [list(scalars) for _, scalars in groupby(variables, key=lambda v: v.name.partition("[")[0])]
    return {re.sub(r"\d+(?=[],])", r"1..\g<0>", scalars[-1].name): scalars for scalars in declared}


def connections(block: Block) -> tuple[list[Connection], list[Connection]]:
    """Returns the connections of a block's inputs, then of its outputs, in the order of the declaration."""
    # Blocks of other packages are left out: an FMU must not depend on what else is installed.
    points = [point for point in installed(BLOCKS).values() if point.dist and point.dist.name == "l1-depth"]
    with from_sources():
        others = [load(point, "block") for point in points if point.name != block.name]
    # Blocks that give the same signal replace each other: they are not connected.
    given = {v.name for v in block.of_causality("output")}
    others = [other for other in others if given.isdisjoint(v.name for v in other.of_causality("output"))]
    incoming = [(*pair, other.name) for other in others for pair in _pairs(other, block)]
    outgoing = [(*pair, other.name) for other in others for pair in _pairs(block, other)]
    return (
        _grouped(incoming, list(arrays(block.of_causality("input"))), 1),
        _grouped(outgoing, list(arrays(block.of_causality("output"))), 0),
    )


def _pairs(source: Block, target: Block) -> Iterator[tuple[str, str]]:
    """Yields (output of the source, input of the target) that belong together."""
    outputs = {name.partition("[")[0]: name for name in arrays(source.of_causality("output"))}
    units = {name: [v.unit for v in scalars] for name, scalars in arrays(source.variables).items()}
    inputs = arrays(target.of_causality("input"))
    measures = any(name.startswith(_MEASURED) for name in inputs)
    for name, scalars in inputs.items():
        plain = name.partition("[")[0].removeprefix(_MEASURED)
        names = (_MEASURED + plain, plain) if measures else (plain,)
        output = next((outputs[candidate] for candidate in names if candidate in outputs), None)
        if output and units[output] == [v.unit for v in scalars]:
            yield output, name


def _grouped(pairs: list[tuple[str, str, str]], order: list[str], own: int) -> list[Connection]:
    """Returns the pairs in the order of the block's own ports, with all blocks that have the other port."""
    others: dict[tuple[str, str], list[str]] = {}
    for output, target, other in sorted(pairs, key=lambda pair: order.index(pair[own])):
        others.setdefault((output, target), []).append(other)
    return [Connection(*ports, tuple(names)) for ports, names in others.items()]


def diagram(block: Block, incoming: Iterable[Connection], outgoing: Iterable[Connection]) -> str:
    """Returns the block as SVG: inputs at the left, outputs at the right, in groups of the same other FMU."""
    ports = [arrays(block.of_causality(causality)) for causality in ("input", "output")]
    left = _rows(ports[0], {one.input: one.others for one in incoming}, "start value holds")
    right = _rows(ports[1], {one.output: one.others for one in outgoing}, "to observe")
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


def _rows(ports: Iterable[str], others: dict[str, tuple[str, ...]], rest: str) -> list[tuple[str, bool]]:
    """Returns (text, whether it is a port) of one side: the name of a group, then its ports.

    rest: name of the group of ports without a connection, the last one
    """
    groups: dict[str, list[str]] = {}
    for port in sorted(ports, key=lambda port: port not in others):
        names = others.get(port, (rest,))
        groups.setdefault(names[0] if len(names) == 1 else f"one of {len(names)} FMUs", []).append(port)
    rows: list[tuple[str, bool]] = []
    for name, members in groups.items():
        rows += [(name, False), *((port, True) for port in members)]
    return rows
