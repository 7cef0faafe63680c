"""Environments without wrappers, whole episodes as arrays, and comparisons of their results to the
last bit."""

from __future__ import annotations

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cablebot_gym import ENV_IDS
from cablebot_gym.envs import env_robot
from cablebot_gym.physics.kernel import rows
from cablebot_gym.robots import find_robot

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
FLEX_PLANAR = "CableBot-FlexPlanar-v0"
FLEX_SPATIAL = "CableBot-FlexSpatial-v0"
ROBOTS = {env_id: find_robot(env_robot(env_id)) for env_id in ENV_IDS}

each_id = pytest.mark.parametrize("env_id", ENV_IDS)
rigid_ids = pytest.mark.parametrize("env_id", [PLANAR, SPATIAL])
two_ids = pytest.mark.parametrize("env_id", [PLANAR, FLEX_SPATIAL])
"""The smallest robot and the one with most parts."""


def make(env_id, **keywords):
    """A single environment without wrappers."""
    return gym.make(env_id, **keywords).unwrapped


def make_vector(env_id, count, **keywords):
    """A vector environment without wrappers."""
    return gym.make_vec(env_id, num_envs=count, **keywords).unwrapped


def wrenches(env):
    """Present external force and moment of each environment, (N, 6)."""
    plant = env._simulation._plant
    return plant._read(plant._parameters, rows.FORCE, 6)


def random_actions(env, steps, low=0.0, high=0.8):
    """Random actions that mostly pull, for an environment of either kind."""
    return np.random.default_rng(0).uniform(low, high, (steps, *env.action_space.shape))


@dataclasses.dataclass
class Episode:
    """T steps of one environment or several: observations and info have T + 1 rows, from the reset
    on."""

    observations: np.ndarray
    info: dict[str, np.ndarray]
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


def rollout(env, actions, **reset):
    """An open-loop episode."""
    observation, info = env.reset(**reset)
    observations = [observation]
    infos = [info]
    outcomes = []
    for action in actions:
        observation, *outcome, info = env.step(action)
        observations.append(observation)
        infos.append(info)
        outcomes.append(outcome)
    columns = {key: np.array([info[key] for info in infos]) for key in infos[0]}
    rewards, terminated, truncated = (np.array(column) for column in zip(*outcomes, strict=True))
    return Episode(np.array(observations), columns, rewards, terminated, truncated)


def different_results(ours, theirs):
    """Names of the results that differ in any bit; ``start`` is the first observation."""
    pairs = {"start": (ours.observations[0], theirs.observations[0])}
    for field in ("observations", "rewards", "terminated", "truncated"):
        pairs[field] = getattr(ours, field), getattr(theirs, field)
    for key in ours.info:
        pairs[key] = ours.info[key], theirs.info[key]
    return {name for name, (mine, yours) in pairs.items() if not np.array_equal(mine, yours)}


def check_equal(ours, theirs, where=""):
    """Results of ``reset`` or ``step`` that are equal to the last bit."""
    if isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for key in theirs:
            check_equal(ours[key], theirs[key], key)
    elif isinstance(theirs, tuple):
        for mine, yours in zip(ours, theirs, strict=True):
            check_equal(mine, yours, where)
    else:
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype, where
        assert_array_equal(ours, theirs, err_msg=where)
