"""What every law owes: it says when it is built for another robot, and it is found under its own name."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import cablebot_baselines.classical
from cablebot_baselines.classical.law import first_steps
from cablebot_gym import ENV_IDS
from cablebot_gym.policies import PolicyEntry, PolicyError
from cablebot_gym.policies.protocol import reset_policy
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, ROBOTS, SPATIAL

ENTRIES = [entry for entry in vars(cablebot_baselines.classical).values() if isinstance(entry, PolicyEntry)]
CASES = [(entry, env_id) for entry in ENTRIES for env_id in entry.env_ids]

each_case = pytest.mark.parametrize(("entry", "env_id"), CASES, ids=lambda value: getattr(value, "name", value))


def tasks_of(env_id, **keywords):
    env = gym.make_vec(env_id, num_envs=2, **keywords)
    env.reset(seed=0)
    return env.unwrapped.tasks


def robot_of(env_id):
    return tasks_of(env_id)[0].robot


@each_case
def test_law_does_not_refuse_its_own_robot_nor_one_of_another_mass(entry, env_id):
    robot = robot_of(env_id)
    law = entry.factory(robot)
    law.reset(tasks_of(env_id))
    law.reset(tasks_of(env_id, robot=robot.replace(mass=1.1 * robot.mass, name="heavier")))


@each_case
def test_task_of_another_robot_is_not_begun(entry, env_id):
    robot = robot_of(env_id)
    law = entry.factory(robot)
    for other_id in ENV_IDS:
        if other_id != env_id:
            with pytest.raises(
                ValueError, match=rf"was built for robot '{robot.name}', but the task's robot '.*Build the law"
            ):
                law.reset(tasks_of(other_id))


@pytest.mark.parametrize(
    ("robot", "other", "difference"),
    [
        (SPATIAL, FLEX_SPATIAL, "joint springs"),
        (FLEX_SPATIAL, SPATIAL, "no joint springs"),
        (SPATIAL, PLANAR, "3 cables in the plane"),
        (PLANAR, SPATIAL, "6 cables in space"),
        (SPATIAL, SPATIAL.replace(base_anchors=1.01 * SPATIAL.base, name="wide"), "other anchors"),
        (
            FLEX_SPATIAL,
            FLEX_SPATIAL.replace(home_pose=(0, 0, 0.15, 0, 0, 0), name="flex-wide"),
            "another home pose, which is the zero of its motor angles",
        ),
        (SPATIAL, SPATIAL.replace(platform_anchors=1.01 * SPATIAL.platform, name="wide"), "other anchors"),
    ],
)
def test_refusal_does_not_keep_the_difference_to_itself(robot, other, difference):
    law = cablebot_baselines.classical.Composite if robot.flexible else cablebot_baselines.classical.Robust
    env_id = next(env_id for env_id in ENV_IDS if robot_of(env_id).name == other.name.replace("wide", "spatial"))
    task = tasks_of(env_id, robot=other)
    expected = f"built for robot '{robot.name}', but the task's robot '{other.name}' has {difference}. Build the law"
    with pytest.raises(ValueError, match=expected):
        law(robot).reset(task)
    with pytest.raises(PolicyError, match=expected):
        reset_policy(law(robot), "mine", lambda: task)


@each_case
def test_observation_of_another_robot_is_not_read_as_if_it_were_this_ones(entry, env_id):
    law = entry.factory(robot_of(env_id))
    for other_id in ENV_IDS:
        if other_id != env_id:
            observation, _ = gym.make_vec(other_id, num_envs=2).reset(seed=0)
            for wrong in (observation, observation[0]):
                with pytest.raises(
                    ValueError,
                    match=r"a policy for robot '.*' reads observations of \d+ components, .*build it for the env",
                ):
                    law.predict(wrong)


@each_case
def test_one_observation_does_not_differ_from_its_row_of_a_batch(entry, env_id):
    """For three steps, so that what a law remembers counts; the second command lies beyond the motors' reach."""
    env = gym.make_vec(env_id, num_envs=3, payload=[0.0, 3.0, 8.0])
    law = entry.factory(robot_of(env_id))
    observation, _ = env.reset(seed=0)
    together, alone, start = None, [None] * 3, np.ones(3, np.bool_)
    for _ in range(3):
        before = observation.copy()
        action, together = law.predict(observation, state=together, episode_start=start, deterministic=True)
        assert action.shape == (3, env.single_action_space.shape[0])
        np.testing.assert_array_equal(observation, before)
        for index in range(3):
            single, alone[index] = law.predict(observation[index], state=alone[index], episode_start=start[index])
            assert single.shape == action[index].shape
            np.testing.assert_allclose(single, action[index], rtol=1e-9, atol=1e-9)
        observation, *_ = env.step(action)
        start = np.zeros(3, np.bool_)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_entry_is_not_missing_among_the_installed_ones(entry):
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    module, attribute = project["project"]["entry-points"]["cablebot_gym.policies"][entry.name].split(":")
    assert getattr(importlib.import_module(module), attribute) is entry
    assert entry.kind == "classical"
    assert set(entry.env_ids) <= set(ENV_IDS)


def test_robots_are_not_all_without_a_law():
    named = {robot_of(env_id).name for entry in ENTRIES for env_id in entry.env_ids}
    assert named == set(ROBOTS)
    assert FLEX_PLANAR.name in named


@pytest.mark.parametrize("start", [True, np.array([True]), np.array([[True]])])
def test_start_of_one_observation_is_not_refused_in_an_array_of_one(start):
    """Stable-Baselines3 gives it so."""
    assert first_steps("a state", start, ()).item()
    assert not first_steps("a state", ~np.asarray(start), ()).item()


def test_starts_of_another_batch_are_not_taken():
    with pytest.raises(ValueError, match=r"one boolean or have shape \(3,\), not shape \(2,\)"):
        first_steps("a state", [True, False], (3,))
    assert first_steps("a state", [True, False, True], (3,)).tolist() == [True, False, True]
    assert first_steps(None, None, (2,)).tolist() == [True, True]
