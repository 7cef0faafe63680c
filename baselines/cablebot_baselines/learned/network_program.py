"""Plans of a trained network, in the form that the rehearsal of plans asks for."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from cablebot_baselines.learned.plan_network import PlanNetwork
from cablebot_baselines.learned.plan_space import TOLERANCE, PlanSpace, largest_violation
from cablebot_baselines.learned.refinement import refined
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.planning import Infeasible, MarginProfile, Margins, PlannedMotion

COARSE = np.geomspace(0.5, 8.0, 24)
"""Payloads of the first plans, in payloads of exact tracking."""

REFINED = np.geomspace(1.02, 1.12, 8)
"""Payloads of refined plans, in payloads of the network's."""

FINE = 12
"""Number of plans between the heaviest feasible one of these and the next one."""


class NetworkProgram:
    """Plans of a network about one reference.

    Args:
        network: the network of the robot.
        space: splines and limits of the robot.
        trajectory: reference motion.
        margins: margins of the first plan.
        lightest: payload for which a plan must be feasible too [kg].
        refine: whether all plans but the first one are refined by Gauss–Newton steps.
    """

    def __init__(
        self,
        network: PlanNetwork,
        space: PlanSpace,
        trajectory: Trajectory,
        *,
        margins: Margins,
        lightest: float,
        refine: bool = False,
    ) -> None:
        self._network, self._space = network, space
        self._trajectory, self._lightest = trajectory, lightest
        self._margins, self._refine = margins, refine
        self._problem = space.problem(trajectory)

    def solve(self) -> PlannedMotion:
        """The first plan, of the network alone.

        Raises:
            Infeasible: if no plan passes its own check.
        """
        plan, _ = self._planned(self._margins, None)
        return plan

    def resolve(self, margins: Margins, profile: MarginProfile | None = None) -> PlannedMotion:
        """The plan for the heaviest payload of many that passes its own check.

        Args:
            margins: margins to the limits.
            profile: margins over time in addition.

        Raises:
            Infeasible: if none does.
        """
        plan, at_nodes = self._planned(margins, profile)
        heaviest = plan.payload
        while self._refine and plan.payload == heaviest:
            payloads = plan.payload * REFINED
            heaviest = payloads[-1]
            plan = self._best(payloads, at_nodes, margins, refine=True) or plan
        return plan

    def _planned(
        self, margins: Margins, profile: MarginProfile | None
    ) -> tuple[PlannedMotion, Tensor]:
        """The network's plan for the heaviest payload, and the margins at the control points."""
        duration = self._trajectory.duration
        at_nodes = self._space.node_margins(margins, profile, duration)
        plan = self._best(float(self._problem.exact[0]) * COARSE, at_nodes, margins)
        if plan is None:
            raise Infeasible("the network plans no feasible motion")
        finer = plan.payload * np.geomspace(1.0, COARSE[1] / COARSE[0], FINE + 1)[1:-1]
        return self._best(finer, at_nodes, margins) or plan, at_nodes

    @torch.no_grad()
    def _best(
        self, payloads: Array, at_nodes: Tensor, margins: Margins, *, refine: bool = False
    ) -> PlannedMotion | None:
        """The feasible plan with the heaviest of some payloads."""
        space = self._space
        count = len(payloads)
        problem = self._problem[torch.zeros(count, dtype=torch.int64)]
        pairs = torch.tensor([[self._lightest, payload] for payload in payloads])
        query = space.query(problem, pairs, at_nodes.expand(count, -1, -1))
        points, violations = self._network.plan(query)
        if refine:
            points = refined(space, query, points)
            violations = largest_violation(space.violations(query, points, space.checks))
        feasible = np.flatnonzero(violations.numpy() < TOLERANCE)
        if len(feasible) == 0:
            return None
        best = feasible[-1:]
        motors: tuple[Array, ...] = ()
        if space.robot.flexible:
            lightest, heaviest = space.motor_points(query[best], points[best])
            motors = heaviest, lightest
        return PlannedMotion(
            name=self._trajectory.name,
            knots=space.knots * self._trajectory.duration,
            poses=points[best[0], :, : space.robot.coordinates].numpy(),
            motors=motors,
            payload=float(payloads[best[0]]),
            lightest=self._lightest,
            minimum_tension=space.robot.minimum_tension + margins.tension,
        )
