"""Files of trained policies as policies."""

from __future__ import annotations

import zipfile
from pathlib import Path

from cablebot_gym.policies import Policy
from cablebot_gym.robots import Robot


def load_network(path: str | Path, robot: Robot) -> Policy | None:
    """Loads the policy of a ``train`` or ``train-plan`` run for a nominal robot; returns None if the
    file has none.

    Raises:
        ImportError: if torch is missing, which plans need; the message names the command that
            installs it.
        ValueError: if the file cannot be read, or the policy does not fit the robot.
    """
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if "arr_0.npy" in names:
        from cablebot_baselines.learned.steered_policy import SteeredPolicy

        return SteeredPolicy(robot, path)
    if any(name.endswith("/data.pkl") for name in names):
        from cablebot_baselines.learned.learned_plan import learned_plan

        return learned_plan(robot, Path(path))
    return None
