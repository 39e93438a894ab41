"""What the steps of the C layer compute and refuse, against closed forms."""

import math
from collections.abc import Callable

import pytest

from .native_block import EVERYTHING
from .native_model import ERROR, LAST_TIME, OK
from .native_session import (
    GUID,
    REFERENCES,
    Session,
    begin,
    internal_steps,
    read,
    step,
    stepping,
    told,
    write,
)


@pytest.fixture
def session(open_session: Callable[[str], Session]) -> Session:
    return open_session(EVERYTHING.name)


@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (0.5, 1),
        (1.0, 1),
        (1.0 + 1e-10, 1),
        (1.0 + 1e-8, 2),
        (3.0 - 1e-8, 3),
        (3.0 * (1.0 + 1e-10), 3),
        (3.0 * (1.0 + 1e-8), 4),
        (4.4, 5),
    ],
)
def test_a_step_is_divided_into_the_fewest_internal_steps_up_to_rounding(
    session: Session, length: float, expected: int
) -> None:
    """The length is that of the communication step in internal steps of 0.1 s; 1e-9 of it is rounding."""
    assert step(stepping(session), 0.0, 0.1 * length) == OK
    assert internal_steps(session) == expected


def test_internal_steps_are_equal_and_inputs_move_through_their_middles(session: Session) -> None:
    """x' = t + force valve + 1 - ratio x, three explicit steps by hand."""
    stepping(session)
    assert write(session, force=2.0, valve=0.9) == OK
    references = [REFERENCES["force"], REFERENCES["valve"]]
    assert session("set_input_derivatives", 0, references, [1, 1], [1.0, 2.0]).status == OK
    assert step(session, 0.0, 0.24) == OK
    x, h = 1.0, 0.24 / 3
    for i in range(3):
        t = (i + 0.5) * h
        x += h * ((2.0 + t) * min(0.9 + 2.0 * t, 1.0) + 1.0 - 0.5 * x + i * h)
    assert read(session, "y")[0] == pytest.approx(8.0 * x, rel=1e-15)  # roundings of a sum
    assert step(session, 0.24, 0.1) == OK  # the rates held for one step
    x += 0.1 * (2.0 * 0.9 + 1.0 - 0.5 * x + 0.24)
    assert read(session, "y")[0] == pytest.approx(8.0 * x, rel=1e-15)


def test_the_start_time_reaches_outputs_that_were_read_before(session: Session) -> None:
    """square = x^2 + t."""
    session("instantiate", 0, "it", 1, GUID, "all", True)
    assert read(session, "square") == [1.0]
    assert session("setup", 0, 2.0, False, 0.0).status == OK
    assert read(session, "square") == [3.0]


def test_a_step_may_pass_the_stop_time_by_rounding_and_by_no_more(session: Session) -> None:
    stepping(session, stop=0.3)
    for t in (0.0, 0.1, 0.2):
        assert step(session, t, 0.1) == OK
    assert 0.2 + 0.1 > 0.3
    assert told(session("step", 0, 0.3, 1e-6)).endswith("expected at most the stop time 0.3 s")


def test_a_reset_ends_the_stop_time(session: Session) -> None:
    assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
    assert session("setup", 0, 0.0, True, 0.3).status == OK
    assert session("reset", 0).status == OK
    session("enter", 0)  # without a setup, which would set it anew
    session("leave", 0)
    assert step(session, 0.0, 0.4) == OK


