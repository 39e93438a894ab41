"""Calls of the native FMU that a random search seldom reaches: poor importers, forged states."""

import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fmus import catalogue
from fmus.export.c_source import c_sources
from fmus.instance import Instance

from .native_model import DISCARD, ERROR, OK, Null
from .native_session import GUID, Answer, Session, compiled

pytestmark = pytest.mark.cross


NOTHING = Null(0)
Open = Callable[[str], Session]


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {
        name: compiled(c_sources(catalogue.load_block(name), GUID), tmp_path_factory.mktemp(name))
        for name in catalogue.block_names()
    }


@pytest.fixture
def open_session(programs: dict[str, Path]) -> Iterator[Open]:
    opened: list[Session] = []

    def one(name: str) -> Session:
        opened.append(Session(programs[name]))
        return opened[-1]

    yield one
    for session in opened:
        if session.is_alive:
            session("free", 0)
            assert session("live").values == ["0"]
            session.close()


def _begin(session: Session) -> Session:
    assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
    assert session("setup", 0, 0.0, False, 0.0).status == OK
    assert session("enter", 0).status == OK
    return session


def _stepping(session: Session) -> Session:
    assert _begin(session)("leave", 0).status == OK
    return session


def _references(name: str) -> dict[str, int]:
    return {v.name: v.value_reference for v in catalogue.load_block(name).variables}


def _told(answer: Answer) -> str:
    (message,) = answer.messages
    return message.text


def test_a_call_without_an_instance_is_an_error_that_nobody_hears(open_session: Open) -> None:
    session = open_session("ExamplePlant")
    for call in (
        ("get", -1, "R", [0], "+"),
        ("set", -1, "R", [0], [1.0]),
        ("get", -1, "S", [], NOTHING),
        ("set", -1, "S", [], []),
        ("set_debug_logging", -1, True, []),
        ("setup", -1, 0.0, False, 0.0),
        ("enter", -1),
        ("leave", -1),
        ("terminate", -1),
        ("reset", -1),
        ("cancel", -1),
        ("step", -1, 0.0, 0.1),
        ("set_input_derivatives", -1, [0], [1], [1.0]),
        ("get_output_derivatives", -1, [0], [1], "+"),
        ("directional_derivative", -1, [0], [0], [1.0], "+"),
        *(("get_status", -1, kind, 2, "+") for kind in "RBINS"),
        ("get_state", -1, 0),
        ("set_state", -1, 0),
        ("free_state", -1, 0),
        ("state_size", -1, 0, "+"),
        ("serialize", -1, 0, 9, "+"),
        ("deserialize", -1, [1, 2], 0),
    ):
        answer = session(*call)
        assert (answer.status, answer.messages) == (ERROR, []), call
        assert set(answer.values) <= {"untouched"}, call
    assert session("free", -1).status == OK


@pytest.mark.parametrize("kind", ["no_logger", "no_memory", "no_release"])
def test_an_importer_may_give_no_logger_and_no_memory(open_session: Open, kind: str) -> None:
    session = open_session("ExamplePlant")
    assert session("instantiate", 0, "it", 1, GUID, kind, True).status == OK
    assert session("get_state", 0, 0).status == OK
    assert session("cancel", 0).status == ERROR
    assert session("set_state", 0, 0).status == OK
    assert session("enter", 0).status == OK
    assert session("free_state", 0, 0).status == OK


def test_without_callbacks_or_memory_there_is_no_instance(open_session: Open) -> None:
    session = open_session("ExamplePlant")
    assert session("instantiate", 0, "it", 1, GUID, "none", True) == (ERROR, [], [])
    assert "no memory" in _told(session("instantiate", 0, "it", 1, GUID, "out_of_memory", True))


