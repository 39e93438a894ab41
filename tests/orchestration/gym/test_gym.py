"""Environments: an agent takes a controller's place, an episode is a run, and its rewards are its metrics."""

import re
import warnings
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from fmus.block.block_file import write_new_block
from orchestration.errors import ScenarioError, SimulationError, SystemDefinitionError
from orchestration.gym import FmuEnv, FmuVectorEnv, Task, task_of
from orchestration.results import increments, metrics
from orchestration.scenarios.scenario import Scenario, load_scenario
from orchestration.system.experiment import Event, Experiment
from orchestration.system.signals import Ramps
from orchestration.system.system import System
from tests.described_fmus import described
from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build

FORCE, POSITION, REFERENCE = "plant.u[1]", "plant.y[1]", "control.u[2]"
METRICS = {
    "error": {"function": "rmse", "signal": POSITION, "reference": REFERENCE, "scale": 10.0, "unit": "mm"},
    "effort": {"function": "effort", "signal": POSITION},
    "variation": {"function": "total_variation", "signal": POSITION},
    "late": {"function": "mean", "signal": POSITION, "window": [0.5, 1.0]},
    "early": {"function": "effort", "signal": FORCE, "window": [0.0, 0.5]},
    "own": {"function": "effort", "signal": "control.y[1]"},
}
BOUNDS = {FORCE: (-2.0, 6.0)}


@pytest.fixture
def scenario(linear: Build) -> Scenario:
    """A plant x' = -x + u that a controller leads along a ramp."""
    plant, control = linear(saves_state=True), linear(b=(1.0, 1.0), d=((0.5, 0.0),))
    system = System(
        {"plant": plant, "control": control}, ((POSITION, "control.u[1]"), ("control.y[1]", FORCE))
    )
    experiment = Experiment(
        1.0,
        0.1,
        parameters={"control.a": -2.0, "plant.initial_state": 3.0},
        signals={REFERENCE: Ramps([[0.0, 0.0], [1.0, 2.0]])},
        events=(Event(0.5, {"control.a": -1.0}),),
        record=(POSITION, "control.y[1]", REFERENCE),
    )
    return Scenario("ramp", "A ramp", system, experiment, METRICS)


@pytest.fixture
def task(scenario: Scenario) -> Task:
    weights = {"error": -1.0, "effort": -0.5, "variation": -0.1}
    return replace(task_of(scenario, weights, replaced="control", bounds=BOUNDS), vary={"plant.a": draw})


@pytest.fixture
def env(task: Task) -> Iterator[FmuEnv]:
    with closing(FmuEnv(task)) as made:
        yield made


@pytest.fixture
def envs(task: Task) -> Iterator[FmuVectorEnv]:
    """Two of them."""
    with closing(FmuVectorEnv(task, 2)) as made:
        yield made


def draw(random: np.random.Generator) -> float:
    return -random.uniform(1.0, 2.0)


def episode(env: FmuEnv, **options: Any) -> tuple[np.ndarray, float]:
    """Observations and the sum of rewards under actions that are the same each time."""
    observations, total, done = [env.reset(**options)[0]], 0.0, False
    actions = np.random.default_rng(0)
    while not done:
        observation, reward, terminated, truncated, _ = env.step(actions.uniform(-1.0, 1.0, 1))
        observations.append(observation)
        total, done = total + reward, terminated or truncated
    return np.array(observations), total


def test_gymnasium_finds_nothing_wrong(task: Task) -> None:
    gymnasium.register("Checked-v0", entry_point=lambda **_: FmuEnv(task))
    with warnings.catch_warnings(), closing(gymnasium.make("Checked-v0")) as made:
        warnings.simplefilter("error")
        check_env(made.unwrapped)


def test_the_agent_takes_the_place_of_the_component(task: Task, scenario: Scenario) -> None:
    assert (task.actions, task.observations) == ((FORCE,), (POSITION, REFERENCE))
    assert list(task.system.components) == ["plant"]
    assert task.experiment.parameters == {"plant.initial_state": 3.0}
    assert (task.experiment.signals, task.experiment.events) == ({}, ())
    assert task.experiment.record == (POSITION,)
    later = replace(scenario.experiment, start_time=-3.0, step_sizes={"plant": 0.2, "control": 0.1})
    other = task_of(replace(scenario, experiment=later), {"error": -1.0}, replaced="control")
    assert other.experiment.step_sizes == {"plant": 0.2}
    assert other.reward({}, {POSITION: 5.0, REFERENCE: 3.0}, 0.2) == pytest.approx(
        -(20.0**2) * 0.2 / 4.0
    )  # mm, s


