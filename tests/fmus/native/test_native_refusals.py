"""What a native FMU of FMI 2.0 refuses, with which status and message, and what it gives a poor importer."""

import math
from typing import Any

import pytest

from .conftest import Open
from .session import DISCARD, ENDED, ERROR, GUID, OK, Null, Session

NOTHING = Null(0)
SETUP = ("setup", 0.0, False, 0.0)
LIFE = {"instantiated": (), "set up": (SETUP,), "initialization": (SETUP, ("enter",))}
LIFE["stepping"] = (*LIFE["initialization"], ("leave",))


def led(session: Session, stage: str) -> Session:
    """Leads a new instance to a stage of its life."""
    session.instantiate()
    assert all(session(*call).status == OK for call in LIFE[stage])
    return session


# calls


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("step", (0.5, 0.1), "communication point 0.5 s: expected 0 s, the current time"),
        ("step", (0.0, 0.0), "communication step size 0 s: expected more than 0"),
        ("step", (0.0, -0.1), "communication step size -0.1 s: expected more than 0"),
        ("step", (0.0, math.nan), "expected more than 0"),
        ("step", (0.0, 1.1), "step to 1.1 s: expected at most the stop time 1 s"),
        ("set", ("R", [99], [0.0]), "value reference 99: expected 0..22 of ExamplePlant"),
        ("set", ("R", [18], [0.0]), "output can not be set, it is calculated"),
        ("set", ("R", [0], [0.1]), "internal_step is fixed, set it before the initialization ends"),
        ("set", ("S", [0], ["%n"]), "ExamplePlant has no String variables"),
        ("get", ("I", [18], "+"), "output is Real: expected Integer or Enumeration"),
        ("get", ("S", [2**32 - 1], "+"), "ExamplePlant has no String variables"),
        ("enter", (), "is not allowed in the state 'step complete'"),
        (*SETUP[:1], SETUP[1:], "is not allowed in the state 'step complete'"),
        ("cancel", (), "expected a step in progress"),
        ("set_input_derivatives", ([14], Null(1), [1.0]), "order"),
        ("set_input_derivatives", ([13], [1], [1.0]), "initial_state[2]: expected an input"),
        ("get_output_derivatives", ([18], [0], "+"), "ExamplePlant has no derivatives of outputs"),
        ("get_output_derivatives", ([18, 16], [1, 2], "+"), "ExamplePlant has no derivatives of outputs"),
        ("directional_derivative", ([14], [14], [1.0], "+"), "unknown control: expected what is calculated"),
        ("directional_derivative", ([18], [18], [1.0], "+"), "known output: expected a parameter, an input"),
        ("directional_derivative", ([18], [999], [1.0], "+"), "value reference 999"),
        ("get_state", (None,), "FMUstate is NULL"),
        ("set_state", (9,), "FMUstate is NULL"),
        ("state_size", (9, "+"), "FMUstate is NULL"),
        ("state_size", (0, NOTHING), "size is NULL"),
        ("serialize", (0, 1000, NOTHING), "serializedState is NULL"),
        ("serialize", (0, 8, "+"), "size 8: expected 334"),
        ("deserialize", (Null(1000), 1), "serializedState is NULL"),
        ("deserialize", (bytes(1000), None), "FMUstate is NULL"),
        ("deserialize", (b"", 1), "not a serialized state"),
    ],
)
def test_an_illegal_call_is_an_error_that_changes_nothing(
    plant: Session, call: str, arguments: tuple[Any, ...], message: str
) -> None:
    """Afterwards FMI allows reading, restoring, resetting and freeing only."""
    everything = plant.stepping(stop=1.0).of(*plant.references)[:19]
    assert plant("get_state", 0).status == OK
    before = plant("get", "R", everything, "+")
    with plant.kept():
        assert message in plant.refused(call, *arguments)
        assert plant("get", "R", everything, "+") == before
        assert "is not allowed in the state 'error'" in plant.refused("step", 0.0, 0.1)
    assert plant.step(0.0, 1.0) == plant("free_state", 0).status == OK


