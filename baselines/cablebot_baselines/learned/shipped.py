"""The shipped learned policy. This module does not need torch."""

from __future__ import annotations

from pathlib import Path

from cablebot_baselines.entries import DATA
from cablebot_gym.policies import Policy, PolicyEntry
from cablebot_gym.robots import Robot

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of ``ppo-circle-spatial.zip``, the bundle, ``ppo-circle-spatial.json``, the record of its
training, and ``ppo-circle-spatial-sb3.zip``, the actor as a model of Stable-Baselines3."""

BUNDLE = WEIGHTS / "ppo-circle-spatial.zip"
"""Bundle of ``ppo-circle``."""


def load_ppo_circle(robot: Robot) -> Policy:
    """Loads ``ppo-circle`` for a nominal robot.

    Raises:
        ValueError: if the weights are missing or damaged, or the robot's observation differs from
            the one that the policy was trained on.
    """
    # Imported here: listing policies does not need them.
    from cablebot_baselines.learned.bundle import Bundle
    from cablebot_baselines.learned.policy import LearnedPolicy

    return LearnedPolicy(Bundle.load(BUNDLE), robot)


PPO_CIRCLE = PolicyEntry(factory=load_ppo_circle, files=(BUNDLE,), **DATA["ppo-circle"])
