"""Best known payload: the largest known payload for which a motion and its inputs stay within all
limits.

It is a lower bound of the largest feasible payload. A local solver computes it. Replays of the
inputs in the environment verify it, with the physics step and with a tenth of it. Needs the extra
``optimal``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from io import BytesIO
from typing import Any

import numpy as np

from cablebot_gym.bounds.optimum import Mesh, Problem, solve
from cablebot_gym.bounds.tightening import Tightening
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.settings import make_settings
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.rollout import Rollout, record_rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.planning import (
    Follower,
    Infeasible,
    MarginProfile,
    Margins,
    MotionProgram,
    PlannedMotion,
    State,
)
from cablebot_gym.planning.library import load_or_compute
from cablebot_gym.policies.adapters import OpenLoop
from cablebot_gym.task import ErrorBounds, to_jsonable
from cablebot_gym.utils.console import Say
from cablebot_gym.utils.files import cache_folder, read_cached
from cablebot_gym.utils.results import Result

MESH_TOLERANCE = 0.001
"""Relative change of the payload below which the mesh refinement stops."""


_SMALL = 0.1
"""Payload, as a fraction of the platform mass, below which the refinement stops at an absolute
change."""


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
    control_frequency: float | None = None,
    progress: Say | None = None,
    cache: bool = True,
) -> BestKnownPayload:
    """Computes the best known payload under the task criterion.

    A nonlinear program with splines and collocation is solved from several starts, see
    :mod:`~cablebot_gym.bounds.optimum`. The mesh is halved until finer ones would hardly change the payload, see
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
        control_frequency: actions per second [Hz]; None for that of the robot.
        progress: callback with a description of the next step.
        cache: whether to read the result from the disk cache and to store it there.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid, or if no motion within the limits is found.
    """
    search = _Search.of(
        env_id,
        robot=robot,
        trajectory=trajectory,
        error_bounds=error_bounds,
        control_frequency=control_frequency,
    )
    report: Say = progress or (lambda _: None)
    if not cache:
        return search.solve(report)
    result: BestKnownPayload = load_or_compute(
        search.file, _read, lambda: search.solve(report), _bytes
    )
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
    return read_cached(cache_folder() / _Search.of(env_id, **options).file, _read)


@dataclass(frozen=True)
class _Search(Problem):
    """A problem whose motion is verified by replays."""

    @property
    def steps(self) -> int:
        return round(self.trajectory.duration * self.control_frequency)

    @property
    def substeps(self) -> int:
        """Number of physics steps in a control period of the environment."""
        return make_settings(count=1, **self.conditions).substeps

    @property
    def file(self) -> str:
        """Name of the cache file."""
        return f"best-{self.fingerprint(__name__)}.npz"

    @property
    def tightening(self) -> Tightening:
        """Rule for the margins of the replayed motions."""
        times = np.arange(self.steps) / self.control_frequency
        return Tightening(robot=self.robot, error_bounds=self.error_bounds, times=times)

    def solve(self, report: Say) -> BestKnownPayload:
        """Solves and refines the program, and verifies the motion."""
        meshes = self._refined(report)
        finest = meshes[-1]
        best = finest.motion
        found = self._verify(finest.program, best, report)
        if found is None or found.motion.payload < (1 - _MOST_LOST) * best.payload:
            finer = self._verify(self.program(2 * finest.intervals), best, report)
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
            meshes=tuple((mesh.intervals, mesh.motion.payload) for mesh in meshes),
            environment={
                "robot": robot.to_dict(),
                "trajectory": to_jsonable(self.trajectory),
                "control_frequency": self.control_frequency,
            },
            versions=versions() | {"casadi": version("casadi")},
            motion=motion,
            actions=found.actions,
        )

    def _refined(self, report: Say) -> list[Mesh]:
        """Meshes, until finer ones would hardly change the payload."""
        meshes: list[Mesh] = []
        for mesh in self.meshes(report):
            meshes.append(mesh)
            unit = max(mesh.motion.payload, _SMALL * self.robot.mass)
            payloads = [one.motion.payload / unit for one in meshes]
            if len(payloads) > 1 and has_converged(payloads):
                break
        return meshes

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
                    motion = _with_margins(program, margins, start)
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


def _with_margins(program: MotionProgram, margins: Margins, start: PlannedMotion) -> PlannedMotion:
    """The motion of a program with margins, from its last solution if there is one.

    Raises:
        Infeasible: if the solver finds no motion within the constraints.
    """
    try:
        return program.resolve(margins)
    except Infeasible:
        return solve(program, start)


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