def test_a_call_without_an_instance_is_an_error_that_nobody_hears(plant: Session) -> None:
    for call in (
        ("get", "R", [0], "+"),
        ("set", "R", [0], [1.0]),
        ("get", "S", [], NOTHING),
        ("set", "S", [], []),
        ("set_debug_logging", True, []),
        SETUP,
        *((name,) for name in ("enter", "leave", "terminate", "reset", "cancel")),
        ("step", 0.0, 0.1),
        ("set_input_derivatives", [0], [1], [1.0]),
        ("get_output_derivatives", [0], [1], "+"),
        ("directional_derivative", [0], [0], [1.0], "+"),
        *(("get_status", kind, 2, "+") for kind in "RBINS"),
        *((name, 0) for name in ("get_state", "set_state", "free_state")),
        ("state_size", 0, "+"),
        ("serialize", 0, 9, "+"),
        ("deserialize", [1, 2], 0),
    ):
        answer = plant(*call, slot=-1)
        assert (answer.status, answer.messages) == (ERROR, []), call
        assert set(answer.values) <= {"untouched"}, call
    assert plant("free", slot=-1).status == OK


def test_what_needs_steps_is_not_allowed_before_them(plant: Session) -> None:
    for call in (("get_output_derivatives", [], [], "+"), ("get_status", "B", ENDED, "+")):
        with plant.begin().kept():
            text = plant.refused(*call)
            assert text.endswith("is not allowed in the state 'initialization mode'")
        plant("free")


def test_nothing_may_be_asked_of_outputs_strings_and_states_in_steps(plant: Session) -> None:
    plant.stepping()
    assert plant("get_output_derivatives", [], [], "+").status == OK
    assert plant("get", "S", [], NOTHING).status == OK
    assert plant("free_state", None).status == OK


def test_an_endless_step_is_an_error(plant: Session) -> None:
    """FMI 2.0.5, 4.2.2: it cannot be carried out, not even in part."""
    assert plant.stepping().step(0.0, 1.0) == OK
    assert "expected at most 1e+09 internal steps" in plant.refused("step", 1.0, 1e7)


# values


@pytest.mark.parametrize("stage", ["instantiated", "initialization", "stepping"])
@pytest.mark.parametrize(
    ("name", "kind", "value", "message"),
    [
        ("gain", "R", -101.0, "fmi2SetReal: gain = -101: expected -100 to 100"),
        ("internal_step", "R", 11.0, "fmi2SetReal: internal_step = 11: expected 0.001 to 10 s"),
        ("mode", "I", 2, "fmi2SetInteger: mode = 2: expected one of 0 (rest), 3 (run)"),
        ("valve", "R", -2.0, "fmi2SetReal: valve = -2: expected 0 to 1"),
    ],
)
def test_a_start_value_out_of_range_is_an_error_whose_message_needs_no_logging(
    session: Session, stage: str, name: str, kind: str, value: float, message: str
) -> None:
    """An input in initialization mode is no start value any more: a solver may try others."""
    led(session, stage)
    assert session("set_debug_logging", False, []).status == OK
    before = session.get(name)
    is_start = stage == "instantiated" or (stage == "initialization" and name != "valve")
    answer = session("set", kind, session.of(name), [value])
    assert answer.status == (ERROR if is_start else DISCARD)
    assert [m.text for m in answer.messages] == [message] * is_start
    assert session.get(name) == before


CONTRADICTIONS = [
    ({"gain": 9.0, "limit": 9.0}, "gain below limit"),
    ({"gain": -20.0}, "gain limit above -50"),
]


