"""Defines a reward from `info`: accuracy minus the heat of the motors.

Run it: python examples/your_reward.py
"""

import gymnasium as gym

from cablebot_gym import load_policy
from cablebot_gym.robots import PLANAR


class Frugal(gym.Wrapper):
    """Accuracy (1 on the reference, 0 beyond 10 mm) minus a tenth of the mean squared torque
    ratio."""

    def step(self, action):
        observation, _, terminated, truncated, info = self.env.step(action)
        accuracy = max(0.0, 1 - info["tracking_error"] / 0.01)
        heat = float(((info["torques"] / PLANAR.stall_torque) ** 2).mean())
        return observation, accuracy - 0.1 * heat, terminated, truncated, info


if __name__ == "__main__":
    for payload in (0.0, 1.0, 2.0):
        env = Frugal(gym.make("CableBot-Planar-v0", payload=payload))
        total = 0.0
        ended = False
        policy = load_policy("fl", PLANAR)
        (observation, _) = env.reset(seed=0)
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(policy.predict(observation)[0])
            total, ended = total + reward, terminated or truncated
        print(f"{payload:g} kg: {total:.1f} of {env.unwrapped.task.steps}")
