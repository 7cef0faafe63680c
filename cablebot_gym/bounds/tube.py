"""Tube about a reference, with the quantities of the proof in
:mod:`~cablebot_gym.bounds.certificate`, whose equations it cites."""

from __future__ import annotations

import math
from typing import Any

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
    constant = np.ones_like(s)
    values = ((1 - s) ** 2 / 2, 0.5 + s - s**2, s**2 / 2)
    rates = (-(1 - s) / width, (1 - 2 * s) / width, s / width)
    outer = constant / width**2
    middle = -2 * constant / width**2
    return values, rates, (outer, middle, outer)


def norm(vectors: Array) -> Array:
    """Lengths of vectors (..., d), shape (...)."""
    lengths: Array = np.linalg.norm(vectors, axis=-1)
    return lengths


def _at_both_ends(values: Array) -> Array:
    """Values (chords + 1, …) at the start and the end of each chord, shape (chords, 2, …)."""
    return np.stack([values[:-1], values[1:]], axis=1)


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
        instants = np.arange(2 * intervals * REFINEMENT + 1)  # two for each chord
        times = start + instants * (self.chord / 2)
        reference = trajectory(np.minimum(times, trajectory.duration))
        largest_sample = float(norm(reference.acceleration).max())
        self.acceleration = ACCELERATION_FACTOR * largest_sample
        self.radius = error_bounds.position + self._chord_error(self.acceleration)
        self.position = reference.position[::2]
        self.start_velocity = reference.velocity[0]
        chord_vectors = np.diff(self.position, axis=0)
        self.speed = norm(chord_vectors)[:, None] / self.chord
        largest_torque = robot.stall_torque + robot.coulomb_friction
        self.pull = largest_torque / robot.pulley_radius - robot.minimum_tension
        self.slope = (robot.speed_slope + robot.damping) / robot.pulley_radius**2
        self.inertia = robot.pulley_inertia / robot.pulley_radius**2
        self.away = textbook.jacobian(robot, self.position)  # u
        self.length = norm(self.position[:, None] - robot.base)
        shortest = np.minimum(self.length[1:], self.length[:-1])
        shortest = shortest - self.speed * self.chord / 2  # between the ends of a chord
        if np.any(shortest <= self.radius):
            shortest_of_cables = shortest.min(axis=0)
            cable = int(np.argmin(shortest_of_cables)) + 1
            tube = f"the tube of {error_bounds.position:g} m reaches the anchor of cable {cable}"
            raise ValueError(f"no certificate exists: {tube}. Choose a smaller position bound")
        self._set_curvatures(shortest)
        fractions = np.arange(REFINEMENT + 1) / REFINEMENT
        # (derivative, coefficient, point in interval)
        self.splines: Array = np.array(quadratic_splines(fractions, self.width))
        self._set_free_coefficients()
        self._functionals()

    def _chord_error(self, second: Any) -> Any:
        """Largest distance of a function from its chord, if its second derivative is at most
        ``second``."""
        return second * self.chord**2 / 8

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
        value, rate, second = (
            np.einsum("cs,ck...->ks...", spline, local) for spline in self.splines
        )

        def ends(points: Array) -> Array:
            pairs = np.stack([points[:, :-1], points[:, 1:]], axis=2)
            return pairs.reshape(-1, 2, *points.shape[2:])

        second = second[:, :-1]  # constant in an interval
        return ends(value), ends(rate), second.reshape(-1, *second.shape[2:])

    def _functionals(self) -> None:
        """Computes the left side of (3) as linear functions of the coefficients. Every q_i is
        linear along each chord.

        The result is ``force`` (N + 2, 2), without its factor M, and ``tension`` (N + 2, m).
        ``towards`` (N + 2, 2) is ∫ w·D by the trapezoidal rule.
        """
        n = self.intervals
        eta = self.chord
        self.force = np.zeros((n + 2, 2))
        self.tension = np.zeros((n + 2, self.robot.cables))
        self.towards = np.zeros((n + 2, 2))
        points = np.arange(n)[:, None] * REFINEMENT + np.arange(REFINEMENT + 1)
        position = self.position[points]
        length = self.length[points]
        towards = -self.away[points].sum(axis=2)
        trapezoid = np.full(REFINEMENT + 1, eta)
        trapezoid[[0, -1]] = eta * 0.5

        def integral(weights: Array, values: Array) -> Any:
            """Weighted sum over the points of each interval."""
            return np.einsum("s,ksi->ki", weights, values)

        areas = (1 / 6, 2 / 3, 1 / 6)  # of the splines, for intervals of width 1
        for j in range(3):
            value, rate, second = self.splines[:, j]
            support = slice(j, j + n)
            self.towards[support] += integral(trapezoid * value, towards)
            self.force[support] += integral(trapezoid * second, position)
            area = self.width * areas[j]
            bent = integral(trapezoid * second, length)
            # exact ∫ of a product of two functions that are linear along each chord
            start_rate = rate[:-1]
            end_rate = rate[1:]
            weights = np.zeros(REFINEMENT + 1)
            weights[:-1] += eta * (2 * start_rate + end_rate) / 6
            weights[1:] += eta * (start_rate + 2 * end_rate) / 6
            turned = integral(weights, length)
            self.tension[support] -= self.pull * area + self.inertia * bent - self.slope * turned
        if self.known_start:
            value, rate, _ = self.splines[:, :, 0]
            velocity = self.start_velocity
            self.force[:3] += np.outer(rate, self.position[0]) - np.outer(value, velocity)
            length_rate = self.away[0] @ velocity
            wound = np.outer(rate, self.length[0]) - np.outer(value, length_rate)
            self.tension[:3] -= self.inertia * wound
            self.tension[:3] += self.slope * np.outer(value, self.length[0])

    def deficits(self, force: Array, tension: Array) -> Array:
        """Upper bound of the violation of (2) on each chord, shape (chords, m); ≤ 0 where (2)
        holds."""
        largest, fastest, w_second = self._sizes(force)
        phi, _, phi_second = self.chords(tension)
        largest = largest[:, None]
        bend = w_second[:, None] + 2 * fastest[:, None] * self.turning_in_tube
        bend = bend + largest * self.bending_in_tube + phi_second
        margin = self._chord_error(np.maximum(bend, 0.0))
        deficit_at_ends = self._support(force) - phi
        deficit = deficit_at_ends.max(axis=1) + margin
        # Where w vanishes, (2) is φ ≥ 0, which follows from coefficients ≥ 0.
        return np.where(largest > 0, deficit, 0.0)

    def _sizes(self, force: Array) -> tuple[Array, Array, Array]:
        """Upper bounds of |w|, |ẇ| and |ẅ| on each chord, each (chords,)."""
        w, rate, second = (norm(x) for x in self.chords(force))
        largest = w.max(axis=1) + self._chord_error(second)
        fastest = rate.max(axis=1)
        return largest, fastest, second

    def _least_forces(self, force: Array) -> float:
        """Lower bound of min(g, 0) in (4)."""
        largest, fastest, second = self._sizes(force)
        bend = second * self.robot.cables + 2 * fastest * self.turning.sum(axis=1)
        bend = bend + largest * self.bending.sum(axis=1)
        away = np.sum(self._chord_error(bend) + largest * self.fanning)
        on_reference = np.sum(self.towards * force)
        integral = float(on_reference + self.chord * away)
        return min(-self.robot.minimum_tension * integral, 0.0)

    def _support(self, force: Array) -> Array:
        """Maximum of w·d_i over the disc at both ends of each chord, shape (chords, 2, m)."""
        w, _, _ = self.chords(force)
        w = w[:, :, None]  # (chords, 2, 1, 2)
        towards = -_at_both_ends(self.away)
        along = np.sum(w * towards, axis=-1)
        across = np.abs(w[..., 0] * towards[..., 1] - w[..., 1] * towards[..., 0])
        angle = np.arctan2(across, along)
        # The directions d_i of the disc lie within ± arc of that at its centre.
        least_angle = np.maximum(angle - _at_both_ends(self.arc), 0.0)
        return np.hypot(along, across) * np.cos(least_angle)

    def surplus(self, mass: float, force: Array, tension: Array) -> float:
        """Lower bound of h(M) in (4)."""
        _, _, w_second = self.chords(force)
        _, rate, second = self.chords(tension)
        b = self.inertia * second[:, None] - self.slope * rate  # (chords, 2, m)
        cable_terms = np.einsum("kei,keij->kej", b, _at_both_ends(self.away))
        psi = mass * w_second[:, None] - cable_terms
        largest = np.abs(b).max(axis=1)
        bends = 2 * self.slope * np.abs(second) * self.turning
        bends = bends + largest * self.bending
        bend = np.sum(bends, axis=-1)
        mean_psi = norm(psi).mean(axis=1)
        tube = self.radius * (mean_psi + self._chord_error(bend))
        positive = np.maximum(b.max(axis=1), 0.0)
        negative = np.maximum(-b.min(axis=1), 0.0)
        bulge = np.sum(positive * self.bulge, axis=-1)
        sag = self._chord_error(np.sum(negative * self.sagging, axis=-1))
        known = mass * np.sum(self.force * force) + np.sum(self.tension * tension)
        uncertain = self.chord * np.sum(tube + bulge + sag)
        return float(known - uncertain) + self._least_forces(force)
