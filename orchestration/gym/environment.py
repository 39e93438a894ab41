"""Environments of one run and of many: spaces, actions, observations, rewards."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fmus.extras import imports_of
from orchestration.errors import SystemDefinitionError
from orchestration.gym.episodes import Episode, EpisodePlan, task_runs
from orchestration.many.places import AUTO, device_of
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.scenarios.task import Task
from orchestration.system.values import value_range

with imports_of("gym", "a Gymnasium environment"):
    import gymnasium
    from gymnasium.spaces import Box, Space
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

_LARGEST = np.finfo(float).max
Array = np.ndarray


class _Agent:
    """The part that an environment and a vector of them share: everything but the shapes."""

    _runs: Any  # an Episode, or what `task_runs` gives
    _done: Any = None  # before the first episode
    _terminated: Any
    _arrays: Any = np  # module of the arrays of values, actions and rewards

    def _plan(self, task: Task) -> tuple[EpisodePlan, Box, Box]:
        """Returns the plan of all episodes, and the spaces of one environment."""
        plan = EpisodePlan(task)
        observations, inputs = _spaces(plan)
        self._task, self._names = task, plan.names
        self._middle = self._arrays.asarray(0.5 * (inputs.low + inputs.high))
        self._half = self._arrays.asarray(0.5 * (inputs.high - inputs.low))
        return plan, observations, Box(-1.0, 1.0, inputs.shape, np.float64)

    def _own_units(self, action: Array, space: Space[Array]) -> Array:
        """Returns actions from -1 to 1 in units of the inputs; those beyond count as the nearest.

        Raises SystemDefinitionError for another shape.
        """
        self._check_begun()
        if np.shape(action) != space.shape:
            raise SystemDefinitionError(f"action of shape {np.shape(action)}: expected {space.shape}")
        # np.clip takes as long as a step
        return self._middle + self._half * np.minimum(np.maximum(action, -1.0), 1.0)

    def _check_begun(self) -> None:
        if self._done is None:
            raise gymnasium.error.ResetNeeded("no episode has begun: expected reset() first")

    def _look(self) -> None:
        values, self._time, self._done, self._terminated = self._runs.look()
        self._values = dict(zip(self._names, values, strict=True))

    def _step(self, *which: Array) -> Any:
        """Makes a communication step; returns its reward."""
        before, start = self._values, self._time
        self._runs.step(*which)
        self._look()
        return self._task.reward(before, self._values, self._time - start)

    def _observation(self) -> Array:
        return self._arrays.array([self._values[name] for name in self._task.observations]).T

    def _info(self) -> dict[str, Any]:
        return {"time": self._time}


class FmuEnv(_Agent, gymnasium.Env[Array, Array]):
    """One environment of a task; `reset(seed=...)` makes the following episodes repeat.

    Parameters
    ----------
    task : Task
        The system and the agent's place in it, as from `task_of`.

    Raises
    ------
    SystemDefinitionError
        For an unknown name, or an action without bounds; in an episode the errors of `Run.step`.

    Examples
    --------
    >>> from orchestration import load_scenario
    >>> from orchestration.gym import task_of
    >>> bounds = {"plant.voltage[1]": (-6.0, 6.0), "plant.voltage[2]": (-6.0, 6.0)}  # V
    >>> env = FmuEnv(task_of(load_scenario("nominal-extended"), {"rmse": -1.0}, bounds=bounds))
    >>> observation, info = env.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> info
    {'time': 0.02}
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # as its base declares it

    def __init__(self, task: Task) -> None:
        plan, self.observation_space, self.action_space = self._plan(task)
        self._runs = Episode(plan, Simulator(task.system))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins another episode, with other seeds and parameters where the task draws them.

        Parameters
        ----------
        seed : int, optional
            Seed of this episode and all that follow; by default the random numbers go on.
        options : mapping, optional
            Ignored.

        Returns
        -------
        tuple
            Observation, {"time": s}.
        """
        super().reset(seed=seed)
        self._runs.reset(self.np_random)
        self._look()
        return self._observation(), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Takes an action, and steps.

        Parameters
        ----------
        action : array, shape (actions,)
            From -1 to 1, scaled to the bounds of the inputs.

        Returns
        -------
        tuple
            Observation, reward, whether an FMU terminated, whether the stop time is reached, {"time": s}.
        """
        values = self._own_units(action, self.action_space)
        self._runs.act(*values.tolist())
        reward = 0.0
        for _ in range(self._task.steps):
            reward += float(self._step())
            if self._done:
                break
        truncated = self._done and not self._terminated
        return self._observation(), reward, self._terminated, truncated, self._info()

    def recording(self) -> Recording:
        """Returns the recording of the present episode until now.

        Returns
        -------
        Recording
        """
        self._check_begun()
        return self._runs.run.recording()

    def close(self) -> None:
        """Frees the FMUs, and ends the episode."""
        self._runs.engine.close()
        self._done = None


