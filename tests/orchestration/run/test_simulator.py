"""FMUs that stay loaded: run after run as if each were the first."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.fmi.binding import Library
from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Experiment
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import alone, coupled
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build

EXPERIMENT = Experiment(1.0, 0.1)


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the components in the order in which they were loaded."""
    names: list[str] = []
    original = FmuInstance.__init__

    def counted(self: FmuInstance, name: str, *arguments: Any) -> None:
        names.append(name)
        original(self, name, *arguments)

    monkeypatch.setattr(FmuInstance, "__init__", counted)
    return names


def test_a_second_run_is_like_the_first_and_loads_nothing(linear: Build, loaded: list[str]) -> None:
    with Simulator(coupled(linear)) as simulator:
        first = simulator.run(EXPERIMENT)
        other = simulator.run(Experiment(1.0, 0.1, parameters={"one.initial_state": 3.0}))
        again = simulator.run(EXPERIMENT)
    assert loaded == ["one", "two"]
    assert_same_bits(again, first)
    assert other["one.y[1]"][0] == 3.0


def test_runs_of_other_signals_and_records_share_the_fmus(linear: Build, loaded: list[str]) -> None:
    with Simulator(alone(linear)) as simulator:
        simulator.run(Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}))
        run = simulator.run(Experiment(2.0, 0.5, signals={"one.u[1]": lambda t: t}, record=("one.u[1]",)))
    assert run["one.u[1]"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert loaded == ["one"]


def test_an_fmu_that_cannot_be_reset_is_loaded_anew(
    linear: Build, loaded: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Simulator(coupled(linear)) as simulator:
        first = simulator.run(EXPERIMENT)
        monkeypatch.setattr(FmuInstance, "reset", lambda self: False)
        assert_same_bits(simulator.run(EXPERIMENT), first)
    assert loaded == ["one", "two"] * 2


def test_a_run_whose_reset_failed_is_not_wired_as_the_run_before_it(
    linear: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(instance: FmuInstance) -> bool:
        raise OrchestrationError("no reset")

    system, extrapolated = coupled(linear), Experiment(1.0, 0.1, extrapolation=1)
    with Simulator(system) as simulator:
        simulator.run(EXPERIMENT)
        with monkeypatch.context() as failing:
            failing.setattr(FmuInstance, "reset", fail)
            with pytest.raises(OrchestrationError, match="no reset"):
                simulator.run(extrapolated)
        assert_same_bits(simulator.run(extrapolated), simulate(system, extrapolated))


def test_a_reset_that_is_refused_is_told(linear: Build) -> None:
    path = linear()
    with FmuInstance("one", path, describe(path)) as component:
        component.initialise(0.0, None)
        assert component.reset()
        assert component.is_fresh
        component.library = Refusing(component.library)
        component.initialise(0.0, None)
        assert not component.reset()
        assert not component.is_fresh


class Refusing(Library):
    """A library that refuses to reset."""

    def __init__(self, library: Library) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        return (lambda handle: 3) if name == "fmi2Reset" else getattr(self._library, name)


@pytest.mark.parametrize("misdeed", [Misdeed.ERROR, Misdeed.FATAL])
def test_after_a_failure_the_fmus_are_loaded_anew(
    linear: Build, rogue: Build, loaded: list[str], misdeed: Misdeed
) -> None:
    with Simulator(pair(linear, rogue)) as simulator:
        with pytest.raises(SimulationError):
            simulator.run(doing(misdeed))
        assert len(simulator.run(doing(Misdeed.NONE)).time) == 11
    assert loaded == ["rogue", "lag"] * 2


def test_nothing_is_left_when_it_closes(linear: Build, temporary: Path) -> None:
    system = coupled(linear)
    with Simulator(system) as simulator:
        simulator.run(EXPERIMENT)
        assert len(list(temporary.iterdir())) == 2
    assert not list(temporary.iterdir())


def test_a_run_is_asked_for_by_an_experiment_or_by_its_settings(linear: Build) -> None:
    system = coupled(linear)
    assert_same_bits(simulate(system, stop_time=1.0, step_size=0.1), simulate(system, EXPERIMENT))
    usual: Any = {"inputs": {}, "stop_time": None, "algorithm": "jacobi", "record": ()}  # as if not given
    assert_same_bits(simulate(system, EXPERIMENT, **usual), simulate(system, EXPERIMENT))
    with pytest.raises(SystemDefinitionError, match="an experiment or its settings, got both: stop_time"):
        simulate(system, EXPERIMENT, stop_time=1.0)


def test_real_time_is_kept_and_missed_deadlines_are_told(linear: Build) -> None:
    """At a factor of 1e9 every deadline but the first, which sets the clock, is missed."""
    begun = time.monotonic()
    calm = simulate(coupled(linear), EXPERIMENT, real_time=5.0).provenance["real_time"]
    assert time.monotonic() - begun >= 0.2  # 1 s at five times the clock
    assert calm["factor"] == 5.0
    rushed = simulate(coupled(linear), EXPERIMENT, real_time=1e9).provenance["real_time"]
    assert rushed["missed_deadlines"] == 10
    assert rushed["worst_lateness_s"] > 0.0
    assert 0.1 <= rushed["worst_at_s"] <= 1.0


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf")])
def test_a_real_time_factor_must_be_positive(linear: Build, factor: float) -> None:
    with pytest.raises(SystemDefinitionError, match=r"real time factor .* expected more than 0"):
        simulate(coupled(linear), EXPERIMENT, real_time=factor)


def test_a_run_during_a_run_is_refused(linear: Build) -> None:
    """It would reset the FMUs under the other's feet."""
    with Simulator(coupled(linear)) as simulator:

        def again(done: int, total: int) -> None:
            simulator.run(EXPERIMENT)

        with pytest.raises(SimulationError, match="this simulator is running: expected another one"):
            simulator.run(EXPERIMENT, again)
        assert len(simulator.run(EXPERIMENT).time) == 11


def test_simulators_of_one_system_do_not_meet(linear: Build) -> None:
    with Simulator(coupled(linear)) as one, Simulator(coupled(linear)) as other:
        inside: list[Any] = []
        outer = one.run(EXPERIMENT, lambda done, total: inside.append(other.run(EXPERIMENT)))
    assert all(np.array_equal(recording.values, outer.values) for recording in inside)
    assert inside
