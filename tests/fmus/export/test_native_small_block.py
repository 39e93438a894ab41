"""What the C layer computes and refuses, against closed forms and by marks in the bytes of a state."""

import math
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.export import toolchain
from fmus.export.c_source import c_sources

from .native_block import EVERYTHING
from .native_model import DISCARD, ERROR, LAST_TIME, OK, WARNING
from .native_session import GUID, Session, begin, saved, stepping, told, with_checksum

REFERENCES = {v.name: v.value_reference for v in EVERYTHING.variables}
FIRST_WORD = 16 + len(GUID)  # of a serialised state: magic, format and GUID come before


@pytest.fixture
def session(open_session: Callable[[str], Session]) -> Session:
    return open_session(EVERYTHING.name)


def write(session: Session, **values: float) -> int:
    """Set Reals; the status."""
    references = [REFERENCES[name] for name in values]
    return session("set", 0, "R", references, [float(value) for value in values.values()]).status


def read(session: Session, *names: str) -> list[float]:
    answer = session("get", 0, "R", [REFERENCES[name] for name in names], "+")
    assert answer.status == OK
    return [float.fromhex(value) for value in answer.values]


def step(session: Session, t: float, h: float) -> int:
    return session("step", 0, t, h).status


def internal_steps(session: Session) -> int:
    return int(float.fromhex(session("get", 0, "I", [REFERENCES["steps"]], "+").values[0]))


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


def test_a_step_may_pass_the_stop_time_by_rounding_and_by_no_more(session: Session) -> None:
    assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
    assert session("setup", 0, 0.0, True, 0.3).status == OK
    session("enter", 0)
    session("leave", 0)
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
    assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
    assert session("setup", 0, time, False, 0.0).status == OK
    session("enter", 0)
    session("leave", 0)
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


def test_the_sign_of_a_zero_is_set(session: Session) -> None:
    stepping(session)
    for value in (0.0, -0.0, 0.0):
        assert write(session, force=value) == OK
        assert math.copysign(1.0, read(session, "force")[0]) == math.copysign(1.0, value)


def test_output_derivatives_follow_parameters_and_inputs_that_have_just_been_set(session: Session) -> None:
    """y = gain limit x, so y' = gain limit (force valve + 1 - gain / limit x + t), of the present values."""
    stepping(session)
    assert step(session, 0.0, 0.1) == OK
    x = read(session, "y")[0] / 8.0
    assert write(session, limit=5.0, force=2.0, valve=0.25) == OK
    rate = 2.0 * 0.25 + 1.0 - 0.4 * x + 0.1
    references = [REFERENCES["y"], REFERENCES["square"], REFERENCES["y"]]
    answer = session("get_output_derivatives", 0, references, [1, 1, 1], "+")
    expected = [10.0 * rate, 2.0 * x * rate + 1.0, 10.0 * rate]
    assert [float.fromhex(v) for v in answer.values] == pytest.approx(expected, rel=1e-14)
    assert read(session, "y", "product") == [8.0 * x, 8.0]  # of the last step, until the next one


def test_contradictory_parameters_are_an_error_of_steps_and_derivatives_that_names_the_requirement(
    session: Session,
) -> None:
    stepping(session)
    assert session("get_state", 0, 0).status == OK
    for values, expected in (
        ({"gain": 9.0, "limit": 9.0}, "gain below limit"),
        ({"gain": -20.0}, "gain limit above -50"),
    ):
        for call in (("get_output_derivatives", 0, [REFERENCES["y"]], [1], "+"), ("step", 0, 0.0, 0.1)):
            assert write(session, **values) == OK
            answer = session(*call)
            assert answer.status == ERROR
            assert told(answer).endswith(f"parameters of Everything: expected {expected}")
            assert session("set_state", 0, 0).status == OK
    assert session("free_state", 0, 0).status == OK
    assert step(session, 0.0, 0.1) == OK


def test_a_known_that_is_named_twice_counts_twice(session: Session) -> None:
    """In both modes; d(product) = limit d(gain) + gain d(limit)."""
    begin(session)
    gain, limit, product = (REFERENCES[name] for name in ("gain", "limit", "product"))
    for mode in ("initialization", "step"):
        answer = session("directional_derivative", 0, [product], [gain, limit, gain], [1.0, 10.0, 2.0], "+")
        assert [float.fromhex(v) for v in answer.values] == [4.0 * 3.0 + 2.0 * 10.0], mode
        session("leave", 0)


