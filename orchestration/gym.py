"""Gymnasium environments of any system: an agent in the place of a controller.

    task = task_of("nominal-extended", {"rmse": -1.0}, bounds={"plant.voltage[1]": (-12.0, 12.0), ...})
    env = FmuEnv(task)                       one environment
    envs = FmuVectorEnv(task, num_envs=16)   many in one process

An episode is one run: truncated at the stop time, terminated if an FMU terminates the simulation. Importing
this module registers `l1-depth/Scenario-v0`, whose arguments are those of `task_of`.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from fmus.extras import imports_of
from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.master import Simulator
from orchestration.master.saved_state import SavedState
from orchestration.results.recording import Recording
from orchestration.scenarios.task import Task, task_of
from orchestration.system.experiment import Experiment
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.signals import values_at
from orchestration.system.system import CheckedSystem, check
from orchestration.system.values import Value, value_range

with imports_of("gym", "a Gymnasium environment"):
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

__all__ = ["FmuEnv", "FmuVectorEnv", "Task", "task_of"]

_LARGEST_SEED = 2**31 - 1000  # of the generator in our sensors, and of most others
_LARGEST = np.finfo(float).max
Array = np.ndarray


class _Episodes:
    """The runs of one environment.

    names: of the values that are read: of variables, then of the task's signals
    """

    def __init__(self, task: Task) -> None:
        self._task, self.simulator = task, Simulator(task.system)
        self._variables, signals = _names(task)
        self._signals = [task.signals[name] for name in signals]
        self.names = (*self._variables, *signals)
        self._experiment = _recorded(task, self._variables)
        self._of_signals: Array | None = None  # a row for each communication point
        self._first: SavedState | None = None

    def reset(self, random: np.random.Generator) -> None:
        """Begin another episode."""
        task = self._task
        drawn: dict[str, Value] = {name: int(random.integers(1, _LARGEST_SEED)) for name in task.seeds}
        drawn |= {name: draw(random) for name, draw in task.vary.items()}
        with suppress(OrchestrationError):  # after an FMU returned fatal
            if self._first:
                self.simulator.restore(self._first)
                return
        experiment = replace(self._experiment, parameters={**task.experiment.parameters, **drawn})
        self.simulator.start(experiment, external=task.actions)
        if self._of_signals is None:  # the communication points of every episode are the same
            table = [values_at(signal, self.simulator.points) for signal in self._signals]
            self._of_signals = np.array(table).T
        self._read = self.simulator.reader(*self._variables)
        self._write = self.simulator.writer(*task.actions)
        if self.simulator.can_save and not drawn:
            self._first = self.simulator.save()

    def values(self) -> tuple[float, ...]:
        """The present values of `names`."""
        values = self._read() if len(self._variables) > 1 else (self._read(),)
        if self._of_signals is None or not self._signals:
            return values
        return (*values, *self._of_signals[self.simulator.point].tolist())

    def act(self, action: Sequence[float]) -> None:
        """Set the actions, in their own units, from the present point on."""
        self._write(*action)


class FmuEnv(gymnasium.Env[Array, Array]):
    """One environment of a task. `reset(seed=...)` makes the episodes that follow the same again.

    Raises SystemDefinitionError for a name that is unknown, or an action without bounds; in an episode what
    `Simulator.step` raises.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # as its base declares it

    def __init__(self, task: Task) -> None:
        self._task, self._episodes = task, _Episodes(task)
        self.observation_space, of_inputs = _spaces(task)
        self.action_space = Box(-1.0, 1.0, of_inputs.shape, np.float64)
        self._middle, self._half = _middle_and_half(of_inputs)
        self._values: dict[str, float] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin another episode, with other seeds and parameters where the task draws them."""
        super().reset(seed=seed)
        self._episodes.reset(self.np_random)
        self._look()
        return self._observation(), {"time": self._episodes.simulator.time}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One action: (observation, reward, whether an FMU terminated, whether time is up, {"time": s})."""
        simulator, reward = self._episodes.simulator, 0.0
        now = simulator.time
        self._episodes.act((self._middle + self._half * _within(action)).tolist())
        for _ in range(self._task.steps):
            before, start = self._values, now
            simulator.step()
            self._look()
            now = simulator.time
            reward += float(self._task.reward(before, self._values, now - start))
            if simulator.is_done:
                break
        terminated = simulator.is_terminated
        return self._observation(), reward, terminated, simulator.is_done and not terminated, {"time": now}

    def _look(self) -> None:
        self._values = dict(zip(self._episodes.names, self._episodes.values(), strict=True))

    def _observation(self) -> Array:
        return np.array([self._values[name] for name in self._task.observations])

    def recording(self) -> Recording:
        """The recording of the present episode until now."""
        return self._episodes.simulator.recording()

    def close(self) -> None:
        self._episodes.simulator.close()


