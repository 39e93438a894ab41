"""The generated C says what the block says, whatever characters its texts are made of."""

import ctypes
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import pytest

from fmus.block import Block, variable
from fmus.errors import ExportError
from fmus.files import write_archive
from fmus.generate.archive import native_members
from fmus.generate.trace import trace
from tests.shared_builds import with_libraries

ODD = 'θ ≥ 0 "quoted" \\ %s%n ??/ \U0001f41f \x01 */'


class Kind(IntEnum):
    LOW = 0
    HIGH = 31


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-6, max=10.0)
    kind: Kind = variable(Kind.LOW, "An enumeration without docstring")


@dataclass(frozen=True)
class State:
    x: float = 1.0


@dataclass(frozen=True)
class Outputs:
    count: int = variable(0, "Ten to the time")
    is_late: bool = variable(False, "Whether time has passed")


def odd_block(**changes: Any) -> Block:
    """No inputs, an integer and a boolean output, and texts that C does not like."""
    block = Block.of_module(
        __name__,
        "Odd",
        ODD.replace("\x01", "*\n/"),
        step=lambda t, h, state, inputs, p, c: State(state.x * 10.0),
        output=lambda t, state, p, c: Outputs(state.x, state.x > 1.0),
        requirements=lambda p, c: ((p.internal_step < 5.0, ODD),),
    )
    return replace(block, **changes)


@pytest.mark.slow
def test_odd_texts_and_types_survive(tmp_path: Path, load: Any) -> None:
    fmu = load(write_fmu(odd_block(), tmp_path)).begin()
    integer, boolean = [fmu.references["count"]], [fmu.references["is_late"]]
    assert (fmu.slave.getInteger(integer), fmu.slave.getBoolean(boolean)) == ([1], [0])
    fmu.slave.doStep(0.0, 0.1)
    assert (fmu.slave.getInteger(integer), fmu.slave.getBoolean(boolean)) == ([10], [1])
    fmu["internal_step"] = 6.0
    assert fmu.status("doStep", 0.1, 0.1) == "error"
    assert fmu.log[-1].endswith("expected " + ODD.replace("%", "%%"))


def test_an_integer_output_that_does_not_fit_discards_the_step(tmp_path: Path, load: Any) -> None:
    """A double that no C int holds must not be cast to one."""
    fmu = load(write_fmu(odd_block(), tmp_path)).begin()
    for i in range(9):
        fmu.slave.doStep(0.1 * i, 0.1)
    assert fmu.slave.getInteger([fmu.references["count"]]) == [10**9]
    assert fmu.status("doStep", 0.9, 0.1) == "discard"
    assert fmu.slave.getInteger([fmu.references["count"]]) == [10**9]
    assert 2 ** (8 * ctypes.sizeof(ctypes.c_int) - 1) < 10**10


def test_items_beyond_a_word_are_refused() -> None:
    class Wide(IntEnum):
        FAR = 32

    @dataclass(frozen=True)
    class Far:
        internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-6, max=10.0)
        kind: Wide = variable(Wide.FAR, "An enumeration")

    with pytest.raises(ExportError, match=r"kind: items \[32\]: expected numbers from 0 to 31"):
        native_members(trace(odd_block(parameters=Far, requirements=lambda p, c: ())))


def write_fmu(block: Block, folder: Path) -> Path:
    _, members = native_members(trace(block))
    return write_archive(folder / f"{block.name}.fmu", with_libraries(block.name, members))
