"""An Integer, Boolean or Enumeration is given as one; a function that gives another number is refused."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import pytest

from fmus.block import Block, variable
from fmus.block.instance import BlockError, BlockInstance
from fmus.errors import ExportError
from fmus.generate.trace import trace
from fmus.generate.verify import check_trace
from fmus.numerics import floor, where


class Gear(IntEnum):
    """A choice with a gap."""

    LOW = 1
    HIGH = 3


@dataclass(frozen=True)
class Parameters:
    gain: float = variable(1.5, "Gain", min=0.5, max=2.0)


@dataclass(frozen=True)
class Calculated:
    number: int = variable(0, "Number")


@dataclass(frozen=True)
class State:
    x: float = 0.0


@dataclass(frozen=True)
class GearState:
    gear: Gear = Gear.LOW


@dataclass(frozen=True)
class Outputs:
    count: int = variable(0, "Count")
    is_on: bool = variable(False, "On")
    gear: Gear = variable(Gear.LOW, "Gear")


def outputs_of(x: Any) -> Outputs:
    """Floats that are the whole numbers declared."""
    return Outputs(floor(x), where(x > 1.0, 1.0, 0.0), where(x > 1.0, 3.0, 1.0))  # type: ignore[arg-type]


def block_of(outputs: Callable[[Any], Outputs] = outputs_of, number: Callable[[Any], Any] = floor) -> Block:
    return Block(
        name="Whole",
        description="Whole numbers from a number",
        parameters=Parameters,
        calculated=Calculated,
        state=State,
        outputs=Outputs,
        calculate=lambda p: Calculated(number(p.gain)),
        output=lambda t, s, p, c: outputs(s.x),
        step=lambda t, h, s, u, p, c: State(s.x + 0.7),
    )


def test_floats_that_are_whole_numbers_are_given_in_the_declared_types() -> None:
    block = block_of()
    check_trace(trace(block))
    instance = BlockInstance(block)
    instance.exit_initialization_mode()
    instance.do_step(0.0, block.step_size)
    instance.do_step(block.step_size, block.step_size)
    given = [instance.get(v.value_reference) for v in block.variables if not v.settable]
    assert given == [1, 1, True, Gear.HIGH]
    assert list(map(type, given)) == [int, int, bool, Gear]


REFUSED: Any = [
    (block_of(Outputs), "output gives count = ", "a whole number, as Outputs declares it with 0;"),
    (
        block_of(lambda x: Outputs(is_on=2.0 + floor(x))),
        "output gives is_on = ",
        "0 or 1, as Outputs declares it",
    ),
    (
        block_of(lambda x: Outputs(gear=floor(x))),
        "output gives gear = 0.0",
        "one of 1 (low), 3 (high), as Out",
    ),
    (
        block_of(number=lambda g: 0.3 * g),
        "calculate gives number = ",
        "a whole number, as Calculated declares",
    ),
]


@pytest.mark.parametrize(("block", "got", "expected"), REFUSED)
def test_another_number_is_refused_with_function_and_name(block: Block, got: str, expected: str) -> None:
    with pytest.raises(ExportError, match=f"py:[0-9]+: {re.escape(got)}.*expected {re.escape(expected)}"):
        check_trace(trace(block))


@dataclass(frozen=True)
class CountState:
    x: int = 0


@dataclass(frozen=True)
class SwitchState:
    x: bool = False


@pytest.mark.parametrize(
    ("state", "step", "message"),
    [
        (GearState, lambda s: GearState(s.gear + 1), "gear = 2: expected one of 1 (low), 3 (high)"),
        (CountState, lambda s: CountState(s.x + 0.5), "expected a whole number, as CountState declares it"),
        (SwitchState, lambda s: SwitchState(0.5 + s.x), "expected 0 or 1, as SwitchState declares it"),
    ],
)
def test_a_state_of_another_number_is_refused(state: Any, step: Callable[[Any], Any], message: str) -> None:
    block = Block("States", "States", state=state, outputs=Outputs, output=lambda *_: Outputs())
    block = replace(block, step=lambda t, h, s, u, p, c: step(s))
    with pytest.raises(ExportError, match=re.escape(message)):
        check_trace(trace(block))


def test_a_number_reached_later_that_is_no_item_refuses_the_step_and_keeps_the_state() -> None:
    instance = BlockInstance(block_of(lambda x: Outputs(gear=where(x > 1.0, 2, 1))))  # type: ignore[arg-type]
    instance.exit_initialization_mode()
    instance.do_step(0.0, 0.01)
    before = instance.snapshot()
    with pytest.raises(BlockError, match=r"gear = 2: expected one of 1 \(low\), 3 \(high\)"):
        instance.do_step(0.01, 0.01)
    assert instance.snapshot() == before
