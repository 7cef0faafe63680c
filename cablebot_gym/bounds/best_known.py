"""The best found: the largest payload for which some motion and inputs stay inside all limits (extra ``optimal``).

It is a lower bound of the supremum: a local solver found it, and a replay of its inputs through the environment's own
plant has shown that it is possible. Nothing shows that no more is, except where a certificate is given as well.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields
from importlib.metadata import version
from io import BytesIO
from typing import Any

import gymnasium as gym
import numpy as np

from cablebot_gym.bounds.certificate import planar_certificate
from cablebot_gym.envs import check_robot, env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.constraints import DLCCMonitor, Verdict
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import MINIMUM_TENSION
from cablebot_gym.planning import Follower, Infeasible, Margins, MotionProgram, PlannedMotion, State
from cablebot_gym.planning.library import fingerprint, kept, known
from cablebot_gym.planning.program import HEAVIEST
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import Limits, as_plain, check_workspace, find_limits
from cablebot_gym.trajectories import Trajectory, find_trajectory

REFINED = 0.005
"""Meshes are halved until the payload moves by less than this share of itself."""

COARSEST, LEAST = 25.0, 20
"""Intervals of the first mesh, per second and at least."""

_LITTLE = 0.1
"""Of a payload below this share of the platform's mass, meshes need not find out more."""

MOST = 16
"""No mesh is finer than so many times the first."""

_FIRST_SHARE = 5e-4
_FIRST_MARGINS = Margins(demand=1e-4, tension=0.05)
"""What the smallest margins leave of the bounds of the errors, and of the rest: the solver's and sampling's errors."""

_RUNGS = 10
"""Margins that may be tried, each twice the one before."""

_WORTH = 0.997
"""A replayed payload is near enough to the program's; if not, a mesh twice as fine is tried: springs swing between the
points at which forces balance."""

_GAINS = {"rigid": (2500.0, 100.0), "flexible": (100.0, 10.0)}
"""(K_P, K_D) with which inputs are made from a motion [1/s², 1/s]; the replay then has no feedback."""

_MOTOR_FREQUENCY = 200.0
"""The same of the motors of flexible robots [rad/s]."""

_FIRST_MESHES = 3
"""Meshes that may fail: in a narrow tube about a reference that jumps, coarse ones have no motion."""

_STRONGER, _WIDER = 1e3, 0.05
"""A limit is to blame if a motion is found once the motors are so many times as strong, or the bound is so wide [m,
rad]: one limit alone, or if that is not enough, all of them together."""

