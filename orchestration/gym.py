"""Gymnasium environments of any system: an agent in the place of a controller.

    task = task_of("nominal-extended", {"rmse": -1.0}, bounds={"plant.voltage[1]": (-12.0, 12.0), ...})
    env = FmuEnv(task)                       one environment
    envs = FmuVectorEnv(task, num_envs=16)   many in one process

An episode is one run: truncated at the stop time, terminated if an FMU terminates the simulation. Importing
this module registers `l1-depth/Scenario-v0`, whose arguments are those of `task_of`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fmus.extras import imports_of
from orchestration.errors import SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.scenarios.task import Task, task_of
from orchestration.scenarios.task_runs import Episode, checked_system, read_names, task_runs
from orchestration.system.values import value_range

with imports_of("gym", "a Gymnasium environment"):
    import gymnasium
    from gymnasium.spaces import Box, Space
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

__all__ = ["FmuEnv", "FmuVectorEnv", "Task", "task_of"]

_LARGEST = np.finfo(float).max
Array = np.ndarray


class FmuEnv(gymnasium.Env[Array, Array]):
    """One environment of a task. `reset(seed=...)` makes the episodes that follow the same again.

    Raises SystemDefinitionError for a name that is unknown, or an action without bounds; in an episode what
    `Simulator.step` raises.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # as its base declares it

    def __init__(self, task: Task) -> None:
        self._task, self._episode = task, Episode(task)
        self.observation_space, of_inputs = _spaces(task)
        self.action_space = Box(-1.0, 1.0, of_inputs.shape, np.float64)
        self._middle, self._half = _middle_and_half(of_inputs)
        self._values: dict[str, float] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin another episode, with other seeds and parameters where the task draws them."""
        super().reset(seed=seed)
        self._episode.reset(self.np_random)
        self._look()
        return self._observation(), {"time": self._episode.simulator.time}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One action: (observation, reward, whether an FMU terminated, whether time is up, {"time": s})."""
        simulator, reward = self._episode.simulator, 0.0
        now = simulator.time
        self._episode.act((self._middle + self._half * _within(action, self.action_space)).tolist())
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
        self._values = dict(zip(self._episode.names, self._episode.values(), strict=True))

    def _observation(self) -> Array:
        return np.array([self._values[name] for name in self._task.observations])

    def recording(self) -> Recording:
        """The recording of the present episode until now."""
        return self._episode.simulator.recording()

    def close(self) -> None:
        self._episode.simulator.close()


class FmuVectorEnv(VectorEnv[Array, Array, Array]):
    """Many environments of a task in one process; each that is done is reset by the next step.

    ensemble: whether they step together, with the same values: by default where they can and their FMUs are
    compiled for that; True compiles them, and raises EnsembleError where they cannot
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, task: Task, num_envs: int, ensemble: bool | None = None) -> None:
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise SystemDefinitionError(f"num_envs = {num_envs!r}: expected a whole number from 1 on")
        self._task, self.num_envs = task, num_envs
        self.single_observation_space, of_inputs = _spaces(task)
        self.single_action_space = Box(-1.0, 1.0, of_inputs.shape, np.float64)
        self._middle, self._half = _middle_and_half(of_inputs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._runs = task_runs(task, num_envs, ensemble)
        names = self._runs.names
        self._observed = [names.index(name) for name in task.observations]
        self._randoms: list[np.random.Generator] = []
        self._values, self._time = np.empty((len(names), num_envs)), np.zeros(num_envs)
        self._done = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins an episode in every environment; environment i has the seed `seed + i`, or `seed[i]`.

        Raises SystemDefinitionError for another number of seeds, and for the option `reset_mask`.
        """
        if "reset_mask" in (options or {}):
            raise SystemDefinitionError("reset_mask: expected none, the next step resets what is done")
        if seed is not None or not self._randoms:
            seeds = range(seed, seed + self.num_envs) if isinstance(seed, int | np.integer) else seed
            seeds = [None] * self.num_envs if seeds is None else seeds
            if len(seeds) != self.num_envs:
                raise SystemDefinitionError(f"{len(seeds)} seeds: expected {self.num_envs}")
            self._randoms = [np.random.default_rng(s) for s in seeds]
        self._runs.reset(self._randoms, np.ones(self.num_envs, bool))
        self._done = np.zeros(self.num_envs, bool)
        self._look()
        return self._values[self._observed].T, {"time": self._time}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """One action in each environment; those that were done begin an episode, with a reward of 0."""
        values = self._middle + self._half * _within(actions, self.action_space)
        rewards, is_running = np.zeros(self.num_envs), ~self._done
        if self._done.any():
            self._runs.reset(self._randoms, self._done)
        if is_running.any():
            self._runs.act(values, is_running)
        for _ in range(self._task.steps):
            rewards += np.where(is_running, self._step(is_running), 0.0)
            self._done = self._runs.is_done()
            is_running &= ~self._done
        terminated = self._runs.is_terminated()
        observations = self._values[self._observed].T
        return observations, rewards, terminated, self._done & ~terminated, {"time": self._time}

    def _step(self, is_running: Array) -> Array:
        """One communication step of the environments that are running; returns the reward of each."""
        before, start, names = self._values, self._time, self._runs.names
        if is_running.any():
            self._runs.step(is_running)
        self._look()
        old, new = (dict(zip(names, rows, strict=True)) for rows in (before, self._values))
        return self._task.reward(old, new, self._time - start)

    def _look(self) -> None:
        self._values, self._time = self._runs.values(), self._runs.time()

    def recordings(self) -> list[Recording]:
        """The recording of the present episode of each environment until now."""
        return self._runs.recordings()

    def close_extras(self, **kwargs: Any) -> None:
        self._runs.close()


def _spaces(task: Task) -> tuple[Box, Box]:
    """Of observations, and of actions in their own units: an agent's -1..1 are low..high."""
    system = checked_system(task)

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
    if not task.actions or not read_names(task)[0]:
        raise SystemDefinitionError("task: expected an action, and a variable to observe")
    kinds = {name: system.ports[name].variable.type for name in task.actions}
    others = [f"{name} is of type {kind}" for name, kind in kinds.items() if kind != "Real"]
    if others:
        raise SystemDefinitionError(f"action: {', '.join(others)}: expected inputs of type Real")
    return observations, actions


def _middle_and_half(of_inputs: Box) -> tuple[Array, Array]:
    return 0.5 * (of_inputs.low + of_inputs.high), 0.5 * (of_inputs.high - of_inputs.low)


def _within(action: Array, space: Space[Array]) -> Array:
    """Returns the action, or the nearest from -1 to 1; SystemDefinitionError for one of another shape.

    np.clip takes as long as a step.
    """
    if np.shape(action) != space.shape:
        raise SystemDefinitionError(f"action of shape {np.shape(action)}: expected {space.shape}")
    return np.minimum(np.maximum(action, -1.0), 1.0)


def _scenario_env(*arguments: Any, **settings: Any) -> FmuEnv:
    return FmuEnv(task_of(*arguments, **settings))


def _scenario_envs(
    *arguments: Any, num_envs: int = 1, ensemble: bool | None = None, **settings: Any
) -> FmuVectorEnv:
    return FmuVectorEnv(task_of(*arguments, **settings), num_envs, ensemble)


gymnasium.register(
    "l1-depth/Scenario-v0",
    entry_point="orchestration.gym:_scenario_env",
    vector_entry_point="orchestration.gym:_scenario_envs",
)
