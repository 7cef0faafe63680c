"""The shipped policies with networks that plan. This module does not need torch."""

from __future__ import annotations

from cablebot_baselines.entries import DATA
from cablebot_baselines.learned.shipped import WEIGHTS, weights_of
from cablebot_baselines.planners.trajopt import TrajOpt
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot


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


NETWORKS = tuple(sorted(WEIGHTS.glob("plan-*.zip")))

LEARNED_PLAN = PolicyEntry(factory=load_learned_plan, files=NETWORKS, **DATA["learned-plan"])
REFINED_PLAN = PolicyEntry(factory=load_refined_plan, files=NETWORKS, **DATA["refined-plan"])
"""The entries of the policies."""
