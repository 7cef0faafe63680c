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

from dataclasses import dataclass

import numpy as np

from cablebot_gym.bounds.closed_form import control_instants
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_reproduction.simulation import CONTROL_FREQUENCY

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
    """``C m_e`` of the last guess [kg], the result if the iteration converged (step 7b)."""
    converged: bool
    """Whether the last guess and ``payload`` differ by at most :data:`TOLERANCE`."""
    motor: int
    """Motor with the smallest coefficient at the last guess, counted from 1."""


def load_coefficient(
    robot: Robot, full: Array, empty: Array, speed: Array, *, corrected: bool
) -> Array:
    """``(C_a)_i`` of Eq. 37, shape (..., m): largest load of each motor as a multiple of the
    guessed load.

    The printed form is the absolute value of Eq. 38. The corrected coefficient is ``inf`` if the
    torque does not depend on the load.

    Args:
        robot: robot with these motors.
        full: τ_e, torques with the guessed positive load, shape (..., m) [N·m].
        empty: τ_n, torques without load, shape (..., m) [N·m].
        speed: β̇, motor speeds, shape (..., m) [rad/s].
        corrected: whether to use the corrected form instead of the printed one.
    """
    lower, upper = textbook.torque_limits(robot, speed)
    difference = full - empty
    with np.errstate(divide="ignore", invalid="ignore"):
        if corrected:
            reserve = np.where(difference >= 0, upper, lower) - empty
            return np.where(difference == 0, np.inf, reserve / difference)
        reserve = np.where(full >= 0, upper, lower) - full
        return np.abs(reserve / difference)


def iterate_load(
    robot: Robot,
    trajectory: Trajectory,
    *,
    guess: float,
    corrected: bool,
    minimum_tension: float = 0.0,
) -> LoadIteration:
    """Runs the eight steps of the paper for exact tracking of a motion with a positive payload. The
    average of ``C m_e`` and m_e is the next guess (7a).

    Args:
        robot: robot with a rigid transmission.
        trajectory: trajectory with the same number of coordinates.
        guess: first guess m_e [kg]; > 0.
        corrected: whether to use the corrected form instead of the printed one.
        minimum_tension: lower tension bound [N]; only a planar robot uses it.
    """
    _, reference = control_instants(robot, trajectory, CONTROL_FREQUENCY)
    motion = (reference.position, reference.velocity, reference.acceleration)

    def required(load: float) -> textbook.InverseDynamics:
        mass = robot.mass + load
        return textbook.inverse_dynamics(robot, mass, *motion, minimum=minimum_tension)

    empty = required(0.0)
    loads = [guess]
    while True:
        full = required(loads[-1])
        coefficient = load_coefficient(
            robot, full.torques, empty.torques, empty.speeds, corrected=corrected
        )
        _, motor = np.unravel_index(np.argmin(coefficient), coefficient.shape)  # Eqs. 38 and 39
        payload = float(coefficient.min()) * loads[-1]
        converged = abs(payload - loads[-1]) <= TOLERANCE
        if converged or len(loads) == MOST_GUESSES:
            return LoadIteration(tuple(loads), payload, converged, int(motor) + 1)
        loads.append((loads[-1] + payload) / 2)
