"""Model exchange of native FMUs: states, derivatives, events, orders of convergence, refusals."""

import dataclasses
import math
import random
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from ctypes import POINTER, byref, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.linalg import expm

from fmus.block import Block, NoValues, variable
from fmus.block.scalars import flatten, unflatten
from fmus.build import builder
from fmus.build.random_points import drawn
from fmus.compliance.examine import examine
from fmus.errors import ExportError
from fmus.registry import block_entry_points
from tests.shared_builds import Fmus

from .exchanged import BALL, GROWTH, TANK, Exchanged, Outputs, Reading, State, euler, heun, rk4

CONTROLLERS = [
    name
    for name, point in block_entry_points().items()
    if any(v.name == "measured_depth" for v in point.load().of_causality("input"))
]
CONTINUOUS = ("ExamplePlant", "RovDepthPlant", "RovHeavePitchPlant", "BlueRov2Plant")
Load = Callable[[Path], Exchanged]


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return builder.build_block(BALL, tmp_path_factory.mktemp("ball"))


@pytest.fixture(scope="module")
def growth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return builder.build_block(GROWTH, tmp_path_factory.mktemp("growth"))


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return builder.build_block(TANK, tmp_path_factory.mktemp("tank"))


@pytest.fixture
def exchange(tmp_path: Path) -> Iterator[Load]:
    loaded: list[Exchanged] = []

    def one(path: Path) -> Exchanged:
        loaded.append(Exchanged(path, tmp_path / f"{len(loaded)}"))
        return loaded[-1]

    yield one
    for instance in loaded:
        instance.model.freeInstance()


def co_simulated(path: Path, stop_time: float, h: float, **values: float) -> Mapping[str, float]:
    """Returns the outputs at the end of a run of co-simulation."""
    result: Any = fmpy.simulate_fmu(
        str(path), fmi_type="CoSimulation", stop_time=stop_time, step_size=h, output_interval=h,
        start_values=values,
    )  # fmt: skip
    return dict(zip(result.dtype.names, result[-1], strict=True))


# the description


@pytest.mark.parametrize("name", builder.block_names())
def test_one_fmu_has_both_interfaces_and_fmpy_runs_both(built: Fmus, name: str) -> None:
    path, block = str(built[name]), builder.load_block(name)
    description: Any = fmpy.read_model_description(path)
    assert validate_fmu(path) == []
    assert description.modelExchange.modelIdentifier == description.coSimulation.modelIdentifier == name
    assert description.numberOfContinuousStates == len(flatten(block.continuous))
    for interface in ("ModelExchange", "CoSimulation"):
        stop = 4 * block.step_size
        result: Any = fmpy.simulate_fmu(path, fmi_type=interface, stop_time=stop, output_interval=stop)
        assert result["time"][-1] == pytest.approx(stop)
        assert all(np.isfinite(result[v.name]).all() for v in block.of_causality("output"))


