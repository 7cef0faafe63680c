"""A batch of episodes: plant, references, seeded draws, and what each step returns. Two env classes are its faces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import outcome
from cablebot_gym.envs.disturbances import Disturbances
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.references import ReferenceTables
from cablebot_gym.envs.settings import Settings, check_options, check_stability
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.robots import RobotArrays
from cablebot_gym.task import Limits, Task
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.uncertainty import PARAMETERS, Uncertainty, draw_size


@dataclass(frozen=True, kw_only=True, eq=False)
class _Start:
    """Where the episodes of some lanes begin, k of them."""

    lanes: NDArray[np.int64]
    uncertainty: Uncertainty
    robot: RobotArrays
    """Of all k, or of each."""
    payload: Array
    """True, (k,)."""
    parameters: Array
    """The kernel's, (k, rows)."""
    pose: Array
    velocity: Array
    angle: Array
    """Of the motors behind springs, (k, m); zeros if rigid."""
    torque: Array
    """That holds the robot at rest, (k, m); zeros if nobody asks."""
    speed: Array
    """Of the pulleys, (k, m); zeros if nobody asks."""


class Simulation:
    """N lanes, each with an episode of its own. The single environment is a batch of one.

    After :meth:`reset` and :meth:`step`, ``observation`` (N, size), ``reward`` (N,), ``reason`` (N,), codes of
    :data:`outcome.TERMINATION_REASONS`, and ``info`` (N, columns) hold the result; they are overwritten by the next
    call.
    """

    def __init__(self, settings: Settings, count: int) -> None:
        self.settings, self.count = settings, count
        robot = settings.robot
        self.layout = observation_layout(robot)
        self._plant = Plant(robot, count, cable=settings.cable)
        self._parameters = pack_parameters(robot)
        self._tables = ReferenceTables(settings.control_frequency, settings.substeps, to_snap=robot.flexible)
        space = self.layout.space()
        self._bounds = np.array([space.low, space.high])
        self._workspace = np.array(robot.pose_bounds, order="C")  # each order of an array is compiled for anew
        self._stall = np.tile(robot.stall_torque, (count, 1))
        self._lane_settings = np.zeros((count, outcome.LANE_SETTINGS))
        self._slack_for = np.zeros(count)
        self._everyone = np.arange(count)
        self.streams = Streams(count)
        """Where all random numbers come from."""
        self._disturbances = Disturbances(robot, count, settings.control_frequency, self.streams)
        self._draw_size = draw_size(robot)
        self.truth: dict[str, Array] = {}
        """True parameters of the present episodes by name, each (N, …)."""
        self._trajectories: list[Trajectory] = [settings.trajectory] * count
        self._limits: list[Limits] = [settings.limits] * count
        self.observation = np.zeros((count, self.layout.size))
        self.reward = np.zeros(count)
        self.reason = np.zeros(count, np.int64)
        self.info = np.zeros((count, outcome.info_columns(robot.cables)))

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The public task of each lane's episode."""
        settings, told = self.settings, self._lane_settings
        return tuple(
            Task(
                robot=settings.robot,
                trajectory=self._trajectories[lane],
                limits=self._limits[lane],
                control_frequency=settings.control_frequency,
                cable=settings.cable,
                told_payload=float(told[lane, outcome.TOLD]),
                payload_known=bool(told[lane, outcome.KNOWN]),
            )
            for lane in range(self.count)
        )

    @property
    def stall_torque(self) -> Array:
        """True τ_s, shape (N, m)."""
        return self._stall

    @property
    def pose(self) -> Array:
        """True X, shape (N, n)."""
        return self._plant.pose

    @property
    def velocity(self) -> Array:
        """True Ẋ, shape (N, n)."""
        return self._plant.velocity

    def reset(self, lanes: NDArray[np.int64], options: Mapping[str, Any] | None = None) -> None:
        """Starts new episodes in ``lanes``; ``options`` hold for these episodes only.

        Raises:
            ValueError: if an option is unknown or not valid; nothing has changed then.
        """
        settings, robot = self.settings, self.settings.robot
        given = check_options(options, robot, self.count)
        trajectory, limits = given.get("trajectory", settings.trajectory), given.get("limits", settings.limits)
        uncertainties = given.get("uncertainty", settings.uncertainty)
        if "uncertainty" in given:
            check_stability(robot, uncertainties, settings.control_frequency, settings.substeps)
        self._tables.prepare(trajectory)

        self.streams.begin(lanes)
        payload = self._of(lanes, given.get("payload", settings.payload))
        if settings.payload_range is not None and "payload" not in given:
            low, high = settings.payload_range
            payload = low + (high - low) * self.streams.uniform(lanes, Purpose.PAYLOAD, 1)[:, 0]
        known = self._of(lanes, given.get("payload_known", settings.payload_known))
        error = np.broadcast_to(given.get("initial_error", settings.initial_error), (self.count, robot.coordinates))
        start = trajectory(0.0)
        pose = start.position + error[lanes]
        if settings.initial_error_range is not None and "initial_error" not in given:
            uniform = self.streams.uniform(lanes, Purpose.START, robot.coordinates)
            pose = pose + settings.initial_error_range * (2 * uniform - 1)
        velocity = np.broadcast_to(start.velocity, pose.shape)
        starts = [
            self._drawn(lanes[some], uncertainty, payload[some], pose[some], velocity[some])
            for uncertainty, some in self._by_uncertainty(lanes, uncertainties)
        ]

        bounds = np.array([limits.position, limits.rotation])
        self._lane_settings[lanes, outcome.TOLD] = payload * known
        self._lane_settings[lanes, outcome.KNOWN] = known
        self._lane_settings[lanes, outcome.POSITION_BOUND : outcome.ROTATION_BOUND + 1] = bounds
        for lane in lanes:
            self._trajectories[lane], self._limits[lane] = trajectory, limits
        for one in starts:
            self._start(one)
        self._tables.follow(lanes, trajectory, self._plant.which)
        self._observe(lanes, fresh=True)

    def _of(self, lanes: NDArray[np.int64], value: Any) -> Any:
        """The lanes' part of a value that is one for all or one per lane."""
        return np.broadcast_to(value, (self.count,))[lanes]

    def _by_uncertainty(
        self, lanes: NDArray[np.int64], uncertainties: tuple[Uncertainty, ...]
    ) -> Iterator[tuple[Uncertainty, NDArray[np.int64]]]:
        """Each uncertainty and the places in ``lanes`` that it holds for."""
        if len(uncertainties) == 1:
            yield uncertainties[0], np.arange(len(lanes))
            return
        for uncertainty in dict.fromkeys(uncertainties[lane] for lane in lanes):
            yield uncertainty, np.flatnonzero([uncertainties[lane] == uncertainty for lane in lanes])

    def _drawn(
        self, lanes: NDArray[np.int64], uncertainty: Uncertainty, payload: Array, pose: Array, velocity: Array
    ) -> _Start:
        """Draws the true robots; changes nothing yet.

        Raises:
            ValueError: if no tensions hold a robot where it has to be held.
        """
        robot: RobotArrays = self.settings.robot
        parameters = self._parameters
        if uncertainty.parameters:
            uniform = self.streams.uniform(lanes, Purpose.PARAMETERS, self._draw_size)
            robot = true = uncertainty.draw(self.settings.robot, payload, uniform)
            parameters, payload = pack_parameters(true), true.payload
        rows = np.array(np.broadcast_to(parameters, (len(lanes), parameters.shape[-1])))
        rows[:, kernel.MASS] += payload
        angle = torque = speed = np.zeros((len(lanes), robot.cables))
        loaded, minimum = robot.mass + payload, textbook.MINIMUM_TENSION
        try:
            if robot.flexible:
                angle = textbook.static_motor_angle(robot, loaded, pose, minimum=minimum)
            if uncertainty.delay:
                torque = textbook.static_torque(robot, loaded, pose, minimum=minimum)
        except np.linalg.LinAlgError as error:
            raise ValueError("no tensions hold the robot at its start pose: choose another start") from error
        if robot.flexible or uncertainty.delay:
            speed = textbook.pulley_speed(robot, pose, velocity)
        return _Start(
            lanes=lanes,
            uncertainty=uncertainty,
            robot=robot,
            payload=payload,
            parameters=rows,
            pose=pose,
            velocity=velocity,
            angle=angle,
            torque=torque,
            speed=speed,
        )

    def _start(self, start: _Start) -> None:
        """Puts the true robots where their episodes begin."""
        lanes, robot = start.lanes, start.robot
        self._stall[lanes] = robot.stall_torque
        self._lane_settings[lanes, outcome.PAYLOAD] = start.payload
        self._remember(lanes, robot, start.payload)
        self._plant.set_parameters(lanes, start.parameters)
        self._plant.set_state(lanes, start.pose, start.velocity)
        if robot.flexible:
            self._plant.set_motors(lanes, start.angle, start.speed)
        holding = textbook.drive_command(robot, start.torque, start.speed)
        self._disturbances.begin(lanes, start.uncertainty, holding)

    def _remember(self, lanes: NDArray[np.int64], robot: RobotArrays, payload: Array) -> None:
        for name, parameter in PARAMETERS.items():
            if (parameter.flexible and not robot.flexible) or (parameter.spatial and robot.planar):
                continue
            nominal = getattr(self.settings.robot, parameter.attribute) if name != "payload" else 0.0
            if name not in self.truth:
                self.truth[name] = np.zeros((self.count, *np.shape(nominal)))
            self.truth[name][lanes] = payload if name == "payload" else getattr(robot, parameter.attribute)

    def step(self, action: Array) -> None:
        """One control period under drive commands (N, m), which have to be finite."""
        plant, tables, settings = self._plant, self._tables, self.settings
        if not self._disturbances.quiet:
            action = self._disturbances.late(action)
            self._disturbances.push(plant)
        plant.set_demand(action)
        plant.advance(tables.physics, tables.physics_ends, substeps=settings.substeps, step=settings.physics_step)
        self._observe(self._everyone, fresh=False)

    def _observe(self, lanes: NDArray[np.int64], *, fresh: bool) -> None:
        plant, tables, settings = self._plant, self._tables, self.settings
        if not self._disturbances.quiet:
            self._disturbances.measure(lanes, plant.step_index[lanes])
        outcome.outcome(
            fresh,
            settings.robot.flexible,
            lanes,
            plant.lanes,
            kernel.RECORD_ROWS,
            plant.record,
            tables.control,
            tables.control_ends,
            plant.which,
            plant.step_index,
            self._lane_settings,
            self._stall,
            self._workspace,
            self._bounds,
            settings.weights,
            settings.period,
            settings.termination_radius,
            settings.slack_time,
            self._slack_for,
            self._disturbances.noise,
            self.observation,
            self.reward,
            self.reason,
            self.info,
        )
