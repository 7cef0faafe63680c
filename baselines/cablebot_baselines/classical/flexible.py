"""Control laws that work on robots with joint springs, where the paper's own (Eq. 22) does not.

All are built from nominal parameters and the told payload, and read motor angles β′ and speeds β̇′. None of them clips
its commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cablebot_baselines.classical.law import Array, ClassicalLaw
from cablebot_baselines.classical.outer_loop import PD, RobustPD, checked_gains
from cablebot_gym.envs import FLEXIBLE_ENV_IDS
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import MINIMUM_TENSION
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

DIFFERENCE_STEP = 2e-4
"""Step of the central differences in time that give κ̇ and κ̈ along a motion [s]; their error is below 1e-6."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A motion at one instant, to snap; each array is (..., n)."""

    position: Array
    """X [m, rad]."""
    velocity: Array
    """First derivative."""
    acceleration: Array
    """Second derivative."""
    jerk: Array
    """Third derivative."""
    snap: Array
    """Fourth derivative."""

    def after(self, time: float) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration a short time later, by Taylor's series."""
        x, v, a, j, s = self.position, self.velocity, self.acceleration, self.jerk, self.snap
        return (
            x + time * (v + time / 2 * (a + time / 3 * (j + time / 4 * s))),
            v + time * (a + time / 2 * (j + time / 3 * s)),
            a + time * (j + time / 2 * s),
        )


