# /// script
# dependencies = ["cablebot-gym", "minari[create,hdf5]", "pillow"]
# [tool.clients]
# package = "minari"
# ///
"""Minari: episodes of a policy as a dataset for offline reinforcement learning, and a replay."""

import os

import gymnasium as gym
import numpy as np

os.environ["MINARI_DATASETS_PATH"] = os.path.abspath("datasets")
import minari  # reads the path

from cablebot_gym import load_policy
from cablebot_gym.robots import PLANAR

ENV_ID = "CableBot-Planar-v0"
NAME = "cablebot-planar/fl-v0"
ORIGIN = {"algorithm_name": "fl", "author": "you", "author_email": "you@example.org"}

env = minari.DataCollector(gym.make(ENV_ID))
policy = load_policy("fl", PLANAR)
for payload in (0.0, 1.0):
    observation, _ = env.reset(seed=0, options={"payload": payload})
    policy.reset([env.unwrapped.task])
    ended = False
    while not ended:
        action = policy.predict(observation)[0].astype(env.action_space.dtype)
        observation, _, terminated, truncated, _ = env.step(action)
        ended = terminated or truncated
dataset = env.create_dataset(NAME, eval_env=ENV_ID, **ORIGIN)

episode = dataset[1]
env = dataset.recover_environment()
observations = [env.reset(seed=0, options={"payload": payload})[0]]
observations += [env.step(action)[0] for action in episode.actions]
assert np.array_equal(observations, episode.observations)  # to the last bit
print(f"{dataset.total_episodes} episodes, {dataset.total_steps} steps")