class FmuVectorEnv(VectorEnv[Array, Array, Array]):
    """Many environments of a task in one process; each that is done is reset by the next step."""

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, task: Task, num_envs: int) -> None:
        self._task, self.num_envs = task, num_envs
        self._episodes = [_Episodes(task) for _ in range(num_envs)]
        self.single_observation_space, of_inputs = _spaces(task)
        self.single_action_space = Box(-1.0, 1.0, of_inputs.shape, np.float64)
        self._middle, self._half = _middle_and_half(of_inputs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        names = self._episodes[0].names
        self._observed = [names.index(name) for name in task.observations]
        self._randoms: list[np.random.Generator] = []
        self._values, self._time = np.empty((len(names), num_envs)), np.zeros(num_envs)
        self._done = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode in every environment; environment i has the seed `seed + i`, or `seed[i]`."""
        if seed is not None or not self._randoms:
            seeds = range(seed, seed + self.num_envs) if isinstance(seed, int) else seed
            self._randoms = [np.random.default_rng(s) for s in seeds or [None] * self.num_envs]
        for episodes, random in zip(self._episodes, self._randoms, strict=True):
            episodes.reset(random)
        self._done = np.zeros(self.num_envs, bool)
        self._look()
        return self._values[self._observed].T, {"time": self._time}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """One action in each environment; those that were done begin an episode, with a reward of 0."""
        values = self._middle + self._half * _within(actions)
        for episodes, random, action, done in zip(
            self._episodes, self._randoms, values.tolist(), self._done.tolist(), strict=True
        ):
            if done:
                episodes.reset(random)
            else:
                episodes.act(action)
        simulators = [episodes.simulator for episodes in self._episodes]
        rewards, is_running = np.zeros(self.num_envs), ~self._done
        for _ in range(self._task.steps):
            rewards += np.where(is_running, self._step(is_running), 0.0)
            self._done = np.array([simulator.is_done for simulator in simulators])
            is_running &= ~self._done
        terminated = np.array([simulator.is_terminated for simulator in simulators])
        observations = self._values[self._observed].T
        return observations, rewards, terminated, self._done & ~terminated, {"time": self._time}

    def _step(self, is_running: Array) -> Array:
        """One communication step of the environments that are running; returns the reward of each."""
        before, start, names = self._values, self._time, self._episodes[0].names
        for episodes, running in zip(self._episodes, is_running.tolist(), strict=True):
            if running:
                episodes.simulator.step()
        self._look()
        old, new = (dict(zip(names, rows, strict=True)) for rows in (before, self._values))
        return self._task.reward(old, new, self._time - start)

    def _look(self) -> None:
        self._values = np.array([episodes.values() for episodes in self._episodes]).T
        self._time = np.array([episodes.simulator.time for episodes in self._episodes])

    def recordings(self) -> list[Recording]:
        """The recording of the present episode of each environment until now."""
        return [episodes.simulator.recording() for episodes in self._episodes]

    def close_extras(self, **kwargs: Any) -> None:
        for episodes in self._episodes:
            episodes.simulator.close()


def _names(task: Task) -> tuple[list[str], list[str]]:
    """What is read: the names of variables, and of the task's signals."""
    names = dict.fromkeys((*task.observations, *task.reads))
    return [n for n in names if n not in task.signals], [n for n in names if n in task.signals]


def _recorded(task: Task, variables: Sequence[str]) -> Experiment:
    """The experiment, which also records what the agent does and sees: that is read most quickly."""
    record = task.experiment.record
    if not record:  # which is all outputs and actions
        return task.experiment
    ports = _checked(task).ports
    outputs = [n for n in variables if n in ports and ports[n].variable.causality == "output"]
    return replace(task.experiment, record=[*dict.fromkeys((*record, *outputs, *task.actions))])


def _checked(task: Task) -> CheckedSystem:
    driven = dict.fromkeys((*task.experiment.driven_inputs, *task.actions))
    return check(task.system, driven, open_inputs=OpenInputs(task.experiment.open_inputs))


def _spaces(task: Task) -> tuple[Box, Box]:
    """Of observations, and of actions in their own units: an agent's -1..1 are low..high."""
    system = _checked(task)

    def box(names: Sequence[str], purpose: str) -> Box:
        limits = []
        for name in names:
            declared = (-np.inf, np.inf) if name in task.signals else value_range(system.port(name, purpose))
            limits.append(task.bounds.get(name, declared))
        low, high = np.array(limits, float).reshape(-1, 2).clip(-_LARGEST, _LARGEST).T
        return Box(low, high, dtype=np.float64)

    observations, actions = box(task.observations, "observation"), box(task.actions, "action")
    is_bounded = (actions.low > -_LARGEST) & (actions.high < _LARGEST)
    if not is_bounded.all():
        names = ", ".join(name for name, bounded in zip(task.actions, is_bounded, strict=True) if not bounded)
        raise SystemDefinitionError(f"{names}: the FMU has no min and max: expected bounds of each action")
    if not task.actions or not _names(task)[0]:
        raise SystemDefinitionError("task: expected an action, and a variable to observe")
    kinds = {name: system.ports[name].variable.type for name in task.actions}
    others = [f"{name} is of type {kind}" for name, kind in kinds.items() if kind != "Real"]
    if others:
        raise SystemDefinitionError(f"action: {', '.join(others)}: expected inputs of type Real")
    return observations, actions


def _middle_and_half(of_inputs: Box) -> tuple[Array, Array]:
    return 0.5 * (of_inputs.low + of_inputs.high), 0.5 * (of_inputs.high - of_inputs.low)


def _within(action: Array) -> Array:
    """The action, or the nearest from -1 to 1; np.clip takes as long as a step."""
    return np.minimum(np.maximum(action, -1.0), 1.0)


def _scenario_env(*arguments: Any, **settings: Any) -> FmuEnv:
    return FmuEnv(task_of(*arguments, **settings))


def _scenario_envs(*arguments: Any, num_envs: int = 1, **settings: Any) -> FmuVectorEnv:
    return FmuVectorEnv(task_of(*arguments, **settings), num_envs)


gymnasium.register(
    "l1-depth/Scenario-v0",
    entry_point="orchestration.gym:_scenario_env",
    vector_entry_point="orchestration.gym:_scenario_envs",
)
