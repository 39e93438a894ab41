"""The picture of a block."""

import io
import struct
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from PIL import Image

from fmus.block import NoValues, variable
from fmus.generate import builder
from fmus.generate.documentation.terminals_and_icon import SIZE, icon
from tests.described_fmus import members


@cache
def icon_of(name: str) -> bytes:
    return icon(builder.load_block(name))


def shown(data: bytes) -> Image.Image:
    return Image.open(io.BytesIO(data)).convert("RGBA")


def chunks(data: bytes) -> list[str]:
    """Names of the chunks of a PNG."""
    names, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        names.append(data[at + 4 : at + 8].decode())
        at += 12 + length
    return names


@pytest.mark.parametrize("name", builder.block_names())
def test_the_picture_is_a_square_that_shows_something(name: str) -> None:
    picture = shown(icon_of(name))
    assert picture.size == (SIZE, SIZE)
    assert picture.getpixel((0, 0))[3] == 0, "expected a transparent corner"  # type: ignore[index]
    colours = picture.getcolors(SIZE * SIZE)
    assert colours is not None
    assert len(colours) > 10


def test_the_same_block_gives_the_same_bytes_without_a_date() -> None:
    block = builder.load_block("RovDepthPlant")
    assert icon(block) == icon(block)
    assert set(chunks(icon(block))) <= {"IHDR", "PLTE", "tRNS", "IDAT", "IEND"}


def test_different_blocks_look_different() -> None:
    names = builder.block_names()
    assert len(set(map(icon_of, names))) == len(names)


def test_each_declared_port_has_its_triangle() -> None:
    """Coloured as an input on the left edge, as an output on the right one."""

    @dataclass(frozen=True)
    class Outputs:
        first: float = variable(0.0, "First")
        second: float = variable(0.0, "Second")
        third: float = variable(0.0, "Third")

    block = replace(builder.load_block("ExamplePlant"), inputs=NoValues, outputs=Outputs)
    picture = shown(icon(block))
    edges = [[picture.getpixel((x, y)) for y in range(SIZE)] for x in (8, SIZE - 8)]  # beyond the box
    runs = [sum(1 for a, b in pairwise(edge) if a[3] < 128 <= b[3]) for edge in edges]  # type: ignore[index]
    assert runs == [0, 3]


def test_a_long_name_and_many_ports_stay_inside_the_picture() -> None:
    long = replace(builder.load_block("L1DepthController"), name="A" * 55)
    picture = shown(icon(long))
    frame = [picture.getpixel((x, 55)) for x in (4, SIZE - 5)]
    assert [pixel[3] for pixel in frame] == [0, 0]  # type: ignore[index]


def test_it_is_inside_the_fmu(either: dict[str, Path]) -> None:
    assert members(either["ExamplePlant"])["model.png"] == icon_of("ExamplePlant")
