"""Best known payload: the largest known payload for which a motion and its inputs stay within all
limits.

It is a lower bound of the largest feasible payload. A local solver computes it. Replays of the
inputs in the environment verify it, with the physics step and with a tenth of it. Needs the extra
``optimal``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from io import BytesIO
from typing import Any

import numpy as np

from cablebot_gym.bounds.tightening import Tightening
from cablebot_gym.envs import check_robot
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.settings import default_trajectory, make_settings
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory, find_trajectory
from cablebot_gym.physics.statics import HEAVIEST
from cablebot_gym.planning import (
    Follower,
    Infeasible,
    MarginProfile,
    Margins,
    MotionProgram,
    PlannedMotion,
    State,
)
from cablebot_gym.planning.library import fingerprint, load_or_compute
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.policies.adapters import OpenLoop
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import ErrorBounds, check_workspace, find_error_bounds, to_jsonable
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.console import Say
from cablebot_gym.utils.files import cache_folder, read_cached
from cablebot_gym.utils.results import Result

MESH_TOLERANCE = 0.001
"""Relative change of the payload below which the mesh refinement stops."""

INTERVALS_PER_SECOND = 25.0
"""Intervals of the first mesh per second of motion."""

MIN_INTERVALS = 20
"""Least number of intervals of the first mesh."""

MAX_INTERVALS = 120
"""Largest number of intervals of the first mesh."""

_SMALL = 0.1
"""Payload, as a fraction of the platform mass, below which the refinement stops at an absolute
change."""

MAX_MESH_FACTOR = 16
"""Largest ratio of the number of intervals to that of the first mesh."""

_TRIALS = 25
"""Largest number of margin profiles that are tried on a mesh."""

_MOST_LOST = 0.001
"""Largest accepted relative difference between the payloads of the program and of the replays.
Above it, a mesh of half the width is tried, because springs oscillate between the collocation
points."""

REPLAY_FACTORS = (1, 10)
"""Physics steps of the replays: the environment's step is divided by these factors."""

_GAINS = {"rigid": (2500.0, 100.0), "flexible": (100.0, 10.0)}
"""Gains (K_P, K_D) of the controller that computes the inputs of a motion [1/s², 1/s]. The replay
has no feedback."""

_MOTOR_FREQUENCY = 200.0
"""Frequency of the motor loop of flexible robots in that controller [rad/s]."""

_FIRST_MESHES = 3
"""Number of coarse meshes that may fail. With narrow error bounds about a jumping reference,
coarse meshes are infeasible."""


@dataclass(frozen=True, kw_only=True)
class BestKnownReplay:
    """An episode under the stored inputs, without feedback."""

    substeps: int
    """Physics steps per control period."""
    violation: str | None
    """First violation of the task criterion as text; None if the episode carries the payload."""
    least_tension: float
    """Least tension of any cable at the physics steps [N]."""
    position_peak: float
    """Largest position error at the physics steps [m]."""
    rotation_peak: float
    """Largest rotation error at the physics steps [rad]; 0 for a planar robot."""

    def __str__(self) -> str:
        text = f"least tension {self.least_tension:.3f} N, largest errors {1e3 * self.position_peak:.3f} mm"
        text += f" and {1e3 * self.rotation_peak:.3f} mrad" if self.rotation_peak else ""
        return text if self.violation is None else f"{text}; fails: {self.violation}"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BestKnownPayload(Result):
    """Largest known payload for which a motion and its inputs stay within all limits: a lower
    bound."""

    env_id: str
    """Id of the environment."""
    payload: float
    """Best known payload [kg]."""
    total_mass: float
    """Mass of platform and payload [kg]."""
    verified: bool
    """Whether all replays of the inputs carry the payload in the environment under the task
    criterion."""
    replays: tuple[BestKnownReplay, ...]
    """Replays with the environment's physics step and with a tenth of it."""
    error_bounds: dict[str, float | None]
    """Bounds of the position error [m] and the rotation error [rad]; None for a planar robot."""
    program_payload: float
    """Payload of the nonlinear program without margins, on the finest mesh [kg]."""
    meshes: tuple[tuple[int, float], ...]
    """Pairs of number of intervals and payload [kg] for every mesh."""
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
        replays = [asdict(replay) for replay in self.replays]
        return data | {"meshes": [list(mesh) for mesh in self.meshes], "replays": replays}

    def __str__(self) -> str:
        bounds = f"{1e3 * (self.error_bounds['position'] or 0):g} mm"
        if self.error_bounds["rotation"] is not None:
            bounds += f", {1e3 * self.error_bounds['rotation']:g} mrad"
        status = "verified by replays" if self.verified else "not verified"
        text = (
            f"{self.env_id}, {self.environment['trajectory']['name']}, {bounds}: best known payload {self.payload:.3f} "
            f"kg (total {self.total_mass:.3f} kg), {status}; a lower bound of the feasible payload"
        )
        for replay in self.replays:
            text += f"\nreplay with {replay.substeps} physics steps per control period: {replay}"
        return text