class FlexibleLaw(ClassicalLaw):
    """A law for joint springs, which reads the motors' own speeds.

    Raises:
        ValueError: if the robot has no springs, or ``minimum_tension`` is negative.
    """

    def __init__(self, robot: Robot, *, minimum_tension: float = MINIMUM_TENSION) -> None:
        if not robot.flexible:
            raise ValueError(f"{type(self).__name__} needs joint springs, and {robot.name!r} has none: use fl")
        super().__init__(robot, minimum_tension=minimum_tension)

    def torques(self, part: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques that the law asks for [N·m], and motor speeds [rad/s], each (..., m)."""
        return self._torque(part, mass), part["motor_speed"]

    def _torque(self, part: dict[str, Array], mass: Array) -> Array:
        raise NotImplementedError

    def _as_rigid(self, mass: Array, part: dict[str, Array], acceleration: Array) -> tuple[Array, Array, Array]:
        """κ + c′ β̇, β̈ and β̇ of an acceleration: but for J′ β̈, the torque that rigid joints would need."""
        needed = self._inverse_dynamics(mass, part["pose"], part["velocity"], acceleration)
        return needed.torques + self.robot.motor_damping * needed.speeds, needed.windings, needed.speeds

    def _spring(self, mass: Array, pose: Array, velocity: Array, acceleration: Array) -> Array:
        """κ = r T + J β̈ + c β̇, what the springs have to give."""
        return self._inverse_dynamics(mass, pose, velocity, acceleration).torques

    def _winding(self, pose: Array, velocity: Array, acceleration: Array) -> Array:
        """β̈ [rad/s²], (..., m)."""
        return self._inverse_dynamics(np.asarray(self.robot.mass), pose, velocity, acceleration).windings

    def _spring_rates(self, mass: Array, motion: Motion) -> tuple[Array, Array, Array]:
        """κ, κ̇ and κ̈ along a motion."""
        before, now, after = (
            self._spring(mass, *motion.after(time)) for time in (-DIFFERENCE_STEP, 0.0, DIFFERENCE_STEP)
        )
        return now, (after - before) / (2 * DIFFERENCE_STEP), (after - 2 * now + before) / DIFFERENCE_STEP**2


class Composite(FlexibleLaw):
    """The rigid law with motor and pulley as one, plus damping of the springs, ``K_v (β̇ − β̇′)``.

    The torque is held for a control period h, so a stiff spring bears less of this damping. Where the platform is much
    heavier than the rotors, a spring's twist δ swings with ω ≈ √(K/J′), and all that the law does to it is the torque
    −(K_v − J′K_D) δ̇: the outer loop takes the swing's β̇ for a motion of the platform. From one instant to the next
    the swing then has

        det = 1 − g sin(ωh)/ω,   trace = 2 cos(ωh) − g sin(ωh)/ω   with   g = K_v/J′ − K_D,

    and is stable for 0 < g < ω cot(ωh/2) if ωh < π. Beyond, where a control period is more than half a swing, damping
    that is held feeds the swing or takes from it as the sign of sin(ωh) says; g = 0 does neither at any ωh. Hence

        K_v = min(spring_damping √(K J′), max(½ √(K J′) cot(ωh/2), J′K_D)),   the cotangent only where ωh < π,

    that is, half of what is stable, and where that is too little, as much as leaves the swing alone. On the paper's
    robot at 500 Hz the first term rules up to K = 82 N·m/rad and the last from some 910 on; as K grows the law becomes
    the rigid one. Before :meth:`begin` has told the control frequency, K_v is the first term.

    Args:
        robot: nominal robot.
        gains: (K_P, K_D) of the rigid law; None for the paper's.
        spring_damping: largest K_v in units of √(K J′).
        minimum_tension: T_min of a planar robot [N].
    """

    def __init__(
        self,
        robot: Robot,
        *,
        gains: tuple[float, float] | None = None,
        spring_damping: float = 1.0,
        minimum_tension: float = MINIMUM_TENSION,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        self.outer: PD | RobustPD = PD(gains=checked_gains(gains, robot))
        if not 0 <= spring_damping < math.inf:
            raise ValueError(f"spring_damping must be at least 0, not {spring_damping}")
        self._most = self._damping = spring_damping * np.sqrt(robot.stiffness * robot.motor_inertia)

    def begin(self, tasks: Sequence[Task]) -> None:
        """Refuses episodes of another robot, and fits the damping to the control period."""
        super().begin(tasks)
        self._damping = self.damping(max(1 / task.control_frequency for task in tasks))

    def damping(self, period: float) -> Array:
        """K_v [N·m·s/rad] where torques are held for a period [s], (m,)."""
        robot, phase = self.robot, textbook.highest_frequency(self.robot) * period
        stable = np.sqrt(robot.stiffness * robot.motor_inertia) / math.tan(phase / 2) if phase < math.pi else 0.0
        return np.minimum(self._most, np.maximum(stable / 2, robot.motor_inertia * self.outer.gains[1]))

    @property
    def turning_inertia(self) -> Array:
        """J + J′: motor and pulley as one [kg·m²], (m,)."""
        return self.robot.pulley_inertia + self.robot.motor_inertia

    def _torque(self, part: dict[str, Array], mass: Array) -> Array:
        torques, winding, speeds = self._as_rigid(mass, part, self.outer(part))
        return torques + self.robot.motor_inertia * winding + self._damping * (speeds - part["motor_speed"])


class MotorPD(FlexibleLaw):
    """PD control of the motors towards ``β′_d = β_d + κ_d/K``, with the torque of the reference as feed-forward.

    On the reference everything follows from X_d and its derivatives to snap (the plant is flat), so the platform's own
    pose is not even read.

    Args:
        robot: nominal robot.
        frequency: ω of the motor loop [rad/s]; K_P = J′ω², K_D = 2 ζ J′ ω.
        damping_ratio: ζ.
        minimum_tension: T_min of a planar robot [N].
    """

    def __init__(
        self,
        robot: Robot,
        *,
        frequency: float = 200.0,
        damping_ratio: float = 0.7,
        minimum_tension: float = MINIMUM_TENSION,
    ) -> None:
        super().__init__(robot, minimum_tension=minimum_tension)
        if not (0 < frequency < math.inf and 0 < damping_ratio < math.inf):
            raise ValueError("frequency and damping_ratio must be greater than 0")
        self._stiffness = robot.motor_inertia * frequency**2
        self._damping = 2 * damping_ratio * robot.motor_inertia * frequency

    def _torque(self, part: dict[str, Array], mass: Array) -> Array:
        robot, names = self.robot, ("pose", "velocity", "acceleration", "jerk", "snap")
        pose, velocity, acceleration, jerk, snap = (part[f"reference_{name}"] for name in names)
        motion = Motion(position=pose, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap)
        spring, spring_rate, spring_second = self._spring_rates(mass, motion)
        angle = textbook.pulley_angle(robot, pose) + spring / robot.stiffness
        speed = self.pulley_speed(pose, velocity) + spring_rate / robot.stiffness
        winding = self._winding(pose, velocity, acceleration) + spring_second / robot.stiffness
        feed_forward = spring + robot.motor_inertia * winding + robot.motor_damping * speed
        correction = self._stiffness * (angle - part["motor_angle"]) + self._damping * (speed - part["motor_speed"])
        return feed_forward + correction


class FourthOrder(FlexibleLaw):
    """Fourth-order feedback linearization: the snap of the platform is commanded, its error has the poles asked for.

    Acceleration and jerk follow from the state, through the springs; κ is affine in Ẍ, κ̇ in jerk, κ̈ in snap, all with
    the matrix ∂κ/∂Ẍ. Needs as many cables as coordinates. The paper has no gains for it, these are ours.

    Args:
        robot: nominal spatial robot.
        poles: four, in the left half plane [1/s].

    Raises:
        ValueError: if the robot is planar, or a pole is not stable.
    """

    def __init__(self, robot: Robot, *, poles: Sequence[complex] = (-15.0, -15.0, -60.0, -60.0)) -> None:
        super().__init__(robot)
        if robot.cables != robot.coordinates:
            raise ValueError(f"fl4 needs as many cables as coordinates; {robot.name!r} has {robot.cables}")
        gains = np.poly(np.asarray(poles))
        if len(poles) != 4 or not np.all(np.real(poles) < 0) or np.any(np.abs(np.imag(gains)) > 1e-9 * np.abs(gains)):
            raise ValueError(f"poles must be four stable ones, complex ones in pairs, not {poles}")
        self._gains = np.real(gains)[1:]

    def _torque(self, part: dict[str, Array], mass: Array) -> Array:
        robot, pose, velocity = self.robot, part["pose"], part["velocity"]
        still, slope = np.zeros_like(pose), self.torque_slope(mass, pose)
        spring = robot.stiffness * (part["motor_angle"] - textbook.pulley_angle(robot, pose))
        spring_rate = robot.stiffness * (part["motor_speed"] - self.pulley_speed(pose, velocity))
        acceleration = _solved(slope, spring - self._spring(mass, pose, velocity, still))
        motion = Motion(position=pose, velocity=velocity, acceleration=acceleration, jerk=still, snap=still)
        jerk = _solved(slope, spring_rate - self._spring_rates(mass, motion)[1])
        motion = Motion(position=pose, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=still)
        drift = self._spring_rates(mass, motion)[2]
        errors = (
            part["reference_jerk"] - jerk,
            part["reference_acceleration"] - acceleration,
            part["reference_velocity"] - velocity,
            part["reference_pose"] - pose,
        )
        snap = part["reference_snap"] + sum(gain * error for gain, error in zip(self._gains, errors, strict=True))
        spring_second = drift + (slope @ snap[..., None])[..., 0]
        winding = self._winding(pose, velocity, acceleration)
        motor = robot.motor_inertia * (winding + spring_second / robot.stiffness)
        return spring + motor + robot.motor_damping * part["motor_speed"]


def _solved(matrix: Array, vector: Array) -> Array:
    solution: Array = np.linalg.solve(matrix, vector[..., None])[..., 0]
    return solution


def composite_tuned(robot: Robot) -> Composite:
    """Composite with gains that also work on the planar robot, and for a payload that is not told.

    Much more damping of the springs loses what it gains: β̇′ follows β̇ only as far as the springs' torque is constant.
    """
    if robot.planar:
        return Composite(robot, gains=(800.0, 30.0), spring_damping=0.5)
    return Composite(robot, gains=(200.0, 28.0), spring_damping=0.4)


SPATIAL_ENV_IDS = tuple(env_id for env_id in FLEXIBLE_ENV_IDS if "Spatial" in env_id)

COMPOSITE = PolicyEntry(
    name="composite",
    kind="classical",
    env_ids=SPATIAL_ENV_IDS,  # the paper's planar gains are too stiff for springs this soft
    factory=Composite,
    summary="rigid law and damping of the joint springs",
)

COMPOSITE_TUNED = PolicyEntry(
    name="composite-tuned",
    kind="classical",
    env_ids=FLEXIBLE_ENV_IDS,
    factory=composite_tuned,
    summary="composite with gains that work on the planar robot too, and better for a payload that is not told",
)

MOTOR_PD = PolicyEntry(
    name="motor-pd",
    kind="classical",
    env_ids=FLEXIBLE_ENV_IDS,
    factory=MotorPD,
    summary="motor-side PD with the flat plant's feed-forward",
)

FL4 = PolicyEntry(
    name="fl4",
    kind="classical",
    env_ids=SPATIAL_ENV_IDS,
    factory=FourthOrder,
    summary="fourth-order feedback linearization",
)