@pytest.mark.parametrize("names", [("a", "plant.y[1]", "b"), ("b", "a", "plant.y[1]")])
def test_each_observation_has_the_value_of_its_name(task: Task, names: tuple[str, ...]) -> None:
    signals = {"a": Ramps([[0.0, 0.0], [1.0, 2.0]]), "b": Ramps([[0.0, 5.0], [1.0, 4.0]])}
    observing = replace(task, signals=signals, observations=names, vary={}, reward=lambda before, after, h: h)
    with closing(FmuEnv(replace(observing, reads=()))) as env:
        env.reset()
        observed = dict(zip(names, env.step(np.zeros(1))[0].tolist(), strict=True))
        position = env.recording()[POSITION][-1]
    assert observed == pytest.approx({"a": 0.2, "b": 4.9, "plant.y[1]": position})


def misbehaving(task: Task, rogue: Build, misdeed: Misdeed, time: float) -> Task:
    """Of a plant that does it from that time [s]."""
    parameters = {"plant.misdeed": int(misdeed), "plant.misdeed_time": time}
    return replace(
        task,
        system=System({"plant": rogue(saves_state=True)}),
        experiment=Experiment(1.0, 0.1, parameters=parameters),
        actions=("plant.u",),
        observations=("plant.y",),
        reward=lambda before, after, h: h,
        bounds={"plant.u": (0.0, 1.0)},
        reads=(),
        vary={},
    )


def test_the_reward_of_several_points_is_their_sum(task: Task) -> None:
    """Alone, and in a vector of one."""
    rewarded = replace(task, reward=increments.effort(POSITION), steps=5)
    with closing(FmuVectorEnv(rewarded, 1)) as envs:
        envs.reset(seed=1)
        total = sum(envs.step(np.zeros((1, 1)))[1] for _ in range(2))
        efforts = [metrics.FUNCTIONS["effort"](recording, POSITION) for recording in envs.recordings()]
    assert total == pytest.approx(efforts)
    with closing(FmuEnv(rewarded)) as env:
        env.reset(seed=1)
        alone = sum(env.step(np.zeros(1))[1] for _ in range(2))
    assert alone == pytest.approx(efforts[0])


def test_an_action_beyond_its_bounds_counts_as_the_nearest_within(env: FmuEnv, envs: FmuVectorEnv) -> None:
    env.reset(seed=1)
    envs.reset(seed=1)
    beyond = [env.step(np.array([3.0]))[0], envs.step(np.full((2, 1), 3.0))[0][0]]
    env.reset(seed=1)
    within = env.step(np.ones(1))[0]
    assert all(np.array_equal(observation, within) for observation in beyond)


def test_inputs_that_nothing_drives_may_be_open(linear: Build, task: Task) -> None:
    system = System({"plant": linear(), "other": linear()})
    open_inputs = Experiment(1.0, 0.1, open_inputs="start")
    with closing(FmuEnv(replace(task, system=system, experiment=open_inputs))) as env:
        assert env.reset()[0][0] == 1.0  # its state


def test_an_environment_begins_anew_after_a_fatal_error(rogue: Build, task: Task) -> None:
    with closing(FmuEnv(misbehaving(task, rogue, Misdeed.FATAL, 0.15))) as env:
        first = env.reset()[0]
        with pytest.raises(SimulationError, match="fatal"):
            [env.step(np.zeros(1)) for _ in range(4)]
        assert np.array_equal(env.reset()[0], first)
        env.step(np.zeros(1))


@pytest.mark.parametrize(
    "drawn",
    [
        {"seeds": ["plant.initial_state"], "vary": {}},
        {"vary": {"plant.initial_state": lambda random: float(random.integers(100))}},
    ],
    ids=["a seed", "a parameter"],
)
def test_what_is_drawn_differs_between_episodes_and_repeats_with_the_seed(task: Task, drawn: Any) -> None:
    with closing(FmuEnv(replace(task, **drawn))) as env:
        starts = [env.reset(seed=seed)[0][0] for seed in (4, None, 4, None)]
    assert starts[:2] == starts[2:]
    assert starts[0] != starts[1]
    assert all(start == int(start) for start in starts)


