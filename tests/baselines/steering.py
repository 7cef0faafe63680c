"""Steered laws, networks and observations for the tests of learned policies."""

from itertools import pairwise

import gymnasium as gym
import numpy as np

from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import (
    Shift,
    Steering,
)
from cablebot_gym.envs import PAPER_ENV_IDS, env_robot
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import find_robot

PLANAR_ID, SPATIAL_ID, FLEX_PLANAR_ID, FLEX_SPATIAL_ID = PAPER_ENV_IDS

PERIOD = 1 / 500

FEATURES = (
    "pose",
    "actions",
    "error",
    "time_since_start",
    "time_to_go_decays",
    "model_payload",
)

CASES = {
    "rigid": (PLANAR_ID, Base(gains=(2000.0, 90.0)), Shift(action_period=0.02)),
    "springs": (FLEX_SPATIAL_ID, Base(law="composite"), Shift(degree=4)),
}
"""Environment, base law and action mapping."""


def steering_of(env_id=PLANAR_ID, base=None, action_mapping=None, features=FEATURES):
    robot = find_robot(env_robot(env_id))
    return Steering(
        robot, base=base or Base(), action_mapping=action_mapping or Shift(), features=features
    )


def network_of(steering, *, scale=1.0, hidden=(8,), seed=1):
    """A random network; with a scale of 0 its output is zero."""
    draw = np.random.default_rng(seed)
    sizes = (steering.inputs, *hidden, steering.actions)
    pairs = list(pairwise(sizes))
    return Network(
        mean=draw.normal(size=steering.inputs),
        scale=draw.uniform(0.5, 2.0, steering.inputs),
        weights=tuple(scale * draw.normal(size=(after, before)) for before, after in pairs),
        biases=tuple(scale * draw.normal(size=after) for _, after in pairs),
    )


def bundle_of(case="rigid", **network):
    env_id, base, action_mapping = CASES[case]
    return Bundle(
        env_id=env_id,
        base=base,
        action_mapping=action_mapping,
        features=FEATURES,
        network=network_of(steering_of(env_id, base, action_mapping), **network),
        card={"seed": 1, "note": "é"},
    )


def observations(env_id, steps, envs=4):
    """Observations (steps, envs, size) of a classical law with different payloads, and the
    tasks."""
    env = gym.make_vec(env_id, num_envs=envs)
    observation, _ = env.reset(seed=3, options={"payload": np.linspace(0.0, 1.5, envs)})
    policy = load_policy("motor-pd" if "Flex" in env_id else "fl", find_robot(env_robot(env_id)))
    rows = []
    for _ in range(steps):
        rows.append(observation.copy())
        observation, *_ = env.step(policy.predict(observation)[0])
    return np.array(rows), env.unwrapped.tasks


def tasks_of(env_id, **keywords):
    env = gym.make_vec(env_id, num_envs=2, **keywords)
    env.reset(seed=0)
    return env.unwrapped.tasks


def run(policy, rows, starts=None):
    """Actions of a policy for observations (steps, …, size); ``starts`` (steps, …) marks the starts
    of episodes."""
    state = None
    actions = []
    for step, observation in enumerate(rows):
        action, state = policy.predict(observation, state, None if starts is None else starts[step])
        actions.append(action)
    return np.array(actions)


def line(robot, start, speed, times):
    """Observations (steps, size) of a reference with constant velocity."""
    layout = observation_layout(robot)
    rows = np.zeros((len(times), layout.size))
    blocks = layout.split(rows)
    blocks["reference_pose"][:] = start + speed * np.asarray(times)[:, None]
    blocks["reference_velocity"][:] = speed
    return rows


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
