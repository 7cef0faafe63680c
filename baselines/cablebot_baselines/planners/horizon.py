"""Quadratic program of the receding-horizon controller.

It plans the motion of the next 0.2 s as a spline within the error bounds that needs small motor
actions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg.lapack import dpotrf, dtrtri

from cablebot_gym.envs.observation import PREVIEWS
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import Demands, demands, inverse_dynamics
from cablebot_gym.physics.textbook import times_vector
from cablebot_gym.planning import Margins
from cablebot_gym.planning.stage_functions import TENSION, check_model, import_casadi
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds

HORIZON = PREVIEWS[-1]
"""Planning horizon [s]; it equals the longest preview of the reference."""

_DEGREE = 3
"""Degree of the spline; the acceleration is linear between knots."""

_TIME_SCALE = 0.05
"""Time that scales velocities (bound per time) and accelerations (bound per time²) [s]."""

_FIRST_ITERATIONS = 3
"""Number of quadratic programs for a plan without a previous plan as initial guess."""

_DIFFERENCE = 1e-6
"""Step of the difference quotients along X [m, rad] and Ẋ [m/s, rad/s]."""


_SMOOTHNESS_WEIGHT = 1e-6
"""Weight of the sum of squared acceleration steps between instants, in bounds per (50 ms)²."""

_ACTION_EXCESS_WEIGHT = 100.0
"""Weight of the largest constraint violation of actions, in units of ±1, and of tensions, in units of
10 N."""

_ERROR_EXCESS_WEIGHT = 1000.0
"""Weight of the largest constraint violation of errors, in units of their bounds."""


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Discretisation and objective weights of a plan. Errors are in units of their bounds, actions
    in units of ±1."""

    intervals: int
    """Number of spline intervals."""
    instants: int
    """Number of instants of each interval at which the constraints apply."""
    margins: Margins
    """Margins to the constraints, which the tracking law uses to correct errors."""
    action_exponent: float
    """p ≥ 2 of the objective, the mean of aᵖ over motors and instants. A larger p penalises peaks
    more."""
    error_weight: float
    """Weight of the mean square error."""
    end_error_weight: float
    """Weight of the squared error at the end of the horizon; the reference after it is unknown."""
    end_velocity_weight: float
    """Weight of the squared velocity error at the end of the horizon, in bounds per 50 ms."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedRobot:
    """What is expected of a robot within the horizon."""

    mass: float
    """Mass of platform and payload [kg]."""
    strength: Array | float = 1.0
    """Strength of each motor as a fraction of the nominal one, (m,)."""
    disturbance: Array | float = 0.0
    """Acceleration by a wrench, (n,) [m/s², rad/s²]."""


class PlanningError(RuntimeError):
    """The quadratic program has no solution, or the solver failed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """What a plan has to do."""

    reference: Array
    """X_d at :attr:`HorizonProgram.instants`, (K, n)."""
    last_velocity: Array
    """Ẋ_d at the end of the horizon, (n,)."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearisation:
    """Actions and tensions, linearised about a plan. Rows are the actions and then the tensions, in
    units of ``TENSION``, of all motors."""

    plan: Array
    """Control points (points, n)."""
    strength: Array | float
    """Strength of each motor as a fraction of the nominal one, (m,)."""
    values: Array
    """Actions and tensions at the instants, (K, 2m)."""
    slope: Array
    """Derivatives with respect to the control points, (K, 2m, points·n)."""
    null_slope: Array
    """Derivatives with respect to the null-space tensions of the same instant, (K, 2m, m − n)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """Quadratic program for the change of a plan whose start is not yet given: ``½ w'w + (g + G s)'w``
    subject to ``A w ≤ b − B s``, with the change s of the first two control points. The excesses
    are not part of w here."""

    plan: Array
    """Control points (points, n)."""
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
    """Constraint matrix, (rows, columns). The next program overwrites the rows that are not
    fixed."""
    hessian: Array
    """Hessian of the terms of errors, last velocity and acceleration steps, (points·n, points·n)."""
    gradient: Array
    """Derivative of the gradient of these terms with respect to their values, (points·n,
    values)."""


