"""Files of the shipped networks."""

from __future__ import annotations

from pathlib import Path

from cablebot_gym.envs import fitting_env_id
from cablebot_gym.robots import Robot

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of ``plan-ID.zip``, the networks that plan, and ``ppo-ID.zip``, the actors of reinforcement
learning."""


def weights_of(robot: Robot, kind: str) -> Path:
    """File of the shipped network of a kind, ``plan`` or ``ppo``, for robots of this kind.

    Raises:
        ValueError: if there is none.
    """
    env_id = fitting_env_id(robot)
    path = WEIGHTS / f"{kind}-{env_id}.zip"
    if not path.is_file():
        command = {"plan": "train-plan", "ppo": "train"}[kind]
        raise ValueError(
            f"there is no network for robot {robot.name!r}: cablebot {command} {env_id} trains one"
        )
    return path
