"""Batch of episodes, which both environment classes wrap: plant, references, random draws and step
results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs import limits, outcome
from cablebot_gym.envs.disturbances import Disturbances
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.references import ReferenceTables
from cablebot_gym.envs.sensors import Sensors
from cablebot_gym.envs.settings import Settings, check_options, make_settings
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.physics.rest import equilibrium_torques, motor_start
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.task import Task, at_rest, start_pose
from cablebot_gym.uncertainty import PARAMETERS, RobotArrays, Uncertainty, draw_size


class Simulation:
    """N environments, each with its own episode. The single environment is a batch of one.

    :meth:`reset` and :meth:`step` write their results to ``observation`` (N, size), ``reward``
    (N,), ``reason`` (N,), an index of :data:`~cablebot_gym.envs.TERMINATION_REASONS`, ``complete``
    (N,), whether the motion is complete, ``info`` (N, columns), the scalars of info, and ``cables``
    (quantities, N, m). The next call overwrites them.

    Args:
        robot: robot, as the environments take it.
        batch: leading axes of the actions: (N,), or () for the single environment.
        keywords: further keywords of the environments.

    Raises:
        TypeError: if a keyword is unknown.
        ValueError: if a value is invalid.
    """

    def __init__(self, robot: Any, batch: tuple[int, ...], keywords: Mapping[str, Any]) -> None:
        self.count = count = math.prod(batch)
        self.settings = settings = make_settings(robot=robot, count=count, **keywords)
        """Checked constructor keywords."""
        robot = settings.robot
        self._action_shape = (*batch, robot.cables)
        self.layout = observation_layout(robot, settings.measurement)
        self._plant = Plant(robot, count, cable=settings.cable)
        self._parameters = pack_parameters(robot)
        self._tables = ReferenceTables(
            settings.control_frequency, settings.substeps, to_snap=robot.flexible
        )
        self.stall_torque = np.tile(robot.stall_torque, (count, 1))
        """True stall torques τ_s [N·m], (N, m)."""
        self._setting_columns = np.zeros((count, outcome.SETTING_COLUMNS))
        self._sent = np.zeros((count, robot.cables))
        self._slack_for = np.zeros(count)
        self._violated = np.zeros(count, np.bool_)
        self._all_indices = np.arange(count)
        self.streams = Streams(count)
        """Random streams of all draws."""
        self._disturbances = Disturbances(
            robot, settings.measurement, count, settings.control_frequency, self.streams
        )
        self._sensors = Sensors(robot, settings.measurement, count, settings.period)
        self.motion_steps = np.ones(count, np.int64)
        """Number of control steps of each environment's motion, (N,)."""
        self.truth: dict[str, Array] = {}
        """True parameters of the present episodes by name, each (N, …)."""
        self._settings_of_episodes = [settings] * count
        self.observation = np.zeros((count, self.layout.size))
        self.reward = np.zeros(count)
        self.reason = np.zeros(count, np.int64)
        self.complete = np.zeros(count, np.bool_)
        self.info = np.zeros((count, len(outcome.INFO_SCALARS)))
        # One environment more, whose values nobody reads. Otherwise, with 512 environments, all
        # quantities of a cable would share a set of the first-level cache.
        self.cables = np.zeros((len(outcome.INFO_CABLES), count + 1, robot.cables))
        self._constants = self._make_constants()
        self._bind()

    def _make_constants(self) -> outcome.Constants:
        """Constants of the compiled outcome. Their arrays are writable and C-ordered, as after a copy
        or a pickle of the environment: numba would compile again for read-only arrays."""
        settings = self.settings
        robot = settings.robot
        space = self.layout.space()
        return outcome.Constants(
            flexible=robot.flexible,
            dimensions=robot.dimensions,
            lanes=self._plant.lanes,
            workspace=np.array(robot.pose_bounds, order="C"),
            bounds=np.array([space.low, space.high]),
            encoder_resolution=settings.measurement.encoder_resolution,
            normalised=settings.normalised_observation,
            centre=self.layout.centre.copy(),
            per_scale=self.layout.per_scale.copy(),
            weights=settings.reward_weights,
            period=settings.period,
            minimum_tension=limits.minimum_tension(robot, settings.cable),
            maximum_tension=robot.maximum_tension,
            termination_radius=settings.error_bounds.termination_radius,
            terminate_on_violation=settings.terminate_on_violation,
        )

    def __getstate__(self) -> dict[str, Any]:
        """The attributes without those of :meth:`_bind`."""
        bound = ("_outcome_arguments", "_advance", "_outcome")
        return {name: value for name, value in self.__dict__.items() if name not in bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restores a copy or pickle, whose arrays the compiled code then reads."""
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        """Makes the compiled code read the present arrays."""
        plant = self._plant
        tables = self._tables
        episodes = outcome.Episodes(
            record=plant.record,
            step=plant.step_index,
            motion_steps=self.motion_steps,
            trajectory_index=plant.trajectory_index,
            references=tables.control,
            last_rows=tables.control_ends,
            settings=self._setting_columns,
            stall=self.stall_torque,
            readings=self._sensors.readings,
            noise=self._disturbances.noise,
            sent=self._sent,
            slack_for=self._slack_for,
            violated=self._violated,
        )
        outputs = outcome.Outputs(
            observation=self.observation,
            reward=self.reward,
            reason=self.reason,
            complete=self.complete,
            info=self.info,
            cables=self.cables,
        )
        self._advance = plant.advance_call(
            tables.physics,
            tables.physics_ends,
            substeps=self.settings.substeps,
            step=self.settings.physics_step,
        )
        # Plain tuples: numba finds their type several times faster than that of named ones.
        self._outcome_arguments = tuple(self._constants), tuple(episodes), tuple(outputs)
        self._outcome = partial(
            outcome.outcome.present, False, self._all_indices, *self._outcome_arguments
        )

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Task of each environment's episode: the public knowledge of a policy."""
        return tuple(self.task(env_index) for env_index in range(self.count))

    def task(self, env_index: int) -> Task:
        """Task of one environment's episode."""
        episode = self._settings_of_episodes[env_index]
        columns = self._setting_columns[env_index]
        return Task(
            robot=episode.robot,
            trajectory=episode.trajectory,
            error_bounds=episode.error_bounds,
            control_frequency=episode.control_frequency,
            cable=episode.cable,
            model_payload=float(columns[outcome.MODEL_PAYLOAD]),
            payload_known=bool(columns[outcome.KNOWN]),
            measurement=episode.measurement,
        )

    def truth_of(self, env_index: int) -> dict[str, Array]:
        """True parameters of one environment's episode."""
        return {name: values[env_index].copy() for name, values in self.truth.items()}

    @property
    def steps(self) -> NDArray[np.int64]:
        """Control steps since the reset of each environment, shape (N,)."""
        return self._plant.step_index[: self.count]

    @property
    def pose(self) -> Array:
        """True poses X, shape (N, n)."""
        return self._plant.pose

    @property
    def torques(self) -> Array:
        """Motor torques that the last step applied, or those at rest after a reset, shape (N, m)
        [N·m]."""
        return self.cables[outcome.INFO_CABLES.index("torques"), : self.count]

    def reset(
        self,
        env_indices: NDArray[np.int64],
        options: Mapping[str, Any] | None = None,
        seeds: Sequence[int | None] | None = None,
    ) -> None:
        """Starts new episodes in the environments ``env_indices``.

        Args:
            env_indices: environments, (k,).
            options: reset options, which apply to these episodes only.
            seeds: seed of each of these environments, or None to continue its streams.

        Raises:
            ValueError: if an option is unknown or invalid. The environments and their streams are
                unchanged then.
        """
        before = self.streams.state()
        try:
            if seeds is not None:
                self.streams.seed(env_indices, seeds)
            self._start_episodes(env_indices, options)
        except Exception:
            self.streams.restore(before)
            raise

    def _start_episodes(
        self, env_indices: NDArray[np.int64], options: Mapping[str, Any] | None
    ) -> None:
        checked = check_options(options, self.settings.robot, self.count)
        episode = self.settings.with_options(checked)
        self._tables.prepare(episode.trajectory)
        if "noise_seed" in checked:
            noise_seeds = np.array(checked["noise_seed"], object)
            self.streams.noise_seeds[env_indices] = noise_seeds[env_indices]
        self.streams.start_episode(env_indices)
        if episode.payload_range is None:
            payload = self._values_of(env_indices, episode.payload)
        else:
            low, high = episode.payload_range
            uniform = self.streams.uniform(env_indices, Purpose.PAYLOAD, 1)[:, 0]
            payload = low + (high - low) * uniform
        start = episode.trajectory(0.0)
        robot = episode.robot
        if episode.initial_error is None:
            nominal = start_pose(robot, episode.trajectory, episode.error_bounds)
        else:
            nominal = start.position + episode.initial_error
        pose = np.broadcast_to(nominal, (self.count, robot.coordinates))[env_indices]
        if episode.initial_error_range is not None:
            uniform = self.streams.uniform(env_indices, Purpose.START, robot.coordinates)
            pose = pose + episode.initial_error_range * (2 * uniform - 1)
        velocity = np.broadcast_to(start.velocity, pose.shape)
        # So far only the streams have changed, which reset() restores after an error. A table that
        # prepare() has added and nobody follows does no harm.
        start_calls = []
        for uncertainty, positions in self._by_uncertainty(env_indices, episode.uncertainty):
            call = self._start_call(
                env_indices[positions],
                uncertainty,
                payload[positions],
                pose[positions],
                velocity[positions],
            )
            start_calls.append(call)

        self._store_settings(env_indices, episode, payload, rests=at_rest(start))
        for call in start_calls:
            call()
        self._tables.follow(env_indices, episode.trajectory, self._plant.trajectory_index)
        self._bind()  # the tables and the noise may be new arrays
        self._measure(env_indices, fresh=True)
        outcome.outcome(True, env_indices, *self._outcome_arguments)

    def _store_settings(
        self, env_indices: NDArray[np.int64], episode: Settings, payload: Array, *, rests: bool
    ) -> None:
        """Stores the columns that the outcome and the tasks of the episodes read."""
        known = self._values_of(env_indices, episode.payload_known)
        factor = self._values_of(env_indices, episode.model_payload_factor)
        columns = self._setting_columns.T
        columns[outcome.MODEL_PAYLOAD, env_indices] = payload * known * factor
        columns[outcome.KNOWN, env_indices] = known
        columns[outcome.POSITION_BOUND, env_indices] = episode.error_bounds.position
        columns[outcome.ROTATION_BOUND, env_indices] = episode.error_bounds.rotation
        columns[outcome.STARTS_AT_REST, env_indices] = rests
        steps = round(episode.trajectory.duration * episode.control_frequency)
        self.motion_steps[env_indices] = max(1, steps)
        for env_index in env_indices:
            self._settings_of_episodes[env_index] = episode

    def _values_of(self, env_indices: NDArray[np.int64], value: Any) -> Any:
        """Values for ``env_indices`` of a value that is given once for all environments or once per
        environment."""
        return np.broadcast_to(value, (self.count,))[env_indices]

    def _by_uncertainty(
        self, env_indices: NDArray[np.int64], uncertainties: tuple[Uncertainty, ...]
    ) -> Iterator[tuple[Uncertainty, NDArray[np.int64]]]:
        """Each uncertainty and the positions in ``env_indices`` to which it applies."""
        if len(uncertainties) == 1:
            yield uncertainties[0], np.arange(len(env_indices))
            return
        positions_of: dict[Uncertainty, list[int]] = {}
        for position, env_index in enumerate(env_indices):
            positions_of.setdefault(uncertainties[env_index], []).append(position)
        for uncertainty, positions in positions_of.items():
            yield uncertainty, np.array(positions)

    def _start_call(
        self,
        env_indices: NDArray[np.int64],
        uncertainty: Uncertainty,
        nominal_payload: Array,
        pose: Array,
        velocity: Array,
    ) -> Callable[[], None]:
        """Draws the true robots of k episodes. The returned function writes their initial
        conditions to the plant.

        Raises:
            ValueError: if no cable tensions hold a robot at rest at its start pose.
        """
        nominal = self.settings.robot
        true_robots: RobotArrays = nominal
        true_payload = nominal_payload
        parameters = self._parameters
        if uncertainty.parameters:
            uniform = self.streams.uniform(env_indices, Purpose.PARAMETERS, draw_size(nominal))
            drawn = uncertainty.draw(nominal, nominal_payload, uniform)
            true_robots = drawn
            true_payload = drawn.payload
            parameters = pack_parameters(drawn)
        shape = (len(env_indices), parameters.shape[-1])
        robot_parameters = np.array(np.broadcast_to(parameters, shape))
        robot_parameters[:, rows.MASS] += true_payload  # the plant knows one mass
        moved = any(PARAMETERS[name].position for name in uncertainty.parameters)
        try:
            torque = equilibrium_torques(
                nominal, true_robots, true_robots.mass + true_payload, pose, moved=moved
            )
        except np.linalg.LinAlgError as error:
            raise ValueError(
                "no tensions hold the robot at rest at its start pose: choose another one"
            ) from error
        torque = np.broadcast_to(torque, (len(env_indices), nominal.cables))
        motors = motor_start(true_robots, torque, pose, velocity)

        def write_to_plant() -> None:
            self.stall_torque[env_indices] = true_robots.stall_torque
            self._setting_columns[env_indices, outcome.TRUE_PAYLOAD] = true_payload
            self._store_truth(env_indices, true_robots, true_payload)
            self._plant.set_parameters(env_indices, robot_parameters)
            self._plant.set_state(env_indices, pose, velocity)
            if nominal.flexible:
                self._plant.set_motors(env_indices, motors.motor_angle, motors.speed)
            self._plant.set_torques(env_indices, motors.torque)
            action = normalised_action(true_robots, motors.torque, motors.speed)
            self._disturbances.reset(env_indices, uncertainty, np.clip(action, -1.0, 1.0))

        return write_to_plant

    def _store_truth(
        self, env_indices: NDArray[np.int64], robot: RobotArrays, payload: Array
    ) -> None:
        """Writes to :attr:`truth` the true value of each parameter that this kind of robot has."""
        for name, parameter in PARAMETERS.items():
            if not parameter.belongs_to(self.settings.robot):
                continue
            if name == "payload":
                nominal = 0.0
                true = payload
            else:
                nominal = getattr(self.settings.robot, parameter.attribute)
                true = getattr(robot, parameter.attribute)
            if name not in self.truth:
                self.truth[name] = np.zeros((self.count, *np.shape(nominal)))
            self.truth[name][env_indices] = true

    def step(self, actions: ArrayLike) -> None:
        """Advances all environments by one control period under actions (N, m), or (m,) of the
        single environment.

        Raises:
            ValueError: if the shape differs, or a component is not finite or not within ±
                ``LARGEST``.
        """
        plant = self._plant
        sent = _check_actions(actions, self._action_shape)
        self._sent[...] = sent
        applied = sent
        if not self._disturbances.quiet:
            applied = self._disturbances.delayed(sent)
            self._disturbances.update_wrench(plant)
        plant.set_action(applied)
        self._advance()
        self._measure(self._all_indices, fresh=False)
        self._outcome()

    def observe(self, readings: ArrayLike, sent: ArrayLike | None = None) -> None:
        """Makes the next observation from the sensors of real robots in place of the plant's. Reward
        and info have no meaning then.

        Args:
            readings: readings of the winches in the order of the observation, (N, components).
            sent: actions of the last control period, shaped as for :meth:`step`; None at the start,
                after :meth:`reset`.
        """
        if sent is not None:
            self._sent[...] = _check_actions(sent, self._action_shape)
            self._plant.step_index += 1
        self._sensors.readings[...] = readings
        outcome.outcome(sent is None, self._all_indices, *self._outcome_arguments)

    def _measure(self, env_indices: NDArray[np.int64], *, fresh: bool) -> None:
        """Draws the noise and reads the sensors of the next observation."""
        if not self._disturbances.quiet:
            self._disturbances.measure(env_indices, self._plant.step_index[env_indices])
        if self.settings.measurement.winches:
            self._sensors.read(env_indices, self._plant, self.truth, fresh=fresh)


def _check_actions(actions: ArrayLike, shape: tuple[int, ...]) -> Array:
    checked = np.asarray(actions, dtype=np.float64)
    if checked.shape != shape:
        raise ValueError(
            f"an action must have shape {shape}, one component for each motor, not {checked.shape}"
        )
    largest = outcome.LARGEST
    # A Python loop is faster than NumPy for a few numbers.
    if checked.ndim == 1:
        components = checked.tolist()
    else:
        components = [np.max(np.abs(checked))]
    for component in components:
        if not -largest < component < largest:
            raise ValueError(
                f"an action must be finite, each component within ± {largest:g}, not {component}"
            )
    return checked
