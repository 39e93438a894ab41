"""FMUs for model exchange alone are components as others are: CVode integrates them, with their events."""

import itertools
import math
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.sundials import CVodeSolver
from scipy.linalg import expm

from fmus.errors import FmuWarning
from fmus.fmi.binding import DISCARD, ERROR, OK, WARNING
from fmus.fmi.description import describe
from fmus.fmi.model_exchange import ModelExchangeInstance, _Solver
from fmus.generate import builder
from orchestration.cli.package_fmus import build_ramp_source
from orchestration.errors import FmuLoadError, SimulationError
from orchestration.exchange import ssp_read, ssp_write
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.scenarios.scenario import load, load_scenario
from orchestration.system.experiment import Event, Experiment
from orchestration.system.system import System
from tests.described_fmus import XML, members
from tests.fmus.compliance.archives import write
from tests.fmus.native.exchanged import BALL
from tests.mutants.slaves import EXCHANGE_CHANGES, write_slave
from tests.orchestration.python_loop import LoopInPython
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Fmus

TIMES: dict[str, Any] = {"start_time": 0.5, "stop_time": 4.5, "step_size": 0.04}  # the default experiment
COMPLETED = "completed 1"  # with noSetFMUStatePriorToCurrentPoint, as fmi2DoStep is called
RECORDED = ("m.x", "m.v", "m.stairs", "m.turns", "m.above")
EXPERIMENT = Experiment(4.5, 0.04, 0.5, record=RECORDED, open_inputs="start")


def model_exchange_alone(path: Path, folder: Path, name: str = "") -> Path:
    """The FMU without its interface for co-simulation."""
    content = members(path)
    xml = re.sub(rb"<CoSimulation\b([^>]*/>|.*?</CoSimulation>)", b"", content[XML], flags=re.DOTALL)
    assert xml != content[XML]
    return write(content | {XML: xml}, folder / (name or path.name))


def exchange(folder: Path, mutation: str = "", flags: str = "") -> System:
    """A foreign FMU with time, state and step events, which refuses calls in wrong states."""
    changes = EXCHANGE_CHANGES.get(mutation or flags, ())
    return System({"m": write_slave(folder, mutation, flags, changes, "Exchange")})


def exchanged(folder: Path, mutation: str = "", flags: str = "", **settings: Any) -> Recording:
    """The recording of a run of it."""
    return simulate(exchange(folder, mutation, flags), open_inputs="start", **(TIMES | settings))