class HorizonProgram:
    """Plans X(t) for t from 0 to :data:`HORIZON` from a given state, as a cubic spline with evenly
    spaced knots.

    Each iteration linearises the robot about the last plan and solves one quadratic program for the
    control points. If the robot has more cables than coordinates, the null-space tensions are free
    variables at each instant. Constraints are soft with weights far above all others, so a plan
    exists from every state. The Gauss–Newton method treats aᵖ as the square of a^(p/2).

    Args:
        robot: rigid robot.
        tuning: discretisation and objective weights.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if the motors of the robot have a lag.
    """

    def __init__(self, robot: Robot, tuning: Tuning) -> None:
        ca = import_casadi()
        check_model(robot)
        self.robot = robot
        self.tuning = tuning
        self.minimum_tension = robot.minimum_tension + tuning.margins.tension
        """Minimum cable tension of the plans [N]."""
        knots = np.linspace(0.0, HORIZON, tuning.intervals + 1)
        self._knots = np.pad(knots, _DEGREE, mode="edge")
        # Greville abscissa of the second control point [s]
        self._second_point_time = float(knots[1]) / _DEGREE
        count = tuning.intervals * tuning.instants + 1
        self.instants = np.linspace(0.0, HORIZON, count)
        """Times at which the constraints apply, (K,) [s]."""
        self._bases = self.basis(self.instants)
        self._fit = np.linalg.pinv(self._bases[0])
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
        # Columns: the control points, of which the first two are given, and the null-space tensions.
        motion = n * (tuning.intervals + _DEGREE)
        self._columns = motion + count * (m - n)
        self._start = slice(2 * n)
        self._free = slice(2 * n, None)
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
        variables = self._columns - 2 * n + 2
        dense = {
            "h": ca.Sparsity.dense(variables, variables),
            "a": ca.Sparsity.dense(self._rows, variables),
        }
        solver = ca.conic("plan", "daqp", dense, {"error_on_fail": False})
        self._quadratic = _BufferedSolver(solver)
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
        """Matrices from control points to pose, velocity and acceleration at times in the horizon,
        (3, ..., points)."""
        points = len(self._knots) - _DEGREE - 1
        pose = BSpline(self._knots, np.eye(points), _DEGREE)
        velocity = pose.derivative(1)
        acceleration = pose.derivative(2)
        return np.stack([pose(times), velocity(times), acceleration(times)])

    def _shift(self, time: float) -> Array:
        pose, _, _ = self.basis(self.instants + time)
        return self._fit @ pose

    def plan(
        self,
        pose: Array,
        velocity: Array,
        target: Target,
        *,
        robot: ExpectedRobot,
    ) -> Array:
        """Control points (points, n) of a plan, from the reference as the first guess.

        Args:
            pose: X, (n,) [m, rad].
            velocity: Ẋ, (n,) [m/s, rad/s].
            target: what the plan has to do.
            robot: what is expected of the robot.

        Raises:
            PlanningError: if one of the quadratic programs has no solution.
        """
        plan = self._with_start(self._fit @ target.reference, pose, velocity)
        for _ in range(_FIRST_ITERATIONS):
            program = self.assembled(self.linearised(plan, robot), target)
            plan = self.solved(program, pose, velocity)
        return plan

    def _with_start(self, plan: Array, pose: Array, velocity: Array) -> Array:
        """A plan with another start."""
        second_point = pose + self._second_point_time * velocity
        return np.vstack([pose, second_point, plan[2:]])

    def linearised(self, plan: Array, expected: ExpectedRobot) -> Linearisation:
        """First part of an iteration: the robot, linearised about a plan.

        Raises:
            PlanningError: if the pose is singular.
        """
        robot = self.robot
        mass = expected.mass
        motion = self._bases @ plan
        motion[2] -= expected.disturbance
        varied = self._varied(motion)
        masses = np.full(varied.shape[1:3], mass)
        demand = demands(robot, masses, varied)
        structure = np.swapaxes(demand.structure, -1, -2)
        try:
            inverse, null_space = _inverse_and_null_space(structure[0])
        except np.linalg.LinAlgError as error:
            raise PlanningError("the pose is singular") from error
        tensions = self._tensions_of_plan(mass, motion, demand, inverse)
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
        slope = np.concatenate([action_slope, tension_slope], axis=1)
        null_slope = np.concatenate([per_tension * null_space, null_space], axis=1)
        tensions = tensions / TENSION
        actions = passive_actions[0] + action_per_tension * tensions
        return Linearisation(
            plan=plan,
            strength=expected.strength,
            values=np.concatenate([actions, tensions], axis=1),
            slope=self._slope(slope),
            null_slope=null_slope,
        )

    def _varied(self, motion: Array) -> Array:
        """A motion (3, K, n), and after it those with a difference of one coordinate of X, Ẋ or Ẍ,
        (3, 1 + 3n, K, n)."""
        variations = np.arange(len(self._steps))
        order, coordinate = np.divmod(variations, self.robot.coordinates)
        varied = np.repeat(motion[:, None], 1 + len(variations), axis=1)
        varied[order, 1 + variations, :, coordinate] += self._steps[:, None]
        return varied

    def _difference_quotients(self, values: Array) -> Array:
        """Derivatives with respect to (X, Ẋ, Ẍ), (K, size, 3n), of values at :meth:`_varied`, (1 +
        3n, K, size)."""
        differences = values[1:] - values[0]
        quotients = differences / self._steps[:, None, None]
        return np.moveaxis(quotients, 0, -1)

    def _tensions_of_plan(
        self, mass: float, motion: Array, demand: Demands, inverse: Array
    ) -> Array:
        """Tensions of an unvaried motion, (K, m) [N]."""
        robot = self.robot
        minimum = self.minimum_tension
        load = demand.load[0]
        if not self._has_null_space:
            return -times_vector(inverse, load)
        if robot.kind == "planar":
            return inverse_dynamics(robot, mass, *motion, minimum=minimum).tensions
        structure = demand.structure[0]
        speeds = demand.speeds[0]
        accelerations = demand.pulley_accelerations[0]
        return textbook.least_action_tensions(
            robot, structure, load, speeds, accelerations, minimum
        )

    # The quadratic program minimises ½ z'Hz + g'z subject to A z ≤ b. The variables z are the changes
    # of the free control points, the null-space tensions, and the excesses of actions and errors
    # over their limits. The solver gets H = 1 by a change of variables, z = L⁻ᵀ w with H = LLᵀ: it
    # would need more time than BLAS for it.

    def assembled(self, linearisation: Linearisation, target: Target) -> Program:
        """Second part of an iteration: the quadratic program.

        Raises:
            PlanningError: if a number is not finite.
        """
        fixed = self._fixed(target.error_bounds)
        poses, velocities, accelerations = self._bases @ linearisation.plan
        errors = (poses - target.reference) / fixed.bounds
        end_velocity = (velocities[-1] - target.last_velocity) / fixed.bounds
        jumps = np.diff(accelerations, axis=0) / fixed.bounds
        limited_errors = errors[1:]
        matrix = fixed.matrix
        m = self.robot.cables
        slope = linearisation.slope
        null_slope = linearisation.null_slope
        # Actions have an upper limit, tensions a lower one.
        self._write_rows(matrix[self._actions], slope[:, :m], null_slope[:, :m])
        self._write_rows(matrix[self._tensions], -slope[:, m:], -null_slope[:, m:])
        lengths = self._write_lengths(fixed, limited_errors)
        hessian = np.zeros((self._columns, self._columns))
        hessian[self._motion, self._motion] = fixed.hessian
        null_space = np.arange(self._motion.stop, self._columns)
        hessian[null_space, null_space] += 1e-6  # makes the program strictly convex
        gradient = np.zeros(self._columns)
        fixed_values = np.concatenate([errors, end_velocity[None], jumps], axis=None)
        gradient[self._motion] = fixed.gradient @ fixed_values
        powers, power_slope = self._action_powers(linearisation, matrix[self._actions])
        hessian += power_slope.T @ power_slope
        gradient += powers @ power_slope
        free = self._free
        factor, failed = dpotrf(hessian[free, free], lower=1)
        if failed or not np.isfinite(matrix).all():
            raise PlanningError("the linearised equations are not finite")
        whitening = dtrtri(factor, lower=1)[0].T
        return Program(
            plan=linearisation.plan,
            whitening=whitening,
            matrix=whitening.T @ matrix[:, free].T,
            start_matrix=matrix[:, self._start].copy(),
            limit=self._limits(linearisation, fixed, limited_errors, lengths),
            gradient=gradient[free] @ whitening,
            start_gradient=whitening.T @ hessian[free, self._start],
        )

    def solved(self, program: Program, pose: Array, velocity: Array) -> Array:
        """Last part of an iteration: control points (points, n) of a plan from a start.

        Args:
            program: the quadratic program; its plan has a start nearby.
            pose: X, (n,) [m, rad].
            velocity: Ẋ, (n,) [m/s, rad/s].

        Raises:
            PlanningError: if the program has no solution.
        """
        plan = self._with_start(program.plan, pose, velocity)
        start_change = (plan - program.plan)[:2].ravel()
        gradient = program.gradient + program.start_gradient @ start_change
        limit = program.limit - program.start_matrix @ start_change
        if not (np.isfinite(gradient).all() and np.isfinite(limit).all()):
            raise PlanningError("the linearised equations are not finite")
        inputs = self._quadratic.inputs
        inputs["g"][:-2, 0] = gradient
        inputs["a"][:, :-2] = program.matrix.T
        inputs["uba"][:, 0] = limit
        change = program.whitening @ self._quadratic()[:-2]
        free_points = plan[2:]
        point_changes = change[: free_points.size]
        free_points += point_changes.reshape(free_points.shape)
        return plan

    def _write_rows(self, rows: Array, slope: Array, null_slope: Array) -> None:
        """Writes the rows of actions or tensions, (K·m, columns)."""
        count, m, _ = slope.shape
        rows = rows.reshape(count, m, -1)
        rows[:, :, self._motion] = slope
        if self._has_null_space:
            instants = np.arange(count)
            null_rows = rows[:, :, self._null_space].reshape(count, m, count, -1)
            null_rows[instants, :, instants] = null_slope

    def _write_lengths(self, fixed: _Fixed, errors: Array) -> Array:
        """Writes the rows of ‖e‖, linearised, and returns it at all instants but the first, (K −
        1,)."""
        position = slice(self.robot.dimensions)
        position_errors = errors[:, position]
        lengths: Array = np.linalg.norm(position_errors, axis=1)
        directions = position_errors / np.maximum(lengths, 1e-9)[:, None]
        slope = directions[:, None] @ fixed.error_slope[1:, position]
        fixed.matrix[self._lengths, self._motion] = slope[:, 0]
        return lengths

    def _action_powers(
        self, linearisation: Linearisation, action_rows: Array
    ) -> tuple[Array, Array]:
        """a^(p/2), whose sum of squares is the mean of aᵖ, (K·m,), and their derivatives (K·m,
        columns)."""
        m = self.robot.cables
        count = len(self.instants)
        # The slope of a^(p/2) must not vanish.
        actions = np.maximum(linearisation.values[:, :m], 0.05)
        half = self.tuning.action_exponent / 2
        # The last instant counts half, as in the trapezoidal rule.
        weights = np.full((count, 1), 1 / count)
        weights[-1] /= 2
        roots = np.sqrt(weights)
        slope = half * actions ** (half - 1) * roots
        powers = roots * actions**half
        return powers.ravel(), slope.reshape(-1, 1) * action_rows

    def _limits(
        self, linearisation: Linearisation, fixed: _Fixed, errors: Array, lengths: Array
    ) -> Array:
        """Room of a plan to the limit of each row, (rows,)."""
        m = self.robot.cables
        actions = linearisation.values[:, :m]
        tensions = linearisation.values[:, m:]
        largest_action = linearisation.strength * (1 - self.tuning.margins.action)
        room = (
            largest_action - actions,
            tensions - self.minimum_tension / TENSION,
            fixed.limits[0] - lengths,
            fixed.limits - errors,
            fixed.limits + errors,
        )
        return np.concatenate(room, axis=None)

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
        weights[count] = tuning.end_velocity_weight * _TIME_SCALE**2
        weights[count + 1 :] = _SMOOTHNESS_WEIGHT * _TIME_SCALE**4
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
        """Converts derivatives with respect to (X, Ẋ, Ẍ), (K, rows, 3n), to those for the control
        points, (K, rows, points·n)."""
        count, rows, _ = by_motion.shape
        n = self.robot.coordinates
        by_order = by_motion.reshape(count, rows, 3, n).swapaxes(1, 2)
        slope = np.moveaxis(self._bases, 0, -1) @ by_order.reshape(count, 3, rows * n)
        by_point = slope.reshape(count, -1, rows, n).swapaxes(1, 2)
        return by_point.reshape(count, rows, -1)


