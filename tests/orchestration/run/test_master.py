"""The master: order of convergence, exact landing, events, and what happens when a slave fails."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from fmus.files import write_archive
from orchestration.errors import FmuLoadError, SimulationError, SystemDefinitionError
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.signals import Constant, Cosine
from orchestration.system.system import System
from tests.described_fmus import members


def two_lags(foreign: Mapping[str, Path]) -> System:
    """x1' = -x1 + x2, x2' = -x2 + x1... by way of two FMUs that each see the other's output."""
    return System({"one": foreign["Lag"], "two": foreign["Lag"]}, (("one.y", "two.u"), ("two.y", "one.u")))


@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_the_error_falls_with_first_order(built: Mapping[str, Path], algorithm: Algorithm) -> None:
    """docs/reference/master.md: held inputs make both algorithms first order in the step."""
    system = System(
        {"a": built["ExamplePlant"], "b": built["ExamplePlant"]},
        (("a.output", "b.control"), ("b.output", "a.control")),
    )
    start = {"a.initial_state[1]": 1.0, "b.initial_state[2]": 0.5}
    free = {f"{name}.theta[{i}]": 0.0 for name in "ab" for i in (1, 2)}
    idle = {"a.disturbance": 0.0, "b.disturbance": 0.0}
    block = np.array([[0.0, 1.0], [-1.0, -1.4]])
    coupling = np.array([[0.0, 0.0], [1.0, 0.0]])
    exact = (expm(2.0 * np.block([[block, coupling], [coupling, block]])) @ [1.0, 0.0, 0.0, 0.5])[0]

    def error(h: float) -> float:
        experiment = Experiment(2.0, h, algorithm=algorithm, parameters=start | free, inputs=idle)
        return abs(simulate(system, experiment)["a.output"][-1] - exact)

    order = math.log2(error(0.02) / error(0.01))
    assert order == pytest.approx(1.0, abs=0.05)  # the second-order term is about h = 1 %


def test_gauss_seidel_uses_the_newest_output(foreign: Mapping[str, Path]) -> None:
    """One step of h from x = (1, 1) with u_1 = 0 at the start: by hand."""
    system = System({"one": foreign["Lag"], "two": foreign["Lag"]}, (("one.y", "two.u"),))
    common: dict[str, Any] = {"stop_time": 0.5, "step_size": 0.5, "inputs": {"one.u": 0.0}}
    decay = math.exp(-0.5)
    jacobi = simulate(system, Experiment(**common))
    assert jacobi["two.y"][-1] == pytest.approx(1.0)
    seidel = simulate(system, Experiment(**common, algorithm=Algorithm.GAUSS_SEIDEL))
    assert seidel["two.y"][-1] == pytest.approx(decay + (1.0 - decay) * decay)


def test_communication_points_are_not_accumulated_and_the_last_lands(foreign: Mapping[str, Path]) -> None:
    run = simulate(System({"lag": foreign["Lag"]}), Experiment(1.05, 0.1, inputs={"lag.u": 0.0}))
    assert run.time.tolist() == [*(i * 0.1 for i in range(11)), 1.05]
    assert run["lag.y"] == pytest.approx(np.exp(-run.time), rel=1e-12)


def test_signals_and_units_are_recorded_at_the_points(built: Mapping[str, Path]) -> None:
    experiment = Experiment(
        0.1, 0.02, inputs={"p.disturbance": 0.0}, signals={"p.control": Cosine(2.0, 3.0)},
        record=("p.control", "p.output"),
    )  # fmt: skip
    run = simulate(System({"p": built["ExamplePlant"]}), experiment)
    assert run.names == ("p.control", "p.output")
    assert run.units == ("1", "1")
    assert run["p.control"] == pytest.approx(2.0 * np.cos(3.0 * run.time), rel=1e-15)
    assert run.provenance["fmus"]["p"]["model"] == "ExamplePlant"


