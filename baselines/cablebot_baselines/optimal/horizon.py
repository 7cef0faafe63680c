"""The next fifth of a second as a quadratic program: a spline within the tube that asks the motors for least."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from cablebot_gym.envs.observation import PREVIEWS
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.planning import Margins
from cablebot_gym.planning.stage_functions import TENSION, import_casadi, rigid_instant
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits

HORIZON = PREVIEWS[-1]
"""How far ahead is planned: as far as the reference can be seen [s]."""

_DEGREE = 3
"""Of the spline: its acceleration is linear between knots."""

_SLOW = 0.05
"""Time in which a coordinate may cross its bound, to measure velocities and accelerations in [s]."""


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """What a plan weighs. Errors are in units of their bounds, drive commands of ±1."""

    intervals: int
    """Of the spline."""
    instants: int
    """Of each interval at which limits hold."""
    margins: Margins
    """What plans leave unused of each limit, for the law to correct errors with."""
    power: float
    """p ≥ 2 of the mean of aᵖ over motors and instants, which a plan makes small; the larger, the more peaks count."""
    error: float
    """Weight of the mean square error."""
    end_error: float
    """Weight of the square of the last error: what comes after the horizon is not known."""
    end_velocity: float
    """Weight of the square of the last velocity error, in bounds per 50 ms."""
    smoothness: float
    """Weight of the sum of squared jumps of acceleration from one instant to the next, in bounds per (50 ms)²."""
    too_much: float = 100.0
    """Price of the largest drive command beyond its limit, in commands, and of tensions, in 250 N."""
    too_far: float = 1000.0
    """Price of the largest error beyond its bound."""


class NoPlan(RuntimeError):
    """The quadratic program was not solved."""


class HorizonProgram:
    """Plans X(t) for t from 0 to :data:`HORIZON` from a state, a cubic spline with evenly spaced knots.

    Each round linearises the robot about the last plan and solves one quadratic program for the control points. Where
    cables are more than coordinates, the share of the tensions that moves nothing is free at each instant. Limits are
    soft, at a price beyond all else: there is a plan from every state. Gauß–Newton makes of aᵖ the square of a^(p/2).

    Args:
        robot: rigid.
        tuning: what to weigh.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
    """

    def __init__(self, robot: Robot, tuning: Tuning) -> None:
        ca = import_casadi()
        self.robot, self.tuning = robot, tuning
        knots = np.linspace(0.0, HORIZON, tuning.intervals + 1)
        self._knots = np.r_[np.zeros(_DEGREE), knots, np.full(_DEGREE, HORIZON)]
        self._near = float(knots[1]) / _DEGREE  # how far the second control point is ahead of the first, in time
        self.instants = np.linspace(0.0, HORIZON, tuning.intervals * tuning.instants + 1)
        """At which limits hold, (K,) [s]."""
        self._bases = self.basis(self.instants)
        self._fit = np.linalg.pinv(self._bases[0])
        self.basis_at = lru_cache(maxsize=1024)(self.basis)
        """:meth:`basis` of one time, remembered."""
        n, m, count = robot.coordinates, robot.cables, len(self.instants)
        self._along = min(n, 3)
        self._motion, self._spare = (tuning.intervals + _DEGREE - 2) * n, (m - n) * count
        self._size = self._motion + self._spare + 2
        function = rigid_instant(robot)
        numbers = ca.SX.sym("w", function.size1_in(0))
        values = function(numbers)
        slope = ca.densify(ca.jacobian(values, numbers[: 3 * n + m]))
        names = ["motion"], ["values", "slopes"]
        linear = ca.Function("linear", [numbers], [values, slope], *names, {"cse": True})
        self._linear = _InPlace(linear.map(count))
        rows = 2 * m * count + (1 + 2 * n) * (count - 1)
        dense = {"h": ca.Sparsity.dense(self._size, self._size), "a": ca.Sparsity.dense(rows, self._size)}
        self._quadratic = _InPlace(ca.conic("plan", "daqp", dense, {"error_on_fail": False}))
        self._quadratic.inputs["lbx"][:-2] = -np.inf  # what exceeds limits is not negative
        self._quadratic.inputs["ubx"][:] = np.inf

    def basis(self, times: Array | float) -> Array:
        """From control points to pose, velocity and acceleration at times within the horizon, (3, ..., points)."""
        spline = BSpline(self._knots, np.eye(len(self._knots) - _DEGREE - 1), _DEGREE)
        return np.stack([spline(times), spline.derivative(1)(times), spline.derivative(2)(times)])

    def plan(
        self,
        guess: Array,
        pose: Array,
        velocity: Array,
        reference: Array,
        last_velocity: Array,
        *,
        mass: float,
        limits: Limits,
        rounds: int = 1,
    ) -> Array:
        """Control points (points, n) of a plan.

        Args:
            guess: poses at :attr:`instants` to linearise about first, (K, n).
            pose: X, (n,) [m, rad].
            velocity: Ẋ, (n,).
            reference: X_d at :attr:`instants`, (K, n).
            last_velocity: Ẋ_d at the end of the horizon, (n,).
            mass: platform and payload [kg].
            limits: bounds of the errors.
            rounds: quadratic programs to solve, one after the other.

        Raises:
            NoPlan: if one of them is not solved.
        """
        plan: Array = self._fit @ guess
        plan[0], plan[1] = pose, pose + self._near * velocity
        for _ in range(rounds):
            try:
                self._write(plan, reference, last_velocity, mass, limits)
            except np.linalg.LinAlgError as error:
                raise NoPlan("the pose is singular") from error
            plan[2:] += self._solved().reshape(-1, self.robot.coordinates)
        return plan

    # The quadratic program: minimise ½ z'Hz + g'z over low ≤ A z ≤ high, z the change of the free control points, then
    # the spare tensions, then by how much drive commands and errors exceed their limits.

    def _write(self, plan: Array, reference: Array, last_velocity: Array, mass: float, limits: Limits) -> None:
        """Writes the quadratic program about a plan into the solver's arrays."""
        tuning, margins, n, m = self.tuning, self.tuning.margins, self.robot.coordinates, self.robot.cables
        bases, count, along = self._bases, len(self.instants), self._along
        bounds = np.array([limits.position] * along + [limits.rotation] * (n - along))
        poses, velocities, accelerations = bases @ plan
        demand, demand_slope, tension, tension_slope = self._linearised(poses, velocities, accelerations, mass)
        errors = (poses - reference) / bounds
        error_slope = self._slope(np.broadcast_to(np.eye(n, 3 * n) / bounds[:, None], (count, n, 3 * n)))

        inputs, row = self._quadratic.inputs, 0

        def at_most(slope: Array, excess: tuple[float, float], room: Array) -> None:
            """slope z ≤ room, by the next rows of the matrix; ``excess`` is the price's coefficients."""
            nonlocal row
            rows = slice(row, row + len(slope))
            inputs["a"][rows, : slope.shape[1]], inputs["a"][rows, -2:] = slope, excess
            inputs["lba"][rows, 0], inputs["uba"][rows, 0], row = -np.inf, room.ravel(), rows.stop

        at_most(demand_slope, (-1, 0), 1 - margins.demand - demand)
        # Spare tensions can always be raised; without, tensions are as soft as drive commands.
        at_most(-tension_slope, (0 if self._spare else -0.2, 0), tension - margins.tension / TENSION)
        # The start is given, so limits hold from the second instant on. ‖e‖ is linearised, and a box holds it in.
        most = np.r_[[1 - margins.position / limits.position] * along]
        most = np.r_[most, [1 - margins.rotation / limits.rotation] * (n - along)]
        length = np.linalg.norm(errors[1:, :along], axis=1)
        toward = errors[1:, :along] / np.maximum(length, 1e-9)[:, None]
        by_instant = error_slope.reshape(count, n, -1)[1:]
        at_most(np.einsum("kl,klz->kz", toward, by_instant[:, :along]), (0, -1), most[0] - length)
        for side in (1, -1):
            at_most(side * by_instant.reshape(-1, self._motion), (0, -1), most - side * errors[1:])

        hessian, gradient = inputs["h"], inputs["g"][:, 0]
        hessian[:], gradient[:] = 0.0, 0.0

        def least(slope: Array, value: Array, weight: Array | float) -> None:
            """Adds half the sum of weight · (value + slope z)²."""
            z = slice(slope.shape[1])
            weighted = slope.T * weight
            hessian[z, z] += weighted @ slope
            gradient[z] += weighted @ value.ravel()

        strain = np.maximum(demand.ravel(), 0.05)  # of a^(p/2), whose slope must not vanish
        half = tuning.power / 2
        share = np.repeat(np.r_[np.ones(count - 1), 0.5] / count, m)
        least(half * strain[:, None] ** (half - 1) * demand_slope, strain**half, share)
        least(error_slope, errors, tuning.error / count)
        least(error_slope.reshape(count, n, -1)[-1], errors[-1], tuning.end_error)
        unit = bounds / _SLOW
        end = np.kron(bases[1][-1, 2:], np.diag(1 / unit))
        least(end, (velocities[-1] - last_velocity) / unit, tuning.end_velocity)
        unit = bounds / _SLOW**2
        jumps = np.kron(np.diff(bases[2], axis=0)[:, 2:], np.diag(1 / unit))
        least(jumps, np.diff(accelerations, axis=0) / unit, tuning.smoothness)
        spare = np.arange(self._motion, self._motion + self._spare)
        hessian[spare, spare] += 1e-6
        hessian[[-2, -1], [-2, -1]] = 1.0
        gradient[-2:] = tuning.too_much, tuning.too_far

    def _linearised(
        self, poses: Array, velocities: Array, accelerations: Array, mass: float
    ) -> tuple[Array, Array, Array, Array]:
        """Drive commands (K, m) and their slope (K·m, variables), and tensions of the same shapes in their unit."""
        n, m, count = self.robot.coordinates, self.robot.cables, len(poses)
        least = self.tuning.margins.tension
        needed = inverse_dynamics(self.robot, mass, poses, velocities, accelerations, minimum=least)
        tensions = needed.tensions / TENSION
        masses = np.full((count, 1), mass)
        self._linear.inputs["motion"][:] = np.concatenate([poses, velocities, accelerations, tensions, masses], 1).T
        results = self._linear()
        demand = results["values"][n:].T.copy()
        slope = results["slopes"].reshape(n + m, count, 3 * n + m).swapaxes(0, 1)
        by_motion, by_tension = np.split(slope, [3 * n], axis=2)
        # The balance gives the tensions' change from the motion's, up to what moves nothing.
        inverse = np.linalg.pinv(by_tension[:, :n]) if self._spare else np.linalg.inv(by_tension[:, :n])
        follow = -inverse @ by_motion[:, :n]
        demand_slope = self._slope(by_motion[:, n:] + by_tension[:, n:] @ follow)
        tension_slope = self._slope(follow)
        if self._spare:
            nothing = np.swapaxes(np.linalg.svd(by_tension[:, :n])[2][:, n:], 1, 2)
            demand_slope = np.hstack([demand_slope, _diagonal(by_tension[:, n:] @ nothing)])
            tension_slope = np.hstack([tension_slope, _diagonal(nothing)])
        return demand, demand_slope, tensions, tension_slope

    def _slope(self, by_motion: Array) -> Array:
        """From slopes by (X, Ẋ, Ẍ) at each instant, (K, rows, 3n), to those by the free control points."""
        n = self.robot.coordinates
        parts = np.split(by_motion, [n, 2 * n], axis=2)
        pairs = zip(self._bases, parts, strict=True)
        slope = sum(basis[:, None, 2:, None] * part[:, :, None, :] for basis, part in pairs)
        return np.asarray(slope).reshape(-1, self._motion)

    def _solved(self) -> Array:
        """The change of the free control points that solves the program."""
        inputs = self._quadratic.inputs
        if not all(np.all(np.isfinite(inputs[name])) for name in ("h", "g", "a", "uba")):
            raise NoPlan("the state has no finite equations")
        try:
            change = self._quadratic()["x"][: self._motion, 0]
        except RuntimeError as error:
            raise NoPlan(str(error)) from error
        if not (self._quadratic.succeeded and np.all(np.isfinite(change))):
            raise NoPlan("the solver failed")
        return change