Progress = Callable[[str], None]
"""Told what is done next."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BestFound:
    """The largest payload found for which some motion and inputs stay inside all limits: a lower bound."""

    env_id: str
    """Environment."""
    payload: float
    """[kg]"""
    total_mass: float
    """Platform and payload [kg]."""
    verified: bool
    """Whether the inputs, held at the control rate, carried the payload in the environment's own plant, every physics
    step judged by the DLCC monitor under the task criterion."""
    limits: dict[str, float | None]
    """Bounds of position [m] and rotation [rad]; None for a robot that does not turn."""
    program_payload: float
    """What the program finds with nothing left for sampling and rounding, on the last mesh [kg]."""
    meshes: tuple[tuple[int, float], ...]
    """(intervals, payload [kg]) of every mesh."""
    margins: dict[str, float]
    """What the replayed motion leaves of the limits."""
    upper: dict[str, Any] | None
    """A payload that is proved to be out of reach, see :class:`~cablebot_gym.bounds.certificate.Certificate`; None where
    none is known."""
    environment: dict[str, Any]
    """Robot, trajectory and control frequency, as plain data."""
    versions: dict[str, str]
    """Of Python and of the packages that make the number."""
    motion: PlannedMotion = field(repr=False)
    """The motion."""
    commands: Array = field(repr=False)
    """Drive command of every control step, (steps, m)."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data; without the motion and its commands."""
        data = {item.name: getattr(self, item.name) for item in fields(self) if item.repr}
        return data | {"meshes": [list(mesh) for mesh in self.meshes]}

    def to_json(self) -> str:
        """The result as JSON, indented."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        bounds = f"{1e3 * (self.limits['position'] or 0):g} mm"
        if self.limits["rotation"] is not None:
            bounds += f", {1e3 * self.limits['rotation']:g} mrad"
        shown = "verified by replay" if self.verified else "not verified: no replay kept the limits"
        text = (
            f"{self.env_id}, {self.environment['trajectory']['name']}, {bounds}: best found {self.payload:.3f} kg "
            f"(total {self.total_mass:.3f} kg), {shown}; a lower bound of what is possible"
        )
        if self.upper is not None and self.upper["total_mass"] is not None:
            text += f"\nproved out of reach: more than {self.upper['payload']:.3f} kg"
            text += f" (total {self.upper['total_mass']:.3f} kg); {self.upper['conditions']}"
        return text


def best_found(
    env_id: str,
    *,
    robot: Robot | None = None,
    trajectory: Any = None,
    limits: Limits | dict[str, float] | None = None,
    control_frequency: float = 500.0,
    progress: Progress | None = None,
    cache: bool = True,
) -> BestFound:
    """The largest payload that a motion and inputs are found for, under the task criterion.

    Splines and collocation (:mod:`cablebot_gym.planning`), from several starts, on meshes that are halved until the
    payload moves by less than :data:`REFINED`. The last motion then leaves a little of each limit, as little as lets
    its inputs, made with feedback once and then replayed without, carry the payload in the environment itself.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        robot: of the environment's kind; None for its own.
        trajectory: name, name with fields, or object; None for the environment's own.
        limits: bounds of the errors; None for 10 mm and 10 mrad.
        control_frequency: drive commands per second [Hz].
        progress: told what is done next.
        cache: whether to keep the result on disk, and to take it from there.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is not valid, or no motion stays inside the limits: the message says which of them
            is to blame.
    """
    import_casadi()
    case = _case(env_id, robot, trajectory, limits, control_frequency)
    say: Progress = progress or (lambda _: None)
    if not cache:
        return case.solved(say)
    result: BestFound = kept(case.file, _read, lambda: case.solved(say), _bytes)
    return result


def known_best(
    env_id: str,
    *,
    robot: Robot | None = None,
    trajectory: Any = None,
    limits: Limits | dict[str, float] | None = None,
    control_frequency: float = 500.0,
) -> BestFound | None:
    """What :func:`best_found` keeps on disk of the same arguments; None if it has nothing.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is not valid.
    """
    import_casadi()
    found: BestFound | None = known(_case(env_id, robot, trajectory, limits, control_frequency).file, _read)
    return found


def _case(
    env_id: str,
    robot: Robot | None,
    trajectory: Any,
    limits: Limits | dict[str, float] | None,
    control_frequency: float,
) -> _Case:
    robot = find_robot(env_robot(env_id)) if robot is None else robot
    check_robot(env_id, robot)
    found = find_trajectory(default_trajectory(robot) if trajectory is None else trajectory, robot.coordinates)
    return _Case(env_id, robot, found, find_limits(limits), float(control_frequency))


@dataclass(frozen=True)
class _Case:
    env_id: str
    robot: Robot
    trajectory: Trajectory
    limits: Limits
    control_frequency: float

    @property
    def steps(self) -> int:
        return round(self.trajectory.duration * self.control_frequency)

    @property
    def file(self) -> str:
        """Of the cache."""
        data = {"env_id": self.env_id, "limits": self.limits, "control_frequency": self.control_frequency}
        return f"best-{fingerprint('cablebot_gym.bounds.best_known', self.robot, self.trajectory, **data)}.npz"

    def solved(self, say: Progress) -> BestFound:
        """Refines, verifies, and puts together what is known."""
        if not 0 < self.control_frequency < math.inf or self.steps < 1:
            raise ValueError(f"control_frequency must give at least one step, not {self.control_frequency} Hz")
        check_workspace(self.robot, self.trajectory)
        meshes = list(self._refined(say))
        intervals, program = meshes[-1]
        motion, commands, margins, verified = self._verified(intervals, program, say)
        if not verified or motion.payload < _WORTH * program.payload:
            finer = self._verified(2 * intervals, program, say)
            if finer[-1] and (not verified or finer[0].payload > motion.payload):
                motion, commands, margins, verified = finer
        robot, rotates = self.robot, not self.robot.planar
        upper = None
        if robot.planar and not robot.flexible:
            say("proving a bound from above")
            with suppress(ValueError):  # a tube that reaches an anchor has no certificate
                upper = planar_certificate(robot, self.trajectory, self.limits).to_dict()
        return BestFound(
            env_id=self.env_id,
            payload=motion.payload,
            total_mass=robot.mass + motion.payload,
            verified=verified,
            limits={"position": self.limits.position, "rotation": self.limits.rotation if rotates else None},
            program_payload=program.payload,
            meshes=tuple((count, mesh.payload) for count, mesh in meshes),
            margins=as_plain(margins),
            upper=upper,
            environment={
                "robot": robot.to_dict(),
                "trajectory": as_plain(self.trajectory),
                "control_frequency": self.control_frequency,
            },
            versions=versions() | {"casadi": version("casadi")},
            motion=motion,
            commands=commands,
        )

    # The program

    def _refined(self, say: Progress) -> Iterator[tuple[int, PlannedMotion]]:
        """Every mesh and its motion."""
        intervals, best = max(LEAST, math.ceil(COARSEST * self.trajectory.duration)), None
        for _ in range(_FIRST_MESHES):
            say(f"{intervals} intervals, several starts")
            best = self._first(intervals)
            if best is not None:
                break
            intervals *= 2
        if best is None or best.payload < 0 or best.payload > (1 - 1e-3) * HEAVIEST:
            raise ValueError(self._blame(intervals, best))
        yield intervals, best
        most = MOST * intervals
        while 2 * intervals <= most:
            intervals *= 2
            say(f"{intervals} intervals, {best.payload:.3f} kg so far")
            try:
                finer = self._solve(intervals, best)
            except Infeasible:  # what the coarser mesh found still stands, to be verified by its replay
                say(f"no motion on {intervals} intervals, going on with fewer")
                return
            yield intervals, finer
            moved, best = abs(finer.payload - best.payload), finer
            if moved < REFINED * max(best.payload, _LITTLE * self.robot.mass):
                return

    def _first(self, intervals: int) -> PlannedMotion | None:
        """The best of several starts: the reference, sagged, and wandering about it; None if none succeeds."""
        program = self._program(intervals)
        n, found = self.robot.coordinates, []
        sag = np.zeros(n)
        sag[min(2, n - 1)] = 0.7
        wave = np.random.default_rng(0).uniform(-0.5, 0.5, (4, n))
        phases = np.linspace(0.0, math.pi, program.control_points)[:, None]
        wandering = np.sum([part * np.sin((k + 1) * phases) for k, part in enumerate(wave)], axis=0) / len(wave)
        for shift in (np.zeros(n), sag, wandering):
            try:
                found.append(program.solve(shift=shift))
            except Infeasible:
                continue
        return max(found, key=lambda motion: motion.payload, default=None)

    def _program(self, intervals: int, margins: Margins | None = None) -> MotionProgram:
        period = 1 / self.control_frequency
        return MotionProgram(
            self.robot, self.trajectory, self.limits, intervals=intervals, margins=margins, period=period
        )

    def _solve(self, intervals: int, start: PlannedMotion, margins: Margins | None = None) -> PlannedMotion:
        program = self._program(intervals, margins)
        try:
            return program.solve(start)
        except Infeasible:  # a start so near to the limits can be in the solver's way
            return program.solve()

    def _blame(self, intervals: int, best: PlannedMotion | None) -> str:
        """Which limits keep every motion out: each that alone, much wider, would let one through."""
        name = self.trajectory.name
        if best is not None and best.payload > 0:
            return (
                f"nothing limits the payload on {name!r}: {HEAVIEST:g} kg are carried; choose a faster motion or a "
                f"position bound below {self.limits.position:g} m"
            )
        cause = self._cause(intervals)
        if best is not None:
            most = self.robot.mass + best.payload
            return (
                f"not even the empty platform of {self.robot.mass:g} kg can be moved along {name!r}, {most:.3g} kg at "
                f"most: to blame is {cause}; choose a lighter platform, a slower motion or wider limits"
            )
        why = f"to blame is {cause}; choose wider limits or a slower motion"
        return f"no motion along {name!r} was found inside the limits: {why}"

    def _cause(self, intervals: int) -> str:
        motors, limits = self.robot.motors, self.limits
        stronger = self.robot.replace(
            motors=motors.replace(
                stall_torque=tuple(_STRONGER * self.robot.stall_torque),
                free_speed=tuple(_STRONGER * self.robot.per_motor(motors.free_speed)),
            )
        )
        position, rotation = max(_WIDER, limits.position), max(_WIDER, limits.rotation)
        wider = {
            "the motors' torque-speed lines": (stronger, limits),
            f"the position bound of {limits.position:g} m": (self.robot, limits.replace(position=position)),
        }
        if not self.robot.planar:
            bound = f"the rotation bound of {limits.rotation:g} rad"
            wider[bound] = (self.robot, limits.replace(rotation=rotation))

        def possible(robot: Robot, bounds: Limits) -> bool:
            with suppress(Infeasible):
                return MotionProgram(robot, self.trajectory, bounds, intervals=intervals).solve().payload >= 0
            return False

        if alone := [limit for limit, relaxed in wider.items() if possible(*relaxed)]:
            return " or ".join(alone)
        if possible(stronger, Limits(position=position, rotation=rotation)):
            return " together with ".join(wider)
        return "the cables, which can only pull: the motion asks them to push"

    # The replay

    def _verified(
        self, intervals: int, program: PlannedMotion, say: Progress
    ) -> tuple[PlannedMotion, Array, Margins, bool]:
        """The heaviest motion whose inputs pass a replay, found by bisection over the margins."""
        low, high = 0, _RUNGS
        best: tuple[PlannedMotion, Array, Margins] | None = None
        rung = _RUNGS // 5
        while low < high:
            margins = self._margins(2.0**rung)
            say(f"replaying inputs that leave {margins.position * 1e3:.3g} mm")
            try:
                motion = self._solve(intervals, program, margins)
                commands = self._commands(motion)
                passed = self._replayed(commands, motion.payload).carried
            except Infeasible:
                high = rung  # more room leaves even less
                rung = (low + high) // 2
                continue
            if passed:
                best, high = (motion, commands, margins), rung
            else:
                low = rung + 1
            rung = (low + high) // 2
        if best is None:
            return program, self._commands(program), Margins(), False
        return *best, True

    def _margins(self, factor: float) -> Margins:
        share = factor * _FIRST_SHARE
        rest = _FIRST_MARGINS.scaled(factor)
        return Margins(
            position=share * self.limits.position,
            rotation=share * self.limits.rotation,
            demand=rest.demand,
            tension=min(rest.tension, MINIMUM_TENSION),  # more would only cost payload
        )

    def _environment(self, payload: float) -> DLCCMonitor:
        env = gym.make(
            self.env_id,
            robot=self.robot,
            trajectory=self.trajectory,
            limits=self.limits,
            termination_radius=self.limits.termination_radius,
            payload=payload,
            control_frequency=self.control_frequency,
            max_episode_steps=self.steps,
        )
        return DLCCMonitor(env)

    def _commands(self, motion: PlannedMotion) -> Array:
        """Drive commands that follow a motion, (steps, m)."""
        follower = Follower(robot=self.robot, gains=_GAINS[self.robot.joints], motor_frequency=_MOTOR_FREQUENCY)
        env, period = self._environment(motion.payload), 1 / self.control_frequency
        observation, _ = env.reset(seed=0)
        layout, commands = env.get_wrapper_attr("layout"), []
        for step in range(self.steps):
            state = State.of(layout.split(observation), np.asarray(step * period))
            command = follower.command(motion, state, np.asarray(motion.payload), period)
            commands.append(np.clip(command, -1.0, 1.0))
            observation, _, terminated, _, _ = env.step(commands[-1])
            if terminated:
                commands += [commands[-1]] * (self.steps - len(commands))
                break
        env.close()
        return np.array(commands)

    def _replayed(self, commands: Array, payload: float) -> Verdict:
        return replay(self._environment(payload), commands)


def replay(env: DLCCMonitor, commands: Array) -> Verdict:
    """How an episode of an environment goes under given drive commands (steps, m), without any feedback."""
    env.reset(seed=0)
    for command in commands:
        _, _, terminated, _, _ = env.step(command)
        if terminated:
            break
    env.close()
    return env.verdict


def _bytes(found: BestFound) -> bytes:
    buffer = BytesIO()
    arrays = {"result": np.array(found.to_json()), "commands": found.commands, **found.motion.to_arrays()}
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read(data: bytes) -> BestFound:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        result = json.loads(str(file["result"]))
        result["meshes"] = tuple((count, payload) for count, payload in result["meshes"])
        return BestFound(**result, motion=PlannedMotion.from_arrays(file), commands=file["commands"])
