"""Best known payload: the largest known payload for which a motion and its inputs stay within all limits.

It is a lower bound of the largest feasible payload. A local solver computes it, and a replay of the inputs in the
environment verifies it. Only a certificate gives an upper bound. Needs the extra ``optimal``.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields
from importlib.metadata import version
from io import BytesIO
from typing import Any

import numpy as np

from cablebot_gym.bounds.certificate import planar_certificate
from cablebot_gym.envs import check_robot, env_robot
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import MINIMUM_TENSION
from cablebot_gym.planning import Follower, Infeasible, Margins, MotionProgram, PlannedMotion, State
from cablebot_gym.planning.library import fingerprint, load_or_compute, read_cached
from cablebot_gym.planning.program import HEAVIEST
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.policies.protocol import OpenLoop
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import ErrorBounds, check_workspace, find_error_bounds, to_jsonable
from cablebot_gym.trajectories import Trajectory, find_trajectory
from cablebot_gym.utils.checks import number

MESH_TOLERANCE = 0.005
"""Relative change of the payload below which the mesh refinement stops."""

INTERVALS_PER_SECOND, MIN_INTERVALS = 25.0, 20
"""Number of intervals in the first mesh: per second of motion, and minimum."""

_SMALL = 0.1
"""Payload, as a fraction of the platform mass, below which the refinement stops at an absolute change."""

MAX_MESH_FACTOR = 16
"""Largest ratio of the number of intervals to that of the first mesh."""

_FIRST_FRACTION = 5e-4
_FIRST_MARGINS = Margins(action=1e-4, tension=0.05)
"""Smallest margins: fraction of the error bounds, and margins of action and tension. They cover errors of solver and
sampling."""

_MARGIN_LEVELS = 10
"""Number of margin levels. Each level doubles the margins of the previous one."""

_ENOUGH = 0.997
"""Least accepted ratio of the replayed payload to that of the program. Below it, a mesh of half the width is tried,
because springs oscillate between the collocation points."""

_GAINS = {"rigid": (2500.0, 100.0), "flexible": (100.0, 10.0)}
"""Gains (K_P, K_D) of the controller that computes the inputs of a motion [1/s², 1/s]. The replay has no feedback."""

_MOTOR_FREQUENCY = 200.0
"""Frequency of the motor loop of flexible robots in that controller [rad/s]."""

_FIRST_MESHES = 3
"""Number of coarse meshes that may fail. In a narrow tube about a jumping reference, coarse meshes are infeasible."""

_STRONGER, _WIDER = 1e3, 0.05
"""Relaxations that identify the limiting constraint: factor of the motor strength, and error bound [m, rad]."""

Progress = Callable[[str], None]
"""Callback with a description of the next step."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BestKnownPayload:
    """Largest known payload for which a motion and its inputs stay within all limits: a lower bound."""

    env_id: str
    """Id of the environment."""
    payload: float
    """Best known payload [kg]."""
    total_mass: float
    """Mass of platform and payload [kg]."""
    verified: bool
    """Whether a replay of the inputs carried the payload in the environment. The inputs are constant during a control
    period. The DLCC monitor checks every physics step under the task criterion."""
    error_bounds: dict[str, float | None]
    """Bounds of the position error [m] and the rotation error [rad]; None for a planar robot."""
    program_payload: float
    """Payload of the nonlinear program without margins, on the finest mesh [kg]."""
    meshes: tuple[tuple[int, float], ...]
    """Pairs of number of intervals and payload [kg] for every mesh."""
    margins: dict[str, float]
    """Margins of the replayed motion with respect to the limits."""
    upper: dict[str, Any] | None
    """Proved upper bound, see :class:`~cablebot_gym.bounds.certificate.Certificate`; None where none is known."""
    environment: dict[str, Any]
    """Robot, trajectory and control frequency, as JSON-able data."""
    versions: dict[str, str]
    """Versions of Python and of the packages that determine the result."""
    motion: PlannedMotion = field(repr=False)
    """Planned motion of the platform."""
    actions: Array = field(repr=False)
    """Action of every control step, (steps, m)."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data without the motion and its actions."""
        data = {item.name: getattr(self, item.name) for item in fields(self) if item.repr}
        return data | {"meshes": [list(mesh) for mesh in self.meshes]}

    def to_json(self) -> str:
        """The result as JSON, indented."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        bounds = f"{1e3 * (self.error_bounds['position'] or 0):g} mm"
        if self.error_bounds["rotation"] is not None:
            bounds += f", {1e3 * self.error_bounds['rotation']:g} mrad"
        status = "verified by replay" if self.verified else "not verified: every replay violates a limit"
        text = (
            f"{self.env_id}, {self.environment['trajectory']['name']}, {bounds}: best known payload {self.payload:.3f} "
            f"kg (total {self.total_mass:.3f} kg), {status}; a lower bound of the feasible payload"
        )
        if self.upper is not None and self.upper["total_mass"] is not None:
            text += f"\nproved upper bound: {self.upper['payload']:.3f} kg"
            text += f" (total {self.upper['total_mass']:.3f} kg); {self.upper['conditions']}"
        return text


def find_best_known(
    env_id: str,
    *,
    robot: Robot | None = None,
    trajectory: Any = None,
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    control_frequency: float = 500.0,
    progress: Progress | None = None,
    cache: bool = True,
) -> BestKnownPayload:
    """Computes the best known payload under the task criterion.

    A nonlinear program with splines and collocation (:mod:`cablebot_gym.planning`) is solved from several starts. The
    mesh is halved until the relative change of the payload is below :data:`MESH_TOLERANCE`. The final motion keeps
    margins to the limits. A controller with feedback computes its inputs once. The margins are the smallest ones with
    which an open-loop replay of these inputs carries the payload in the environment.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        robot: robot of the environment's kind; None for the robot of the environment.
        trajectory: name, name with fields, or object; None for the default of the environment.
        error_bounds: bounds of the tracking errors; None for 10 mm and 10 mrad.
        control_frequency: actions per second [Hz].
        progress: callback with a description of the next step.
        cache: whether to read the result from the disk cache and to store it there.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid, or if no motion within the limits is found. The message names the
            limiting constraint.
    """
    import_casadi()
    case = _case(env_id, robot, trajectory, error_bounds, control_frequency)
    report: Progress = progress or (lambda _: None)
    if not cache:
        return case.solve(report)
    result: BestKnownPayload = load_or_compute(case.file, _read, lambda: case.solve(report), _bytes)
    return result


def cached_best_known(env_id: str, **options: Any) -> BestKnownPayload | None:
    """Cached result of :func:`find_best_known` for the same arguments; None if the disk cache has none.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        options: keyword arguments of :func:`find_best_known` that describe the problem.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid.
    """
    import_casadi()
    cached: BestKnownPayload | None = read_cached(_case(env_id, **options).file, _read)
    return cached


def _case(
    env_id: str,
    robot: Robot | None = None,
    trajectory: Any = None,
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    control_frequency: float = 500.0,
) -> _Case:
    robot = find_robot(env_robot(env_id)) if robot is None else robot
    check_robot(env_id, robot)
    motion = find_trajectory(default_trajectory(robot) if trajectory is None else trajectory, robot.coordinates)
    frequency = number("control_frequency", control_frequency, above=0.5 / motion.duration, unit="Hz")
    return _Case(env_id, robot, motion, find_error_bounds(error_bounds), frequency)


@dataclass(frozen=True)
class _Case:
    """One problem: the arguments of :func:`find_best_known` in canonical form."""

    env_id: str
    robot: Robot
    trajectory: Trajectory
    error_bounds: ErrorBounds
    control_frequency: float

    @property
    def steps(self) -> int:
        return round(self.trajectory.duration * self.control_frequency)

    @property
    def file(self) -> str:
        """Name of the cache file."""
        data = {"env_id": self.env_id, "error_bounds": self.error_bounds, "control_frequency": self.control_frequency}
        return f"best-{fingerprint('cablebot_gym.bounds.best_known', self.robot, self.trajectory, **data)}.npz"

    def solve(self, report: Progress) -> BestKnownPayload:
        """Solves and refines the program, verifies the motion, and adds the upper bound."""
        check_workspace(self.robot, self.trajectory)
        meshes = list(self._refine(report))
        intervals, program = meshes[-1]
        motion, actions, margins, verified = self._verify(intervals, program, report)
        if not verified or motion.payload < _ENOUGH * program.payload:
            finer = self._verify(2 * intervals, program, report)
            if finer[-1] and (not verified or finer[0].payload > motion.payload):
                motion, actions, margins, verified = finer
        robot, upper = self.robot, None
        if robot.planar and not robot.flexible:
            report("computing the certificate of an upper bound")
            with suppress(ValueError):  # no certificate exists if the tube reaches an anchor
                upper = planar_certificate(robot, self.trajectory, self.error_bounds).to_dict()
        return BestKnownPayload(
            env_id=self.env_id,
            payload=motion.payload,
            total_mass=robot.mass + motion.payload,
            verified=verified,
            error_bounds=vars(self.error_bounds) | ({"rotation": None} if robot.planar else {}),
            program_payload=program.payload,
            meshes=tuple((count, mesh.payload) for count, mesh in meshes),
            margins=to_jsonable(margins),
            upper=upper,
            environment={
                "robot": robot.to_dict(),
                "trajectory": to_jsonable(self.trajectory),
                "control_frequency": self.control_frequency,
            },
            versions=versions() | {"casadi": version("casadi")},
            motion=motion,
            actions=actions,
        )

    # --- program ---

    def _refine(self, report: Progress) -> Iterator[tuple[int, PlannedMotion]]:
        """Number of intervals and motion of every mesh."""
        intervals, best = max(MIN_INTERVALS, math.ceil(INTERVALS_PER_SECOND * self.trajectory.duration)), None
        for _ in range(_FIRST_MESHES):
            report(f"solving on {intervals} intervals from several starts")
            best = self._first(intervals)
            if best is not None:
                break
            intervals *= 2
        if best is None or best.payload < 0 or best.payload > (1 - 1e-3) * HEAVIEST:
            raise ValueError(self._infeasibility(intervals, best))
        yield intervals, best
        finest = MAX_MESH_FACTOR * intervals
        while 2 * intervals <= finest:
            intervals *= 2
            report(f"solving on {intervals} intervals, {best.payload:.3f} kg so far")
            try:
                finer = self._solve(intervals, best)
            except Infeasible:  # the motion on the coarser mesh remains a candidate
                report(f"no motion on {intervals} intervals, continuing with the coarser mesh")
                return
            yield intervals, finer
            change, best = abs(finer.payload - best.payload), finer
            if change < MESH_TOLERANCE * max(best.payload, _SMALL * self.robot.mass):
                return

    def _first(self, intervals: int) -> PlannedMotion | None:
        """Best motion from several starts: the reference, a lowered one, and a wave about it; None if all fail."""
        program = self._program(intervals)
        n, motions = self.robot.coordinates, []
        sag = np.zeros(n)
        sag[min(2, n - 1)] = 0.7
        wave = np.random.default_rng(0).uniform(-0.5, 0.5, (4, n))
        phases = np.linspace(0.0, math.pi, program.control_points)[:, None]
        waves = np.sum([amplitude * np.sin((k + 1) * phases) for k, amplitude in enumerate(wave)], axis=0) / len(wave)
        for shift in (np.zeros(n), sag, waves):
            try:
                motions.append(program.solve(shift=shift))
            except Infeasible:
                continue
        return max(motions, key=lambda motion: motion.payload, default=None)

    def _program(self, intervals: int, margins: Margins | None = None) -> MotionProgram:
        period = 1 / self.control_frequency
        return MotionProgram(
            self.robot, self.trajectory, self.error_bounds, intervals=intervals, margins=margins, period=period
        )

    def _solve(self, intervals: int, start: PlannedMotion, margins: Margins | None = None) -> PlannedMotion:
        program = self._program(intervals, margins)
        try:
            return program.solve(start)
        except Infeasible:  # a start close to the limits can make the solver fail
            return program.solve()

    def _infeasibility(self, intervals: int, best: PlannedMotion | None) -> str:
        """Error message for a problem without a solution."""
        name, remedy = self.trajectory.name, "Choose a slower motion, wider error bounds or a lighter platform"
        if best is None:
            return f"no motion along {name!r} within the limits was found; limiting: {self._cause(intervals)}. {remedy}"
        if best.payload < 0:
            heaviest = f"at most {self.robot.mass + best.payload:.3g} kg of the platform's {self.robot.mass:g} kg"
            return f"{name!r} is infeasible even unloaded: {heaviest} are feasible. {remedy}"
        return f"nothing limits the payload on {name!r}: {HEAVIEST:g} kg is feasible. Choose a faster motion"

    def _cause(self, intervals: int) -> str:
        """The constraint whose relaxation makes the problem feasible."""
        motors, bounds = self.robot.motors, self.error_bounds
        free_speed = tuple(_STRONGER * self.robot.per_motor(motors.free_speed))
        stall_torque = tuple(_STRONGER * self.robot.stall_torque)
        stronger = self.robot.replace(motors=motors.replace(stall_torque=stall_torque, free_speed=free_speed))
        wider = ErrorBounds(position=max(_WIDER, bounds.position), rotation=max(_WIDER, bounds.rotation))
        for cause, robot, tube in (
            ("the motors' torque-speed lines", stronger, bounds),
            ("the error bounds", self.robot, wider),
            ("the error bounds together with the motors' torque-speed lines", stronger, wider),
        ):
            with suppress(Infeasible):
                if MotionProgram(robot, self.trajectory, tube, intervals=intervals).solve().payload >= 0:
                    return cause
        return "the cables, which can only pull, but the motion needs pushing forces"

    # --- replay ---

    def _verify(
        self, intervals: int, program: PlannedMotion, report: Progress
    ) -> tuple[PlannedMotion, Array, Margins, bool]:
        """Bisects over the margins for the heaviest motion whose inputs pass a replay."""
        low, high = 0, _MARGIN_LEVELS
        best: tuple[PlannedMotion, Array, Margins] | None = None
        level = _MARGIN_LEVELS // 5
        while low < high:
            margins = self._margins(2.0**level)
            report(f"replaying inputs with a margin of {margins.position * 1e3:.3g} mm")
            try:
                motion = self._solve(intervals, program, margins)
                actions = self._actions(motion)
                passed = self._record(OpenLoop(actions), motion.payload).verdict.carried
            except Infeasible:
                high = level  # larger margins are infeasible as well
                level = (low + high) // 2
                continue
            if passed:
                best, high = (motion, actions, margins), level
            else:
                low = level + 1
            level = (low + high) // 2
        if best is None:
            return program, self._actions(program), Margins(), False
        return *best, True

    def _margins(self, factor: float) -> Margins:
        """The smallest margins times a factor."""
        fraction = factor * _FIRST_FRACTION
        rest = _FIRST_MARGINS.scaled(factor)
        return Margins(
            position=fraction * self.error_bounds.position,
            rotation=fraction * self.error_bounds.rotation,
            action=rest.action,
            tension=min(rest.tension, MINIMUM_TENSION),  # a larger margin only reduces the payload
        )

    def _record(self, policy: Any, payload: float) -> Rollout:
        """The episode of a policy with a payload [kg]."""
        return record_rollout(
            policy,
            self.env_id,
            payload=payload,
            robot=self.robot,
            trajectory=self.trajectory,
            error_bounds=self.error_bounds,
            control_frequency=self.control_frequency,
        )

    def _actions(self, motion: PlannedMotion) -> Array:
        """Actions of a controller that tracks a motion, (steps, m)."""
        follower = Follower(robot=self.robot, gains=_GAINS[self.robot.joints], motor_frequency=_MOTOR_FREQUENCY)
        layout, period, steps = observation_layout(self.robot), 1 / self.control_frequency, itertools.count()

        def track(observation: Array) -> Array:
            state = State.of(layout.split(observation), np.asarray(next(steps) * period))
            return np.clip(follower.action(motion, state, np.asarray(motion.payload), period), -1.0, 1.0)

        actions = self._record(track, motion.payload).arrays["commanded_action"]
        return np.concatenate([actions, np.repeat(actions[-1:], self.steps - len(actions), axis=0)])


def _bytes(result: BestKnownPayload) -> bytes:
    buffer = BytesIO()
    arrays = {"result": np.array(result.to_json()), "actions": result.actions, **result.motion.to_arrays()}
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read(data: bytes) -> BestKnownPayload:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        result = json.loads(str(file["result"]))
        result["meshes"] = tuple((count, payload) for count, payload in result["meshes"])
        return BestKnownPayload(**result, motion=PlannedMotion.from_arrays(file), actions=file["actions"])
