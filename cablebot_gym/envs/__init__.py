"""The Gymnasium face of the plants: ids, registered when :mod:`cablebot_gym` is imported."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from cablebot_gym.utils.suggestions import no_such

ENV_ROBOTS = {
    "CableBot-Planar-v0": "planar",
    "CableBot-Spatial-v0": "spatial",
    "CableBot-FlexPlanar-v0": "flex-planar",
    "CableBot-FlexSpatial-v0": "flex-spatial",
}
"""Robot of each id."""

ENV_IDS = tuple(ENV_ROBOTS)
"""Every id."""

FLEXIBLE_ENV_IDS = tuple(env_id for env_id in ENV_IDS if "-Flex" in env_id)
"""Ids of robots with joint springs."""

RIGID_ENV_IDS = tuple(env_id for env_id in ENV_IDS if env_id not in FLEXIBLE_ENV_IDS)
"""Ids of robots without."""

MAX_EPISODE_STEPS = 500
"""Time limit in the specs: 1 s at the default control frequency."""


def register_envs() -> None:
    """Registers every id with Gymnasium; a second call changes nothing."""
    for env_id, robot in ENV_ROBOTS.items():
        if env_id not in gym.registry:
            gym.register(
                id=env_id,
                entry_point="cablebot_gym.envs.single:CableBotEnv",
                vector_entry_point="cablebot_gym.envs.vector:CableBotVectorEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs={"robot": robot},
            )


def env_robot(env_id: str) -> str:
    """The robot's name of an id.

    Raises:
        ValueError: if the id is unknown, naming the known ones.
    """
    if env_id not in ENV_ROBOTS:
        raise ValueError(no_such("environment", env_id, ENV_IDS))
    return ENV_ROBOTS[env_id]


def described(env_id: str, robot_name: str) -> str:
    """An id for titles, with ``robot_name`` where it is not the id's own."""
    return env_id if ENV_ROBOTS.get(env_id) == robot_name else f"{env_id} with robot {robot_name!r}"


def check_robot(env_id: str, robot: Any) -> None:
    """Refuses an unknown id, and a robot of another kind than the id's.

    Raises:
        ValueError: naming the valid ids, or the id that fits the robot.
    """
    usual = env_robot(env_id)
    if robot is None:
        return
    from cablebot_gym.robots import find_robot  # not at import: making an id has to stay light

    own, wanted = find_robot(robot), find_robot(usual)
    if not _same_kind(own, wanted):
        fits = next(i for i, name in ENV_ROBOTS.items() if _same_kind(own, find_robot(name)))
        raise ValueError(f"robot {own.name!r} does not fit {env_id}: use {fits}")


def check_spec(spec: EnvSpec | None, robot: Any) -> None:
    """Refuses a robot of another kind than that of the id by which Gymnasium made an environment.

    Raises:
        ValueError: naming the id that fits the robot.
    """
    if spec is not None and spec.id in ENV_ROBOTS:
        check_robot(spec.id, robot)


def _same_kind(one: Any, other: Any) -> bool:
    return bool((one.planar, one.flexible) == (other.planar, other.flexible))