def test_contradictory_parameters_are_an_error_of_derivatives_of_the_initialisation(session: Session) -> None:
    begin(session)
    assert write(session, gain=4.0) == OK
    references = [REFERENCES["product"]], [REFERENCES["gain"]]
    answer = session("directional_derivative", 0, *references, [1.0], "+")
    assert (answer.status, answer.values) == (ERROR, ["untouched"])
    assert told(answer).endswith("expected gain below limit")


def test_derivatives_by_inputs_are_those_of_the_mode(session: Session) -> None:
    """x = start + force in initialisation mode; later no output depends directly on an input."""
    begin(session)
    arguments = [REFERENCES["y"], REFERENCES["square"]], [REFERENCES["force"], REFERENCES["start"]]
    answer = session("directional_derivative", 0, *arguments, [1.0, 0.0], "+")
    assert [float.fromhex(v) for v in answer.values] == [8.0, 2.0]
    assert session("leave", 0).status == OK
    for _ in range(2):  # while stepping, then terminated
        answer = session("directional_derivative", 0, *arguments, [1.0, 1.0], "+")
        assert [float.fromhex(v) for v in answer.values] == [0.0, 0.0]
        rates = session("get_output_derivatives", 0, [REFERENCES["square"]], [1], "+").values
        assert [float.fromhex(v) for v in rates] == [2.0]  # 2 x x' + 1, x' = 1 - ratio x
        assert (session("get_status", 0, "R", LAST_TIME, "+").values) == ["0x0p+0"]
        session("terminate", 0)


def test_a_derivative_of_higher_order_is_0_of_an_output_and_left_out_of_an_input(session: Session) -> None:
    """FMI 2.0.5, 4.2.1: above the order that is provided, the retrieved value is 0."""
    stepping(session)
    outputs = [REFERENCES["y"], REFERENCES["square"]]
    first = session("get_output_derivatives", 0, outputs, [1, 1], "+").values
    assert session("get_output_derivatives", 0, outputs, [2, 1], "+").values == ["0x0p+0", first[1]]
    inputs = [REFERENCES["force"]] * 2
    answer = session("set_input_derivatives", 0, inputs, [1, 2], [10.0, -5.0])
    assert answer.status == WARNING
    assert told(answer).endswith("force: order 2 is left out: expected 1")
    assert step(session, 0.0, 0.1) == OK
    assert read(session, "y")[0] == pytest.approx(
        8.0 * (1.0 + 0.1 * (10.0 * 0.05 * 0.5 + 1.0 - 0.5)), rel=1e-15
    )


@pytest.mark.parametrize("order", [0, -1])
def test_a_derivative_has_an_order_of_at_least_1(session: Session, order: int) -> None:
    for call in (
        ("set_input_derivatives", 0, [REFERENCES["force"]], [order], [1.0]),
        ("get_output_derivatives", 0, [REFERENCES["y"]], [order], "+"),
    ):
        stepping(session)
        answer = session(*call)
        assert answer.status == ERROR
        assert told(answer).endswith(f"order {order}: expected at least 1")
        session("free", 0)


def test_setting_no_derivatives_changes_nothing(session: Session) -> None:
    stepping(session)
    before = saved(session)
    assert session("set_input_derivatives", 0, [], [], []).status == OK
    assert saved(session) == before


def test_an_output_that_no_integer_holds_discards_the_step(session: Session) -> None:
    begin(session)
    assert session("set", 0, "I", [REFERENCES["count"]], [2**31 - 2]).status == OK
    assert session("leave", 0).status == OK
    assert step(session, 0.0, 0.1) == OK
    assert internal_steps(session) == 2**31 - 1
    assert "not finite any more" in told(session("step", 0, 0.1, 0.1))
    assert internal_steps(session) == 2**31 - 1


def test_a_refused_step_leaves_rates_and_the_next_one_uses_them(session: Session) -> None:
    stepping(session)
    assert session("set_input_derivatives", 0, [REFERENCES["force"]], [1], [10.0]).status == OK
    assert write(session, limit=1e308) == OK
    assert step(session, 0.0, 0.1) == DISCARD
    assert write(session, limit=4.0) == OK
    assert step(session, 0.0, 0.1) == OK
    x = 1.0 + 0.1 * (10.0 * 0.05 * 0.5 + 1.0 - 0.5)
    assert read(session, "y")[0] == pytest.approx(8.0 * x, rel=1e-15)