def test_an_episode_is_a_run_and_its_rewards_add_up_to_its_metrics(task: Task) -> None:
    recorded = replace(task, experiment=replace(task.experiment, record=(POSITION, FORCE)))
    with closing(FmuEnv(recorded)) as env:
        observations, total = episode(env)
        recording = env.recording()
    assert observations[:, 0].tolist() == recording[POSITION].tolist()
    assert observations[:, 1] == pytest.approx(2.0 * recording.time)
    forces = 2.0 + 4.0 * np.random.default_rng(0).uniform(-1.0, 1.0, 10)  # -1..1 are -2..6
    assert recording[FORCE] == pytest.approx([*forces, forces[-1]])
    effort, variation = (metrics.FUNCTIONS[f](recording, POSITION) for f in ("effort", "total_variation"))
    squares = (10.0 * (observations[1:, 0] - observations[1:, 1])) ** 2  # of the points after the first
    assert total == pytest.approx(-squares.mean() - 0.5 * effort - 0.1 * variation)


def test_the_last_step_of_an_episode_is_shorter(task: Task) -> None:
    with closing(FmuEnv(replace(task, steps=3))) as env:
        env.reset()
        times = [env.step(np.zeros(1))[4]["time"] for _ in range(4)]
    assert times == pytest.approx([0.3, 0.6, 0.9, 1.0])


def test_an_episode_without_draws_begins_like_the_first(task: Task) -> None:
    with closing(FmuEnv(replace(task, vary={}))) as env:
        (first, a), (second, b) = episode(env), episode(env)
    assert np.array_equal(first, second)
    assert a == b


def test_an_fmu_that_terminates_the_simulation_terminates_the_episode(rogue: Build, task: Task) -> None:
    with closing(FmuEnv(misbehaving(task, rogue, Misdeed.TERMINATE, 0.35))) as env:
        env.reset()
        steps = [env.step(np.zeros(1)) for _ in range(4)]
    assert [step[2] for step in steps] == [False, False, False, True]
    assert not any(step[3] for step in steps)


def test_a_vector_holds_the_environments_of_its_seeds(task: Task) -> None:
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (13, 3, 1))
    with closing(FmuVectorEnv(task, num_envs=3)) as envs:
        observations, _ = envs.reset(seed=7)
        steps = [envs.step(action) for action in actions]
    for i in range(3):
        with closing(FmuEnv(task)) as env:
            alone = [env.reset(seed=7 + i)[0]]
            alone += [env.step(action[i])[0] for action in actions[:10]]
            alone.append(env.reset()[0])  # by the step after the last
            alone += [env.step(action[i])[0] for action in actions[11:]]
        assert np.array_equal([observations[i], *(step[0][i] for step in steps)], alone)
    assert [step[3].tolist() for step in steps[9:11]] == [[True] * 3, [False] * 3]
    assert steps[10][1].tolist() == [0.0] * 3
    assert envs.observation_space.contains(steps[5][0])


def test_a_reset_after_the_end_begins_episodes_that_the_next_step_does_not_begin_again(
    envs: FmuVectorEnv,
) -> None:
    def begin() -> list[np.ndarray]:
        return [envs.reset(seed=1)[0], *envs.step(np.ones((2, 1)))[:2]]

    first = begin()
    while not envs.step(np.ones((2, 1)))[3].all():
        pass
    assert all(map(np.array_equal, begin(), first))


def test_seeds_of_a_vector_may_be_numbers_of_numpy(envs: FmuVectorEnv) -> None:
    seeds: list[Any] = [3, np.int64(3), np.array([3, 4])]
    seeded = [np.concatenate([envs.reset(seed=seed)[0], envs.step(np.ones((2, 1)))[0]]) for seed in seeds]
    assert np.array_equal(seeded[0], seeded[1])
    assert np.array_equal(seeded[0], seeded[2])


def test_scenarios_are_registered() -> None:
    assert {"orchestration.gym:_scenario_env", "orchestration.gym:_scenario_envs"} == {
        getattr(gymnasium.spec("l1-depth/Scenario-v0"), name)
        for name in ("entry_point", "vector_entry_point")
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"reward": {"eror": 1.0}}, "reward: no metric 'eror'; nearest is 'error'"),
        ({"reward": {"late": 1.0}}, "metric late: expected a sum over the whole run: rmse, effort, to"),
        ({"reward": {"early": 1.0}}, "reward: metric early: expected a sum over the whole run"),
        ({"reward": {"own": 1.0}}, "reward: control.y[1]: the agent takes the place of control"),
        ({"reward": {}, "replaced": "controll"}, "ramp: no component 'controll'; nearest is 'control'"),
    ],
)
def test_a_task_that_a_scenario_does_not_hold_is_refused(
    scenario: Scenario, arguments: Any, message: str
) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        task_of(scenario, **({"replaced": "control"} | arguments))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"bounds": {}}, "plant.u[1]: the FMU has no min and max: expected bounds of each action"),
        ({"observations": ("plant.z",)}, "observation: no variable 'plant.z'"),
        ({"actions": ()}, "plant.u[1]: driven by nothing"),
        ({"observations": (REFERENCE,), "reads": ()}, "expected an action, and a variable to observe"),
    ],
)
def test_an_environment_that_cannot_be_made_is_refused(task: Task, changes: Any, message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=re.escape(message)):
        FmuEnv(replace(task, **changes))


