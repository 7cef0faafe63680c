"""The paper's search for the payload (Section 5.1), as printed and as it has to be.

The paper guesses a load m_e, computes the motors' torques τ_e with it and τ_n without, and takes ``m_load = C m_e``
with the load coefficient C of Eq. 37-39. So m_e has to be the guess (the tables' m_l), not the end-effector's mass
m_n: where the torque is affine in the load, ``τ_e = τ_n + m_e s``, the product ``m_e (U − τ_n)/(τ_e − τ_n)`` is
``(U − τ_n)/s``, the true m*, from any guess. That is the corrected form. Printed are three other things:

* ``τ± = U± − τ_e``: C is then ``m*/m_e − 1``, and the guess that repeats itself, C = 1, is **half** the true load.
* abs(): a motor that is overloaded without any load counts as if it had as much to spare.
* U⁺ or U⁻ by the sign of τ_e: what matters is which of them the torque moves towards, the sign of ``τ_e − τ_n``.

"q̇" is the motor speed β̇ in both, or k₂ = τ_s/ω_n would have the wrong unit.
:func:`~cablebot_gym.bounds.closed_form.exact_payload` needs no guess.
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


@dataclass(frozen=True, kw_only=True)
class LoadIteration:
    """How the paper's algorithm came to its answer."""

    loads: tuple[float, ...]
    """Every guess m_e in turn [kg]; the first is the one that was given."""
    payload: float
    """``C m_e`` of the last guess [kg], the algorithm's answer where it converged (step 7b); ``inf``: no motor's torque
    depends on the load."""
    converged: bool
    """Whether the last guess and ``payload`` differ by no more than the tolerance. Not if the guesses ran out, or the
    next would have left the robot without mass: the motion is too fast for any payload."""
    motor: int | None
    """Motor with the least coefficient at the last guess, counted from 1; None if no torque depends on the load."""
    time: float | None
    """Control instant at which it has it [s]."""


def load_coefficient(robot: Robot, full: ArrayLike, empty: ArrayLike, speed: ArrayLike, *, corrected: bool) -> Array:
    """``(C_a)_i`` of Eq. 37, shape (..., m): how many times the guessed load each motor could bear.

    As printed it is the absolute value of Eq. 38. A torque that does not depend on the load bounds nothing: ``inf``.

    Args:
        robot: whose motors these are.
        full: τ_e, torques with the guessed load, which is positive, shape (..., m) [N·m].
        empty: τ_n, torques without load, shape (..., m) [N·m].
        speed: β̇, motor speeds, shape (..., m) [rad/s].
        corrected: whether to use the form that is right, or the printed one.
    """
    full, empty = np.asarray(full, float), np.asarray(empty, float)
    lower, upper = textbook.torque_limits(robot, speed)
    difference = full - empty
    limit = np.where((difference if corrected else full) >= 0, upper, lower)
    room = limit - (empty if corrected else full)
    with np.errstate(divide="ignore", invalid="ignore"):
        coefficient = np.where(difference == 0, np.inf, room / difference)
    return coefficient if corrected else np.abs(coefficient)


def iterate_load(
    robot: Robot,
    trajectory: Trajectory,
    *,
    guess: float,
    corrected: bool,
    minimum_tension: float = 0.0,
    tolerance: float = 1e-6,
    max_iterations: int = 100,
    frequency: float = 500.0,
    line_speed: ArrayLike = 1.0,
) -> LoadIteration:
    """The paper's eight steps for exact tracking: ``m_load = C m_e``, then the average of both is the next guess (7a).

    It knows torques alone, and upper ends alone. Where these are what limits the robot, the corrected form agrees with
    :func:`~cablebot_gym.bounds.closed_form.exact_payload`, also in finding a negative payload. The least tensions of
    a planar robot are only piecewise affine in the load; ``C m_e`` then moves with the guess, and convergence is not
    certain.

    Args:
        robot: with a rigid transmission.
        trajectory: for a robot with as many coordinates.
        guess: the first m_e [kg]; > 0.
        corrected: whether to use the form that is right, or the printed one.
        minimum_tension: that the least tensions of a planar robot keep [N]; has no effect on a spatial robot.
        tolerance: difference of m_load and m_e at which they are the same (7b) [kg]; > 0.
        max_iterations: guesses at most; ≥ 1.
        frequency: elements of the path per second [Hz], the control instants of exact tracking.
        line_speed: the speed in the torque-speed lines, as for exact tracking.

    Raises:
        ValueError: if an argument is not valid, or no tensions give the motion's accelerations at all.
    """
    for name, value in (("guess", guess), ("tolerance", tolerance)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be finite and greater than 0 kg, not {value}")
    if max_iterations < 1:
        raise ValueError(f"max_iterations must be at least 1, not {max_iterations}")
    times, reference = control_instants(robot, trajectory, frequency)
    speed = np.asarray(line_speed, float) * textbook.pulley_speed(robot, reference.position, reference.velocity)
    empty = _torques(robot, 0.0, reference, minimum_tension)
    loads: list[float] = []
    while True:
        loads.append(guess)
        # Steps 5 and 6. No load, or hardly any, tells nothing; and a torque that a negative load has taken away is a
        # torque that a positive one would add.
        probe = guess if abs(guess) > tolerance else math.copysign(tolerance, guess)
        change = math.copysign(1.0, probe) * (_torques(robot, probe, reference, minimum_tension) - empty)
        coefficient = load_coefficient(robot, empty + change, empty, speed, corrected=corrected)
        k, motor = np.unravel_index(np.argmin(coefficient), coefficient.shape)  # Eq. 38 and 39
        payload = float(coefficient[k, motor]) * abs(probe)
        limited = math.isfinite(payload)
        converged = not limited or abs(payload - guess) <= tolerance
        if converged or len(loads) == max_iterations or (guess + payload) / 2 <= -robot.mass:
            return LoadIteration(
                loads=tuple(loads),
                payload=payload,
                converged=converged,
                motor=int(motor) + 1 if limited else None,
                time=float(times[k]) if limited else None,
            )
        guess = (guess + payload) / 2


def _torques(robot: Robot, load: float, reference: Reference, minimum: float) -> Array:
    """Torques of exact tracking with a load, shape (K, m)."""
    motion = (reference.position, reference.velocity, reference.acceleration)
    tensions = textbook.required_tensions(robot, robot.mass + load, *motion, minimum=minimum)
    return textbook.required_torques(robot, tensions, *motion)
