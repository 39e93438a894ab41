"""A saved state of the native FMU is all of it; bytes that no instance of it can have are refused."""

import math
import re
import struct
from collections.abc import Callable

import pytest

from .blocks import EVERYTHING
from .conftest import Open
from .session import ERROR, FIRST_WORD, GUID, LAST_TIME, OK, Session, with_checksum

NEVER_FINITE = (math.nan, math.inf, -math.inf)
MARK = 1.2345678901234567e77


def deserialized(session: Session, content: bytes) -> None:
    """Goes on from the bytes of a saved state."""
    for call in (("deserialize", content, 1), ("set_state", 1), ("free_state", 1)):
        assert session(*call).status == OK


def test_another_process_goes_on_from_the_bytes(open_session: Open) -> None:
    one, other = open_session("RovDepthPlant").stepping(), open_session("RovDepthPlant").instantiate()
    real = [v.name for v in (*one.block.variables, *one.block.states) if v.type == "Real"]
    assert one.set(**{"voltage[1]": 2.0}) == one.step(0.0, 0.02) == OK
    deserialized(other, one.saved())
    assert one.step(0.02, 0.02) == other.step(0.02, 0.02) == OK
    assert other.get(*real) == one.get(*real)
    assert other.saved() == one.saved()


def test_a_state_whose_parameters_were_just_set_can_be_restored_from_its_bytes(session: Session) -> None:
    assert session.stepping().set(gain=3.0) == OK
    content = session.saved()
    assert session("reset").status == OK
    deserialized(session, content)
    assert session.step(0.0, 0.1) == OK
    assert session.get("product") == [12.0]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[:-1], "wrong size"),
        (lambda data: b"", "not a serialized state"),
        (lambda data: b"x" + data[1:], "not a serialized state"),
        (lambda data: data[:8] + b"\x01" + data[9:], "another version's format"),
        (lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:], "damaged"),
        (lambda data: with_checksum(data[:16] + b"x" * len(GUID) + data[FIRST_WORD:-8]), "another FMU's"),
    ],
)
def test_bytes_that_are_not_this_fmus_are_refused(
    plant: Session, damage: Callable[[bytes], bytes], message: str
) -> None:
    assert plant.stepping().step(0.0, 0.02) == OK
    content = plant.saved()
    with plant.kept():
        assert message in plant.refused("deserialize", damage(content), 0)
    assert plant.saved() == content


def test_a_restored_state_leaves_the_stop_time_of_the_setup(plant: Session, open_session: Open) -> None:
    """Wherever the state is from: the end is what the importer said to this instance."""
    with plant.instantiate().kept():
        assert plant("setup", 0.0, True, 1.0).status == OK
    assert plant("enter").status == plant("leave").status == OK
    with plant.kept():
        text = plant.refused("step", 0.0, 1.1)
        assert text == "fmi2DoStep: step to 1.1 s: expected at most the stop time 1 s"
    assert plant("get_state", 0).status == plant.step(0.0, 1.0) == OK
    never_set_up = open_session("ExamplePlant").instantiate()
    deserialized(never_set_up, plant.saved())
    assert never_set_up.step(1.0, 1e3) == OK
    for call in (("reset",), ("set_state", 0), ("free_state", 0), ("step", 0.0, 1.1)):
        assert plant(*call).status == OK


# forged words with a good checksum


def is_taken(session: Session, content: bytes, position: int, word: bytes) -> bool:
    """Whether bytes with another word at a place are a state; the instance is as before then."""
    with session.kept():
        forged = with_checksum(content[:position] + word + content[position + 8 : -8])
        answer = session("deserialize", forged, 0)
        if answer.status == OK:
            use(session)
            session("free_state", 0)
        else:
            assert answer.status == ERROR
            (message,) = answer.messages
            text = message.text.removeprefix("fmi2DeSerializeFMUstate: ")
            assert re.fullmatch(r"this FMU cannot have such a state|(x|steps|side) = \S+: expected .+", text)
    return answer.status == OK


def use(session: Session) -> None:
    """With a state that is taken the instance can go on: nothing ends the process."""
    session("set_state", 0)
    for kind, types in (("R", "Real"), ("I", "Enumeration")):
        references = [v.value_reference for v in EVERYTHING.variables if v.type == types]
        session("get", kind, references, "+")
    time = session("get_status", "R", LAST_TIME, "+")
    if time.status == OK:
        session.step(time.numbers[0], 0.001)


def test_forged_bytes_do_no_harm(session: Session) -> None:
    content = session.stepping().saved()
    numbers = (math.nan, -math.inf, 1e308, 0.5, 3e9, -1.0)
    words = *(struct.pack("<d", x) for x in numbers), b"\xff" * 8, b"\x05" + bytes(7)
    places = range(FIRST_WORD, len(content) - 8, 8)
    assert {is_taken(session, content, place, word) for place in places for word in words} == {True, False}


