"""Tube about a reference, with the quantities of the proof in
:mod:`~cablebot_gym.bounds.certificate`, whose equations it cites."""

from __future__ import annotations

import math

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Trajectory

REFINEMENT = 8
"""Number of chords of the reference in each interval between knots."""

ACCELERATION_FACTOR = 1.1
"""Assumed largest ratio of the acceleration of the reference between samples to the largest sampled
one."""

_TURN = math.sqrt(4 / 3)
"""Largest |d²u/dt²| of a direction u to a point during straight motion [V²/ρ²]: maximum of
sin·√(sin² + 4 cos²)."""


def quadratic_splines(s: Array, width: float) -> tuple[tuple[Array, ...], ...]:
    """Value, first and second derivative of the three quadratic B-splines at fractions s of an
    interval."""
    one = np.ones_like(s)
    return (
        ((1 - s) ** 2 / 2, 0.5 + s - s**2, s**2 / 2),
        (-(1 - s) / width, (1 - 2 * s) / width, s / width),
        (one / width**2, -2 * one / width**2, one / width**2),
    )


def norm(vectors: Array) -> Array:
    """Lengths of vectors (..., d), shape (...)."""
    lengths: Array = np.linalg.norm(vectors, axis=-1)
    return lengths


class Tube:
    """Chords of the reference between ``start`` and ``end``, with the quantities of (3) and (4).

    Arrays over chords have shape (chords, …) with chords = REFINEMENT · intervals. Arrays over
    their ends have shape (chords + 1, …).
    """

    def __init__(
        self,
        robot: Robot,
        trajectory: Trajectory,
        error_bounds: ErrorBounds,
        start: float,
        end: float,
        intervals: int,
    ) -> None:
        self.robot = robot
        self.start = start
        self.end = end
        self.intervals = intervals
        self.width = (end - start) / intervals
        self.chord = self.width / REFINEMENT
        self.known_start = start == 0  # pose and velocity are known at t = 0
        # two instants for each chord
        times = start + np.arange(2 * intervals * REFINEMENT + 1) * (self.chord / 2)
        reference = trajectory(np.minimum(times, trajectory.duration))
        self.acceleration = ACCELERATION_FACTOR * float(norm(reference.acceleration).max())
        self.radius = error_bounds.position + self.acceleration * self.chord**2 / 8
        self.position = reference.position[::2]
        self.start_velocity = reference.velocity[0]
        self.speed = norm(np.diff(self.position, axis=0))[:, None] / self.chord
        largest_torque = robot.stall_torque + robot.coulomb_friction
        self.pull = largest_torque / robot.pulley_radius - robot.minimum_tension
        self.slope = (robot.speed_slope + robot.damping) / robot.pulley_radius**2
        self.inertia = robot.pulley_inertia / robot.pulley_radius**2
        self.away = textbook.jacobian(robot, self.position)  # u
        self.length = norm(self.position[:, None] - robot.base)
        shortest = np.minimum(self.length[1:], self.length[:-1]) - self.speed * self.chord / 2
        if np.any(shortest <= self.radius):
            cable = int(np.argmin(shortest.min(axis=0))) + 1
            tube = f"the tube of {error_bounds.position:g} m reaches the anchor of cable {cable}"
            raise ValueError(f"no certificate exists: {tube}. Choose a smaller position bound")
        self._set_curvatures(shortest)
        fractions = np.arange(REFINEMENT + 1) / REFINEMENT
        # (derivative, coefficient, point in interval)
        self.splines: Array = np.array(quadratic_splines(fractions, self.width))
        self._set_free_coefficients()
        self._functionals()

    def _set_curvatures(self, shortest: Array) -> None:
        """Bounds of turning directions and bulging lengths, for cables no shorter than
        ``shortest``."""
        self.arc = np.arcsin(self.radius / self.length)
        self.bulge = shortest - np.sqrt(shortest**2 - self.radius**2)  # κ
        self.turning = self.speed / shortest
        self.bending = _TURN * (self.speed / shortest) ** 2
        nearest = shortest - self.radius
        self.turning_in_tube = self.speed / nearest
        self.bending_in_tube = _TURN * (self.speed / nearest) ** 2
        self.sagging = self.speed**2 / shortest
        self.fanning = self.radius * np.sum(1 / nearest, axis=-1)  # |D(p) − D(p_d)|

    def _set_free_coefficients(self) -> None:
        """Coefficients that may differ from zero: w, φ and their rates vanish at unknown ends."""
        self.free_force = np.ones(self.intervals + 2, bool)
        self.free_tension = np.ones(self.intervals + 2, bool)
        self.free_force[-4:] = False
        self.free_tension[-2:] = False
        if not self.known_start:
            self.free_force[:4] = False
            self.free_tension[:2] = False

    def chords(self, coefficients: Array) -> tuple[Array, Array, Array]:
        """Value and rate at both ends of each chord, shape (chords, 2, …), and second derivative,
        shape (chords, …)."""
        local = np.stack([coefficients[j : j + self.intervals] for j in range(3)])
        value, rate, second = (np.einsum("cs,ck...->ks...", table, local) for table in self.splines)

        def ends(at: Array) -> Array:
            pairs = np.stack([at[:, :-1], at[:, 1:]], axis=2)
            return pairs.reshape(-1, 2, *at.shape[2:])

        return ends(value), ends(rate), second[:, :-1].reshape(-1, *second.shape[2:])

    def _functionals(self) -> None:
        """Computes the left side of (3) as linear functions of the coefficients. Every q_i is
        linear along each chord.

        The result is ``force`` (N + 2, 2), without its factor M, and ``tension`` (N + 2, m).
        ``towards`` (N + 2, 2) is ∫ w·D by the trapezoidal rule.
        """
        n, eta = self.intervals, self.chord
        self.force = np.zeros((n + 2, 2))
        self.tension = np.zeros((n + 2, self.robot.cables))
        self.towards = np.zeros((n + 2, 2))
        points = np.arange(n)[:, None] * REFINEMENT + np.arange(REFINEMENT + 1)
        position = self.position[points]
        length = self.length[points]
        towards = -self.away[points].sum(axis=2)
        trapezoid = eta * np.concatenate([[0.5], np.ones(REFINEMENT - 1), [0.5]])
        for j in range(3):
            value, rate, second = self.splines[:, j]
            self.towards[j : j + n] += np.einsum("s,ksi->ki", trapezoid * value, towards)
            self.force[j : j + n] += np.einsum("s,ksi->ki", trapezoid * second, position)
            area = self.width * (1 / 6, 2 / 3, 1 / 6)[j]
            bent = np.einsum("s,ksi->ki", trapezoid * second, length)
            # exact ∫ of a product of two functions that are linear along each chord
            start_rate, end_rate = rate[:-1], rate[1:]
            weight = np.zeros(REFINEMENT + 1)
            weight[:-1] += eta * (2 * start_rate + end_rate) / 6
            weight[1:] += eta * (start_rate + 2 * end_rate) / 6
            turned = np.einsum("s,ksi->ki", weight, length)
            self.tension[j : j + n] -= self.pull * area + self.inertia * bent - self.slope * turned
        if self.known_start:
            value, rate = self.splines[0, :, 0], self.splines[1, :, 0]
            length_rate = self.away[0] @ self.start_velocity
            momentum = np.outer(rate, self.position[0]) - np.outer(value, self.start_velocity)
            self.force[:3] += momentum
            wound = np.outer(rate, self.length[0]) - np.outer(value, length_rate)
            self.tension[:3] -= self.inertia * wound
            self.tension[:3] += self.slope * np.outer(value, self.length[0])

    def deficits(self, force: Array, tension: Array) -> Array:
        """Upper bound of the violation of (2) on each chord, shape (chords, m); ≤ 0 where (2)
        holds."""
        largest, fastest, w_second = self._sizes(force)
        phi, _, phi_second = self.chords(tension)
        bend = w_second[:, None] + 2 * fastest[:, None] * self.turning_in_tube
        bend = bend + largest[:, None] * self.bending_in_tube + phi_second
        margin = np.maximum(bend, 0.0) * self.chord**2 / 8
        deficit = (self._support(force) - phi).max(axis=1) + margin
        # Where w vanishes, (2) is φ ≥ 0, which follows from coefficients ≥ 0.
        return np.where((largest > 0)[:, None], deficit, 0.0)

    def _sizes(self, force: Array) -> tuple[Array, Array, Array]:
        """Upper bounds of |w|, |ẇ| and |ẅ| on each chord, each (chords,)."""
        w, rate, second = (norm(x) for x in self.chords(force))
        return w.max(axis=1) + second * self.chord**2 / 8, rate.max(axis=1), second

    def _least_forces(self, force: Array) -> float:
        """Lower bound of min(g, 0) in (4)."""
        largest, fastest, second = self._sizes(force)
        bend = second * self.robot.cables + 2 * fastest * self.turning.sum(axis=1)
        bend = bend + largest * self.bending.sum(axis=1)
        away = np.sum(bend * self.chord**2 / 8 + largest * self.fanning)
        integral = float(np.sum(self.towards * force) + self.chord * away)
        return min(-self.robot.minimum_tension * integral, 0.0)

    def _support(self, force: Array) -> Array:
        """Maximum of w·d_i over the disc at both ends of each chord, shape (chords, 2, m)."""
        w = self.chords(force)[0][:, :, None]  # (chords, 2, 1, 2)
        towards = -np.stack([self.away[:-1], self.away[1:]], axis=1)
        arc = np.stack([self.arc[:-1], self.arc[1:]], axis=1)
        along = np.sum(w * towards, axis=-1)
        across = np.abs(w[..., 0] * towards[..., 1] - w[..., 1] * towards[..., 0])
        angle = np.arctan2(across, along)
        return np.hypot(along, across) * np.cos(np.maximum(angle - arc, 0.0))

    def surplus(self, mass: float, force: Array, tension: Array) -> float:
        """Lower bound of h(M) in (4)."""
        _, _, w_second = self.chords(force)
        _, rate, second = self.chords(tension)
        b = self.inertia * second[:, None] - self.slope * rate  # (chords, 2, m)
        away = np.stack([self.away[:-1], self.away[1:]], axis=1)
        psi = mass * w_second[:, None] - np.einsum("kei,keij->kej", b, away)
        largest = np.abs(b).max(axis=1)
        bends = 2 * self.slope * np.abs(second) * self.turning + largest * self.bending
        bend = np.sum(bends, axis=-1)
        tube = self.radius * (norm(psi).mean(axis=1) + bend * self.chord**2 / 8)
        bulge = np.sum(np.maximum(b.max(axis=1), 0.0) * self.bulge, axis=-1)
        sag = np.sum(np.maximum(-b.min(axis=1), 0.0) * self.sagging, axis=-1) * self.chord**2 / 8
        known = mass * np.sum(self.force * force) + np.sum(self.tension * tension)
        return float(known - self.chord * np.sum(tube + bulge + sag)) + self._least_forces(force)
