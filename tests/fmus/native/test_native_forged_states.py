"""A serialised state with forged words and a good checksum is taken only if an instance can have it."""

import math
import struct
from collections.abc import Callable

import pytest

from .native_block import EVERYTHING
from .native_model import ERROR, OK
from .native_session import (
    GUID,
    REFERENCES,
    Session,
    begin,
    read,
    saved,
    step,
    stepping,
    told,
    with_checksum,
    write,
)

FIRST_WORD = 16 + len(GUID)  # of a serialised state: magic, format and GUID come before
MARK = 1.2345678901234567e77
TAKEN = [0.5, -1e300, 0.0]
NEVER_FINITE = [math.nan, math.inf, -math.inf]


@pytest.fixture
def session(open_session: Callable[[str], Session]) -> Session:
    return open_session(EVERYTHING.name)


def _marked_rate(session: Session) -> None:
    stepping(session)
    assert session("set_input_derivatives", 0, [REFERENCES["force"]], [1], [MARK]).status == OK


def _marked_input(session: Session) -> None:
    assert write(stepping(session), force=MARK) == OK


def _marked_time(session: Session) -> None:
    assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
    assert session("setup", 0, MARK, False, 0.0).status == OK


def _marked_state(session: Session) -> None:
    begin(session)
    assert write(session, start=0.0, force=MARK) == OK
    assert session("leave", 0).status == OK
    assert write(session, force=0.0) == OK


@pytest.mark.parametrize(
    ("marked", "words", "refused"),
    [
        (_marked_rate, TAKEN, NEVER_FINITE),
        (_marked_input, TAKEN, NEVER_FINITE),
        (_marked_time, TAKEN, NEVER_FINITE),
        (_marked_state, TAKEN, NEVER_FINITE),
    ],
)
def test_a_forged_number_that_is_not_finite_is_refused(
    session: Session, marked: Callable[[Session], None], words: list[float], refused: list[float]
) -> None:
    """With a good checksum, at each place that holds the mark."""
    marked(session)
    content = bytes(saved(session))
    mark = struct.pack("<d", MARK)
    places = [i for i in range(FIRST_WORD, len(content) - 8, 8) if content[i : i + 8] == mark]
    assert places
    for position in places:
        for word in (*words, *refused):
            assert _forged(session, content, position, struct.pack("<d", word)) is (word in words)


def test_forged_flags_values_and_outputs_that_no_instance_has_are_refused(session: Session) -> None:
    """The first words are mode and three flags; then time and the values by value reference."""
    content = bytes(saved(stepping(session)))
    assert struct.unpack_from("<4q", content, FIRST_WORD) == (4, 0, 0, 0)  # nothing is stale while stepping
    first_value = FIRST_WORD + 8 * 5
    for word in range(4):
        for number in (0, 1, 2, 3, 4, 5, 8, 16, 24, 32, -1):
            is_mode = number in (1, 2, 4, 8, 16)
            good = is_mode if word == 0 else number in (0, 1)
            assert _forged(session, content, FIRST_WORD + 8 * word, struct.pack("<q", number)) is good
    for name, good, bad in (
        ("internal_step", (1e-3, 10.0), (0.0, 11.0)),
        ("gain", (-100.0, 100.0), (-100.1, 100.1, math.nan)),
        ("mode", (0.0, 3.0), (1.0, 2.0, 4.0, -1.0, math.nan)),
        ("enabled", (0.0, 1.0), (2.0, -1.0)),
        ("count", (-(2.0**31), 2.0**31 - 2), (2.0**31 - 1, -(2.0**31) - 1)),
        ("level", (-5.0, 5.0), (-6.0, 6.0)),
        ("steps", (-(2.0**31), 2.0**31 - 1), (2.0**31, -(2.0**31) - 1, math.nan)),
        ("high", (0.0, 1.0), (0.5, 2.0, -1.0, 3e9, math.inf)),
        ("y", (1e308,), (math.nan, math.inf)),
        ("square", (1e308,), (math.nan, -math.inf)),
    ):
        for number in (*good, *bad):
            position = first_value + 8 * REFERENCES[name]
            is_taken = _forged(session, content, position, struct.pack("<d", number))
            assert is_taken is (number in good), (name, number)


def test_forged_words_of_model_exchange_that_no_instance_has_are_refused(session: Session) -> None:
    """The last words: interface, number of steps, start time, inputs of the present step and one to spare."""
    content = bytes(saved(stepping(session)))
    n_words = 3 + len(EVERYTHING.of_causality("input")) + 1
    first = len(content) - 8 - 8 * n_words  # before the checksum
    assert struct.unpack_from("<2q", content, first) == (0, 0)
    for word, kind, good, bad in (
        (0, "q", (0,), (1, 2, 3, -1)),  # of model exchange no instance is in step mode
        (1, "q", (0, 5), (-1, 2**53, 2**63 - 1)),
        (2, "d", (0.0, -2.5), NEVER_FINITE),
        (3, "d", (0.0, 1e300), NEVER_FINITE),
    ):
        for number in (*good, *bad):
            is_taken = _forged(session, content, first + 8 * word, struct.pack(f"<{kind}", number))
            assert is_taken is (number in good), (word, number)


def _forged(session: Session, content: bytes, position: int, word: bytes) -> bool:
    """Whether the bytes are taken with another word at a place; the instance is as before then."""
    session("get_state", 0, 1)
    forged = with_checksum(content[:position] + word + content[position + 8 : -8])
    answer = session("deserialize", 0, list(forged), 0)
    assert answer.status in (OK, ERROR)
    if answer.status == ERROR:
        assert told(answer) == "fmi2DeSerializeFMUstate: the state is none that this FMU can have"
    assert session("set_state", 0, 1).status == OK
    session("free_state", 0, 0)
    session("free_state", 0, 1)
    return answer.status == OK


def test_a_state_whose_parameters_were_just_set_can_be_restored_from_its_bytes(session: Session) -> None:
    stepping(session)
    assert write(session, gain=3.0) == OK
    content = saved(session)
    assert session("reset", 0).status == OK
    assert session("deserialize", 0, content, 1).status == OK
    assert session("set_state", 0, 1).status == OK
    assert session("free_state", 0, 1).status == OK
    assert step(session, 0.0, 0.1) == OK
    assert read(session, "product") == [12.0]
