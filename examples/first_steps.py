"""Runs one episode step by step, prints the blocks of an observation, and evaluates the episode.

Run it: python examples/first_steps.py
"""

import gymnasium as gym

from cablebot_gym import DLCCMonitor, load_policy
from cablebot_gym.robots import SPATIAL

env = DLCCMonitor(gym.make("CableBot-Spatial-v0"))
observation, info = env.reset(seed=0, options={"payload": 3.0})
print(env.unwrapped.layout.table())

policy = load_policy("fl", SPATIAL)  # the paper's feedback linearization for the nominal robot
terminated = truncated = False
while not (terminated or truncated):
    action, _ = policy.predict(observation)
    observation, reward, terminated, truncated, info = env.step(action)
verdict = env.verdict
print(f"largest position error {1e3 * verdict.position_peak:.2f} mm")
print(f"largest action {max(verdict.peak_action):.2f}")
print("carried" if verdict.carried else f"not carried: {verdict.violation}")
