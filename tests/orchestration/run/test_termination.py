"""A component that terminates the simulation (FMI 2.0.5, 4.2.3; 3.0.2, 4.2.1) ends the run there."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.faults import Drift, Fault, Noise
from orchestration.system.signals import Cosine
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.rogue_systems import doing, pair, run
from tests.shared_builds import Build


@pytest.fixture(params=[2, 3], ids=["FMI 2", "FMI 3"])
def rogue(rogue: Build, request: pytest.FixtureRequest) -> Build:
    """The rogue in each standard: a step that ends the simulation is discarded in FMI 2.0 alone."""
    return partial(rogue, fmi=request.param)


@pytest.fixture(params=[2, 3], ids=["FMI 2", "FMI 3"])
def stair(stair: Build, request: pytest.FixtureRequest) -> Build:
    return partial(stair, fmi=request.param)


ROUNDING = 1e-12  # relative: the last step ends at 0.55 s, or is 0.05 s long


def check_same(recording: Recording, expected: Recording) -> None:
    """Equal, but for the last digits."""
    assert recording.time == pytest.approx(expected.time, rel=ROUNDING)
    assert recording.values == pytest.approx(expected.values, rel=ROUNDING, abs=ROUNDING)


def reversed_order(system: System) -> System:
    return System(dict(reversed(list(system.components.items()))), system.connections)


@pytest.mark.parametrize("h", [0.2, 1.0, 3.0])
def test_a_stair_ends_at_9_s(stair: Build, h: float) -> None:
    """As the Reference FMU of this name, whose suggested stop time is 10 s."""
    recording = run(System({"stair": stair(saves_state=True)}), Experiment(10.0, h))
    assert recording.time == pytest.approx(np.arange(0.0, 9.0 + h / 2, h))
    assert recording["stair.counter"].tolist() == np.floor(recording.time + 1e-9 + 1.0).tolist()
    assert recording.provenance["terminated"] == {
        "component": "stair", "time_s": pytest.approx(9.0), "messages": []
    }  # fmt: skip


@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize("saves_state", [True, False])
@pytest.mark.parametrize("order", [lambda system: system, reversed_order], ids=["first", "last"])
def test_a_run_ends_at_the_communication_point_at_which_a_component_terminates_it(
    linear: Build, rogue: Build, algorithm: Algorithm, saves_state: bool, order: Callable
) -> None:
    system = order(pair(linear, rogue, saves_state))
    experiment = replace(doing(Misdeed.TERMINATE, 0.5), algorithm=algorithm)
    recording = run(system, experiment)
    without = run(system, replace(doing(Misdeed.NONE), stop_time=0.5, algorithm=algorithm))
    check_same(recording, without)
    assert recording.provenance["terminated"] == {
        "component": "rogue", "time_s": pytest.approx(0.5), "messages": ["the dive is over"]
    }  # fmt: skip
    assert "terminated" not in without.provenance


@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize(
    ("misdeed", "h"), [(Misdeed.TERMINATE, 0.1), (Misdeed.TERMINATE_UNTIMED, 0.1), (Misdeed.TERMINATE, 1.0)]
)
def test_a_run_ends_within_a_step_as_with_that_stop_time(
    linear: Build, rogue: Build, algorithm: Algorithm, misdeed: Misdeed, h: float
) -> None:
    """Without LastSuccessfulTime the end is approached to 1e-9 of a step, in shorter and shorter ones."""
    system = pair(linear, rogue)
    experiment = replace(doing(misdeed, 0.55, h=h), algorithm=algorithm)
    recording = run(system, experiment)
    steps = min(h, 0.55)
    stopped = replace(doing(Misdeed.NONE, h=steps), stop_time=0.55, algorithm=algorithm)
    if misdeed is Misdeed.TERMINATE:
        check_same(recording, run(system, stopped))
    else:
        assert recording.time[-1] == pytest.approx(0.55, abs=2e-9)  # the rogue allows 1e-9 s
        check_same(Recording(recording.names, recording.units, recording.time[:6], recording.values[:6]),
                   run(system, replace(stopped, stop_time=0.5)))  # fmt: skip
    assert recording.provenance["terminated"]["time_s"] == recording.time[-1]
    assert recording.provenance["terminated"]["component"] == "rogue"


def test_a_run_that_is_over_at_its_start_is_no_shorter_step(linear: Build, rogue: Build) -> None:
    recording = run(pair(linear, rogue), doing(Misdeed.TERMINATE, 0.0))
    assert recording.time.tolist() == [0.0]
    assert recording.provenance["discarded_steps"] == 1


def test_the_last_point_has_the_signals_and_faults_of_its_time(rogue: Build) -> None:
    experiment = replace(
        doing(Misdeed.TERMINATE, 0.55),
        signals={"rogue.u": Cosine(1.0, 3.0)},
        faults=(Fault("rogue.u", Noise(0.1)), Fault("rogue.u", Drift(2.0), start=0.2)),
        record=("rogue.u", "rogue.y"),
    )
    system = System({"rogue": rogue(saves_state=True)})
    stopped = replace(experiment, stop_time=0.55, parameters=doing(Misdeed.NONE).parameters)
    recording, expected = run(system, experiment), run(system, stopped)
    check_same(recording, expected)
    assert recording["rogue.u"][-1] == expected["rogue.u"][-1]


def test_a_run_ends_before_the_step_if_no_component_can_go_back(linear: Build, rogue: Build) -> None:
    system = pair(linear, rogue, saves_state=False)
    recording = run(system, doing(Misdeed.TERMINATE, 0.55))
    check_same(recording, run(system, replace(doing(Misdeed.NONE), stop_time=0.5)))
    assert recording.provenance["terminated"]["time_s"] == 0.55


def test_a_component_alone_need_not_go_back(rogue: Build) -> None:
    experiment = replace(doing(Misdeed.TERMINATE, 0.55), inputs={"rogue.u": 2.0})
    recording = run(System({"rogue": rogue(saves_state=False)}), experiment)
    assert recording.time == pytest.approx([*np.arange(6) * 0.1, 0.55])
    assert recording["rogue.y"] == pytest.approx(2.0 * recording.time, rel=ROUNDING)


def test_a_run_with_a_tolerance_ends_where_a_component_terminates_it(linear: Build, rogue: Build) -> None:
    system = pair(linear, rogue)
    experiment = replace(doing(Misdeed.TERMINATE, 0.55), tolerance=1e-3)
    recording = run(system, experiment)
    exact = run(system, replace(experiment, stop_time=0.55, parameters=doing(Misdeed.NONE).parameters))
    assert recording.time == pytest.approx(exact.time, rel=ROUNDING)
    assert recording.values == pytest.approx(exact.values, abs=1e-3)


def test_events_at_and_behind_the_end_are_not_made(linear: Build, rogue: Build) -> None:
    """An FMU that terminated accepts no value."""
    system = pair(linear, rogue)
    at = tuple(Event(time, {"lag.a": -2.0}) for time in (0.5, 0.6))
    recording = run(system, replace(doing(Misdeed.TERMINATE, 0.5), events=at))
    check_same(recording, run(system, replace(doing(Misdeed.NONE), stop_time=0.5)))


def test_components_with_step_sizes_of_their_own_hold_their_last_outputs(linear: Build, rogue: Build) -> None:
    experiment = replace(doing(Misdeed.TERMINATE, 0.5), step_sizes={"lag": 0.3})
    recording = run(pair(linear, rogue), experiment)
    assert len(recording.time) == 6
    assert recording["lag.y[1]"][3] == recording["lag.y[1]"][5]


def test_a_run_that_is_led_step_by_step_ends_too(linear: Build, rogue: Build) -> None:
    system, experiment = pair(linear, rogue), doing(Misdeed.TERMINATE, 0.55)
    with Simulator(system) as simulator:
        stepped = simulator.start(experiment)
        for _ in range(6):
            stepped.step()
        assert stepped.time == pytest.approx(0.55)
        with pytest.raises(
            OrchestrationError, match=r"rogue terminated the simulation at 0\.55 s: expected no"
        ):
            stepped.step()
        recording = stepped.recording()
    expected = run(system, experiment)
    assert np.array_equal(recording.values, expected.values)
    assert recording.provenance["terminated"] == expected.provenance["terminated"]


def test_the_next_run_goes_on_to_its_stop_time(linear: Build, rogue: Build) -> None:
    system = pair(linear, rogue)
    with Simulator(system) as simulator:
        simulator.run(doing(Misdeed.TERMINATE, 0.55))
        again = simulator.run(doing(Misdeed.NONE))
    assert np.array_equal(again.values, run(system, doing(Misdeed.NONE)).values)


@pytest.mark.slow
def test_a_process_of_its_own_and_the_progress_end_there(linear: Build, rogue: Build) -> None:
    system, experiment = pair(linear, rogue), doing(Misdeed.TERMINATE, 0.55)
    calls: list[tuple[int, int]] = []
    recording = simulate(system, experiment, lambda *done: calls.append(done), timeout=10.0)
    expected = run(system, experiment)
    assert np.array_equal(recording.values, expected.values)
    assert recording.provenance == expected.provenance
    assert calls[-1] == (6, 6)
