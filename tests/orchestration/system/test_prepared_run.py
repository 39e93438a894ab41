"""Which communication points a run has, what is set there, and which runs are refused."""

from collections.abc import Callable
from pathlib import Path

import pytest

from orchestration.errors import SystemDefinitionError
from orchestration.system.experiment import Event, Experiment
from orchestration.system.prepared_run import prepare
from orchestration.system.system import System

Build = Callable[..., Path]
NEAR = 1e-13  # rounding, of times of about 1 s


@pytest.mark.parametrize("varies_step_size", [True, False])
@pytest.mark.parametrize("offset", [-NEAR, 0.0, NEAR])
def test_an_event_near_a_communication_point_is_at_it(
    linear: Build, varies_step_size: bool, offset: float
) -> None:
    """7 times 0.1 is not 0.7 in floating point: it is the same point, without a step of 1e-16 s."""
    system = System({"one": linear(varies_step_size=varies_step_size)})
    event = Event(0.7 + offset, {"one.a": -2.0})
    prepared = prepare(system, Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, events=[event]))
    assert len(prepared.points) == 11
    assert list(prepared.changes) == [7]


def test_events_near_each_other_share_a_communication_point(linear: Build) -> None:
    events = [Event(0.25 + i * NEAR, {"one.a": -2.0 - i}) for i in range(3)]
    system = System({"one": linear()})
    prepared = prepare(system, Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, events=events))
    assert len(prepared.points) == 12
    assert {index: [value for _, value in changes] for index, changes in prepared.changes.items()} == {
        3: [-2.0, -3.0, -4.0]
    }


def test_events_that_are_not_near_have_points_of_their_own(linear: Build) -> None:
    """A thousandth of a step apart."""
    events = [Event(t, {"one.a": -2.0}) for t in (0.2001, 0.25, 0.2501)]
    system = System({"one": linear()})
    prepared = prepare(system, Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, events=events))
    assert prepared.points[2:7].tolist() == pytest.approx([0.2, 0.2001, 0.25, 0.2501, 0.3], abs=NEAR)
    assert list(prepared.changes) == [3, 4, 5]


def test_an_event_after_the_last_point_of_a_slow_component_is_at_the_end(linear: Build) -> None:
    """Steps of 0.4 s in 1 s: the next of its own points would be at 1.2 s."""
    event = Event(0.9, {"one.a": -2.0})
    inputs, slow = {"one.u[1]": 0.0}, {"one": 0.4}
    prepared = prepare(
        System({"one": linear()}), Experiment(1.0, 0.1, inputs=inputs, events=[event], step_sizes=slow)
    )
    assert list(prepared.changes) == [len(prepared.points) - 1] == [10]


def test_a_step_size_longer_than_the_run_is_refused() -> None:
    with pytest.raises(SystemDefinitionError, match=r"step size 2.0 s: expected at most the run, 1 s"):
        Experiment(1.0, 2.0)
    assert len(Experiment(0.3, 0.1 + 0.2).time_grid()) == 2  # equal but for rounding


def test_a_recording_that_no_machine_holds_is_refused(linear: Build) -> None:
    system = System({f"c{i}": linear() for i in range(1000)})
    inputs = {f"c{i}.u[1]": 0.0 for i in range(1000)}
    with pytest.raises(SystemDefinitionError, match=r"1e\+09 communication points of 1000 .* GB of"):
        prepare(system, Experiment(1.0, 1e-9, inputs=inputs))
