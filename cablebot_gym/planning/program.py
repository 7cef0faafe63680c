"""Nonlinear program for the motion with the heaviest payload, with splines, collocation, CasADi and
IPOPT.

The motion X(t) is a spline. On a rigid robot, tensions and torques at each instant follow from X, Ẋ
and Ẍ. On a flexible robot the motor angles β′(t) are a second spline. The balance of forces of the
platform at the collocation points couples the two splines, and the torques follow from β′ and its
derivatives.

Each constraint is a function of a few numbers at one instant, which are affine in the variables of
the program. The Jacobian and the Hessian are assembled from small dense ones. This is ten times
faster than to differentiate the whole program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.statics import HEAVIEST, hold_payload
from cablebot_gym.physics.textbook import cable_equivalent
from cablebot_gym.planning.motion import (
    FLEXIBLE_DEGREE,
    MOTOR_DEGREE,
    RIGID_DEGREE,
    Margins,
    PlannedMotion,
)
from cablebot_gym.planning.signals import SolverInterrupt
from cablebot_gym.planning.stage_functions import (
    TENSION,
    check_model,
    derivatives,
    flexible_stage,
    import_casadi,
    rigid_stage,
    start_motors,
    start_stage,
)
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, start_pose
from cablebot_gym.trajectories import Trajectory

STAGES_PER_INTERVAL = {"rigid": 2, "flexible": 4}
"""Instants per spline interval at which actions and tensions are constrained. Springs oscillate in
between: with two instants the actions exceeded their limits by 10 %, with four by 0.6 %."""

ERROR_STAGES_PER_INTERVAL = 4
"""Instants per spline interval at which the error bounds are enforced."""

_TOLERANCE = 1e-5
"""Tolerance of IPOPT on the scaled program. Payloads are then accurate to 0.1 g."""

_LIGHTEST = -0.95
"""Smallest payload of the program in platform masses. A negative payload tells how much too heavy
the platform is."""

_START_MASSES = 65
"""Number of masses in the table of the springs at rest. The tensions of redundant cables are not
linear in the mass."""

_HOLD_MARGIN = 1e-6
"""Margin to the payload that the motors hold at the start pose [kg]. It covers rounding."""

_WARM_START = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-5,
    **{f"warm_start_{name}_push": 1e-8 for name in ("bound", "slack_bound", "mult_bound")},
}
"""Options of IPOPT for a start with multipliers close to the solution."""


class Infeasible(RuntimeError):
    """The solver found no motion within the constraints."""


class _Spline:
    """One spline of the program. Its control points are ``base + scale * z[at]`` of the variables
    z."""

    def __init__(self, knots: Array, degree: int, at: Array, base: Array, scale: Array) -> None:
        self.knots, self.degree = knots, degree
        self.at, self.base, self.scale = at, base, scale

    def rows(self, times: Array, orders: Sequence[int]) -> list[_Row]:
        """Values or derivatives of the spline at the times, one row per order and coordinate."""
        rows = []
        for order in orders:
            basis = _basis(self.knots, self.degree, times, order)
            for channel, scale in enumerate(self.scale):
                rows.append(_Row(basis * scale, self.at[:, channel], basis @ self.base[:, channel]))
        return rows

    def control_points(self, z: Array) -> Array:
        """Control points for the variables, shape (count, channels)."""
        points: Array = self.base + self.scale * z[self.at]
        return points


@dataclass(frozen=True)
class _Row:
    """One number at each of several instants: ``matrix @ z[at] + constant``."""

    matrix: Array
    at: Array
    constant: Array


@dataclass(frozen=True, kw_only=True)
class _Block:
    """Constraints on a function of a few numbers at each of several instants."""

    function: Any
    """SX function from the numbers to the constrained values."""
    matrix: csr_matrix
    """Matrix from the variables to all numbers, one instant after the other."""
    offset: Array
    """Constant part of the numbers."""
    low: Array
    """Lower bounds at one instant."""
    high: Array
    """Upper bounds at one instant."""
    instants: int
    """Number of instants."""


class MotionProgram:
    """The nonlinear program for one robot, reference and mesh.

    Args:
        robot: any robot without motor lag.
        trajectory: reference motion. The motion starts at :func:`~cablebot_gym.task.start_pose`
            with its velocity.
        error_bounds: bounds of the tracking error.
        intervals: number of intervals of the splines.
        margins: margins to the constraints; None for no margins.
        lightest: a second payload for which the same motion must be feasible [kg]; None for the
            heaviest one only. On a given motion, actions and tensions are affine in the payload, so
            all payloads in between are feasible.
        period: control period over which the torques are constant [s]; 0 for continuous torques.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if a margin is not below its bound, the minimum tension exceeds the initial
            tension of a flexible planar robot, or the robot has motor lag.
    """

    def __init__(
        self,
        robot: Robot,
        trajectory: Trajectory,
        error_bounds: ErrorBounds,
        *,
        intervals: int,
        margins: Margins | None = None,
        lightest: float | None = None,
        period: float = 0.0,
    ) -> None:
        self._ca = import_casadi()
        self._period = period
        check_model(robot)
        self._robot = cable_equivalent(robot)
        self._trajectory = trajectory
        self._error_bounds = error_bounds
        self._lightest = lightest
        self._start = start_pose(robot, trajectory, error_bounds)
        held = hold_payload(robot, trajectory, error_bounds) - _HOLD_MARGIN
        self._heaviest = min(HEAVIEST * robot.mass, held)
        self._set_margins(margins or Margins())
        count = STAGES_PER_INTERVAL[robot.joints] * intervals
        self._instants = np.linspace(0.0, trajectory.duration, count + 1)
        self._error_instants = np.linspace(
            0.0, trajectory.duration, ERROR_STAGES_PER_INTERVAL * intervals + 1
        )[1:]
        self._variables = 0
        self._payload_at = self._take(1)
        self._poses = self._pose_spline(intervals)
        loads = 1 if lightest is None else 2
        self._motors = [
            self._motor_spline(intervals) for _ in range(loads if robot.flexible else 0)
        ]
        self._tensions = [
            self._take(len(self._instants), robot.cables)
            for _ in range(0 if robot.flexible else loads)
        ]
        self._interrupt = SolverInterrupt()
        self._solver: tuple[Any, Array, Array] | None = None
        self._solution: Any = None

    def _set_margins(self, margins: Margins) -> None:
        robot = self._robot
        self._margins = margins
        self._least = self._robot.minimum_tension + margins.tension
        for name in ("position", "rotation"):
            if not getattr(margins, name) < (bound := getattr(self._error_bounds, name)):
                raise ValueError(f"margins: {name} must be below the error bound {bound:g}")
        initial = textbook.allocated_minimum(robot)
        if robot.flexible and robot.cables > robot.coordinates and self._least > initial:
            raise ValueError(
                f"margins: tension must be at most {initial - robot.minimum_tension:g} N for {robot.name!r}, "
                f"whose initial tension is {initial:g} N, not {margins.tension:g} N"
            )

    def solve(
        self, start: PlannedMotion | None = None, *, shift: Array | None = None
    ) -> PlannedMotion:
        """Solves the program for the motion with the heaviest payload.

        Args:
            start: initial guess, such as the motion on a coarser mesh; None for the reference.
            shift: offset of the initial control points of the pose in units of the error bounds,
                shape (n,) or (control points, n).

        Raises:
            Infeasible: if the solver finds no motion within the constraints; the message is its
                status.
        """
        if self._solver is None:
            self._solver = self._assemble({})
        return self._solved(
            self._solver, x0=self._initial_guess(start, 0.0 if shift is None else shift)
        )

    def resolve(self, margins: Margins) -> PlannedMotion:
        """Solves the program with other margins, starting from its last solution, which takes a few
        iterations.

        Args:
            margins: margins to the constraints, close to those of the last solution.

        Raises:
            Infeasible: if the solver finds no motion within the constraints, or the program has no
                solution yet.
            ValueError: if a margin is not below its bound.
        """
        self._set_margins(margins)
        self._solver = None
        if (last := self._solution) is None:
            raise Infeasible("the program has no solution to start from")
        x0 = np.array(last["x"])[:, 0]
        return self._solved(
            self._assemble(_WARM_START), x0=x0, lam_x0=last["lam_x"], lam_g0=last["lam_g"]
        )

    def _solved(
        self, assembled: tuple[Any, Array, Array], *, x0: Array, **multipliers: Any
    ) -> PlannedMotion:
        solver, lowest, highest = assembled
        low, high = self._bounds()
        if np.any(low > high):
            raise Infeasible("the motors cannot hold the start pose")
        with self._interrupt.watch():
            solution = solver(
                x0=np.clip(x0, low, high), lbx=low, ubx=high, lbg=lowest, ubg=highest, **multipliers
            )
        status = solver.stats()["return_status"]
        if status not in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
            raise Infeasible(status)
        self._solution = solution
        return self._motion(np.clip(np.array(solution["x"])[:, 0], low, high))

    @property
    def control_points(self) -> int:
        """Number of control points of the pose spline."""
        return len(self._poses.base)

    # Variables

    def _take(self, *shape: int) -> Array:
        """Indices of new variables."""
        first = self._variables
        self._variables = self._variables + int(np.prod(shape))
        return np.arange(first, self._variables).reshape(shape)

    def _pose_spline(self, intervals: int) -> _Spline:
        degree = FLEXIBLE_DEGREE if self._robot.flexible else RIGID_DEGREE
        knots = _knots(self._trajectory.duration, intervals, degree)
        n, count = self._robot.coordinates, intervals + degree
        base = _interpolate(knots, degree, self._trajectory(greville(knots, degree)).position)
        turning = np.arange(n) >= self._robot.dimensions
        bounds = np.where(turning, self._error_bounds.rotation, self._error_bounds.position)
        return _Spline(knots, degree, self._take(count, n), base, bounds)

    def _motor_spline(self, intervals: int) -> _Spline:
        robot, degree = self._robot, MOTOR_DEGREE
        knots = _knots(self._trajectory.duration, intervals, degree)
        poses = self._trajectory(greville(knots, degree)).position
        angles, _ = start_motors(
            robot, np.full(len(poses), robot.mass), poses, np.zeros(robot.coordinates)
        )
        base = _interpolate(knots, degree, angles)
        return _Spline(
            knots, degree, self._take(len(base), robot.cables), base, np.ones(robot.cables)
        )

    def _masses(self) -> list[float | None]:
        """Masses of platform and payload [kg]; None for the mass that is maximised."""
        return [None] if self._lightest is None else [None, self._robot.mass + self._lightest]

    def _bounds(self) -> tuple[Array, Array]:
        """Bounds of the variables. They fix the start pose and its velocity, with the springs at
        rest."""
        low = np.full(self._variables, -np.inf)
        high = np.full(self._variables, np.inf)
        robot = self._robot
        pose = self._start
        velocity = self._trajectory(0.0).velocity
        ends = [(self._poses, pose, velocity)]
        if (
            robot.weightless and self._motors
        ):  # with gravity the angles depend on the payload: a constraint
            ends += [
                (spline, *start_motors(robot, np.array(robot.mass), pose, velocity))
                for spline in self._motors
            ]
        for spline, value, rate in ends:
            step = spline.knots[spline.degree + 1] / spline.degree
            for row, point in enumerate((value, value + step * rate)):
                low[spline.at[row]] = high[spline.at[row]] = (
                    point - spline.base[row]
                ) / spline.scale
        for at in self._tensions:
            low[at] = self._least / TENSION
        low[self._payload_at], high[self._payload_at] = _LIGHTEST * robot.mass, self._heaviest
        return low, high

    def _initial_guess(self, start: PlannedMotion | None, shift: Any) -> Array:
        """Initial values of the variables."""
        z = np.zeros(self._variables)
        robot = self._robot
        poses = self._poses
        for at in self._tensions:
            z[at] = 1.0
        if start is not None:
            points = _interpolate(
                poses.knots, poses.degree, start(greville(poses.knots, poses.degree)).position
            )
            z[poses.at] = (points - poses.base) / poses.scale
            z[self._payload_at] = start.payload
            motion = start(self._instants)
            masses = [
                robot.mass + start.payload if mass is None else mass for mass in self._masses()
            ]
            for at, mass in zip(self._tensions, masses, strict=False):
                tensions = textbook.required_tensions(
                    robot, mass, motion.position, motion.velocity, motion.acceleration, strict=False
                )
                z[at] = tensions / TENSION
            for spline, mass in zip(self._motors, masses, strict=False):
                times = greville(spline.knots, spline.degree)
                angles = start.motor_motion(times, np.full(len(times), mass - robot.mass))[0]
                z[spline.at] = _interpolate(spline.knots, spline.degree, angles) - spline.base
        z[poses.at] += shift
        return z

    def _motion(self, z: Array) -> PlannedMotion:
        payload = float(z[self._payload_at][0])
        return PlannedMotion(
            name=self._trajectory.name,
            knots=self._poses.knots,
            poses=self._poses.control_points(z),
            motors=tuple(spline.control_points(z) for spline in self._motors),
            payload=payload,
            lightest=payload if self._lightest is None else self._lightest,
            minimum_tension=self._least,
        )

    # Constraints

    def _blocks(self) -> list[_Block]:
        blocks = self._error_blocks()
        for index, mass in enumerate(self._masses()):
            blocks += (
                self._flexible(index, mass) if self._robot.flexible else self._rigid(index, mass)
            )
        return blocks

    def _block(self, function: Any, rows: list[_Row], low: Array, high: Array) -> _Block:
        """A block with the numbers of one instant after the other: row k·d + i is number i at
        instant k."""
        d, instants = len(rows), len(rows[0].constant)
        indices, columns, values = [], [], []
        for number, row in enumerate(rows):
            k, j = np.nonzero(row.matrix)
            indices.append(k * d + number)
            columns.append(row.at[j])
            values.append(row.matrix[k, j])
        entries = np.concatenate(values), (np.concatenate(indices), np.concatenate(columns))
        matrix = csr_matrix(entries, (instants * d, self._variables))
        offset = np.stack([row.constant for row in rows], axis=1).ravel()
        return _Block(
            function=function, matrix=matrix, offset=offset, low=low, high=high, instants=instants
        )

    def _error_blocks(self) -> list[_Block]:
        """Constraints on the position and rotation errors, in units of their bounds."""
        ca = self._ca
        d = self._robot.dimensions
        angles = self._robot.coordinates - self._robot.dimensions
        times = self._error_instants
        reference = self._trajectory(times).position
        rows = [
            _Row(row.matrix / bound, row.at, (row.constant - target) / bound)
            for row, target, bound in zip(
                self._poses.rows(times, [0]), reference.T, self._poses.scale, strict=True
            )
        ]
        translation = ca.SX.sym("e", d)
        rotation = ca.SX.sym("e", angles)
        radius = 1 - self._margins.position / self._error_bounds.position
        distance = ca.Function("distance", [translation], [ca.sumsqr(translation)])
        blocks = [self._block(distance, rows[:d], np.array([-np.inf]), np.array([radius**2]))]
        if angles:
            most = np.full(angles, 1 - self._margins.rotation / self._error_bounds.rotation)
            blocks.append(
                self._block(ca.Function("rotation", [rotation], [rotation]), rows[d:], -most, most)
            )
        return blocks

    def _mass_row(self, mass: float | None, times: int) -> _Row:
        column = np.ones((times, 1)) if mass is None else np.zeros((times, 1))
        constant = np.full(times, self._robot.mass if mass is None else mass)
        return _Row(column, self._payload_at, constant)

    def _action_bounds(self) -> Array:
        return np.full(
            (2 if self._period > 0 else 1) * self._robot.cables, 1 - self._margins.action
        )

    def _rigid(self, index: int, mass: float | None) -> list[_Block]:
        times = self._instants
        balanced = np.zeros(self._robot.coordinates)
        most = self._action_bounds()
        at = self._tensions[index]
        tensions = [_Row(np.eye(len(times)), column, np.zeros(len(times))) for column in at.T]
        rows = [*self._poses.rows(times, [0, 1, 2]), *tensions, self._mass_row(mass, len(times))]
        return [
            self._block(
                rigid_stage(self._robot, self._period),
                rows,
                np.r_[balanced, -most],
                np.r_[balanced, most],
            )
        ]

    def _flexible(self, index: int, mass: float | None) -> list[_Block]:
        robot = self._robot
        poses = self._poses
        motors = self._motors[index]
        balance, limits = flexible_stage(robot, self._period)
        balanced = np.zeros(robot.coordinates)
        most = self._action_bounds()
        least = np.full(2 * robot.cables, self._least / TENSION)

        def rows(times: Array, orders: Sequence[int]) -> list[_Row]:
            return [
                *poses.rows(times, orders),
                *motors.rows(times, orders),
                self._mass_row(mass, len(times)),
            ]

        collocation = greville(motors.knots, motors.degree)
        if index > 0:  # all payloads start with the same Ẍ, which the first block determines
            collocation = collocation[1:]  # valid for a start from rest only
        blocks = [
            self._block(balance, rows(collocation, [0, 1, 2]), balanced, balanced),
            self._block(
                limits,
                rows(self._instants, [0, 1, 2]),
                np.r_[-most, least],
                np.r_[most, np.full(len(least), np.inf)],
            ),
        ]
        if not robot.weightless:
            masses = np.linspace(
                (1 + _LIGHTEST) * robot.mass, robot.mass + self._heaviest, _START_MASSES
            )
            velocity = self._trajectory(0.0).velocity
            start = start_stage(
                robot, *(tuple(values.tolist()) for values in (self._start, velocity, masses))
            )
            begin, equal = np.zeros(1), np.zeros(2 * robot.cables)
            blocks.append(
                self._block(
                    start,
                    [*motors.rows(begin, [0, 1]), self._mass_row(mass, len(begin))],
                    equal,
                    equal,
                )
            )
        return blocks

    # The program

    def _assemble(self, start: dict[str, Any]) -> tuple[Any, Array, Array]:
        """The IPOPT solver of the program with options for its start, and the bounds of its
        constraints."""
        ca = self._ca
        z = ca.MX.sym("z", self._variables)
        sigma = ca.MX.sym("sigma")
        parameters = ca.MX.sym("p", 0)
        values = []
        jacobians = []
        multipliers = []
        lows = []
        highs = []
        hessian = ca.MX(self._variables, self._variables)
        for block in self._blocks():
            matrix = ca.DM(block.matrix.tocsc())
            size = block.matrix.shape[0] // block.instants
            rows = len(block.low)
            count = block.instants
            numbers = ca.reshape(matrix @ z + ca.DM(block.offset), size, count)
            first, second = derivatives(block.function)
            values.append(ca.vec(block.function.map(count)(numbers)))
            jacobians.append(ca.diagcat(*ca.horzsplit(first.map(count)(numbers), size)) @ matrix)
            multipliers.append(ca.MX.sym("lam", rows * count))
            curvature = second.map(count)(numbers, ca.reshape(multipliers[-1], rows, count))
            hessian += matrix.T @ ca.diagcat(*ca.horzsplit(curvature, size)) @ matrix
            lows.append(np.tile(block.low, count))
            highs.append(np.tile(block.high, count))
        constraints = ca.vertcat(*values)
        lam = ca.MX.sym("lam_g", constraints.shape[0])
        ends = np.cumsum([0, *(item.shape[0] for item in multipliers)]).tolist()
        (hessian,) = ca.graph_substitute([ca.triu(hessian)], multipliers, ca.vertsplit(lam, ends))
        self._callback = self._interrupt.callback(ca, self._variables, constraints.shape[0])
        options = {
            "iteration_callback": self._callback,
            "jac_g": ca.Function(
                "slopes",
                [z, parameters],
                [constraints, ca.vertcat(*jacobians)],
                ["x", "p"],
                ["g", "jac_g_x"],
            ),
            "hess_lag": ca.Function(
                "curvature",
                [z, parameters, sigma, lam],
                [hessian],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": 200,
                "tol": _TOLERANCE,
                "acceptable_tol": 10 * _TOLERANCE,
                "linear_solver": "mumps",
                "mumps_pivot_order": 0,  # minimum degree: on these band matrices three times faster than automatic
                "mu_strategy": "adaptive",
                **start,
            },
        }
        program = {"x": z, "f": -z[int(self._payload_at[0])], "g": constraints}
        return (
            ca.nlpsol("motion", "ipopt", program, options),
            np.concatenate(lows),
            np.concatenate(highs),
        )


def greville(knots: Array, degree: int) -> Array:
    """Greville points of a spline, one per control point. The values at these points determine the
    spline."""
    count = len(knots) - degree - 1
    return np.array([knots[index + 1 : index + degree + 1].mean() for index in range(count)])


def _knots(duration: float, intervals: int, degree: int) -> Array:
    """Equally spaced knots, clamped at both ends."""
    return np.r_[
        np.zeros(degree), np.linspace(0.0, duration, intervals + 1), np.full(degree, duration)
    ]


def _basis(knots: Array, degree: int, times: Array, order: int) -> Array:
    """Matrix from the control points to a derivative at each time, shape (times, control
    points)."""
    spline = BSpline(knots, np.eye(len(knots) - degree - 1), degree)
    values = (spline.derivative(order) if order else spline)(times)
    return np.where(np.abs(values) > 1e-12 * np.abs(values).max(), values, 0.0)


def _interpolate(knots: Array, degree: int, values: Array) -> Array:
    """Control points of the spline with given values at its Greville points."""
    points: Array = np.linalg.solve(_basis(knots, degree, greville(knots, degree), 0), values)
    return points
