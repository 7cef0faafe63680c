"""Optimum: the largest payload of the nonlinear program of a motion (:mod:`cablebot_gym.planning`), on
two meshes and without replays.

Best known payloads (:mod:`~cablebot_gym.bounds.best_known`) refine it and verify it. Needs the extra
``optimal``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from typing import Any, Self

import numpy as np

from cablebot_gym.envs import check_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.motions import Trajectory, find_trajectory
from cablebot_gym.physics.statics import HEAVIEST
from cablebot_gym.planning import Infeasible, MotionProgram, PlannedMotion
from cablebot_gym.planning.library import fingerprint, load_or_compute
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import ErrorBounds, check_workspace, find_error_bounds
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.console import Say

INTERVALS_PER_SECOND = 25.0
"""Intervals of the first mesh per second of motion."""

MIN_INTERVALS = 20
"""Least number of intervals of the first mesh."""

MAX_INTERVALS = 48
"""Largest number of intervals of the first mesh."""

MAX_MESH_FACTOR = 16
"""Largest ratio of the number of intervals to that of the first mesh."""

_FIRST_MESHES = 3
"""Number of coarse meshes that may fail. With narrow error bounds about a jumping reference,
coarse meshes are infeasible."""

MESHES = 2
"""Number of meshes of an optimum."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """The solution of a problem on one mesh."""

    intervals: int
    """Number of intervals."""
    program: MotionProgram
    """The program, after its solution."""
    motion: PlannedMotion
    """Motion with the largest payload."""


@dataclass(frozen=True)
class Problem:
    """A motion of a robot within its limits, whose payload is to be as large as possible."""

    env_id: str
    robot: Robot
    trajectory: Trajectory
    error_bounds: ErrorBounds
    control_frequency: float

    @classmethod
    def of(
        cls,
        env_id: str,
        *,
        robot: Any = None,
        trajectory: Any = None,
        error_bounds: ErrorBounds | dict[str, float] | None = None,
        control_frequency: float | None = None,
    ) -> Self:
        """The problem of the arguments of :func:`find_optimum`.

        Raises:
            ImportError: if CasADi is missing; the message names the command that installs it.
            ValueError: if an argument is invalid.
        """
        import_casadi()
        check_robot(env_id, robot)
        robot = find_robot(env_id if robot is None else robot)
        if trajectory is None:
            trajectory = default_trajectory(robot)
        motion = find_trajectory(trajectory, robot.kind)
        if control_frequency is None:
            control_frequency = robot.defaults.control_frequency
        frequency = number(
            "control_frequency", control_frequency, above=0.5 / motion.duration, unit="Hz"
        )
        return cls(env_id, robot, motion, find_error_bounds(error_bounds, robot), frequency)

    @property
    def conditions(self) -> dict[str, Any]:
        """Keywords of the environment with this problem."""
        return {
            "robot": self.robot,
            "trajectory": self.trajectory,
            "error_bounds": self.error_bounds,
            "control_frequency": self.control_frequency,
        }

    def fingerprint(self, module: str) -> str:
        """Hash of the problem and of a module that solves it, see
        :func:`~cablebot_gym.planning.library.fingerprint`."""
        return fingerprint(
            module,
            self.robot,
            self.trajectory,
            env_id=self.env_id,
            error_bounds=self.error_bounds,
            control_frequency=self.control_frequency,
        )

    def program(self, intervals: int) -> MotionProgram:
        """The nonlinear program on a mesh."""
        period = 1 / self.control_frequency
        return MotionProgram(
            self.robot, self.trajectory, self.error_bounds, intervals=intervals, period=period
        )

    def meshes(self, report: Say) -> Iterator[Mesh]:
        """Solutions on meshes of half the width each, up to :data:`MAX_MESH_FACTOR` times the intervals
        of the first one, or until a mesh has none.

        Args:
            report: callback with a description of the next step.

        Raises:
            ValueError: if no motion within the limits is found, or nothing limits the payload.
        """
        check_workspace(self.robot, self.trajectory)
        mesh = self._first_mesh(report)
        yield mesh
        finest = MAX_MESH_FACTOR * mesh.intervals
        while 2 * mesh.intervals <= finest:
            intervals = 2 * mesh.intervals
            report(f"solving on {intervals} intervals, {mesh.motion.payload:.3f} kg so far")
            program = self.program(intervals)
            try:
                motion = solve(program, mesh.motion)
            except Infeasible:  # the motion on the coarser mesh remains
                report(f"no motion on {intervals} intervals, continuing with the coarser mesh")
                return
            mesh = Mesh(intervals=intervals, program=program, motion=motion)
            yield mesh

    def _first_mesh(self, report: Say) -> Mesh:
        intervals = math.ceil(INTERVALS_PER_SECOND * self.trajectory.duration)
        intervals = min(max(MIN_INTERVALS, intervals), MAX_INTERVALS)
        best = None
        for _ in range(_FIRST_MESHES):
            report(f"solving on {intervals} intervals from several starts")
            program = self.program(intervals)
            best = self.best_of_starts(program)
            if best is not None:
                break
            intervals *= 2
        if best is None or not 0 <= best.payload <= (1 - 1e-3) * HEAVIEST * self.robot.mass:
            raise ValueError(self._infeasibility(best))
        return Mesh(intervals=intervals, program=program, motion=best)

    def best_of_starts(self, program: MotionProgram) -> PlannedMotion | None:
        """Best motion of a program from several starts: the reference, a lowered one, and a wave about it;
        None if all fail."""
        n = self.robot.coordinates
        motions = []
        sag = np.zeros(n)
        sag[min(2, n - 1)] = 0.7
        wave = np.random.default_rng(0).uniform(-0.5, 0.5, (4, n))
        phases = np.linspace(0.0, math.pi, program.control_points)[:, None]
        waves = np.sum(
            [amplitude * np.sin((k + 1) * phases) for k, amplitude in enumerate(wave)], axis=0
        ) / len(wave)
        for shift in (np.zeros(n), sag, waves):
            try:
                motions.append(program.solve(shift=shift))
            except Infeasible:
                continue
        return max(motions, key=lambda motion: motion.payload, default=None)

    def _infeasibility(self, best: PlannedMotion | None) -> str:
        """Error message for a problem without a solution."""
        name = self.trajectory.name
        remedy = "Choose a slower motion, wider error bounds or a lighter platform"
        if best is None:
            return f"no motion along {name!r} within the limits was found. {remedy}"
        if best.payload < 0:
            heaviest = f"at most {self.robot.mass + best.payload:.3g} kg of the platform's {self.robot.mass:g} kg"
            return f"{name!r} is infeasible even unloaded: {heaviest} are feasible. {remedy}"
        heaviest = f"{HEAVIEST * self.robot.mass:g} kg"
        return f"nothing limits the payload on {name!r}: {heaviest} is feasible. Choose a faster motion"


def solve(program: MotionProgram, start: PlannedMotion) -> PlannedMotion:
    """The motion of a program.

    Raises:
        Infeasible: if the solver finds no motion within the constraints.
    """
    try:
        return program.solve(start)
    except Infeasible:  # a start close to the limits can make the solver fail
        return program.solve()


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Largest payload of a motion on a mesh."""

    meshes: tuple[tuple[int, float], ...]
    """Pairs of number of intervals and payload [kg] of the meshes."""
    first: PlannedMotion
    """Motion of the first mesh."""

    @property
    def payload(self) -> float:
        """Payload of the last mesh [kg]."""
        return self.meshes[-1][1]


