"""The task of an agent in a system: its actions, its observations and its reward."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import ScenarioError
from orchestration.results.increments import Reward, reward_of
from orchestration.scenarios.scenario import Scenario, load_scenario
from orchestration.system.experiment import Event, Experiment
from orchestration.system.signals import Signal
from orchestration.system.system import System
from orchestration.system.values import Value

Draw = Callable[[np.random.Generator], Value]


@dataclass(frozen=True)
class Task:
    """A system, its experiment, and what an agent does and sees there.

    Attributes
    ----------
    system, experiment : System, Experiment
        The FMUs, and an episode with them.
    actions : sequence of str
        Inputs that the agent sets, in the order of its action; nothing else drives them.
    observations : sequence of str
        Names of variables and of `signals`, in the order of its observation.
    reward : callable
        Reward of a communication step, from the values before and after it (name -> value) and its size [s].
    reads : sequence of str
        Variables and `signals` that the reward needs beside the observations.
    bounds : mapping
        Name -> (low, high), in place of the FMU's min and max; an action of -1..1 is scaled to them.
    signals : mapping
        Functions of time that drive no FMU, such as a reference.
    seeds : sequence of str
        Parameters, such as the seed of a noise, for which each episode draws an integer below 2^31 - 1000.
    vary : mapping
        Parameter -> function of a random generator that draws its value for an episode.
    steps : int
        Communication steps for one action; their rewards are summed.
    """

    system: System
    experiment: Experiment
    actions: Sequence[str]
    observations: Sequence[str]
    reward: Reward
    reads: Sequence[str] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    signals: Mapping[str, Signal] = field(default_factory=dict)
    seeds: Sequence[str] = ()
    vary: Mapping[str, Draw] = field(default_factory=dict)
    steps: int = 1


def task_of(
    scenario: str | Scenario,
    reward: Mapping[str, float] | Reward,
    replaced: str = "controller",
    plant: str | Path = "",
    mapping: Mapping[str, str] | None = None,
    **settings: Any,
) -> Task:
    """Returns the task of a component of a scenario, whose place the agent takes.

    Parameters
    ----------
    scenario : str or Scenario
        The scenario, or its name.
    reward : mapping or callable
        Metric of the scenario -> weight (`reward_of`), or a function: see `Task`.
    replaced : str
        The component. The inputs that it drives are the actions; the outputs that drive it, and its signals,
        are the observations.
    plant : str or Path
        FMU or block in the place of the plant, if the scenario is given by name.
    mapping : mapping, optional
        Name of the vehicle's interface -> variable of that plant.
    **settings
        Members of `Task`, in place of the scenario's.

    Returns
    -------
    Task

    Raises
    ------
    ScenarioError
        For an unknown component, a loaded scenario with a `plant`, or a reward that reads the component.

    Examples
    --------
    >>> task = task_of("nominal-extended", reward={"rmse": -1.0})
    >>> task.actions
    ('plant.voltage[1]', 'plant.voltage[2]')
    """
    if isinstance(scenario, str):
        overrides = {"components": {"plant": {"names": dict(mapping)}}} if mapping else {}
        scenario = load_scenario(scenario, overrides, settings={"plant": str(plant)} if plant else {})
    elif plant or mapping:
        raise ScenarioError(f"plant {plant}: expected the name of a scenario, got one that is loaded")
    if replaced not in scenario.system.components:
        known = scenario.system.components
        raise ScenarioError(f"{scenario.name}: no component {replaced!r}; {nearest(replaced, known)}")
    own = f"{replaced}."
    experiment = scenario.experiment
    connections = scenario.system.connections
    signals = {name: signal for name, signal in experiment.signals.items() if name.startswith(own)}
    inputs = [source for source, target, *_ in connections if target.startswith(own)]
    names: list[str] = []
    if not callable(reward):
        duration = experiment.stop_time - experiment.start_time
        reward, names = reward_of(scenario.metrics, reward, duration)
        lost = [name for name in names if name.startswith(own) and name not in signals]
        if lost:
            raise ScenarioError(f"reward: {', '.join(lost)}: the agent takes the place of {replaced}")
    follows: dict[str, Any] = {
        "actions": tuple(target for source, target, *_ in connections if source.startswith(own)),
        "observations": (*dict.fromkeys(inputs), *signals),
        "reads": names,
        "signals": signals,
    }
    components = {name: fmu for name, fmu in scenario.system.components.items() if name != replaced}
    remaining = [pair for pair in connections if not any(str(name).startswith(own) for name in pair[:2])]
    return Task(
        System(components, remaining), _without(experiment, own), reward=reward, **(follows | settings)
    )


def _without(experiment: Experiment, own: str) -> Experiment:
    """Returns the experiment without what belongs to a component; own: the beginning of its names."""

    def kept(values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in values.items() if not name.startswith(own)}

    events = [Event(event.time, kept(event.values)) for event in experiment.events]
    return replace(
        experiment,
        parameters=kept(experiment.parameters),
        inputs=kept(experiment.inputs),
        signals=kept(experiment.signals),
        events=[event for event in events if event.values],
        record=[name for name in experiment.record if not name.startswith(own)],
        step_sizes={name: size for name, size in experiment.step_sizes.items() if f"{name}." != own},
        faults=[fault for fault in experiment.faults if not fault.input.startswith(own)],
    )
