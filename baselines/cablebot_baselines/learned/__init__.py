"""Learned policies: what trains them, and what runs them without torch."""

from __future__ import annotations

from pathlib import Path

from cablebot_gym.policies import Policy
from cablebot_gym.robots import Robot


def load_bundle(path: Path, robot: Robot) -> Policy | None:
    """The policy in a bundle, for a nominal robot; None if the file is no bundle.

    Raises:
        ValueError: if the bundle is damaged, or its policy was trained on another observation than the robot's.
    """
    from cablebot_baselines.learned.bundle import Bundle, is_bundle  # not at import: what trains does not need them
    from cablebot_baselines.learned.policy import LearnedPolicy

    return LearnedPolicy(Bundle.load(path), robot) if is_bundle(path) else None
