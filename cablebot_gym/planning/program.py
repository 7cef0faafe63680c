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
from functools import cached_property
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.statics import HEAVIEST, hold_payload
from cablebot_gym.planning.assembly import Assembled
from cablebot_gym.planning.blocks import (
    ConstraintBlock,
    Limits,
    ProgramRow,
    Spline,
    clamped_knots,
    greville,
    interpolate,
    make_block,
)
from cablebot_gym.planning.motion import (
    FLEXIBLE_DEGREE,
    MOTOR_DEGREE,
    RIGID_DEGREE,
    MarginProfile,
    Margins,
    PlannedMotion,
)
from cablebot_gym.planning.signals import SolverInterrupt
from cablebot_gym.planning.stage_functions import (
    TENSION,
    check_model,
    flexible_stage,
    import_casadi,
    rigid_stage,
    start_motors,
    start_stage,
)
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, start_pose

STAGES_PER_INTERVAL = {"rigid": 2, "flexible": 4}
"""Instants per spline interval at which actions and tensions are constrained. Springs oscillate in
between: with two instants the actions exceeded their limits by 10 %, with four by 0.6 %."""

ERROR_STAGES_PER_INTERVAL = 4
"""Instants per spline interval at which the error bounds are enforced."""

_LIGHTEST = -0.95
"""Smallest payload of the program in platform masses. A negative payload tells how much too heavy
the platform is."""

_START_MASSES = 65
"""Number of masses in the table of the springs at rest. The tensions of redundant cables are not
linear in the mass."""

_HOLD_MARGIN = 1e-6
"""Margin to the payload that the motors hold at the start pose [kg]. It covers rounding."""


