# /// script
# dependencies = ["cablebot-gym", "control"]
# ///
"""python-control: an LQR law. The inverse dynamics turn its accelerations into actions."""

import control
import gymnasium as gym
import numpy as np

import cablebot_gym
from cablebot_gym import evaluate_dlcc, inverse_dynamics, normalised_action
from cablebot_gym.robots import PLANAR

ENV_ID = cablebot_gym.ENV_IDS[0]
layout = gym.make(ENV_ID).unwrapped.layout
one, zero = np.eye(2), np.zeros((2, 2))
weights = np.diag([1.0, 1.0, 1e-4, 1e-4]), 1e-7 * one
gain, _, _ = control.lqr(np.block([[zero, one], [zero, zero]]), np.vstack([zero, one]), *weights)


def lqr(observation):
    now = layout.split(observation)
    error = np.concatenate(
        [now["pose"] - now["reference_pose"], now["velocity"] - now["reference_velocity"]]
    )
    acceleration = now["reference_acceleration"] - gain @ error
    mass = PLANAR.mass + now["model_payload"][0]
    needed = inverse_dynamics(PLANAR, mass, now["pose"], now["velocity"], acceleration, minimum=5.0)
    return normalised_action(PLANAR, needed.torques, needed.speeds)


print(evaluate_dlcc(lqr, ENV_ID))
