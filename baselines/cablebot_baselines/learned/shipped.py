"""The shipped learned policies. This module does not need torch."""

from __future__ import annotations

from pathlib import Path

from cablebot_baselines.entries import DATA
from cablebot_baselines.learned.steered_policy import SteeredPolicy
from cablebot_baselines.planners.trajopt import TrajOpt
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.policies import PolicyEntry
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


def load_ppo(robot: Robot) -> SteeredPolicy:
    """Loads ``ppo`` for a nominal robot.

    Raises:
        ValueError: if no network is shipped for the robot.
    """
    return SteeredPolicy(robot, weights_of(robot, "ppo"))


def load_learned_plan(robot: Robot) -> TrajOpt:
    """Loads ``learned-plan`` for a nominal robot.

    Raises:
        ImportError: if torch is missing; the message names the command that installs it.
        ValueError: if no network is shipped for the robot.
    """
    path = weights_of(robot, "plan")
    from cablebot_baselines.learned.learned_plan import learned_plan

    return learned_plan(robot, path)


def load_refined_plan(robot: Robot) -> TrajOpt:
    """Loads ``refined-plan``, as :func:`load_learned_plan`."""
    path = weights_of(robot, "plan")
    from cablebot_baselines.learned.learned_plan import refined_plan

    return refined_plan(robot, path)


ACTORS = tuple(sorted(WEIGHTS.glob("ppo-*.zip")))
NETWORKS = tuple(sorted(WEIGHTS.glob("plan-*.zip")))
"""Files of the actors, and of the networks that plan."""

PPO = PolicyEntry(factory=load_ppo, files=ACTORS, **DATA["ppo"])
LEARNED_PLAN = PolicyEntry(factory=load_learned_plan, files=NETWORKS, **DATA["learned-plan"])
REFINED_PLAN = PolicyEntry(factory=load_refined_plan, files=NETWORKS, **DATA["refined-plan"])
"""The entries of the policies."""
