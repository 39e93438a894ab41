"""An Enumeration or Boolean is one of its items in both flavours, or the step is refused."""

import re
from collections.abc import Callable

import pytest

from fmus.block.instance import BlockError, BlockInstance

from .native_block import ITEMS
from .native_model import DISCARD, ERROR, OK
from .native_session import Session, begin, refused, saved, told

REFERENCES = {v.name: v.value_reference for v in ITEMS.variables}
PARAMETER, INPUT, MODE, IS_ON = (REFERENCES[name] for name in ("choice", "choose", "mode", "is_on"))
NAMES_OF_MODE = r"expected one of 0 \(rest\), 3 \(run\)"
NAMES_OF_BOOLEAN = r"expected 0 \(false\) or 1 \(true\)"


@pytest.fixture
def session(open_session: Callable[[str], Session]) -> Session:
    return begin(open_session(ITEMS.name))


@pytest.fixture
def instance() -> BlockInstance:
    return BlockInstance(ITEMS)


def outputs(session: Session) -> list[int]:
    return [
        int(float.fromhex(session("get", 0, kind, [reference], "+").values[0]))
        for kind, reference in (("I", MODE), ("B", IS_ON))
    ]


@pytest.mark.parametrize(
    ("choice", "expected"), [(1003.0, [3, 0]), (1000.0, [0, 0]), (-1001.0, [0, 1]), (-1000.0, [0, 0])]
)
def test_items_are_given(
    session: Session, instance: BlockInstance, choice: float, expected: list[int]
) -> None:
    session("leave", 0)
    instance.exit_initialization_mode()
    assert session("set", 0, "R", [INPUT], [choice]).status == OK
    instance.set(INPUT, choice)
    assert session("step", 0, 0.0, 0.01).status == OK
    instance.do_step(0.0, 0.01)
    assert outputs(session) == expected == [instance.get(MODE), instance.get(IS_ON)]


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        (1001.0, f"mode .*: {NAMES_OF_MODE}"),
        (1002.5, f"mode .*: {NAMES_OF_MODE}"),
        (1032.0, f"mode .*: {NAMES_OF_MODE}"),
        (-1000.5, f"is_on .*: {NAMES_OF_BOOLEAN}"),
        (-1002.0, f"is_on .*: {NAMES_OF_BOOLEAN}"),
    ],
)
def test_a_step_to_another_number_is_discarded_and_the_state_stays(
    session: Session, instance: BlockInstance, choice: float, message: str
) -> None:
    session("leave", 0)
    instance.exit_initialization_mode()
    assert session("set", 0, "R", [INPUT], [choice]).status == OK
    instance.set(INPUT, choice)
    before, snapshot = saved(session), instance.snapshot()
    assert re.search(message, refused(session("step", 0, 0.0, 0.01), DISCARD))
    with pytest.raises(BlockError, match=message):
        instance.do_step(0.0, 0.01)
    assert (saved(session), instance.snapshot()) == (before, snapshot)


def test_a_calculated_parameter_that_is_no_item_ends_the_initialisation(
    session: Session, instance: BlockInstance
) -> None:
    assert session("set", 0, "R", [PARAMETER], [1001.0]).status == OK
    instance.set(PARAMETER, 1001.0)
    answer = session("leave", 0)
    assert answer.status == ERROR
    assert told(answer).endswith("chosen is another number: expected one of 0 (rest), 3 (run)")
    with pytest.raises(BlockError, match=f"chosen = 1.0: {NAMES_OF_MODE}"):
        instance.exit_initialization_mode()
    session("free", 0)
    begin(session)
    assert session("set", 0, "R", [PARAMETER], [1003.0]).status == OK
    assert session("leave", 0).status == OK
