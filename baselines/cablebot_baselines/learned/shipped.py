"""The shipped learned policies. This module does not need torch."""

from __future__ import annotations

from pathlib import Path

from cablebot_baselines.entries import DATA
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.policies import Policy, PolicyEntry
from cablebot_gym.robots import Robot

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of ``plan-ID.zip``, the networks that plan, ``ppo-circle-spatial.zip``, the bundle,
``ppo-circle-spatial.json``, the record of its training, and ``ppo-circle-spatial-sb3.zip``, the actor
as a model of Stable-Baselines3."""

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


def plan_weights(robot: Robot) -> Path:
    """File of the shipped network that plans for robots of this kind.

    Raises:
        ValueError: if there is none.
    """
    env_id = fitting_env_id(robot)
    path = WEIGHTS / f"plan-{env_id}.zip"
    if not path.is_file():
        raise ValueError(
            f"there is no network for robot {robot.name!r}: cablebot train-plan {env_id} trains one"
        )
    return path


def load_learned_plan(robot: Robot) -> Policy:
    """Loads ``learned-plan`` for a nominal robot.

    Raises:
        ImportError: if torch is missing; the message names the command that installs it.
        ValueError: if no network is shipped for the robot.
    """
    from cablebot_baselines.learned.learned_plan import learned_plan

    return learned_plan(robot, plan_weights(robot))


def load_refined_plan(robot: Robot) -> Policy:
    """Loads ``refined-plan``, as :func:`load_learned_plan`."""
    from cablebot_baselines.learned.learned_plan import refined_plan

    return refined_plan(robot, plan_weights(robot))


NETWORKS = tuple(sorted(WEIGHTS.glob("plan-*.zip")))
"""Files of the networks that plan."""

LEARNED_PLAN = PolicyEntry(factory=load_learned_plan, files=NETWORKS, **DATA["learned-plan"])
REFINED_PLAN = PolicyEntry(factory=load_refined_plan, files=NETWORKS, **DATA["refined-plan"])
