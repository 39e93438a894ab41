"""Calls of the native FMU that a random search seldom reaches: poor importers, forged states."""

import math
import struct
from collections.abc import Callable

import pytest

from .native_block import EVERYTHING, block_named
from .native_model import DISCARD, ENDED, ERROR, OK, WARNING, Null
from .native_session import GUID, Session, begin, refused, saved, stepping, told, with_checksum

Open = Callable[[str], Session]

NOTHING = Null(0)


def _references(name: str) -> dict[str, int]:
    return {v.name: v.value_reference for v in block_named(name).variables}


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


@pytest.mark.parametrize("kind", ["no_logger", "no_memory"])
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
    assert "no memory" in told(session("instantiate", 0, "it", 1, GUID, "out_of_memory", True))


def test_a_refused_instance_is_explained_whatever_its_name_and_guid(open_session: Open) -> None:
    session = open_session("ExamplePlant")
    for name, kind, guid, reason in (
        ("it", 1, "%s%n#r1#", "GUID %s%n##r1##: expected"),
        ("it", 1, "%" * 6000, "GUID %%%"),
        ("%n" * 3000, 1, "{}", "GUID {}"),
        ("it", 1, None, "GUID NULL"),
        ("it", 1, "", "GUID : expected"),
        ("it", 7, GUID, "expected fmi2CoSimulation"),
        (None, 1, GUID, "expected an instance name"),
        ("", 1, GUID, "expected an instance name"),
        ("\v\f", 1, GUID, "expected an instance name"),
    ):
        answer = session("instantiate", 0, name, kind, guid, "all", True)
        assert reason in refused(answer)
        assert answer.messages[0].name == (name or "")


def test_without_memory_a_state_is_not_saved_and_the_instance_can_be_reset(open_session: Open) -> None:
    session = stepping(open_session("ExamplePlant"))
    content = saved(session)
    for call in (("get_state", 0, 1), ("deserialize", 0, content, 1)):
        session("memory", 0)
        assert "no memory" in told(session(*call))
        session("memory", 1)
        assert session("step", 0, 0.0, 0.001).status == ERROR
        assert session("reset", 0).status == OK


def test_a_null_where_a_state_belongs_is_an_error(open_session: Open) -> None:
    session = stepping(open_session("ExamplePlant"))
    assert session("free_state", 0, None).status == OK
    session("get_state", 0, 0)
    content = saved(session)
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


def test_derivatives_without_their_orders_are_an_error(open_session: Open) -> None:
    force = _references(EVERYTHING.name)["force"]
    session = stepping(open_session(EVERYTHING.name))
    assert "order" in refused(session("set_input_derivatives", 0, [force], Null(1), [1.0]))


@pytest.mark.parametrize("calls", [0, 1, 2, 3], ids=["instantiated", "set up", "initialization", "stepping"])
def test_what_is_calculated_is_set_in_no_state(open_session: Open, calls: int) -> None:
    for name in ("product", "y"):
        session = open_session(EVERYTHING.name)
        assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
        for call in (("setup", 0, 0.0, False, 0.0), ("enter", 0), ("leave", 0))[:calls]:
            assert session(*call).status == OK
        answer = session("set", 0, "R", [_references(EVERYTHING.name)[name]], [1.0])
        assert answer.status == ERROR
        assert told(answer).endswith(f"{name} can not be set, it is calculated")


def test_strings_there_are_none(open_session: Open) -> None:
    session = begin(open_session("ExamplePlant"))
    assert session("get", 0, "S", [], NOTHING).status == OK
    assert "no String" in told(session("set", 0, "S", [0], ["%n"]))
    assert "no String" in told(session("get", 0, "S", [2**32 - 1], "+"))


def test_contradictory_parameters_are_an_error_until_the_instance_is_restored(open_session: Open) -> None:
    """FMI 2.0.5, 2.1.3: neither fmi2ExitInitializationMode nor fmi2GetXXX may discard."""
    session, r = begin(open_session("RovDepthPlant")), _references("RovDepthPlant")
    assert session("get_state", 0, 0).status == OK
    for call in (("leave", 0), ("get", 0, "R", [r["depth"]], "+")):
        assert session("set", 0, "R", [r["sensor_delay"]], [0.3]).status == OK
        assert "expected sensor_delay at most 7 times sensor_period" in refused(session(*call))
        assert session("get", 0, "R", [r["sensor_delay"]], "+").values == [(0.3).hex()]
        assert session("set_state", 0, 0).status == OK
    assert session("set", 0, "R", [r["sensor_delay"]], [0.28]).status == OK
    assert session("leave", 0).status == OK
    assert session("free_state", 0, 0).status == OK


def test_step_finished_is_called_after_each_completed_step_and_no_other(open_session: Open) -> None:
    """FMI 2.0.5, 2.1.5: if a pointer to a function is provided, it must be called."""
    session = open_session("ExamplePlant")
    assert session("instantiate", 0, "it", 1, GUID, "step_finished", True).status == OK
    for call in (("setup", 0, 0.0, True, 2.0), ("enter", 0), ("leave", 0)):
        assert session(*call) == (OK, [], [])
    for step in range(2):
        (signal,) = session("step", 0, float(step), 1.0).messages
        assert (signal.status, signal.category) == (OK, "stepFinished")
    assert [m.category for m in session("step", 0, 2.0, 1.0).messages] == ["logStatusError"]


