"""A law that weighs the payload while it moves, and does not let motors clip each on its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablebot_baselines.classical.allocation import attainable
from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flexible import composite_tuned
from cablebot_baselines.classical.law import Array, ClassicalLaw, first_steps
from cablebot_gym.envs import FLEXIBLE_ENV_IDS, RIGID_ENV_IDS
from cablebot_gym.kinematics import cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import STANDARD_GRAVITY, Robot
from cablebot_gym.task import Task

ADAPTIVE_GAINS = {"planar": (2000.0, 90.0), "spatial": (400.0, 40.0)}
"""(K_P, K_D) of ``adaptive`` [1/s², 1/s], critically damped; stiffer ones carry no more and pass on more noise."""

LIGHTEST = 0.5
"""Least estimate of platform and payload, relative to the nominal platform: noise must not make it negative."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """What one control instant leaves for the next; each array is (..., size)."""

    pose: Array
    """X [m, rad]."""
    velocity: Array
    """Ẋ."""
    pulley: Array
    """β̇ [rad/s]."""
    torques: Array
    """Rigid: asked of the motors. Flexible: κ of the springs [N·m]."""
    time_left: Array
    """The observation's clock [s]."""
    impulse: Array
    """Σ w·f, f the impulse of the cables [N·s · m/s²], (..., 1)."""
    change: Array
    """Σ w·y, y = Δṗ − g h what a kilogram of it changed [m/s · m/s²], (..., 1)."""


