"""Learned policies: training (needs torch) and evaluation (does not need torch)."""

from __future__ import annotations

import zipfile
from pathlib import Path

from cablebot_gym.policies import Policy
from cablebot_gym.robots import Robot


def load_bundle(path: str | Path, robot: Robot) -> Policy | None:
    """Loads a policy from a bundle for a nominal robot; returns None if the file is not a bundle.

    Raises:
        ValueError: if the bundle is damaged, or its policy was trained on an observation other than
            the robot's.
    """
    # Imported here: training does not need them.
    from cablebot_baselines.learned.bundle import Bundle, is_bundle
    from cablebot_baselines.learned.policy import LearnedPolicy

    if not is_bundle(path):
        return None
    return LearnedPolicy(Bundle.load(path), robot)


def load_plan(path: str | Path, robot: Robot) -> Policy | None:
    """Loads a policy from the network of a ``train-plan`` run for a nominal robot; returns None if the
    file has no tensors of torch.

    Raises:
        ImportError: if torch is missing; the message names the command that installs it.
        ValueError: if the file cannot be read.
    """
    with zipfile.ZipFile(path) as archive:
        if not any(name.endswith("/data.pkl") for name in archive.namelist()):
            return None
    from cablebot_baselines.learned.learned_plan import learned_plan

    return learned_plan(robot, Path(path))