class Infeasible(RuntimeError):
    """The solver found no motion within the constraints."""


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
        ValueError: if the robot has motor lag.
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
        self._robot = robot
        self._trajectory = trajectory
        self._error_bounds = error_bounds
        self._lightest = lightest
        self._start = start_pose(robot, trajectory, error_bounds)
        held = hold_payload(robot, trajectory, error_bounds) - _HOLD_MARGIN
        self._heaviest = min(HEAVIEST * robot.mass, held)
        self.set_margins(margins or Margins())
        self._profile = MarginProfile.zeros(np.zeros(0), robot.cables)
        count = STAGES_PER_INTERVAL[robot.joints] * intervals
        self._instants = np.linspace(0.0, trajectory.duration, count + 1)
        count = ERROR_STAGES_PER_INTERVAL * intervals
        self._error_instants = np.linspace(0.0, trajectory.duration, count + 1)[1:]
        self._variables = 0
        self._payload_at = self._take(1)
        self._poses = self._pose_spline(intervals)
        self._motors: list[Spline] = []
        self._tensions: list[Array] = []
        for _ in self._masses():
            if robot.flexible:
                self._motors.append(self._motor_spline(intervals))
            else:
                self._tensions.append(self._take(len(self._instants), robot.cables))
        self._interrupt = SolverInterrupt()
        self._solution: Any = None

    def set_margins(self, margins: Margins) -> None:
        """Sets the margins of the next solutions."""
        self._margins = margins
        self._least = self._robot.minimum_tension + margins.tension
        self._largest = self._robot.maximum_tension - margins.tension

    def solve(
        self,
        start: PlannedMotion | None = None,
        *,
        shift: Array | None = None,
        near: bool = False,
    ) -> PlannedMotion:
        """Solves the program for the motion with the heaviest payload.

        Args:
            start: initial guess, such as the motion on a coarser mesh; None for the reference.
            shift: offset of the initial control points of the pose in units of the error bounds,
                shape (n,) or (control points, n).
            near: whether ``start`` is close to the solution, such as the motion of a similar robot.
                The solver then takes a third of the iterations.

        Raises:
            Infeasible: if the solver finds no motion within the constraints; the message is its
                status.
        """
        guess = self._initial_guess(start)
        if shift is not None:
            guess[self._poses.at] += shift
        if near:
            return self._solved(self._assembled.near_solver, x0=guess)
        return self._solved(self._assembled.cold_solver, x0=guess)

    def resolve(self, margins: Margins, profile: MarginProfile | None = None) -> PlannedMotion:
        """Solves the program with other margins, starting from its last solution, which takes a few
        iterations.

        Args:
            margins: margins to the constraints, close to those of the last solution.
            profile: additional margins over time, which hold for later solutions too; None for
                those of the last solution.

        Raises:
            Infeasible: if the solver finds no motion within the constraints, or the program has no
                solution yet.
        """
        self.set_margins(margins)
        if profile is not None:
            self._profile = profile
        start = self._solution
        if start is None:
            raise Infeasible("the program has no solution to start from")
        x0 = np.array(start["x"])[:, 0]
        solver = self._assembled.warm_solver
        return self._solved(solver, x0=x0, lam_x0=start["lam_x"], lam_g0=start["lam_g"])

    def _solved(self, solver: Any, *, x0: Array, **multipliers: Any) -> PlannedMotion:
        low, high = self._bounds()
        if np.any(low > high):
            raise Infeasible("the motors cannot hold the start pose")
        least, most = self._assembled.bounds(self)
        if np.any(least > most):
            raise Infeasible("the margins leave nothing between two limits")
        x0 = np.clip(x0, low, high)
        with self._interrupt.watch():
            solution = solver(x0=x0, lbx=low, ubx=high, lbg=least, ubg=most, **multipliers)
        status = solver.stats()["return_status"]
        if status not in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
            raise Infeasible(status)
        self._solution = solution
        x = np.array(solution["x"])[:, 0]
        return self._motion(np.clip(x, low, high))

    @property
    def control_points(self) -> int:
        """Number of control points of the pose spline."""
        return len(self._poses.base)

    # Variables

    def _take(self, *shape: int) -> Array:
        """Indices of new variables."""
        begin = self._variables
        self._variables += int(np.prod(shape))
        return np.arange(begin, self._variables).reshape(shape)

    def _pose_spline(self, intervals: int) -> Spline:
        degree = RIGID_DEGREE
        if self._robot.flexible:
            degree = FLEXIBLE_DEGREE
        knots = clamped_knots(self._trajectory.duration, intervals, degree)
        poses = self._trajectory(greville(knots, degree)).position
        base = interpolate(knots, degree, poses)
        bounds = self._error_bounds.of_coordinates(self._robot)
        return Spline(knots, degree, self._take(*base.shape), base, bounds)

    def _motor_spline(self, intervals: int) -> Spline:
        robot = self._robot
        degree = MOTOR_DEGREE
        knots = clamped_knots(self._trajectory.duration, intervals, degree)
        poses = self._trajectory(greville(knots, degree)).position
        masses = np.full(len(poses), robot.mass)
        angles, _ = start_motors(robot, masses, poses, np.zeros(robot.coordinates))
        base = interpolate(knots, degree, angles)
        at = self._take(len(base), robot.cables)
        return Spline(knots, degree, at, base, np.ones(robot.cables))

    def _masses(self) -> list[float | None]:
        """Masses of platform and payload [kg]; None for the mass that is maximised."""
        if self._lightest is None:
            return [None]
        return [None, self._robot.mass + self._lightest]

    def _bounds(self) -> tuple[Array, Array]:
        """Bounds of the variables. They fix the start pose and its velocity, with the springs at
        rest."""
        low = np.full(self._variables, -np.inf)
        high = np.full(self._variables, np.inf)
        robot = self._robot
        pose = self._start
        velocity = self._trajectory(0.0).velocity
        starts = [(self._poses, pose, velocity)]
        # With gravity the angles depend on the payload: a constraint.
        if robot.weightless and self._motors:
            angle, speed = start_motors(robot, np.array(robot.mass), pose, velocity)
            starts += [(spline, angle, speed) for spline in self._motors]
        for spline, value, rate in starts:
            step = spline.knots[spline.degree + 1] / spline.degree
            for row, point in enumerate((value, value + step * rate)):
                fixed = (point - spline.base[row]) / spline.scale
                low[spline.at[row]] = fixed
                high[spline.at[row]] = fixed
        for at in self._tensions:
            margin = self._profile_at("tension", self._instants)[:, None]
            low[at] = (self._least + margin) / TENSION
            high[at] = (self._largest - margin) / TENSION
        low[self._payload_at] = _LIGHTEST * robot.mass
        high[self._payload_at] = self._heaviest
        return low, high

    def _initial_guess(self, start: PlannedMotion | None) -> Array:
        """Initial values of the variables."""
        z = np.zeros(self._variables)
        robot = self._robot
        poses = self._poses
        for at in self._tensions:
            z[at] = 1.0
        if start is None:
            return z
        positions = start(greville(poses.knots, poses.degree)).position
        points = interpolate(poses.knots, poses.degree, positions)
        z[poses.at] = (points - poses.base) / poses.scale
        z[self._payload_at] = start.payload
        for index, fixed_mass in enumerate(self._masses()):
            mass = fixed_mass
            if mass is None:
                mass = robot.mass + start.payload
            times = self._instants
            if robot.flexible:
                spline = self._motors[index]
                times = greville(spline.knots, spline.degree)
            motion = start(times)
            tensions = textbook.required_tensions(
                robot,
                mass,
                motion.position,
                motion.velocity,
                motion.acceleration,
                minimum=self._least,
                strict=False,
            )
            if robot.flexible:
                angles = textbook.rest_angles(robot, tensions, motion.position)
                z[spline.at] = interpolate(spline.knots, spline.degree, angles) - spline.base
            else:
                z[self._tensions[index]] = tensions / TENSION
        return z

    def _motion(self, z: Array) -> PlannedMotion:
        payload = float(z[self._payload_at][0])
        lightest = self._lightest
        if lightest is None:
            lightest = payload
        return PlannedMotion(
            name=self._trajectory.name,
            knots=self._poses.knots,
            poses=self._poses.control_points(z),
            motors=tuple(spline.control_points(z) for spline in self._motors),
            payload=payload,
            lightest=lightest,
            minimum_tension=self._least,
        )

    # Constraints

    def _blocks(self) -> list[ConstraintBlock]:
        blocks = self._error_blocks()
        for index, mass in enumerate(self._masses()):
            if self._robot.flexible:
                blocks += self._flexible(index, mass)
            else:
                blocks.append(self._rigid(index, mass))
        return blocks

    @cached_property
    def _assembled(self) -> Assembled:
        payload = int(self._payload_at[0])
        return Assembled(self._blocks(), self._variables, payload, self._interrupt)

    def _constrain(
        self, times: Array, function: Any, rows: list[ProgramRow], limits: Limits
    ) -> ConstraintBlock:
        return make_block(times, function, rows, limits, self._variables)

    def _error_blocks(self) -> list[ConstraintBlock]:
        """Constraints on the position and rotation errors, in units of their bounds."""
        ca = self._ca
        d = self._robot.dimensions
        angles = self._robot.coordinates - d
        times = self._error_instants
        reference = self._trajectory(times).position
        rows = []
        pose_rows = self._poses.rows(times, [0])
        for row, target, bound in zip(pose_rows, reference.T, self._poses.scale, strict=True):
            constant = (row.constant - target) / bound
            rows.append(ProgramRow(row.matrix / bound, row.at, constant))
        translation = ca.SX.sym("e", d)
        distance = ca.Function("distance", [translation], [ca.sumsqr(translation)])

        def within(program: MotionProgram) -> tuple[Array, Array]:
            radius = program._error_radius("position")
            return np.full_like(radius, -np.inf), radius * np.abs(radius)  # negative: infeasible

        blocks = [self._constrain(times, distance, rows[:d], within)]
        if angles:
            rotation = ca.SX.sym("e", angles)
            angle_errors = ca.Function("rotation", [rotation], [rotation])

            def least_and_most(program: MotionProgram) -> tuple[Array, Array]:
                most = np.repeat(program._error_radius("rotation"), angles, axis=1)
                return -most, most

            blocks.append(self._constrain(times, angle_errors, rows[d:], least_and_most))
        return blocks

    def _profile_at(self, name: str, instants: Array) -> Array:
        """Additional margin of a limit at every instant, shape (instants, ...): the largest one up
        to the instants next to it, because the constraint must also hold in between."""
        return self._profile.largest(name, instants, instants[-1] - instants[-2])

    def _error_radius(self, name: str) -> Array:
        """Bound of an error at every instant in units of the error bound, shape (instants, 1)."""
        margin = getattr(self._margins, name) + self._profile_at(name, self._error_instants)
        return np.asarray(1 - margin / getattr(self._error_bounds, name))[:, None]

    def _mass_row(self, mass: float | None, times: int) -> ProgramRow:
        column = np.zeros((times, 1))
        if mass is None:
            column[:] = 1.0
            mass = self._robot.mass
        return ProgramRow(column, self._payload_at, np.full(times, mass))

    def _action_bounds(self) -> Array:
        """Bound of the actions at every instant, shape (instants, actions)."""
        bounds = 1 - self._margins.action - self._profile_at("action", self._instants)
        if self._period > 0:  # at both ends of a period
            bounds = np.hstack([bounds, bounds])
        return bounds

    def _rigid(self, index: int, mass: float | None) -> ConstraintBlock:
        times = self._instants
        count = len(times)
        rows = [*self._poses.rows(times, [0, 1, 2])]
        for column in self._tensions[index].T:
            rows.append(ProgramRow(np.eye(count), column, np.zeros(count)))
        rows.append(self._mass_row(mass, count))
        stage = rigid_stage(self._robot, self._period)
        balanced = np.zeros((count, self._robot.coordinates))

        def limits(program: MotionProgram) -> tuple[Array, Array]:
            most = program._action_bounds()
            return np.hstack([balanced, -most]), np.hstack([balanced, most])

        return self._constrain(times, stage, rows, limits)

    def _flexible(self, index: int, mass: float | None) -> list[ConstraintBlock]:
        robot = self._robot
        poses = self._poses
        motors = self._motors[index]
        balance, limited = flexible_stage(robot, self._period)

        def limits(program: MotionProgram) -> tuple[Array, Array]:
            most = program._action_bounds()
            margin = program._profile_at("tension", program._instants)[:, None]
            least = np.repeat((program._least + margin) / TENSION, 2 * robot.cables, axis=1)
            largest = np.full_like(least, np.inf)  # of the tensions, then of the spring forces
            largest[:, : robot.cables] = (program._largest - margin) / TENSION
            return np.hstack([-most, least]), np.hstack([most, largest])

        def rows(times: Array, orders: Sequence[int]) -> list[ProgramRow]:
            return [
                *poses.rows(times, orders),
                *motors.rows(times, orders),
                self._mass_row(mass, len(times)),
            ]

        collocation = greville(motors.knots, motors.degree)
        if index > 0:  # all payloads start with the same Ẍ, which the first block determines
            collocation = collocation[1:]  # valid for a start from rest only
        balance_rows = rows(collocation, [0, 1, 2])
        limited_rows = rows(self._instants, [0, 1, 2])
        blocks = [
            self._constrain(collocation, balance, balance_rows, _equal),
            self._constrain(self._instants, limited, limited_rows, limits),
        ]
        if not robot.weightless:
            lightest_mass = (1 + _LIGHTEST) * robot.mass
            heaviest_mass = robot.mass + self._heaviest
            masses = np.linspace(lightest_mass, heaviest_mass, _START_MASSES)
            velocity = self._trajectory(0.0).velocity
            # Tuples can be keys of the cache.
            conditions = (tuple(values.tolist()) for values in (self._start, velocity, masses))
            start = start_stage(robot, *conditions)
            begin = np.zeros(1)
            start_rows = [*motors.rows(begin, [0, 1]), self._mass_row(mass, len(begin))]
            blocks.append(self._constrain(begin, start, start_rows, _equal))
        return blocks


def _equal(_: MotionProgram) -> tuple[Array, Array]:
    """Bounds of values that must be zero."""
    return np.zeros(1), np.zeros(1)
