# /// script
# dependencies = ["cablebot-gym[minari]", "minari"]
# ///
"""Minari: episodes of a policy as a dataset for offline reinforcement learning."""

import os

import gymnasium as gym

os.environ["MINARI_DATASETS_PATH"] = os.path.abspath("datasets")
import minari  # reads the path

import cablebot_gym
from cablebot_gym import load_policy
from cablebot_gym.robots import PLANAR

ENV_ID = cablebot_gym.ENV_IDS[0]

env = minari.DataCollector(gym.make(ENV_ID))
policy = load_policy("fl", PLANAR)
for payload in (0.0, 1.0):
    observation, _ = env.reset(seed=0, options={"payload": payload})
    ended = False
    while not ended:
        action = policy.predict(observation)[0].astype("float32")
        observation, _, terminated, truncated, _ = env.step(action)
        ended = terminated or truncated
env.create_dataset(
    "cablebot-planar/fl-v0",
    eval_env=ENV_ID,
    algorithm_name="fl",
    author="you",
    author_email="you@example.org",
)
dataset = minari.load_dataset("cablebot-planar/fl-v0")
print(f"{dataset.total_episodes} episodes, {dataset.total_steps} steps")