def find_optimum(env_id: str, *, cache: bool = True, **options: Any) -> Optimum:
    """Computes the optimum of a motion under the task criterion, for an exactly known robot.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        cache: whether to read the result from the disk cache and to store it there.
        options: ``robot``, ``trajectory``, ``error_bounds`` and ``control_frequency`` of
            :func:`~cablebot_gym.bounds.best_known.find_best_known`.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid, or if no motion within the limits is found.
    """
    problem = Problem.of(env_id, **options)
    if not cache:
        return _optimum(problem)
    file = f"optimum-{problem.fingerprint(__name__)}.npz"
    found: Optimum = load_or_compute(file, _read, lambda: _optimum(problem), _bytes)
    return found


def _optimum(problem: Problem) -> Optimum:
    meshes = list(islice(problem.meshes(lambda _: None), MESHES))
    return Optimum(
        meshes=tuple((mesh.intervals, mesh.motion.payload) for mesh in meshes),
        first=meshes[0].motion,
    )


def _bytes(optimum: Optimum) -> bytes:
    buffer = BytesIO()
    meshes = np.array(json.dumps(optimum.meshes))
    np.savez(buffer, meshes=meshes, **optimum.first.to_arrays())  # type: ignore[arg-type]
    return buffer.getvalue()


def _read(data: bytes) -> Optimum:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        meshes = json.loads(str(file["meshes"]))
        return Optimum(
            meshes=tuple((count, payload) for count, payload in meshes),
            first=PlannedMotion.from_arrays(file),
        )
