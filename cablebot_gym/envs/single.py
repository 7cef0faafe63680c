"""The single environment."""

from __future__ import annotations

import inspect
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs import SpecChecked
from cablebot_gym.envs.outcome import info_dict
from cablebot_gym.envs.pictures import RATE, Pictures, check_render_mode
from cablebot_gym.envs.settings import KEYWORDS, keyword_table
from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import PARAMETERS
from cablebot_gym.utils.checks import check_keywords, whole


class CableBotEnv(SpecChecked, gym.Env[Array, Array]):
    """A cable-suspended robot moves a payload along a reference motion with motors of limited
    torque.

    The first four robots are those of Korayem, Tourajizadeh and Bamdad (2010), with misprints
    corrected:

    * `CableBot-Planar-v0`: a point mass on three cables in the horizontal plane.
    * `CableBot-Spatial-v0`: a platform with six degrees of freedom on six cables; the z axis points
      down.
    * `CableBot-FlexPlanar-v0` and `CableBot-FlexSpatial-v0`: the same robots with springs between
      motors and pulleys (Eq. 4).
    * `CableBot-Point-v0` and `CableBot-PlanarPlatform-v0`: a camera on four cables, and a plate on
      four cables in a vertical plane; from published data and assumptions.
    * `CableBot-FlexPoint-v0` and `CableBot-FlexPlanarPlatform-v0`: the same robots with elastic
      cables.

    All quantities are in SI units and radians.

    ## Action space

    `Box(-1, 1, (m,))`: one normalised action a for each of the m motors. The torque-speed line
    limits the torque of a motor to U⁻ ≤ τ ≤ U⁺, with U± = ±τ_s − (τ_s/ω_n)·β̇ for the stall torque
    τ_s, the free speed ω_n and the present motor speed β̇. Action +1 requests U⁺, action −1
    requests U⁻.

    At the start of a control period, the action, clipped to ±1, sets the requested torque τ_s a −
    (τ_s/ω_n)·β̇, which is constant during the period. The motor follows it with the time constant
    `lag` of the robot's motors, usually 0. The result is clipped to the present U± at every stage
    of every physics step. This is the applied torque.

    Actions outside [−1, 1] are accepted if their magnitude is below 10⁶. They act like ±1 and are
    returned unclipped as `info["commanded_action"]`: |a| > 1 is the torque violation of the paper.

    ## Observation space

    A flat, bounded `Box`. `env.unwrapped.layout` gives the slices of the blocks, and
    `layout.table()` prints them with their bounds. m is the number of cables, n that of the
    coordinates: (x, y) or (x, y, z) of a point mass, (x, y, φ) of a platform in a plane,
    (x, y, z, ψ, θ, φ) of one in space. A component saturates at its bound.

    | name | size | meaning |
    |---|---|---|
    | `pose` | n | measured pose X, exact without sensor noise |
    | `velocity` | n | measured velocity Ẋ, exact without sensor noise |
    | `motor_angle` | m | flexible only: motor angle β′; β′ minus the pulley angle β is the spring deflection |
    | `motor_speed` | m | flexible only: motor speed β̇′ |
    | `time_to_go` | 1 | time until the reference motion ends; 0 afterwards |
    | `reference_pose` | n | reference pose X_d at the present control instant |
    | `reference_velocity` | n | first derivative of X_d |
    | `reference_acceleration` | n | second derivative of X_d |
    | `reference_jerk` | n | flexible only: third derivative of X_d |
    | `reference_snap` | n | flexible only: fourth derivative of X_d |
    | `preview_20ms` | n | X_d in 0.02 s minus X_d now |
    | `preview_50ms` | n | X_d in 0.05 s minus X_d now |
    | `preview_100ms` | n | X_d in 0.1 s minus X_d now |
    | `preview_200ms` | n | X_d in 0.2 s minus X_d now |
    | `model_payload` | 1 | payload of the controller's model; 0 if the payload is unknown |
    | `payload_known` | 1 | 1 if the payload is known, else 0 |
    | `last_actions` | 3m | the last three actions, latest first, clipped to ±1; 0 before the first |
    | `slack_time` | 1 | time for which some cable has been slack without a pause, see "Termination" |

    `measurement="winches"` replaces `pose` and `velocity` by the sensors of the winches, of rigid
    robots too. They are the first blocks:

    | name | size | meaning |
    |---|---|---|
    | `motor_angle` | m | motor angle, zero at the home pose of the true robot |
    | `motor_speed` | m | motor speed |
    | `tensions` | m | `+tensions`: load cells: tensions at the start of the last control period; at first, at rest |
    | `orientation` | 3 | `+imu`: roll ψ, pitch θ and yaw φ |
    | `angular_rate` | 3 | `+imu`: angular rate in the frame of the platform |
    | `specific_force` | 3 | `+imu`: mean acceleration minus gravity in the last control period, in the same frame |

    `measurement={"kind": "winches", "encoder_resolution": 7.7e-4, "tensions": True}` rounds the
    motor angles to steps of `encoder_resolution` [rad]. The errors of the sensors are `sensors` and
    `sensor_bias` of the uncertainty. Reward, termination and info use the true state. The
    normalised observation has no tracking errors then.

    `last_actions` are the actions that the policy sent, before a `delay` of the uncertainty.
    Together with them and `slack_time` the observation has the Markov property if all parameters
    are known, the motors have no lag, and the delay is at most three control periods. It does not
    have it with a longer delay, with sensor noise or a wrench, or with unknown parameters. The
    reward also depends on whether a limit has been violated before; with `terminate_on_violation`
    it does not.

    `normalised_observation=True` is recommended for learning: the components above differ by many
    orders of magnitude, those of the normalised observation are of order one. Each component is
    (value − centre)/scale. The scales follow from the robot alone, and `layout.table()` prints
    them. `pose` and `velocity` become tracking errors, with the default error bounds as the scale
    of the pose. `layout.normalise(observation)` is the same function, and
    `layout.space(normalised=True)` the space. `observation_dtype="float32"` rounds the observation
    to the number type of most networks. The simulation uses float64 in any case.

    ## Reward

    The reward is the weighted sum of five terms. `reward_weights` sets the weights, and `info`
    contains each weighted term as `reward_…`.

    | term | weight | value |
    |---|---|---|
    | `inside` | 1 | 1 while no limit has been violated in the episode, else 0 |
    | `position` | 0.05 | 1/(1 + e/R), with the position error e and its bound R |
    | `rotation` | 0.05 | 1/(1 + e/R), with the rotation error e and its bound R; 0 for a point mass |
    | `saturation` | 0.02 | minus the mean over the motors of min(1, max(0, abs(a) − 1)) |
    | `violation` | 0.1 | minus the number of control steps of the motion, once, at the first violation |

    The limits are those of the task criterion, by which a policy is evaluated, and
    `info["violated"]` tells whether one has been violated in the episode, at the start included:

    * the position and rotation errors are within the bounds R of `error_bounds` at every physics
      step;
    * each cable has at least the tension `minimum_tension` of the robot (1 N) at every physics
      step, or is not pushed, if cables are bilateral;
    * each cable has at most the tension `maximum_tension` of the robot, if it has one, at every
      physics step;
    * the motors can hold the robot at the start, if the motion starts at rest;
    * the episode does not terminate.

    With the default weights, every episode that keeps all limits has a larger return than every
    episode of the same motion that violates one. For a motion of K steps:

    * Without violation, each step yields 1 from `inside`, at least 0.05/2 from `position`, because
      e ≤ R, and at least −0.02 from `saturation`: the return exceeds K.
    * With the first violation in step k ≤ K, `inside` yields k − 1 ≤ K − 1, `position` and
      `rotation` yield at most 0.1 K, and `violation` takes 0.1 K: the return is at most K − 1.

    ## Start

    An episode starts at time 0 with the velocity of the reference. The start pose is the same for
    all payloads:

    * Without gravity, which is in a horizontal plane, robots start at the first pose of the
      reference.
    * Under gravity they start lower than this pose by half the position error bound, at most 50 mm,
      if the motion starts at rest: there the cables are steeper, and the motors hold more payload
      at rest. `paper-spatial`, the circle as printed, accelerates from time 0 and starts on the
      reference.
    * `initial_error` sets the difference between start pose and reference pose; 0 starts on the
      reference.

    `info["torques"]` after a reset are the torques that hold the true robot at rest at the start
    pose, with a reserve of tension if there are more cables than coordinates. `torque_margin` is
    their distance from the stall torques. If a component is negative, no policy can hold the robot
    there, and the payload counts as not carried, if the motion starts at rest.

    The springs of a flexible robot start with these torques, clipped to the stall torques, and its
    motors start at the speed of the pulleys. A policy that reads `motor_angle` can therefore infer
    an unknown payload; this is physically correct.

    ## Termination

    An episode terminates if one of these conditions is met:

    1. `tracking_error`: the position error exceeds 0.1 m and twice its bound of the keyword
       `error_bounds`;
    2. `slack`: some cable has been slack for longer than 0.1 s;
    3. `workspace`: the pose is outside the workspace of the robot;
    4. `non_finite`: the state is not finite;
    5. `violation`: a limit is violated, see "Reward", and `terminate_on_violation` is set.

    `info["termination_reason"]` is the code of the condition, an integer, and 0 while the episode
    runs. :data:`cablebot_gym.envs.TERMINATION_REASONS` has the names by code:

    | code | 0 | 1 | 2 | 3 | 4 | 5 |
    |---|---|---|---|---|---|---|
    | name | (empty) | `tracking_error` | `slack` | `workspace` | `non_finite` | `violation` |

    If several conditions are met, `non_finite` takes precedence, then `workspace`,
    `tracking_error`, `slack` and `violation`.

    ## Truncation

    The step that completes the motion truncates the episode: step `env.unwrapped.task.steps`, the
    duration of the motion times `control_frequency`. The default motion has 800 steps at 500 Hz.
    The ids are registered without `max_episode_steps`; `gym.make(id, max_episode_steps=100)` adds
    Gymnasium's wrapper `TimeLimit`, which truncates earlier.

    `step` may be called after the truncation: the reference stays at its final pose, and every
    further step is truncated too.

    ## Copies

    `copy.deepcopy(env)` and pickling copy the environment in the middle of an episode. The copy and
    the original are independent. With equal actions they return equal results, bit for bit,
    including random draws.

    ## Info

    The dict has the same keys after a reset and after every step. All values are numbers, booleans
    or arrays of them.

    * At the present instant: `time` [s], `tracking_error` (position error) [m], `rotation_error`
      (largest difference of an angle) [rad], `payload` (true payload) [kg].
    * Since the start: `violated` (whether a limit has been violated, see "Reward"),
      `termination_reason` (code, see "Termination").
    * Over the last control period: `cost`, as in Safety-Gymnasium: 1 if a limit is violated in the
      period, else 0. The limits are those of `violated`. After a reset, it is 1 if the start
      violates a limit, which counts in the first step too: an episode keeps all limits if and only
      if the sum of the costs of its steps is 0.
    * Over the last control period: `tracking_error_peak` and `rotation_error_peak` (largest values
      at any physics step), `least_tensions` and `largest_tensions` (m least and m largest tensions
      at the start of any physics step) [N], and `slack` (m booleans: whether the cable was slack at
      any physics step or, if cables are bilateral, pushed).
    * At the start of the last control period, which is at `action_time` [s]: `commanded_action`,
      `torques` (applied torques) [N·m], `tensions` [N], `motor_speeds` [rad/s], `torque_margin`
      (distance of the requested torque from the torque limit, τ_s (1 − abs(a))) [N·m]. Each has m
      components.

    After a reset there is no last period: actions, tensions and speeds are 0, and the peaks are the
    errors at the start. `torques` and `torque_margin` are those at rest, see "Start".

    ## Arguments

    All arguments are keyword-only and accept JSON-able values. Those marked * are also reset
    options, which apply to one episode: `env.reset(options={"payload": 2.0})`.

    {keywords}

    The defaults of a robot are in its data. Without data, the motion is the paper's circle between
    dwells for a robot with the paper's geometry, else a lemniscate about the home pose that the
    motors can follow; the bounds are 10 mm (at most 1 % and at least 0.1 % of the width of the
    base) and 10 mrad.

    ## Payload known or unknown

    The *nominal payload* is `payload` or the draw from `payload_range`. The *true payload* acts on
    the robot: `info["payload"]`. It differs from the nominal payload only by `uncertainty`. The
    *model payload* is the payload of the controller's model. The controller reads it in the block
    `model_payload` of the observation and in `env.unwrapped.task.model_payload`. It is
    `model_payload_factor` times the nominal payload if the payload is known (`payload_known`), and
    0 if the payload is unknown.

    ## Uncertainty

    `uncertainty` describes how the true robot differs from the nominal robot. It is one of:

    * a name: `"table6"` (the paper's Table 6), `"table6-load"`, `"hardware"` (a real winch robot)
      or `"sensors"`, or names joined by `+`;
    * a dict such as `{"parameters": {"stiffness": {"low": -0.2, "high": 0.2}}, "wrench":
      {"force_std": 1.0}, "delay": 1}`;
    * a :class:`~cablebot_gym.uncertainty.Uncertainty`.

    It has five parts:

    * `parameters`: true parameters, drawn around the nominal values at each reset.
    * `wrench`: an external wrench on the platform.
    * `sensors`: white noise on the measured blocks of the observation.
    * `sensor_bias`: normal errors of the same blocks, constant in an episode.
    * `delay`: number of control steps by which actions arrive late, or `(low, high)` of a number
      drawn at each reset. The observation holds the last three actions; with a longer delay it is
      not Markov. Until the first action arrives, the motors hold the true robot, with its true
      payload, at rest at the start pose. `info["commanded_action"]` is the action that arrives.

    The observation and the task contain the nominal robot and the model payload.
    `env.unwrapped.truth` contains the true parameters, and `info["payload"]` is the true payload.

    Fields that are omitted have their defaults. Each entry of `parameters` has these fields:

    | field | default | meaning |
    |---|---|---|
    | `low`, `high` | | bounds of the uniform deviation, as a fraction of the nominal value: −0.1 is −10 % |
    | `relative` | true | false: the deviation is in the unit of the parameter, which anchors require |
    | `each` | true | one draw for each motor, axis or coordinate; false: one draw for all of them |

    The names of the parameters are {parameters}.
    `motor_strength` is τ_s at constant free speed. The nominal robots have no lag and no Coulomb
    friction: give these two with `"relative": false`.

    `wrench` has these fields:

    | field | default | meaning |
    |---|---|---|
    | `force_mean`, `force_std` | 0 | normal force along the axes of the base frame, one number or one per axis [N] |
    | `moment_mean`, `moment_std` | 0 | not for a point mass: moment about these axes through the centre of mass [N·m] |
    | `correlation_time` | 0.01 | time for which a draw is constant [s] |
    | `factor` | (1, 1) | (low, high) of a uniform factor for each component, drawn once per episode |

    `sensors` and `sensor_bias` have standard deviations, 0 by default: `position` [m], `rotation`
    [rad], `velocity` [m/s], `rotation_rate` [rad/s], `motor_angle` [rad] and `motor_speed` [rad/s];
    with winches `tension` [N] of the load cells, and `tilt` (roll, pitch) [rad], `yaw` [rad],
    `angular_rate` [rad/s] and `specific_force` [m/s²] of the IMU.

    The wrench and the white noise have a seed of their own, the reset option `noise_seed` (default:
    the seed). In a vector environment it is one integer, which counts up like the seed, or one per
    environment. Episodes with equal seeds and different noise seeds have the same parameters and
    different noise.

    ## Rendering

    With `render_mode="rgb_array"`, `render()` returns the present picture of 640 × 480 pixels. With
    `"human"`, `reset` and `step` show it in a window, 50 times per second of episode time. On a
    machine without display, `"human"` paints the pictures without showing them and writes a log
    message.

    * The colour of a cable shows its tension. A slack cable is dashed and sags.
    * The payload is a steel ball below the platform, although it acts at the platform's centre of
      mass.
    * The tube around the path extends by the position error bound R to either side.
    * Each motor has a bar of its applied torque between its present U⁻ and U⁺. The bar is red if
      the motor saturates.
    * Gauges compare the errors with their error bounds.

    A recording of every step has 500 pictures per second of episode time. Played at
    `metadata["render_fps"]` (50), it is ten times slower than the episode. Rendering requires the
    extra `render`. Gymnasium's `RecordVideo` also requires `moviepy`; `cablebot video` does not.

    ## Version history

    * v0: release 0.1.0. The changelog gives the rules with their reasons.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": RATE}  # noqa: RUF012 - Gymnasium's

    def __init__(self, *, robot: Any, render_mode: str | None = None, **keywords: Any) -> None:
        check_keywords(keywords, KEYWORDS, type(self))
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        self._simulation = Simulation(robot, (), keywords)
        self.settings = self._simulation.settings
        """Checked constructor keywords."""
        self.layout = self._simulation.layout
        """Layout of the observation: names, slices, units and bounds of its blocks."""
        self.action_space = Box(-1.0, 1.0, (self.settings.robot.cables,), dtype=np.float32)
        self.observation_space = self.settings.observation_space()
        self._env_index = np.zeros(1, np.int64)
        self._pictures: Pictures | None = None
        if render_mode is not None:
            self._pictures = Pictures(self._simulation, self.settings.robot.name)
        self._started = self._terminated = False

    @property
    def task(self) -> Task:
        """Task of the present episode: the public knowledge of a policy."""
        return self._simulation.task(0)

    @property
    def truth(self) -> dict[str, Array]:
        """True parameters of the present episode, named as in
        :data:`cablebot_gym.uncertainty.PARAMETERS`."""
        return self._simulation.truth_of(0)

    @property
    def pose(self) -> Array:
        """True pose X, shape (n,)."""
        pose: Array = self._simulation.pose[0]
        return pose

    def render(self) -> NDArray[np.uint8] | None:
        """The present picture, shape (480, 640, 3), if the render mode is ``rgb_array``; else None.
        See the class.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._pictures is None:
            gym.logger.warn(
                "render() has no effect without a render mode: make the environment with "
                'render_mode="rgb_array" or "human"'
            )
            return None
        if not self._started:
            raise ResetNeeded("call reset() before render()")
        if self.render_mode == "rgb_array":
            return self._pictures.array(0)
        self._pictures.show()
        return None

    def close(self) -> None:
        """Closes the window, if it is open."""
        if self._pictures is not None:
            self._pictures.close()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; ``options`` apply to this episode only, see the class.

        Raises:
            ValueError: if an option or the seed is invalid; the present episode is unchanged then.
        """
        if seed is not None:
            seed = whole("seed", seed)
        episode_seed = seed
        if seed is None and not self._started:
            episode_seed = self.np_random_seed
        self._simulation.reset(self._env_index, options, [episode_seed])
        # After the check of the options, because an invalid reset does not change the seed.
        super().reset(seed=seed)
        self._started = True
        self._terminated = False
        if self._pictures is not None:
            self._pictures.on_reset([0])
            if self.render_mode == "human":
                self._pictures.show()
        observation, _, _, info = self._result()
        return observation, info

    def step(self, action: ArrayLike) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advances the episode by one control period. The step that completes the motion truncates
        the episode.

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the action is not m finite numbers.
        """
        if not self._started:
            raise ResetNeeded("call reset() before step()")
        if self._terminated:
            gym.logger.warn(
                "step() after the episode was terminated: the results are meaningless, call reset()"
            )
        self._simulation.step(action)
        if self._pictures is not None:
            self._pictures.on_step()
            if self.render_mode == "human":
                self._pictures.show()
        observation, reward, self._terminated, info = self._result()
        return observation, reward, self._terminated, bool(self._simulation.complete[0]), info

    def _result(self) -> tuple[Array, float, bool, dict[str, Any]]:
        simulation = self._simulation
        reason = int(simulation.reason[0])
        info = info_dict(simulation.info[0], simulation.cables[:, 0])
        info["termination_reason"] = reason
        observation = simulation.observation[0].astype(self.settings.observation_dtype)
        return observation, float(simulation.reward[0]), reason > 0, info


_PARAMETER_NAMES = ", ".join(f"`{name}`" for name in PARAMETERS)
CableBotEnv.__doc__ = (
    inspect.cleandoc(CableBotEnv.__doc__ or "")  # absent under python -OO
    .replace("{keywords}", keyword_table())
    .replace("{parameters}", _PARAMETER_NAMES)
)