@pytest.mark.parametrize(("values", "requirement"), CONTRADICTIONS)
def test_contradictory_parameters_are_an_error_until_the_instance_is_restored(
    session: Session, values: dict[str, float], requirement: str
) -> None:
    """FMI 2.0.5, 2.1.3: neither fmi2ExitInitializationMode nor fmi2GetXXX may discard."""
    product, gain = session.of("product"), session.of("gain")
    initial = ("leave",), ("get", "R", product, "+"), ("directional_derivative", product, gain, [1.0], "+")
    for stage, calls in (("initialization", initial), ("stepping", (("step", 0.0, 0.1),))):
        led(session, stage)
        for call in calls:
            with session.kept():
                assert session.set(**values) == OK
                text = session.refused(*call)
                assert text.endswith(f"parameters of Everything: expected {requirement}")
                assert session.get(*values) == [*values.values()]
        assert session.set(gain=3.5) == OK
        assert session(*calls[0]).status == OK
        session("free")


@pytest.mark.slow
def test_an_initial_state_that_is_not_finite_is_an_error(open_session: Open) -> None:
    """It could not be saved as bytes, and no step would lead out of it."""
    vehicle = open_session("RovDepthPlant").begin()
    assert vehicle.set(initial_depth=1e308) == OK
    assert "state or outputs are not finite at the start" in vehicle.refused("leave")


# instances


@pytest.mark.parametrize("kind", ["no_logger", "no_memory"])
def test_an_importer_may_give_no_logger_and_no_memory(plant: Session, kind: str) -> None:
    plant.instantiate(kind)
    calls = ("get_state", 0), ("cancel",), ("set_state", 0), ("enter",), ("free_state", 0)
    assert [plant(*call).status for call in calls] == [OK, ERROR, OK, OK, OK]


def test_without_callbacks_or_memory_there_is_no_instance(plant: Session) -> None:
    assert plant("instantiate", "it", 1, GUID, "none", True) == (ERROR, [], [])
    assert "no memory" in plant.refused("instantiate", "it", 1, GUID, "out_of_memory", True)


@pytest.mark.parametrize("logging", [True, False])
@pytest.mark.parametrize(
    ("name", "kind", "guid", "reason"),
    [
        ("it", 1, "%s%n#r1#", "GUID %s%n##r1##: expected"),
        ("it", 1, "%" * 6000, "GUID %%%"),
        ("%n" * 3000, 1, "{}", "GUID {}"),
        ("it", 1, None, "GUID NULL"),
        ("it", 1, "", "GUID : expected"),
        ("it", 7, GUID, "expected fmi2CoSimulation"),
        *((name, 1, GUID, "expected an instance name") for name in (None, "", "\v\f")),
    ],
    ids=str,
)
def test_a_refused_instance_is_explained_whatever_its_name_and_guid(
    plant: Session, logging: bool, name: str | None, kind: int, guid: str | None, reason: str
) -> None:
    answer = plant("instantiate", name, kind, guid, "all", logging)
    assert answer.status == ERROR
    (message,) = answer.messages
    assert reason in message.text
    assert message.name == (name or "")


def test_without_memory_a_state_is_not_saved_and_the_instance_can_be_reset(plant: Session) -> None:
    content = plant.stepping().saved()
    for call in (("get_state", 1), ("deserialize", content, 1)):
        plant.memory(False)
        assert "no memory" in plant.refused(*call)
        plant.memory(True)
        assert plant.step(0.0, 0.001) == ERROR
        assert plant("reset").status == OK


def test_step_finished_is_called_after_each_completed_step_and_no_other(plant: Session) -> None:
    """FMI 2.0.5, 2.1.5: if a pointer to a function is provided, it must be called."""
    plant.instantiate("step_finished")
    for call in (("setup", 0.0, True, 2.0), ("enter",), ("leave",)):
        assert plant(*call) == (OK, [], [])
    for t in (0.0, 1.0):
        (signal,) = plant("step", t, 1.0).messages
        assert (signal.status, signal.category) == (OK, "stepFinished")
    assert [m.category for m in plant("step", 2.0, 1.0).messages] == ["logStatusError"]


# messages