@pytest.mark.parametrize(
    ("time", "h", "late", "status"),
    [
        (0.0, 0.1, 0.9e-9, OK),
        (0.0, 0.1, 1.1e-9, ERROR),
        (0.0, 1e-7, 0.9e-10, OK),
        (0.0, 1e-7, 1.1e-10, ERROR),
        (1e6, 10.0, 0.9e-3, OK),
        (1e6, 10.0, 1.1e-3, ERROR),
        (1e6, 1e-8, 1.6e-9, OK),
        (1e6, 1e-8, 2.0e-9, ERROR),
    ],
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_communication_point_may_differ_by_a_part_of_the_time_and_the_step_and_by_rounding(
    session: Session, time: float, h: float, late: float, status: int, side: float
) -> None:
    """1e-9 of the time, or of 1 s if that is more, at most 1e-3 of the step; and 8 epsilon of the time."""
    stepping(session, time)
    assert step(session, time + side * late, h) == status


def test_time_goes_on_from_the_importers_communication_point(session: Session) -> None:
    """Which may differ from the time of the FMU by rounding."""
    stepping(session)
    assert step(session, 0.0, 0.1) == OK
    point = 0.1 + 1e-12
    assert step(session, point, 0.1) == OK
    answer = session("get_status", 0, "R", LAST_TIME, "+")
    assert float.fromhex(answer.values[0]) == point + 0.1 != 0.2
    square, y = read(session, "square", "y")
    assert square == (y / 8.0) ** 2 + point + 0.1


def test_a_step_follows_the_parameters_that_are_set_restored_and_reset(session: Session) -> None:
    """x' = (1 while the mode is RUN) - gain / limit x + t. A step needs what is kept of them."""

    def reached(t: float, rests: bool, h: float = 0.1) -> float:
        x = read(session, "y")[0] / 8.0
        assert step(session, t, 0.1) == OK
        assert read(session, "y")[0] == pytest.approx(
            8.0 * (x + 0.1 * (1.0 - rests - 0.5 * x + t)), rel=1e-14
        )
        return read(session, "y")[0]

    stepping(session)
    first, second = reached(0.0, False), reached(0.1, False)
    assert session("get_state", 0, 1).status == OK
    third = reached(0.2, False)
    assert session("set", 0, "I", [REFERENCES["mode"]], [0]).status == OK
    reached(0.3, True)
    assert session("set_state", 0, 1).status == session("free_state", 0, 1).status == OK
    assert read(session, "y") == [second]
    assert reached(0.2, False) == third
    assert session("set", 0, "I", [REFERENCES["mode"]], [0]).status == OK
    reached(0.3, True)
    assert session("reset", 0).status == OK
    for call in ("enter", "leave"):
        assert session(call, 0).status == OK
    assert reached(0.0, False) == first
    reached(0.1, False, h=0.05)


def test_steps_of_more_lengths_than_the_layer_keeps_numbers_for_are_each_of_their_own(
    session: Session,
) -> None:
    """x' = 1 - gain / limit x + t: lengths in turn, and each of them again."""
    stepping(session)
    t, x = 0.0, read(session, "y")[0] / 8.0
    for h in [0.05 + i / 256.0 for i in range(7)] * 3:
        x += h * (1.0 - 0.5 * x + t)
        assert step(session, t, h) == OK
        assert read(session, "y")[0] == pytest.approx(8.0 * x, rel=1e-12)
        t += h


def test_the_sign_of_a_zero_is_set(session: Session) -> None:
    stepping(session)
    for value in (0.0, -0.0, 0.0):
        assert write(session, force=value) == OK
        assert math.copysign(1.0, read(session, "force")[0]) == math.copysign(1.0, value)


def test_an_output_that_no_integer_holds_discards_the_step(session: Session) -> None:
    begin(session)
    assert session("set", 0, "I", [REFERENCES["count"]], [2**31 - 2]).status == OK
    assert session("leave", 0).status == OK
    assert step(session, 0.0, 0.1) == OK
    assert internal_steps(session) == 2**31 - 1
    assert "not finite any more" in told(session("step", 0, 0.1, 0.1))
    assert internal_steps(session) == 2**31 - 1


def test_the_lowest_integer_is_a_value(session: Session) -> None:
    begin(session)
    assert session("set", 0, "I", [REFERENCES["count"]], [-(2**31)]).status == OK
    assert internal_steps(session) == -(2**31)
