"""Model exchange of native FMUs of FMI 2.0: description, derivatives, convergence, refused blocks."""

import dataclasses
import math
import random
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.linalg import expm

from fmus.block import Block, NoValues, variable
from fmus.block.random_points import drawn
from fmus.block.scalars import flatten, unflatten
from fmus.compliance.examine import examine
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.registry import BLOCKS, installed
from tests.described_fmus import members
from tests.shared_builds import Fmus, one_of_a_kind, slow_but

from .exchanged import BALL, Exchanged, Outputs, Reading, State, euler, heun, rk4

CONTROLLERS = [
    name
    for name, point in installed(BLOCKS).items()
    if any(v.name == "measured_depth" for v in point.load().of_causality("input"))
]
CONTINUOUS = one_of_a_kind(("ExamplePlant", "RovDepthPlant", "RovHeavePitchPlant", "BlueRov2Plant"))
Exchange = Callable[[str], Exchanged]


def co_simulated(path: Path, stop_time: float, h: float, **values: float) -> Mapping[str, float]:
    """Returns the outputs at the end of a run of co-simulation."""
    options: Any = {"step_size": h, "output_interval": h, "start_values": values}
    result: Any = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", stop_time=stop_time, **options)
    return dict(zip(result.dtype.names, result[-1], strict=True))


# the description


# of all types, and without a state
@pytest.mark.parametrize("name", slow_but(("L1DepthController", "ThrustAllocation"), builder.block_names()))
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


def test_states_and_their_derivatives_are_variables(exchange: Exchange) -> None:
    fmu = exchange("Ball").begin()
    rows = {v.name: v for v in fmu.description.modelVariables if v.causality == "local"}
    units = {"state.height": "m", "state.velocity": "m/s"}
    units |= {"der(state.height)": "m/s", "der(state.velocity)": "m/s2"}
    assert {v.name: v.unit for v in rows.values()} == units
    assert rows["der(state.velocity)"].derivative is rows["state.velocity"]
    assert [unknown.variable.name for unknown in fmu.description.derivatives] == [*rows][2:]
    assert list(fmu.states) == [fmu["state.height"], fmu["state.velocity"]] == [1.0, 0.0]
    assert list(fmu.rates) == [fmu["der(state.height)"], fmu["der(state.velocity)"]] == [0.0, -8.0]
    assert list(fmu.nominals) == [2.0, 1.0]
    assert list(fmu.indicators) == [1.0, -2.0]


@pytest.mark.slow
def test_a_tool_finds_nothing_in_an_fmu_with_discrete_reals(small_built: Fmus) -> None:
    assert validate_fmu(str(small_built["Tank"])) == []
    assert [r.messages for r in examine(small_built["Tank"]) if r.messages] == []


@pytest.mark.parametrize(("name", "expected"), [("Ball", ["state.velocity"]), ("Growth", [])])
def test_a_state_that_an_event_may_change_has_reinit(
    small_built: Fmus, name: str, expected: list[str]
) -> None:
    """FMI 2.0.5, 2.2.7: a bounce changes the velocity, nothing changes another state."""
    description = ElementTree.fromstring(members(small_built[name])["modelDescription.xml"])
    variables = description.iterfind("ModelVariables/ScalarVariable[Real]")
    assert [v.get("name") for v in variables if v.find("Real[@reinit]") is not None] == expected


def test_dependencies_are_those_of_the_equations(exchange: Exchange) -> None:
    description = exchange("Ball").description
    listed = {
        unknown.variable.name: [v.name for v in unknown.dependencies]
        for unknown in (*description.outputs, *description.derivatives)
    }
    outputs = {"lifted": ["lift"], "bounces": [], "reading": []}
    outputs |= {name: ["state.height"] for name in ("height", "is_low")}
    assert listed == outputs | {"der(state.height)": ["state.velocity"], "der(state.velocity)": ["lift"]}


# derivatives


@pytest.mark.parametrize("name", CONTINUOUS)
def test_derivatives_and_indicators_are_those_of_the_block(exchange: Exchange, name: str) -> None:
    block, rng = builder.load_block(name), random.Random(1)
    fmu, p = exchange(name).solving(), block.parameters()
    c = block.calculate(p)
    assert block.derivative
    for _ in range(20):
        u, x = drawn(block, "input", block.inputs, 0.7, rng), [rng.uniform(-2, 2) for _ in fmu.states]
        for v, value in zip(block.of_causality("input"), flatten(u), strict=True):
            fmu[v.name] = value
        fmu.at(0.01, x)
        start = flatten(block.initial_state(0.0, block.inputs(), p, c))
        state = block.held(0.01, unflatten(block.state, [*x, *start[len(x) :]]), u, p, c)
        rounding = 1e-12  # in another order
        rates, indicators = (f(0.01, state, u, p, c) for f in (block.derivative, block.crossings))
        assert fmu.rates == pytest.approx(flatten(rates), rel=rounding, abs=rounding)
        assert fmu.indicators == pytest.approx(indicators, rel=rounding, abs=rounding)


