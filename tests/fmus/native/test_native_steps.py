"""What steps of the C layer compute and refuse, against closed forms: x' = t + force valve + 1 - x / 2."""

import math
import re

import pytest

from fmus.block.instance import BlockError, BlockInstance

from .blocks import ITEMS, TANK
from .conftest import Open
from .session import DISCARD, ERROR, LAST_TIME, OK, WARNING, Session


def euler(x: float, t: float, h: float, force: float = 0.0) -> float:
    """Returns x after an internal step, with `force` in place of force times valve."""
    return x + h * (force + 1.0 - 0.5 * x + t)


def reached(session: Session) -> float:
    """Returns the state x, of which the output y is a multiple."""
    return session.get("y")[0] / 8.0


def set_rates(session: Session, **rates: float) -> int:
    """Returns the status of setting first derivatives of inputs."""
    return session("set_input_derivatives", session.of(*rates), [1] * len(rates), [*rates.values()]).status


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
    assert session.stepping().step(0.0, 0.1 * length) == OK
    assert session.get("steps") == [expected]


def test_internal_steps_are_equal_and_inputs_move_through_their_middles(session: Session) -> None:
    """Three explicit steps by hand, in which the valve opens to its limit."""
    session.stepping()
    assert session.set(force=2.0, valve=0.9) == set_rates(session, force=1.0, valve=2.0) == OK
    assert session.step(0.0, 0.24) == OK
    x, h = 1.0, 0.24 / 3
    for i in range(3):
        t = (i + 0.5) * h
        x = euler(x, i * h, h, force=(2.0 + t) * min(0.9 + 2.0 * t, 1.0))
    assert reached(session) == pytest.approx(x, rel=1e-15)  # roundings of a sum
    assert session.step(0.24, 0.1) == OK  # the rates held for one step
    assert reached(session) == pytest.approx(euler(x, 0.24, 0.1, force=2.0 * 0.9), rel=1e-15)


def test_the_start_time_reaches_outputs_that_were_read_before(session: Session) -> None:
    """square = x^2 + t."""
    assert session.instantiate().get("square") == [1.0]
    assert session("setup", 2.0, False, 0.0).status == OK
    assert session.get("square") == [3.0]


@pytest.mark.slow
def test_a_step_may_pass_the_stop_time_by_rounding_and_by_no_more(session: Session) -> None:
    session.stepping(stop=0.3)
    assert [session.step(t, 0.1) for t in (0.0, 0.1, 0.2)] == [OK] * 3
    assert 0.2 + 0.1 > 0.3
    assert session.refused("step", 0.3, 1e-6).endswith("expected at most the stop time 0.3 s")


def test_a_reset_ends_the_stop_time(session: Session) -> None:
    session.instantiate()
    # no setup after the reset, which would set it anew
    for call in (("setup", 0.0, True, 0.3), ("reset",), ("enter",), ("leave",), ("step", 0.0, 0.4)):
        assert session(*call).status == OK


