"""Saved states of a run that is led step by step: from each it goes on as if nothing had come between."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, SimulationError
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.run.run import Run
from orchestration.scenarios.declarations import fault
from orchestration.system.experiment import Event, Experiment
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import alone, coupled
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build

FORCE = "one.u[1]"
FORCED = Experiment(1.0, 0.1)
DELAYED = fault({"input": "two.u[1]", "kind": "delay", "delay": 0.2}, "fault")


@pytest.fixture
def simulator(linear: Build) -> Iterator[Simulator]:
    """Of one linear system, x' = -x + u, that saves its state."""
    with Simulator(alone(linear, saves_state=True)) as simulator:
        yield simulator


@pytest.fixture
def run(simulator: Simulator) -> Run:
    """Whose force is external."""
    return simulator.start(FORCED, external=(FORCE,))


def led_by(run: Run, *forces: float) -> None:
    """Steps, each with another force."""
    for force in forces:
        run.set(FORCE, force)
        run.step()


def to_the_end(run: Run) -> None:
    while run.time < 1.0:
        run.step()


def recorded(linear: Build, *forces: float) -> Recording:
    """The recording of a run that goes straight on."""
    with Simulator(alone(linear)) as simulator:
        run = simulator.start(FORCED, external=(FORCE,))
        led_by(run, *forces)
        return run.recording()


@pytest.mark.parametrize(
    "options",
    [
        {"extrapolation": 1},
        {"algorithm": "gauss-seidel", "extrapolation": 1, "faults": (DELAYED,)},
        {"events": (Event(0.33, {"one.a": -5.0}), Event(0.62, {"one.a": -1.0}))},
        {"tolerance": 1e-2},
    ],
    ids=["extrapolation", "fault", "events", "tolerance"],
)
def test_a_run_that_goes_back_at_every_third_step_is_the_run(linear: Build, options: Any) -> None:
    experiment = Experiment(1.0, 0.1, **options)
    with Simulator(coupled(linear, saves_state=True)) as simulator:
        expected = simulator.run(experiment)
        run = simulator.start(experiment)
        while run.time < 0.75:
            state = run.save()
            for _ in range(3):
                run.step()
            run.restore(state)
            run.step()
        to_the_end(run)
        assert_same_bits(run.recording(), expected)


def test_each_of_many_states_leads_back_to_its_own_record(linear: Build, run: Run) -> None:
    """A tree of states, as a planner makes it: 1, 1.2 and 1.3 begin alike; 1.2 goes another way than 1.3."""
    led_by(run, 1.0, 1.0)
    fork = run.save()
    led_by(run, 2.0)
    early = run.save()
    led_by(run, 2.0, 2.0)
    one = run.save()
    run.restore(fork)
    led_by(run, 3.0, 3.0)
    other = run.save()
    led_by(run, 3.0, 3.0, 3.0)
    ways = []
    for state in (one, other, early, one, fork):
        run.restore(state)
        ways.append(run.recording())
    run.restore(one)
    led_by(run, 4.0)
    ways.append(run.recording())
    forces = [(2.0,) * 3, (3.0,) * 2, (2.0,), (2.0,) * 3, (), (2.0, 2.0, 2.0, 4.0)]
    for way, more in zip(ways, forces, strict=True):
        assert_same_bits(way, recorded(linear, 1.0, 1.0, *more))


def test_a_state_holds_what_was_set(run: Run) -> None:
    run.set(FORCE, 2.0)
    run.set("one.a", -3.0)
    state = run.save()
    run.set(FORCE, 5.0)
    run.set("one.a", -4.0)
    run.restore(state)
    assert (run.read(FORCE), run.read("one.a")) == (2.0, -3.0)


def test_a_state_serves_its_run_alone(simulator: Simulator, run: Run) -> None:
    state = run.save()
    other = simulator.start(FORCED, external=(FORCE,))
    with pytest.raises(OrchestrationError, match="the saved state belongs to a run that has ended"):
        other.restore(state)
    other.step()


def test_a_state_needs_fmus_that_save_theirs(linear: Build) -> None:
    with Simulator(coupled(linear)) as simulator:
        run = simulator.start(Experiment(1.0, 0.1))
        with pytest.raises(OrchestrationError, match="one, two cannot save its state: expected canGetAndSet"):
            run.save()


def test_a_run_goes_back_to_before_a_failure(linear: Build, rogue: Build) -> None:
    with Simulator(pair(linear, rogue)) as simulator:
        run = simulator.start(doing(Misdeed.ERROR))
        run.step()
        state = run.save()
        for _ in range(2):
            with pytest.raises(SimulationError, match=r"t = 0\.5 s: fmi2DoStep returned error"):
                to_the_end(run)
            run.restore(state)
            assert len(run.recording().time) == 2
            run.step()


def test_a_run_goes_back_to_before_its_termination(linear: Build, rogue: Build) -> None:
    """Within the step from 0.5 s: the point of 0.6 s, which has become 0.55 s, is where it was."""
    with Simulator(pair(linear, rogue)) as simulator:
        run = simulator.start(doing(Misdeed.TERMINATE, 0.55))
        state, points = run.save(), run.points.copy()
        ends = []
        for _ in range(2):
            while not run.is_done:
                run.step()
            ends.append(run.recording())
            run.restore(state)
            assert not run.is_terminated
            assert np.array_equal(run.points, points)
            assert "terminated" not in run.recording().provenance
    assert ends[0].time[-1] == pytest.approx(0.55)
    assert np.array_equal(ends[0].values, ends[1].values)
    assert ends[0].provenance == ends[1].provenance


def test_no_run_goes_back_after_a_fatal_error(linear: Build, rogue: Build) -> None:
    with Simulator(pair(linear, rogue)) as simulator:
        run = simulator.start(doing(Misdeed.FATAL))
        state = run.save()
        with pytest.raises(SimulationError, match="fmi2DoStep returned fatal"):
            to_the_end(run)
        with pytest.raises(OrchestrationError, match="fmi2DoStep returned fatal"):
            run.restore(state)
        simulator.run(replace(doing(Misdeed.NONE), stop_time=0.2))


def test_a_state_that_is_dropped_makes_room_for_the_next(run: Run) -> None:
    first = run.save()
    snapshot = first.snapshot
    del first
    again, more = run.save(), run.save()
    assert again.snapshot is snapshot
    assert more.snapshot is not snapshot