class _BufferedSolver:
    """CasADi solver that reads and writes NumPy arrays in place. Matrix conversion would take
    longer than the solver.

    Args:
        solver: solver of a quadratic program with dense arguments.
    """

    def __init__(self, solver: Any) -> None:
        self._buffer, self._evaluate = solver.buffer()
        self.inputs: dict[str, Array] = {}
        """Input arrays by name, column-major. The caller writes to them."""
        for index in range(solver.n_in()):
            flat: Any = np.zeros(solver.numel_in(index))
            if flat.size:
                self._buffer.set_arg(index, memoryview(flat))
                name = solver.name_in(index)
                shape = solver.size_in(index)
                self.inputs[name] = flat.reshape(shape, order="F")
        variables: Any = np.zeros(solver.numel_out("x"))
        self._buffer.set_res(solver.index_out("x"), memoryview(variables))
        self._variables: Array = variables

    def __call__(self) -> Array:
        """Solves the program and returns its variables. The next call overwrites them.

        Raises:
            PlanningError: if CasADi rejects the inputs, or the solver fails.
        """
        try:
            self._evaluate()
        except RuntimeError as error:
            raise PlanningError(str(error)) from error
        if not (self._buffer.stats()["success"] and np.isfinite(self._variables).all()):
            raise PlanningError("the solver failed")
        return self._variables


def _inverse_and_null_space(forces: Array) -> tuple[Array, Array]:
    """Pseudoinverses (K, m, n) and null spaces (K, m, m − n) of matrices (K, n, m).

    Raises:
        numpy.linalg.LinAlgError: if a square matrix is singular, or a number is not finite.
    """
    _, n, m = forces.shape
    if n == m:
        no_null_space = np.zeros((len(forces), m, 0))
        return np.linalg.inv(forces), no_null_space
    left, singular_values, right = np.linalg.svd(forces)
    right = np.swapaxes(right, 1, 2)
    left = np.swapaxes(left / singular_values[:, None], 1, 2)
    inverse = right[:, :, :n] @ left
    null_space = right[:, :, n:]
    return inverse, null_space