def mark_rate(session: Session) -> None:
    assert session.stepping()("set_input_derivatives", session.of("force"), [1], [MARK]).status == OK


def mark_input(session: Session) -> None:
    assert session.stepping().set(force=MARK) == OK


def mark_time(session: Session) -> None:
    assert session.instantiate()("setup", MARK, False, 0.0).status == OK


def mark_state(session: Session) -> None:
    assert session.begin().set(start=0.0, force=MARK) == session("leave").status == OK
    assert session.set(force=0.0) == OK


@pytest.mark.parametrize("mark", [mark_rate, mark_input, mark_time, mark_state])
def test_a_forged_number_that_is_not_finite_is_refused(
    session: Session, mark: Callable[[Session], None]
) -> None:
    """At each place that holds the mark."""
    mark(session)
    content, marked = session.saved(), struct.pack("<d", MARK)
    places = [i for i in range(FIRST_WORD, len(content) - 8, 8) if content[i : i + 8] == marked]
    assert places
    for place in places:
        for number in (0.5, -1e300, 0.0, *NEVER_FINITE):
            assert is_taken(session, content, place, struct.pack("<d", number)) is math.isfinite(number)


@pytest.mark.parametrize(
    ("index", "number", "reason"),
    [
        (0, math.inf, "x = inf: expected a finite number"),
        (1, 0.5, "steps = 0.5: expected at least -2147483648"),
        (1, -(2.0**31) - 1, "steps = -2147483649: expected at least -2147483648"),
        (1, 2.0**40, None),
        (2, 1.0000000000000002, "side = 1.0000000000000002: expected -1 to 1"),
        (2, -1.0, None),
    ],
)
def test_a_restored_state_out_of_its_range_is_refused_by_name(
    session: Session, index: int, number: float, reason: str | None
) -> None:
    """States follow the values and the rates of inputs; the bytes are a state in no instance yet."""
    content = session.stepping().saved()
    inputs = len(EVERYTHING.of_causality("input"))
    place = FIRST_WORD + 8 * (5 + len(EVERYTHING.variables) + inputs + 1 + index)
    forged = with_checksum(content[:place] + struct.pack("<d", number) + content[place + 8 : -8])
    with session.kept():
        if reason is None:
            assert session("deserialize", forged, 0).status == OK
            assert session("free_state", 0).status == OK
        else:
            assert session.refused("deserialize", forged, 0) == f"fmi2DeSerializeFMUstate: {reason}"


def test_forged_flags_values_and_outputs_that_no_instance_has_are_refused(session: Session) -> None:
    """The first words are mode and three flags; then time and the values by value reference.

    The last are interface, number of steps, start time, inputs of the present step, and one to spare.
    """
    content = session.stepping().saved()
    assert struct.unpack_from("<4q", content, FIRST_WORD) == (4, 0, 0, 0)  # nothing is stale while stepping
    integers = (0, 1, 2, 3, 4, 5, 8, 16, 24, 32, -1)
    last = len(content) - 8 - 8 * (3 + len(EVERYTHING.of_causality("input")) + 1)  # before the checksum
    assert struct.unpack_from("<2q", content, last) == (0, 0)

    def at(name: str) -> int:
        return FIRST_WORD + 8 * (5 + session.references[name])

    for place, kind, good, others in (
        (FIRST_WORD, "q", (1, 2, 4, 8, 16), integers),
        *((FIRST_WORD + 8 * flag, "q", (0, 1), integers) for flag in (1, 2, 3)),
        (at("internal_step"), "d", (1e-3, 10.0), (0.0, 11.0)),
        (at("gain"), "d", (-100.0, 100.0), (-100.1, 100.1, math.nan)),
        (at("mode"), "d", (0.0, 3.0), (1.0, 2.0, 4.0, -1.0, math.nan)),
        (at("enabled"), "d", (0.0, 1.0), (2.0, -1.0)),
        (at("count"), "d", (-(2.0**31), 2.0**31 - 2), (2.0**31 - 1, -(2.0**31) - 1)),
        (at("level"), "d", (-5.0, 5.0), (-6.0, 6.0)),
        (at("steps"), "d", (-(2.0**31), 2.0**31 - 1), (2.0**31, -(2.0**31) - 1, math.nan)),
        (at("high"), "d", (0.0, 1.0), (0.5, 2.0, -1.0, 3e9, math.inf)),
        (at("y"), "d", (1e308,), (math.nan, math.inf)),
        (at("square"), "d", (1e308,), (math.nan, -math.inf)),
        (last, "q", (0,), (1, 2, 3, -1)),  # of model exchange no instance is in step mode
        (last + 8, "q", (0, 5), (-1, 2**53, 2**63 - 1)),
        (last + 16, "d", (0.0, -2.5), NEVER_FINITE),
        (last + 24, "d", (0.0, 1e300), NEVER_FINITE),
    ):
        for number in (*good, *others):
            taken = is_taken(session, content, place, struct.pack(f"<{kind}", number))
            assert taken is (number in good), (place, number)