def find_best_known(
    env_id: str,
    *,
    robot: Any = None,
    trajectory: Any = None,
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    control_frequency: float = 500.0,
    progress: Say | None = None,
    cache: bool = True,
) -> BestKnownPayload:
    """Computes the best known payload under the task criterion.

    A nonlinear program with splines and collocation (:mod:`cablebot_gym.planning`) is solved from
    several starts. The mesh is halved until finer ones would hardly change the payload, see
    :func:`has_converged`. The final motion keeps margins to the limits. A controller with feedback
    computes its inputs once. Where open-loop replays of these inputs exceed a limit, the margin to
    it grows at these times, until the replays carry the payload in the environment, with its
    physics step and with a tenth of it.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        robot: robot of the environment's kind, as for ``find_robot``; None for the robot of the
            environment.
        trajectory: name, name with fields, or object; None for the default of the environment.
        error_bounds: bounds of the tracking errors; None for those of the robot.
        control_frequency: actions per second [Hz].
        progress: callback with a description of the next step.
        cache: whether to read the result from the disk cache and to store it there.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid, or if no motion within the limits is found.
    """
    import_casadi()
    case = _case(env_id, robot, trajectory, error_bounds, control_frequency)
    report: Say = progress or (lambda _: None)
    if not cache:
        return case.solve(report)
    result: BestKnownPayload = load_or_compute(case.file, _read, lambda: case.solve(report), _bytes)
    return result


def has_converged(payloads: Sequence[float]) -> bool:
    """Whether a finer mesh would hardly change the payload.

    This holds if the last change is below :data:`MESH_TOLERANCE`. It also holds if the changes
    decrease like a geometric series, and the sum of all further ones is below half of it.

    Args:
        payloads: payloads of meshes of half the width each, relative to the last one.
    """
    changes = np.abs(np.diff(payloads))
    if changes[-1] < MESH_TOLERANCE:
        return True
    if len(changes) < 2 or changes[-1] >= changes[-2]:
        return False
    ratio = changes[-1] / changes[-2]
    return bool(changes[-1] * ratio / (1 - ratio) < MESH_TOLERANCE / 2)


def cached_best_known(env_id: str, **options: Any) -> BestKnownPayload | None:
    """Cached result of :func:`find_best_known` for the same arguments; None if the disk cache has
    none.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        options: keyword arguments of :func:`find_best_known` that describe the problem.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid.
    """
    import_casadi()
    return read_cached(cache_folder() / _case(env_id, **options).file, _read)


def _case(
    env_id: str,
    robot: Any = None,
    trajectory: Any = None,
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    control_frequency: float = 500.0,
) -> _Problem:
    check_robot(env_id, robot)
    robot = find_robot(env_id if robot is None else robot)
    motion = find_trajectory(
        default_trajectory(robot) if trajectory is None else trajectory, robot.kind
    )
    frequency = number(
        "control_frequency", control_frequency, above=0.5 / motion.duration, unit="Hz"
    )
    return _Problem(env_id, robot, motion, find_error_bounds(error_bounds, robot), frequency)


