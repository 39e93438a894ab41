"""Events of model exchange of FMI 2.0, and what it refuses."""

import math
from collections.abc import Callable
from ctypes import POINTER, byref, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

import fmpy
import numpy as np
import pytest

from tests.shared_builds import Fmus

from .exchanged import Exchanged

Exchange = Callable[[str], Exchanged]


# samples


def test_samples_are_taken_at_events_alone(exchange: Exchange) -> None:
    ball = exchange("Ball").begin()
    assert ball.event()[3:] == (False, True, 0.25)
    ball.model.enterContinuousTimeMode()
    ball.at(0.25, [0.7, -1.0])
    assert (ball["height"], ball["reading"]) == (0.7, 0.0)
    ball.model.enterEventMode()
    assert ball["reading"] == 0.0
    ball.model.setInteger([ball.references["level"]], [3])
    assert ball.event() == (False, False, False, False, True, 0.5)
    assert ball["reading"] == 3.7
    assert ball.event()[3:] == (False, True, 0.5)
    assert ball["reading"] == 3.7


@pytest.mark.slow
def test_outputs_follow_time_alone_and_states_alone(exchange: Exchange) -> None:
    growth = exchange("Growth").begin()
    assert growth.event()[4:] == (True, 0.1)
    growth.model.enterContinuousTimeMode()
    assert growth["time"] == 0.0
    growth.model.setTime(0.05)
    assert growth["time"] == 0.05
    ball = exchange("Ball").solving()
    assert ball["height"] == 1.0
    assert ball.status(*ball.vector("SetContinuousStates", 2, (c_double * 2)(0.5, 0.0))) == "ok"
    assert ball["height"] == 0.5


def test_a_step_of_a_block_takes_the_inputs_of_its_beginning(exchange: Exchange) -> None:
    """An event between two samples changes no input of the step, and keeps its time."""
    growth = exchange("Growth").solving()
    for t, value in ((0.05, 1.0), (0.1, 1.0), (0.25, 2.0)):
        growth.model.setTime(t)
        growth.model.enterEventMode()
        growth["factor"] = 2.0
        growth.event()
        assert (growth["time"], growth["value"]) == (t, value)
        growth.model.enterContinuousTimeMode()


def test_samples_of_a_block_are_its_internal_steps(exchange: Exchange) -> None:
    growth = exchange("Growth").begin(internal_step=0.03)
    assert growth.event()[4:] == (True, 0.025)
    growth.model.setTime(1e8)
    text = growth.refused("newDiscreteStates")
    assert text.endswith("size 1e+08 s: expected at most 1e+09 internal steps")


@pytest.mark.parametrize(("internal_step", "next_sample"), [(0.02, 0.22), (0.1, 0.3)])
def test_steps_of_another_size_begin_where_the_last_one_ended(
    exchange: Exchange, internal_step: float, next_sample: float
) -> None:
    growth = exchange("Growth").begin(internal_step=0.05)
    growth["factor"] = 2.0
    growth.event()
    growth.model.enterContinuousTimeMode()
    growth.event(0.2)
    assert growth["value"] == 16.0
    growth["internal_step"] = internal_step
    assert growth.event()[4:] == (True, pytest.approx(next_sample, rel=1e-12))
    assert growth["value"] == 16.0


@pytest.mark.parametrize(("t", "next_sample"), [(0.3, 0.5), (0.45, 0.575)])
def test_a_sample_that_was_missed_is_taken_late(exchange: Exchange, t: float, next_sample: float) -> None:
    """As in co-simulation: one that is late by more than half a period starts the clock again."""
    ball = exchange("Ball").solving().at(t, [0.6, -1.0])
    assert ball.event(t) == (False, False, False, False, True, next_sample)
    assert ball["reading"] == 0.6


def test_without_samples_no_event_is_announced(exchange: Exchange) -> None:
    assert exchange("ExamplePlant").begin().event() == (False, False, False, False, False, 0.0)


# what changes when