def test_states_and_their_derivatives_are_variables(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    rows = {v.name: v for v in fmu.description.modelVariables if v.causality == "local"}
    assert [(v.name, v.unit) for v in rows.values()] == [
        ("state.height", "m"), ("state.velocity", "m/s"),
        ("der(state.height)", "m/s"), ("der(state.velocity)", "m/s2"),
    ]  # fmt: skip
    assert rows["der(state.velocity)"].derivative is rows["state.velocity"]
    assert [unknown.variable.name for unknown in fmu.description.derivatives] == [*rows][2:]
    assert list(fmu.states) == [fmu["state.height"], fmu["state.velocity"]] == [1.0, 0.0]
    assert list(fmu.rates) == [fmu["der(state.height)"], fmu["der(state.velocity)"]] == [0.0, -8.0]
    assert list(fmu.nominals) == [2.0, 1.0]
    assert list(fmu.indicators) == [1.0, -2.0]


def test_a_state_that_an_event_may_change_has_reinit(ball: Path, growth: Path) -> None:
    """FMI 2.0.5, 2.2.7: a bounce changes the velocity, nothing changes another state."""
    for path, expected in ((ball, ["state.velocity"]), (growth, [])):
        with zipfile.ZipFile(path) as archive:
            description = ElementTree.fromstring(archive.read("modelDescription.xml"))
        variables = description.iterfind("ModelVariables/ScalarVariable[Real]")
        assert [v.get("name") for v in variables if v.find("Real[@reinit]") is not None] == expected


def test_dependencies_are_those_of_the_equations(ball: Path, exchange: Load) -> None:
    description = exchange(ball).description
    listed = {
        unknown.variable.name: [v.name for v in unknown.dependencies]
        for unknown in (*description.outputs, *description.derivatives)
    }
    assert listed == {
        "height": ["state.height"], "lifted": ["lift"], "bounces": [], "reading": [],
        "is_low": ["state.height"],
        "der(state.height)": ["state.velocity"], "der(state.velocity)": ["lift"],
    }  # fmt: skip


# derivatives


@pytest.mark.parametrize("name", CONTINUOUS)
def test_derivatives_and_indicators_are_those_of_the_block(built: Fmus, exchange: Load, name: str) -> None:
    block, rng = builder.load_block(name), random.Random(1)
    fmu, p = exchange(built[name]).begin(), block.parameters()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    c = block.calculate(p)
    assert block.derivative
    for _ in range(20):
        u, x = drawn(block, "input", block.inputs, 0.7, rng), [rng.uniform(-2, 2) for _ in fmu.states]
        for v, value in zip(block.of_causality("input"), flatten(u), strict=True):
            fmu[v.name] = value
        fmu.at(0.01, x)
        start = flatten(block.initial_state(0.0, block.inputs(), p, c))
        state = block.held(0.01, unflatten(block.state, [*x, *start[len(x) :]]), u, p, c)
        scale = 1e-12  # of roundings in another order
        assert fmu.rates == pytest.approx(
            flatten(block.derivative(0.01, state, u, p, c)), rel=scale, abs=scale
        )
        assert fmu.indicators == pytest.approx(block.crossings(0.01, state, u, p, c), rel=scale, abs=scale)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_directional_derivatives_are_those_of_differences(built: Fmus, exchange: Load, name: str) -> None:
    """Of outputs and derivatives by continuous states and inputs, at a point away from corners."""
    fmu = exchange(built[name]).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    x = 0.3 + 0.01 * np.arange(fmu.count)
    inputs = [v.name for v in fmu.description.modelVariables if v.causality == "input" and v.type == "Real"]
    point = {name: 0.5 - 0.02 * i for i, name in enumerate(inputs)}
    outputs = [unknown.variable.name for unknown in (*fmu.description.outputs, *fmu.description.derivatives)]
    states = [v.name for v in fmu.description.modelVariables if v.name.startswith("state.")]

    def values(changed: str, change: float) -> np.ndarray:
        for own, value in point.items():
            fmu[own] = value + change * (own == changed)
        fmu.at(0.01, [xi + change * (own == changed) for own, xi in zip(states, x, strict=True)])
        return np.array([fmu[own] for own in outputs])

    unknowns = [fmu.references[name] for name in outputs]
    for known in (*inputs, *states):
        difference = (values(known, 1e-5) - values(known, -1e-5)) / 2e-5
        values("", 0.0)
        given = fmu.model.getDirectionalDerivative(unknowns, [fmu.references[known]], [1.0])
        assert given == pytest.approx(difference, rel=1e-6, abs=1e-6), known


@pytest.mark.parametrize(("dead_zone", "expected"), [(0.0, 0.5 / 0.25), (0.1, 0.0)])
def test_at_0_v_the_derivative_of_a_thruster_is_that_of_its_line_or_of_its_dead_zone(
    built: Fmus, exchange: Load, dead_zone: float, expected: float
) -> None:
    """F' = (K v - F) / T, by v; in a dead zone the voltage has no effect."""
    values = {"thruster_gain[1]": 0.5, "thruster_lag[1]": 0.25, "thruster_dead_zone[1]": dead_zone}
    fmu = exchange(built["RovDepthPlant"]).begin(**values, **{"voltage[1]": 0.0})
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    rate, voltage = (fmu.references[name] for name in ("der(state.thruster_force[1])", "voltage[1]"))
    assert fmu.model.getDirectionalDerivative([rate], [voltage], [1.0]) == [expected]


@pytest.mark.parametrize("known", ["initial_state[1]", "theta[2]", "control"])
def test_derivatives_at_the_start_follow_parameters_and_inputs(
    built: Fmus, exchange: Load, known: str
) -> None:
    def started(change: float) -> tuple[Exchanged, list[str], np.ndarray]:
        fmu = exchange(built["ExamplePlant"])
        fmu.model.setupExperiment()
        fmu.model.enterInitializationMode()
        point = {"initial_state[1]": 0.5, "initial_state[2]": 0.25, "theta[2]": -4.0, "control": 2.0}
        for name, value in point.items():
            fmu[name] = value + change * (name == known)
        unknowns = [u.variable.name for u in fmu.description.initialUnknowns]
        return fmu, unknowns, np.array([fmu[name] for name in unknowns])

    fmu, unknowns, below = started(0.0)
    given = fmu.model.getDirectionalDerivative(
        [fmu.references[name] for name in unknowns], [fmu.references[known]], [1.0]
    )
    # all of these are linear in each of the three
    assert given == pytest.approx(started(1.0)[2] - below, rel=1e-12, abs=1e-12)
    assert any(given[unknowns.index(name)] for name in unknowns if name.startswith("der("))


# convergence


@pytest.mark.parametrize(("solver", "order"), [(euler, 1), (heun, 2), (rk4, 4)])
def test_it_converges_to_the_closed_form_with_the_order_of_the_solver(
    built: Fmus, exchange: Load, solver: Any, order: int
) -> None:
    a = np.array([[0.0, 1.0, 0.0], [3.0, -5.9, 2.3], [0.0, 0.0, 0.0]])
    exact = (expm(a) @ [1.0, -0.5, 1.0])[:2]

    def error(steps: int) -> float:
        fmu = exchange(built["ExamplePlant"])
        fmu.begin(**{"initial_state[1]": 1.0, "initial_state[2]": -0.5, "control": 2.0, "disturbance": 0.3})
        fmu.event()
        fmu.model.enterContinuousTimeMode()
        x = fmu.states
        for i in range(steps):
            x = solver(fmu.slope, i / steps, x, 1 / steps)
        return float(np.abs(x - exact).max())

    # the next term of the error is about a twentieth of this one
    assert math.log2(error(40) / error(80)) == pytest.approx(order, abs=0.25)


def test_co_simulation_has_the_fourth_order_of_its_scheme(ball: Path, built: Fmus) -> None:
    a = np.array([[0.0, 1.0, 0.0], [3.0, -5.9, 2.0], [0.0, 0.0, 0.0]])
    exact = (expm(a) @ [1.0, 0.0, 1.0])[0]

    def error(h: float) -> float:
        values = {"initial_state[1]": 1.0, "control": 2.0, "internal_step": h}
        return abs(co_simulated(built["ExamplePlant"], 1.0, 0.2, **values)["state[1]"] - exact)

    assert math.log2(error(0.02) / error(0.01)) == pytest.approx(4, abs=0.25)


# steps well below the time constant of the thrusters, in BlueRov2Plant 1 / (91 rad/s)
@pytest.mark.parametrize(("name", "h"), [("RovDepthPlant", 0.01), ("BlueRov2Plant", 0.0025)])
def test_co_simulation_of_a_vehicle_converges_to_model_exchange(
    built: Fmus, exchange: Load, name: str, h: float
) -> None:
    """Thrusters by the exact answer there, by the solver here; below the surface, away from corners."""
    values = {"initial_depth": 2.0, "voltage[1]": 6.0, "voltage[2]": 6.0, "sensor_noise": 0.0}
    exact = exchange(built[name]).begin(**values).run(0.5, 2e-4)["depth"]

    def error(h: float) -> float:
        return abs(co_simulated(built[name], 0.5, 0.1, internal_step=h, **values)["depth"] - exact)

    assert error(h) < 1e-7
    assert math.log2(error(h) / error(h / 2)) == pytest.approx(4, abs=0.25)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_block_without_derivative_samples_as_co_simulation_steps(
    built: Fmus, exchange: Load, name: str
) -> None:
    """Bit for bit, at the suggested step size, with inputs that change at samples."""
    path = built[name]
    slave: Any = fmpy.instantiate_fmu(
        fmpy.extract(str(path)), fmpy.read_model_description(str(path)), "CoSimulation"
    )
    slave.setupExperiment(startTime=1.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    fmu = exchange(path).begin(1.0)
    names = [v.name for v in fmu.description.modelVariables if v.causality == "output"]
    references, h = [fmu.references[name] for name in names], fmu.description.defaultExperiment.stepSize
    measured, seen = fmu.references["measured_depth"], set[tuple[float, ...]]()
    for i in range(20):
        for model in (slave, fmu.model):
            model.setReal([measured], [0.1 * i])
        *_, is_defined, at = fmu.event()
        assert is_defined
        assert at == 1.0 + (i + 1) * float(h)
        assert fmu.model.getReal(references) == slave.getReal(references)
        seen.add(tuple(fmu.model.getReal(references)))
        fmu.model.enterContinuousTimeMode()
        fmu.model.setTime(at)
        fmu.model.setReal([measured], [99.0])  # before the sample, and without effect
        assert fmu.model.getReal(references) == slave.getReal(references)
        fmu.model.enterEventMode()
        slave.doStep(1.0 + i * float(h), float(h))
    assert len(seen) > 10
    slave.freeInstance()


# events


def test_samples_are_taken_at_events_alone(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    assert fmu.event()[3:] == (False, True, 0.25)
    fmu.model.enterContinuousTimeMode()
    fmu.at(0.25, [0.7, -1.0])
    assert fmu["height"] == 0.7
    assert fmu["reading"] == 0.0
    fmu.model.enterEventMode()
    assert fmu["reading"] == 0.0
    fmu.model.setInteger([fmu.references["level"]], [3])
    assert fmu.event() == (False, False, False, False, True, 0.5)
    assert fmu["reading"] == 3.7
    assert fmu.event()[3:] == (False, True, 0.5)
    assert fmu["reading"] == 3.7


def test_outputs_follow_time_alone_and_states_alone(ball: Path, growth: Path, exchange: Load) -> None:
    fmu = exchange(growth).begin()
    assert fmu.event()[4:] == (True, 0.1)
    fmu.model.enterContinuousTimeMode()
    assert fmu["time"] == 0.0
    fmu.model.setTime(0.05)
    assert fmu["time"] == 0.05
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    assert fmu["height"] == 1.0
    assert _vector(fmu, "SetContinuousStates", 2, (c_double * 2)(0.5, 0.0)) == "ok"
    assert fmu["height"] == 0.5


def test_a_step_of_a_block_takes_the_inputs_of_its_beginning(growth: Path, exchange: Load) -> None:
    """An event between two samples changes no input of the step, and keeps its time."""
    fmu = exchange(growth).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    for t, value in ((0.05, 1.0), (0.1, 1.0), (0.25, 2.0)):
        fmu.model.setTime(t)
        fmu.model.enterEventMode()
        fmu["factor"] = 2.0
        fmu.event()
        assert (fmu["time"], fmu["value"]) == (t, value)
        fmu.model.enterContinuousTimeMode()


def test_samples_of_a_block_are_its_internal_steps(growth: Path, exchange: Load) -> None:
    fmu = exchange(growth).begin(internal_step=0.03)
    assert fmu.event()[4:] == (True, 0.025)
    fmu.model.setTime(1e8)
    assert fmu.status(fmu.model.newDiscreteStates) == "error"
    assert fmu.log[-1].endswith("size 1e+08 s: expected at most 1e+09 internal steps")


@pytest.mark.parametrize(("internal_step", "next_sample"), [(0.02, 0.22), (0.1, 0.3)])
def test_steps_of_another_size_begin_where_the_last_one_ended(
    growth: Path, exchange: Load, internal_step: float, next_sample: float
) -> None:
    fmu = exchange(growth).begin(internal_step=0.05)
    fmu["factor"] = 2.0
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu.event(0.2)
    assert fmu["value"] == 16.0
    fmu["internal_step"] = internal_step
    assert fmu.event()[4:] == (True, pytest.approx(next_sample, rel=1e-12))
    assert fmu["value"] == 16.0


def test_truth_values_change_at_events_alone(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    reference = [fmu.references["is_low"]]
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu.at(0.1, [0.25, -1.0])
    assert (fmu["height"], fmu.model.getBoolean(reference)) == (0.25, [False])
    fmu.model.enterEventMode()
    assert fmu.model.getBoolean(reference) == [True]


def test_discrete_reals_change_at_events_alone(tank: Path, exchange: Load) -> None:
    fmu = exchange(tank).begin()
    fmu["opening"] = 0.5
    fmu.event()
    assert (fmu["level"], fmu["shown"]) == (1.0, 1.5)
    fmu.model.enterContinuousTimeMode()
    fmu.at(0.1, [0.25])
    fmu["inflow"] = 2.0
    assert (fmu["level"], fmu["shown"], *fmu.rates) == (0.25, 1.5, 1.875)
    fmu.model.enterEventMode()
    assert fmu["shown"] == 0.75
    fmu["opening"] = 0.0
    assert fmu["shown"] == 0.25


def test_a_tool_finds_nothing_in_an_fmu_with_discrete_reals(tank: Path) -> None:
    assert validate_fmu(str(tank)) == []
    assert [r.messages for r in examine(tank) if r.messages] == []


def test_indicators_follow_inputs_at_once(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu["lift"] = 5.0
    assert list(fmu.indicators) == [1.0, 3.0]


def test_the_solver_may_set_states_one_by_one(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    assert fmu["height"] == 1.0
    fmu["state.height"] = 0.25
    assert fmu["height"] == 0.25
    assert list(fmu.states) == [0.25, 0.0]
    assert fmu.status(fmu.__setitem__, "state.velocity", math.inf) == "discard"
    assert fmu.log[-1] == "fmi2SetReal: state.velocity = inf: expected a finite number"
    fmu.model.enterEventMode()
    assert fmu.status(fmu.__setitem__, "state.height", 0.5) == "error"
    assert fmu.log[-1] == "fmi2SetReal: state.height can not be set, it is calculated"


def test_without_samples_no_event_is_announced(built: Fmus, exchange: Load) -> None:
    assert exchange(built["ExamplePlant"]).begin().event() == (False, False, False, False, False, 0.0)


def test_an_event_that_fails_is_an_error_from_which_a_saved_state_leads_back(
    growth: Path, exchange: Load
) -> None:
    """The second of two samples that are due overflows; with one alone the instance goes on. By 2.1.3 no
    function of events may discard.
    """
    fmu = exchange(growth).begin()
    fmu["factor"] = 1e200
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu.model.setTime(0.2)
    fmu.model.enterEventMode()
    before = fmu.model.getFMUState()
    assert fmu.status(fmu.model.newDiscreteStates) == "error"
    fmu.model.setFMUState(before)
    assert (fmu["value"], fmu["time"]) == (1.0, 0.2)
    fmu.model.setTime(0.1)
    assert fmu.event()[4:] == (True, 0.2)
    assert (fmu["value"], fmu["time"]) == (1e200, 0.1)
    fmu["factor"] = 0.5
    fmu.model.setTime(0.25)
    before = fmu.model.getFMUState()
    assert fmu.status(fmu.model.newDiscreteStates) == "error"  # the step began with the factor of before
    fmu.model.setFMUState(before)
    fmu.model.setTime(0.15)
    assert fmu.event()[4:] == (True, 0.2)
    assert fmu["time"] == 0.15


@pytest.mark.parametrize(("t", "next_sample"), [(0.3, 0.5), (0.45, 0.575)])
def test_a_sample_that_was_missed_is_taken_late(
    ball: Path, exchange: Load, t: float, next_sample: float
) -> None:
    """As in co-simulation: one that is late by more than half a period starts the clock again."""
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu.at(t, [0.6, -1.0])
    assert fmu.event(t) == (False, False, False, False, True, next_sample)
    assert fmu["reading"] == 0.6


def test_inputs_are_there_at_once_and_states_jump_at_events_alone(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu["lift"] = 3.0
    assert fmu["lifted"] == 3.0
    assert list(fmu.rates) == [0.0, -5.0]
    fmu.at(0.1, [-0.01, -2.0])
    assert fmu["bounces"] == 0.0
    assert list(fmu.states) == [-0.01, -2.0]
    assert list(fmu.indicators) == [-0.01, 1.0]  # of the present input too
    fmu.model.enterEventMode()
    assert fmu.event()[3]
    assert list(fmu.states) == [-0.01, 1.0]
    assert fmu["bounces"] == 1.0
    assert not fmu.event()[3]
    assert fmu["bounces"] == 1.0


def test_a_ball_bounces_where_the_closed_form_has_it(ball: Path) -> None:
    """From 1 m under 8 m/s2: at 0.5 s with 4 m/s, then after 0.5 s and 0.25 s more, half as fast each."""
    result: Any = fmpy.simulate_fmu(
        str(ball), fmi_type="ModelExchange", stop_time=1.125, output_interval=0.125, relative_tolerance=1e-9
    )
    at = {round(float(row["time"]), 3): row for row in result}
    assert at[0.5]["bounces"] in (0.0, 1.0)  # at the event, before or after it
    assert at[0.75]["bounces"] == 1.0
    assert at[0.75]["height"] == pytest.approx(2.0**2 / (2 * 8.0), abs=1e-6)
    assert at[1.125]["bounces"] == 2.0
    assert at[1.125]["height"] == pytest.approx(1.0**2 / (2 * 8.0), abs=1e-6)
    assert at[1.125]["reading"] == pytest.approx(0.0, abs=1e-6)


def test_co_simulation_bounces_too(ball: Path) -> None:
    """In steps of 0.01 s, at whose ends it bounces, so it is late by as much."""
    values = co_simulated(ball, 0.75, 0.05, internal_step=1e-4, lift=0.0)
    assert values["bounces"] == 1.0
    assert values["height"] == pytest.approx(0.25, abs=1e-3)


@pytest.mark.parametrize("moment", ["event", "continuous"])
def test_a_saved_state_goes_on(ball: Path, exchange: Load, moment: str) -> None:
    fmu, other = exchange(ball).begin(), exchange(ball)
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    fmu.at(0.25, [0.5, -1.0])
    if moment == "event":
        fmu.event(0.25)
    data = fmu.model.serializeFMUstate(fmu.model.getFMUstate())
    other.model.setFMUstate(other.model.deSerializeFMUstate(data))
    for instance in (fmu, other):
        if moment == "continuous":
            instance.event(0.25)
        instance.model.enterContinuousTimeMode()
        instance.at(0.5, [0.25, 1.0])
        instance.event(0.5)
    for name in fmu.references:
        if name not in ("level", "is_low"):  # no Reals
            assert fmu[name] == other[name]
    assert fmu["reading"] == 0.25


# refusals


def _vector(fmu: Exchanged, name: str, count: int | None = None, array: Any = None) -> str:
    values = (c_double * 8)() if array is None else array
    function, size = getattr(fmu.model, f"fmi2{name}"), fmu.count if count is None else count
    return fmu.status(function, fmu.model.component, values, size)


VECTORS = ("GetContinuousStates", "GetDerivatives", "GetNominalsOfContinuousStates", "SetContinuousStates")


@pytest.mark.parametrize("name", VECTORS)
@pytest.mark.parametrize(("count", "array"), [(1, None), (3, None), (2, POINTER(c_double)())])
def test_a_vector_of_another_length_or_none_is_refused(
    ball: Path, exchange: Load, name: str, count: int, array: Any
) -> None:
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    assert _vector(fmu, name) == "ok"
    assert _vector(fmu, name, count, array) == "error"
    assert fmu.log[-1] == f"fmi2{name}: " + (
        f"{count} values: expected 2" if array is None else "the array is NULL"
    )


def test_calls_in_another_mode_are_refused(ball: Path, exchange: Load) -> None:
    in_event_mode: dict[str, Callable[[Exchanged], str]] = {
        "SetContinuousStates": lambda f: _vector(f, "SetContinuousStates"),
        "CompletedIntegratorStep": lambda f: f.status(f.model.completedIntegratorStep),
    }
    in_continuous_time_mode: dict[str, Callable[[Exchanged], str]] = {
        "NewDiscreteStates": lambda f: f.status(f.model.newDiscreteStates),
        "EnterContinuousTimeMode": lambda f: f.status(f.model.enterContinuousTimeMode),
    }
    for is_continuous, calls in enumerate((in_event_mode, in_continuous_time_mode)):
        for name, call in calls.items():
            fmu = exchange(ball).begin()
            if is_continuous:
                fmu.model.enterContinuousTimeMode()
            assert call(fmu) == "error"
            mode = "continuous-time mode" if is_continuous else "event mode"
            assert fmu.log[-1] == f"fmi2{name} is not allowed in the state '{mode}'"


def test_what_is_no_continuous_input_is_set_at_events_alone(ball: Path, tank: Path, exchange: Load) -> None:
    for path, name, kind in (
        (ball, "gravity", "Real"),
        (ball, "level", "Integer"),
        (tank, "opening", "Real"),
    ):
        fmu = exchange(path).begin()
        arguments = [fmu.references[name]], [1]
        setter = getattr(fmu.model, f"set{kind}")
        assert fmu.status(setter, *arguments) == "ok"
        fmu.model.enterContinuousTimeMode()
        assert fmu.status(setter, *arguments) == "error"
        assert fmu.log[-1] == f"fmi2Set{kind}: {name} can not be set in continuous-time mode"


def test_a_step_of_the_solver_asks_for_nothing(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    fmu.model.enterContinuousTimeMode()
    asked = c_int(7), c_int(7)
    arguments = c_void_p(fmu.model.component), c_int(1), *map(byref, asked)
    assert fmu.model.dll.fmi2CompletedIntegratorStep(*arguments) == 0
    assert [flag.value for flag in asked] == [0, 0]


def test_states_and_derivatives_of_the_start_follow_parameters(built: Fmus, exchange: Load) -> None:
    fmu = exchange(built["RovDepthPlant"])
    fmu.model.setupExperiment()
    fmu.model.enterInitializationMode()
    fmu["initial_depth"] = 3.0
    assert fmu.states[0] == 3.0
    fmu["initial_heave_velocity"] = 0.25
    assert fmu.rates[0] == 0.25
    fmu["net_weight"] = 30.0  # above the weight, of which nominal values know nothing
    assert list(fmu.nominals) == [1.0] * 4
    assert _vector(fmu, "GetContinuousStates") == "error"


def test_derivatives_need_an_initialization_and_parameters_that_agree(built: Fmus, exchange: Load) -> None:
    fmu = exchange(built["RovDepthPlant"])
    assert _vector(fmu, "GetDerivatives") == "error"
    assert fmu.log[-1] == "fmi2GetDerivatives is not allowed in the state 'instantiated'"
    for read in (
        lambda: _vector(fmu, "GetDerivatives"),
        lambda: fmu.status(fmu.__getitem__, "der(state.depth)"),
    ):
        fmu.model.reset()
        fmu.begin()
        fmu["net_weight"] = 30.0  # above the weight
        assert read() == "error"
        assert "expected net_weight below weight" in fmu.log[-1]


def test_derivatives_that_are_not_finite_are_discarded(built: Fmus, exchange: Load) -> None:
    fmu = exchange(built["RovDepthPlant"]).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    x = fmu.states
    fmu.at(0.0, np.where(np.arange(len(x)) == 1, 1e200, x))
    assert _vector(fmu, "GetDerivatives") == "discard"
    assert fmu.log[-1] == "fmi2GetDerivatives at 0 s: not finite; take shorter steps"


def test_what_is_not_finite_is_refused(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin()
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    assert _vector(fmu, "SetContinuousStates", 2, (c_double * 2)(math.nan, 0.0)) == "discard"
    assert list(fmu.states) == [1.0, 0.0]
    fmu.at(0.0, [1.0, 0.0])
    assert fmu.status(fmu.model.setTime, math.inf) == "error"


def test_an_event_past_the_stop_time_is_refused_and_a_trial_is_not(ball: Path, exchange: Load) -> None:
    fmu = exchange(ball).begin(stop_time=1.0)
    fmu.event()
    fmu.model.enterContinuousTimeMode()
    assert fmu.status(fmu.model.setTime, 1.5) == "ok"
    fmu.model.enterEventMode()
    assert fmu.status(fmu.model.newDiscreteStates) == "error"
    assert "at most the stop time 1 s" in fmu.log[-1]


def test_calls_and_states_of_the_other_interface_are_refused(ball: Path, exchange: Load, load: Any) -> None:
    slave, fmu = load(ball).begin(), exchange(ball).begin()
    assert fmu.status(fmu.model.setFMUstate, slave.slave.getFMUstate()) == "error"
    assert fmu.log[-1] == "fmi2SetFMUstate: the state is of the other interface"
    fmu.model.reset()
    state = fmu.begin().model.getFMUstate()
    assert slave.status("setFMUstate", state) == "error"
    fmu.model.terminate()
    vr, order, value = (c_uint * 1)(fmu.references["height"]), (c_int * 1)(1), (c_double * 1)()
    call = fmu.model.dll.fmi2GetRealOutputDerivatives
    assert call(c_void_p(fmu.model.component), vr, c_size_t(1), order, value) == 3
    assert fmu.log[-1] == "fmi2GetRealOutputDerivatives: expected an instance for co-simulation"
    call = fmu.model.dll.fmi2GetRealStatus
    assert call(c_void_p(fmu.model.component), c_int(2), value) == 3
    assert fmu.log[-1] == "fmi2GetRealStatus: expected an instance for co-simulation"
    slave.slave.reset()
    call = fmu.model.dll.fmi2SetTime
    assert call(c_void_p(slave.slave.component), c_double(0.0)) == 3
    assert "fmi2SetTime: expected an instance for model exchange" in slave.log


# blocks


def refusal(block: Block, folder: Path) -> str:
    with pytest.raises(ExportError) as caught:
        builder.build_block(block, folder)
    return str(caught.value)


def test_a_count_that_is_not_guarded_is_refused(tmp_path: Path) -> None:
    def counts(t: float, h: float, state: State, *_: Any) -> State:
        return dataclasses.replace(state, bounces=state.bounces + 1.0)

    message = refusal(dataclasses.replace(BALL, step=counts), tmp_path)
    assert "step changes bounces by what it was: expected at_events(state, new)" in message


def test_an_integration_of_another_derivative_is_refused(tmp_path: Path) -> None:
    def falls(t: float, h: float, state: State, u: Any, p: Any, c: Any) -> State:
        return dataclasses.replace(
            state, height=state.height + h * state.velocity, velocity=state.velocity - 2.0 * h * p.gravity
        )

    message = refusal(dataclasses.replace(BALL, integrate=falls), tmp_path)
    assert "derivative gives velocity = " in message
    assert message.endswith("as the function integrate has it in a short step")


def test_an_integration_of_the_block_is_that_of_co_simulation(ball: Path, tmp_path: Path) -> None:
    def falls(t: float, h: float, state: State, u: Any, p: Any, c: Any) -> State:
        a = u.lift - p.gravity
        return dataclasses.replace(
            state, height=state.height + h * state.velocity + h * h * a, velocity=state.velocity + h * a
        )

    # h^2 a in place of h^2 a / 2: too low by h a t / 2
    own = co_simulated(builder.build_block(dataclasses.replace(BALL, integrate=falls), tmp_path), 0.4, 0.1)
    assert own["height"] - co_simulated(ball, 0.4, 0.1)["height"] == pytest.approx(-0.01 * 8.0 * 0.4 / 2)


@dataclasses.dataclass(frozen=True)
class Empty:
    pass


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"derivative": None}, "expected both a class Continuous and a function derivative, or neither"),
        ({"continuous": NoValues}, "expected both a class Continuous and a function derivative, or neither"),
        ({"state": Reading}, "expected class State(Continuous)"),
        (
            {"continuous": Empty, "state": Empty},
            "expected a state at least, or no class Continuous",
        ),
        ({"continuous": NoValues, "derivative": None, "integrate": lambda: 0}, "derivative beside integrate"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=re.escape(message)):
        dataclasses.replace(BALL, **change)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        (variable(1, "Height"), "start 1: expected a float, a continuous state is a Real"),
        (variable(1.0, "Height", nominal=0.0), "nominal 0.0: expected more than 0"),
        (variable(1.0, "Height", variability="fixed"), "variability 'fixed': expected 'continuous'"),
        (1.0, "expected a declaration"),
    ],
)
def test_a_continuous_state_is_a_real_that_is_declared(declared: Any, message: str, tmp_path: Path) -> None:
    kind = type(getattr(declared, "default", 1.0))
    own = dataclasses.make_dataclass("Continuous", [("height", kind, declared)], frozen=True)
    block = dataclasses.replace(
        BALL, continuous=own, state=own, derivative=lambda *_: own(), step=lambda t, h, state, *_: state,
        output=lambda *_: Outputs(), crossings=lambda *_: (), initial_state=lambda *_: own(),
    )  # fmt: skip
    assert message in refusal(block, tmp_path)