def test_a_refused_instance_is_explained_whatever_its_name_and_guid(open_session: Open) -> None:
    session = open_session("ExamplePlant")
    for name, kind, guid, reason in (
        ("it", 1, "%s%n#r1#", "GUID %s%n##r1##: expected"),
        ("it", 1, "%" * 6000, "GUID %%%"),
        ("%n" * 3000, 1, "{}", "GUID {}"),
        ("it", 1, None, "GUID NULL"),
        ("it", 0, GUID, "expected fmi2CoSimulation"),
        ("it", 7, GUID, "expected fmi2CoSimulation"),
        (None, 1, GUID, "expected an instance name"),
        ("", 1, GUID, "expected an instance name"),
    ):
        answer = session("instantiate", 0, name, kind, guid, "all", True)
        assert answer.status == ERROR
        assert reason in _told(answer)
        assert answer.messages[0].name == (name or "")


def test_without_memory_a_state_is_not_saved_and_the_instance_can_be_reset(open_session: Open) -> None:
    session = _stepping(open_session("ExamplePlant"))
    content = _saved(session)
    for call in (("get_state", 0, 1), ("deserialize", 0, content, 1)):
        session("memory", 0)
        assert "no memory" in _told(session(*call))
        session("memory", 1)
        assert session("step", 0, 0.0, 0.001).status == ERROR
        assert session("reset", 0).status == OK


def test_a_null_where_a_state_belongs_is_an_error(open_session: Open) -> None:
    session = _stepping(open_session("ExamplePlant"))
    assert session("free_state", 0, None).status == OK
    session("get_state", 0, 0)
    content = _saved(session)
    for call in (
        ("get_state", 0, None),
        ("set_state", 0, 9),
        ("state_size", 0, 9, "+"),
        ("state_size", 0, 0, NOTHING),
        ("serialize", 0, 0, len(content), NOTHING),
        ("serialize", 0, 0, len(content) - 1, "+"),
        ("deserialize", 0, Null(len(content)), 1),
        ("deserialize", 0, content, None),
        ("deserialize", 0, [], 1),
    ):
        answer = session(*call)
        assert (answer.status, len(answer.messages)) == (ERROR, 1), call
        assert session("step", 0, 0.0, 0.001).status == ERROR
        assert session("set_state", 0, 0).status == OK
    assert session("step", 0, 0.0, 0.001).status == OK
    assert session("free_state", 0, 0).status == OK


def test_strings_there_are_none(open_session: Open) -> None:
    session = _begin(open_session("ExamplePlant"))
    assert session("get", 0, "S", [], NOTHING).status == OK
    assert "no String" in _told(session("set", 0, "S", [0], ["%n"]))
    assert "no String" in _told(session("get", 0, "S", [2**32 - 1], "+"))


def test_contradictory_parameters_are_discarded_until_they_are_put_right(open_session: Open) -> None:
    session, r = _begin(open_session("RovDepthPlant")), _references("RovDepthPlant")
    assert session("set", 0, "R", [r["sensor_delay"]], [0.3]).status == OK
    for call in (("leave", 0), ("get", 0, "R", [r["depth"]], "+")):
        answer = session(*call)
        assert answer.status == DISCARD
        assert "expected sensor_delay at most 7 times sensor_period" in _told(answer)
    assert session("get", 0, "R", [r["sensor_delay"]], "+").status == OK
    assert session("set", 0, "R", [r["sensor_delay"]], [0.28]).status == OK
    assert session("leave", 0).status == OK


def test_an_initial_state_that_is_not_finite_is_discarded(open_session: Open) -> None:
    """It could not be saved as bytes, and no step would lead out of it."""
    session, r = _begin(open_session("RovDepthPlant")), _references("RovDepthPlant")
    assert session("set", 0, "R", [r["initial_depth"]], [1e308]).status == OK
    assert "state or outputs are not finite at the start" in _told(session("leave", 0))
    assert session("set", 0, "R", [r["initial_depth"]], [1.0]).status == OK
    assert session("leave", 0).status == OK


