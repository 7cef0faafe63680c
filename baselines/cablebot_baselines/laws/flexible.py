"""Control laws for robots with joint springs or elastic cables, which the paper's own law (Eq. 22)
does not stabilise.

All laws use the nominal parameters and the model payload. They read the motor angles β′ and the
motor speeds β̇′. They do not saturate their actions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cablebot_baselines.entries import entry
from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.outer_loop import (
    PD,
    Gains,
    OuterLoop,
    checked_gains,
)
from cablebot_gym.motions import Reference
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, Robot
from cablebot_gym.task import Task

DIFFERENCE_PERIODS = 2
"""Control periods on each side of the central differences for κ̇ and κ̈ along a motion. The torque is
constant over a period: shorter differences would hold for all of it what a kink of the tensions, at a
change of the least one, demands for an instant."""

FADE_TIME = 0.5
"""Time constant with which :class:`MotorPD` leaves the tensions at the start of an episode for its own
[s].

Faster, a cable of ``flex-gch-klaus`` swings below its minimum tension.
"""

MOTOR_FREQUENCY = 200.0
"""ω of the motor loop of :class:`MotorPD` [rad/s]: K_P = J′ω², K_D = 2 ζ J′ ω."""

MOTOR_DAMPING_RATIO = 0.7
"""ζ of that loop."""

FLEXIBLE_MINIMUM_TENSION = 14.0
"""Least tension that the laws allocate on a planar robot with joint springs [N].

A jump of the reference acceleration lets the tensions swing far below the allocated ones. This is
the smallest value for which no tension limits the DLCC of ``motor-pd`` and ``composite`` on the
paper's circle between dwells. It costs a law that the tensions do not limit only a few per cent of
the DLCC.
"""


class JointMotion(Reference):
    """Pose and its first four time derivatives at one instant; each array is (..., n)."""

    def after(self, time: float | Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration after ``time`` [s], by Taylor series.

        Times have the shape of the arrays, or one that broadcasts with them.
        """
        x = self.position
        v = self.velocity
        a = self.acceleration
        j = self.jerk
        s = self.snap
        position = x + time * (v + time / 2 * (a + time / 3 * (j + time / 4 * s)))
        velocity = v + time * (a + time / 2 * (j + time / 3 * s))
        acceleration = a + time * (j + time / 2 * s)
        return position, velocity, acceleration


class FlexibleLaw(ClassicalLaw):
    """Base class of the control laws for joint springs, which read the motor speeds.

    Raises:
        ValueError: if the robot has neither joint springs nor elastic cables, or
            ``minimum_tension`` is negative.
    """

    usual_minimum = FLEXIBLE_MINIMUM_TENSION

    def __init__(self, robot: Robot, *, minimum_tension: float | None = None) -> None:
        if not robot.flexible:
            law = type(self).__name__
            raise ValueError(
                f"{law} needs joint springs or elastic cables; robot {robot.name!r} has none"
            )
        super().__init__(robot, minimum_tension=minimum_tension)
        self._difference_step = DIFFERENCE_PERIODS / robot.defaults.control_frequency

    def reset(self, tasks: Sequence[Task]) -> None:
        """Checks the robots of the tasks and reads the control period.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        super().reset(tasks)
        self._difference_step = DIFFERENCE_PERIODS / tasks[0].control_frequency

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Requested torques [N·m] and motor speeds [rad/s], each (..., m)."""
        return self._motor_torques(blocks, mass), blocks["motor_speed"]

    def _motor_torques(self, blocks: dict[str, Array], mass: Array) -> Array:
        raise NotImplementedError

    def _rigid_torques(
        self, mass: Array, blocks: dict[str, Array], acceleration: Array
    ) -> tuple[Array, Array, Array]:
        """Torque κ + c′ β̇, pulley acceleration β̈ and pulley speed β̇ for an acceleration of the
        platform.

        With a rigid joint the motor torque would be κ + c′ β̇ + J′ β̈.
        """
        required = self._inverse_dynamics(mass, blocks["pose"], blocks["velocity"], acceleration)
        spring = textbook.holding_torque(self.robot, required.torques)
        torques = spring + textbook.motor_friction(self.model, required.speeds, spring)
        return torques, required.pulley_accelerations, required.speeds

    def _spring_torque_derivatives(
        self, mass: Array, motion: JointMotion
    ) -> tuple[Array, Array, Array]:
        """Spring torques κ = r T + J β̈ + c β̇ that a motion requires, κ̇ and κ̈, by central
        differences."""
        step = self._difference_step
        steps = step * np.array([-1.0, 0.0, 1.0])
        times = steps.reshape(-1, *[1] * motion.position.ndim)
        masses = np.stack([mass] * len(steps))
        # One batch takes a third of the time of three.
        before, now, after = self._inverse_dynamics(masses, *motion.after(times)).torques
        rate = (after - before) / (2 * step)
        second = (after - 2 * now + before) / step**2
        return now, rate, second

    def _reference_spring_torques(
        self, mass: Array, blocks: dict[str, Array]
    ) -> tuple[Array, Array, Array]:
        """κ_d, κ̇_d and κ̈_d of the reference."""
        motion = JointMotion(
            position=blocks["reference_pose"],
            velocity=blocks["reference_velocity"],
            acceleration=blocks["reference_acceleration"],
            jerk=blocks["reference_jerk"],
            snap=blocks["reference_snap"],
        )
        return self._spring_torque_derivatives(mass, motion)


