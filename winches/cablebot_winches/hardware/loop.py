"""The control loop: reads the winches, calls the policy and commands torques, within limits."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.physics.compiling import compiled_at_once
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.policies import LoadedPolicy, PolicyError
from cablebot_gym.policies.spec import check_measurement
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import number
from cablebot_winches.hardware.limits import DriveLimits, DriveMoment, Guard, Stop
from cablebot_winches.hardware.odrive import Winches
from cablebot_winches.hardware.result import DriveResult
from cablebot_winches.identification.log import pose_columns

PATIENCE = 5.0
"""Longest time for replies before the start, and without real time [s]."""

INTERRUPTED = "interrupted"
"""Cause of a stop after Ctrl-C."""


class Clock(Protocol):
    """Time of a drive: the module :mod:`time`, or that of a test."""

    def monotonic(self) -> float:
        """Time [s]."""

    def sleep(self, seconds: float, /) -> None:
        """Waits."""


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Time of the control periods."""

    real_time: bool = True
    """Whether a control period lasts as long as it says. Otherwise the next one starts at once, for
    simulated winches that wait for their commands."""
    reply_time: float | None = None
    """Longest time for the replies to a question [s]. None shares half a period among the questions,
    or stands for :data:`PATIENCE` without real time."""
    clock: Clock = time
    """The clock."""


def drive(
    policy: LoadedPolicy,
    winches: Winches,
    *,
    limits: DriveLimits | None = None,
    armed: bool = False,
    pace: Pace | None = None,
    **keywords: Any,
) -> DriveResult:
    """Moves a robot with real winches along a reference motion.

    The observation, the meaning of an action and the reference are those of the environments with
    ``measurement="winches"``. The platform rests at the start pose of the task, held by the winches,
    whose angles are set to those of the robot's model there. At the end, and whenever a limit is
    violated, the policy fails or the drive is interrupted, all winches hold.

    Args:
        policy: a policy that reads the sensors of winches, such as ``ekf+fl``.
        winches: the winches.
        limits: limits, which stop the drive; None for those of the robot.
        armed: whether to command torques. Otherwise the winches are only read.
        pace: time of the control periods; None for real time.
        keywords: ``robot``, ``trajectory``, ``payload`` and other keywords of the environments.

    Returns:
        The result, also after a stop.

    Raises:
        ConnectionError: if a winch is not ready at the start.
        PolicyError: if the policy fails before the motors follow it.
        ValueError: if a keyword is invalid, the policy does not read winches, or the motion does not
            start at rest.
    """
    keywords = {"measurement": "winches"} | keywords
    episode = Simulation(keywords.pop("robot"), (), keywords)
    measurement = episode.settings.measurement
    if measurement.tensions or measurement.imu:
        raise ValueError("measurement: the boards of winches have encoders only; use 'winches'")
    check_measurement(policy, measurement)
    episode.reset(np.zeros(1, np.int64))
    task = episode.task(0)
    if not task.starts_at_rest:
        raise ValueError(f"motion {task.trajectory.name!r} must start at rest: add a dwell")
    loop = _Loop(policy, winches, episode, limits or DriveLimits(), pace or Pace(), armed=armed)
    with compiled_at_once():
        loop.prepare()
        stop = loop.run()
    return loop.result(stop)