class _InPlace:
    """A CasADi function on numpy arrays that are its memory: to convert matrices takes longer than to solve with them.

    Args:
        function: of dense arguments.
    """

    def __init__(self, function: Any) -> None:
        self._buffer, self._evaluate = function.buffer()
        self.inputs: dict[str, Array] = {}
        """By name, column-major; to be written to."""
        self._outputs: dict[str, Array] = {}
        for place in range(function.n_in()):
            flat: Any = np.zeros(function.numel_in(place))
            if flat.size:
                self._buffer.set_arg(place, memoryview(flat))
                self.inputs[function.name_in(place)] = flat.reshape(function.size_in(place), order="F")
        for place in range(function.n_out()):
            flat = np.zeros(function.numel_out(place))
            self._buffer.set_res(place, memoryview(flat))
            self._outputs[function.name_out(place)] = flat.reshape(function.size_out(place), order="F")

    def __call__(self) -> dict[str, Array]:
        """The results by name, overwritten by the next call.

        Raises:
            RuntimeError: if CasADi refuses the inputs.
        """
        self._evaluate()
        return self._outputs

    @property
    def succeeded(self) -> bool:
        """Whether the last call, of a solver, did."""
        return bool(self._buffer.stats()["success"])


def _diagonal(blocks: Array) -> Array:
    """(K, rows, columns) to (K·rows, K·columns), zero off the diagonal."""
    count, rows, columns = blocks.shape
    matrix = np.zeros((count, rows, count, columns))
    matrix[np.arange(count), :, np.arange(count)] = blocks
    return matrix.reshape(count * rows, count * columns)