def test_a_rate_ends_with_its_step_also_where_another_input_gets_one_then(session: Session) -> None:
    stepping(session)
    force, valve = REFERENCES["force"], REFERENCES["valve"]
    assert session("set_input_derivatives", 0, [force, valve], [1, 1], [10.0, 1.0]).status == OK
    assert step(session, 0.0, 0.1) == OK
    assert session("set_input_derivatives", 0, [valve], [1], [1.0]).status == OK
    assert step(session, 0.1, 0.1) == OK
    x = 0.95 * 1.0 + 0.1 * (10.0 * 0.05 * 0.55 + 1.0)
    x = 0.95 * x + 0.1 * (1.0 + 0.1)  # the force is 0 again
    assert read(session, "y")[0] == pytest.approx(8.0 * x, rel=1e-14)


@pytest.mark.parametrize(("rate", "limit"), [(20.0, 1.0), (-20.0, 0.0)])
def test_an_input_with_a_rate_stays_within_its_range(session: Session, rate: float, limit: float) -> None:
    stepping(session)
    assert write(session, force=2.0) == OK
    assert session("set_input_derivatives", 0, [REFERENCES["valve"]], [1], [rate]).status == OK
    assert step(session, 0.0, 0.1) == OK
    assert read(session, "y")[0] == pytest.approx(8.0 * (0.95 + 0.1 * (2.0 * limit + 1.0)), rel=1e-14)


MARK = 1.2345678901234567e77
TAKEN = [0.5, -1e300, 0.0]
NEVER_FINITE = [math.nan, math.inf, -math.inf]


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


def _marked_output(session: Session) -> None:
    begin(session)
    assert write(session, gain=0.5, limit=2.0, start=MARK) == OK
    assert session("leave", 0).status == OK
    assert step(session, 0.0, 1e-3) == OK


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
        ("gain", (-100.0, 100.0), (-100.1, 100.1, math.nan)),
        ("mode", (0.0, 3.0), (1.0, 2.0, 4.0, -1.0, math.nan)),
        ("enabled", (0.0, 1.0), (2.0, -1.0)),
        ("count", (-(2.0**31 - 1), 2.0**31 - 2), (2.0**31 - 1, -(2.0**31))),
        ("level", (-5.0, 5.0), (-6.0, 6.0)),
        ("steps", (-(2.0**31 - 1), 2.0**31 - 1), (2.0**31, -(2.0**31), math.nan)),
        ("high", (0.0, 1.0), (0.5, 2.0, -1.0, 3e9, math.inf)),
        ("y", (1e308,), (math.nan, math.inf)),
        ("square", (1e308,), (math.nan, -math.inf)),
    ):
        for number in (*good, *bad):
            position = first_value + 8 * REFERENCES[name]
            is_taken = _forged(session, content, position, struct.pack("<d", number))
            assert is_taken is (number in good), (name, number)


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


_COMMA = """
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int print(char *text, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    const int length = vsnprintf(text, size, format, arguments);
    va_end(arguments);
    for (char *c = text; *c; c++) *c = *c == '.' ? ',' : *c;
    return length;
}

static double read(const char *text, char **end) {
    char plain[64];
    strcpy(plain, text);
    for (char *c = plain; *c; c++) *c = *c == ',' ? '.' : *c;
    return strtod(plain, end);
}

#define snprintf print
#define strtod read
#include "log.h"

int main(int count, char **texts) {
    for (int i = 1; i < count; i++) puts(DECIMAL(read(texts[i], NULL)));
    return log_category("logAll") != LOG_ALL;
}
"""


def test_numbers_in_messages_are_the_shortest_with_a_point_also_where_the_host_prints_commas(
    tmp_path: Path,
) -> None:
    for name, text in (c_sources(EVERYTHING, GUID) | {"comma.c": _COMMA}).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    toolchain.zig(
        ["cc", *toolchain.FLAGS, "-I", str(toolchain.FMI_HEADERS), "-o", "comma", "comma.c"], tmp_path
    )
    numbers = ["0.5", "0.1", "1e-07", "0.30000000000000004", "-1.7976931348623157e+308", "3", "nan", "inf"]
    command = [str(tmp_path / "comma"), *numbers]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() == numbers
