"""Compares your own controller with the paper's: the same law with a lower reference (steeper
cables).

Run it: python examples/your_controller.py
"""

from cablebot_gym import evaluate_dlcc, inverse_dynamics, normalised_action, observation_layout
from cablebot_gym.robots import SPATIAL


class Sagging:
    """Feedback linearization about a reference 8 mm below the evaluated one; z points down."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        blocks = observation_layout(SPATIAL).split(observation)
        error = blocks["reference_pose"] + [0, 0, 0.008, 0, 0, 0] - blocks["pose"]
        error_rate = blocks["reference_velocity"] - blocks["velocity"]
        acceleration = blocks["reference_acceleration"] + 60 * error_rate + 900 * error
        mass = SPATIAL.mass + blocks["model_payload"][..., 0]
        needed = inverse_dynamics(SPATIAL, mass, blocks["pose"], blocks["velocity"], acceleration)
        return normalised_action(SPATIAL, needed.torques, needed.speeds), state


if __name__ == "__main__":
    for policy in ("fl", Sagging()):
        print(evaluate_dlcc(policy, "CableBot-Spatial-v0"))
