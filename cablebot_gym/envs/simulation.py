"""Batch of episodes, which both environment classes wrap: plant, references, random draws and step results."""

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
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.uncertainty import PARAMETERS, Uncertainty, draw_size


@dataclass(frozen=True, kw_only=True, eq=False)
class _Start:
    """Initial conditions of k episodes that have the same uncertainty."""

    env_indices: NDArray[np.int64]
    """Environments, (k,)."""
    uncertainty: Uncertainty
    """Uncertainty of the episodes."""
    robot: RobotArrays
    """True robot: one for all k, or a batch of k."""
    payload: Array
    """True payload [kg], (k,)."""
    parameters: Array
    """Kernel parameters, (k, rows)."""
    pose: Array
    """Start pose X, (k, n)."""
    velocity: Array
    """Start velocity Ẋ, (k, n)."""
    angle: Array
    """Motor angles β′ of flexible robots [rad], (k, m); zeros for rigid robots."""
    torque: Array
    """Motor torques that hold the robot at rest [N·m], (k, m); zeros without actuation delay."""
    speed: Array
    """Pulley speeds [rad/s], (k, m); zeros for rigid robots without actuation delay."""


class Simulation:
    """N environments, each with its own episode. The single environment is a batch of one.

    :meth:`reset` and :meth:`step` write their results to ``observation`` (N, size), ``reward`` (N,), ``reason`` (N,),
    an index of :data:`outcome.TERMINATION_REASONS`, and ``info`` (N, columns). The next call overwrites them.
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
        self._workspace = np.array(robot.pose_bounds, order="C")  # numba compiles once per memory order
        self._stall = np.tile(robot.stall_torque, (count, 1))
        self._episode_settings = np.zeros((count, outcome.EPISODE_SETTINGS))
        self._slack_for = np.zeros(count)
        self._all_indices = np.arange(count)
        self.streams = Streams(count)
        """Random streams of all draws."""
        self._disturbances = Disturbances(robot, count, settings.control_frequency, self.streams)
        self._draw_size = draw_size(robot)
        self.truth: dict[str, Array] = {}
        """True parameters of the present episodes by name, each (N, …)."""
        self._trajectories: list[Trajectory] = [settings.trajectory] * count
        self._error_bounds: list[ErrorBounds] = [settings.error_bounds] * count
        self.observation = np.zeros((count, self.layout.size))
        self.reward = np.zeros(count)
        self.reason = np.zeros(count, np.int64)
        self.info = np.zeros((count, outcome.info_columns(robot.cables)))

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Task of each environment's episode: the public knowledge of a policy."""
        settings, rows = self.settings, self._episode_settings
        return tuple(
            Task(
                robot=settings.robot,
                trajectory=self._trajectories[env_index],
                error_bounds=self._error_bounds[env_index],
                control_frequency=settings.control_frequency,
                cable=settings.cable,
                model_payload=float(rows[env_index, outcome.MODEL_PAYLOAD]),
                payload_known=bool(rows[env_index, outcome.KNOWN]),
            )
            for env_index in range(self.count)
        )

    @property
    def stall_torque(self) -> Array:
        """True stall torques τ_s [N·m], shape (N, m)."""
        return self._stall

    @property
    def pose(self) -> Array:
        """True poses X, shape (N, n)."""
        return self._plant.pose

    @property
    def velocity(self) -> Array:
        """True velocities Ẋ, shape (N, n)."""
        return self._plant.velocity

    def reset(self, env_indices: NDArray[np.int64], options: Mapping[str, Any] | None = None) -> None:
        """Starts new episodes in the environments ``env_indices``; ``options`` apply to these episodes only.

        Raises:
            ValueError: if an option is unknown or invalid. The environments are unchanged then, apart from the episode
                numbers of the streams.
        """
        settings, robot = self.settings, self.settings.robot
        given = check_options(options, robot, self.count)
        trajectory = given.get("trajectory", settings.trajectory)
        error_bounds = given.get("error_bounds", settings.error_bounds)
        uncertainties = given.get("uncertainty", settings.uncertainty)
        if "uncertainty" in given:
            check_stability(robot, uncertainties, settings.control_frequency, settings.substeps)
        self._tables.prepare(trajectory)

        self.streams.start_episode(env_indices)
        payload = self._values_of(env_indices, given.get("payload", settings.payload))
        if settings.payload_range is not None and "payload" not in given:
            low, high = settings.payload_range
            payload = low + (high - low) * self.streams.uniform(env_indices, Purpose.PAYLOAD, 1)[:, 0]
        known = self._values_of(env_indices, given.get("payload_known", settings.payload_known))
        factor = self._values_of(env_indices, given.get("model_payload_factor", settings.model_payload_factor))
        error = np.broadcast_to(given.get("initial_error", settings.initial_error), (self.count, robot.coordinates))
        start = trajectory(0.0)
        pose = start.position + error[env_indices]
        if settings.initial_error_range is not None and "initial_error" not in given:
            uniform = self.streams.uniform(env_indices, Purpose.START, robot.coordinates)
            pose = pose + settings.initial_error_range * (2 * uniform - 1)
        velocity = np.broadcast_to(start.velocity, pose.shape)
        starts = [
            self._draw_start(env_indices[rows], uncertainty, payload[rows], pose[rows], velocity[rows])
            for uncertainty, rows in self._by_uncertainty(env_indices, uncertainties)
        ]

        bounds = np.array([error_bounds.position, error_bounds.rotation])
        self._episode_settings[env_indices, outcome.MODEL_PAYLOAD] = payload * known * factor
        self._episode_settings[env_indices, outcome.KNOWN] = known
        self._episode_settings[env_indices, outcome.POSITION_BOUND : outcome.ROTATION_BOUND + 1] = bounds
        for env_index in env_indices:
            self._trajectories[env_index], self._error_bounds[env_index] = trajectory, error_bounds
        for start_state in starts:
            self._apply_start(start_state)
        self._tables.follow(env_indices, trajectory, self._plant.trajectory_index)
        self._observe(env_indices, fresh=True)

    def _values_of(self, env_indices: NDArray[np.int64], value: Any) -> Any:
        """Values for ``env_indices`` of a value that is given once for all environments or once per environment."""
        return np.broadcast_to(value, (self.count,))[env_indices]

    def _by_uncertainty(
        self, env_indices: NDArray[np.int64], uncertainties: tuple[Uncertainty, ...]
    ) -> Iterator[tuple[Uncertainty, NDArray[np.int64]]]:
        """Each uncertainty and the positions in ``env_indices`` to which it applies."""
        if len(uncertainties) == 1:
            yield uncertainties[0], np.arange(len(env_indices))
            return
        for uncertainty in dict.fromkeys(uncertainties[env_index] for env_index in env_indices):
            yield uncertainty, np.flatnonzero([uncertainties[env_index] == uncertainty for env_index in env_indices])

    def _draw_start(
        self, env_indices: NDArray[np.int64], uncertainty: Uncertainty, payload: Array, pose: Array, velocity: Array
    ) -> _Start:
        """Draws the true robots of k episodes, without a change of the plant.

        Raises:
            ValueError: if a robot has to be at rest at its start pose and no cable tensions hold it there.
        """
        robot: RobotArrays = self.settings.robot
        parameters = self._parameters
        if uncertainty.parameters:
            uniform = self.streams.uniform(env_indices, Purpose.PARAMETERS, self._draw_size)
            robot = true = uncertainty.draw(self.settings.robot, payload, uniform)
            parameters, payload = pack_parameters(true), true.payload
        rows = np.array(np.broadcast_to(parameters, (len(env_indices), parameters.shape[-1])))
        rows[:, kernel.MASS] += payload
        angle = torque = speed = np.zeros((len(env_indices), robot.cables))
        loaded, minimum = robot.mass + payload, textbook.MINIMUM_TENSION
        try:
            if robot.flexible:
                angle = textbook.static_motor_angle(robot, loaded, pose, minimum=minimum)
            if uncertainty.delay:
                torque = textbook.static_torque(robot, loaded, pose, minimum=minimum)
        except np.linalg.LinAlgError as error:
            raise ValueError(
                "no tensions hold the robot at rest at its start pose: choose another start pose"
            ) from error
        if robot.flexible or uncertainty.delay:
            speed = textbook.pulley_speed(robot, pose, velocity)
        return _Start(
            env_indices=env_indices,
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

    def _apply_start(self, start: _Start) -> None:
        """Writes the initial conditions to the plant."""
        env_indices, robot = start.env_indices, start.robot
        self._stall[env_indices] = robot.stall_torque
        self._episode_settings[env_indices, outcome.PAYLOAD] = start.payload
        self._store_truth(env_indices, robot, start.payload)
        self._plant.set_parameters(env_indices, start.parameters)
        self._plant.set_state(env_indices, start.pose, start.velocity)
        if robot.flexible:
            self._plant.set_motors(env_indices, start.angle, start.speed)
        holding = textbook.normalised_action(robot, start.torque, start.speed)
        self._disturbances.reset(env_indices, start.uncertainty, holding)

    def _store_truth(self, env_indices: NDArray[np.int64], robot: RobotArrays, payload: Array) -> None:
        """Stores the true parameters that the robot has in :attr:`truth`."""
        for name, parameter in PARAMETERS.items():
            if (parameter.flexible and not robot.flexible) or (parameter.spatial and robot.planar):
                continue
            nominal = getattr(self.settings.robot, parameter.attribute) if name != "payload" else 0.0
            if name not in self.truth:
                self.truth[name] = np.zeros((self.count, *np.shape(nominal)))
            self.truth[name][env_indices] = payload if name == "payload" else getattr(robot, parameter.attribute)

    def step(self, action: Array) -> None:
        """Advances all environments by one control period under the actions (N, m), which must be finite."""
        plant, tables, settings = self._plant, self._tables, self.settings
        if not self._disturbances.quiet:
            action = self._disturbances.delayed(action)
            self._disturbances.update_wrench(plant)
        plant.set_action(action)
        plant.advance(tables.physics, tables.physics_ends, substeps=settings.substeps, step=settings.physics_step)
        self._observe(self._all_indices, fresh=False)

    def _observe(self, env_indices: NDArray[np.int64], *, fresh: bool) -> None:
        plant, tables, settings = self._plant, self._tables, self.settings
        if not self._disturbances.quiet:
            self._disturbances.measure(env_indices, plant.step_index[env_indices])
        outcome.outcome(
            fresh,
            settings.robot.flexible,
            env_indices,
            plant.lanes,
            kernel.RECORD_ROWS,
            plant.record,
            tables.control,
            tables.control_ends,
            plant.trajectory_index,
            plant.step_index,
            self._episode_settings,
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
