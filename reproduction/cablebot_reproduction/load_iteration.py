"""The payload iteration of the paper (Section 5.1), as printed and corrected.

The paper guesses a load m_e. It computes the motor torques τ_e with this load and τ_n without it.
The payload is ``m_load = C m_e`` with the load coefficient C of Eqs. 37-39. The variable m_e must
therefore be the guess (m_l in the tables), not the mass m_n of the end-effector. If the torque is
affine in the load, ``τ_e = τ_n + m_e s``, the product ``m_e (U − τ_n)/(τ_e − τ_n)`` equals ``(U −
τ_n)/s``, the true payload m*, for every guess. This is the corrected form. The printed form differs
in three points:

* ``τ± = U± − τ_e``: C is then ``m*/m_e − 1``, and the fixed point C = 1 is **half** the true
  payload.
* abs(): a motor that is overloaded without load counts as if it had the same amount of torque in
  reserve.
* The sign of τ_e selects U⁺ or U⁻. The correct choice is the limit that the torque approaches: the
  sign of ``τ_e − τ_n``.

In both forms "q̇" is the motor speed β̇, because otherwise k₂ = τ_s/ω_n has the wrong unit.
:func:`~cablebot_gym.bounds.closed_form.exact_payload` computes the payload without a guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.bounds.closed_form import control_instants
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference, Trajectory
from cablebot_gym.utils.checks import number
from cablebot_reproduction.runs import CONTROL_FREQUENCY

TOLERANCE = 1e-6
"""Largest difference between m_load and m_e at convergence (7b) [kg]."""

MOST_GUESSES = 100
"""Largest number of guesses."""


@dataclass(frozen=True)
class LoadIteration:
    """Record of a run of the iteration."""

    loads: tuple[float, ...]
    """All guesses m_e in order [kg]; the first one is the argument ``guess``."""
    payload: float
    """``C m_e`` of the last guess [kg], the result if the iteration converged (step 7b); ``inf`` if
    no motor torque depends on the load."""
    converged: bool
    """Whether the last guess and ``payload`` differ by at most :data:`TOLERANCE`. False after
    :data:`MOST_GUESSES` guesses without convergence, or if the next guess would make the total mass
    zero or negative because the motion is too fast for any payload."""
    motor: int | None
    """Motor with the smallest coefficient at the last guess, counted from 1; None if no torque
    depends on the load."""
    time: float | None
    """Control instant of the smallest coefficient [s]; None if no torque depends on the load."""


def load_coefficient(
    robot: Robot, full: ArrayLike, empty: ArrayLike, speed: ArrayLike, *, corrected: bool
) -> Array:
    """``(C_a)_i`` of Eq. 37, shape (..., m): largest load of each motor as a multiple of the
    guessed load.

    The printed form is the absolute value of Eq. 38. The coefficient is ``inf`` if the torque does
    not depend on the load.

    Args:
        robot: robot with these motors.
        full: τ_e, torques with the guessed positive load, shape (..., m) [N·m].
        empty: τ_n, torques without load, shape (..., m) [N·m].
        speed: β̇, motor speeds, shape (..., m) [rad/s].
        corrected: whether to use the corrected form instead of the printed one.
    """
    full = np.asarray(full, float)
    empty = np.asarray(empty, float)
    lower, upper = textbook.torque_limits(robot, speed)
    difference = full - empty
    direction, start = difference, empty
    if not corrected:
        direction, start = full, full
    reserve = np.where(direction >= 0, upper, lower) - start
    with np.errstate(divide="ignore", invalid="ignore"):
        coefficient = np.where(difference == 0, np.inf, reserve / difference)
    if corrected:
        return coefficient
    return np.abs(coefficient)


def iterate_load(
    robot: Robot,
    trajectory: Trajectory,
    *,
    guess: float,
    corrected: bool,
    minimum_tension: float = 0.0,
    line_speed: ArrayLike = 1.0,
) -> LoadIteration:
    """Runs the eight steps of the paper for exact tracking. The average of ``C m_e`` and m_e is the
    next guess (7a).

    Only motor torques and upper bounds of the payload count. If these limit the robot, the
    corrected form agrees with :func:`~cablebot_gym.bounds.closed_form.exact_payload`. The minimum
    tensions of a planar robot have kinks over the load, so the iteration may not converge.

    Args:
        robot: robot with a rigid transmission.
        trajectory: trajectory with the same number of coordinates.
        guess: first guess m_e [kg]; > 0.
        corrected: whether to use the corrected form instead of the printed one.
        minimum_tension: lower tension bound [N]; only a planar robot uses it.
        line_speed: factor of the pulley speed in the torque-speed line, as for exact tracking.

    Raises:
        ValueError: if the guess is invalid, or if no tensions produce the motion.
    """
    guess = number("guess", guess, above=0, unit="kg")
    times, reference = control_instants(robot, trajectory, CONTROL_FREQUENCY)
    pulley_speed = textbook.pulley_speed(robot, reference.position, reference.velocity)
    speed = np.asarray(line_speed, float) * pulley_speed
    empty = _torques(robot, 0.0, reference, minimum_tension)
    loads: list[float] = []
    while True:
        loads.append(guess)
        # Steps 5 and 6. The probe load must differ from zero. A torque that a negative load removes
        # equals the torque that the corresponding positive load adds.
        probe = math.copysign(max(abs(guess), TOLERANCE), guess)
        change = _torques(robot, probe, reference, minimum_tension) - empty
        full = empty + math.copysign(1.0, probe) * change
        coefficient = load_coefficient(robot, full, empty, speed, corrected=corrected)
        k, motor = np.unravel_index(np.argmin(coefficient), coefficient.shape)  # Eq. 38 and 39
        payload = float(coefficient[k, motor]) * abs(probe)
        if not math.isfinite(payload):
            return LoadIteration(tuple(loads), payload, converged=True, motor=None, time=None)
        converged = abs(payload - guess) <= TOLERANCE
        next_guess = (guess + payload) / 2
        if converged or len(loads) == MOST_GUESSES or next_guess <= -robot.mass:
            return LoadIteration(
                tuple(loads), payload, converged, motor=int(motor) + 1, time=float(times[k])
            )
        guess = next_guess


def _torques(robot: Robot, load: float, reference: Reference, minimum: float) -> Array:
    """Torques of exact tracking with a load, shape (K, m) [N·m]."""
    motion = (reference.position, reference.velocity, reference.acceleration)
    tensions = textbook.required_tensions(robot, robot.mass + load, *motion, minimum=minimum)
    return textbook.required_torques(robot, tensions, *motion)