class FmuVectorEnv(_Agent, VectorEnv[Array, Array, Array]):
    """Many environments of a task in one process; each that is done is reset by the next step.

    Parameters
    ----------
    task : Task
        As for `FmuEnv`.
    num_envs : int
        Number of environments.
    where : str
        "auto": in vectors, with the same values, if the FMUs allow it and are compiled for it.
        "vectors": compiles them.
        "processor": one by one.
        "gpu": on the GPU of this machine. Observations and rewards are arrays of CuPy; actions are such
        arrays or others with DLPack on that GPU, such as arrays of PyTorch and JAX.

    Raises
    ------
    EnsembleError
        With "vectors" or "gpu", if the FMUs cannot run so.
    SystemDefinitionError
        For a number of environments below 1, and as for `FmuEnv`.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, task: Task, num_envs: int, where: str = AUTO) -> None:
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise SystemDefinitionError(f"num_envs = {num_envs!r}: expected a whole number from 1 on")
        self.num_envs = num_envs
        device = device_of(where)
        self._arrays = device.arrays if device else np
        plan, self.single_observation_space, self.single_action_space = self._plan(task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._runs = task_runs(plan, num_envs, where, device)
        self._randoms: list[np.random.Generator] = []

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begins an episode in every environment.

        Parameters
        ----------
        seed : int or sequence of int, optional
            Environment i has the seed `seed + i`, or `seed[i]`.
        options : mapping, optional
            Must not have `reset_mask`: the next step resets the environments that are done.

        Returns
        -------
        tuple
            Observations, shape (num_envs, observations), and {"time": array of s}.

        Raises
        ------
        SystemDefinitionError
            For another number of seeds, and for the option `reset_mask`.
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
        self._look()
        return self._observation(), self._info()

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Takes one action in each environment; those that were done begin an episode, with a reward of 0.

        Parameters
        ----------
        actions : array, shape (num_envs, actions)
            From -1 to 1, scaled to the bounds of the inputs.

        Returns
        -------
        tuple
            Like the result of `FmuEnv.step`, with a first axis of environments.
        """
        if self._arrays is not np and not isinstance(actions, np.ndarray):
            actions = self._arrays.from_dlpack(actions)
        values = self._own_units(self._arrays.asarray(actions), self.action_space)
        rewards, is_running = self._arrays.zeros(self.num_envs), ~self._done
        if self._done.any():
            self._runs.reset(self._randoms, self._done)
        if is_running.any():
            self._runs.act(values, is_running)
        else:
            self._look()
        for _ in range(self._task.steps):
            if not is_running.any():
                break
            reward = self._step(is_running)
            rewards += np.where(self._arrays.asarray(is_running), reward, 0.0)
            is_running &= ~self._done
        truncated = self._done & ~self._terminated
        return self._observation(), rewards, self._terminated, truncated, self._info()

    def recordings(self) -> list[Recording]:
        """Returns the recording of the present episode of each environment until now.

        Returns
        -------
        list of Recording
        """
        self._check_begun()
        return self._runs.recordings()

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the FMUs, and ends the episodes; `close` calls it.

        Parameters
        ----------
        **kwargs
            Ignored.
        """
        self._runs.close()
        self._done = None


def _spaces(plan: EpisodePlan) -> tuple[Box, Box]:
    """Returns the spaces of observations, and of actions in their own units."""
    task, system = plan.task, plan.system

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
    if not task.actions or not plan.variables:
        raise SystemDefinitionError("task: expected an action, and a variable to observe")
    kinds = {name: system.ports[name].variable.type for name in task.actions}
    others = [f"{name} is of type {kind}" for name, kind in kinds.items() if kind != "Real"]
    if others:
        raise SystemDefinitionError(f"action: {', '.join(others)}: expected inputs of type Real")
    return observations, actions