def test_truth_values_change_at_events_alone(exchange: Exchange) -> None:
    ball = exchange("Ball").solving().at(0.1, [0.25, -1.0])
    reference = [ball.references["is_low"]]
    assert (ball["height"], ball.model.getBoolean(reference)) == (0.25, [False])
    ball.model.enterEventMode()
    assert ball.model.getBoolean(reference) == [True]


@pytest.mark.slow
def test_discrete_reals_change_at_events_alone(exchange: Exchange) -> None:
    tank = exchange("Tank").begin()
    tank["opening"] = 0.5
    tank.event()
    assert (tank["level"], tank["shown"]) == (1.0, 1.5)
    tank.model.enterContinuousTimeMode()
    tank.at(0.1, [0.25])
    tank["inflow"] = 2.0
    assert (tank["level"], tank["shown"], *tank.rates) == (0.25, 1.5, 1.875)
    tank.model.enterEventMode()
    assert tank["shown"] == 0.75
    tank["opening"] = 0.0
    assert tank["shown"] == 0.25


def test_inputs_are_there_at_once_and_states_jump_at_events_alone(exchange: Exchange) -> None:
    ball = exchange("Ball").solving()
    ball["lift"] = 3.0
    assert (ball["lifted"], *ball.rates, *ball.indicators) == (3.0, 0.0, -5.0, 1.0, 1.0)
    ball.at(0.1, [-0.01, -2.0])
    assert (ball["bounces"], *ball.states) == (0.0, -0.01, -2.0)
    assert list(ball.indicators) == [-0.01, 1.0]  # of the present input too
    ball.model.enterEventMode()
    assert ball.event()[3]
    assert (ball["bounces"], *ball.states) == (1.0, -0.01, 1.0)
    assert not ball.event()[3]
    assert ball["bounces"] == 1.0


def test_the_solver_may_set_states_one_by_one(exchange: Exchange) -> None:
    ball = exchange("Ball").solving()
    assert ball["height"] == 1.0
    ball["state.height"] = 0.25
    assert (ball["height"], *ball.states) == (0.25, 0.25, 0.0)
    velocity, height = ball.references["state.velocity"], ball.references["state.height"]
    text = ball.refused("setReal", [velocity], [math.inf], status="discard")
    assert text == "fmi2SetReal: state.velocity = inf: expected a finite number"
    ball.model.enterEventMode()
    text = ball.refused("setReal", [height], [0.5])
    assert text == "fmi2SetReal: state.height can not be set, it is calculated"


