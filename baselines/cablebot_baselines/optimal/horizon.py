"""Quadratic program of the receding-horizon controller.

It plans the motion of the next 0.2 s as a spline within the error bounds that needs small motor
actions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from cablebot_gym.envs.observation import PREVIEWS
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.planning import Margins
from cablebot_gym.planning.stage_functions import TENSION, check_model, import_casadi, rigid_stage
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds

HORIZON = PREVIEWS[-1]
"""Planning horizon [s]; it equals the longest preview of the reference."""

_DEGREE = 3
"""Degree of the spline; the acceleration is linear between knots."""

_TIME_SCALE = 0.05
"""Time that scales velocities (bound per time) and accelerations (bound per time²) [s]."""


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


class _Model(NamedTuple):
    """Actions and tensions, linearised about a plan."""

    action: Array
    """Actions, (K, m)."""
    action_slope: Array
    """Derivatives of the actions with respect to the variables, (K·m, variables)."""
    tension: Array
    """Tensions in units of ``TENSION``, (K, m)."""
    tension_slope: Array
    """Derivatives of the tensions, (K·m, variables)."""


class _Constraint(NamedTuple):
    """``slope z + excess_factors · (excess of actions, excess of errors) ≤ limit``, one row for each
    limit."""

    slope: Array
    """Coefficients of the first variables, (rows, ...). Those of the further variables are 0."""
    excess_factors: tuple[float, float]
    """Coefficients of the two excesses, the last variables."""
    limit: Array
    """Upper limits, any shape with one value for each row."""


class _SquaredTerm(NamedTuple):
    """Term of the objective: half the sum of weight · (value + slope z)²."""

    slope: Array
    """Coefficients of the first variables, (rows, ...)."""
    value: Array
    """Value without change of the plan, any shape with one value for each row."""
    weight: Array | float
    """Weight of each row, or of all rows."""


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
        self._fit = np.linalg.pinv(self._bases[0])
        self.basis_at = lru_cache(maxsize=1024)(self.basis)
        """:meth:`basis` of one time, cached."""
        n = robot.coordinates
        m = robot.cables
        count = len(self.instants)
        self._positions = robot.dimensions
        self._motion = (tuning.intervals + _DEGREE - 2) * n
        self._null = (m - n) * count
        self._size = self._motion + self._null + 2
        function = rigid_stage(robot)
        arguments = ca.SX.sym("w", function.size1_in(0))
        values = function(arguments)
        slope = ca.densify(ca.jacobian(values, arguments[: 3 * n + m]))
        names = ["motion"], ["values", "slopes"]
        linear = ca.Function("linear", [arguments], [values, slope], *names, {"cse": True})
        self._linear = _BufferedFunction(linear.map(count))
        rows = 2 * m * count + (1 + 2 * n) * (count - 1)
        dense = {
            "h": ca.Sparsity.dense(self._size, self._size),
            "a": ca.Sparsity.dense(rows, self._size),
        }
        self._quadratic = _BufferedFunction(
            ca.conic("plan", "daqp", dense, {"error_on_fail": False})
        )
        # The last two variables, the excesses, are at least 0.
        self._quadratic.inputs["lbx"][:-2] = -np.inf
        self._quadratic.inputs["ubx"][:] = np.inf

    def basis(self, times: Array | float) -> Array:
        """Matrices from control points to pose, velocity and acceleration at times in the horizon,
        (3, ..., points)."""
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
        robot: ExpectedRobot,
        error_bounds: ErrorBounds,
        iterations: int = 1,
    ) -> Array:
        """Control points (points, n) of a plan.

        Args:
            guess: poses at :attr:`instants` for the first linearisation, (K, n).
            pose: X, (n,) [m, rad].
            velocity: Ẋ, (n,) [m/s, rad/s].
            reference: X_d at :attr:`instants`, (K, n).
            last_velocity: Ẋ_d at the end of the horizon, (n,).
            robot: what is expected of the robot.
            error_bounds: bounds of the tracking errors.
            iterations: number of quadratic programs to solve in sequence.

        Raises:
            PlanningError: if one of the quadratic programs has no solution.
        """
        plan: Array = self._fit @ guess
        plan[0], plan[1] = pose, pose + self._second_point_time * velocity
        for _ in range(iterations):
            try:
                self._write_program(plan, reference, last_velocity, robot, error_bounds)
            except np.linalg.LinAlgError as error:
                raise PlanningError("the pose is singular") from error
            plan[2:] += self._solution().reshape(-1, self.robot.coordinates)
        return plan

    # The quadratic program minimises ½ z'Hz + g'z subject to low ≤ A z ≤ high. The variables z are
    # the changes of the free control points, the null-space tensions, and the excesses of actions
    # and errors over their limits.

    def _write_program(
        self,
        plan: Array,
        reference: Array,
        last_velocity: Array,
        robot: ExpectedRobot,
        error_bounds: ErrorBounds,
    ) -> None:
        """Writes the quadratic program, linearised about a plan, into the arrays of the solver."""
        bounds = self._by_coordinate(error_bounds.position, error_bounds.rotation)
        poses, velocities, accelerations = self._bases @ plan
        forced = accelerations - robot.disturbance
        model = self._linearised(poses, velocities, forced, robot.mass)
        errors = (poses - reference) / bounds
        n = self.robot.coordinates
        shape = (len(self.instants), n, 3 * n)
        error_slope = self._slope(np.broadcast_to(np.eye(n, 3 * n) / bounds[:, None], shape))
        inputs = self._quadratic.inputs
        row = 0
        for constraint in self._constraints(model, errors, error_slope, bounds, robot.strength):
            rows = slice(row, row + len(constraint.slope))
            inputs["a"][rows, : constraint.slope.shape[1]] = constraint.slope
            inputs["a"][rows, -2:] = constraint.excess_factors
            inputs["lba"][rows, 0] = -np.inf
            inputs["uba"][rows, 0] = constraint.limit.ravel()
            row = rows.stop
        hessian = inputs["h"]
        gradient = inputs["g"][:, 0]
        hessian[:] = 0.0
        gradient[:] = 0.0
        terms = [
            *self._tracking_terms(model.action, model.action_slope, errors, error_slope),
            *self._motion_terms(velocities[-1] - last_velocity, accelerations, bounds),
        ]
        for term in terms:
            z = slice(term.slope.shape[1])
            weighted = term.slope.T * term.weight
            hessian[z, z] += weighted @ term.slope
            gradient[z] += weighted @ term.value.ravel()
        null = np.arange(self._motion, self._motion + self._null)
        hessian[null, null] += 1e-6  # makes the program strictly convex
        hessian[[-2, -1], [-2, -1]] = 1.0
        gradient[-2:] = self.tuning.action_excess_weight, self.tuning.error_excess_weight

    def _by_coordinate(self, position: float, rotation: float) -> Array:
        """A value for each coordinate, (n,)."""
        is_position = np.arange(self.robot.coordinates) < self._positions
        return np.where(is_position, position, rotation)

    def _constraints(
        self,
        model: _Model,
        errors: Array,
        error_slope: Array,
        bounds: Array,
        strength: Array | float,
    ) -> list[_Constraint]:
        """Constraints of actions, tensions and errors; errors are in units of their bounds."""
        margins = self.tuning.margins
        largest_action = strength * (1 - margins.action)
        actions = _Constraint(model.action_slope, (-1, 0), largest_action - model.action)
        # Null-space tensions can always be raised. Without a null space the tension constraints are
        # soft, like those of the actions.
        tension_factor = -0.2
        if self._null:
            tension_factor = 0
        reserve = model.tension - self.minimum_tension / TENSION
        tensions = _Constraint(-model.tension_slope, (tension_factor, 0), reserve)
        # The initial state is given, so error constraints start at the second instant. ‖e‖ is
        # linearised. Additional bounds on each coordinate limit the linearisation error.
        errors = errors[1:]
        by_instant = error_slope.reshape(len(self.instants), self.robot.coordinates, -1)[1:]
        limits = 1 - self._by_coordinate(margins.position, margins.rotation) / bounds
        position = slice(self._positions)
        length = np.linalg.norm(errors[:, position], axis=1)
        direction = errors[:, position] / np.maximum(length, 1e-9)[:, None]
        length_slope = np.einsum("kl,klz->kz", direction, by_instant[:, position])
        slope = by_instant.reshape(-1, self._motion)
        return [
            actions,
            tensions,
            _Constraint(length_slope, (0, -1), limits[0] - length),
            _Constraint(slope, (0, -1), limits - errors),
            _Constraint(-slope, (0, -1), limits + errors),
        ]

    def _tracking_terms(
        self, action: Array, action_slope: Array, errors: Array, error_slope: Array
    ) -> list[_SquaredTerm]:
        """Terms of the actions and of the errors; errors are in units of their bounds."""
        tuning = self.tuning
        count = len(self.instants)
        positive = np.maximum(action.ravel(), 0.05)  # the slope of a^(p/2) must not vanish
        half = tuning.action_exponent / 2
        power_slope = half * positive[:, None] ** (half - 1) * action_slope
        # The last instant counts half, as in the trapezoidal rule.
        weights = np.repeat(np.r_[np.ones(count - 1), 0.5] / count, self.robot.cables)
        end_slope = error_slope.reshape(count, self.robot.coordinates, -1)[-1]
        return [
            _SquaredTerm(power_slope, positive**half, weights),
            _SquaredTerm(error_slope, errors, tuning.error_weight / count),
            _SquaredTerm(end_slope, errors[-1], tuning.end_error_weight),
        ]

    def _motion_terms(
        self, end_velocity_error: Array, accelerations: Array, bounds: Array
    ) -> list[_SquaredTerm]:
        """Terms of the velocity error at the end and of the acceleration steps."""
        _, velocity_basis, acceleration_basis = self._bases
        unit = bounds / _TIME_SCALE
        end_slope = np.kron(velocity_basis[-1, 2:], np.diag(1 / unit))
        end = _SquaredTerm(end_slope, end_velocity_error / unit, self.tuning.end_velocity_weight)
        unit = bounds / _TIME_SCALE**2
        jump_slope = np.kron(np.diff(acceleration_basis, axis=0)[:, 2:], np.diag(1 / unit))
        jumps = np.diff(accelerations, axis=0) / unit
        return [end, _SquaredTerm(jump_slope, jumps, self.tuning.smoothness_weight)]

    def _linearised(
        self, poses: Array, velocities: Array, accelerations: Array, mass: float
    ) -> _Model:
        """Actions and tensions of a motion, each (K, n), linearised about it."""
        n = self.robot.coordinates
        m = self.robot.cables
        count = len(poses)
        required = inverse_dynamics(
            self.robot, mass, poses, velocities, accelerations, minimum=self.minimum_tension
        )
        tensions = required.tensions / TENSION
        masses = np.full((count, 1), mass)
        self._linear.inputs["motion"][:] = np.concatenate(
            [poses, velocities, accelerations, tensions, masses], 1
        ).T
        results = self._linear()
        action = results["values"][n:].T.copy()
        slope = results["slopes"].reshape(n + m, count, 3 * n + m).swapaxes(0, 1)
        by_motion, by_tension = np.split(slope, [3 * n], axis=2)
        # The force balance gives the change of the tensions as a function of the motion, up to the
        # null space.
        force_by_tension = by_tension[:, :n]
        invert: Any = np.linalg.inv
        if self._null:
            invert = np.linalg.pinv
        tension_by_motion = -invert(force_by_tension) @ by_motion[:, :n]
        action_slope = self._slope(by_motion[:, n:] + by_tension[:, n:] @ tension_by_motion)
        tension_slope = self._slope(tension_by_motion)
        if self._null:
            null_space = np.swapaxes(np.linalg.svd(force_by_tension)[2][:, n:], 1, 2)
            action_by_null = _block_diagonal(by_tension[:, n:] @ null_space)
            action_slope = np.hstack([action_slope, action_by_null])
            tension_slope = np.hstack([tension_slope, _block_diagonal(null_space)])
        return _Model(action, action_slope, tensions, tension_slope)

    def _slope(self, by_motion: Array) -> Array:
        """Converts derivatives with respect to (X, Ẋ, Ẍ), (K, rows, 3n), to those for the free
        control points."""
        n = self.robot.coordinates
        derivatives = np.split(by_motion, [n, 2 * n], axis=2)
        slope: Array = np.zeros(())
        for basis, derivative in zip(self._bases, derivatives, strict=True):
            slope = slope + basis[:, None, 2:, None] * derivative[:, :, None, :]
        return slope.reshape(-1, self._motion)

    def _solution(self) -> Array:
        """Solves the program and returns the change of the free control points."""
        for name in ("h", "g", "a", "uba"):
            if not np.all(np.isfinite(self._quadratic.inputs[name])):
                raise PlanningError("the linearised equations are not finite")
        try:
            change = self._quadratic()["x"][: self._motion, 0]
        except RuntimeError as error:
            raise PlanningError(str(error)) from error
        if not (self._quadratic.succeeded and np.all(np.isfinite(change))):
            raise PlanningError("the solver failed")
        return change


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


def _block_diagonal(blocks: Array) -> Array:
    """Block-diagonal matrix (K·rows, K·columns) of blocks (K, rows, columns)."""
    count, rows, columns = blocks.shape
    matrix = np.zeros((count, rows, count, columns))
    matrix[np.arange(count), :, np.arange(count)] = blocks
    return matrix.reshape(count * rows, count * columns)
