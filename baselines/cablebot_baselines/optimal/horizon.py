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
from cablebot_gym.physics.inverse import demands, inverse_dynamics
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

_DIFFERENCE = 1e-6
"""Step of the difference quotients along X [m, rad] and Ẋ [m/s, rad/s]."""


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
    smoothness_weight: float
    """Weight of the sum of squared acceleration steps between instants, in bounds per (50 ms)²."""
    action_excess_weight: float = 100.0
    """Weight of the largest constraint violation of actions, in units of ±1, and of tensions, in
    units of 10 N."""
    error_excess_weight: float = 1000.0
    """Weight of the largest constraint violation of errors, in units of their bounds."""


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
        self.robot, self.tuning = robot, tuning
        self.minimum_tension = robot.minimum_tension + tuning.margins.tension
        """Minimum cable tension of the plans [N]."""
        knots = np.linspace(0.0, HORIZON, tuning.intervals + 1)
        self._knots = np.r_[np.zeros(_DEGREE), knots, np.full(_DEGREE, HORIZON)]
        # Greville abscissa of the second control point [s]
        self._second_point_time = float(knots[1]) / _DEGREE
        self.instants = np.linspace(0.0, HORIZON, tuning.intervals * tuning.instants + 1)
        """Times at which the constraints apply, (K,) [s]."""
        self._bases = self.basis(self.instants)
        self._bases_of_instants = np.moveaxis(self._bases, 0, -1)
        self._fit = np.linalg.pinv(self._bases[0])
        self.basis_at = lru_cache(maxsize=1024)(self.basis)
        """:meth:`basis` of one time, cached."""
        self.shift = lru_cache(maxsize=64)(self._shift)
        """Matrix from the control points of a plan to those of the plan from a later time on,
        (points, points), by extrapolation beyond the horizon; cached."""
        n = robot.coordinates
        m = robot.cables
        count = len(self.instants)
        self._positions = robot.dimensions
        self._start = 2 * n
        self._motion = (tuning.intervals + _DEGREE) * n
        self._null = (m - n) * count
        self._columns = self._motion + self._null
        self._action_per_tension = TENSION * robot.pulley_radius / robot.stall_torque
        # The load is linear in Ẍ.
        self._steps = np.repeat([_DIFFERENCE, _DIFFERENCE, 1.0], n)
        self._limited = 2 * m * count
        rows = self._limited + (1 + 2 * n) * (count - 1)
        self._fixed = lru_cache(maxsize=16)(self._fixed_parts)
        size = self._columns - self._start + 2
        dense = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(rows, size)}
        self._quadratic = _BufferedFunction(
            ca.conic("plan", "daqp", dense, {"error_on_fail": False})
        )
        self._write_excesses()

    def _write_excesses(self) -> None:
        """Writes what is the same in all programs into the arrays of the solver. The last two
        variables are the excesses of actions and errors."""
        inputs = self._quadratic.inputs
        inputs["h"][:] = np.eye(len(inputs["h"]))
        inputs["g"][-2:, 0] = self.tuning.action_excess_weight, self.tuning.error_excess_weight
        actions = slice(self._limited // 2)
        tensions = slice(self._limited // 2, self._limited)
        inputs["a"][actions, -2] = -1.0
        # Null-space tensions can always be raised. Without a null space the tension constraints are
        # soft, like those of the actions.
        if not self._null:
            inputs["a"][tensions, -2] = -0.2
        inputs["a"][self._limited :, -1] = -1.0
        inputs["lba"][:] = -np.inf
        # The excesses are at least 0.
        inputs["lbx"][:-2] = -np.inf
        inputs["ubx"][:] = np.inf

    def basis(self, times: Array | float) -> Array:
        """Matrices from control points to pose, velocity and acceleration at times in the horizon,
        (3, ..., points)."""
        spline = BSpline(self._knots, np.eye(len(self._knots) - _DEGREE - 1), _DEGREE)
        return np.stack([spline(times), spline.derivative(1)(times), spline.derivative(2)(times)])

    def _shift(self, time: float) -> Array:
        shift: Array = self._fit @ self.basis(self.instants + time)[0]
        return shift

    def plan(
        self,
        pose: Array,
        velocity: Array,
        target: Target,
        *,
        robot: ExpectedRobot,
        iterations: int = 1,
    ) -> Array:
        """Control points (points, n) of a plan, from the reference as the first guess.

        Args:
            pose: X, (n,) [m, rad].
            velocity: Ẋ, (n,) [m/s, rad/s].
            target: what the plan has to do.
            robot: what is expected of the robot.
            iterations: number of quadratic programs to solve in sequence.

        Raises:
            PlanningError: if one of the quadratic programs has no solution.
        """
        plan = self._with_start(self._fit @ target.reference, pose, velocity)
        for _ in range(iterations):
            program = self.assembled(self.linearised(plan, robot), target)
            plan = self.solved(program, pose, velocity)
        return plan

    def _with_start(self, plan: Array, pose: Array, velocity: Array) -> Array:
        """A plan with another start."""
        start = pose, pose + self._second_point_time * velocity
        return np.concatenate([start, plan[2:]])

    def linearised(self, plan: Array, expected: ExpectedRobot) -> Linearisation:
        """First part of an iteration: the robot, linearised about a plan.

        Raises:
            PlanningError: if the pose is singular.
        """
        robot, mass = self.robot, expected.mass
        motion = self._bases @ plan
        motion[2] -= expected.disturbance
        varied = self._varied(motion)
        demand = demands(robot, np.full(varied.shape[1:3], mass), varied)
        if not np.isfinite(demand.pulley_accelerations).all():
            raise PlanningError("the pose is singular")
        structure = np.swapaxes(demand.structure, -1, -2)
        try:
            inverse, null_space = _inverse_and_null_space(structure[0])
        except np.linalg.LinAlgError as error:
            raise PlanningError("the pose is singular") from error
        minimum = self.minimum_tension
        if not self._null:
            tensions = -times_vector(inverse, demand.load[0])
        elif robot.kind == "planar":
            tensions = inverse_dynamics(robot, mass, *motion, minimum=minimum).tensions
        else:
            speeds, accelerations = demand.speeds[0], demand.pulley_accelerations[0]
            tensions = textbook.least_action_tensions(
                robot, demand.structure[0], demand.load[0], speeds, accelerations, minimum
            )
        imbalance = demand.load + times_vector(structure, tensions)
        torques = textbook.motor_torques(robot, 0.0, demand.speeds, demand.pulley_accelerations)
        passive = textbook.normalised_action(robot, torques, demand.speeds)
        steps = self._steps[:, None, None]
        imbalance_slope = np.moveaxis((imbalance[1:] - imbalance[0]) / steps, 0, -1)
        passive_slope = np.moveaxis((passive[1:] - passive[0]) / steps, 0, -1)
        # The force balance gives the change of the tensions as a function of the motion, up to the
        # null space.
        tension_slope = inverse @ imbalance_slope / -TENSION
        per_tension = self._action_per_tension
        action_slope = passive_slope + per_tension[:, None] * tension_slope
        tensions = tensions / TENSION
        actions = passive[0] + per_tension * tensions
        return Linearisation(
            plan=plan,
            strength=expected.strength,
            values=np.concatenate([actions, tensions], axis=1),
            slope=self._slope(np.concatenate([action_slope, tension_slope], axis=1)),
            null_slope=np.concatenate([per_tension[:, None] * null_space, null_space], axis=1),
        )

    def _varied(self, motion: Array) -> Array:
        """A motion (3, K, n), and after it those with a difference of one coordinate of X, Ẋ or Ẍ,
        (3, 1 + 3n, K, n)."""
        rows = np.arange(len(self._steps))
        order, coordinate = np.divmod(rows, self.robot.coordinates)
        varied = np.repeat(motion[:, None], 1 + len(rows), axis=1)
        varied[order, 1 + rows, :, coordinate] += self._steps[:, None]
        return varied

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
        self._write_rows(fixed.matrix, linearisation)
        length = self._write_lengths(fixed, errors[1:])
        end_velocity = (velocities[-1] - target.last_velocity) / fixed.bounds
        jumps = np.diff(accelerations, axis=0) / fixed.bounds
        fixed_values = np.concatenate([errors.ravel(), end_velocity, jumps.ravel()])
        hessian = np.zeros((self._columns, self._columns))
        gradient = np.zeros(self._columns)
        hessian[: self._motion, : self._motion] = fixed.hessian
        gradient[: self._motion] = fixed.gradient @ fixed_values
        null = np.arange(self._motion, self._columns)
        hessian[null, null] += 1e-6  # makes the program strictly convex
        self._add_actions(hessian, gradient, linearisation.values, fixed.matrix)
        free = slice(self._start, None)
        factor, failed = dpotrf(hessian[free, free], lower=1)
        if failed or not np.isfinite(fixed.matrix).all():
            raise PlanningError("the linearised equations are not finite")
        whitening = dtrtri(factor, lower=1)[0].T
        room = (fixed.limits - errors[1:]).ravel(), (fixed.limits + errors[1:]).ravel()
        limits = *self._room(linearisation), fixed.limits[0] - length, *room
        return Program(
            plan=linearisation.plan,
            whitening=whitening,
            matrix=whitening.T @ fixed.matrix[:, free].T,
            start_matrix=fixed.matrix[:, : self._start].copy(),
            limit=np.concatenate(limits),
            gradient=gradient[free] @ whitening,
            start_gradient=whitening.T @ hessian[free, : self._start],
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
        moved = (plan - program.plan)[:2].ravel()
        inputs = self._quadratic.inputs
        inputs["g"][:-2, 0] = program.gradient + program.start_gradient @ moved
        inputs["a"][:, :-2] = program.matrix.T
        inputs["uba"][:, 0] = program.limit - program.start_matrix @ moved
        change = program.whitening @ self._solution()
        plan[2:] += change[: self._motion - self._start].reshape(-1, self.robot.coordinates)
        return plan

    def _write_rows(self, matrix: Array, linearisation: Linearisation) -> None:
        """Writes the rows of actions and tensions: actions have an upper limit, tensions a lower
        one."""
        m = self.robot.cables
        count = len(self.instants)
        rows = matrix[: self._limited].reshape(2, count, m, self._columns)
        slope = linearisation.slope.reshape(count, 2, m, self._motion)
        rows[0, :, :, : self._motion] = slope[:, 0]
        np.negative(slope[:, 1], out=rows[1, :, :, : self._motion])
        if self._null:
            null_slope = linearisation.null_slope.reshape(count, 2, m, -1)
            by_instant = rows[..., self._motion :].reshape(2, count, m, count, -1)
            each = np.arange(count)
            by_instant[0, each, :, each] = null_slope[:, 0]
            by_instant[1, each, :, each] = -null_slope[:, 1]

    def _room(self, linearisation: Linearisation) -> tuple[Array, Array]:
        """Room of actions and tensions to their limits, each (K·m,)."""
        m = self.robot.cables
        largest = linearisation.strength * (1 - self.tuning.margins.action)
        actions = largest - linearisation.values[:, :m]
        tensions = linearisation.values[:, m:] - self.minimum_tension / TENSION
        return actions.ravel(), tensions.ravel()

    def _write_lengths(self, fixed: _Fixed, errors: Array) -> Array:
        """Writes the rows of ‖e‖, linearised, and returns it at all instants but the first, (K −
        1,)."""
        position = slice(self._positions)
        length: Array = np.linalg.norm(errors[:, position], axis=1)
        direction = errors[:, position] / np.maximum(length, 1e-9)[:, None]
        slope = (direction[:, None] @ fixed.error_slope[1:, position])[:, 0]
        fixed.matrix[self._limited : self._limited + len(length), : self._motion] = slope
        return length

    def _add_actions(self, hessian: Array, gradient: Array, values: Array, matrix: Array) -> None:
        """Adds the mean of aᵖ, as the square of a^(p/2), to the objective."""
        m = self.robot.cables
        count = len(self.instants)
        positive = np.maximum(values[:, :m], 0.05)  # the slope of a^(p/2) must not vanish
        half = self.tuning.action_exponent / 2
        # The last instant counts half, as in the trapezoidal rule.
        weights = np.full((count, 1), 1 / count)
        weights[-1] /= 2
        power_slope = half * positive ** (half - 1) * np.sqrt(weights)
        slope = power_slope.reshape(-1, 1) * matrix[: self._limited // 2]
        hessian += slope.T @ slope
        gradient += (np.sqrt(weights) * positive**half).ravel() @ slope

    def _fixed_parts(self, error_bounds: ErrorBounds) -> _Fixed:
        """The parts of all programs with the same error bounds."""
        tuning, margins = self.tuning, self.tuning.margins
        n, count = self.robot.coordinates, len(self.instants)
        bounds = self._by_coordinate(error_bounds.position, error_bounds.rotation)
        position, velocity, acceleration = self._bases
        per_bound = np.diag(1 / bounds)
        error_slope = np.kron(position, per_bound)
        end_velocity_slope = np.kron(velocity[-1:], per_bound)
        jump_slope = np.kron(np.diff(acceleration, axis=0), per_bound)
        slope = np.concatenate([error_slope, end_velocity_slope, jump_slope])
        weights = np.zeros(len(slope))
        weights[: n * count] = tuning.error_weight / count
        weights[n * (count - 1) : n * count] += tuning.end_error_weight
        weights[n * count : n * (count + 1)] = tuning.end_velocity_weight * _TIME_SCALE**2
        weights[n * (count + 1) :] = tuning.smoothness_weight * _TIME_SCALE**4
        gradient = (slope * weights[:, None]).T
        matrix = np.zeros((len(self._quadratic.inputs["uba"]), self._columns))
        # The initial state is given, so error constraints start at the second instant. ‖e‖ is
        # linearised. Additional bounds on each coordinate limit the linearisation error.
        first = self._limited + count - 1
        matrix[first:, : self._motion] = np.concatenate([error_slope[n:], -error_slope[n:]])
        return _Fixed(
            bounds=bounds,
            limits=1 - self._by_coordinate(margins.position, margins.rotation) / bounds,
            error_slope=error_slope.reshape(count, n, -1),
            matrix=matrix,
            hessian=gradient @ slope,
            gradient=gradient,
        )

    def _by_coordinate(self, position: float, rotation: float) -> Array:
        """A value for each coordinate, (n,)."""
        is_position = np.arange(self.robot.coordinates) < self._positions
        return np.where(is_position, position, rotation)

    def _slope(self, by_motion: Array) -> Array:
        """Converts derivatives with respect to (X, Ẋ, Ẍ), (K, rows, 3n), to those for the control
        points, (K, rows, points·n)."""
        count, rows, _ = by_motion.shape
        n = self.robot.coordinates
        by_order = np.swapaxes(by_motion.reshape(count, rows, 3, n), 1, 2)
        slope = self._bases_of_instants @ by_order.reshape(count, 3, rows * n)
        return np.swapaxes(slope.reshape(count, -1, rows, n), 1, 2).reshape(count, rows, -1)

    def _solution(self) -> Array:
        """Solves the program and returns the variables without the excesses."""
        for name in ("g", "uba"):
            if not np.all(np.isfinite(self._quadratic.inputs[name])):
                raise PlanningError("the linearised equations are not finite")
        try:
            variables = self._quadratic()["x"][:-2, 0]
        except RuntimeError as error:
            raise PlanningError(str(error)) from error
        if not (self._quadratic.succeeded and np.all(np.isfinite(variables))):
            raise PlanningError("the solver failed")
        return variables


class _BufferedFunction:
    """CasADi function that reads and writes NumPy arrays in place. Matrix conversion would take
    longer than the solver.

    Args:
        function: CasADi function with dense arguments.
    """

    def __init__(self, function: Any) -> None:
        self._buffer, self._evaluate = function.buffer()
        self.inputs: dict[str, Array] = {}
        """Input arrays by name, column-major. The caller writes to them."""
        self._outputs: dict[str, Array] = {}
        for index in range(function.n_in()):
            flat: Any = np.zeros(function.numel_in(index))
            if flat.size:
                self._buffer.set_arg(index, memoryview(flat))
                self.inputs[function.name_in(index)] = flat.reshape(
                    function.size_in(index), order="F"
                )
        for index in range(function.n_out()):
            flat = np.zeros(function.numel_out(index))
            self._buffer.set_res(index, memoryview(flat))
            self._outputs[function.name_out(index)] = flat.reshape(
                function.size_out(index), order="F"
            )

    def __call__(self) -> dict[str, Array]:
        """Evaluates the function and returns the results by name. The next call overwrites them.

        Raises:
            RuntimeError: if CasADi rejects the inputs.
        """
        self._evaluate()
        return self._outputs

    @property
    def succeeded(self) -> bool:
        """Whether the last call of a solver succeeded."""
        return bool(self._buffer.stats()["success"])


def _inverse_and_null_space(forces: Array) -> tuple[Array, Array]:
    """Pseudoinverses (K, m, n) and null spaces (K, m, m − n) of matrices (K, n, m).

    Raises:
        numpy.linalg.LinAlgError: if a square matrix is singular, or a number is not finite.
    """
    _, n, m = forces.shape
    if n == m:
        return np.linalg.inv(forces), np.zeros((len(forces), m, 0))
    left, values, right = np.linalg.svd(forces)
    right = np.swapaxes(right, 1, 2)
    inverse = right[:, :, :n] @ np.swapaxes(left / values[:, None], 1, 2)
    return inverse, right[:, :, n:]