@dataclass(frozen=True)
class _Problem:
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
    def conditions(self) -> dict[str, Any]:
        """Keywords of the environment in which the replays run."""
        return {
            "robot": self.robot,
            "trajectory": self.trajectory,
            "error_bounds": self.error_bounds,
            "control_frequency": self.control_frequency,
        }

    @property
    def substeps(self) -> int:
        """Number of physics steps in a control period of the environment."""
        return make_settings(count=1, **self.conditions).substeps

    @property
    def file(self) -> str:
        """Name of the cache file."""
        key = fingerprint(
            "cablebot_gym.bounds.best_known",
            self.robot,
            self.trajectory,
            env_id=self.env_id,
            error_bounds=self.error_bounds,
            control_frequency=self.control_frequency,
        )
        return f"best-{key}.npz"

    @property
    def tightening(self) -> Tightening:
        """Rule for the margins of the replayed motions."""
        times = np.arange(self.steps) / self.control_frequency
        return Tightening(robot=self.robot, error_bounds=self.error_bounds, times=times)

    def solve(self, report: Say) -> BestKnownPayload:
        """Solves and refines the program, and verifies the motion."""
        check_workspace(self.robot, self.trajectory)
        meshes, program = self._refine(report)
        best = meshes[-1][1]
        found = self._verify(program, best, report)
        if found is None or found.motion.payload < (1 - _MOST_LOST) * best.payload:
            finer = self._verify(self._program(2 * meshes[-1][0]), best, report)
            if finer is not None and (found is None or finer.motion.payload > found.motion.payload):
                found = finer
        if found is None:
            actions = self._track(best, self.tightening.no_profile()).actions
            replays = tuple(replay for replay, _ in self._replays(actions, best.payload))
            found = _Verified(motion=best, actions=actions, replays=replays)
        robot = self.robot
        motion = found.motion
        return BestKnownPayload(
            env_id=self.env_id,
            payload=motion.payload,
            total_mass=robot.mass + motion.payload,
            verified=all(replay.violation is None for replay in found.replays),
            replays=found.replays,
            error_bounds=vars(self.error_bounds) | ({"rotation": None} if robot.point_mass else {}),
            program_payload=best.payload,
            meshes=tuple((count, mesh.payload) for count, mesh in meshes),
            environment={
                "robot": robot.to_dict(),
                "trajectory": to_jsonable(self.trajectory),
                "control_frequency": self.control_frequency,
            },
            versions=versions() | {"casadi": version("casadi")},
            motion=motion,
            actions=found.actions,
        )

    # --- program ---

    def _refine(self, report: Say) -> tuple[list[tuple[int, PlannedMotion]], MotionProgram]:
        """Number of intervals and motion of every mesh, and the program of the last mesh after its
        solution."""
        intervals = math.ceil(INTERVALS_PER_SECOND * self.trajectory.duration)
        best = None
        intervals = min(max(MIN_INTERVALS, intervals), MAX_INTERVALS)
        for _ in range(_FIRST_MESHES):
            report(f"solving on {intervals} intervals from several starts")
            program = self._program(intervals)
            best = self._first(program)
            if best is not None:
                break
            intervals *= 2
        if (
            best is None
            or best.payload < 0
            or best.payload > (1 - 1e-3) * HEAVIEST * self.robot.mass
        ):
            raise ValueError(self._infeasibility(best))
        meshes = [(intervals, best)]
        finest = MAX_MESH_FACTOR * intervals
        while 2 * intervals <= finest:
            intervals *= 2
            report(f"solving on {intervals} intervals, {best.payload:.3f} kg so far")
            finer = self._program(intervals)
            try:
                motion = _solve(finer, best)
            except Infeasible:  # the motion on the coarser mesh remains a candidate
                report(f"no motion on {intervals} intervals, continuing with the coarser mesh")
                break
            meshes.append((intervals, motion))
            best = motion
            program = finer
            unit = max(best.payload, _SMALL * self.robot.mass)
            payloads = [mesh.payload / unit for _, mesh in meshes]
            if has_converged(payloads):
                break
        return meshes, program

    def _first(self, program: MotionProgram) -> PlannedMotion | None:
        """Best motion from several starts: the reference, a lowered one, and a wave about it; None
        if all fail."""
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

    def _program(self, intervals: int) -> MotionProgram:
        period = 1 / self.control_frequency
        return MotionProgram(
            self.robot, self.trajectory, self.error_bounds, intervals=intervals, period=period
        )

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

    # --- replay ---

    def _verify(
        self, program: MotionProgram, start: PlannedMotion, report: Say
    ) -> _Verified | None:
        """The motion with the smallest margins whose inputs pass all replays; None if there is
        none.

        Where an episode exceeds a limit, the margin to this limit grows by the excess at that time.
        """
        tightening = self.tightening
        margins = tightening.least_margins
        profile = tightening.no_profile()
        for trial in range(1, _TRIALS + 1):
            report(f"replaying inputs, trial {trial} of the margins")
            try:
                if trial == 1:
                    motion = _solve(program, start, margins)
                else:
                    motion = program.resolve(margins, profile)
            except Infeasible:  # larger margins are infeasible as well
                return None
            tracked = self._track(motion, profile)
            replays: list[BestKnownReplay] = []
            for replay, episode in self._replays(tracked.actions, motion.payload):
                replays.append(replay)
                if replay.violation is not None:
                    # The finer one, which takes ten times as long, would exceed the same limits.
                    profile = tightening.grown(profile, [episode], tracked.excess)
                    break
            else:
                return _Verified(
                    motion=motion,
                    actions=tracked.actions,
                    replays=tuple(replays),
                )
        return None

    def _replays(self, actions: Array, payload: float) -> Iterator[tuple[BestKnownReplay, Rollout]]:
        """Replays of actions, and their episodes, the coarse one first."""
        for factor in REPLAY_FACTORS:
            substeps = factor * self.substeps
            episode = self._record(OpenLoop(actions), payload, substeps=substeps)
            verdict = episode.verdict
            replay = BestKnownReplay(
                substeps=substeps,
                violation=None if verdict.violation is None else str(verdict.violation),
                least_tension=verdict.least_tension,
                position_peak=verdict.position_peak,
                rotation_peak=verdict.rotation_peak,
            )
            yield replay, episode

    def _record(self, policy: Any, payload: float, **keywords: Any) -> Rollout:
        return record_rollout(policy, self.env_id, payload=payload, **self.conditions | keywords)

    def _track(self, motion: PlannedMotion, profile: MarginProfile) -> _Tracked:
        """Actions of a controller that tracks a motion."""
        gains = _GAINS[self.robot.joints]
        follower = Follower(robot=self.robot, gains=gains, motor_frequency=_MOTOR_FREQUENCY)
        layout = observation_layout(self.robot)
        period = 1 / self.control_frequency
        payload = np.asarray(motion.payload)
        margin = profile.largest("tension", profile.times, 0.0)
        tension = motion.minimum_tension + margin
        requested: list[Array] = []

        def track(observation: Array) -> Array:
            step = len(requested)
            state = State.from_blocks(layout.split(observation), np.asarray(step * period))
            action = follower.action(motion, state, payload, period, float(tension[step]))
            requested.append(action)
            return np.clip(action, -1.0, 1.0)

        episode = self._record(track, motion.payload)
        actions = episode.arrays["commanded_action"]
        excess = np.abs(requested) - 1
        missing = self.steps - len(actions)  # after a termination
        actions = np.concatenate([actions, np.repeat(actions[-1:], missing, axis=0)])
        return _Tracked(actions=actions, excess=excess)