def test_an_action_of_another_type_than_real_is_refused(linear: Build, task: Task) -> None:
    discrete = replace(
        task,
        system=System({"plant": linear(passes_discrete=True)}),
        experiment=Experiment(1.0, 0.1, open_inputs="start"),
        actions=("plant.integer_in",),
        bounds={"plant.integer_in": (0.0, 4.0)},
    )
    with pytest.raises(SystemDefinitionError, match="integer_in is of type Integer: expected inputs of"):
        FmuEnv(discrete)


def test_an_environment_is_refused_until_its_first_reset_and_from_its_end_on(
    env: FmuEnv, envs: FmuVectorEnv
) -> None:
    steps = (lambda: env.step(np.zeros(1)), lambda: envs.step(np.zeros((2, 1))))
    calls: tuple[Any, ...] = (*steps, env.recording, envs.recordings)

    def are_refused() -> None:
        for call in calls:
            with pytest.raises(gymnasium.error.ResetNeeded, match=r"no episode has begun: expected reset"):
                call()

    are_refused()
    env.reset()
    envs.reset()
    for call in calls:
        call()
    env.close()
    envs.close()
    are_refused()


@pytest.mark.parametrize("action", [0.5, [[0.5]], [0.5, 0.5], []])
def test_an_action_of_another_shape_is_refused(env: FmuEnv, action: Any) -> None:
    env.reset()
    with pytest.raises(SystemDefinitionError, match=r"action of shape \(.*\): expected \(1,\)"):
        env.step(action)


@pytest.mark.parametrize("actions", [0.5, [0.5], [[0.5]], np.zeros((3, 1)), np.zeros((2, 2))])
def test_actions_of_a_vector_are_not_stretched_to_its_shape(envs: FmuVectorEnv, actions: Any) -> None:
    envs.reset()
    with pytest.raises(SystemDefinitionError, match=r"action of shape \(.*\): expected \(2, 1\)"):
        envs.step(actions)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *(({"seed": seeds}, f"{len(seeds)} seeds: expected 2") for seeds in ([], [1], [1, 2, 3])),
        (
            {"options": {"reset_mask": np.array([True, False])}},
            "reset_mask: expected none, the next step",
        ),
    ],
)
def test_environments_are_reset_together_and_each_by_its_seed(
    envs: FmuVectorEnv, arguments: Any, message: str
) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        envs.reset(**arguments)
    envs.reset(options={"mine": 1})


@pytest.mark.parametrize("count", [0, -1, 2.0, "2"])
def test_a_vector_of_no_environment_is_refused(task: Task, count: Any) -> None:
    with pytest.raises(SystemDefinitionError, match=r"num_envs = .*: expected a whole number from 1 on"):
        FmuVectorEnv(task, count)


def test_a_vehicle_may_be_a_python_file(vehicle_fmus: None, tmp_path: Path) -> None:
    """Its FMU is built, and the range of its force bounds the actions."""
    write_new_block("rover", tmp_path, kind="vehicle")
    task = task_of("nominal-extended", {"rmse": -1.0}, plant=tmp_path / "rover.py")
    assert task.actions == ("plant.control_force",)
    with closing(FmuEnv(task)) as env:
        assert (env._middle, env._half) == (0.0, 6.0)


def test_an_agent_steers_another_vehicle(vehicle_fmus: None, tmp_path: Path) -> None:
    """Its force is the action, within its range; what it has under another name is mapped."""
    fmu = described(tmp_path / "boat.fmu", ("thrust",), ("depth", "depth_rate"))
    task = task_of("nominal-extended", {"rmse": -1.0}, plant=fmu, mapping={"control_force": "thrust"})
    assert task.actions == ("plant.thrust",)
    assert set(task.observations) == {"plant.depth", "plant.depth_rate", "controller.depth_reference"}
    loaded = load_scenario("nominal-extended")
    with pytest.raises(ScenarioError, match="expected the name of a scenario, got one that is loaded"):
        task_of(loaded, {"rmse": -1.0}, plant=fmu)