class _Loop:
    """State of a drive."""

    def __init__(
        self,
        policy: LoadedPolicy,
        winches: Winches,
        episode: Simulation,
        limits: DriveLimits,
        pace: Pace,
        *,
        armed: bool,
    ) -> None:
        task = episode.task(0)
        robot = task.robot
        self._policy = policy
        self._winches = winches
        self._episode = episode
        self._limits = limits
        self._pace = pace
        self._armed = armed
        self._task = task
        self._period = 1 / task.control_frequency
        number("watchdog", limits.watchdog, above=2 * self._period, unit="s")
        self._questions = winches.questions + 1  # the last one is for errors
        self._reply_time = PATIENCE
        if pace.reply_time is not None:
            self._reply_time = number("reply_time", pace.reply_time, above=0, unit="s")
        elif pace.real_time:
            self._reply_time = self._period / 2 / self._questions
        self._guard = Guard(limits, task)
        self._commanded = False
        self._state: Any = None
        self._action: Array | None = None
        self._torque = episode.torques[0].copy()
        self._slices = episode.layout.slices()
        self._angle = episode.observation[0, self._slices["motor_angle"]].copy()
        self._speed = np.zeros(robot.cables)
        self._time = 0.0
        self._pose = task.start_pose
        self._lost = np.zeros(robot.cables, int)
        self._lost_in_a_row = np.zeros(robot.cables, int)
        self._late = 0
        self._late_in_a_row = 0
        self._computing_time = 0.0
        self._tracking_error = 0.0
        self._torque_fraction = 0.0
        self._rows: list[Array] = []

    def prepare(self) -> None:
        """Homes the winches, and computes a first and a second period: what is called for the first
        time may compile for seconds."""
        winches = self._winches
        winches.check_ready(self._now() + PATIENCE)
        winches.home(self._angle, self._now(), PATIENCE)
        self._episode.observe(self._readings())
        self._policy.reset(lambda: (self._task,))
        for _ in range(2):
            self._action, self._state = self._act(0.0)
        self._estimate_pose(np.zeros(len(winches)))
        self._policy.reset(lambda: (self._task,))
        self._action = self._state = None

    def run(self) -> Stop | None:
        """Drives until the motion is complete or a limit is violated; then the winches hold."""
        stop = None
        begin = self._now()
        due = begin
        moment = 0.0
        try:
            if self._armed:
                self._winches.start_watchdogs(self._limits.watchdog)
            for step in range(self._task.steps):
                moment = step * self._period
                if self._pace.real_time:
                    moment = self._now() - begin
                due += self._period
                stop = self._advance(step, moment) or self._wait(moment, due)
                if stop is not None:
                    break
                if self._pace.real_time:
                    due = max(due, self._now())
        except PolicyError as error:
            stop = Stop(cause=str(error), time=moment)
        except KeyboardInterrupt:
            stop = Stop(cause=INTERRUPTED, time=moment)
        except Exception as error:  # the log is worth more than a traceback
            stop = Stop(cause=f"the loop raised {type(error).__name__}: {error}", time=moment)
        finally:
            self._hold()
        return stop

    def _hold(self) -> None:
        """Stops all winches."""
        if not self._armed:
            return
        if not self._commanded:  # they hold already, with what their integrators have found
            self._winches.end_watchdogs()
            return
        try:
            self._winches.hold(self._torque)
        except KeyboardInterrupt:  # a second Ctrl-C, which must not leave out a winch
            self._winches.hold(self._torque)

    def _now(self) -> float:
        return self._pace.clock.monotonic()

    def _advance(self, step: int, moment: float) -> Stop | None:
        """One control period from the readings to the torques."""
        begin = self._now()
        angle, speed = self._winches.feedback(begin, self._reply_time)
        checked = step % len(self._winches)  # one winch in each period
        error = self._winches.error(checked, begin + self._questions * self._reply_time)
        replied = self._now()
        if error:
            return Stop(cause=f"axis error {error:#x}", time=moment, winch=checked + 1)
        if error is None:
            self._lost[checked] += 1
        elapsed = max(self._period, moment - self._time)
        self._time = moment
        last_speed = self._speed
        # An angle that jumps is no less dangerous than a speed.
        largest_speed = np.maximum(np.abs(speed), np.abs(angle - self._angle) / elapsed)
        self._take(angle, speed, elapsed)
        if np.max(self._lost_in_a_row) >= self._limits.lost_limit:
            silent = int(np.argmax(self._lost_in_a_row)) + 1
            return Stop(cause="lost messages", time=moment, winch=silent)
        self._episode.observe(self._readings(), self._action)
        action, self._state = self._act(moment)
        acceleration = (self._speed - last_speed) / elapsed
        pose = self._estimate_pose(acceleration)
        stop = self._command(moment, action, pose, np.nan_to_num(largest_speed), np.isnan(angle))
        self._computing_time = max(self._computing_time, self._now() - replied)
        return stop

    def _take(self, angle: Array, speed: Array, elapsed: float) -> None:
        """Stores readings. Those that are lost are extrapolated from the last ones."""
        lost = np.isnan(angle)
        self._lost += lost
        self._lost_in_a_row = np.where(lost, self._lost_in_a_row + 1, 0)
        self._angle = np.where(lost, self._angle + elapsed * self._speed, angle)
        self._speed = np.where(lost, self._speed, speed)

    def _readings(self) -> Array:
        """Readings in the order of the observation, (1, 2 m)."""
        return np.concatenate([self._angle, self._speed])[None]

    def _estimate_pose(self, acceleration: Array) -> Array:
        """Pose by the last readings and torques, (n,), with motor accelerations (m,) [rad/s²]."""
        robot = self._task.robot
        load = spring_load(robot, self._torque, self._speed, acceleration)
        return estimated_pose(robot, self._angle, load, self._pose)

    def _act(self, moment: float) -> tuple[Array, Any]:
        """Action of the policy, (m,), and its next state."""
        payload = np.array([self._task.model_payload])
        action, state = self._policy.act(
            self._episode.observation,
            self._state,
            np.array([self._action is None]),
            cables=len(self._winches),
            payloads=payload,
            time=moment,
        )
        return action[0], state

    def _command(
        self, moment: float, action: Array, pose: Array, speed: Array, lost: Array
    ) -> Stop | None:
        """Checks the limits, commands the torques of an action, and adds a row to the log."""
        robot = self._task.robot
        if np.isfinite(pose).all():
            self._pose = pose  # the next guess
        reference = self._episode.observation[0, self._slices["reference_pose"]]
        miss = (pose - reference)[: robot.dimensions]
        applied = np.clip(action, -1.0, 1.0)
        torque = robot.stall_torque * applied - robot.speed_slope * self._speed
        now = DriveMoment(
            time=moment,
            action=applied,
            torque=torque,
            speed=speed,
            pose=pose,
            tracking_error=float(np.linalg.norm(miss)),
        )
        self._tracking_error = max(self._tracking_error, now.tracking_error)
        self._torque_fraction = max(self._torque_fraction, float(np.max(np.abs(applied))))
        self._action = action
        stop = None
        sent = np.full(robot.cables, np.nan)
        if self._armed:  # otherwise the platform rests, and its motion says nothing
            stop = self._guard.check(now)
        if self._armed and stop is None:
            self._commanded = True
            self._winches.send(torque)
            self._torque = sent = torque
        measured = np.where(lost, np.nan, [self._angle, self._speed])
        self._rows.append(np.concatenate([[moment], measured.ravel(), sent, pose]))
        return stop

    def _wait(self, moment: float, due: float) -> Stop | None:
        """Waits for the end of the control period. A late end shifts all later periods: the motion
        becomes slower, and no period shorter."""
        if not self._pace.real_time:
            return None
        left = due - self._now()
        if left >= 0:
            self._late_in_a_row = 0
            self._pace.clock.sleep(left)
            return None
        self._late += 1
        self._late_in_a_row += 1
        if self._late_in_a_row < self._limits.late_limit:
            return None
        return Stop(cause="computer too slow", time=moment)

    def result(self, stop: Stop | None) -> DriveResult:
        """The result of the drive."""
        robot = self._task.robot
        names = ["time"]
        for quantity in ("angle", "speed", "torque"):
            names += [f"{quantity}_{winch + 1}" for winch in range(robot.cables)]
        names += pose_columns(robot)
        columns = np.reshape(self._rows, (-1, len(names))).T
        return DriveResult(
            robot=robot.name,
            policy=self._policy.name,
            motion=self._task.trajectory.name,
            armed=self._armed,
            periods=len(self._rows),
            stop=stop,
            tracking_error=self._tracking_error,
            torque_fraction=self._torque_fraction,
            lost=tuple(self._lost.tolist()),
            late=self._late,
            computing_time=self._computing_time,
            log=dict(zip(names, columns, strict=True)),
        )


