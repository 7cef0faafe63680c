"""Splines about reference motions, in batches, and how far they violate the limits.

All motions have the same number of spline intervals. Inverse dynamics gives the actions and the
tensions at all instants at once, without a rollout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from scipy.interpolate import BSpline, make_lsq_spline
from torch import Tensor

from cablebot_baselines.learned.differentiable import (
    RequiredActuation,
    internal_direction,
    required_actuation,
)
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.planning import MarginProfile, Margins, clamped_knots, greville
from cablebot_gym.planning.motion import FLEXIBLE_DEGREE, MOTOR_DEGREE, RIGID_DEGREE
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, start_pose

INTERVALS = 72
"""Spline intervals of every motion."""

STAGES = {"rigid": 2, "flexible": 4}
"""Instants per interval at which the actions and the tensions of a training are limited."""

CHECKS = {"rigid": 5, "flexible": 8}
"""Instants per interval at which those of a finished plan are checked."""

ERROR_STAGES = 4
"""Instants per interval at which the error bounds are limits."""

FIXED_POINTS = {"rigid": 2, "flexible": 4}
"""Control points that the start at rest determines; springs need rest up to the jerk."""

MOTOR_SAMPLES = 4
"""Samples of the motor angles per control point, to which their spline is fitted."""

FIT_SAMPLES = 600
"""Samples of a reference to which its spline is fitted."""

JUMP = 1e-6
"""Time before and after a control point at which the reference is read: its acceleration may jump
there [s]."""

DECAYS = (0.1, 0.3)
"""Time constants of the inputs that mark the start and the end of a motion [s]."""

RESERVES = {"position": 0.005, "rotation": 0.005, "tension": 0.005, "action": 0.002}
"""Margins of a training and of a refinement in addition, because a plan is also checked between their
instants."""

TOLERANCE = 0.004
"""Largest violation of a feasible plan, in the units of :meth:`PlanSpace.violations`."""

ERROR_WEIGHT = 5.0
"""Weight of the squares of violated error bounds, in a training and in a refinement."""

TENSION = 0.1
"""Missing tension that counts as much as an action that is 1 too large, as a fraction of the cable
force of the stalled motors."""

_FLOAT = torch.float64


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanProblem:
    """References of N motions and their limits, as tensors."""

    duration: Tensor
    """Durations, (N,) [s]."""
    points: Tensor
    """Control points of the splines fitted to the references, (N, count, n)."""
    start: Tensor
    """First control points of the motions, which give their start, (N, fixed, n)."""
    poses: Tensor
    """Reference poses at the instants of the error bounds, (N, instants, n)."""
    inputs: Tensor
    """The reference, the inverse Jacobian and the time at each control point, (N, count, size)."""
    exact: Tensor
    """Payload of exact tracking by the actions at the control points, (N,) [kg]."""

    def __getitem__(self, index: Any) -> PlanProblem:
        """Some of the motions."""
        return PlanProblem(**{item.name: getattr(self, item.name)[index] for item in fields(self)})

    def __len__(self) -> int:
        return len(self.duration)

    @classmethod
    def joined(cls, problems: Sequence[PlanProblem]) -> PlanProblem:
        """The motions of several problems, one after the other."""
        names = [item.name for item in fields(cls)]
        return cls(**{name: torch.cat([getattr(p, name) for p in problems]) for name in names})


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanQuery:
    """What N plans are asked for."""

    problem: PlanProblem
    """The references."""
    payloads: Tensor
    """Lightest and heaviest payload of each plan [kg], (N, 2)."""
    margins: Tensor
    """Margins at the control points: of position, rotation, tension and the action of each motor, (N,
    count, 3 + m). Those of the errors are fractions of their bounds; that of the tensions is in units
    of :attr:`PlanSpace.tension`."""
    internal: Tensor
    """Internal tensions of a flexible robot with redundant cables on the reference with both
    payloads [N], (N, count, 2); else (N, count, 0)."""

    def __getitem__(self, index: Any) -> PlanQuery:
        """Some of the plans."""
        return PlanQuery(**{item.name: getattr(self, item.name)[index] for item in fields(self)})


class PlanSpace:
    """Splines, inverse dynamics and limits of one robot.

    Args:
        robot: the robot.
        error_bounds: bounds of the tracking error.

    Raises:
        ValueError: if the robot has more than one redundant cable.
    """

    def __init__(self, robot: Robot, error_bounds: ErrorBounds) -> None:
        if robot.cables > robot.coordinates + 1:
            raise ValueError(
                f"robot {robot.name!r} has {robot.cables - robot.coordinates} redundant cables: "
                "a network plans for at most one"
            )
        self.robot = robot
        self.error_bounds = error_bounds
        self.degree = FLEXIBLE_DEGREE if robot.flexible else RIGID_DEGREE
        self.fixed = FIXED_POINTS[robot.joints]
        self.knots = clamped_knots(1.0, INTERVALS, self.degree)
        self.nodes = greville(self.knots, self.degree)
        """Fractions of the duration at which the control points act most, (count,)."""
        self.node_basis = self._basis(self.nodes)
        self.stages = self._basis(_fractions(STAGES[robot.joints] * INTERVALS))
        self.checks = self._basis(_fractions(CHECKS[robot.joints] * INTERVALS))
        count = ERROR_STAGES * INTERVALS
        self.errors = self._basis(np.arange(1, count + 1) / count)
        """The instants of the error bounds."""
        fit = self._basis(np.linspace(0.0, 1.0, FIT_SAMPLES))
        self._fit = np.linalg.pinv(fit.matrices[0].numpy())
        self.bounds = torch.tensor(error_bounds.of_coordinates(robot), dtype=_FLOAT)
        """Error bound of each coordinate, (n,) [m, rad]."""
        self.tension = TENSION * float((robot.stall_torque / robot.pulley_radius).mean())
        """Unit of missing tensions [N]."""
        self.reserve = self.margin_vector(RESERVES)
        """Margins in addition to those of a query, (3 + m,)."""

    def margin_vector(self, margins: Mapping[str, float]) -> Tensor:
        """Margins by the names of :class:`Margins` in the order and units of :class:`PlanQuery`."""
        names = ["position", "rotation", "tension"] + ["action"] * self.robot.cables
        return torch.tensor([margins[name] for name in names], dtype=_FLOAT)

    def no_margins(self, count: int) -> Tensor:
        """Margins of zero for a number of plans."""
        return torch.zeros(count, len(self.nodes), 3 + self.robot.cables, dtype=_FLOAT)

    @property
    def has_internal(self) -> bool:
        """Whether the internal tension is planned: the law of a rigid robot selects it."""
        return self.robot.flexible and self.redundant

    @property
    def redundant(self) -> bool:
        """Whether the robot has more cables than coordinates."""
        return self.robot.cables > self.robot.coordinates

    def problem(self, trajectory: Trajectory) -> PlanProblem:
        """The problem of one reference."""
        duration = trajectory.duration
        end = duration * (1 - 1e-12)
        times = self.nodes * duration
        before = trajectory(np.clip(times - JUMP, 0.0, end))
        after = trajectory(np.clip(times + JUMP, 0.0, end))
        points = self._fit @ trajectory(np.linspace(0.0, end, FIT_SAMPLES)).position
        inverse = np.linalg.pinv(textbook.jacobian(self.robot, after.position))
        column = times[:, None]
        edges = [np.exp(-span / tau) for span in (column, duration - column) for tau in DECAYS]
        inputs = [
            after.position - self.robot.home,
            after.velocity,
            before.acceleration,
            after.acceleration,
            inverse.reshape(len(times), -1),
            *edges,
            np.full_like(column, duration),
        ]
        values = {
            "duration": duration,
            "points": points,
            "start": self._start(trajectory),
            "poses": trajectory(self.errors.instants * end).position,
            "inputs": np.concatenate(inputs, axis=1),
            "exact": 0.0,
        }
        tensors = {
            name: torch.tensor(np.asarray(value)[None], dtype=_FLOAT)
            for name, value in values.items()
        }
        tensors["exact"] = self._exact_payload(PlanProblem(**tensors))
        return PlanProblem(**tensors)

    def _start(self, trajectory: Trajectory) -> Array:
        """First control points: the start pose with the velocity of the reference."""
        pose = start_pose(self.robot, trajectory, self.error_bounds)
        times = self.nodes[: self.fixed, None] * trajectory.duration
        points: Array = pose + times * trajectory(0.0).velocity
        return points

    def _exact_payload(self, problem: PlanProblem) -> Tensor:
        """Payload with which the actions along the reference reach ±1, at least a twentieth of the
        robot's mass, (N,) [kg]."""
        mass = self.robot.mass
        payloads = torch.tensor([[0.0, mass]]).expand(len(problem), -1)
        query = self.query(problem, payloads, self.no_margins(len(problem)))
        points = torch.cat([problem.points, query.internal], dim=-1)
        orders = self.node_basis.orders(points, problem.duration)
        unloaded, loaded = self.actuation(query, orders).action.unbind(dim=2)
        slope = (loaded - unloaded) / mass
        largest = (1 - slope.sign() * unloaded) / slope.abs()
        return largest.amin((1, 2)).clamp(min=0.05 * mass)

    @torch.no_grad()
    def query(self, problem: PlanProblem, payloads: Tensor, margins: Tensor) -> PlanQuery:
        """The query of plans with payloads (N, 2) and margins."""
        nothing = problem.points[..., :0]
        query = PlanQuery(problem=problem, payloads=payloads, margins=margins, internal=nothing)
        if not self.has_internal:
            return query
        orders = self.node_basis.orders(problem.points, problem.duration)
        structure = textbook.jacobian(self.robot, problem.points.numpy())
        tensions = self.actuation(query, orders).tensions
        return replace(query, internal=_internal(torch.tensor(structure), tensions))

    def _basis(self, instants: Array) -> Basis:
        return Basis.of(self.knots, self.degree, instants, 4 if self.robot.flexible else 2)

    def actuation(self, query: PlanQuery, orders: Sequence[Tensor]) -> RequiredActuation:
        """Tensions, torques and actions at instants with both payloads, each (N, instants, 2, m).

        Args:
            query: what the plans are asked for.
            orders: X, with the internal tensions, and its derivatives, each (N, instants, n) or (N,
                instants, n + 2).
        """
        count, instants, size = orders[0].shape
        coordinates = self.robot.coordinates
        rows = [order.reshape(count * instants, size) for order in orders]
        internal = None
        if size > coordinates:
            internal = [row[:, coordinates:] for row in rows[:3]]
        minimum = self.robot.minimum_tension + self.tension * query.margins[:, 0, 2]
        required = required_actuation(
            self.robot,
            [row[:, :coordinates] for row in rows],
            (self.robot.mass + query.payloads).repeat_interleave(instants, dim=0),
            minimum.repeat_interleave(instants),
            internal,
        )
        shape = (count, instants, 2, self.robot.cables)
        values = {item.name: getattr(required, item.name).view(shape) for item in fields(required)}
        return RequiredActuation(**values)

    def excess(self, query: PlanQuery, orders: Sequence[Tensor], basis: Basis) -> Tensor:
        """How far the actions and the tensions are beyond their limits, (N, instants, 4 m); negative
        within them.

        Args:
            query: what the plans are asked for.
            orders: as for :meth:`actuation`.
            basis: the instants.
        """
        required = self.actuation(query, orders)
        margins = basis.interpolation @ query.margins
        action = required.action.abs() - (1 - margins[:, :, None, 3:])
        reserve = self.robot.minimum_tension + self.tension * margins[:, :, 2, None, None]
        missing = reserve - required.tensions
        if np.isfinite(self.robot.maximum_tension):
            most = self.robot.maximum_tension + self.robot.minimum_tension - reserve
            missing = torch.maximum(missing, required.tensions - most)
        return torch.cat([action.flatten(2), missing.flatten(2) / self.tension], dim=-1)

    def error_excess(self, query: PlanQuery, poses: Tensor) -> Tensor:
        """How far poses at the instants of :attr:`errors` are beyond the error bounds in units of
        them, (N, instants, 1 + angles); negative within them."""
        split = self.robot.dimensions
        deviation = (poses[..., : self.robot.coordinates] - query.problem.poses) / self.bounds
        distance = deviation[..., :split].norm(dim=-1, keepdim=True)
        rotation = deviation[..., split:].abs()
        margins = self.errors.interpolation @ query.margins
        return torch.cat([distance + margins[..., :1], rotation + margins[..., 1:2]], dim=-1) - 1

    def violations(self, query: PlanQuery, points: Tensor, basis: Basis) -> tuple[Tensor, Tensor]:
        """Violations of actions and tensions, (N, instants, 4 m), and of the error bounds, (N,
        instants, 1 + angles); zero within the limits.

        Args:
            query: what the plans are asked for.
            points: control points of the motions and of the internal tensions, (N, count, n) or (N,
                count, n + 2).
            basis: the instants of actions and tensions.
        """
        excess = self.excess(query, basis.orders(points, query.problem.duration), basis)
        return torch.relu(excess), torch.relu(self.error_excess(query, self.errors.poses(points)))

    @torch.no_grad()
    def motor_points(self, query: PlanQuery, points: Tensor) -> list[Array]:
        """Control points of the motor angles that the motion of a single query requires with each
        payload, each (count, m) [rad]."""
        robot = self.robot
        basis = self._basis(np.linspace(0.0, 1.0, MOTOR_SAMPLES * len(self.nodes)))
        required = self.actuation(query, basis.orders(points, query.problem.duration))
        forces = required.tensions[0]
        if robot.jointed:  # the springs accelerate the pulleys, too
            forces = required.torques[0] / torch.tensor(robot.pulley_radius)
        poses = basis.poses(points[0])[:, None, : robot.coordinates]
        angles = textbook.rest_angles(robot, forces.numpy(), poses.numpy())
        inner = self.degree - MOTOR_DEGREE
        spline = make_lsq_spline(basis.instants, angles, self.knots[inner:-inner], MOTOR_DEGREE)
        return list(np.moveaxis(spline.c, 1, 0))

    def node_margins(
        self, margins: Margins, profile: MarginProfile | None, duration: float
    ) -> Tensor:
        """Margins at the control points of one motion, (1, count, 3 + m), see :class:`PlanQuery`."""
        names = ("position", "rotation", "tension", "action")
        sizes = (self.error_bounds.position, self.error_bounds.rotation, self.tension, 1.0)
        times = self.nodes * duration
        columns = []
        for name, size in zip(names, sizes, strict=True):
            width = self.robot.cables if name == "action" else 1
            values = np.full((len(times), width), getattr(margins, name))
            if profile is not None:
                largest = profile.largest(name, times, duration / len(times))
                values += largest.reshape(len(times), width)
            columns.append(values / size)
        return torch.tensor(np.concatenate(columns, axis=1)[None])


