"""A controller of your own against the paper's: the same law, told to hang a little lower, where cables are steeper.

A policy is anything with Stable-Baselines3's ``predict``; here it gets all payloads as one batch. The equations are
those of ``cablebot_gym.physics.textbook``.

Run it: python examples/your_controller.py
"""

import numpy as np

from cablebot_gym.dlcc import evaluate_dlcc
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics.textbook import drive_command, inverse_dynamics
from cablebot_gym.robots import SPATIAL

LOWER = np.array([0, 0, 0.006, 0, 0, 0])  # [m]; z points down


class Sagging:
    """Feedback linearization about a reference 6 mm below the one that is judged by."""

    layout = observation_layout(SPATIAL)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        part = self.layout.split(observation)
        error = part["reference_pose"] + LOWER - part["pose"]
        error_rate = part["reference_velocity"] - part["velocity"]
        acceleration = part["reference_acceleration"] + 60 * error_rate + 900 * error
        mass = SPATIAL.mass + part["told_payload"][..., 0]
        needed = inverse_dynamics(SPATIAL, mass, part["pose"], part["velocity"], acceleration)
        return drive_command(SPATIAL, needed.torques, needed.speeds), state


if __name__ == "__main__":
    for policy in ("fl", Sagging()):
        print(evaluate_dlcc(policy, "CableBot-Spatial-v0"))
