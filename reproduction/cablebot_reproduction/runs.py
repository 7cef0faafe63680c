"""Computations that several parts share: module-level functions whose arguments can be pickled.

The motion is the paper's circle as printed, without dwells, unless ``trajectory`` is given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cablebot_gym.evaluation import Comparison, DLCCResult, compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.robots import Robot
from cablebot_reproduction.exact import paper_circle

Law = Callable[[Robot], Any]
"""Builds a policy for a robot: a class of :mod:`cablebot_baselines.classical`, or a partial of such
a class."""

CONTROL_FREQUENCY = 500.0
"""Number of control instants per second [Hz]."""

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
FLEX = "CableBot-FlexSpatial-v0"


def largest_payload(
    *, env_id: str, law: Law, robot: Robot, name: str, **keywords: Any
) -> DLCCResult:
    """:func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc` of a law that is built for the
    controlled robot."""
    keywords.setdefault("trajectory", paper_circle(robot))
    return evaluate_dlcc(law(robot), env_id, robot=robot, name=name, **keywords)


def closed_loop(
    *, env_id: str, law: Law, robot: Robot, payload: float = 0.0, **keywords: Any
) -> Rollout:
    """One episode of a law that is built for the controlled robot."""
    keywords.setdefault("trajectory", paper_circle(robot))
    return record_rollout(law(robot), env_id, payload=payload, robot=robot, **keywords)


def compared(
    *, env_id: str, laws: tuple[tuple[str, Law], ...], robot: Robot, **keywords: Any
) -> Comparison:
    """:func:`~cablebot_gym.evaluation.compare_policies` of named laws that are built for the
    controlled robot."""
    keywords.setdefault("trajectory", paper_circle(robot))
    names = [name for name, _ in laws]
    policies = [law(robot) for _, law in laws]
    return compare_policies(policies, env_id, names=names, robot=robot, **keywords)
