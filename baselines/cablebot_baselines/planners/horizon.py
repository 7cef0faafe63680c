"""Quadratic programs of the receding-horizon controller.

They plan the motion of the next 0.2 s as a spline within the error bounds that needs small motor
actions, for N robots at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cablebot_baselines.planners.horizon_tuning import Tuning
from cablebot_baselines.planners.quadratic import (
    BufferedSolver,
    PlanningError,
    inverse_and_null_space,
    inverse_factors,
)
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import demands, inverse_dynamics
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.planning.stage_functions import TENSION, check_model, import_casadi
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds

HORIZON_PERIODS = 100
"""Planning horizon in control periods of the robot: slow robots with wide error bounds have longer
ones."""

_DEGREE = {"rigid": 3, "flexible": 5}
"""Degree of the spline, by joints of the robot: a flexible one needs jerk and snap."""

_GIVEN = {"rigid": 2, "flexible": 4}
"""Number of derivatives at the start of a plan that are given, the pose among them: up to the velocity,
or up to the jerk."""

_TIME_SCALE = 0.25
"""Time that scales velocities (bound per time) and accelerations (bound per time²), as a fraction of
the horizon."""

_FIRST_ITERATIONS = 3
"""Number of quadratic programs for a plan without a previous plan as initial guess."""

_DIFFERENCE = 1e-6
"""Step of the difference quotients along X [m, rad] and Ẋ [m/s, rad/s]."""


_ACTION_EXCESS_WEIGHT = 100.0
"""Weight of the largest constraint violation of actions, in units of ±1, and of tensions, in units of
10 N."""

_ERROR_EXCESS_WEIGHT = 1000.0
"""Weight of the largest constraint violation of errors, in units of their bounds."""


class _Batch:
    """Data whose arrays have N robots along their first axis."""

    def __getitem__(self, rows: Any) -> Self:
        """The data of some robots."""
        data = {}
        for name, value in vars(self).items():
            data[name] = value[rows] if isinstance(value, np.ndarray) else value
        return type(self)(**data)


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedRobots(_Batch):
    """What is expected of N robots within the horizon."""

    mass: Array
    """Mass of platform and payload, (N,) [kg]."""
    strength: Array
    """Strength of each motor as a fraction of the nominal one, (N, m)."""
    disturbance: Array
    """Acceleration by a wrench, (N, n) [m/s², rad/s²]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Target(_Batch):
    """What N plans have to do."""

    reference: Array
    """X_d at :attr:`HorizonProgram.instants`, (N, K, n)."""
    last_velocity: Array
    """Ẋ_d at the end of the horizon, (N, n)."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearisation(_Batch):
    """Actions and tensions, linearised about N plans. Rows are the actions and then the tensions, in
    units of ``TENSION``, of all motors. NaN where a pose is singular."""

    plan: Array
    """Control points, (N, points, n)."""
    strength: Array
    """Strength of each motor as a fraction of the nominal one, (N, m)."""
    values: Array
    """Actions and tensions at the instants, (N, K, 2m)."""
    slope: Array
    """Derivatives with respect to the control points, (N, K, 2m, points·n)."""
    null_slope: Array
    """Derivatives with respect to the null-space tensions of the same instant, (N, K, 2m, m − n)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Program(_Batch):
    """Quadratic programs for the changes of N plans whose starts are not yet given: ``½ w'w + (g + G
    s)'w`` subject to ``A w ≤ b − B s``, with the change s of the control points at the start. The
    excesses are not part of w here. NaN where a program has no solution."""

    plan: Array
    """Control points, (N, points, n)."""
    whitening: Array
    """L⁻ᵀ: from w to the changes of the free control points and the null-space tensions."""
    matrix: Array
    """Aᵀ."""
    start_matrix: Array
    """B."""
    limit: Array
    """b."""
    gradient: Array
    """g."""
    start_gradient: Array
    """G."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fixed:
    """Parts of the program that depend only on the error bounds. Errors are in units of them."""

    bounds: Array
    """Error bound of each coordinate, (n,)."""
    limits: Array
    """Largest error of each coordinate in a plan, (n,)."""
    error_slope: Array
    """Derivatives of the errors, (K, n, points·n)."""
    matrix: Array
    """Constraint matrix, (rows, columns), with zeros in the rows that are not fixed."""
    hessian: Array
    """Hessian of the terms of errors, last velocity and acceleration steps, (points·n, points·n)."""
    gradient: Array
    """Derivative of the gradient of these terms with respect to their values, (points·n,
    values)."""


class HorizonProgram:
    """Plans X(t) for t from 0 to :attr:`horizon` from a given start, as a spline with evenly spaced
    knots.

    Each iteration linearises the robot about the last plan and solves one quadratic program for the
    control points. If the robot has more cables than coordinates, the null-space tensions are free
    variables at each instant. Constraints are soft with weights far above all others, so a plan
    exists from every state. The Gauss–Newton method treats aᵖ as the square of a^(p/2).

    Args:
        robot: robot; joint springs count as stiff.
        tuning: discretisation and objective weights.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the motors of the robot have a lag.
    """

    def __init__(self, robot: Robot, tuning: Tuning) -> None:
        ca = import_casadi()
        check_model(robot)
        self.given = _GIVEN[robot.joints]
        """Number of derivatives at the start of a plan that are given, the pose among them."""
        self._degree = _DEGREE[robot.joints]
        self.robot = robot = rigid_equivalent(robot)
        self.tuning = tuning
        self.minimum_tension = robot.minimum_tension + tuning.margins.tension
        """Minimum cable tension of the plans [N]."""
        self.horizon = HORIZON_PERIODS / robot.defaults.control_frequency
        """Planning horizon [s]."""
        knots = np.linspace(0.0, self.horizon, tuning.intervals + 1)
        self._knots = np.pad(knots, self._degree, mode="edge")
        self.points = tuning.intervals + self._degree
        """Number of control points."""
        count = tuning.intervals * tuning.instants + 1
        self.instants = np.linspace(0.0, self.horizon, count)
        """Times at which the constraints apply, (K,) [s]."""
        self._bases = self.basis(self.instants)[:3]
        self._fit = np.linalg.pinv(self._bases[0])
        # From the derivatives at the start to the first control points.
        self._first_points = np.linalg.inv(self.basis(0.0)[: self.given, : self.given])
        self.basis_at = lru_cache(maxsize=1024)(self.basis)
        """:meth:`basis` of one time, cached."""
        self.shift = lru_cache(maxsize=64)(self._shift)
        """Matrix from the control points of a plan to those of the plan from a later time on,
        (points, points), by extrapolation beyond the horizon; cached."""
        self._fixed = lru_cache(maxsize=16)(self._fixed_parts)
        n = robot.coordinates
        m = robot.cables
        # The load is linear in Ẍ.
        self._steps = np.repeat([_DIFFERENCE, _DIFFERENCE, 1.0], n)
        # Columns: the control points, of which the first ones are given, and the null-space tensions.
        motion = n * self.points
        self._columns = motion + count * (m - n)
        self._start = slice(self.given * n)
        self._free = slice(self.given * n, None)
        self._motion = slice(motion)
        self._null_space = slice(motion, None)
        self._has_null_space = m > n
        # Rows. Errors have no rows at the first instant, where the state is given.
        actions = count * m
        lengths = 2 * actions
        errors = lengths + count - 1
        self._actions = slice(actions)
        self._tensions = slice(actions, lengths)
        self._lengths = slice(lengths, errors)
        self._errors = slice(errors, None)
        self._rows = errors + 2 * n * (count - 1)
        # The variables of the solver are the free columns and the excesses of actions and errors.
        variables = self._columns - self.given * n + 2
        dense = {
            "h": ca.Sparsity.dense(variables, variables),
            "a": ca.Sparsity.dense(self._rows, variables),
        }
        solver = ca.conic("plan", "daqp", dense, {"error_on_fail": False})
        self._quadratic = BufferedSolver(solver)
        self._write_excesses()

    def _write_excesses(self) -> None:
        """Writes what is the same in all programs into the arrays of the solver. The last two
        variables are the excesses of actions and errors."""
        inputs = self._quadratic.inputs
        np.fill_diagonal(inputs["h"], 1.0)
        gradient = inputs["g"]
        gradient[-2] = _ACTION_EXCESS_WEIGHT
        gradient[-1] = _ERROR_EXCESS_WEIGHT
        matrix = inputs["a"]
        matrix[self._actions, -2] = -1.0
        # Null-space tensions can always be raised. Without a null space the tension constraints are
        # soft, like those of the actions.
        if not self._has_null_space:
            matrix[self._tensions, -2] = -0.2
        matrix[self._lengths, -1] = -1.0
        matrix[self._errors, -1] = -1.0
        inputs["lba"][:] = -np.inf
        # The excesses are at least 0.
        inputs["lbx"][:-2] = -np.inf
        inputs["ubx"][:] = np.inf

    def basis(self, times: Array | float) -> Array:
        """Matrices from control points to the pose and its first four derivatives at times in the
        horizon, (5, ..., points)."""
        pose = BSpline(self._knots, np.eye(self.points), self._degree)
        return np.stack([pose(times, order) for order in range(5)])

    def _shift(self, time: float) -> Array:
        return self._fit @ self.basis(self.instants + time)[0]

    def plan(self, start: Array, target: Target, *, robots: ExpectedRobots) -> tuple[Array, str]:
        """Control points of plans, from the reference as the first guess, and the reason of failures,
        as :meth:`solved`.

        Args:
            start: pose and derivatives at the start, (N, given, n).
            target: what the plans have to do.
            robots: what is expected of the robots.
        """
        plans = self._with_start(self._fit @ target.reference, start)
        rows = np.arange(len(plans))
        first_reason = ""
        for _ in range(_FIRST_ITERATIONS):
            program = self.assembled(self.linearised(plans[rows], robots[rows]), target[rows])
            plans[rows], reason = self.solved(program, start[rows])
            first_reason = first_reason or reason
            rows = rows[has_plan(plans[rows])]
            if not len(rows):
                break
        return plans, first_reason

    def _with_start(self, plans: Array, start: Array) -> Array:
        """Plans with other starts."""
        return np.concatenate([self._first_points @ start, plans[:, self.given :]], axis=1)

    def linearised(self, plans: Array, expected: ExpectedRobots) -> Linearisation:
        """First part of an iteration: the robots, linearised about plans."""
        robot = self.robot
        motion = self._bases[:, None] @ plans
        motion[2] -= expected.disturbance[:, None]
        varied = self._varied(motion)
        masses = np.empty(varied.shape[1:-1])
        masses[...] = expected.mass[:, None]
        demand = demands(robot, masses, varied)
        structure = np.swapaxes(demand.structure, -1, -2)
        inverse, null_space = inverse_and_null_space(structure[0])
        tensions = self._tensions_of_plan(masses[0], motion, demand.load[0], inverse)
        imbalance = demand.load + times_vector(structure, tensions)
        torques = textbook.motor_torques(robot, 0.0, demand.speeds, demand.pulley_accelerations)
        passive_actions = textbook.normalised_action(robot, torques, demand.speeds)
        # The force balance gives the change of the tensions as a function of the motion, up to the
        # null space. Tensions are in units of TENSION from here on.
        tension_slope = inverse @ self._difference_quotients(imbalance) / -TENSION
        passive_slope = self._difference_quotients(passive_actions)
        radius = textbook.loaded_radius(robot, demand.speeds[0])
        action_per_tension = TENSION * radius / robot.stall_torque
        per_tension = action_per_tension[..., None]
        action_slope = passive_slope + per_tension * tension_slope
        slope = np.concatenate([action_slope, tension_slope], axis=2)
        null_slope = np.concatenate([per_tension * null_space, null_space], axis=2)
        tensions = tensions / TENSION
        actions = passive_actions[0] + action_per_tension * tensions
        return Linearisation(
            plan=plans,
            strength=expected.strength,
            values=np.concatenate([actions, tensions], axis=2),
            slope=self._slope(slope),
            null_slope=null_slope,
        )

    def _varied(self, motion: Array) -> Array:
        """Motions (3, N, K, n), and after them those with a difference of one coordinate of X, Ẋ or
        Ẍ, (3, 1 + 3n, N, K, n)."""
        variations = np.arange(len(self._steps))
        order, coordinate = np.divmod(variations, self.robot.coordinates)
        varied = np.repeat(motion[:, None], 1 + len(variations), axis=1)
        varied[order, 1 + variations, ..., coordinate] += self._steps[:, None, None]
        return varied

    def _difference_quotients(self, values: Array) -> Array:
        """Derivatives with respect to (X, Ẋ, Ẍ), (N, K, size, 3n), of values at :meth:`_varied`, (1 +
        3n, N, K, size)."""
        differences = values[1:] - values[0]
        quotients = differences / self._steps[:, None, None, None]
        return np.moveaxis(quotients, 0, -1)

    def _tensions_of_plan(self, mass: Array, motion: Array, load: Array, inverse: Array) -> Array:
        """Tensions of unvaried motions with masses (N, K) and loads (N, K, n), (N, K, m) [N]."""
        if not self._has_null_space:
            return -times_vector(inverse, load)
        return inverse_dynamics(self.robot, mass, *motion, minimum=self.minimum_tension).tensions

    # The quadratic program minimises ½ z'Hz + g'z subject to A z ≤ b. The variables z are the changes
    # of the free control points, the null-space tensions, and the excesses of actions and errors
    # over their limits. The solver gets H = 1 by a change of variables, z = L⁻ᵀ w with H = LLᵀ: it
    # would need more time than BLAS for it.

    def assembled(self, linearisation: Linearisation, target: Target) -> Program:
        """Second part of an iteration: the quadratic programs."""
        fixed = self._fixed(target.error_bounds)
        poses, velocities, accelerations = self._bases[:, None] @ linearisation.plan
        errors = (poses - target.reference) / fixed.bounds
        end_velocity = (velocities[:, -1] - target.last_velocity) / fixed.bounds
        jumps = np.diff(accelerations, axis=1) / fixed.bounds
        limited_errors = errors[:, 1:]
        count = len(poses)
        matrix = np.repeat(fixed.matrix[None], count, axis=0)
        m = self.robot.cables
        slope = linearisation.slope
        null_slope = linearisation.null_slope
        # Actions have an upper limit, tensions a lower one.
        self._write_rows(matrix[:, self._actions], slope[:, :, :m], null_slope[:, :, :m])
        self._write_rows(matrix[:, self._tensions], -slope[:, :, m:], -null_slope[:, :, m:])
        lengths = self._write_lengths(matrix, fixed, limited_errors)
        hessian = np.zeros((count, self._columns, self._columns))
        hessian[:, self._motion, self._motion] = fixed.hessian
        null_space = np.arange(self._motion.stop, self._columns)
        hessian[:, null_space, null_space] += 1e-6  # makes the programs strictly convex
        gradient = np.zeros((count, self._columns))
        values = [errors.reshape(count, -1), end_velocity, jumps.reshape(count, -1)]
        gradient[:, self._motion] = times_vector(fixed.gradient, np.concatenate(values, axis=1))
        powers, power_slope = self._action_powers(linearisation, matrix[:, self._actions])
        hessian += np.swapaxes(power_slope, 1, 2) @ power_slope
        gradient += times_vector(np.swapaxes(power_slope, 1, 2), powers)
        free = self._free
        unwhitened = inverse_factors(hessian[:, free, free])
        return Program(
            plan=linearisation.plan,
            whitening=np.swapaxes(unwhitened, 1, 2),
            matrix=unwhitened @ np.swapaxes(matrix[:, :, free], 1, 2),
            start_matrix=matrix[:, :, self._start].copy(),
            limit=self._limits(linearisation, fixed, limited_errors, lengths),
            gradient=times_vector(unwhitened, gradient[:, free]),
            start_gradient=unwhitened @ hessian[:, free, self._start],
        )

    def solved(self, program: Program, start: Array) -> tuple[Array, str]:
        """Last part of an iteration: control points (N, points, n) of plans from their starts, and the
        reason of the first failure; NaN where there is none.

        Args:
            program: the quadratic programs; their plans have starts nearby.
            start: pose and derivatives at the start, (N, given, n).
        """
        plans = self._with_start(program.plan, start)
        count = len(plans)
        start_change = (plans - program.plan)[:, : self.given].reshape(count, -1)
        gradient = program.gradient + times_vector(program.start_gradient, start_change)
        limit = program.limit - times_vector(program.start_matrix, start_change)
        first_reason = ""
        inputs = self._quadratic.inputs
        for row in range(count):
            inputs["g"][:-2, 0] = gradient[row]
            inputs["a"][:, :-2] = program.matrix[row].T
            inputs["uba"][:, 0] = limit[row]
            try:
                if not (np.isfinite(gradient[row]).all() and np.isfinite(limit[row]).all()):
                    raise PlanningError("the linearised equations are not finite")
                change = program.whitening[row] @ self._quadratic()[:-2]
            except PlanningError as error:
                first_reason = first_reason or str(error)
                plans[row] = np.nan
                continue
            free_points = plans[row, self.given :]
            free_points += change[: free_points.size].reshape(free_points.shape)
        return plans, first_reason

    def _write_rows(self, rows: Array, slope: Array, null_slope: Array) -> None:
        """Writes the rows of actions or tensions, (N, K·m, columns)."""
        robots, count, m, _ = slope.shape
        rows = rows.reshape(robots, count, m, -1)
        rows[..., self._motion] = slope
        if self._has_null_space:
            instants = np.arange(count)
            null_rows = rows[..., self._null_space].reshape(robots, count, m, count, -1)
            null_rows[:, instants, :, instants] = np.swapaxes(null_slope, 0, 1)

    def _write_lengths(self, matrix: Array, fixed: _Fixed, errors: Array) -> Array:
        """Writes the rows of ‖e‖, linearised, and returns it at all instants but the first, (N, K −
        1)."""
        position = slice(self.robot.dimensions)
        position_errors = errors[..., position]
        lengths: Array = np.linalg.norm(position_errors, axis=-1)
        directions = position_errors / np.maximum(lengths, 1e-9)[..., None]
        slope = directions[:, :, None] @ fixed.error_slope[1:, position]
        matrix[:, self._lengths, self._motion] = slope[:, :, 0]
        return lengths

    def _action_powers(
        self, linearisation: Linearisation, action_rows: Array
    ) -> tuple[Array, Array]:
        """a^(p/2), whose sum of squares is the mean of aᵖ, (N, K·m), and their derivatives (N, K·m,
        columns)."""
        m = self.robot.cables
        count = len(self.instants)
        # The slope of a^(p/2) must not vanish.
        actions = np.maximum(linearisation.values[:, :, :m], 0.05)
        half = self.tuning.action_exponent / 2
        # The last instant counts half, as in the trapezoidal rule.
        weights = np.full((count, 1), 1 / count)
        weights[-1] /= 2
        roots = np.sqrt(weights)
        slope = half * actions ** (half - 1) * roots
        powers = roots * actions**half
        robots = len(actions)
        return powers.reshape(robots, -1), slope.reshape(robots, -1, 1) * action_rows

    def _limits(
        self, linearisation: Linearisation, fixed: _Fixed, errors: Array, lengths: Array
    ) -> Array:
        """Room of each plan to the limit of each row, (N, rows)."""
        m = self.robot.cables
        actions = linearisation.values[:, :, :m]
        tensions = linearisation.values[:, :, m:]
        largest_action = linearisation.strength[:, None] * (1 - self.tuning.margins.action)
        room = (
            largest_action - actions,
            tensions - self.minimum_tension / TENSION,
            fixed.limits[0] - lengths,
            fixed.limits - errors,
            fixed.limits + errors,
        )
        return np.concatenate([part.reshape(len(actions), -1) for part in room], axis=1)

    def _fixed_parts(self, error_bounds: ErrorBounds) -> _Fixed:
        """The parts of all programs with the same error bounds."""
        tuning = self.tuning
        margins = tuning.margins
        n = self.robot.coordinates
        count = len(self.instants)
        bounds = self._by_coordinate(error_bounds.position, error_bounds.rotation)
        margin = self._by_coordinate(margins.position, margins.rotation)
        position, velocity, acceleration = self._bases
        acceleration_steps = np.diff(acceleration, axis=0)
        bases = np.concatenate([position, velocity[-1:], acceleration_steps])
        slope = np.kron(bases, np.diag(1 / bounds))
        weights = np.empty(len(bases))
        weights[:count] = tuning.error_weight / count
        weights[count - 1] += tuning.end_error_weight
        time = _TIME_SCALE * self.horizon
        weights[count] = tuning.end_velocity_weight * time**2
        weights[count + 1 :] = tuning.smoothness_weight * time**4
        gradient = (slope * np.repeat(weights, n)[:, None]).T
        error_slope = slope[: count * n]
        limited_slope = error_slope[n:]
        # ‖e‖ is linearised. Additional bounds on each coordinate limit the linearisation error.
        matrix = np.zeros((self._rows, self._columns))
        matrix[self._errors, self._motion] = np.concatenate([limited_slope, -limited_slope])
        return _Fixed(
            bounds=bounds,
            limits=1 - margin / bounds,
            error_slope=error_slope.reshape(count, n, -1),
            matrix=matrix,
            hessian=gradient @ slope,
            gradient=gradient,
        )

    def _by_coordinate(self, position: float, rotation: float) -> Array:
        """A value for each coordinate, (n,)."""
        values = np.full(self.robot.coordinates, position, float)
        values[self.robot.dimensions :] = rotation
        return values

    def _slope(self, by_motion: Array) -> Array:
        """Converts derivatives with respect to (X, Ẋ, Ẍ), (N, K, rows, 3n), to those for the control
        points, (N, K, rows, points·n)."""
        robots, count, rows, _ = by_motion.shape
        n = self.robot.coordinates
        by_order = by_motion.reshape(robots, count, rows, 3, n).swapaxes(2, 3)
        by_order = by_order.reshape(robots, count, 3, rows * n)
        slope = np.moveaxis(self._bases, 0, -1) @ by_order
        by_point = slope.reshape(robots, count, self.points, rows, n).swapaxes(2, 3)
        return by_point.reshape(robots, count, rows, self.points * n)


def rigid_equivalent(robot: Robot) -> Robot:
    """The robot with stiff springs: motor and pulley are one inertia."""
    if not robot.flexible:
        return robot
    transmission = robot.transmission.replace(
        stiffness=None,
        motor_inertia=None,
        motor_damping=0.0,
        pulley_inertia=robot.pulley_inertia + robot.motor_inertia,
        damping=robot.damping + robot.motor_damping,
    )
    return robot.replace(transmission=transmission)


def has_plan(plans: Array) -> NDArray[np.bool_]:
    """Whether there is a plan, (N,), of plans that are NaN where there is none."""
    return np.asarray(np.isfinite(plans).all(axis=(1, 2)))