def test_a_diverging_step_and_an_endless_one_are_discarded(open_session: Open) -> None:
    session, r = _stepping(open_session("ExamplePlant")), _references("ExamplePlant")
    wild = [r["omega"], r["control"]]
    session("set", 0, "R", wild, [1e300, 1e300])
    assert "not finite any more" in _told(session("step", 0, 0.0, 1.0))
    assert "expected at most 1e+09 internal steps" in _told(session("step", 0, 0.0, 1e7))
    session("set", 0, "R", wild, [1.0, 0.0])
    assert session("step", 0, 0.0, 1.0).status == OK
    assert session("get", 0, "R", [r["output"]], "+").values == ["0x0p+0"]


@pytest.mark.parametrize("name", catalogue.block_names())
def test_its_steps_are_those_of_the_block_bit_for_bit(open_session: Open, name: str) -> None:
    session, block = _stepping(open_session(name)), catalogue.load_block(name)
    python = Instance(block)
    python.exit_initialization_mode()
    outputs = [v.value_reference for v in block.of_causality("output")]
    inputs = [v.value_reference for v in block.of_causality("input") if v.minimum is None]
    for i in range(50):
        values = [math.cos(0.1 * i * (k + 1)) for k in range(len(inputs))]
        for reference, value in zip(inputs, values, strict=True):
            python.set(reference, value)
        assert session("set", 0, "R", inputs, values).status == OK
        python.do_step(i * 0.01, 0.01)
        assert session("step", 0, i * 0.01, 0.01).status == OK
        found = session("get", 0, "R", outputs, "+").values
        assert [float.fromhex(v) for v in found] == [python.get(r) for r in outputs]


def test_the_bytes_of_another_fmu_are_refused(open_session: Open) -> None:
    plant, other = _stepping(open_session("ExamplePlant")), _stepping(open_session("L1Controller"))
    answer = plant("deserialize", 0, _saved(other), 0)
    assert answer.status == ERROR
    assert "wrong size" in _told(answer)  # these tests give every FMU one GUID


def test_forged_bytes_do_no_harm(open_session: Open) -> None:
    """With a good checksum: what no instance can be is refused, and with anything else one can go on."""
    session = _stepping(open_session("L1Controller"))
    content = _saved(session)
    session("get_state", 0, 1)
    first = 16 + len(GUID)
    words = [struct.pack("<d", x) for x in (math.nan, -math.inf, 1e308, 0.5, 3e9, -1.0)] + [
        b"\xff" * 8,
        b"\x05" + bytes(7),
    ]
    statuses = set()
    for place in range(first, len(content) - 8, 8):
        for word in words:
            forged = _checked(bytes([*content[:place], *word, *content[place + 8 : -8]]))
            answer = session("deserialize", 0, list(forged), 0)
            statuses.add(answer.status)
            if answer.status == OK:
                _use(session)
            assert session("set_state", 0, 1).status == OK
    assert statuses == {OK, ERROR}
    session("free_state", 0, 0)
    session("free_state", 0, 1)


def _use(session: Session) -> None:
    block = catalogue.load_block("L1Controller")
    session("set_state", 0, 0)
    session("get", 0, "R", [v.value_reference for v in block.variables if v.type == "Real"], "+")
    session("get", 0, "I", [v.value_reference for v in block.variables if v.type == "Enumeration"], "+")
    time = session("get_status", 0, "R", 2, "+")
    if time.status == OK:
        session("step", 0, float.fromhex(time.values[0]), 0.001)


def _saved(session: Session) -> list[int]:
    """The instance's state as bytes."""
    session("get_state", 0, 5)
    size = int(session("state_size", 0, 5, "+").values[0])
    content = [int(v) for v in session("serialize", 0, 5, size, "+").values]
    session("free_state", 0, 5)
    return content


def _checked(content: bytes) -> bytes:
    """With the checksum that belongs to the content (FNV-1a)."""
    digest = 14695981039346656037
    for byte in content:
        digest = (digest ^ byte) * 1099511628211 % 2**64
    return content + struct.pack("<Q", digest)
