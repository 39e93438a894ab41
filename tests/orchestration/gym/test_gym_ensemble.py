"""Environments that step together, as instances of an ensemble, are those that step one by one."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestration.errors import EnsembleError
from orchestration.gym import FmuVectorEnv, Task, task_of
from orchestration.gym import episodes as gym_episodes
from orchestration.many import ensemble
from orchestration.many.ensemble import check_ensemble
from orchestration.places import gpu
from orchestration.results.recording import on_host
from orchestration.scenarios import scenario
from orchestration.system.experiment import Event, Experiment
from orchestration.system.signals import Ramps
from orchestration.system.system import System
from tests.orchestration.places.host_device import HostDevice
from tests.shared_builds import Build

VOLTAGES = ("plant.voltage[1]", "plant.voltage[2]")
CURRENT = "plant.current_velocity"


@pytest.fixture
def task(vehicle_fmus: None) -> Task:
    """The vehicle in 2 s of the nominal scenario, with noise and inertia of each episode."""
    nominal = scenario.load(scenario.find("nominal-extended"))
    task = task_of(
        nominal, {"rmse": -1.0, "control_effort": -0.1}, bounds=dict.fromkeys(VOLTAGES, (-6.0, 6.0))
    )
    short = replace(task.experiment, stop_time=2.0, record=("plant.measured_depth",))
    vary = {"plant.inertia": lambda random: random.uniform(5.0, 7.0)}
    return replace(task, experiment=short, seeds=["plant.sensor_seed"], vary=vary, steps=3)


def episodes(task: Task, count: int, where: str) -> list[Any]:
    """What environments return under actions that are the same each time, over more than two episodes."""
    actions = np.random.default_rng(1).uniform(-1.2, 1.2, (80, count, len(task.actions)))
    if where == "gpu":
        actions = [HostDevice.arrays.asarray(action) for action in actions]
    with closing(FmuVectorEnv(task, count, where)) as envs:
        returned: list[Any] = [*envs.reset(seed=7)[:1]]
        for action in actions:
            observations, rewards, terminated, truncated, info = envs.step(action)
            returned += [observations, rewards, terminated, truncated, info["time"]]
        returned += [recording.values for recording in envs.recordings()]
        returned.append(envs.reset()[0])
    return [on_host(array) for array in returned]


def with_events(task: Task) -> Task:
    """One is between two points of the time grid, and becomes a communication point."""
    events = (Event(0.035, {"plant.linear_damping": 9.0}),)
    return replace(task, experiment=replace(task.experiment, events=events))


def of_variables_alone(task: Task) -> Task:
    """Without signals of the task; one that is observed is driven by a signal of the experiment."""
    signals = {CURRENT: Ramps([(0.0, 0.0), (2.0, 1.0)], smooth=False)}
    inputs = {name: value for name, value in task.experiment.inputs.items() if name != CURRENT}
    return replace(
        task,
        experiment=replace(task.experiment, signals=signals, inputs=inputs),
        observations=("plant.measured_depth", CURRENT),
        reads=(),
        reward=lambda before, after, h: h * after[CURRENT],
    )


def of_connected_inputs(task: Task) -> Task:
    """The vehicle in its loop, of which the agent sees the voltages that arrive."""
    nominal = scenario.load(scenario.find("nominal-extended"))
    inputs = {name: x for name, x in nominal.experiment.inputs.items() if name != "plant.buoyancy_change"}
    return replace(
        task,
        system=nominal.system,
        experiment=replace(nominal.experiment, stop_time=2.0, inputs=inputs, record=VOLTAGES),
        actions=["plant.buoyancy_change"],
        observations=VOLTAGES,
        reads=(),
        signals={},
        bounds={"plant.buoyancy_change": (-0.1, 0.1)},
        reward=lambda before, after, h: h * after[VOLTAGES[0]],
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed",
    [
        lambda task: task,
        lambda task: replace(task, seeds=[], vary={}),
        with_events,
        of_variables_alone,
        of_connected_inputs,
    ],
)
def test_they_have_the_bits_of_environments_with_a_simulator_each(
    task: Task, changed: Callable[[Task], Task], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten: a group and a part of one. So do those on a device, by the program of a GPU."""
    monkeypatch.setattr(gpu, "gpu", HostDevice)
    chosen = changed(task)
    alone, together = (episodes(chosen, 10, where) for where in ("processor", "vectors"))
    for others in (alone, episodes(chosen, 10, "gpu")):
        assert [array.tobytes() for array in together] == [np.asarray(a).tobytes() for a in others]
    assert sum(array.any() for array in together[4::5]) >= 2  # truncated


def test_internal_steps_that_differ_are_refused(task: Task) -> None:
    differing = replace(task, vary={"plant.internal_step": lambda random: 0.01})
    with pytest.raises(EnsembleError, match="internal_step: expected one for all environments"):
        FmuVectorEnv(differing, 8, where="vectors")


def test_fmus_that_are_not_compiled_for_it_have_simulators(
    task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many steps an ensemble would save: that is not known of a loop of the caller's own."""
    monkeypatch.setattr(ensemble, "is_compiled", lambda *_: False)
    monkeypatch.setattr(gym_episodes, "Ensemble", lambda *_: pytest.fail("an ensemble is made"))
    with closing(FmuVectorEnv(task, 8)) as envs:
        assert envs.reset(seed=1)[0].shape == (8, 3)
    with pytest.raises(EnsembleError, match="compiling the FMUs takes longer"):
        check_ensemble(task.system, task.experiment, 10**9, external=task.actions)


def test_foreign_fmus_are_refused(task: Task, linear: Build) -> None:
    foreign = replace(
        task,
        system=System({"plant": linear()}),
        experiment=Experiment(1.0, 0.1),
        actions=["plant.u[1]"],
        observations=["plant.y[1]"],
        bounds={"plant.u[1]": (-1.0, 1.0)},
        reads=(),
        seeds=[],
        vary={},
    )
    with pytest.raises(EnsembleError, match="plant is no native FMU that l1-depth build wrote for this user"):
        FmuVectorEnv(foreign, 8, where="vectors")
