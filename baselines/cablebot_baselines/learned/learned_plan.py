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
from cablebot_baselines.planners.rehearsed import Planner, intervals_of
from cablebot_baselines.planners.trajopt import TrajOpt
from cablebot_gym.planning import Margins, MotionProgram, PlannedMotion
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task


class NetworkPlans:
    """Plans of the network in a file.

    Args:
        path: ``plan.pt`` of a training. It holds tensors only and runs no code.

    Raises:
        ValueError: if the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        try:
            self.key = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
            self._weights = torch.load(path, weights_only=True)
        except (OSError, RuntimeError, ValueError) as error:
            raise ValueError(f"cannot read the network in {str(path)!r} ({error})") from error

    def planner(self, name: str, *, refined: bool = False) -> Planner:
        """How a policy of this name makes its plans."""
        first = self._refined if refined else self._planned
        return Planner(name=name, first=first, module=__name__, key=self.key)

    def _planned(
        self, robot: Robot, task: Task, margins: Margins, lightest: float
    ) -> tuple[NetworkProgram, PlannedMotion]:
        space = PlanSpace(robot, task.error_bounds)
        network = PlanNetwork.of_weights(space, self._weights)
        motion = task.trajectory
        program = NetworkProgram(network, space, motion, margins=margins, lightest=lightest)
        return program, program.solve()

    def _refined(
        self, robot: Robot, task: Task, margins: Margins, lightest: float
    ) -> tuple[MotionProgram, PlannedMotion]:
        """The nonlinear program, and its solution near the plan of the network."""
        _, start = self._planned(robot, task, margins, lightest)
        program = MotionProgram(
            robot,
            task.trajectory,
            task.error_bounds,
            intervals=intervals_of(robot, task.trajectory),
            margins=margins,
            lightest=lightest,
            period=1 / task.control_frequency,
        )
        return program, program.solve(start, near=True)


def learned_plan(robot: Robot, path: Path) -> TrajOpt:
    """The policy with the plans of the network in a file.

    Raises:
        ValueError: if the file cannot be read, or the motors of the robot have a lag.
    """
    return TrajOpt(robot, NetworkPlans(path).planner("learned-plan"))


def refined_plan(robot: Robot, path: Path) -> TrajOpt:
    """The policy with plans that a nonlinear program refines.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: as :func:`learned_plan`.
    """
    import_casadi()
    return TrajOpt(robot, NetworkPlans(path).planner("refined-plan", refined=True))
