"""Adaptive control law: it estimates the payload during the motion and allocates saturated torques
jointly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablebot_baselines.entries import entry
from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.allocation import allocate
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import make_composite
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.outer_loop import by_kind
from cablebot_gym.kinematics import cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.robots import GRAVITY, Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number

ADAPTIVE_GAINS = {"planar": (2000.0, 90.0), "spatial": (400.0, 40.0)}
"""(K_P, K_D) of ``adaptive`` [1/s², 1/s], critically damped.

Higher gains do not increase the DLCC and amplify sensor noise.
"""

MINIMUM_MASS_RATIO = 0.5
"""Lower bound of the mass estimate as a fraction of the nominal platform mass. It keeps noisy
estimates positive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorState:
    """State of the payload estimator between two control steps; each array has shape (...,
    size)."""

    pose: Array
    """X [m, rad]."""
    velocity: Array
    """Ẋ [m/s, rad/s]."""
    pulley_speed: Array
    """β̇ [rad/s]."""
    torques: Array
    """Rigid robot: requested motor torques. Flexible robot: spring torques κ [N·m]."""
    time_to_go: Array
    """Observed time to go [s]."""
    weighted_impulse: Array
    """Σ w·f, where f is the impulse of the cable forces [N·s · m/s²], (..., 1)."""
    weighted_change: Array
    """Σ w·y, where y = Δṗ − g h is the impulse per unit mass [m/s · m/s²], (..., 1)."""