def test_a_ball_bounces_where_the_closed_form_has_it(small_built: Fmus) -> None:
    """From 1 m under 8 m/s2: at 0.5 s with 4 m/s, then after 0.5 s and 0.25 s more, half as fast each."""
    result: Any = fmpy.simulate_fmu(
        str(small_built["Ball"]),
        fmi_type="ModelExchange",
        stop_time=1.125,
        output_interval=0.125,
        relative_tolerance=1e-9,
    )
    at = {round(float(row["time"]), 3): row for row in result}
    assert at[0.5]["bounces"] in (0.0, 1.0)  # at the event, before or after it
    assert at[0.75]["bounces"] == 1.0
    assert at[0.75]["height"] == pytest.approx(2.0**2 / (2 * 8.0), abs=1e-6)
    assert at[1.125]["bounces"] == 2.0
    assert at[1.125]["height"] == pytest.approx(1.0**2 / (2 * 8.0), abs=1e-6)
    assert at[1.125]["reading"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("moment", ["event", "continuous"])
def test_a_saved_state_goes_on(exchange: Exchange, moment: str) -> None:
    ball, other = exchange("Ball").solving().at(0.25, [0.5, -1.0]), exchange("Ball")
    if moment == "event":
        ball.event(0.25)
    data = ball.model.serializeFMUstate(ball.model.getFMUstate())
    other.model.setFMUstate(other.model.deSerializeFMUstate(data))
    for instance in (ball, other):
        if moment == "continuous":
            instance.event(0.25)
        instance.model.enterContinuousTimeMode()
        instance.at(0.5, [0.25, 1.0]).event(0.5)
    reals = [name for name in ball.references if name not in ("level", "is_low")]
    assert [ball[name] for name in reals] == [other[name] for name in reals]
    assert ball["reading"] == 0.25


def test_an_event_that_fails_is_an_error_from_which_a_saved_state_leads_back(exchange: Exchange) -> None:
    """The second of two samples that are due overflows; with one alone the instance goes on. By 2.1.3 no
    function of events may discard.
    """
    growth = exchange("Growth").begin()

    def fail_and_restore() -> None:
        before = growth.model.getFMUState()
        assert growth.status("newDiscreteStates") == "error"
        growth.model.setFMUState(before)

    growth["factor"] = 1e200
    growth.event()
    growth.model.enterContinuousTimeMode()
    growth.model.setTime(0.2)
    growth.model.enterEventMode()
    fail_and_restore()
    assert (growth["value"], growth["time"]) == (1.0, 0.2)
    growth.model.setTime(0.1)
    assert growth.event()[4:] == (True, 0.2)
    assert (growth["value"], growth["time"]) == (1e200, 0.1)
    growth["factor"] = 0.5
    growth.model.setTime(0.25)
    fail_and_restore()  # the step began with the factor of before
    growth.model.setTime(0.15)
    assert growth.event()[4:] == (True, 0.2)
    assert growth["time"] == 0.15


# refusals


VECTORS = ("GetContinuousStates", "GetDerivatives", "GetNominalsOfContinuousStates", "SetContinuousStates")


@pytest.mark.parametrize("name", VECTORS)
@pytest.mark.parametrize(
    ("count", "array", "reason"),
    [
        (1, None, "1 values: expected 2"),
        (3, None, "3 values: expected 2"),
        (2, POINTER(c_double)(), "the array is NULL"),
    ],
)
def test_a_vector_of_another_length_or_none_is_refused(
    exchange: Exchange, name: str, count: int, array: Any, reason: str
) -> None:
    ball = exchange("Ball").solving()
    assert ball.status(*ball.vector(name)) == "ok"
    assert ball.refused(*ball.vector(name, count, array)) == f"fmi2{name}: {reason}"


@pytest.mark.parametrize(
    ("mode", "call"),
    [
        ("event mode", "SetContinuousStates"),
        ("event mode", "CompletedIntegratorStep"),
        ("continuous-time mode", "NewDiscreteStates"),
        ("continuous-time mode", "EnterContinuousTimeMode"),
    ],
)
def test_calls_in_another_mode_are_refused(exchange: Exchange, mode: str, call: str) -> None:
    ball = exchange("Ball").begin()
    if mode == "continuous-time mode":
        ball.model.enterContinuousTimeMode()
    is_vector = call == "SetContinuousStates"
    text = ball.refused(*(ball.vector(call) if is_vector else (call[0].lower() + call[1:],)))
    assert text == f"fmi2{call} is not allowed in the state '{mode}'"


@pytest.mark.parametrize(
    ("block", "name", "kind"),
    [("Ball", "gravity", "Real"), ("Ball", "level", "Integer"), ("Tank", "opening", "Real")],
)
def test_what_is_no_continuous_input_is_set_at_events_alone(
    exchange: Exchange, block: str, name: str, kind: str
) -> None:
    fmu = exchange(block).begin()
    call = f"set{kind}", [fmu.references[name]], [1]
    assert fmu.status(*call) == "ok"
    fmu.model.enterContinuousTimeMode()
    assert fmu.refused(*call) == f"fmi2Set{kind}: {name} can not be set in continuous-time mode"


def test_a_step_of_the_solver_asks_for_nothing(exchange: Exchange) -> None:
    ball = exchange("Ball").begin()
    ball.model.enterContinuousTimeMode()
    asked = c_int(7), c_int(7)
    arguments = c_void_p(ball.model.component), c_int(1), *map(byref, asked)
    assert ball.model.dll.fmi2CompletedIntegratorStep(*arguments) == 0
    assert [flag.value for flag in asked] == [0, 0]


def test_states_and_derivatives_of_the_start_follow_parameters(exchange: Exchange) -> None:
    vehicle = exchange("RovDepthPlant").initialize(initial_depth=3.0)
    assert vehicle.states[0] == 3.0
    vehicle["initial_heave_velocity"] = 0.25
    assert vehicle.rates[0] == 0.25
    vehicle["net_weight"] = 30.0  # above the weight, of which nominal values know nothing
    assert list(vehicle.nominals) == [1.0] * 4
    assert vehicle.status(*vehicle.vector("GetContinuousStates")) == "error"


def test_derivatives_need_an_initialization_and_parameters_that_agree(exchange: Exchange) -> None:
    vehicle = exchange("RovDepthPlant")
    text = vehicle.refused(*vehicle.vector("GetDerivatives"))
    assert text == "fmi2GetDerivatives is not allowed in the state 'instantiated'"
    rate = [vehicle.references["der(state.depth)"]]
    for call in (vehicle.vector("GetDerivatives"), ("getReal", rate)):
        vehicle.model.reset()
        vehicle.begin()["net_weight"] = 30.0  # above the weight
        assert "expected net_weight below weight" in vehicle.refused(*call)


def test_derivatives_that_are_not_finite_are_discarded(exchange: Exchange) -> None:
    vehicle = exchange("RovDepthPlant").solving()
    x = vehicle.states
    vehicle.at(0.0, np.where(np.arange(len(x)) == 1, 1e200, x))
    text = vehicle.refused(*vehicle.vector("GetDerivatives"), status="discard")
    assert text == "fmi2GetDerivatives at 0 s: not finite; take shorter steps"


def test_what_is_not_finite_is_refused(exchange: Exchange) -> None:
    ball = exchange("Ball").solving()
    wrong = ball.vector("SetContinuousStates", 2, (c_double * 2)(math.nan, 0.0))
    assert ball.status(*wrong) == "discard"
    assert list(ball.states) == [1.0, 0.0]
    assert ball.at(0.0, [1.0, 0.0]).status("setTime", math.inf) == "error"


def test_an_event_past_the_stop_time_is_refused_and_a_trial_is_not(exchange: Exchange) -> None:
    ball = exchange("Ball").solving(stop_time=1.0)
    assert ball.status("setTime", 1.5) == "ok"
    ball.model.enterEventMode()
    assert "at most the stop time 1 s" in ball.refused("newDiscreteStates")


def test_calls_and_states_of_the_other_interface_are_refused(
    exchange: Exchange, load: Any, small_built: Fmus
) -> None:
    slave, ball = load(small_built["Ball"]).begin(), exchange("Ball").begin()
    foreign = "SetFMUstate: the state is of the other interface"
    assert ball.refused("setFMUstate", slave.slave.getFMUstate()) == f"fmi2{foreign}"
    ball.model.reset()
    assert slave.status("setFMUstate", ball.begin().model.getFMUstate()) == "error"
    ball.model.terminate()
    component, value = c_void_p(ball.model.component), (c_double * 1)()
    vr, order = (c_uint * 1)(ball.references["height"]), (c_int * 1)(1)
    for name, arguments in (
        ("fmi2GetRealOutputDerivatives", (vr, c_size_t(1), order, value)),
        ("fmi2GetRealStatus", (c_int(2), value)),
    ):
        assert getattr(ball.model.dll, name)(component, *arguments) == 3
        assert ball.log[-1] == f"{name}: expected an instance for co-simulation"
    slave.slave.reset()
    assert ball.model.dll.fmi2SetTime(c_void_p(slave.slave.component), c_double(0.0)) == 3
    assert "fmi2SetTime: expected an instance for model exchange" in slave.log
