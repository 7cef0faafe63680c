"""Steered laws, networks and observations for the tests of learned policies."""

from dataclasses import replace
from itertools import pairwise

import gymnasium as gym
import numpy as np
from oracles.episodes import ROBOTS

from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import Shift, Steering
from cablebot_gym.envs import PAPER_ENV_IDS
from cablebot_gym.policies import load_policy

PLANAR_ID, SPATIAL_ID, _, FLEX_SPATIAL_ID = PAPER_ENV_IDS

FEATURES = ("pose", "actions", "error", "time_since_start", "time_to_go_decays", "model_payload")


def steering_of(env_id=PLANAR_ID, base=None, action_mapping=None, features=FEATURES):
    robot = ROBOTS[env_id]
    return Steering(
        robot, base=base or Base(), action_mapping=action_mapping or Shift(), features=features
    )


def network_of(steering, *, scale=1.0):
    """A random network; with a scale of 0 its output is zero."""
    draw = np.random.default_rng(1)
    sizes = (steering.inputs, 8, steering.actions)
    pairs = list(pairwise(sizes))
    return Network(
        mean=draw.normal(size=steering.inputs),
        scale=draw.uniform(0.5, 2.0, steering.inputs),
        weights=tuple(scale * draw.normal(size=(after, before)) for before, after in pairs),
        biases=tuple(scale * draw.normal(size=after) for _, after in pairs),
    )


def bundle_of(base=None, action_mapping=None, env_id=PLANAR_ID, **network):
    steering = steering_of(env_id, base, action_mapping)
    bundle = Bundle.of_steering(env_id, steering, network_of(steering, **network))
    return replace(bundle, card={"seed": 1, "note": "é"})


def springs(**shift):
    """A policy of a flexible robot."""
    return bundle_of(Base(law="composite"), Shift(degree=4, **shift), FLEX_SPATIAL_ID)


def observations(env_id, steps):
    """Observations (steps, 4, size) of a classical law with different payloads, and the
    tasks."""
    env = gym.make_vec(env_id, num_envs=4)
    observation, _ = env.reset(seed=3, options={"payload": np.linspace(0.0, 1.5, 4)})
    policy = load_policy("motor-pd" if "Flex" in env_id else "fl", ROBOTS[env_id])
    rows = []
    for _ in range(steps):
        rows.append(observation.copy())
        observation, *_ = env.step(policy.predict(observation)[0])
    return np.array(rows), env.unwrapped.tasks


def tasks_of(env_id, **keywords):
    env = gym.make_vec(env_id, num_envs=2, **keywords)
    env.reset(seed=0)
    return env.unwrapped.tasks


def run(policy, rows):
    """Actions of a policy for observations (steps, …, size)."""
    state = None
    actions = []
    for observation in rows:
        action, state = policy.predict(observation, state)
        actions.append(action)
    return np.array(actions)


def steer(steering, rows, actions):
    """Blocks that the base law gets, and observations of a learner, for actions (steps, size)."""
    law_blocks = []
    memory = None
    observed = []
    steering.law.respond = lambda blocks, *arguments: (
        law_blocks.append(blocks) or (np.zeros(6), None)
    )
    for observation, action in zip(rows, actions, strict=True):
        blocks = steering.split(observation)
        memory = steering.reset_memory(blocks, memory, None)
        observed.append(steering.observe(blocks, memory))
        _, memory = steering.respond(blocks, action, memory)
    return {
        name: np.array([blocks[name] for blocks in law_blocks]) for name in law_blocks[0]
    }, np.array(observed)
