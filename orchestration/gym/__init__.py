"""Gymnasium environments of any system: an agent in the place of a controller.

    task = task_of("nominal-extended", {"rmse": -1.0}, bounds={"plant.voltage[1]": (-12.0, 12.0), ...})
    env = FmuEnv(task)                       one environment
    envs = FmuVectorEnv(task, num_envs=16)   many in one process

An episode is one run: truncated at the stop time, terminated if an FMU terminates the simulation. Importing
this module registers `l1-depth/Scenario-v0`, with the arguments of `task_of`.
"""

from typing import Any

from fmus.extras import imports_of
from orchestration.gym.environment import FmuEnv, FmuVectorEnv
from orchestration.many.places import AUTO
from orchestration.scenarios.task import Task, task_of

with imports_of("gym", "a Gymnasium environment"):
    import gymnasium

__all__ = ["FmuEnv", "FmuVectorEnv", "Task", "task_of"]


def _scenario_env(*arguments: Any, **settings: Any) -> FmuEnv:
    return FmuEnv(task_of(*arguments, **settings))


def _scenario_envs(
    *arguments: Any,
    num_envs: int = 1,
    where: str = AUTO,
    **settings: Any,
) -> FmuVectorEnv:
    return FmuVectorEnv(task_of(*arguments, **settings), num_envs, where)


gymnasium.register(
    "l1-depth/Scenario-v0",
    entry_point="orchestration.gym:_scenario_env",
    vector_entry_point="orchestration.gym:_scenario_envs",
)