@dataclass(frozen=True, kw_only=True)
class _Tracked:
    """Inputs of a controller that tracks a motion."""

    actions: Array
    """Actions within ± 1 at every control step, (steps, m)."""
    excess: Array
    """Requested actions beyond ± 1 at every step of the episode, (steps, m); not positive where
    they are within it."""


@dataclass(frozen=True, kw_only=True)
class _Verified:
    """A motion, its inputs and their replays."""

    motion: PlannedMotion
    actions: Array
    replays: tuple[BestKnownReplay, ...]


def _solve(
    program: MotionProgram, start: PlannedMotion, margins: Margins | None = None
) -> PlannedMotion:
    """The motion of a program, from its last solution if there is one.

    Raises:
        Infeasible: if the solver finds no motion within the constraints.
    """
    if margins is not None:
        with suppress(Infeasible):
            return program.resolve(margins)
    try:
        return program.solve(start)
    except Infeasible:  # a start close to the limits can make the solver fail
        return program.solve()


def _bytes(result: BestKnownPayload) -> bytes:
    buffer = BytesIO()
    arrays = {
        "result": np.array(result.to_json()),
        "actions": result.actions,
        **result.motion.to_arrays(),
    }
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read(data: bytes) -> BestKnownPayload:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        result = json.loads(str(file["result"]))
        result["meshes"] = tuple((count, payload) for count, payload in result["meshes"])
        result["replays"] = tuple(BestKnownReplay(**replay) for replay in result["replays"])
        return BestKnownPayload(
            **result, motion=PlannedMotion.from_arrays(file), actions=file["actions"]
        )
