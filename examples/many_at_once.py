"""Runs a thousand robots with different payloads in one batch, and counts those that stay within 10
mm.

Run it: python examples/many_at_once.py
"""

import gymnasium as gym
import numpy as np

from cablebot_gym import load_policy
from cablebot_gym.robots import SPATIAL

COUNT = 1024

if __name__ == "__main__":
    envs = gym.make_vec("CableBot-Spatial-v0", num_envs=COUNT, payload_range=(0, 8))
    policy = load_policy("fl", SPATIAL)
    observations, info = envs.reset(seed=0)
    payload, worst = info["payload"], info["tracking_error"]
    for _ in range(envs.unwrapped.tasks[0].steps):
        actions, _ = policy.predict(observations)
        observations, _, terminated, _, info = envs.step(actions)
        # A terminated episode has failed with this payload; its environment restarts with another
        # one.
        worst = np.maximum(worst, np.where(terminated, np.inf, info["tracking_error_peak"]))
    for low in range(8):
        inside = (payload >= low) & (payload < low + 1)
        print(f"{low} to {low + 1} kg: {np.mean(worst[inside] <= 0.01):4.0%} of {inside.sum()}")