class Composite(FlexibleLaw):
    """Rigid law for motor and pulley as one inertia, plus damping of the springs, ``K_v (β̇ −
    β̇′)``.

    The torque is constant over a control period h, so a stiff spring tolerates less of this
    damping. If the platform is much heavier than the rotors, the spring deflection δ oscillates
    with ω ≈ √(K/J′). The law acts on this oscillation only through the torque −(K_v − J′K_D) δ̇,
    because the outer loop interprets the β̇ of the oscillation as a motion of the platform. From
    one control step to the next the oscillation has

        det = 1 − g sin(ωh)/ω,   trace = 2 cos(ωh) − g sin(ωh)/ω   with   g = K_v/J′ − K_D.

    For ωh < π it is stable if 0 < g < ω cot(ωh/2). For ωh > π the control period is longer than
    half an oscillation. The sampled damping then adds or removes energy according to the sign of
    sin(ωh). g = 0 has no effect at any ωh. Hence

        K_v = min(spring_damping √(K J′), max(½ √(K J′) cot(ωh/2), J′K_D)),   the cotangent only for ωh < π.

    This is half of the stability limit, or the value with g = 0 where that is larger. On the
    paper's robot at 500 Hz the first term applies up to K = 82 N·m/rad and the last from about 910
    N·m/rad on. For K → ∞ the law becomes the rigid law. K_v is the first term until :meth:`reset`
    provides the control frequency.

    Args:
        robot: nominal robot.
        gains: (K_P, K_D) of the rigid law, or ``paper``.
        spring_damping: largest K_v in units of √(K J′).
        leads_springs: whether the torque κ leads by the lag of the damped springs along the
            reference, (K_v κ̇ + J′ κ̈)/K.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.

    Raises:
        ValueError: if the robot has neither joint springs nor elastic cables, or an argument is out
            of its range.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: Gains = "paper",
        spring_damping: float = 1.0,
        leads_springs: bool = False,
        minimum_tension: float | None = None,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer: OuterLoop = PD(gains=checked_gains(gains, robot))
        self.leads_springs = leads_springs
        # √(K J′) [N·m·s/rad]
        self._damping_unit = np.sqrt(self.model.stiffness * self.model.motor_inertia)
        self._max_damping = spring_damping * self._damping_unit
        self._damping = self._max_damping

    def reset(self, tasks: Sequence[Task]) -> None:
        """Checks the robots of the tasks and adapts the damping to the control period.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        super().reset(tasks)
        self._damping = self.damping(1 / tasks[0].control_frequency)

    def damping(self, period: float) -> Array:
        """K_v [N·m·s/rad] for a control period [s], (m,)."""
        _, outer_damping = self.outer.gains
        damping = self.model.motor_inertia * outer_damping
        phase = textbook.highest_frequency(self.model) * period
        if phase < math.pi:
            largest_stable = self._damping_unit / math.tan(phase / 2)
            damping = np.maximum(largest_stable / 2, damping)
        return np.minimum(self._max_damping, damping)

    @property
    def rotor_inertia(self) -> Array:
        """J + J′, motor and pulley as one inertia [kg·m²], (m,)."""
        return self.model.pulley_inertia + self.model.motor_inertia

    def _motor_torques(self, blocks: dict[str, Array], mass: Array) -> Array:
        inertia = self.model.motor_inertia
        damping = self._damping
        acceleration = self.outer(blocks)
        torques, accelerations, speeds = self._rigid_torques(mass, blocks, acceleration)
        torques = torques + inertia * accelerations
        torques += damping * (speeds - blocks["motor_speed"])
        if self.leads_springs:
            _, rate, second = self._reference_spring_torques(mass, blocks)
            stiffness = textbook.joint_stiffness(self.robot, blocks["pose"])
            torques += (damping * rate + inertia * second) / stiffness
        return torques


