"""A batch of episodes: plant, references, seeded draws, and what each step returns. Two env classes are its faces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import outcome
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.references import ReferenceTables
from cablebot_gym.envs.settings import Settings, check_options
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.task import Limits, Task
from cablebot_gym.trajectories import Trajectory

_PAYLOAD_STREAM, _START_STREAM = 0, 1
"""Purposes of random streams. A new purpose takes a new number, so that no other stream changes."""


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
        self._workspace = np.array(robot.pose_bounds)
        self._stall = np.array(robot.stall_torque)
        self._lane_settings = np.zeros((count, outcome.LANE_SETTINGS))
        self._slack_for = np.zeros(count)
        self._everyone = np.arange(count)
        self._seeds = np.zeros(count, object)
        self._episodes = np.zeros(count, np.int64)
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
    def pose(self) -> Array:
        """True X, shape (N, n)."""
        return self._plant.pose

    @property
    def velocity(self) -> Array:
        """True Ẋ, shape (N, n)."""
        return self._plant.velocity

    def seed(self, lanes: Sequence[int], seeds: Sequence[int]) -> None:
        """Restarts the random streams of ``lanes``."""
        for lane, seed in zip(lanes, seeds, strict=True):
            self._seeds[lane] = seed
            self._episodes[lane] = 0

    def streams(self) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
        """Where the random streams stand, for :meth:`restore_streams`."""
        return self._seeds.copy(), self._episodes.copy()

    def restore_streams(self, streams: tuple[NDArray[np.object_], NDArray[np.int64]]) -> None:
        """Puts the random streams back to where they stood."""
        self._seeds, self._episodes = streams

    def reset(self, lanes: NDArray[np.int64], options: Mapping[str, Any] | None = None) -> None:
        """Starts new episodes in ``lanes``; ``options`` hold for these episodes only.

        Raises:
            ValueError: if an option is unknown or not valid; nothing has changed then.
        """
        settings, robot, size = self.settings, self.settings.robot, len(lanes)
        given = check_options(options, robot, self.count)
        trajectory, limits = given.get("trajectory", settings.trajectory), given.get("limits", settings.limits)
        payload = self._of(lanes, given.get("payload", settings.payload))
        if settings.payload_range is not None and "payload" not in given:
            low, high = settings.payload_range
            payload = np.array([low + (high - low) * self._draw(lane, _PAYLOAD_STREAM, 1)[0] for lane in lanes])
        known = self._of(lanes, given.get("payload_known", settings.payload_known))
        error = np.broadcast_to(given.get("initial_error", settings.initial_error), (self.count, robot.coordinates))
        self._tables.prepare(trajectory)
        start = trajectory(0.0)
        pose = start.position + error[lanes]
        if settings.initial_error_range is not None and "initial_error" not in given:
            uniform = np.array([self._draw(lane, _START_STREAM, robot.coordinates) for lane in lanes])
            pose = pose + settings.initial_error_range * (2 * uniform - 1)
        self._episodes[lanes] += 1

        columns = [payload, payload * known, known, np.full(size, limits.position), np.full(size, limits.rotation)]
        self._lane_settings[lanes] = np.stack(columns, axis=1)
        for lane in lanes:
            self._trajectories[lane], self._limits[lane] = trajectory, limits
        parameters = np.tile(self._parameters, (size, 1))
        parameters[:, kernel.MASS] += payload
        self._plant.set_parameters(lanes, parameters)
        velocity = np.broadcast_to(start.velocity, pose.shape)
        self._plant.set_state(lanes, pose, velocity)
        if robot.flexible:
            angle = textbook.static_motor_angle(robot, robot.mass + payload, pose, minimum=textbook.MINIMUM_TENSION)
            self._plant.set_motors(lanes, angle, textbook.pulley_speed(robot, pose, velocity))
        self._tables.follow(lanes, trajectory, self._plant.which)
        self._observe(lanes, fresh=True)

    def _of(self, lanes: NDArray[np.int64], value: Any) -> Any:
        """The lanes' part of a value that is one for all or one per lane."""
        return np.broadcast_to(value, (self.count,))[lanes]

    def _draw(self, lane: int, purpose: int, size: int) -> Array:
        """Uniform numbers in [0, 1) that depend on seed, purpose and number of the episode alone."""
        return np.random.default_rng([self._seeds[lane], purpose, self._episodes[lane]]).random(size)

    def step(self, action: Array) -> None:
        """One control period under drive commands (N, m), which have to be finite."""
        plant, tables, settings = self._plant, self._tables, self.settings
        plant.set_demand(action)
        plant.advance(tables.physics, tables.physics_ends, substeps=settings.substeps, step=settings.physics_step)
        self._observe(self._everyone, fresh=False)

    def _observe(self, lanes: NDArray[np.int64], *, fresh: bool) -> None:
        plant, tables, settings = self._plant, self._tables, self.settings
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
            self.observation,
            self.reward,
            self.reason,
            self.info,
        )
