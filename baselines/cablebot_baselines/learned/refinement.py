"""Damped Gauss–Newton steps that remove the violations of plans.

The residuals are the violations of the training's loss at its instants; limits that are nearly
reached count, too, so that a step does not exceed them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cablebot_baselines.learned.plan_space import ERROR_WEIGHT, Basis, PlanQuery, PlanSpace

STEPS = 12
"""Steps."""

ROWS = 4
"""Largest number of limits that count at one instant."""

NEAR = 0.02
"""Distance to a limit within which it counts."""

DAMPING, EASIER, HARDER = 0.3, 0.4, 4.0
"""First weight of the squares of the moves of the control points in units of the error bounds, and its
factors after a step with and without success."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Residuals:
    """Residuals of one plan at its control points."""

    points: Tensor
    """Control points, (count, n)."""
    values: Tensor
    """Weighted violations of the limits that are near or exceeded, (active,)."""
    matrix: Tensor
    """Their derivatives with respect to the control points, (active, count, n)."""

    @property
    def square(self) -> float:
        """Sum of the squares of the violations."""
        return float((self.values**2).sum())


@torch.enable_grad()
def refined(space: PlanSpace, query: PlanQuery, points: Tensor) -> Tensor:
    """Control points of plans with smaller violations, by the method of Levenberg and Marquardt.

    Args:
        space: splines and limits of the robot.
        query: what the plans are asked for.
        points: their control points, see :meth:`~cablebot_baselines.learned.plan_space.PlanSpace.violations`.
    """
    query = replace(query, margins=query.margins + space.reserve)
    best = _residuals(space, query, points)
    damping = [DAMPING] * len(best)
    for _ in range(STEPS):
        left = [index for index, plan in enumerate(best) if plan.square > 0]
        if not left:
            break
        moved = [best[index].points + _move(space, best[index], damping[index]) for index in left]
        tried = _residuals(space, query[left], torch.stack(moved))
        for index, plan in zip(left, tried, strict=True):
            if plan.square < best[index].square:
                best[index] = plan
                damping[index] *= EASIER
            else:
                damping[index] *= HARDER
    return torch.stack([plan.points for plan in best])


def _residuals(space: PlanSpace, query: PlanQuery, points: Tensor) -> list[_Residuals]:
    """The residuals of each plan."""
    durations = query.problem.duration
    orders = [order.requires_grad_() for order in space.stages.orders(points, durations)]
    limits = _rows(space.excess(query, orders, space.stages), orders)
    poses = space.errors.poses(points).requires_grad_()
    errors = _rows(space.error_excess(query, poses), [poses])
    residuals = []
    for plan, duration in enumerate(durations):
        values, matrix = _active(limits, plan, space.stages, duration)
        error_values, error_matrix = _active(errors, plan, space.errors, duration)
        values = torch.cat([values, ERROR_WEIGHT**0.5 * error_values])
        matrix = torch.cat([matrix, ERROR_WEIGHT**0.5 * error_matrix])
        residuals.append(_Residuals(points=points[plan], values=values, matrix=matrix))
    return residuals


def _rows(excess: Tensor, orders: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
    """The largest values at each instant, (N, instants, rows), and their derivatives with respect to
    each order, each (N, instants, rows, n)."""
    values, _ = excess.topk(min(ROWS, excess.shape[-1]), dim=-1)
    columns = [
        torch.autograd.grad(value.sum(), orders, retain_graph=True) for value in values.unbind(-1)
    ]
    slopes = [torch.stack(order, dim=2) for order in zip(*columns, strict=True)]
    return values.detach(), slopes


def _active(
    rows: tuple[Tensor, list[Tensor]], plan: int, basis: Basis, duration: Tensor
) -> tuple[Tensor, Tensor]:
    """Values of a plan that are near or beyond their limits, (active,), and their derivatives with
    respect to its control points, (active, count, n)."""
    values, slopes = rows
    instants, numbers = torch.nonzero(values[plan] > -NEAR, as_tuple=True)
    matrix = torch.zeros(())
    for order, (weights, slope) in enumerate(zip(basis.matrices, slopes, strict=False)):
        at = slope[plan, instants, numbers][:, None, :]
        matrix = matrix + weights[instants][:, :, None] * at / duration**order
    return values[plan, instants, numbers].clamp(min=0.0), matrix


def _move(space: PlanSpace, plan: _Residuals, damping: float) -> Tensor:
    """The move of the control points, (count, n), that makes the sum of the squares of the residuals
    and the damped moves least. The start does not move."""
    units = torch.full(plan.points.shape[-1:], space.tension, dtype=plan.values.dtype)
    units[: len(space.bounds)] = space.bounds
    free = plan.matrix[:, space.fixed :] * units
    flat = free.flatten(1)
    square = flat.T @ flat + damping * torch.eye(flat.shape[1], dtype=flat.dtype)
    move = torch.linalg.solve(square, -flat.T @ plan.values).view(free.shape[1:]) * units
    return torch.cat([torch.zeros_like(plan.points[: space.fixed]), move])
