"""Computations that several parts share: module-level functions whose arguments can be pickled.

The motion is the paper's circle as printed, without dwells, unless ``trajectory`` is given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cablebot_baselines.paper.exact import paper_circle
from cablebot_gym.evaluation import Comparison, DLCCResult, compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.robots import Robot

Law = Callable[[Robot], Any]
"""Builds a policy for a robot: a class of :mod:`cablebot_baselines.classical`, or a partial of such a class."""

PLANAR, SPATIAL, FLEX = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"


def largest_payload(*, env_id: str, law: Law, robot: Robot, name: str, **keywords: Any) -> DLCCResult:
    """:func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc` of a law that is built for the controlled robot."""
    return evaluate_dlcc(law(robot), env_id, robot=robot, name=name, **_with_motion(robot, keywords))


def closed_loop(*, env_id: str, law: Law, robot: Robot, payload: float = 0.0, **keywords: Any) -> Rollout:
    """One episode of a law that is built for the controlled robot."""
    return record_rollout(law(robot), env_id, payload=payload, robot=robot, **_with_motion(robot, keywords))


def compared(*, env_id: str, laws: tuple[tuple[str, Law], ...], robot: Robot, **keywords: Any) -> Comparison:
    """:func:`~cablebot_gym.evaluation.compare_policies` of named laws that are built for the controlled robot."""
    names, policies = [name for name, _ in laws], [law(robot) for _, law in laws]
    return compare_policies(policies, env_id, names=names, robot=robot, **_with_motion(robot, keywords))


def _with_motion(robot: Robot, keywords: dict[str, Any]) -> dict[str, Any]:
    return {"trajectory": paper_circle(robot)} | keywords
