"""Network that plans a whole motion: it sees the actions and the tensions of its present plan and
moves the control points, a few times.

The first plan is the reference itself. Each pass is trained to give the best plan, whatever plan it
starts from.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from cablebot_baselines.learned.plan_space import PlanQuery, PlanSpace, largest_violation

PASSES = 3
"""Passes of a plan in a training; a finished plan has one more where that is better."""

REACH = 1.05
"""Largest deviation of a control point in units of the error bounds: a spline stays within its control
points."""

WIDTH, BLOCKS, KERNEL = 64, 8, 5
"""Channels, residual blocks and size of their kernels."""

DILATIONS = (1, 2, 4, 8)
"""Dilations of successive blocks."""

LARGEST_ACTION, LARGEST_TENSION = 4.0, 8.0
"""Largest inputs of actions, and of tensions in the unit of
:class:`~cablebot_baselines.learned.plan_space.PlanSpace`; half of it below zero."""

LARGEST_INPUT = 8.0
"""Largest normalised input."""


class PlanNetwork(nn.Module):
    """Residual dilated convolutions over the control points, for one robot.

    Args:
        space: splines and limits of the robot.
        inputs: number of inputs, see :meth:`_features`.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, space: PlanSpace, inputs: int) -> None:
        super().__init__()
        self._space = space
        outputs = space.robot.coordinates + 2 * space.has_internal
        self.first = nn.Conv1d(inputs + outputs, WIDTH, 1)
        self.blocks = nn.ModuleList(_block(DILATIONS[k % len(DILATIONS)]) for k in range(BLOCKS))
        self.last = nn.Conv1d(WIDTH, outputs, 1, bias=False)
        self.last.weight.data *= 0.05
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("scale", torch.ones(inputs))

    @classmethod
    def fresh(cls, space: PlanSpace, query: PlanQuery) -> PlanNetwork:
        """A network with random weights, whose inputs are normalised to those of a query."""
        features = _features(space, query, no_moves(query))
        network = cls(space, features.shape[-1])
        network.mean[:] = features.mean((0, 1))
        network.scale[:] = features.std((0, 1)) + 0.01
        return network

    @classmethod
    def of_weights(cls, space: PlanSpace, weights: Mapping[str, Any]) -> PlanNetwork:
        """The network of a ``state_dict``."""
        network = cls(space, len(weights["mean"]))
        network.load_state_dict(dict(weights))
        return network

    def forward(self, query: PlanQuery, moves: Tensor) -> Tensor:
        """The moves of the control points after one more pass, see :func:`control_points`."""
        features = _features(self._space, query, moves)
        normalised = (features.float() - self.mean) / self.scale
        normalised = normalised.clamp(-LARGEST_INPUT, LARGEST_INPUT)
        hidden = self.first(torch.cat([normalised, moves.float()], dim=-1).mT)
        for block in self.blocks:
            hidden = hidden + block(hidden)
        change: Tensor = self.last(hidden).mT.double()
        return moves + change

    @torch.no_grad()
    def moves(self, query: PlanQuery, passes: int) -> Tensor:
        """The moves of the control points after several passes from the references."""
        moves = no_moves(query)
        for _ in range(passes):
            moves = self(query, moves)
        return moves

    @torch.no_grad()
    def plan(self, query: PlanQuery) -> tuple[Tensor, Tensor]:
        """Control points of finished plans, see :func:`control_points`, and their largest violations
        at the instants of a check, (N,)."""
        space = self._space
        moves = self.moves(query, PASSES)
        plans = [control_points(space, query, each) for each in (moves, self(query, moves))]
        violations = [
            largest_violation(space.violations(query, points, space.checks)) for points in plans
        ]
        is_better = violations[1] < violations[0]
        points = torch.where(is_better[:, None, None], plans[1], plans[0])
        return points, torch.minimum(*violations)


def no_moves(query: PlanQuery) -> Tensor:
    """The moves of the references themselves."""
    return torch.zeros_like(torch.cat([query.problem.points, query.internal], dim=-1))


def _block(dilation: int) -> nn.Sequential:
    padding = dilation * (KERNEL // 2)
    wide = nn.Conv1d(WIDTH, WIDTH, KERNEL, dilation=dilation, padding=padding)
    last = nn.Conv1d(WIDTH, WIDTH, 1)
    last.weight.data *= 0.3
    return nn.Sequential(nn.GELU(), wide, nn.GELU(), last)


def control_points(space: PlanSpace, query: PlanQuery, moves: Tensor) -> Tensor:
    """Control points of motions that begin at the start of the task, and of internal tensions, (N,
    count, n) or (N, count, n + 2).

    Args:
        space: splines and limits of the robot.
        query: what the plans are asked for.
        moves: any numbers of the same shape. Those of the pose are squashed, so that the control
            points stay near the tube of the error bounds; those of the internal tensions are in units
            of :attr:`~cablebot_baselines.learned.plan_space.PlanSpace.tension`.
    """
    problem = query.problem
    points = problem.points + space.bounds * _deviation(space, moves)
    points = torch.cat([problem.start, points[:, space.fixed :]], dim=1)
    internal = query.internal + space.tension * moves[..., space.robot.coordinates :]
    return torch.cat([points, internal], dim=-1)


def _deviation(space: PlanSpace, moves: Tensor) -> Tensor:
    """Deviations from the reference in units of the error bounds, (N, count, n)."""
    split = space.robot.dimensions
    position = moves[..., :split]
    square = (position**2).sum(-1, keepdim=True)
    position = position / (1 + square**2) ** 0.25
    rotation = torch.tanh(moves[..., split : space.robot.coordinates])
    return REACH * torch.cat([position, rotation], dim=-1)


@torch.no_grad()
def _features(space: PlanSpace, query: PlanQuery, moves: Tensor) -> Tensor:
    """Inputs of the network at each control point, (N, count, inputs): the reference, and the actions
    and tensions of the present plan with both payloads."""
    problem = query.problem
    margins = query.margins
    points = control_points(space, query, moves)
    required = space.actuation(query, space.node_basis.orders(points, problem.duration))
    reserve = space.robot.minimum_tension / space.tension + margins[..., 2, None]
    missing = reserve - required.tensions.flatten(2) / space.tension
    limits = (1 - margins[..., None, 3:]).expand_as(required.action).flatten(2)
    actions = required.action.flatten(2)
    each = torch.ones_like(problem.points[..., :1])
    heaviest = query.payloads[:, 1, None, None] * each
    return torch.cat(
        [
            problem.inputs,
            actions.clamp(-LARGEST_ACTION, LARGEST_ACTION),
            missing.clamp(-LARGEST_TENSION, LARGEST_TENSION / 2),
            torch.relu(actions.abs() - limits + 0.1).clamp(max=LARGEST_ACTION),
            torch.relu(missing + 0.2).clamp(max=LARGEST_TENSION),
            _deviation(space, moves),
            margins,
            heaviest / problem.exact[:, None, None],
            heaviest,
        ],
        dim=-1,
    )
