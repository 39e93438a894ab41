"""Derivatives of inputs and by direction of the C layer, against closed forms; refusals."""

from collections.abc import Callable

import pytest

from .exchanged import TANK
from .native_block import EVERYTHING
from .native_model import DISCARD, ERROR, LAST_TIME, OK, WARNING
from .native_session import REFERENCES, Session, begin, read, refused, saved, step, stepping, told, write


@pytest.fixture
def session(open_session: Callable[[str], Session]) -> Session:
    return open_session(EVERYTHING.name)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_derivatives_of_outputs_are_refused_but_for_an_empty_list(session: Session, order: int) -> None:
    """FMI 2.0.5, 4.2.1: maxOutputDerivativeOrder is 0."""
    stepping(session)
    assert session("get_output_derivatives", 0, [], [], "+").status == OK
    for names in (("y",), ("y", "square")):
        assert session("get_state", 0, 0).status == OK
        references, orders = [REFERENCES[name] for name in names], [order] * len(names)
        text = refused(session("get_output_derivatives", 0, references, orders, "+"))
        assert text == "fmi2GetRealOutputDerivatives: Everything has no derivatives of outputs"
        assert step(session, 0.0, 0.1) == ERROR
        assert session("set_state", 0, 0).status == OK
    assert session("free_state", 0, 0).status == OK
    assert step(session, 0.0, 0.1) == OK


def test_not_even_an_empty_list_of_derivatives_of_outputs_is_allowed_before_steps(session: Session) -> None:
    begin(session)
    text = refused(session("get_output_derivatives", 0, [], [], "+"))
    assert text.endswith("GetRealOutputDerivatives is not allowed in the state 'initialization mode'")


def test_contradictory_parameters_are_an_error_of_steps_that_names_the_requirement(
    session: Session,
) -> None:
    stepping(session)
    assert session("get_state", 0, 0).status == OK
    for values, expected in (
        ({"gain": 9.0, "limit": 9.0}, "gain below limit"),
        ({"gain": -20.0}, "gain limit above -50"),
    ):
        assert write(session, **values) == OK
        text = refused(session("step", 0, 0.0, 0.1))
        assert text.endswith(f"parameters of Everything: expected {expected}")
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
        assert (session("get_status", 0, "R", LAST_TIME, "+").values) == ["0x0p+0"]
        session("terminate", 0)


def test_a_derivative_of_higher_order_is_left_out_of_an_input(session: Session) -> None:
    stepping(session)
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
    stepping(session)
    text = refused(session("set_input_derivatives", 0, [REFERENCES["force"]], [order], [1.0]))
    assert text.endswith(f"order {order}: expected at least 1")


def test_a_discrete_real_has_no_derivative(open_session: Callable[[str], Session]) -> None:
    session = stepping(open_session(TANK.name))
    inflow, opening = (v.value_reference for v in TANK.of_causality("input"))
    assert session("set_input_derivatives", 0, [inflow], [1], [1.0]).status == OK
    text = refused(session("set_input_derivatives", 0, [opening], [1], [1.0]))
    assert text == "fmi2SetRealInputDerivatives: opening: expected a continuous input"


def test_setting_no_derivatives_changes_nothing(session: Session) -> None:
    stepping(session)
    before = saved(session)
    assert session("set_input_derivatives", 0, [], [], []).status == OK
    assert saved(session) == before


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