def test_every_type_travels(foreign: Mapping[str, Path]) -> None:
    system = System(
        {"one": foreign["Types"], "two": foreign["Types"]}, (("one.c", "two.a"), ("one.d", "two.b"))
    )
    run = simulate(system, Experiment(0.2, 0.1, inputs={"one.a": 4, "one.b": True}))
    assert run["two.c"].tolist() == [6.0] * 3
    assert run["two.d"].tolist() == [1.0] * 3


def test_an_event_changes_a_parameter_and_an_input_at_its_time(built: Mapping[str, Path]) -> None:
    inputs = {"p.control": 0.0, "p.disturbance": 0.0}
    event = Event(0.05, {"p.disturbance": 5.0, "p.omega": 2.0})
    run = simulate(
        System({"p": built["ExamplePlant"]}), Experiment(0.1, 0.01, inputs=inputs, events=(event,))
    )
    moved = run.time[run["p.state[2]"] != 0.0]
    assert moved[0] == pytest.approx(0.06)


def test_a_loop_in_initialisation_settles_by_repeated_exchange(foreign: Mapping[str, Path]) -> None:
    """PythonFMU states no initial dependencies, so every output may depend on every input."""
    run = simulate(two_lags(foreign), Experiment(1.0, 0.01))
    assert run["one.y"] == pytest.approx(np.ones(101))  # the common mode stands still


def test_a_loop_that_does_not_settle_is_said(foreign: Mapping[str, Path]) -> None:
    system = System({"t": foreign["Types"]}, (("t.c", "t.a"),))
    with pytest.raises(
        SimulationError, match=r"no solution was found for the loop t.a .* after 1000 iterations"
    ):
        simulate(system, Experiment(1.0, 0.1, inputs={"t.b": False}))


def test_a_slave_of_pythonfmu_that_returns_false_terminates_the_simulation(
    foreign: Mapping[str, Path],
) -> None:
    """PythonFMU answers so for it."""
    recording = simulate(System({"done": foreign["Discards"]}), Experiment(1.0, 0.1))
    assert recording.time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert recording.provenance["terminated"] == {
        "component": "done", "time_s": 0.5, "messages": ["the battery is empty"]
    }  # fmt: skip


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    ("name", "status", "words"),
    [("Fails", "error", "the rudder is stuck"), ("Raises", "fatal", "the hull is breached")],
)
def test_a_slave_that_fails_in_mid_run_keeps_what_was_recorded(
    foreign: Mapping[str, Path], temporary: Path, name: str, status: str, words: str, compiled: bool
) -> None:
    """Also one whose discarded step PythonFMU calls an end, if it has logged an error."""
    with (
        pytest.raises(
            SimulationError, match=rf"bad at t = 0.5 s: fmi2DoStep returned {status}: .*{words}"
        ) as caught,
        Simulator(System({"bad": foreign[name]}), compiled) as simulator,
    ):
        simulator.run(Experiment(1.0, 0.1))
    recording = caught.value.recording
    assert recording.time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert recording["bad.y"] == pytest.approx(recording.time)
    assert not list(temporary.iterdir())


def test_an_interruption_keeps_what_was_recorded(foreign: Mapping[str, Path], temporary: Path) -> None:
    reached = 0

    def interrupt(done: int, total: int) -> None:
        nonlocal reached
        reached = done
        if done >= 3:
            raise KeyboardInterrupt

    with pytest.raises(SimulationError, match=r"interrupted") as caught:
        simulate(System({"lag": foreign["Lag"]}), Experiment(1.0, 0.1, inputs={"lag.u": 0.0}), interrupt)
    assert 3 <= reached <= 10  # after 1 + 8 steps, or others where the first one took long
    assert caught.value.recording.time == pytest.approx(0.1 * np.arange(reached + 1))
    assert not list(temporary.iterdir())


