"""Gains, bounds and tensions of robust control, computed from what is expected of a robot.

The paper's robust law (Eqs. 26–36) has free parameters. Here all of them follow from the expectation
and the task:

* **Stiffness Ω** (Eq. 18): ``K_P = Ω²`` and ``K_D = 2 Ω``, as large as :func:`stiffness_limit`
  allows. The law acts for the instant at which its action takes effect, so the dead time T is what is
  not known of the delay and the motor lag, and half a control period. A
  phase margin of :data:`PHASE_MARGIN` means ``c Ω T ≤ atan(2 c) − PHASE_MARGIN``. Springs with the
  damping ``f √(K J′)`` delay the acceleration by another ``f/ω`` with ``ω² = K/J′``; ``f ω = 2
  Ω/RESONANCE_GAIN`` leaves the gain :data:`RESONANCE_GAIN` at ω. With as many cables as coordinates,
  the noise of pose and velocity that Ω amplifies must also leave the cables of the unloaded robot at
  rest taut.
* **Boundary layer** (Eqs. 34–36): outside of it ``k_p = ω₀²``, ``k_d = 2 ω₀`` and ``ω₀ = Ω/2``. A
  diagonal Q of Eq. 35 gives ``s = BᵀPe = ė + λ e`` with ``λ = (Ω + ω₀)/2``. ``Δv = ρ s/max(‖s‖,
  ρ/κ)`` with ``κ = 2 (Ω − ω₀)`` is then, inside the layer, exactly the PD law of stiffness Ω. A
  thinner layer would exceed the limit.
* **Bound ρ** (Eqs. 30–33): the model mass m̂ is the middle of the possible masses. ``m̂/m`` is
  positive, so ``ρ = ζ ‖v₀ − g‖ + φ`` with ``|m/m̂ − 1| ≤ ζ`` is enough: the division by ``1 − ζ`` and
  the condition ``ζ < 1`` of the paper are not needed. φ is :data:`DEVIATIONS` standard deviations of
  the acceleration by strengths, friction and wrench. Positions and angles have separate bounds.
* **Tension margin**, with more cables than coordinates: above the minimum of the robot, the allocated
  tension has :data:`DEVIATIONS` standard deviations of what noise, motor errors, and the uncertain
  inertia and damping of the pulleys take along the reference. A jump of the reference's acceleration
  adds what the rotors take on an unloaded platform. Springs add their overshoot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cablebot_baselines.laws.outer_loop import BoundedRobustPD
from cablebot_baselines.observer.expectation import Expectation
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

PHASE_MARGIN = math.radians(60.0)
"""Phase margin of the loop inside the boundary layer, with the longest lag."""

RESONANCE_GAIN = 0.5
"""Gain of that loop at the resonance of the springs."""

DEVIATIONS = 3.0
"""Bound of a random error in standard deviations."""


def stiffness_limit(lag: float, spring_frequency: float = math.inf) -> float:
    """Largest Ω with which ``K_P = Ω²`` and ``K_D = 2 Ω`` keep the margins [1/s].

    The gain of ``(2 Ω s + Ω²)/s²`` is one at the frequency c Ω with c² = 2 + √5, and its phase
    there is atan(2 c) − π, whatever Ω is. A dead time T takes c Ω T from it. Damped springs with
    the resonance ω take c Ω f/ω, and multiply the gain at ω, which is about 2 Ω/ω, by 1/f.

    Args:
        lag: dead time T [s].
        spring_frequency: ω [rad/s]; infinite for a rigid robot.
    """
    crossover = math.sqrt(2 + math.sqrt(5))
    angle = (math.atan(2 * crossover) - PHASE_MARGIN) / crossover
    # The larger solution of Ω T + 2 Ω²/(ω² RESONANCE_GAIN) = angle, in a form without 0/0.
    root = math.sqrt(lag**2 + 8 * angle / (RESONANCE_GAIN * spring_frequency**2))
    return 2 * angle / (lag + root)


@dataclass(frozen=True, kw_only=True)
class Peaks:
    """Largest values along references."""

    jump: float
    """Jump of the acceleration between two control steps [m/s²]."""
    pulley_speed: float
    """Speed of a pulley [rad/s]."""
    pulley_acceleration: float
    """Angular acceleration of a pulley [rad/s²]."""
    tension_change: float
    """Change of a tension within the time 1/ω of the springs [N]; 0 for a rigid robot."""


def _largest(values: Array) -> float:
    """Largest absolute value."""
    return float(np.abs(values).max())


def spring_frequency(model: Robot, stiffness_spread: float = 0.0) -> float:
    """√(K/J′) of the softest joint spring [rad/s]; infinite for a rigid robot."""
    if not model.flexible:
        return math.inf
    softest = 1 - DEVIATIONS * stiffness_spread
    lowest_square = np.min(model.stiffness / model.motor_inertia)
    return math.sqrt(softest * lowest_square)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustDesign:
    """Gains, bounds and tensions for one expectation. All accelerations and tensions are those of
    the robot at its home pose."""

    expectation: Expectation
    """What is expected of the robot."""
    task: Task
    """Task with the motion."""
    largest_payload: float
    """Largest payload that is possible [kg]."""

    @classmethod
    def usual(cls, expectation: Expectation, task: Task) -> RobustDesign:
        """That for payloads up to the mass of the platform."""
        largest = float(expectation.robot.mass)
        return cls(expectation=expectation, task=task, largest_payload=largest)

    @cached_property
    def robot(self) -> Robot:
        """Expected robot with joint springs in place of elastic cables."""
        return textbook.joint_equivalent(self.expectation.robot)

    @property
    def mass(self) -> float:
        """Middle of the possible masses of platform and payload m̂ [kg]."""
        return float(self.robot.mass) + self.largest_payload / 2

    @property
    def zeta(self) -> float:
        """ζ, bound of |m/m̂ − 1|."""
        expected = self.expectation
        payload_error = (0.5 + DEVIATIONS * expected.payload_spread) * self.largest_payload
        platform_error = DEVIATIONS * expected.mass_spread
        return (payload_error + platform_error) / self.mass

    @cached_property
    def peaks(self) -> Peaks:
        """Largest values along the reference with :attr:`mass`."""
        robot, task = self.robot, self.task
        times = np.arange(task.steps + 1) / task.control_frequency
        motion = task.trajectory(times)
        changes = np.diff(motion.acceleration[:, : robot.dimensions], axis=0)
        required = inverse_dynamics(
            robot,
            self.mass,
            motion.position,
            motion.velocity,
            motion.acceleration,
            minimum=robot.minimum_tension,
            distribute=textbook.central_tensions,
        )
        tension_change = 0.0
        if robot.flexible:
            time = 1 / spring_frequency(robot)
            window = max(1, round(time * task.control_frequency))
            tensions = required.tensions
            tension_change = _largest(tensions[window:] - tensions[:-window])
        return Peaks(
            jump=_largest(np.linalg.norm(changes, axis=1)),
            pulley_speed=_largest(required.speeds),
            pulley_acceleration=_largest(required.pulley_accelerations),
            tension_change=tension_change,
        )

    # Gains

    @property
    def spring_frequency(self) -> float:
        """√(K/J′) of the softest spring [rad/s]; infinite for a rigid robot."""
        return spring_frequency(self.robot, self.expectation.stiffness_spread)

    @cached_property
    def stiffness(self) -> float:
        """Ω [1/s]: K_P = Ω² and K_D = 2 Ω inside the boundary layer."""
        period = 1 / self.task.control_frequency
        shortest, longest = self.expectation.effect_times(period)
        unknown = (longest - shortest) / 2
        limit = stiffness_limit(unknown + period / 2, self.spring_frequency)
        if self.robot.cables > self.robot.coordinates:
            return limit  # the allocated tension carries the noise
        return min(limit, self.noise_limit)

    @property
    def spring_damping(self) -> float:
        """Damping f of the springs in units of √(K J′)."""
        return 2 * self.stiffness / (RESONANCE_GAIN * self.spring_frequency)

    @property
    def noise_limit(self) -> float:
        """Largest Ω with which the noise leaves the cables of the unloaded robot at rest taut
        [1/s].

        The variance of a tension is Ω⁴ p + 4 Ω² r, with p by the noise of the pose and r by that of
        the velocity.
        """
        robot = self.robot
        torque = textbook.static_torque(robot, robot.mass, robot.home, minimum=0.0)
        tensions = torque / robot.pulley_radius
        margin = np.maximum(tensions - robot.minimum_tension, 0.0) / DEVIATIONS
        pose, velocity = self._noise
        by_pose = self._tension_slope**2 @ pose**2
        by_velocity = self._tension_slope**2 @ velocity**2
        root = np.sqrt(4 * by_velocity**2 + by_pose * margin**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            squares = margin**2 / (2 * by_velocity + root)
        squares = np.where(margin > 0, squares, 0.0)
        return math.sqrt(np.min(squares))

    @property
    def _noise(self) -> tuple[Array, Array]:
        """Standard deviations of pose and velocity, each (n,)."""
        deviations = self.expectation.noise.deviations(self.robot)
        n = self.robot.coordinates
        return deviations[:n], deviations[n : 2 * n]

    @property
    def _tension_slope(self) -> Array:
        """Change of the tensions per acceleration of the platform, (m, n)."""
        robot = self.robot
        pulls = textbook.jacobian(robot, robot.home).T
        inertia = textbook.mass_matrix(robot, self.mass, robot.home)
        slope: Array = -np.linalg.pinv(pulls) @ inertia
        return slope

    # Bounds

    @property
    def _motor_errors(self) -> Array:
        """Standard deviations of the torques at rest by strengths and friction, (m,) [N·m]."""
        robot, expected = self.robot, self.expectation
        minimum = robot.minimum_tension
        torque = textbook.static_torque(robot, self.mass, robot.home, minimum=minimum)
        friction = expected.friction_spread * math.sqrt(robot.cables) * robot.coulomb_friction
        errors: Array = np.hypot(expected.strength_spread * torque, friction)
        return errors

    @property
    def phi(self) -> tuple[float, float]:
        """φ, bounds of the accelerations by motors and wrench, of positions and of angles [m/s²,
        rad/s²]."""
        robot = self.robot
        at_rest = np.zeros(robot.coordinates)
        equations = textbook.motion_equations(robot, self.mass, robot.home, at_rest)
        structure = equations.structure
        rotors = structure.T @ (equations.rotor_masses[:, None] * structure)
        mobility = np.linalg.inv(equations.mass_matrix + rotors)
        torque_slope = mobility @ structure.T / robot.pulley_radius
        by_motors = torque_slope**2 @ self._motor_errors**2
        by_wrench = mobility**2 @ self.expectation.wrench_spread**2
        variance = by_motors + by_wrench
        positions, angles = np.split(variance, [robot.dimensions])
        position_bound = DEVIATIONS * math.sqrt(positions.sum())
        angle_bound = DEVIATIONS * math.sqrt(angles.sum())
        return position_bound, angle_bound

    @property
    def outer(self) -> BoundedRobustPD:
        """The outer loop."""
        return BoundedRobustPD(
            stiffness=self.stiffness,
            zeta=self.zeta,
            phi=self.phi,
            gravity=self.robot.gravity_vector,
        )

    # Tensions

    @property
    def minimum_tension(self) -> float:
        """Least tension to allocate with more cables than coordinates [N]: that of the robot, what
        random errors take with :data:`DEVIATIONS`, and what a jump of the acceleration takes."""
        robot, expected = self.robot, self.expectation
        rotor_inertia = np.max(robot.pulley_inertia)
        if robot.flexible:
            rotor_inertia += np.max(robot.motor_inertia)
        radius = np.min(robot.pulley_radius)
        pose, velocity = self._noise
        noise = np.hypot(self.stiffness**2 * pose, 2 * self.stiffness * velocity)
        noise_variance = self._tension_slope**2 @ noise**2
        errors = [
            np.max(self._motor_errors) / radius,
            math.sqrt(np.max(noise_variance)),
            expected.inertia_spread * rotor_inertia * self.peaks.pulley_acceleration / radius,
            expected.damping_spread * self.peaks.pulley_speed / radius,
        ]
        # Errors of the acceleration move the rotors too: an unloaded platform accelerates
        # (m̂ + e)/(m + e) times as much as requested, with the rotors as the mass e.
        structure = textbook.jacobian(robot, robot.home)
        rotors = rotor_inertia / radius**2
        moved = rotors * np.linalg.norm(structure, 2) ** 2
        missing = self.mass - robot.mass
        excess = self.peaks.jump * missing / (robot.mass + moved)
        jump = rotors * (excess + self.phi[0])
        if robot.flexible:
            ratio = self.spring_damping / 2
            overshoot = math.exp(-math.pi * ratio / math.sqrt(1 - ratio**2))
            jump += overshoot * self.peaks.tension_change
        random_errors = DEVIATIONS * np.linalg.norm(errors)
        return float(robot.minimum_tension + random_errors + jump)
