"""What all shipped policies have in common: actions of a batch and of an episode alone, memory, and
refused robots."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import ROBOTS

from cablebot_gym import ENV_IDS
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.policies import load_policy, policy_entries
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL

ENTRIES = policy_entries()

PLANNERS = ("trajopt", "learned-plan", "refined-plan")
"""Policy that takes seconds to minutes at the start of a loop."""

CASES = [
    *(
        pytest.param(
            name, env_id, marks=pytest.mark.landing if name in ("nmpc", "observing", "ppo") else ()
        )
        for name, entry in ENTRIES.items()
        if name not in PLANNERS
        for env_id in entry.env_ids
    ),
    *(pytest.param(name, "CableBot-Planar-v0", marks=pytest.mark.landing) for name in PLANNERS),
    ("fl:gains=tuned", "CableBot-Planar-v0"),
    ("composite:gains=paper", "CableBot-FlexSpatial-v0"),
]

STEPS, RESTART = 16, 8
"""Number of steps, and the step at which the first episode starts anew."""


class Episode:
    """An episode of a robot, and a policy that acts in it alone."""

    def __init__(self, name, env_id, motion, payload):
        kind = ROBOTS[env_id].kind
        trajectory = {"name": f"loop-{kind}", "seed": motion, "dwell": 0.0}
        if name in PLANNERS:
            trajectory = {"name": "line-planar", "duration": 0.4 + motion / 50, "dwell": 0.0}
        self.env = gym.make(env_id, trajectory=trajectory, payload=payload)
        self.task = self.env.unwrapped.task
        self.policy = load_policy(name, self.task.robot)
        self.policy.reset([self.task])
        self.start()

    def start(self):
        self.observation, _ = self.env.reset(seed=0)
        self.state = None

    def act(self):
        action, self.state = self.policy.predict(self.observation, self.state)
        return action


@pytest.mark.usefixtures("exact_plans_only")
@pytest.mark.parametrize(("name", "env_id"), CASES)
def test_row_of_a_batch_acts_as_an_episode_alone(name, env_id):
    """Excludes gains or tensions for the hardest motion of a batch, memory that another episode or
    the last one leaves, and actions that differ when they are repeated."""
    episodes = [Episode(name, env_id, motion, payload) for motion, payload in ((0, 0.0), (5, 2.0))]
    tasks = [episode.task for episode in episodes]
    policy = load_policy(name, tasks[0].robot)
    policy.reset(tasks)
    state = None
    actions = []
    for step in range(STEPS):
        if step == RESTART:
            episodes[0].start()
        starts = np.array([step in (0, RESTART), step == 0])
        observation = np.stack([episode.observation for episode in episodes])
        before = observation.copy()
        repeated, _ = policy.predict(observation, state=state, episode_start=starts)
        action, state = policy.predict(
            observation, state=state, episode_start=starts, deterministic=True
        )
        assert_array_equal(repeated, action)
        assert_array_equal(observation, before)
        assert action.shape == (2, tasks[0].robot.cables)
        assert action.dtype == np.float64
        for episode, row in zip(episodes, action, strict=True):
            assert_allclose(episode.act(), row, rtol=1e-9, atol=1e-9)
            episode.observation = episode.env.step(np.clip(row, -1, 1))[0]
        actions.append(action)
    assert np.ptp(actions, axis=0).max() > 1e-3
    assert np.ptp(actions, axis=1).max() > 1e-3


@pytest.mark.parametrize("name", ["nmpc", "observing", "ppo", *PLANNERS])
def test_policy_for_the_motions_of_its_tasks_raises_before_reset(name):
    observation, _ = gym.make("CableBot-Planar-v0").reset(seed=0)
    with pytest.raises(RuntimeError, match=r"call reset\(tasks\) before predict\(\)"):
        load_policy(name, PLANAR).predict(observation)


@pytest.mark.parametrize("name", ENTRIES)
def test_robot_of_another_kind_is_refused_with_policies_that_support_it(name):
    """A user's robot is judged by its kind."""
    for env_id in set(ENV_IDS) - set(ENTRIES[name].env_ids):
        robot = ROBOTS[env_id].replace(name="own", mass=3.0)
        supporting = [other for other, entry in ENTRIES.items() if env_id in entry.env_ids]
        message = f"'{name}' does not support robot 'own'.*: use one of {', '.join(supporting)}$"
        with pytest.raises(ValueError, match=message):
            load_policy(name, robot)


@pytest.mark.parametrize(
    ("name", "robot", "changes"),
    [
        ("fl", SPATIAL, {"base_anchors": 1.01 * SPATIAL.base}),
        ("fl", SPATIAL, {"platform_anchors": 1.01 * SPATIAL.platform}),
        ("composite", FLEX_SPATIAL, {"home_pose": (0, 0, 0.15, 0, 0, 0)}),
    ],
)
def test_law_rejects_tasks_and_observations_of_a_robot_of_another_geometry(name, robot, changes):
    def task(**changes):
        changed = robot.replace(name="changed", **changes)
        return gym.make(fitting_env_id(robot), robot=changed).unwrapped.task

    law = load_policy(name, robot)
    law.reset([task(mass=11.0)])
    with pytest.raises(ValueError, match=r"'changed' differs in kind or anchors. Build the law"):
        law.reset([task(**changes)])
    with pytest.raises(ValueError, match=r"observation of robot '.*' has \d+ components"):
        law.predict(np.zeros(3))