def test_a_missing_binary_is_said_with_those_there_are(built: Mapping[str, Path], temporary: Path) -> None:
    content = members(built["ExamplePlant"]).items()
    alien = {name.replace("linux64", "win64").replace(".so", ".dll"): data for name, data in content}
    path = write_archive(temporary / "alien.fmu", alien)
    with pytest.raises(FmuLoadError, match=r"has no binary for linux64: it has C sources, win64"):
        simulate(System({"p": path}), Experiment(1.0, 0.1, inputs=PLANT_INPUTS))
    assert list(temporary.iterdir()) == [path]


def test_an_fmu_of_python_without_a_binary_names_the_flavour_that_has_one(
    python_built: Mapping[str, Path], temporary: Path
) -> None:
    """As on macOS, for which PythonFMU has none."""
    content = members(python_built["ExamplePlant"]).items()
    path = write_archive(temporary / "alien.fmu", {n: data for n, data in content if "linux64" not in n})
    with pytest.raises(FmuLoadError, match=r"it has win64; it runs Python: of a block, the native flavour"):
        simulate(System({"p": path}), Experiment(1.0, 0.1, inputs=PLANT_INPUTS))


def test_a_binary_that_cannot_be_loaded_says_why(built: Mapping[str, Path], temporary: Path) -> None:
    content = members(built["ExamplePlant"])
    (library,) = [name for name in content if name.endswith(".so")]
    path = write_archive(temporary / "empty.fmu", content | {library: b"text"})
    with pytest.raises(FmuLoadError, match=r"p: .*empty.fmu cannot be instantiated: .*ExamplePlant.so"):
        simulate(System({"p": path}), Experiment(1.0, 0.1, inputs=PLANT_INPUTS))
    assert list(temporary.iterdir()) == [path]


PLANT_INPUTS = {"p.control": 0.0, "p.disturbance": 0.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": {"p.internal_step": -1.0}}, r"p.internal_step = -1.0: expected 1e-07..10 s"),
        ({"parameters": {"p.theta[1]": math.nan}}, r"p.theta\[1\] = nan: expected a finite number"),
        ({"parameters": {"p.omega": "much"}}, "p.omega = 'much': expected a number"),
        ({"parameters": {"p.omga": 1.0}}, "no variable 'p.omga'; nearest is 'p.omega'"),
        (
            {"parameters": {"p.control": 1.0}},
            "p.control: expected a parameter, or a variable",
        ),
        ({"record": ("p.outpt",)}, "no variable 'p.outpt'; nearest is 'p.output'"),
        ({"events": (Event(0.1, {"p.internal_step": 0.1}),)}, "p.internal_step is fixed"),
        ({"events": (Event(0.1, {"p.output": 0.1}),)}, "expected a parameter or an input, got output"),
        ({"inputs": PLANT_INPUTS | {"p.control": math.inf}}, "p.control = inf: expected a finite number"),
    ],
)
def test_bad_values_are_refused_before_the_run(
    built: Mapping[str, Path], temporary: Path, change: dict[str, Any], message: str
) -> None:
    experiment = replace(Experiment(1.0, 0.1, inputs=PLANT_INPUTS), **change)
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(System({"p": built["ExamplePlant"]}), experiment)
    assert not list(temporary.iterdir())


@pytest.mark.parametrize("step", [0.0, -0.1, math.nan, math.inf])
def test_a_step_must_be_positive(step: float) -> None:
    with pytest.raises(SystemDefinitionError, match=r"communication step size .* expected more than 0"):
        Experiment(1.0, step)


def test_the_stop_must_come_after_the_start() -> None:
    with pytest.raises(
        SystemDefinitionError, match=r"stop time 1.0 s: expected more than the start time 1.0 s"
    ):
        Experiment(1.0, 0.1, start_time=1.0)


def test_a_signal_that_leaves_the_numbers_is_refused_before_the_run(built: Mapping[str, Path]) -> None:
    signals = {"p.control": lambda t: math.nan if t > 0.45 else 0.0, "p.disturbance": Constant(0.0)}
    with pytest.raises(SystemDefinitionError, match=r"signal p.control is nan at t = 0.5 s: expected a fin"):
        simulate(System({"p": built["ExamplePlant"]}), Experiment(1.0, 0.1, signals=signals))