@pytest.mark.parametrize(("dead_zone", "expected"), [(0.0, 0.5 / 0.25), (0.1, 0.0)])
def test_at_0_v_the_derivative_of_a_thruster_is_that_of_its_line_or_of_its_dead_zone(
    exchange: Exchange, dead_zone: float, expected: float
) -> None:
    """F' = (K v - F) / T, by v; in a dead zone the voltage has no effect."""
    values = {"thruster_gain[1]": 0.5, "thruster_lag[1]": 0.25, "thruster_dead_zone[1]": dead_zone}
    fmu = exchange("RovDepthPlant").solving(**values, **{"voltage[1]": 0.0})
    rate, voltage = (fmu.references[name] for name in ("der(state.thruster_force[1])", "voltage[1]"))
    assert fmu.model.getDirectionalDerivative([rate], [voltage], [1.0]) == [expected]


@pytest.mark.parametrize("known", ["initial_state[1]", "theta[2]", "control"])
def test_derivatives_at_the_start_follow_parameters_and_inputs(exchange: Exchange, known: str) -> None:
    def started(change: float) -> tuple[Exchanged, list[str], np.ndarray]:
        point = {"initial_state[1]": 0.5, "initial_state[2]": 0.25, "theta[2]": -4.0, "control": 2.0}
        point[known] += change
        fmu = exchange("ExamplePlant").initialize(**point)
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
    exchange: Exchange, solver: Any, order: int
) -> None:
    a = np.array([[0.0, 1.0, 0.0], [3.0, -5.9, 2.3], [0.0, 0.0, 0.0]])
    exact = (expm(a) @ [1.0, -0.5, 1.0])[:2]

    def error(steps: int) -> float:
        start = {"initial_state[1]": 1.0, "initial_state[2]": -0.5, "control": 2.0, "disturbance": 0.3}
        fmu = exchange("ExamplePlant").solving(**start)
        x = fmu.states
        for i in range(steps):
            x = solver(fmu.slope, i / steps, x, 1 / steps)
        return float(np.abs(x - exact).max())

    # the next term of the error is about a twentieth of this one
    assert math.log2(error(40) / error(80)) == pytest.approx(order, abs=0.25)


def test_co_simulation_has_the_fourth_order_of_its_scheme(built: Fmus) -> None:
    a = np.array([[0.0, 1.0, 0.0], [3.0, -5.9, 2.0], [0.0, 0.0, 0.0]])
    exact = (expm(a) @ [1.0, 0.0, 1.0])[0]

    def error(h: float) -> float:
        values = {"initial_state[1]": 1.0, "control": 2.0, "internal_step": h}
        return abs(co_simulated(built["ExamplePlant"], 1.0, 0.2, **values)["state[1]"] - exact)

    assert math.log2(error(0.02) / error(0.01)) == pytest.approx(4, abs=0.25)