class Adaptive(ClassicalLaw):
    """Runs a law on an estimate of the mass of platform and payload, told or not (certainty equivalence).

    Over a control period of length h momentum balances as m y = f, with y = Δṗ − g h and f = −∫ (SᵀT)_p dt, where
    ∫ r T dt = ∫ (κ − c β̇) dt − J Δβ̇ and κ the motors' torques, clipped as the plant clips them, or the springs'.
    The estimate m̂ = (λ m_told + Σ w·f)/(λ + Σ w·y) weighs the periods by the reference's w = p̈_d − g [m/s²], not by
    y itself: y's noise then has no bias and mostly cancels from one period to the next. Nothing is differentiated.
    What the balance does not know is taken for mass: 5 N downward for 0.3 kg, motors a tenth stronger than told for
    −1.2 kg of 13, a delay of three control steps for 0.3 kg.

    Args:
        law: without memory; asked for torques with the estimated mass.
        prior: for how long the platform has to be weighed until the estimate counts as much as the told mass [s]; > 0.
        allocation: the commands within ±1 that come closest to the acceleration that the law asks for, in place of
            commands beyond ±1, where the robot has as many cables as coordinates. Commands are then clipped by the
            law, and the paper's criterion says nothing.

    Raises:
        ValueError: if ``prior`` is not positive.
    """

    def __init__(self, law: ClassicalLaw, *, prior: float = 0.01, allocation: bool = True) -> None:
        if not 0 < prior < math.inf:
            raise ValueError(f"prior must be a time greater than 0 s, not {prior}")
        super().__init__(law.robot, minimum_tension=law.minimum_tension)
        self.law, self._told_weight = law, prior * STANDARD_GRAVITY**2
        self._allocates = allocation and law.robot.cables == law.robot.coordinates
        self.unclipped = law.unclipped and not self._allocates

    def begin(self, tasks: Sequence[Task]) -> None:
        """Tells the law within of the episodes; it refuses those of another robot."""
        self.law.begin(tasks)

    def mass(self, memory: Memory, told: Array) -> Array:
        """m̂, platform and payload [kg], (...), for a told mass (...)."""
        change = self._told_weight + memory.change[..., 0]
        estimate = (self._told_weight * told + memory.impulse[..., 0]) / np.where(change > 0, change, 1.0)
        return np.maximum(np.where(change > 0, estimate, told), LIGHTEST * self.robot.mass)

    def _control(self, part: dict[str, Array], mass: Array, state: Any, episode_start: Any) -> tuple[Array, Array, Any]:
        robot = self.robot
        memory = self._weighed(part, state, episode_start)
        estimate = np.asarray(self.mass(memory, mass))  # one observation's is indexed as a batch's
        torques, speeds = self.law.torques(part, estimate)
        command = self._command(torques, speeds)
        hard = np.any(np.abs(command) > 1, axis=-1)
        if self._allocates and np.any(hard):
            slope = self.law.torque_slope(estimate[hard], part["pose"][hard]) / robot.stall_torque[:, None]
            command[hard] = attainable(command[hard], slope)
            torques = robot.stall_torque * command - robot.speed_slope * speeds
        return torques, speeds, memory if robot.flexible else replace(memory, torques=torques)

    def _weighed(self, part: dict[str, Array], before: Memory | None, episode_start: Any) -> Memory:
        """The memory after the control period that has just ended."""
        robot, pose, velocity = self.robot, part["pose"], part["velocity"]
        weight = part["reference_acceleration"][..., :3].copy()
        if not robot.planar:
            weight[..., 2] -= robot.gravity
        pulley = self.pulley_speed(pose, velocity)
        torques, nothing = np.zeros_like(pulley), np.zeros_like(part["time_left"])
        if robot.flexible:
            torques = robot.stiffness * np.maximum(part["motor_angle"] - textbook.pulley_angle(robot, pose), 0.0)
        now = Memory(
            pose=pose.copy(),
            velocity=velocity.copy(),
            pulley=pulley,
            torques=torques,
            time_left=part["time_left"].copy(),
            impulse=nothing,
            change=nothing,
        )
        if before is None:
            return now
        first = first_steps(before, episode_start, pose.shape[:-1])[..., None]
        impulse, change = self._period(before, now, weight)
        # The clock stands still once the reference has ended: the estimate stays what it was.
        runs = now.time_left < before.time_left
        return replace(
            now,
            impulse=np.where(first, 0.0, before.impulse + np.where(runs, impulse, 0.0)),
            change=np.where(first, 0.0, before.change + np.where(runs, change, 0.0)),
        )

    def _period(self, before: Memory, now: Memory, weight: Array) -> tuple[Array, Array]:
        """w·f and w·y of the control period between two memories, each (..., 1)."""
        robot, h = self.robot, before.time_left - now.time_left
        first, last = before.torques, now.torques
        if not robot.flexible:  # held by the drive, clipped by the motor at its speed
            first, last = (np.clip(before.torques, *textbook.torque_limits(robot, m.pulley)) for m in (before, now))
        mean = (first + last - robot.damping * (before.pulley + now.pulley)) / 2
        pulled = h * mean - robot.pulley_inertia * (now.pulley - before.pulley)
        cables = cable_vectors(robot.base, robot.platform, (before.pose + now.pose) / 2)
        along = pulled / robot.pulley_radius / np.linalg.norm(cables, axis=-1)
        force = -np.sum(along[..., None] * cables, axis=-2)
        change = (now.velocity - before.velocity)[..., :3]
        if not robot.planar:
            change[..., 2] -= robot.gravity * h[..., 0]
        along_force, along_change = (np.sum(weight * value, axis=-1, keepdims=True) for value in (force, change))
        return along_force, along_change


def _adaptive(robot: Robot) -> Adaptive:
    return Adaptive(FeedbackLinearization(robot, gains=ADAPTIVE_GAINS["planar" if robot.planar else "spatial"]))


def _adaptive_composite(robot: Robot) -> Adaptive:
    return Adaptive(composite_tuned(robot))


ADAPTIVE = PolicyEntry(
    name="adaptive",
    kind="classical",
    env_ids=RIGID_ENV_IDS,
    factory=_adaptive,
    summary="feedback linearization that weighs its payload and shares out what the motors can give",
)

ADAPTIVE_COMPOSITE = PolicyEntry(
    name="adaptive-composite",
    kind="classical",
    env_ids=FLEXIBLE_ENV_IDS,
    factory=_adaptive_composite,
    summary="composite-tuned that weighs its payload and shares out what the motors can give",
)
