"""Variables of every type and causality: as signals, on connections and in the recording."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, ScenarioError, SimulationError, SystemDefinitionError
from orchestration.results import metrics
from orchestration.results.figures import run_figure
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.run.bus import Strings
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.system.experiment import Event, Experiment
from orchestration.system.faults import Delay, Fault, Stuck
from orchestration.system.signals import Ramps, Signal, Table
from orchestration.system.system import System
from tests import foreign_pythonfmu
from tests.orchestration.rogue_systems import run
from tests.shared_builds import Build


def passing(linear: Build) -> System:
    """An FMU whose outputs integer_out and boolean_out are its inputs of the step before."""
    return System({"p": linear(b=(), d=((),), passes_discrete=True)})


def driven(**signals: Signal) -> Experiment:
    signals_by_name = {f"p.{name}": signal for name, signal in signals.items()}
    return Experiment(0.5, 0.1, signals=signals_by_name, open_inputs="start")


def test_integers_and_booleans_follow_signals(linear: Build) -> None:
    steps = Table([0.0, 0.2, 0.4], [3, -7, 2**31 - 1], hold=True)
    signals: dict[str, Signal] = {"integer_in": steps, "boolean_in": lambda t: t > 0.25}
    recording = run(passing(linear), driven(**signals))
    assert recording["p.integer_in"].tolist() == [3, 3, -7, -7, 2**31 - 1, 2**31 - 1]
    assert recording["p.boolean_in"].tolist() == [0, 0, 0, 1, 1, 1]
    for name in ("integer", "boolean"):
        assert recording[f"p.{name}_out"][0] == recording[f"p.{name}_in"][0]
        assert recording[f"p.{name}_out"][1:].tolist() == recording[f"p.{name}_in"][:-1].tolist()


def test_a_table_of_an_integer_or_a_boolean_holds(linear: Build) -> None:
    signals = {"integer_in": Table([0.0, 0.2], [3, -8]), "boolean_in": Table([0.0, 0.25, 0.25], [0, 0, 1])}
    recording = run(passing(linear), driven(**signals))
    assert recording["p.integer_in"].tolist() == [3, 3, -8, -8, -8, -8]
    assert recording["p.boolean_in"].tolist() == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize(
    ("name", "signal", "message"),
    [
        (
            "integer_in",
            Ramps([[0.0, 0.0], [1.0, 10.0]], smooth=True),
            r".* at t = 0.1 s: expected an integer, -2147483648 to 2147483647, as .* has type Integer",
        ),
        ("integer_in", lambda t: 2.0**31, ".* at t = 0 s: expected an integer"),
        ("integer_in", lambda t: float("nan"), "nan at t = 0 s: expected an integer"),
        ("boolean_in", lambda t: 2.0, "2 at t = 0 s: expected true or false"),
    ],
)
def test_a_signal_that_its_input_cannot_have_is_refused(
    linear: Build, name: str, signal: Signal, message: str
) -> None:
    with pytest.raises(SystemDefinitionError, match=f"signal p.{name} is {message}"):
        simulate(passing(linear), driven(**{name: signal}))


def test_signals_of_integers_hold_between_communication_points(linear: Build, rogue: Build) -> None:
    """A tolerance makes more steps, at whose beginnings this signal is no integer."""
    system = System({"p": linear(b=(), d=((),), passes_discrete=True, saves_state=True)})
    experiment = replace(driven(integer_in=lambda t: round(10.0 * t, 9)), tolerance=1e-6)
    assert run(system, experiment)["p.integer_in"].tolist() == [0, 1, 2, 3, 4, 5]


def test_an_integer_output_drives_a_real_input(linear: Build, stair: Build) -> None:
    system = System({"stair": stair(), "lag": linear(a=0.0)}, (("stair.counter", "lag.u[1]"),))
    recording = run(system, Experiment(3.0, 0.5, extrapolation=1, record=("lag.u[1]", "lag.y[1]")))
    assert recording["lag.u[1]"].tolist() == [1, 1, 2, 2, 3, 3, 4]
    assert recording["lag.y[1]"] == pytest.approx(1.0 + np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.0]))


PORTS = {
    "Real": ("Lag", "y", "u"),
    "Integer": ("Types", "c", "a"),
    "Boolean": ("Types", "d", "b"),
    "String": ("Diary", "page", "entry"),
}
ACCEPTED = {("Integer", "Real"), *zip(PORTS, PORTS, strict=True)}


@pytest.mark.parametrize("output", PORTS)
@pytest.mark.parametrize("target", PORTS)
def test_an_output_drives_an_input_that_can_have_its_every_value(
    foreign: Mapping[str, Path], output: str, target: str
) -> None:
    source, given, _ = PORTS[output]
    receiver, _, taken = PORTS[target]
    fmus = {"one": foreign[source], "two": foreign[receiver]}
    system = System(fmus, ((f"one.{given}", f"two.{taken}"),))
    experiment = Experiment(0.2, 0.1, open_inputs="start")
    if (output, target) in ACCEPTED:
        simulate(system, experiment)
    else:
        message = f"expected an output of type {target}.* for an input of type {target}, got {output}"
        with pytest.raises(SystemDefinitionError, match=message):
            simulate(system, experiment)


def diaries(foreign: Mapping[str, Path]) -> System:
    """The first one writes to the second."""
    return System(dict.fromkeys(("one", "two"), foreign["Diary"]), (("one.page", "two.entry"),))


RECORD = ("two.page", "one.page", "two.entry", "one.entry", "one.length", "one.gain", "one.twice")
CHANGE = Event(0.2, {"one.entry": "Tuesday ä", "one.gain": 3.0})
MONDAY = Experiment(0.4, 0.1, inputs={"one.entry": "Mon,day"}, events=(CHANGE,), record=RECORD)


def test_strings_are_connected_and_recorded(foreign: Mapping[str, Path]) -> None:
    """Beside them local variables and parameters: an event's value from its time on, and what an FMU
    computes of it after the next step.
    """
    recording = run(diaries(foreign), MONDAY)
    assert recording["one.entry"].tolist() == ["Mon,day", "Mon,day", "Tuesday ä", "Tuesday ä", "Tuesday ä"]
    assert recording["one.page"].tolist() == ["begun", "Mon,day|", "Mon,day|", "Tuesday ä|", "Tuesday ä|"]
    assert recording["two.entry"].tolist() == recording["one.page"].tolist()
    assert recording["two.page"].tolist() == ["begun", "begun|", "Mon,day||", "Mon,day||", "Tuesday ä||"]
    assert recording["one.gain"].tolist() == [2, 2, 3, 3, 3]
    assert recording["one.twice"].tolist() == [4, 4, 4, 6, 6]
    assert recording["one.length"].tolist() == [0, 16, 16, 30, 30]


def test_a_string_that_is_recorded_can_be_read_at_every_point(foreign: Mapping[str, Path]) -> None:
    with Simulator(diaries(foreign)) as simulator:
        run = simulator.start(MONDAY)
        run.step()
        assert (run.read("one.page"), run.read("one.length")) == ("Mon,day|", 16)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_strings_survive_files_and_tables(foreign: Mapping[str, Path], tmp_path: Path, ending: str) -> None:
    recording = run(diaries(foreign), replace(MONDAY, inputs={"one.entry": "Mon\rday"}))
    recording.write(tmp_path / f"diary.{ending}")
    read = Recording.read(tmp_path / f"diary.{ending}")
    assert (read.names, read.units) == (recording.names, recording.units)
    for name in RECORD:
        assert read[name].tolist() == recording[name].tolist()
        assert recording.to_pandas()[name].tolist() == recording[name].tolist()
        assert recording.to_xarray()[name].values.tolist() == recording[name].tolist()
    assert "two.page  " in repr(recording)


def test_strings_go_on_from_a_checkpoint(tmp_path: Path) -> None:
    """The numbers of the texts of the first run stay what they were, though the second begins with others."""
    system = diaries({"Diary": foreign_pythonfmu.build("Diary", tmp_path, **foreign_pythonfmu.SAVES_STATE)})
    uninterrupted = simulate(system, MONDAY, checkpoints=Checkpoints(tmp_path / "checkpoint", every=0.3))
    resumed = simulate(system, MONDAY, resume=read_checkpoint(tmp_path / "checkpoint"))
    for name in RECORD:
        assert resumed[name].tolist() == uninterrupted[name].tolist()


@pytest.mark.slow
def test_strings_are_in_no_figure_and_no_metric(foreign: Mapping[str, Path], tmp_path: Path) -> None:
    recording = run(diaries(foreign), MONDAY)
    (file,) = run_figure("diary", recording, tmp_path / "diary")
    assert file.is_file()
    with pytest.raises(ScenarioError, match=r"one.page is a String: expected a sig"):
        metrics.evaluate(recording, {"m": {"function": "mean", "signal": "one.page"}})


def test_strings_are_not_recorded_unless_named(foreign: Mapping[str, Path]) -> None:
    assert run(diaries(foreign), replace(MONDAY, record=())).names == ()


def test_a_stopped_run_that_records_nothing_has_its_times_in_a_process_too(
    foreign: Mapping[str, Path],
) -> None:
    def stop(done: int, total: int) -> None:
        raise OrchestrationError("stopped")

    with pytest.raises(SimulationError, match="stopped") as caught:
        simulate(diaries(foreign), replace(MONDAY, record=()), stop, timeout=60.0)
    assert caught.value.recording.time[-1] == MONDAY.stop_time


def test_a_delayed_string_arrives_late_and_none_is_stuck(foreign: Mapping[str, Path]) -> None:
    delayed = replace(MONDAY, faults=(Fault("two.entry", Delay(0.1)),))
    recording = run(diaries(foreign), delayed)
    assert recording["two.entry"][1:].tolist() == recording["one.page"][:-1].tolist()
    with pytest.raises(SystemDefinitionError, match="Stuck: expected an input that is a number"):
        run(diaries(foreign), replace(MONDAY, faults=(Fault("two.entry", Stuck(1.0)),)))


def test_no_signal_drives_a_string(foreign: Mapping[str, Path]) -> None:
    experiment = replace(MONDAY, inputs={}, signals={"one.entry": lambda t: t}, events=())
    with pytest.raises(SystemDefinitionError, match=r"one.entry: expected an input that is a number"):
        run(diaries(foreign), experiment)


def test_an_output_with_an_exact_start_value_can_be_set(stair: Build, linear: Build) -> None:
    recording = simulate(System({"stair": stair()}), Experiment(20.0, 1.0, parameters={"stair.counter": 5}))
    assert recording["stair.counter"].tolist() == [5, 6, 7, 8, 9, 10]
    message = r'y\[1\]: expected a parameter, or .* initial = "exact" .*, got output with initial = calc'
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(passing(linear), replace(driven(), parameters={"p.y[1]": 1.0}))


def test_strings_keep_their_numbers_in_another_run() -> None:
    strings, restored = Strings(), Strings()
    numbers = [strings.number(text) for text in ("a", "", "b", "a")]
    assert numbers == [1, 0, 2, 1]
    restored.number("before")
    restored.table = strings.table
    assert [restored.number(text) for text in ("c", "b", "a", "")] == [3, 2, 1, 0]