@pytest.fixture(scope="module")
def vehicles(built: Fmus, fmi3_built: Fmus, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The plant for model exchange alone, by version of FMI."""
    folder = tmp_path_factory.mktemp("vehicles")
    return {
        fmi: model_exchange_alone(fmus["RovDepthPlant"], folder, f"{fmi}.fmu")
        for fmi, fmus in ((2, built), (3, fmi3_built))
    }


def largest_difference(first: Recording, second: Recording) -> float:
    return float(np.abs(first.values - second.values).max())


def test_a_plant_converges_to_co_simulation_with_the_tolerance_of_the_solver(
    built: Fmus, vehicles: dict[int, Path]
) -> None:
    """The error of a step is some tolerances, and each sample of the sensor starts CVode anew. The scheme of
    co-simulation has errors below 1e-8 here: from an internal step of 1 ms to 0.1 ms they change by less.
    """
    driven = {"plant.voltage[1]": 2.0}
    settings: dict[str, Any] = {"stop_time": 1.0, "step_size": 0.01, "inputs": driven, "open_inputs": "start"}
    reference = simulate(System({"plant": built["RovDepthPlant"]}), **settings)
    system = System({"plant": vehicles[2]})
    errors = [
        largest_difference(simulate(system, fmu_tolerance=tolerance, **settings), reference)
        for tolerance in (1e-6, 1e-8, 1e-10)
    ]
    assert errors[0] > 5 * errors[1] > 25 * errors[2]
    assert errors[2] < 1e-6
    assert largest_difference(simulate(system, **settings), reference) < 1e-5  # by default 1e-9


@pytest.mark.usefixtures("vehicle_fmus")
def test_a_scenario_runs_with_it_in_closed_loop(vehicles: dict[int, Path]) -> None:
    """Internal steps of 1 ms of co-simulation have errors of 1e-6 m in this loop. Larger ones change which
    step of 2 mm the sensor rounds to, after which the depths differ by 1e-3 m.
    """
    short = {
        "experiment": {"stop_time": 20.0},
        "metrics": dict.fromkeys(("holding_thrust", "settling_time", "overshoot"), False),
        "parameters": {"plant.internal_step": 1e-3},
    }
    own = load_scenario("nominal-l1", short)
    other = load_scenario("nominal-l1", short | {"components": {"plant": str(vehicles[2])}})
    expected, recording = (simulate(s.system, s.experiment) for s in (own, other))
    assert np.ptp(expected["plant.depth"]) > 0.05
    assert np.array_equal(recording["plant.measured_depth"], expected["plant.measured_depth"])
    assert np.abs(recording["plant.depth"] - expected["plant.depth"]).max() < 5e-6


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_ball_bounces_where_the_closed_form_has_it(tmp_path: Path, fmi: int) -> None:
    """From 1 m with 8 m/s2 and a restitution of a half it bounces at 0.5, 1 and 1.25 s. The height is read
    at multiples of 0.25 s, which are time events; the tolerance is 1000 of the solver's 1e-9.
    """
    ball = System({"ball": model_exchange_alone(builder.build_block(BALL, tmp_path, fmi=fmi), tmp_path)})
    recording = simulate(ball, stop_time=1.3, step_size=0.1, open_inputs="start")
    for time, height in zip(recording["time"], recording["ball.height"], strict=True):
        begin, speed = max((t, v) for t, v in ((0.5, 2.0), (1.0, 1.0), (1.25, 0.5)) if t <= max(time, 0.5))
        since = time - begin
        expected = 1.0 - 4.0 * time**2 if time < 0.5 else speed * since - 4.0 * since**2
        assert height == pytest.approx(expected, abs=1e-6), time
    bounces = {0.4: 0, 0.6: 1, 0.9: 1, 1.1: 2, 1.3: 3}
    rows = [int(np.argmin(np.abs(recording["time"] - time))) for time in bounces]
    assert recording["ball.bounces"][rows].tolist() == [*bounces.values()]
    assert recording["ball.reading"][3] == pytest.approx(0.75, abs=1e-6)  # of 0.25 s


def test_both_standards_have_the_same_bits(vehicles: dict[int, Path]) -> None:
    """With an array of inputs, an input that changes, a sampled sensor, and a last step that is shorter."""
    changes, inputs = (Event(0.5, {"plant.external_force": -2.0}),), {"plant.voltage[2]": 1.5}
    experiment = Experiment(1.01, 0.02, inputs=inputs, events=changes, open_inputs="start")
    old, new = (simulate(System({"plant": path}), experiment) for path in vehicles.values())
    assert_same_bits(new, old)
    assert np.ptp(old["plant.depth"]) > 1e-3


def test_a_time_event_may_be_a_rounding_error_after_a_communication_point(tmp_path: Path) -> None:
    """The 49th point is 3e-17 s before the time event at 0.25 s, an interval that CVode refuses."""
    step_size = 0.25 / 49
    assert 0 < 0.25 - 49 * step_size < 1e-16
    times: dict[str, Any] = {"start_time": 0.0, "stop_time": 60 * step_size, "step_size": step_size}
    recording = exchanged(tmp_path, record=("m.stairs",), **times)
    assert recording["m.stairs"].tolist() == [0.0] * 50 + [1.0] * 11


def test_an_event_follows_what_is_set_at_a_communication_point(tmp_path: Path) -> None:
    """A relation of the parameter k, which an event alone evaluates, adds 1 to the acceleration."""
    changed, unchanged = (
        exchanged(tmp_path, flags="a relation of a parameter", stop_time=0.7, record=("m.v",), events=events)
        for events in ([Event(0.58, {"m.k": 4.02})], [])
    )
    gained = changed["m.v"] - unchanged["m.v"]
    assert gained[:3].tolist() == [0.0, 0.0, 0.0]
    assert gained[3] == pytest.approx(0.04, rel=0.05)  # in the first of three steps; k adds less


@pytest.mark.parametrize("flags", ["", "completed steps are not needed"])
def test_time_state_and_step_events_are_those_of_fmpy(tmp_path: Path, flags: str) -> None:
    """Both take CVode at 1e-9. FMPy completes steps at communication points alone, so that turns, a step
    event, comes up to one of them later.
    """
    system = exchange(tmp_path, flags=flags)
    recording = simulate(system, record=RECORDED, open_inputs="start", **TIMES)
    expected: Any = fmpy.simulate_fmu(
        str(system.components["m"]),
        start_time=0.5,
        stop_time=4.5,
        output_interval=0.04,
        relative_tolerance=1e-9,
        output=[name.removeprefix("m.") for name in RECORDED],
        record_events=False,
        set_stop_time=False,  # FMPy integrates beyond it
    )
    assert np.abs(recording["time"] - expected["time"]).max() < 1e-9
    for name, limit in (("x", 1e-6), ("v", 1e-6), ("stairs", 0), ("turns", 0), ("above", 0)):
        assert np.abs(recording[f"m.{name}"] - expected[name]).max() <= limit, name
    assert recording["m.stairs"][-1] == 16
    assert recording["m.turns"][-1] == (0 if flags else 3)


def test_the_loop_in_python_gives_the_same_and_a_second_run_too(tmp_path: Path) -> None:
    system = exchange(tmp_path)
    with Simulator(system) as compiled, LoopInPython(system) as slow:
        first = compiled.run(EXPERIMENT)
        assert_same_bits(compiled.run(EXPERIMENT), first)
        assert_same_bits(slow.run(EXPERIMENT), first)


def test_inputs_and_parameters_act_from_the_point_at_which_they_change(tmp_path: Path) -> None:
    """With no spring the acceleration is the input: the velocity is its sum until the first time event."""
    settings = {"stop_time": 0.66, "parameters": {"m.k": 0.1}, "events": (Event(0.58, {"m.u": 1.0}),)}
    slopes = np.diff(exchanged(tmp_path, record=("m.v",), **settings)["m.v"]) / 0.04
    assert slopes == pytest.approx([0.2 - 0.05, 0.2 - 0.05, 1.0 - 0.05, 1.0 - 0.05], abs=0.01)


def test_a_run_goes_on_from_saved_states(tmp_path: Path) -> None:
    """The solver starts anew where a state is saved, so that a saved state of the FMU is the whole state."""
    path = tmp_path / "saved"
    with Simulator(exchange(tmp_path)) as simulator:
        whole = simulator.run(EXPERIMENT, checkpoints=Checkpoints(path, 2.0))
        assert_same_bits(simulator.run(EXPERIMENT, resume=read_checkpoint(path)), whole)


@pytest.fixture
def plant(built: Fmus, tmp_path: Path) -> System:
    """A linear plant with the state x, for model exchange alone."""
    return System({"p": model_exchange_alone(built["ExamplePlant"], tmp_path)})


GROWING: dict[str, Any] = {"parameters": {"p.initial_state[1]": 1.0}, "inputs": {"p.control": 1.0}}
LINEAR = Experiment(10.0, 0.02, open_inputs="start", fmu_tolerance=1e-9, **GROWING)


def restarts(monkeypatch: pytest.MonkeyPatch, run: Callable[[], object]) -> list[float]:
    """Returns the times [s] at which the solver starts anew in a run."""
    times, reset = list[float](), CVodeSolver.reset
    with monkeypatch.context() as patch:
        patch.setattr(CVodeSolver, "reset", lambda solver, time: (times.append(time), reset(solver, time)))
        run()
    return times


def test_the_solver_goes_on_where_no_input_has_changed(
    plant: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of x' = M x + b u by the matrix exponential; with a start in each step the error is far larger."""
    # the state matrix of the block with its theta, and the constant input as a third state
    augmented = np.array([[0.0, 1.0, 0.0], [-1.0 + 4.0, -1.4 - 4.5, 1.0], [0.0, 0.0, 0.0]])

    def error() -> float:
        recording = simulate(plant, LINEAR)
        exact = np.array([(expm(augmented * time) @ [1.0, 0.0, 1.0])[:2] for time in recording["time"]])
        states = np.column_stack([recording[f"p.state[{i}]"] for i in (1, 2)])
        return float(np.abs(states - exact).max() / np.abs(exact).max())

    going_on = error()
    monkeypatch.setattr(_Solver, "begin", CVodeSolver.reset)
    assert 15.0 * going_on < error()


def test_the_solver_starts_anew_where_something_has_changed(
    plant: System, vehicles: dict[int, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An input and a parameter that get other values, not the same ones; samples; a saved state."""
    events = [
        Event(2.0, {"p.control": 1.0}),
        Event(3.0, {"p.control": 1.5}),
        Event(4.0, {"p.theta[1]": 4.0}),
        Event(5.0, {"p.theta[1]": 3.0}),
    ]
    changed = replace(LINEAR, events=events)
    assert restarts(monkeypatch, lambda: simulate(plant, LINEAR)) == [0.0]
    assert restarts(monkeypatch, lambda: simulate(plant, changed)) == [0.0, 3.0, 5.0]
    sampled = System({"v": vehicles[2]}), Experiment(0.2, 0.01, open_inputs="start")
    samples = restarts(monkeypatch, lambda: simulate(*sampled))
    assert samples == pytest.approx([0.0, 0.04, 0.08, 0.12, 0.16])

    def saved_at_1_s() -> None:
        with Simulator(plant) as simulator:
            run = simulator.start(LINEAR)
            run.advance(1.0)
            run.save()
            run.advance(2.0)

    assert restarts(monkeypatch, saved_at_1_s) == [0.0, pytest.approx(1.0)]


def test_restored_states_and_steps_one_by_one_have_the_same_bits(plant: System) -> None:
    with Simulator(plant) as simulator:
        whole = simulator.run(LINEAR)
        run = simulator.start(LINEAR)
        while not run.is_done:
            run.step()
        assert_same_bits(run.recording(), whole)
        run = simulator.start(LINEAR)
        run.advance(3.0)
        state = run.save()
        run.advance()
        first = run.recording()
        run.restore(state)
        run.advance()
        assert_same_bits(run.recording(), first)


def test_a_run_goes_back_in_time_at_rest(plant: System) -> None:
    """Its states, derivatives and indicators are the same at all times."""
    with Simulator(plant) as simulator:
        run = simulator.start(replace(LINEAR, parameters={}, inputs={}))
        state = run.save()
        run.advance(1.0)
        run.restore(state)
        run.advance(1.0)
        assert not run.recording()["p.state[1]"].any()


def test_a_discarded_step_is_repeated_with_the_same_bits_however_fast_the_processor_is(
    plant: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first runs of a simulator have shorter batches of steps than later ones."""
    step, discarded = ModelExchangeInstance._do_step, list[float]()

    def discarding(instance: ModelExchangeInstance, handle: int, start: float, size: float, flag: int) -> int:
        if start < 9.0 or size < 0.015:
            return step(instance, handle, start, size, flag)
        discarded.append(start)
        instance._checked("fmi2EnterContinuousTimeMode")
        instance._solver.begin(start)
        while instance._solver.advance(start + size)[0] < start + size:
            pass
        return DISCARD

    monkeypatch.setattr(ModelExchangeInstance, "_do_step", discarding)
    with Simulator(plant) as simulator:
        first, *others = (simulator.run(LINEAR) for _ in range(3))
    assert len(discarded) >= 3 * 50
    for other in others:
        assert_same_bits(other, first)


def test_the_simulation_ends_where_the_fmu_terminates_it(tmp_path: Path) -> None:
    """The third time event, at 0.5 + 3 * 0.25 s, is within a step."""
    recording = exchanged(tmp_path, "ends without a message")
    messages = ["the FMU terminates the simulation at 1.25 s"]
    assert recording.provenance["terminated"] == {"component": "m", "time_s": 1.25, "messages": messages}
    assert recording["time"][-1] == 1.25


@pytest.mark.parametrize(
    ("mutation", "message"),
    [
        ("NewDiscreteStates fails in state 4", "fmi2NewDiscreteStates; fmi2NewDiscreteStates returned error"),
        ("GetDerivatives fails in state 8", "t = 0.5 s: .*; fmi2GetDerivatives returned error"),
        ("GetEventIndicators fails in state 8", "t = 0.5 s: .*; fmi2GetEventIndicators returned error"),
        ("CompletedIntegratorStep fails in state 8", "; fmi2CompletedIntegratorStep returned error"),
        ("EnterEventMode fails in state 8", "; fmi2EnterEventMode returned error"),
        ("events never end", "t = 0.98 s: .* needs more than 100 fmi2NewDiscreteStates"),
        ("the next event is in the past", "more than 10000 events in one step, at 1 s"),
    ],
)
def test_a_call_that_fails_ends_the_run_with_its_name(
    tmp_path: Path, mutation: str, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SimulationError, match=message) as error:
        exchanged(tmp_path, mutation)
    assert "DoStep" not in str(error.value), "the FMU has no such function"
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_a_run_with_a_time_limit_and_an_ssp_package_take_it(tmp_path: Path) -> None:
    system = exchange(tmp_path)
    (tmp_path / "mine.toml").write_text(
        '[components]\nm = "Exchange.fmu"\n[inputs]\n"m.u" = 0.2\n[experiment]\nopen_inputs = "start"\n'
        "start_time = 0.5\nstop_time = 4.5\nstep_size = 0.04\n"
    )
    written = load(tmp_path / "mine.toml")
    expected = simulate(system, written.experiment)
    assert np.array_equal(simulate(system, written.experiment, timeout=60.0).values, expected.values)
    package = ssp_write.package(written, tmp_path / "mine.ssp", build_ramp_source)
    assert b'implementation="ModelExchange"' in members(package)["SystemStructure.ssd"]
    with ssp_read.opened(package) as read:
        recording = simulate(read.system, read.experiment)
    assert np.array_equal(recording["m.x"], expected["m.x"])


@pytest.fixture
def instance(tmp_path: Path) -> Iterator[ModelExchangeInstance]:
    path = exchange(tmp_path).components["m"]
    instance = ModelExchangeInstance("m", path, describe(path))
    with instance:
        yield instance


def returning(instance: ModelExchangeInstance, name: str, status: int, calls: range) -> None:
    """Lets calls of a function of the FMU, counted from 0, return a status."""
    function, count = getattr(instance.library, name), itertools.count()
    vars(instance.library)[name] = lambda *arguments: max(
        function(*arguments), status if next(count) in calls else OK
    )


def initialised(instance: ModelExchangeInstance) -> None:
    instance.initialise(0.5, 4.5)
    instance.exit_initialization_mode()


@pytest.mark.parametrize(
    ("status", "calls", "expected"),
    [(DISCARD, range(3, 5), OK), (DISCARD, range(10**6), DISCARD), (WARNING, range(3, 4), WARNING)],
)
def test_a_discard_shortens_steps_of_the_solver_and_a_warning_is_returned(
    instance: ModelExchangeInstance, status: int, calls: range, expected: int
) -> None:
    returning(instance, "fmi2GetDerivatives", status, calls)
    initialised(instance)
    assert instance.status("fmi2DoStep", 0.5, 0.04, 1) == expected
    assert instance.last_successful_time() == (0.5 if expected == DISCARD else 0.54)
    assert not instance.terminates()
    assert instance.status("fmi2DoStep", 0.54, 0.04, 1) == (ERROR if expected == DISCARD else OK)


def completing(instance: ModelExchangeInstance, enters: int, terminates: int) -> list[str]:
    """Lets the first completed step ask for an event or the end; returns the calls, which follow."""
    calls, status = list[str](), instance.status

    def called(function: str, *arguments: Any) -> int:
        is_completed = function == "fmi2CompletedIntegratorStep"
        calls.append(f"completed {arguments[0]}" if is_completed else function.removeprefix("fmi2"))
        result = status(function, *arguments)
        if is_completed and calls.count(COMPLETED) == 1:
            arguments[1]._obj.value, arguments[2]._obj.value = enters, terminates
        return result

    vars(instance)["status"] = called
    return calls


def test_each_step_of_the_solver_is_completed_and_may_be_followed_by_an_event(
    instance: ModelExchangeInstance,
) -> None:
    calls = completing(instance, enters=1, terminates=0)
    initialised(instance)
    assert instance.status("fmi2DoStep", 0.5, 0.04, 1) == OK
    completed = [i for i, call in enumerate(calls) if call == COMPLETED]
    assert len(completed) > 10
    assert {tuple(calls[i - 2 : i]) for i in completed} == {("SetTime", "SetContinuousStates")}
    calls = [call for call in calls if not call.startswith("Get")]
    completed = [i for i, call in enumerate(calls) if call == COMPLETED]
    events = [i for i, call in enumerate(calls) if call == "EnterEventMode"]
    assert events == [completed[0] + 1, completed[-1] + 1]


def test_nothing_is_called_after_an_error(instance: ModelExchangeInstance) -> None:
    """FMI 2.0.5, 2.1.3: the simulation cannot be continued."""
    calls = completing(instance, enters=0, terminates=0)
    returning(instance, "fmi2GetDerivatives", ERROR, range(3, 10**6))
    initialised(instance)
    assert instance.status("fmi2DoStep", 0.5, 0.04, 1) == ERROR
    assert (calls.count("GetDerivatives"), calls[-1]) == (4, "GetDerivatives")
    instance.close()
    assert calls[-1] == "FreeInstance"
    assert "Terminate" not in calls


def test_a_completed_step_may_end_the_simulation(instance: ModelExchangeInstance) -> None:
    calls = completing(instance, enters=0, terminates=1)
    initialised(instance)
    assert instance.status("fmi2DoStep", 0.5, 0.04, 1) == DISCARD
    assert (calls[-1], calls.count(COMPLETED)) == (COMPLETED, 1)
    assert instance.terminates()
    reached = instance.last_successful_time()
    assert reached is not None
    assert 0.5 < reached < 0.54
    assert instance.reset()
    initialised(instance)
    assert instance.status("fmi2DoStep", 0.5, 0.04, 1) == OK
    assert not instance.terminates()


def test_a_failure_of_the_solver_has_its_message(instance: ModelExchangeInstance) -> None:
    def no_number(handle: Any, values: Any, count: int) -> int:
        values[0] = math.nan
        return OK

    returning(instance, "fmi2GetDerivatives", DISCARD, range(3, 5))
    initialised(instance)
    assert instance.status("fmi2DoStep", 0.5, 0.04, 1) == OK
    vars(instance.library)["fmi2GetDerivatives"] = no_number
    assert instance.status("fmi2DoStep", 0.54, 0.04, 1) == ERROR
    (message,) = [text for status, text in instance.log if status == ERROR]
    assert re.match(r"CVode returned -\d+: At t = 0\.54", message)


def test_a_warning_of_the_first_event_is_a_warning(instance: ModelExchangeInstance) -> None:
    returning(instance, "fmi2NewDiscreteStates", WARNING, range(1))
    with pytest.warns(FmuWarning, match="t = 0.5 s: fmi2NewDiscreteStates"):
        initialised(instance)


def test_a_machine_for_which_fmpy_has_no_cvode_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmus.fmi.model_exchange", None)
    message = r"Exchange\.fmu is for model exchange alone, for which CVode lacks"
    with pytest.raises(FmuLoadError, match=message):
        exchanged(tmp_path)


def test_an_fmu_without_an_interface_is_refused(built: Fmus, tmp_path: Path) -> None:
    content = members(built["ExamplePlant"])
    xml = re.sub(rb"(CoSimulation|ModelExchange)\b", rb"Other", content[XML])
    path = write(content | {XML: xml}, tmp_path / "none.fmu")
    with pytest.raises(FmuLoadError, match="neither CoSimulation nor ModelExchange"):
        simulate(System({"m": path}), stop_time=1.0, step_size=0.1)
