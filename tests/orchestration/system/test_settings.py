"""An experiment from plain settings: names are checked, and times come from the FMUs where they agree."""

import math
import re
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

from orchestration import Cosine, Event, Experiment, Simulator, System, Table, simulate
from orchestration.errors import SystemDefinitionError
from orchestration.system.experiment import Algorithm, ExperimentSettings, Initialisation, suggested_times
from tests.described_fmus import redescribed
from tests.shared_builds import Build


def suggesting(fmu: Path, path: Path, experiment: str) -> Path:
    """A copy of an FMU whose description has this for its default experiment."""

    def suggest(description: str) -> str:
        text, count = re.subn("<DefaultExperiment[^>]*/>", experiment, description)
        assert count == 1
        return text

    return redescribed(fmu, path, suggest)


def test_times_that_are_not_given_are_those_that_the_fmus_suggest(linear: Build, tmp_path: Path) -> None:
    silent = suggesting(linear(), tmp_path / "silent.fmu", "")
    late = '<DefaultExperiment startTime="2" stopTime="5" stepSize="0.25"/>'
    system = System({"one": suggesting(linear(), tmp_path / "late.fmu", late), "two": silent})
    assert suggested_times(system) == (5.0, 0.25, 2.0)
    assert suggested_times(system, stop_time=1.0) == (1.0, 0.25, 0.0)
    inputs = {"one.u[1]": 0.0, "two.u[1]": 0.0}
    run = simulate(system, inputs=inputs)
    np.testing.assert_array_equal(run.time, 2.0 + 0.25 * np.arange(13))


def test_times_that_the_fmus_do_not_agree_on_must_be_given(linear: Build, tmp_path: Path) -> None:
    other = suggesting(linear(), tmp_path / "other.fmu", '<DefaultExperiment stepSize="0.02"/>')
    with pytest.raises(
        SystemDefinitionError, match=r"step_size: .* suggest several: one 0\.01 s, two 0\.02 s"
    ):
        suggested_times(System({"one": linear(), "two": other}), stop_time=1.0)
    with pytest.raises(SystemDefinitionError, match="stop_time: it is not given, and no FMU suggests one"):
        suggested_times(System({"two": other}))


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"stepsize": 0.1}, "no setting 'stepsize'; nearest is 'step_size'"),
        ({"time_out": 1.0}, "no setting 'time_out'; nearest is 'timeout'"),
        ({"progres": 1, "experimnt": None}, "no setting 'progres'; nearest is 'progress'"),
        ({"experimnt": None, "progres": 1}, "no setting 'experimnt'; nearest is 'experiment'"),
        ({"algorithm": "gaus-seidel"}, "unknown algorithm 'gaus-seidel'; nearest is 'gauss-seidel'"),
        ({"initialisation": "newtn"}, "unknown initialisation 'newtn'; nearest is 'newton'"),
        ({"record": "one.y[1]"}, r"record = 'one.y\[1\]': expected a list of names"),
        ({"events": Event(0.5, {})}, r"events = Event\(.*\): expected a list of Event"),
        ({"faults": ["freeze"]}, r"faults = \['freeze'\]: expected a list of Fault"),
        ({"stop_time": "1"}, "stop_time = '1': expected a number of seconds"),
        ({"step_size": True}, "step_size = True: expected a number of seconds"),
        ({"signals": {"one.u[1]": 1.0}}, r"signal one.u\[1\] = 1.0: expected a function of time; a constant"),
    ],
)
def test_natural_mistakes_are_told(linear: Build, settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(SystemDefinitionError, match=complaint):
        simulate(System({"one": linear()}), **settings)


def test_the_settings_of_simulate_are_those_of_an_experiment() -> None:
    """But for times, which may be None: the FMUs suggest them."""
    of_simulate, of_experiment = map(get_type_hints, (ExperimentSettings, Experiment))
    times = dict.fromkeys(("stop_time", "step_size", "start_time"), float | None)
    assert of_simulate == of_experiment | times


def test_plain_types_mean_what_they_say(linear: Build) -> None:
    """A name of an algorithm, lists, and numbers of NumPy, also of single precision."""
    plain: Any = {"algorithm": "gauss-seidel", "initialisation": "newton", "record": ["one.y[1]"]}
    experiment = Experiment(np.float64(1.0), np.float32(0.5), events=[Event(0.5, {})], **plain)  # type: ignore[arg-type]
    assert experiment.algorithm is Algorithm.GAUSS_SEIDEL
    assert experiment.initialisation is Initialisation.NEWTON
    assert (experiment.record, len(experiment.events)) == (("one.y[1]",), 1)
    system = System({"one": str(linear())}, [])
    values = [
        simulate(system, stop_time=1.0, inputs={"one.u[1]": kind(2)}, parameters={"one.a": -kind(1)})
        for kind in (float, np.float32, np.int64)
    ]
    assert values[0]["one.y[1]"][-1] != 1.0  # the start value
    for other in values[1:]:
        np.testing.assert_array_equal(other.values, values[0].values)


def test_gauss_seidel_by_its_name_is_gauss_seidel(linear: Build) -> None:
    system = System({"one": linear(), "two": linear()}, [["one.y[1]", "two.u[1]"], ["two.y[1]", "one.u[1]"]])
    runs = {
        name: simulate(system, stop_time=1.0, algorithm=name, parameters={"one.initial_state": 0.0}).values
        for name in ("jacobi", "gauss-seidel", Algorithm.GAUSS_SEIDEL)
    }
    np.testing.assert_array_equal(runs["gauss-seidel"], runs[Algorithm.GAUSS_SEIDEL])
    assert not np.array_equal(runs["gauss-seidel"], runs["jacobi"])


def test_samples_and_functions_drive_inputs(linear: Build) -> None:
    """x' = -x + 1, x(0) = 1 stays at 1; a straight line of samples is the same as its function."""
    system = System({"one": linear()})
    constant = simulate(system, stop_time=1.0, signals={"one.u[1]": lambda t: 1.0})
    np.testing.assert_allclose(constant["one.y[1]"], 1.0, rtol=0.0, atol=1e-15)
    line = Table(np.linspace(0.0, 1.0, 11), np.linspace(0.0, 3.0, 11))
    runs = [
        simulate(system, stop_time=1.0, signals={"one.u[1]": signal}) for signal in (line, lambda t: 3.0 * t)
    ]
    np.testing.assert_allclose(
        runs[0].values, runs[1].values, rtol=0.0, atol=1e-14
    )  # rounding of the samples


def test_a_settled_simulator_takes_the_same_experiment(linear: Build) -> None:
    system, signals = System({"one": linear()}), {"one.u[1]": Cosine(1.0, math.pi)}
    with Simulator(system) as simulator:
        run = simulator.run(Experiment(*suggested_times(system), signals=signals))
    np.testing.assert_array_equal(run.values, simulate(system, signals=signals).values)