class Adaptive(ClassicalLaw):
    """A control law that uses an estimate of the mass of platform and payload (certainty
    equivalence).

    The estimator works with a known and with an unknown payload. Over a control period of length h
    the momentum balance is m y = f with y = Δṗ − g h and f = −∫ (SᵀT)_p dt, where ∫ r T dt = ∫ (κ −
    c β̇) dt − J Δβ̇. κ is the motor torque, saturated as in the plant, or the spring torque of a
    flexible robot.

    The estimate is m̂ = (λ m_model + Σ w·f)/(λ + Σ w·y). The weight w = p̈_d − g [m/s²] comes from
    the reference and not from y. Measurement noise of y therefore causes no bias and mostly cancels
    between consecutive periods. The estimator differentiates no signal.

    The estimate counts effects outside the balance as mass. A downward force and a delay of the
    actions increase it; motors that are stronger than in the model decrease it.

    Args:
        law: control law without memory. It computes the torques for the estimated mass.
        estimator_prior_weight: estimation time after which the estimate and the model mass have
            equal weight [s]; > 0.
        allocation: whether saturated actions are replaced by the actions within ±1 that come
            closest to the requested acceleration. This needs as many cables as coordinates. The law
            then saturates its actions itself, and the paper criterion does not apply.

    Raises:
        ValueError: if ``estimator_prior_weight`` is not positive.
    """

    def __init__(
        self, law: ClassicalLaw, *, estimator_prior_weight: float = 0.01, allocation: bool = True
    ) -> None:
        super().__init__(law.robot, minimum_tension=law.minimum_tension)
        weight = number("estimator_prior_weight", estimator_prior_weight, above=0.0, unit="s")
        self.law = law
        self._prior_weight = weight * GRAVITY**2
        self._allocates = allocation and law.robot.cables == law.robot.coordinates
        self.unsaturated_actions = law.unsaturated_actions and not self._allocates

    def reset(self, tasks: Sequence[Task]) -> None:
        """Passes the tasks to the inner law.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        self.law.reset(tasks)

    def mass(self, memory: EstimatorState, model_mass: Array) -> Array:
        """Estimated mass m̂ of platform and payload [kg], (...), for a model mass (...)."""
        numerator = self._prior_weight * model_mass + memory.weighted_impulse[..., 0]
        denominator = self._prior_weight + memory.weighted_change[..., 0]
        is_positive = denominator > 0
        estimate = numerator / np.where(is_positive, denominator, 1.0)
        estimate = np.where(is_positive, estimate, model_mass)
        return np.maximum(estimate, MINIMUM_MASS_RATIO * self.robot.mass)

    def _control(
        self, blocks: dict[str, Array], mass: Array, state: Any, episode_start: Any
    ) -> tuple[Array, Array, Any]:
        memory = self._updated_state(blocks, state, episode_start)
        # np.maximum returns a scalar for a single observation; the masks below need an array.
        estimate = np.asarray(self.mass(memory, mass))
        torques, speeds = self.law.torques(blocks, estimate)
        action = textbook.normalised_action(self.robot, torques, speeds)
        saturated = np.any(np.abs(action) > 1, axis=-1)
        if self._allocates and np.any(saturated):
            robot = self.robot
            pose = blocks["pose"][saturated]
            torque_slope = self.law.torque_slope(estimate[saturated], pose)
            action_slope = torque_slope / robot.stall_torque[:, None]
            action[saturated] = allocate(action[saturated], action_slope)
            torques = robot.stall_torque * action - robot.speed_slope * speeds
        if not self.robot.flexible:
            memory = replace(memory, torques=torques)
        return torques, speeds, memory

    def _updated_state(
        self, blocks: dict[str, Array], before: EstimatorState | None, episode_start: Any
    ) -> EstimatorState:
        """Estimator state after the control period that has just ended."""
        now = self._measured_state(blocks)
        if before is None:
            return now
        reference = blocks["reference_acceleration"][..., : self.robot.dimensions]
        weight = reference - self.robot.gravity_vector
        impulse, change = self._weighted_balance(before, now, weight)
        # The time to go stays constant after the end of the reference. The estimate is then frozen.
        is_running = now.time_to_go < before.time_to_go
        impulse = before.weighted_impulse + np.where(is_running, impulse, 0.0)
        change = before.weighted_change + np.where(is_running, change, 0.0)
        shape = now.pose.shape[:-1]
        starts = first_steps(before, episode_start, shape)[..., None]
        return replace(
            now,
            weighted_impulse=np.where(starts, 0.0, impulse),
            weighted_change=np.where(starts, 0.0, change),
        )

    def _measured_state(self, blocks: dict[str, Array]) -> EstimatorState:
        """Estimator state without past. The torques of a rigid robot are zero until the law has
        computed them."""
        robot = self.robot
        pose = blocks["pose"]
        velocity = blocks["velocity"]
        time_to_go = blocks["time_to_go"]
        pulley_speed = self.pulley_speed(pose, velocity)
        torques = np.zeros_like(pulley_speed)
        if robot.flexible:
            deflection = blocks["motor_angle"] - textbook.pulley_angle(robot, pose)
            stretch = np.maximum(deflection, 0.0)
            stiffness = textbook.joint_stiffness(robot, pose)
            torques = textbook.stretched_torque(robot, stiffness * stretch)
        zero = np.zeros_like(time_to_go)
        return EstimatorState(
            pose=pose.copy(),
            velocity=velocity.copy(),
            pulley_speed=pulley_speed,
            torques=torques,
            time_to_go=time_to_go.copy(),
            weighted_impulse=zero,
            weighted_change=zero,
        )

    def _weighted_balance(
        self, before: EstimatorState, now: EstimatorState, weight: Array
    ) -> tuple[Array, Array]:
        """w·f and w·y of the control period between two states, each (..., 1)."""
        robot = self.model
        period = before.time_to_go - now.time_to_go
        speed_change = now.pulley_speed - before.pulley_speed
        torque_impulse = period * self._mean_torque(before, now)
        # r ∫ T dt of each cable
        angular_impulse = torque_impulse - robot.pulley_inertia * speed_change
        mean_speed = (before.pulley_speed + now.pulley_speed) / 2
        tension_impulse = angular_impulse / textbook.loaded_radius(robot, mean_speed)
        middle = (before.pose + now.pose) / 2
        if robot.swivel is None:
            # The rows of S for the position are the unit vectors of the cables.
            directions = cable_vectors(robot.base, robot.platform, middle)
            scale = tension_impulse / np.linalg.norm(directions, axis=-1)
        else:
            directions = textbook.jacobian(robot, middle)[..., : robot.dimensions]
            scale = tension_impulse
        impulse = -np.sum(scale[..., None] * directions, axis=-2)
        start_velocity = self._mass_center_velocity(before)
        end_velocity = self._mass_center_velocity(now)
        change = end_velocity - start_velocity - robot.gravity_vector * period
        weighted_impulse = np.sum(weight * impulse, axis=-1, keepdims=True)
        weighted_change = np.sum(weight * change, axis=-1, keepdims=True)
        return weighted_impulse, weighted_change

    def _mean_torque(self, before: EstimatorState, now: EstimatorState) -> Array:
        """Mean of κ − c β̇ minus Coulomb friction over the control period between two states
        [N·m], (..., m)."""
        robot = self.model
        start_torque, end_torque = before.torques, now.torques
        friction = robot.damping * (before.pulley_speed + now.pulley_speed)
        if not robot.flexible:
            # The requested torque is constant over the period, but saturates at the motor speed.
            start_limits = textbook.torque_limits(robot, before.pulley_speed)
            end_limits = textbook.torque_limits(robot, now.pulley_speed)
            start_torque = np.clip(before.torques, *start_limits)
            end_torque = np.clip(before.torques, *end_limits)
            # Coulomb friction of a flexible robot acts on the motors.
            start_coulomb = textbook.coulomb_torque(robot, before.pulley_speed)
            end_coulomb = textbook.coulomb_torque(robot, now.pulley_speed)
            friction += start_coulomb + end_coulomb
        return (start_torque + end_torque - friction) / 2

    def _mass_center_velocity(self, state: EstimatorState) -> Array:
        """Velocity of the centre of mass [m/s], (..., d)."""
        d = self.robot.dimensions
        if not np.any(self.robot.mass_center):
            return state.velocity[..., :d]
        mass_matrix = textbook.mass_matrix(self.robot, 1.0, state.pose)
        momentum = textbook.times_vector(mass_matrix, state.velocity)
        return momentum[..., :d]


def make_adaptive(
    robot: Robot, *, estimator_prior_weight: float = 0.01, allocation: bool = True
) -> Adaptive:
    """The adaptive law around feedback linearization or, for a robot with joint springs or elastic
    cables, around the composite law; the arguments are those of :class:`Adaptive`."""
    law: ClassicalLaw
    if robot.flexible:
        law = make_composite(robot)
    else:
        law = FeedbackLinearization(robot, gains=by_kind(ADAPTIVE_GAINS, robot))
    return Adaptive(law, estimator_prior_weight=estimator_prior_weight, allocation=allocation)


ADAPTIVE = entry("adaptive", make_adaptive)
