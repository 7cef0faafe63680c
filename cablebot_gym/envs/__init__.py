"""Environment ids. Importing :mod:`cablebot_gym` registers them with Gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from cablebot_gym.env_ids import ENV_ROBOTS
from cablebot_gym.utils.checks import unknown_name_error

ENV_KINDS = {
    "CableBot-Planar-v0": ("planar", False),
    "CableBot-Spatial-v0": ("spatial", False),
    "CableBot-FlexPlanar-v0": ("planar", True),
    "CableBot-FlexSpatial-v0": ("spatial", True),
    "CableBot-Point-v0": ("point", False),
    "CableBot-PlanarPlatform-v0": ("planar-platform", False),
    "CableBot-FlexPoint-v0": ("point", True),
    "CableBot-FlexPlanarPlatform-v0": ("planar-platform", True),
}
"""Kind of the robots of each environment id, and whether they are flexible."""

ENV_IDS = tuple(ENV_ROBOTS)
"""All environment ids."""

PAPER_ENV_IDS = ENV_IDS[:4]
"""Ids of the environments with the paper's robots, for which the leaderboard has results."""

TERMINATION_REASONS = ("", "tracking_error", "slack", "workspace", "non_finite", "violation")
"""Name of each code in ``info["termination_reason"]``. Code 0, the empty string, means "not
terminated"."""


def register_envs() -> None:
    """Registers every id with Gymnasium. A second call has no effect.

    The specs have no time limit: the environments truncate an episode when its motion is complete.
    """
    for env_id, robot in ENV_ROBOTS.items():
        if env_id not in gym.registry:
            gym.register(
                id=env_id,
                entry_point="cablebot_gym.envs.single:CableBotEnv",
                vector_entry_point="cablebot_gym.envs.vector:CableBotVectorEnv",
                kwargs={"robot": robot},
            )


def env_robot(env_id: str) -> str:
    """Name of the robot of an environment id.

    Raises:
        ValueError: if the id is unknown; the message lists the known ids.
    """
    if env_id not in ENV_ROBOTS:
        raise unknown_name_error("environment", env_id, ENV_IDS)
    return ENV_ROBOTS[env_id]


def described(env_id: str, robot_name: str) -> str:
    """Title text of an environment: its id, followed by ``robot_name`` if this is not the default
    robot of the id."""
    return env_id if ENV_ROBOTS.get(env_id) == robot_name else f"{env_id} with robot {robot_name!r}"


def fitting_env_id(robot: Any) -> str:
    """The id of the environments of a robot's kind.

    Raises:
        ValueError: if the robot is invalid, or there is no id for its kind.
    """
    # imported here: importing cablebot_gym must stay fast
    from cablebot_gym.robots import KIND_TEXTS, find_robot

    given = find_robot(robot)
    for env_id, kind in ENV_KINDS.items():
        if kind == (given.kind, given.flexible):
            return env_id
    raise ValueError(
        f"robot {given.name!r} is {KIND_TEXTS[given.kind]} with a {given.joints} transmission, which has no "
        "environment: use robot.with_rigid_cables()"
    )


def check_robot(env_id: str, robot: Any) -> None:
    """Checks that an environment id exists and that a robot is of the kind of the id.

    Kinds are those of :attr:`~cablebot_gym.robots.record.Robot.kind`, rigid or flexible.

    Raises:
        ValueError: if the id is unknown or the robot does not fit. The message lists the valid ids,
            or gives the id that fits the robot.
    """
    env_robot(env_id)
    if robot is not None and (fitting := fitting_env_id(robot)) != env_id:
        from cablebot_gym.robots import find_robot

        raise ValueError(f"robot {find_robot(robot).name!r} does not fit {env_id}: use {fitting}")


class SpecChecked:
    """Part of both environments. ``gym.make`` sets ``spec``, which checks that the robot is of the
    kind of the id, and warns if its motors cannot hold the start."""

    settings: Any
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Specification from which Gymnasium made the environment; None if it was made directly.

        Raises:
            ValueError: when it is set, if the robot does not fit; the message gives the id that
                fits it.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None and spec.id in ENV_ROBOTS:
            check_robot(spec.id, self.settings.robot)
            self.settings.note_unheld_start()
        self._spec = spec