def test_an_initial_state_that_is_not_finite_is_an_error(open_session: Open) -> None:
    """It could not be saved as bytes, and no step would lead out of it."""
    session, r = begin(open_session("RovDepthPlant")), _references("RovDepthPlant")
    assert session("set", 0, "R", [r["initial_depth"]], [1e308]).status == OK
    assert "state or outputs are not finite at the start" in refused(session("leave", 0))


def test_an_endless_step_is_an_error(open_session: Open) -> None:
    """FMI 2.0.5, 4.2.2: it cannot be carried out, not even in part."""
    session = stepping(open_session("ExamplePlant"))
    assert session("step", 0, 0.0, 1.0).status == OK
    assert "expected at most 1e+09 internal steps" in refused(session("step", 0, 1.0, 1e7))


def test_the_bytes_of_another_fmu_are_refused(open_session: Open) -> None:
    plant, other = stepping(open_session("ExamplePlant")), stepping(open_session(EVERYTHING.name))
    answer = plant("deserialize", 0, saved(other), 0)
    assert answer.status == ERROR
    assert "wrong size" in told(answer)  # these tests give every FMU one GUID


def test_forged_bytes_do_no_harm(open_session: Open) -> None:
    """With a good checksum: what no instance can be is refused, and with anything else one can go on."""
    session = stepping(open_session(EVERYTHING.name))
    content = saved(session)
    session("get_state", 0, 1)
    first = 16 + len(GUID)
    words = [struct.pack("<d", x) for x in (math.nan, -math.inf, 1e308, 0.5, 3e9, -1.0)] + [
        b"\xff" * 8,
        b"\x05" + bytes(7),
    ]
    statuses = set()
    for position in range(first, len(content) - 8, 8):
        for word in words:
            forged = with_checksum(bytes([*content[:position], *word, *content[position + 8 : -8]]))
            answer = session("deserialize", 0, list(forged), 0)
            statuses.add(answer.status)
            if answer.status == OK:
                _use(session)
            assert session("set_state", 0, 1).status == OK
    assert statuses == {OK, ERROR}
    session("free_state", 0, 0)
    session("free_state", 0, 1)


def _use(session: Session) -> None:
    session("set_state", 0, 0)
    session("get", 0, "R", [v.value_reference for v in EVERYTHING.variables if v.type == "Real"], "+")
    session("get", 0, "I", [v.value_reference for v in EVERYTHING.variables if v.type == "Enumeration"], "+")
    time = session("get_status", 0, "R", 2, "+")
    if time.status == OK:
        session("step", 0, float.fromhex(time.values[0]), 0.001)


@pytest.mark.parametrize(
    ("unknown", "known", "reason"),
    [
        ("control", "control", "unknown control: expected what is calculated in this mode"),
        ("output", "output", "known output: expected a parameter, an input or, later, a state"),
    ],
)
def test_a_derivative_is_of_what_follows_by_what_is_set(
    open_session: Open, unknown: str, known: str, reason: str
) -> None:
    session, references = stepping(open_session("ExamplePlant")), _references("ExamplePlant")
    answer = session("directional_derivative", 0, [references[unknown]], [references[known]], [1.0], "+")
    assert (answer.status, answer.values) == (ERROR, ["untouched"])
    assert reason in told(answer)


@pytest.mark.parametrize("name", ["initial_state[2]", "state[1]"])
def test_only_inputs_have_derivatives_to_be_set(open_session: Open, name: str) -> None:
    session, references = stepping(open_session("ExamplePlant")), _references("ExamplePlant")
    answer = session("set_input_derivatives", 0, [references[name]], [1], [1.0])
    assert answer.status == ERROR
    assert f"{name}: expected an input" in told(answer)


@pytest.mark.parametrize(
    ("category", "status"), [("logStatusError", OK), ("logNothing", WARNING), ("", WARNING)]
)
def test_an_unknown_category_of_messages_is_a_warning(open_session: Open, category: str, status: int) -> None:
    session = stepping(open_session("ExamplePlant"))
    answer = session("set_debug_logging", 0, True, [category])
    assert answer.status == status
    assert [m.category for m in answer.messages] == ["logStatusWarning"] * (status == WARNING)


def test_categories_that_are_switched_off_are_those_that_are_named(open_session: Open) -> None:
    session, r = stepping(open_session("ExamplePlant")), _references("ExamplePlant")
    assert session("set_debug_logging", 0, False, ["logStatusDiscard"]).status == OK
    assert session("set", 0, "R", [r["control"]], [math.nan]) == (DISCARD, [], [])
    assert len(session("cancel", 0).messages) == 1
    assert session("set_debug_logging", 0, False, ["logAll"]).status == OK
    assert session("cancel", 0) == (ERROR, [], [])


def test_a_derivative_by_nothing_that_exists_is_an_error(open_session: Open) -> None:
    session, references = stepping(open_session("ExamplePlant")), _references("ExamplePlant")
    answer = session("directional_derivative", 0, [references["output"]], [999], [1.0], "+")
    assert (answer.status, answer.values) == (ERROR, ["untouched"])


def test_the_model_never_ends_the_simulation(open_session: Open) -> None:
    session = stepping(open_session("ExamplePlant"))
    answer = session("get_status", 0, "B", ENDED, "+")
    assert (answer.status, answer.values) == (OK, ["0x0p+0"])
    begun = open_session("ExamplePlant")
    begin(begun)
    assert begun("get_status", 0, "B", ENDED, "+").status == ERROR
