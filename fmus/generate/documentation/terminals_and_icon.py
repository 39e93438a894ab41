"""Terminals and icon of an FMU (FMI 2.0.5, 2.3; FMI 3.0.2, 2.5): terminalsAndIcons.xml and a picture.

Terminals list the ports that belong together, in the file format of FMI 3.0 (2.4.9), which FMI 2.0.4 took
over at the same place. An FMU of FMI 2.0 has the file on request alone: FMI Library 3.0.4 reads it as a file
of FMI 3.0 and prints FATAL lines. Two terminals are enough: inputs and outputs. Both match as a bus: members
of equal name are connected, so the outputs of a block fit the inputs of the same names.
`GraphicalRepresentation` is left out: some readers take the first child of the root for the terminals.
"""

import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import fields
from xml.etree import ElementTree

import numpy as np

from fmus.block import Block
from fmus.block.variables import BlockVariable
from fmus.extras import imports_of
from fmus.files import xml_document

with imports_of("build", "building an FMU"):
    from PIL import Image, ImageDraw, ImageFont

# pixels, both ways
SIZE = 512
# The picture is drawn larger and scaled down: Pillow draws shapes without smooth edges.
_SCALE = 4
_PAPER, _INK, _BAND, _INPUT, _OUTPUT = "#ffffff", "#1d2b3a", "#12486b", "#b45309", "#12486b"
# of each channel: the palette holds the colours on edges, too
_LEVEL = 17
_EDGE, _RADIUS, _HEADER, _PORT = 14, 26, 96, 9
_LARGEST_TEXT, _LARGEST_NAME = 21.0, 46.0


def icon(block: Block) -> bytes:
    """Returns the picture as PNG: the same bytes for the same block on every system, without a date."""
    side = SIZE * _SCALE
    image = Image.new("RGBA", (side, side), (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)
    box = [_px(_EDGE), _px(_EDGE), side - _px(_EDGE), side - _px(_EDGE)]
    header = [box[0], box[1], box[2], _px(_EDGE + _HEADER)]
    draw.rounded_rectangle(box, _px(_RADIUS), _PAPER, _INK, _px(4))
    draw.rounded_rectangle(header, _px(_RADIUS), _BAND, corners=(True, True, False, False))
    name = _font(draw, block.name, SIZE - 2 * _EDGE - 40, _LARGEST_NAME)
    draw.text((side / 2, _px(_EDGE + _HEADER / 2)), block.name, _PAPER, name, "mm")
    _ports(draw, block)
    # Pillow's own choice of a palette, and its compression, differ between systems.
    levels = [_LEVEL * round(value / _LEVEL) for value in range(256)]
    return _png(image.reduce(_SCALE).point(levels * len(image.getbands())))


def _png(image: Image.Image) -> bytes:
    """Returns an RGBA image of at most 256 colours as PNG with a palette (ISO/IEC 15948, 11.2 and 11.3.2)."""
    colours, indices = np.unique(np.frombuffer(image.tobytes(), ">u4"), return_inverse=True)
    palette = colours.astype(">u4").view("u1").reshape(-1, 4)
    # each row begins with the number of its filter, which is 0: none
    rows = np.pad(indices.reshape(SIZE, SIZE).astype("u1"), ((0, 0), (1, 0)))
    chunks = {
        b"IHDR": struct.pack(">IIBBBBB", SIZE, SIZE, 8, 3, 0, 0, 0),
        b"PLTE": palette[:, :3].tobytes(),
        b"tRNS": palette[:, 3].tobytes(),
        b"IDAT": zlib.compress(rows.tobytes(), 9),
        b"IEND": b"",
    }
    parts = (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks.items()
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _px(length: float) -> int:
    return round(length * _SCALE)


def _ports(draw: ImageDraw.ImageDraw, block: Block) -> None:
    """Draws a triangle on the edge and a label beside it for each declared input and output."""
    inputs = [variable.name for variable in fields(block.inputs)]
    outputs = [variable.name for variable in fields(block.outputs)]
    top, bottom = _EDGE + _HEADER + 6, SIZE - _EDGE - 6
    lowest_row = (bottom - top) / max(len(inputs), len(outputs), 1)
    widest_row = "   ".join(max(names, key=len) for names in (inputs, outputs) if names)
    size = min(_LARGEST_TEXT, 0.8 * lowest_row)
    font = _font(draw, widest_row, SIZE - 2 * _EDGE - 6 * _PORT, size)
    for names, x, direction, anchor, colour in (
        (inputs, _EDGE, 1, "lm", _INPUT),
        (outputs, SIZE - _EDGE, -1, "rm", _OUTPUT),
    ):
        for i, name in enumerate(names):
            y = top + (i + 0.5) * (bottom - top) / len(names)
            # a signal to the right
            corners = (x - _PORT, y - _PORT), (x + _PORT, y), (x - _PORT, y + _PORT)
            draw.polygon([(_px(a), _px(b)) for a, b in corners], colour)
            draw.text((_px(x + direction * 2 * _PORT), _px(y)), name, _INK, font, anchor)


def _font(
    draw: ImageDraw.ImageDraw, line: str, width: float, largest: float
) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Returns Pillow's own font, so large that the line is no wider than `width`."""
    length = draw.textlength(line, ImageFont.load_default(_px(largest))) / _SCALE
    return ImageFont.load_default(_px(largest * min(1.0, width / max(length, 1.0))))


Names = Callable[[Iterable[BlockVariable]], list[str]]
PATH = "terminalsAndIcons/terminalsAndIcons.xml"
_TERMINALS = (("inputs", "input", "Every input"), ("outputs", "output", "Every output"))


def _scalars(variables: Iterable[BlockVariable]) -> list[str]:
    return [v.name for v in variables]


def terminals(block: Block, names_of: Names = _scalars) -> dict[str, bytes]:
    """Returns path inside the FMU -> content; nothing for a block without ports.

    names_of: the names in the FMU of the variables that some scalars of the block become
    """
    root = ElementTree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = ElementTree.SubElement(root, "Terminals")
    for name, causality, description in _TERMINALS:
        if variables := block.of_causality(causality):
            attributes = {"name": name, "matchingRule": "bus", "description": description}
            terminal = ElementTree.SubElement(listed, "Terminal", attributes)
            for name_of_member in names_of(variables):
                names = {"variableName": name_of_member, "memberName": name_of_member}
                member = {**names, "variableKind": "signal"}
                ElementTree.SubElement(terminal, "TerminalMemberVariable", member)
    return {PATH: xml_document(root)} if len(listed) else {}