class MotorPD(FlexibleLaw):
    """PD control of the motor angles to ``β′_d = β_d + κ_d/K``, with the torque of the reference as
    feedforward.

    The plant is differentially flat: all reference values follow from X_d and its derivatives up to
    snap. The law does not read the measured pose of the platform, except at the start on elastic
    cables: an episode starts at rest, lower than the reference and with other tensions than the
    law's. The law fades from these motor angles and torques to its own.

    Args:
        robot: nominal robot.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.

    Raises:
        ValueError: if the robot has neither joint springs nor elastic cables, or
            ``minimum_tension`` is negative.
    """

    tension_reserve = 2.0  # the tensions swing more than under a law that reads the pose

    def __init__(self, robot: Robot, *, minimum_tension: float | None = None) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        inertia = self.model.motor_inertia
        self._stiffness = inertia * MOTOR_FREQUENCY**2
        self._damping = 2 * MOTOR_DAMPING_RATIO * inertia * MOTOR_FREQUENCY
        self._fading = 0.0

    def reset(self, tasks: Sequence[Task]) -> None:
        """Checks the robots of the tasks and reads the control period.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        super().reset(tasks)
        self._fading = math.exp(-1 / tasks[0].control_frequency / FADE_TIME)

    def _control(
        self, blocks: dict[str, Array], mass: Array, state: Any, episode_start: Any
    ) -> tuple[Array, Array, Any]:
        if not self.robot.elastic:
            return super()._control(blocks, mass, state, episode_start)
        starts = first_steps(state, episode_start, np.shape(mass))[..., None, None]
        offset = state
        if np.any(starts):
            offset = self._offset_at_rest(blocks, mass)
            if state is not None:
                offset = np.where(starts, offset, state)
        angle_offset, torque_offset = np.moveaxis(offset, -2, 0)
        torques = self._motor_torques(blocks, mass) - torque_offset
        torques -= self._stiffness * angle_offset
        return torques, blocks["motor_speed"], self._fading * offset

    def _offset_at_rest(self, blocks: dict[str, Array], mass: Array) -> Array:
        """Motor angles [rad] and spring torques [N·m] of the law at rest on the reference, less the
        measured ones, (..., 2, m)."""
        pose = blocks["reference_pose"]
        zero = np.zeros_like(pose)
        spring = self._inverse_dynamics(mass, pose, zero, zero).torques
        tensions = spring / self.model.pulley_radius
        angle = textbook.rest_angles(self.robot, tensions, pose)
        spring = textbook.holding_torque(self.robot, spring)
        measured_pose = blocks["pose"]
        measured_angle = blocks["motor_angle"]
        deflection = measured_angle - textbook.pulley_angle(self.model, measured_pose)
        measured_spring = textbook.joint_stiffness(self.robot, measured_pose) * deflection
        return np.stack([angle - measured_angle, spring - measured_spring], axis=-2)

    def _motor_torques(self, blocks: dict[str, Array], mass: Array) -> Array:
        robot = self.model
        pose = blocks["reference_pose"]
        required = self._inverse_dynamics(
            mass, pose, blocks["reference_velocity"], blocks["reference_acceleration"]
        )
        spring, spring_rate, spring_second = self._reference_spring_torques(mass, blocks)
        stiffness = textbook.joint_stiffness(self.robot, pose)
        tensions = spring / robot.pulley_radius
        angle = textbook.rest_angles(self.robot, tensions, pose)
        # With elastic cables the motor torque at rest exceeds r T.
        spring = textbook.holding_torque(self.robot, spring)
        speed = required.speeds + spring_rate / stiffness
        motor_acceleration = required.pulley_accelerations + spring_second / stiffness
        inertial = robot.motor_inertia * motor_acceleration
        feedforward = spring + inertial + textbook.motor_friction(robot, speed, spring)
        angle_error = angle - blocks["motor_angle"]
        speed_error = speed - blocks["motor_speed"]
        correction = self._stiffness * angle_error + self._damping * speed_error
        return feedforward + correction


def _slowest_frequency(robot: Robot) -> float:
    """Smallest √(K/J′) of the motors [rad/s]."""
    squares = robot.stiffness / robot.motor_inertia
    return float(np.sqrt(np.min(squares)))


def make_composite(
    robot: Robot, *, gains: Gains = "tuned", minimum_tension: float | None = None
) -> Composite:
    """Composite law with gains for the kind of the robot, which also tolerate an unknown payload.

    Much more spring damping does not help: β̇′ follows β̇ only as long as the spring torque is
    constant. The lead is for joint springs: on elastic cables it makes the errors larger.

    Args:
        robot: nominal robot.
        gains: ``tuned``, or the ``gains`` of :class:`Composite` with its other defaults.
        minimum_tension: least allocated tension [N], as in :class:`ClassicalLaw`.

    Raises:
        ValueError: as :class:`Composite`.
    """
    if gains != "tuned":
        return Composite(robot, gains=gains, minimum_tension=minimum_tension)
    if robot.kind == "planar":
        return Composite(
            robot, gains=(800.0, 30.0), spring_damping=0.5, minimum_tension=minimum_tension
        )
    ratio = 1.0
    if robot.elastic:
        # The outer loop is as slow, compared with the winches, as that of the paper's robot.
        frequency = _slowest_frequency(textbook.joint_equivalent(robot))
        ratio = min(1.0, frequency / _slowest_frequency(FLEX_SPATIAL))
    return Composite(
        robot,
        gains=(ratio**2 * 200.0, ratio * 28.0),
        spring_damping=0.4,
        leads_springs=not robot.elastic,
        minimum_tension=minimum_tension,
    )


COMPOSITE = entry("composite", make_composite)
MOTOR_PD = entry("motor-pd", MotorPD)
