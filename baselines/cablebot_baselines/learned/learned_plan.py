"""Policies that track the plans of trained networks. They need torch."""

from __future__ import annotations

import hashlib
from pathlib import Path

try:
    import torch
except ImportError as error:
    raise ImportError(
        "learned plans need the extra: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.learned.network_program import NetworkProgram
from cablebot_baselines.learned.plan_network import PlanNetwork
from cablebot_baselines.learned.plan_space import PlanSpace
from cablebot_baselines.planners.rehearsed import Planner
from cablebot_baselines.planners.trajopt import TrajOpt
from cablebot_gym.planning import Margins, PlannedMotion
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task


class NetworkPlans:
    """Plans of the network in a file.

    Args:
        path: ``plan.zip`` of a training. It holds tensors only and runs no code.

    Raises:
        ValueError: if the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        try:
            self.key = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
            self._weights = torch.load(path, weights_only=True)
        except (OSError, RuntimeError, ValueError) as error:
            raise ValueError(f"cannot read the network in {str(path)!r} ({error})") from error

    def planner(self, name: str, *, refine: bool) -> Planner:
        """How the policy of this name makes its plans."""

        def first(
            robot: Robot, task: Task, margins: Margins, lightest: float
        ) -> tuple[NetworkProgram, PlannedMotion]:
            space = PlanSpace(robot, task.error_bounds)
            program = NetworkProgram(
                PlanNetwork.of_weights(space, self._weights),
                space,
                task.trajectory,
                margins=margins,
                lightest=lightest,
                refine=refine,
            )
            return program, program.solve()

        return Planner(name=name, first=first, module=__name__, key=self.key)


def learned_plan(robot: Robot, path: Path) -> TrajOpt:
    """The policy with the plans of the network in a file.

    Raises:
        ValueError: if the file cannot be read, or the motors of the robot have a lag.
    """
    return TrajOpt(robot, NetworkPlans(path).planner("learned-plan", refine=False))


def refined_plan(robot: Robot, path: Path) -> TrajOpt:
    """The policy with such plans after a few Gauss–Newton steps.

    Raises:
        ValueError: as :func:`learned_plan`.
    """
    return TrajOpt(robot, NetworkPlans(path).planner("refined-plan", refine=True))