@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """Basis functions of a spline at fractions of the duration."""

    instants: Array
    """The fractions, from 0 to 1."""
    matrices: tuple[Tensor, ...]
    """Values and derivatives with respect to the fraction, each (instants, count)."""
    interpolation: Tensor
    """Linear interpolation between the control points, (instants, count)."""

    @classmethod
    def of(cls, knots: Array, degree: int, instants: Array, orders: int) -> Basis:
        """The basis functions and their derivatives up to an order."""
        count = len(knots) - degree - 1
        spline = BSpline(knots, np.eye(count), degree)
        inside = np.clip(instants, 0.0, 1.0 - 1e-12)
        matrices = [torch.tensor(spline(inside, order)) for order in range(orders + 1)]
        nodes = greville(knots, degree)
        columns = [np.interp(inside, nodes, row) for row in np.eye(count)]
        return cls(
            instants=instants,
            matrices=tuple(matrices),
            interpolation=torch.tensor(np.stack(columns, axis=1)),
        )

    def poses(self, points: Tensor) -> Tensor:
        """X at the instants, (..., instants, n)."""
        return self.matrices[0] @ points

    def orders(self, points: Tensor, duration: Tensor) -> list[Tensor]:
        """X and its derivatives with respect to time, each (N, instants, n)."""
        return [
            matrix @ points / duration[:, None, None] ** order
            for order, matrix in enumerate(self.matrices)
        ]


def largest_violation(parts: Sequence[Tensor]) -> Tensor:
    """Largest violation of each motion, (N,), see :meth:`PlanSpace.violations`."""
    return torch.stack([part.detach().flatten(1).amax(1) for part in parts]).amax(0)


def _fractions(count: int) -> Array:
    """Equally spaced fractions from 0 to 1, the ends of this number of parts. Accelerations have
    their extremes at the knots, which are among them."""
    return np.linspace(0.0, 1.0, count + 1)


def _internal(structure: Tensor, tensions: Tensor) -> Tensor:
    """Internal tensions (N, count, 2) of tensions (N, count, 2, m), see
    :func:`~cablebot_baselines.learned.differentiable.internal_direction`."""
    _, direction = internal_direction(structure)
    square = (direction**2).sum(-1)
    return (tensions * direction[..., None, :]).sum(-1) / square[..., None]
