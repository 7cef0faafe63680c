"""Simulated episodes and evaluations that several parts share; each is computed once.

A law is built for the controlled robot. The motion is the circle of the paper unless ``trajectory``
is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from cablebot_baselines.laws import Composite, PaperFlexible, RobustPD
from cablebot_baselines.laws.law import ClassicalLaw
from cablebot_baselines.laws.outer_loop import PAPER_GAINS
from cablebot_gym.evaluation import Comparison, DLCCResult, compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_reproduction.robots import paper_circle

Law = Callable[[Robot], Any]
"""Builds a policy for a robot."""

CONTROL_FREQUENCY = 500.0
"""Number of control instants per second [Hz]."""


class FeedForward(ClassicalLaw):
    """Open loop: applies the torque of exact tracking, independent of the state of the robot."""

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques of the reference motion [N·m] and current pulley speeds [rad/s]."""
        acceleration = blocks["reference_acceleration"]
        required = self._inverse_dynamics(
            mass, blocks["reference_pose"], blocks["reference_velocity"], acceleration
        )
        return required.torques, self.pulley_speed(blocks["pose"], blocks["velocity"])


def eq22(robot: Robot) -> PaperFlexible:
    """Law of the paper for joint springs, as printed."""
    return PaperFlexible(robot, as_printed=True)


def composite(robot: Robot) -> Composite:
    """Law for joint springs that replaces Eq. 22 where a stable one is needed, with the gains of
    Table 4."""
    return Composite(robot, gains=PAPER_GAINS["spatial"])


def with_robust_term(law: Any, **options: float) -> Any:
    """A law with the robust term Δv in its outer loop."""
    law.outer = RobustPD(gains=PAPER_GAINS["spatial"], **options)
    return law


def env_id(robot: Robot) -> str:
    """Id of the environment of a robot."""
    if robot.planar:
        return "CableBot-Planar-v0"
    if robot.flexible:
        return "CableBot-FlexSpatial-v0"
    return "CableBot-Spatial-v0"


@cache
def largest_payload(law: Law, robot: Robot, **conditions: Any) -> DLCCResult:
    """Result of :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""
    conditions.setdefault("trajectory", paper_circle(robot))
    return evaluate_dlcc(law(robot), env_id(robot), robot=robot, **conditions)


@cache
def episode(law: Law, robot: Robot, **conditions: Any) -> Rollout:
    """One unloaded episode."""
    conditions.setdefault("trajectory", paper_circle(robot))
    return record_rollout(law(robot), env_id(robot), robot=robot, **conditions)


def compared(laws: Mapping[str, Law], robot: Robot, **conditions: Any) -> Comparison:
    """Result of :func:`~cablebot_gym.evaluation.compare_policies` on the circle of the paper."""
    conditions["trajectory"] = paper_circle(robot)
    policies = [law(robot) for law in laws.values()]
    return compare_policies(policies, env_id(robot), names=list(laws), robot=robot, **conditions)


def peak_error_mm(loop: Rollout) -> float:
    """Largest position error of an episode [mm]."""
    return 1e3 * float(np.max(loop.arrays["tracking_error_peak"]))