def spring_load(robot: Robot, torque: Array, speed: Array, acceleration: Array) -> Array:
    """Torques that motors pass on to their joint springs or elastic cables, (m,) [N·m].

    Args:
        robot: nominal robot.
        torque: motor torques of the last control period, (m,) [N·m].
        speed: motor speeds, (m,) [rad/s].
        acceleration: their change over the last control period, (m,) [rad/s²].
    """
    if not robot.flexible:
        return torque
    inertia = robot.pulley_inertia
    damping = robot.damping
    if robot.jointed:
        inertia = robot.motor_inertia
        damping = robot.motor_damping
    friction = damping * speed + textbook.coulomb_torque(robot, speed)
    return torque - inertia * acceleration - friction


def estimated_pose(robot: Robot, angle: Array, load: Array, guess: Array) -> Array:
    """Pose by forward kinematics, (n,).

    Args:
        robot: nominal robot.
        angle: motor angles, (m,) [rad].
        load: torques of :func:`spring_load`, (m,) [N·m], by which springs and cables are deflected.
        guess: a pose nearby, (n,).
    """
    if robot.flexible:
        tensions = load / robot.pulley_radius
        angle = angle - textbook.rest_angles(robot, tensions, guess)
        angle = angle + textbook.pulley_angle(robot, guess)
    lengths = textbook.cable_lengths(robot, robot.home) - robot.pulley_radius * angle
    # Lengths of redundant cables never fit exactly, and then the last digits may not converge. A pose
    # that is wrong violates a limit.
    return forward_kinematics(robot, lengths, guess)