# steps well below the time constant of the thrusters, in BlueRov2Plant 1 / (91 rad/s)
VEHICLES = [("RovDepthPlant", 0.01), pytest.param("BlueRov2Plant", 0.0025, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("name", "h"), VEHICLES)
def test_co_simulation_of_a_vehicle_converges_to_model_exchange(
    built: Fmus, exchange: Exchange, name: str, h: float
) -> None:
    """Thrusters by the exact answer there, by the solver here; below the surface, away from corners."""
    values = {"initial_depth": 2.0, "voltage[1]": 6.0, "voltage[2]": 6.0, "sensor_noise": 0.0}
    exact = exchange(name).begin(**values).run(0.5, 2e-4)["depth"]

    def error(h: float) -> float:
        return abs(co_simulated(built[name], 0.5, 0.1, internal_step=h, **values)["depth"] - exact)

    assert error(h) < 1e-7
    assert math.log2(error(h) / error(h / 2)) == pytest.approx(4, abs=0.25)


RAMPS = {
    # voltage at 0 and 2 s; parameters; expected times [s]
    "dead zone": ((-2.13, 1.87), {"thruster_dead_zone": 0.5}, [0.815, 1.315]),
    "saturation": ((5.07, 9.07), {"thruster_voltage_limit": 6.0}, [0.465]),
    "reverse": ((-1.05, 2.95), {"thruster_reverse_ratio": 0.8}, [0.525]),
    "table": ((1.03, 3.03), {"thruster_tabulated": True}, [0.17, 1.37]),
    # from 0 N to 2 N at 2 N/s; from 0.94 N on the lag of 0.53 s alone is slower
    "rate limit": ((8.0, 8.0), {"thruster_rate_limit": 2.0, "thruster_lag": 0.53}, [0.47]),
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("corner", RAMPS)
def test_an_importer_locates_corners_of_a_thruster(
    built: Fmus, fmi3_built: Fmus, corner: str, fmi: int
) -> None:
    """FMPy's CVode, between its outputs; below the surface, which has events of its own."""
    ends, values, expected = RAMPS[corner]
    start: dict[str, Any] = {"initial_depth": 5.0, "sensor_ideal": True, "sensor_period": 10.0}
    for name, value in values.items():
        if fmi == 3 and not isinstance(value, bool):
            start[name] = [value, value]
        else:
            start[name if isinstance(value, bool) else f"{name}[1]"] = value
    column, shown = (
        (("voltage[1]", float), ends) if fmi == 2 else (("voltage", float, 2), [(v, v) for v in ends])
    )
    signal = np.array([*zip((0.0, 2.0), shown, strict=True)], dtype=[("time", float), column])
    options: Any = {"output_interval": 0.1, "input": signal, "start_values": start}
    path = str((built if fmi == 2 else fmi3_built)["RovDepthPlant"])
    result: Any = fmpy.simulate_fmu(path, fmi_type="ModelExchange", stop_time=2.0, **options)
    times = np.unique(result["time"])
    located = times[np.abs(10.0 * times - np.round(10.0 * times)) > 1e-6]
    # the end of the rate depends on a state, with an error of some tolerances of the solver, 1e-5
    assert located == pytest.approx(expected, abs=1e-4 if corner == "rate limit" else 1e-9)


@pytest.mark.parametrize("name", one_of_a_kind(CONTROLLERS))
def test_a_block_without_derivative_samples_as_co_simulation_steps(
    built: Fmus, exchange: Exchange, load: Any, name: str
) -> None:
    """Bit for bit, at the suggested step size, with inputs that change at samples."""
    slave, fmu = load(built[name]).slave, exchange(name).begin(1.0)
    slave.setupExperiment(startTime=1.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
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


def test_co_simulation_bounces_too(small_built: Fmus) -> None:
    """In steps of 0.01 s, at whose ends it bounces, so it is late by as much."""
    values = co_simulated(small_built["Ball"], 0.75, 0.05, internal_step=1e-4, lift=0.0)
    assert values["bounces"] == 1.0
    assert values["height"] == pytest.approx(0.25, abs=1e-3)


# blocks


def refusal(block: Block, folder: Path) -> str:
    with pytest.raises(ExportError) as caught:
        builder.build_block(block, folder)
    return str(caught.value)


def test_a_count_that_is_not_guarded_is_refused(tmp_path: Path) -> None:
    def counts(t: float, h: float, state: State, *_: Any) -> State:
        return dataclasses.replace(state, bounces=state.bounces + 1.0)

    message = refusal(dataclasses.replace(BALL, step=counts), tmp_path)
    assert "step: bounces depends on its former value: expected at_events(state, new)" in message


def test_an_integration_of_another_derivative_is_refused(tmp_path: Path) -> None:
    def falls(t: float, h: float, state: State, u: Any, p: Any, c: Any) -> State:
        return dataclasses.replace(
            state, height=state.height + h * state.velocity, velocity=state.velocity - 2.0 * h * p.gravity
        )

    message = refusal(dataclasses.replace(BALL, integrate=falls), tmp_path)
    assert "derivative gives velocity = " in message
    assert message.endswith("as the rate of the function integrate")


@pytest.mark.slow
def test_an_integration_of_the_block_is_that_of_co_simulation(small_built: Fmus, tmp_path: Path) -> None:
    def falls(t: float, h: float, state: State, u: Any, p: Any, c: Any) -> State:
        a = u.lift - p.gravity
        return dataclasses.replace(
            state, height=state.height + h * state.velocity + h * h * a, velocity=state.velocity + h * a
        )

    # h^2 a in place of h^2 a / 2: too low by h a t / 2
    path = builder.build_block(dataclasses.replace(BALL, integrate=falls), tmp_path)
    own, usual = (co_simulated(fmu, 0.4, 0.1)["height"] for fmu in (path, small_built["Ball"]))
    assert own - usual == pytest.approx(-0.01 * 8.0 * 0.4 / 2)


@dataclasses.dataclass(frozen=True)
class Empty:
    pass


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"derivative": None}, "expected both a class Continuous and a function derivative, or neither"),
        ({"continuous": NoValues}, "expected both a class Continuous and a function derivative, or neither"),
        ({"state": Reading}, "expected class State(Continuous)"),
        ({"continuous": Empty, "state": Empty}, "expected a state at least, or no class Continuous"),
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
