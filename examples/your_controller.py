"""A controller of your own against the paper's: the same law, told to hang a little lower, where cables are steeper.

Run it: python examples/your_controller.py
"""

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.physics.textbook import drive_command, inverse_dynamics
from cablebot_gym.robots import SPATIAL


class Sagging:
    """Feedback linearization about a reference 6 mm below the one that is judged by; z points down."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        part = observation_layout(SPATIAL).split(observation)
        error = part["reference_pose"] + [0, 0, 0.006, 0, 0, 0] - part["pose"]
        error_rate = part["reference_velocity"] - part["velocity"]
        acceleration = part["reference_acceleration"] + 60 * error_rate + 900 * error
        mass = SPATIAL.mass + part["told_payload"][..., 0]
        needed = inverse_dynamics(SPATIAL, mass, part["pose"], part["velocity"], acceleration)
        return drive_command(SPATIAL, needed.torques, needed.speeds), state


if __name__ == "__main__":
    for policy in ("fl", Sagging()):
        print(evaluate_dlcc(policy, "CableBot-Spatial-v0"))
