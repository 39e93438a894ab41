"""The master: exchange by hand, exact landing, refused values, and what happens when an FMU fails."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.files import write_archive
from fmus.platforms import SHARED_LIBRARY_SUFFIX, SYSTEM_PLATFORM
from orchestration.errors import FmuLoadError, SimulationError, SystemDefinitionError
from orchestration.run import simulate
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.signals import Cosine
from orchestration.system.system import System
from tests.described_fmus import members
from tests.orchestration.linear_systems import coupled
from tests.orchestration.rogue_systems import run
from tests.orchestration.runs import assert_same_bits, interrupt_at
from tests.shared_builds import Build


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
    recording = simulate(System({"lag": foreign["Lag"]}), Experiment(1.05, 0.1, inputs={"lag.u": 0.0}))
    assert recording.time.tolist() == [*(i * 0.1 for i in range(11)), 1.05]
    assert recording["lag.y"] == pytest.approx(np.exp(-recording.time), rel=1e-12)


def test_signals_and_units_are_recorded_at_the_points(built: Mapping[str, Path]) -> None:
    signals, record = {"p.control": Cosine(2.0, 3.0)}, ("p.control", "p.output")
    experiment = Experiment(0.1, 0.02, inputs={"p.disturbance": 0.0}, signals=signals, record=record)
    recording = simulate(System({"p": built["ExamplePlant"]}), experiment)
    assert recording.names == record
    assert recording.units == ("1", "1")
    assert recording["p.control"] == pytest.approx(2.0 * np.cos(3.0 * recording.time), rel=1e-15)
    assert recording.provenance["fmus"]["p"]["model"] == "ExamplePlant"


def test_a_loop_that_does_not_settle_is_said(foreign: Mapping[str, Path]) -> None:
    """PythonFMU states no initial dependencies, so every output may depend on every input."""
    system = System({"t": foreign["Types"]}, (("t.c", "t.a"),))
    message = r"no solution was found for the loop t.a .* after 1000 iterations"
    with pytest.raises(SimulationError, match=message):
        simulate(system, Experiment(1.0, 0.1, inputs={"t.b": False}))


def test_a_slave_of_pythonfmu_that_returns_false_terminates_the_simulation(
    foreign: Mapping[str, Path],
) -> None:
    """PythonFMU answers so for it."""
    recording = simulate(System({"done": foreign["Discards"]}), Experiment(1.0, 0.1))
    assert recording.time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    expected = {"component": "done", "time_s": 0.5, "messages": ["the battery is empty"]}
    assert recording.provenance["terminated"] == expected


@pytest.mark.parametrize(
    ("name", "status", "words"),
    [("Fails", "error", "the rudder is stuck"), ("Raises", "fatal", "the hull is breached")],
)
def test_a_slave_that_fails_in_mid_run_keeps_what_was_recorded(
    foreign: Mapping[str, Path], temporary: Path, name: str, status: str, words: str
) -> None:
    """Also one whose discarded step PythonFMU calls an end, if it has logged an error."""
    message = rf"bad at t = 0.5 s: fmi2DoStep returned {status}: .*{words}"
    with pytest.raises(SimulationError, match=message) as caught:
        run(System({"bad": foreign[name]}), Experiment(1.0, 0.1))
    recording = caught.value.recording
    assert recording.time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert recording["bad.y"] == pytest.approx(recording.time)
    assert not list(temporary.iterdir())


def test_an_interruption_keeps_what_was_recorded(linear: Build, temporary: Path) -> None:
    system = coupled(linear)
    with pytest.raises(SimulationError, match=r"interrupted") as caught:
        simulate(system, Experiment(1.0, 0.1), interrupt_at(3))
    recording = caught.value.recording
    assert 4 <= len(recording.time) <= 11  # after 1 + 8 steps, or others where the first one took long
    assert_same_bits(recording, simulate(system, Experiment(1.0, 0.1)), len(recording.time))
    assert not list(temporary.iterdir())


PLANT_INPUTS = {"p.control": 0.0, "p.disturbance": 0.0}


def later_nan(t: float) -> float:
    return math.nan if t > 0.45 else 0.0


# Windows does not name the file
LIBRARY_ERROR = "WinError 193" if SYSTEM_PLATFORM == "win64" else f"ExamplePlant{SHARED_LIBRARY_SUFFIX}"
OTHER_PLATFORM = next(name for name in ("win64", "linux64") if name != SYSTEM_PLATFORM)


@pytest.mark.parametrize(
    ("platform", "data", "message"),
    [
        (OTHER_PLATFORM, None, f"has no binary for {SYSTEM_PLATFORM}: it has C sources, {OTHER_PLATFORM}"),
        (SYSTEM_PLATFORM, b"text", f"cannot be instantiated: .*{LIBRARY_ERROR}"),
    ],
)
def test_a_binary_that_cannot_be_loaded_says_why(
    built: Mapping[str, Path], temporary: Path, platform: str, data: bytes | None, message: str
) -> None:
    content = members(built["ExamplePlant"])
    (library,) = [name for name in content if name.endswith(SHARED_LIBRARY_SUFFIX)]
    binary = data or content.pop(library)
    changed = content | {library.replace(SYSTEM_PLATFORM, platform): binary}
    path = write_archive(temporary / "alien.fmu", changed)
    with pytest.raises(FmuLoadError, match=f"alien.fmu .*{message}"):
        simulate(System({"p": path}), Experiment(1.0, 0.1, inputs=PLANT_INPUTS))
    assert list(temporary.iterdir()) == [path]


def test_an_fmu_of_python_without_a_binary_names_the_flavour_that_has_one(
    python_built: Mapping[str, Path], temporary: Path
) -> None:
    """As on macOS, for which PythonFMU has none."""
    content = members(python_built["ExamplePlant"]).items()
    path = write_archive(
        temporary / "alien.fmu", {n: data for n, data in content if SYSTEM_PLATFORM not in n}
    )
    expected = f"it has {OTHER_PLATFORM}; it runs Python: of a block, the native flavour"
    with pytest.raises(FmuLoadError, match=expected):
        simulate(System({"p": path}), Experiment(1.0, 0.1, inputs=PLANT_INPUTS))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": {"p.internal_step": -1.0}}, r"p.internal_step = -1.0: expected 1e-7 to 10 s"),
        ({"parameters": {"p.theta[1]": math.nan}}, r"p.theta\[1\] = nan: expected a finite number"),
        ({"parameters": {"p.omega": "much"}}, "p.omega = 'much': expected a number"),
        ({"parameters": {"p.omga": 1.0}}, "no variable 'p.omga'; nearest is 'p.omega'"),
        ({"parameters": {"p.control": 1.0}}, "p.control: expected a parameter, or a variable"),
        ({"record": ("p.outpt",)}, "no variable 'p.outpt'; nearest is 'p.output'"),
        ({"events": (Event(0.1, {"p.internal_step": 0.1}),)}, "p.internal_step is fixed"),
        ({"events": (Event(0.1, {"p.output": 0.1}),)}, "expected a parameter or an input, got output"),
        ({"inputs": PLANT_INPUTS | {"p.control": math.inf}}, "p.control = inf: expected a finite number"),
        (
            {
                "inputs": {"p.disturbance": 0.0},
                "signals": {"p.control": lambda t: math.nan if t > 0.45 else 0.0},
            },
            "signal p.control is nan at t = 0.5 s: expected a fin",
        ),
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
def test_times_that_do_not_fit_are_refused(step: float) -> None:
    with pytest.raises(SystemDefinitionError, match=r"communication step size .* expected more than 0"):
        Experiment(1.0, step)
    with pytest.raises(SystemDefinitionError, match=r"stop time 1.0 s: .* more than the start time 1.0 s"):
        Experiment(1.0, 0.1, start_time=1.0)
