"""Behaviour that all classical laws share: their robots, observations, batches and registered
names."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import cablebot_baselines.classical
from cablebot_baselines.classical import Composite, FeedbackLinearization
from cablebot_baselines.classical.law import first_steps
from cablebot_gym import ENV_IDS
from cablebot_gym.envs import PAPER_ENV_IDS
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

ENTRIES = [
    entry for entry in vars(cablebot_baselines.classical).values() if isinstance(entry, PolicyEntry)
]
CASES = [(entry, env_id) for entry in ENTRIES for env_id in entry.env_ids]

each_case = pytest.mark.parametrize(
    ("entry", "env_id"), CASES, ids=lambda value: getattr(value, "name", value)
)


@pytest.fixture(scope="module")
def started():
    """Tasks and observations of two environments of each id."""
    envs = {env_id: gym.make_vec(env_id, num_envs=2) for env_id in ENV_IDS}
    observations = {env_id: env.reset(seed=0)[0] for env_id, env in envs.items()}
    return {env_id: env.unwrapped.tasks for env_id, env in envs.items()}, observations


@each_case
def test_law_accepts_its_robot_and_rejects_others(started, entry, env_id):
    tasks, observations = started
    law = entry.factory(tasks[env_id][0].robot)
    law.reset(tasks[env_id])
    for other_id in ENV_IDS:
        if other_id != env_id:
            with pytest.raises(ValueError, match=r"was built for robot .*Build the law"):
                law.reset(tasks[other_id])
            if (
                observations[other_id].shape == observations[env_id].shape
            ):  # four cables, three coordinates
                continue
            for wrong in (observations[other_id], observations[other_id][0]):
                with pytest.raises(
                    ValueError, match=r"the observation of robot '.*' has \d+ components, not"
                ):
                    law.predict(wrong)


@pytest.mark.parametrize(
    ("robot", "changes"),
    [
        (SPATIAL, {"base_anchors": 1.01 * SPATIAL.base}),
        (SPATIAL, {"platform_anchors": 1.01 * SPATIAL.platform}),
        (FLEX_SPATIAL, {"home_pose": (0, 0, 0.15, 0, 0, 0)}),
    ],
)
def test_law_rejects_a_robot_of_another_geometry(robot, changes):
    law = Composite(robot) if robot.flexible else FeedbackLinearization(robot)
    env_id = "CableBot-FlexSpatial-v0" if robot.flexible else "CableBot-Spatial-v0"
    law.reset([gym.make(env_id, robot=robot.replace(mass=11.0)).unwrapped.task])
    changed = gym.make(env_id, robot=robot.replace(name="changed", **changes)).unwrapped.task
    with pytest.raises(ValueError, match="'changed' differs in kind or anchors"):
        law.reset([changed])


@each_case
def test_single_observation_gives_the_action_of_its_row(started, entry, env_id):
    """For three steps, so that a law's state matters; the second action is beyond the motors'
    limits."""
    robot = started[0][env_id][0].robot
    moving = (
        {"trajectory": f"paper-{robot.kind}"} if env_id in PAPER_ENV_IDS else {}
    )  # from the first step on
    env = gym.make_vec(env_id, num_envs=3, payload=[0.0, 3.0, 8.0], **moving)
    law = entry.factory(robot)
    observation, _ = env.reset(seed=0)
    together = None
    alone = [None] * 3
    start = np.ones(3, np.bool_)
    for _ in range(3):
        before = observation.copy()
        action, together = law.predict(
            observation, state=together, episode_start=start, deterministic=True
        )
        assert action.shape == (3, env.single_action_space.shape[0])
        assert np.ptp(action, axis=0).max() > 0.01
        np.testing.assert_array_equal(observation, before)
        for index in range(3):
            single, alone[index] = law.predict(
                observation[index], state=alone[index], episode_start=start[index]
            )
            assert single.shape == action[index].shape
            np.testing.assert_allclose(single, action[index], rtol=1e-9, atol=1e-9)
        observation, *_ = env.step(action)
        start = np.zeros(3, np.bool_)


def test_episode_start_is_one_boolean_or_one_per_row():
    """Stable-Baselines3 passes an array of one for one observation."""
    for start in (True, np.array([[True]])):
        assert first_steps("a state", start, ()).item()
        assert not first_steps("a state", ~np.asarray(start), ()).item()
    assert first_steps("a state", [True, False, True], (3,)).tolist() == [True, False, True]
    with pytest.raises(ValueError, match=r"one boolean or have shape \(3,\)"):
        first_steps("a state", [True, False], (3,))