@pytest.mark.parametrize(
    ("time", "h", "within", "beyond"),
    [
        (0.0, 0.1, 0.9e-9, 1.1e-9),
        (0.0, 1e-7, 0.9e-10, 1.1e-10),
        (1e6, 10.0, 0.9e-3, 1.1e-3),
        (1e6, 1e-8, 1.6e-9, 2.0e-9),
        (1.7e9, 0.01, 0.9e-5, 1.4e-5),  # the time since 1970, where 1e-9 of it would be hundreds of steps
    ],
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_communication_point_may_differ_by_a_part_of_the_time_and_the_step_and_by_rounding(
    session: Session, time: float, h: float, within: float, beyond: float, side: float
) -> None:
    """1e-9 of the time, or of 1 s if that is more, at most 1e-3 of the step; and 8 epsilon of the time."""
    session.stepping(time)
    for late, status in ((beyond, ERROR), (within, OK)):
        with session.kept():
            assert session.step(time + side * late, h) == status


def test_time_goes_on_from_the_importers_communication_point(session: Session) -> None:
    """Which may differ from the time of the FMU by rounding."""
    point = 0.1 + 1e-12
    assert session.stepping().step(0.0, 0.1) == session.step(point, 0.1) == OK
    assert session("get_status", "R", LAST_TIME, "+").numbers == [point + 0.1]
    assert point + 0.1 != 0.2
    square, y = session.get("square", "y")
    assert square == (y / 8.0) ** 2 + point + 0.1


def test_a_step_follows_the_parameters_that_are_set_restored_and_reset(session: Session) -> None:
    """Without the 1 in x' unless the mode is RUN. A step needs what is kept of them."""

    def stepped(t: float, is_running: bool = True) -> float:
        x = reached(session)
        assert session.step(t, 0.1) == OK
        assert reached(session) == pytest.approx(euler(x, t, 0.1, force=is_running - 1.0), rel=1e-14)
        return reached(session)

    session.stepping()
    first, second = stepped(0.0), stepped(0.1)
    with session.kept():
        third = stepped(0.2)
        assert session.set(mode=0) == OK
        stepped(0.3, is_running=False)
    assert reached(session) == second
    assert stepped(0.2) == third
    assert session.set(mode=0) == OK
    stepped(0.3, is_running=False)
    for call in ("reset", "enter", "leave"):
        assert session(call).status == OK
    assert stepped(0.0) == first


def test_steps_of_more_lengths_than_the_layer_keeps_numbers_for_are_each_of_their_own(
    session: Session,
) -> None:
    """Lengths in turn, and each of them again."""
    t, x = 0.0, reached(session.stepping())
    for h in [0.05 + i / 256.0 for i in range(7)] * 3:
        x = euler(x, t, h)
        assert session.step(t, h) == OK
        assert reached(session) == pytest.approx(x, rel=1e-12)
        t += h


def test_the_sign_of_a_zero_is_set(session: Session) -> None:
    session.stepping()
    for value in (0.0, -0.0, 0.0):
        assert session.set(force=value) == OK
        assert math.copysign(1.0, session.get("force")[0]) == math.copysign(1.0, value)


def test_an_output_that_no_integer_holds_discards_the_step(session: Session) -> None:
    assert session.begin().set(count=2**31 - 2) == session("leave").status == session.step(0.0, 0.1) == OK
    assert session.get("steps") == [2**31 - 1]
    assert "not finite any more" in session.refused("step", 0.1, 0.1, status=DISCARD)
    assert session.get("steps") == [2**31 - 1]


def test_the_lowest_integer_is_a_value(session: Session) -> None:
    assert session.begin().set(count=-(2**31)) == OK
    assert session.get("steps") == [-(2**31)]


@pytest.mark.slow
def test_a_step_that_diverges_is_discarded_and_leaves_the_state(plant: Session) -> None:
    assert plant.stepping().set(control=1.0) == plant.step(0.0, 0.5) == OK
    before, saved = plant.get("output"), plant.saved()
    with plant.kept():
        assert plant.set(omega=1e300, control=1e300) == OK
        text = plant.refused("step", 0.5, 1.0, status=DISCARD)
        assert text == "fmi2DoStep at 0.5 s: state or outputs are not finite any more; take shorter steps"
        assert plant("get_status", "R", LAST_TIME, "+").numbers == [0.5]
        assert plant.get("output") == before
        assert plant.set(omega=1.0, control=1.0) == plant.step(0.5, 0.5) == OK
        after = plant.get("output")
    assert plant.saved() == saved
    assert plant.step(0.5, 0.5) == OK
    assert plant.get("output") == after


# derivatives of inputs


def test_a_derivative_of_higher_order_is_left_out_of_an_input(session: Session) -> None:
    inputs = session.stepping().of("force", "force")
    text = session.refused("set_input_derivatives", inputs, [1, 2], [10.0, -5.0], status=WARNING)
    assert text.endswith("force: order 2 is left out: expected 1")
    assert session.step(0.0, 0.1) == OK
    assert reached(session) == pytest.approx(euler(1.0, 0.0, 0.1, force=10.0 * 0.05 * 0.5), rel=1e-15)


def test_a_discrete_real_has_no_derivative(open_session: Open) -> None:
    tank = open_session(TANK.name).stepping()
    assert set_rates(tank, inflow=1.0) == OK
    text = tank.refused("set_input_derivatives", tank.of("opening"), [1], [1.0])
    assert text == "fmi2SetRealInputDerivatives: opening: expected a continuous input"


def test_a_refused_step_leaves_rates_and_the_next_one_uses_them(session: Session) -> None:
    assert set_rates(session.stepping(), force=10.0) == session.set(limit=1e308) == OK
    assert session.step(0.0, 0.1) == DISCARD
    assert session.set(limit=4.0) == session.step(0.0, 0.1) == OK
    assert reached(session) == pytest.approx(euler(1.0, 0.0, 0.1, force=10.0 * 0.05 * 0.5), rel=1e-15)


def test_a_rate_ends_with_its_step_also_where_another_input_gets_one_then(session: Session) -> None:
    assert set_rates(session.stepping(), force=10.0, valve=1.0) == session.step(0.0, 0.1) == OK
    assert set_rates(session, valve=1.0) == session.step(0.1, 0.1) == OK
    x = euler(euler(1.0, 0.0, 0.1, force=10.0 * 0.05 * 0.55), 0.1, 0.1)  # the force is 0 again
    assert reached(session) == pytest.approx(x, rel=1e-14)


@pytest.mark.parametrize(("rate", "limit"), [(20.0, 1.0), (-20.0, 0.0)])
def test_an_input_with_a_rate_stays_within_its_range(session: Session, rate: float, limit: float) -> None:
    assert session.stepping().set(force=2.0) == set_rates(session, valve=rate) == OK
    assert session.step(0.0, 0.1) == OK
    assert reached(session) == pytest.approx(euler(1.0, 0.0, 0.1, force=2.0 * limit), rel=1e-14)


# an Enumeration or Boolean is one of its items in both flavours, or the step is refused

MODE, BOOLEAN = "mode .*: expected one of 0 (rest), 3 (run)", "is_on .*: expected 0 (false) or 1 (true)"


@pytest.fixture
def items(open_session: Open) -> Session:
    return open_session(ITEMS.name).begin()


@pytest.fixture
def instance() -> BlockInstance:
    """The block of `items` in Python."""
    return BlockInstance(ITEMS)


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        *((1003.0, (3, 0)), (1000.0, (0, 0)), (-1001.0, (0, 1)), (-1000.0, (0, 0))),
        *((choice, MODE) for choice in (1001.0, 1002.5, 1032.0)),
        *((choice, BOOLEAN) for choice in (-1000.5, -1002.0)),
    ],
)
def test_a_step_gives_items_or_is_discarded_and_the_state_stays(
    items: Session, instance: BlockInstance, choice: float, expected: tuple[int, int] | str
) -> None:
    assert items("leave").status == items.set(choose=choice) == OK
    instance.exit_initialization_mode()
    instance.set(items.references["choose"], choice)
    if isinstance(expected, tuple):
        assert items.step(0.0, 0.01) == OK
        instance.do_step(0.0, 0.01)
        assert (*items.get("mode"), *items.get("is_on")) == expected
        assert tuple(map(instance.get, items.of("mode", "is_on"))) == expected
        return
    pattern = re.escape(expected).replace(r"\.\*", ".*")
    before, snapshot = items.saved(), instance.snapshot()
    assert re.search(pattern, items.refused("step", 0.0, 0.01, status=DISCARD))
    with pytest.raises(BlockError, match=pattern):
        instance.do_step(0.0, 0.01)
    assert (items.saved(), instance.snapshot()) == (before, snapshot)


def test_a_calculated_parameter_that_is_no_item_ends_the_initialization(
    items: Session, instance: BlockInstance
) -> None:
    assert items.set(choice=1001.0) == OK
    instance.set(items.references["choice"], 1001.0)
    text = "chosen is another number: expected one of 0 (rest), 3 (run)"
    assert items.refused("leave").endswith(text)
    with pytest.raises(BlockError, match=r"chosen = 1.0: expected one of 0 \(rest\), 3 \(run\)"):
        instance.exit_initialization_mode()
    items("free")
    assert items.begin().set(choice=1003.0) == items("leave").status == OK
