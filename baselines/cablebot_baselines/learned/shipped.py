"""The shipped learned policies. This module does not need torch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cablebot_baselines.entries import DATA
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.policies import Policy, PolicyEntry
from cablebot_gym.robots import Robot

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the shipped files: the bundles ``NAME-KIND.zip`` and their cards ``NAME-KIND.json``;
see :func:`stem`."""


@dataclass(frozen=True, kw_only=True)
class Shipped(PolicyEntry):
    """A shipped learned policy and its training."""

    algorithm: str
    """Name for ``cablebot train --algo``."""


def stem(name: str, env_id: str) -> str:
    """Name of a policy's files without their suffix, such as ``planner-planar``."""
    return f"{name}-{short_id(env_id).lower()}"


def weights_file(name: str, env_id: str) -> Path:
    """Path of a policy's bundle."""
    return WEIGHTS / f"{stem(name, env_id)}.zip"


def short_id(env_id: str) -> str:
    """An environment's id without the common prefix and suffix."""
    return env_id.removeprefix("CableBot-").removesuffix("-v0")


def load_shipped(name: str, robot: Robot) -> Policy:
    """Loads a shipped policy for a nominal robot; the robot's kind selects the weights.

    Args:
        name: name in :data:`SHIPPED`.
        robot: nominal robot.

    Raises:
        ValueError: if the weights for this kind of robot are missing or damaged, or the robot's
            observation differs from the one that the policy was trained on.
    """
    # Imported here: listing policies does not need them.
    from cablebot_baselines.learned.bundle import Bundle
    from cablebot_baselines.learned.policy import make_policy

    return make_policy(Bundle.load(weights_file(name, fitting_env_id(robot))), robot)


def _shipped(name: str) -> Shipped:
    files = [weights_file(name, env_id) for env_id in DATA[name]["env_ids"]]
    return Shipped(
        factory=partial(load_shipped, name),
        files=tuple(file for file in files if file.is_file()),
        **DATA[name],
    )


PPO_CIRCLE = _shipped("ppo-circle")
PLANNER = _shipped("planner")

SHIPPED = {entry.name: entry for entry in (PPO_CIRCLE, PLANNER)}
"""Shipped policies by name."""
