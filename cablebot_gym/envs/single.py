"""The single environment."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs import check_spec
from cablebot_gym.envs.outcome import (
    FIRST_CABLE_INFO,
    INFO_NAMES,
    LARGEST,
    SLACK_MARK,
    TERMINATION_REASONS,
    cable_columns,
)
from cablebot_gym.envs.pictures import RATE, Pictures, check_render_mode, moment, scene
from cablebot_gym.envs.settings import check_keywords, make_settings
from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.rendering.moment import Moment, Scene
from cablebot_gym.task import Task

SEED_MESSAGE = "a seed must be at least 0 and a whole number, not {!r}"


class CableBotEnv(gym.Env[Array, Array]):
    """A cable-suspended robot carries a payload along a reference motion, within what its motors can give.

    The plants are those of Korayem, Tourajizadeh and Bamdad (2010), misprints corrected: `CableBot-Planar-v0`, a point
    mass on three cables in the horizontal plane, and `CableBot-Spatial-v0`, a platform on six cables with six degrees
    of freedom, z pointing down; `CableBot-FlexPlanar-v0` and `CableBot-FlexSpatial-v0` have springs between motors and
    pulleys (Eq. 4). SI units and radians throughout.

    ## Action space

    `Box(-1, 1, (m,))`: the drive command of each motor. +1 is U⁺, the torque-speed line at the motor's present speed,
    −1 is U⁻: the requested torque τ_s a − (τ_s/ω_n)·β̇ is held for the control period and clipped to U± at the start
    of each physics step. Commands beyond ±1, up to ±10⁶, are accepted, recorded as `info["drive_demand"]`, and clipped
    by the line: |a| > 1 is the paper's torque violation.

    ## Observation space

    A flat, bounded `Box`; `env.unwrapped.layout` names its slices, and `layout.table()` prints them with their bounds.
    n is 2 (x, y) or 6 (x, y, z, ψ, θ, φ). A component saturates at its bound.

    | name | size | meaning |
    |---|---|---|
    | `pose` | n | X, measured: exact unless sensors are noisy |
    | `velocity` | n | Ẋ |
    | `motor_angle` | m | flexible only: β′; less the pulley's angle, the wind-up of the springs |
    | `motor_speed` | m | flexible only: β̇′ |
    | `time_left` | 1 | until the reference motion ends; 0 afterwards |
    | `reference_pose` | n | X_d at the present control instant |
    | `reference_velocity` | n | first derivative of X_d |
    | `reference_acceleration` | n | second derivative of X_d |
    | `reference_jerk` | n | flexible only: third derivative of X_d |
    | `reference_snap` | n | flexible only: fourth derivative of X_d |
    | `preview_20ms` | n | X_d 0.02 s ahead, less X_d now |
    | `preview_50ms` | n | X_d 0.05 s ahead, less X_d now |
    | `preview_100ms` | n | X_d 0.1 s ahead, less X_d now |
    | `preview_200ms` | n | X_d 0.2 s ahead, less X_d now |
    | `told_payload` | 1 | payload as told; 0 if it is not known |
    | `payload_known` | 1 | 1 if the payload is told, else 0 |

    ## Reward

    The weighted sum of `1/(1 + e/R)` for the position error e and its bound R (`limits`), the same for the rotation
    error (spatial), minus the mean of |a| beyond 1, minus the share of slack cables, minus one when the episode fails.
    Each term stands in `info` as `reward_…`, weighted.

    ## Start

    On the reference's pose and velocity at time 0, plus `initial_error`. Springs start wound to the static equilibrium
    of the true payload (planar: with at least 5 N in each cable), motors at the pulleys' speed: a policy that reads
    `motor_angle` can tell the payload from it. That is physics.

    ## Termination

    1. `tracking_error`: the position error exceeds `termination_radius`;
    2. `slack`: some cable has been slack for longer than `slack_time`;
    3. `workspace`: the pose has left the robot's workspace;
    4. `non_finite`: the state has ceased to be finite.

    `info["termination_reason"]` names it, an empty string otherwise.

    ## Truncation

    By `TimeLimit` alone, after the spec's `max_episode_steps` (500). A motion may be longer or shorter: after its
    duration the reference holds its last pose.

    ## Copies

    `copy.deepcopy(env)` and pickling branch an episode where it is: each copy goes on by itself, to the bit as the
    original does under the same commands and with the same draws.

    ## Info

    The same keys at reset and at every step. Of the present instant: `time`, `tracking_error` [m], `rotation_error`
    [rad], `payload` [kg, true]. Of the control period just passed: `tracking_error_peak`, `rotation_error_peak`
    (largest at any physics step), `slack` (bool for each cable, at any physics step: it hangs loose or, if bilateral,
    pushes), and, at its start `command_time`: `drive_demand`, `torques` [N·m], `tensions` [N], `motor_speeds` [rad/s],
    `torque_margin` (τ_s (1 − |a|), [N·m]). At reset no period has passed: commands, torques, tensions and speeds are
    zero, and the peaks are the errors at the start.

    ## Arguments

    All keyword-only, and each can be given as JSON has it. Those marked * are also reset options, which hold for one
    episode.

    | name | default | meaning |
    |---|---|---|
    | `payload`* | 0 | payload [kg]; the true one too, unless it is uncertain |
    | `payload_range` | None | (low, high): uniform, drawn anew each episode, in place of `payload` |
    | `payload_known`* | True | whether the observation tells the payload |
    | `trajectory`* | the paper's circle | a name, `{"name": …, …}` or a `Trajectory` |
    | `initial_error`* | 0 | start pose less reference, n values |
    | `initial_error_range` | None | n half widths of a uniform start error |
    | `uncertainty`* | None | what the controller does not know, see below |
    | `limits`* | 10 mm, 10 mrad | `{"position": …, "rotation": …}`, scale the reward |
    | `robot` | by id | a name, `Robot.to_dict()` data or a `Robot` |
    | `cable` | "unilateral" | or "bilateral", cables that can push |
    | `control_frequency` | 500 | drive commands per second [Hz] |
    | `substeps` | steps ≤ 1 ms, finer where springs are stiff | physics steps per control period |
    | `termination_radius` | 0.1 | [m] |
    | `slack_time` | 0.1 | [s] |
    | `reward_weights` | see `DEFAULT_WEIGHTS` | weights by term |

    ## Uncertainty

    `uncertainty` is a name (`"table6"`, the paper's; `"sensors"`), names joined by `+`, a dict such as
    `{"parameters": {"stiffness": {"low": -0.2, "high": 0.2}}, "wrench": {"force_std": 1.0}, "delay": 1}`, or a
    :class:`~cablebot_gym.uncertainty.Uncertainty`. Parameters are drawn around the nominal robot at each reset; an
    external wrench acts on the platform; sensor noise is added to `pose`, `velocity`, `motor_angle`, `motor_speed`;
    commands arrive `delay` control steps late, until then the motors hold the start, and `info["drive_demand"]` is what
    arrives. The observation and the
    task keep telling the nominal robot and payload; `env.unwrapped.truth` has all that was drawn, `info["payload"]` the
    true payload.

    The fields; what is left out has the default given. In `parameters`, one of these for each name:

    | field | default | meaning |
    |---|---|---|
    | `low`, `high` | | bounds of the deviation from nominal, a share of it: −0.1 is −10 % |
    | `relative` | true | false: the deviation is in the parameter's own unit, as anchors need it |
    | `distribution` | "uniform" | or "normal", with `mean` 0 and `std`, cut off at the bounds |
    | `each` | true | a draw for each motor, axis or coordinate; false: one for all of them |

    The names are `platform_mass`, `payload`, `platform_inertia`, `pulley_inertia`, `damping`, `stiffness`,
    `motor_inertia`, `motor_damping`, `motor_strength` (τ_s; the free speed stays), `base_anchors` and
    `platform_anchors`. In `wrench`:

    | field | default | meaning |
    |---|---|---|
    | `force_mean`, `force_std` | 0 | normal force along the base frame's axes, one number or one for each [N] |
    | `moment_mean`, `moment_std` | 0 | moment about these axes through the centre of mass, spatial [N·m] |
    | `correlation_time` | 0.01 | how long a draw is held [s] |
    | `factor` | (1, 1) | (low, high) of a factor for each component, drawn once an episode |

    In `sensors`, standard deviations of white noise, 0 by default: `position` [m], `rotation` [rad], `velocity` [m/s],
    `rotation_rate` [rad/s], `motor_angle` [rad], `motor_speed` [rad/s].

    ## Rendering

    `render_mode="rgb_array"`: `render()` returns the picture of now, 640 × 480; `"human"`: `reset` and `step` show it
    in a window, 50 times in a second of the episode. Cables are coloured by tension, dashed and sagging while slack;
    the payload is drawn as a steel ball that hangs below the platform, though it acts at its centre of mass; the tube
    around the path is R wide to either side. A bar for each motor stands within its present U⁻ and U⁺, and is red where
    more was asked for; the gauges show the errors against their bounds. A recording of every step, 500 a second, played
    with `metadata["render_fps"]` shows an episode ten times as long. Needs the extra `render`; Gymnasium's
    `RecordVideo` needs `moviepy` besides, which `cablebot video` does not. On a machine without display, "human" draws
    its pictures without showing them, and a log message says so.

    ## Version history

    * v0: first release.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": RATE}  # noqa: RUF012 - Gymnasium's

    def __init__(self, *, robot: Any, render_mode: str | None = None, **keywords: Any) -> None:
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        check_keywords(keywords)
        self.settings = make_settings(robot=robot, count=1, **keywords)
        """What the environment was made with."""
        self._simulation = Simulation(self.settings, 1)
        self.layout = self._simulation.layout
        """Names the slices of the observation."""
        self._cables = self.settings.robot.cables
        self._cable_columns = tuple(cable_columns(self._cables).items())
        self.action_space = Box(-1.0, 1.0, (self._cables,), dtype=np.float32)
        self.observation_space = self.layout.space()
        self._lane = np.zeros(1, np.int64)
        title = self.settings.robot.name
        self._pictures = None if render_mode is None else Pictures(self._simulation, title)
        self._started = self._terminated = False

    @property
    def task(self) -> Task:
        """What a policy may know of the present episode."""
        return self._simulation.tasks[0]

    @property
    def truth(self) -> dict[str, Array]:
        """True parameters of the present episode, names as in :data:`cablebot_gym.uncertainty.PARAMETERS`."""
        return {name: values[0].copy() for name, values in self._simulation.truth.items()}

    @property
    def pose(self) -> Array:
        """True pose X, shape (n,)."""
        pose: Array = self._simulation.pose[0]
        return pose

    @property
    def scene(self) -> Scene:
        """What there is to see throughout the present episode."""
        return scene(self._simulation, 0, self.settings.robot.name)

    @property
    def moment(self) -> Moment:
        """What there is to see now: the true state."""
        return moment(self._simulation, 0)

    def render(self) -> NDArray[np.uint8] | None:
        """The present picture, shape (480, 640, 3), with ``rgb_array``; None otherwise, see the class.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._pictures is None:
            gym.logger.warn('render() shows nothing: make the environment with render_mode="rgb_array" or "human"')
            return None
        if not self._started:
            raise ResetNeeded("call reset() before render()")
        if self.render_mode == "rgb_array":
            return self._pictures.array(0)
        self._pictures.show()
        return None

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._pictures is not None:
            self._pictures.close()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; ``options`` hold for this episode only, see the class.

        Raises:
            ValueError: if an option is unknown or not valid; the present episode goes on then. At the first reset, if
                the robot is of another kind than the id's.
        """
        if not self._started:
            check_spec(self.spec, self.settings.robot)
        if seed is not None and (not isinstance(seed, (int, np.integer)) or seed < 0):
            raise ValueError(SEED_MESSAGE.format(seed))
        before = self._np_random, self._np_random_seed, self._simulation.streams.standing()
        try:
            if seed is not None or not self._started:
                super().reset(seed=None if seed is None else int(seed))
                self._simulation.streams.seed([0], [self.np_random_seed])
            self._simulation.reset(self._lane, options)
        except Exception:  # a refused reset takes nothing, not even its seed
            self._np_random, self._np_random_seed, streams = before
            self._simulation.streams.restore(streams)
            raise
        self._started, self._terminated = True, False
        if self._pictures is not None:
            self._pictures.begun([0])
            if self.render_mode == "human":
                self._pictures.show()
        observation, _, _, info = self._result()
        return observation, info

    def step(self, action: ArrayLike) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One control period.

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the action is not m finite numbers.
        """
        if not self._started:
            raise ResetNeeded("call reset() before step()")
        checked = check_action(action, (self._cables,))
        if self._terminated:
            gym.logger.warn("step() after the episode was terminated: what follows is no episode, call reset()")
        self._simulation.step(checked)
        if self._pictures is not None:
            self._pictures.stepped()
            if self.render_mode == "human":
                self._pictures.show()
        observation, reward, self._terminated, info = self._result()
        return observation, reward, self._terminated, False, info

    def _result(self) -> tuple[Array, float, bool, dict[str, Any]]:
        simulation = self._simulation
        row, reason = simulation.info[0].copy(), int(simulation.reason[0])
        # The arrays are views of this step's own copy; the scalars become Python floats all at once.
        info: dict[str, Any] = dict(zip(INFO_NAMES, row[:FIRST_CABLE_INFO].tolist(), strict=True))
        for name, columns in self._cable_columns:
            info[name] = row[columns]
        info["slack"] = info["slack"] > SLACK_MARK
        info["termination_reason"] = TERMINATION_REASONS[reason]
        return simulation.observation[0].copy(), float(simulation.reward[0]), reason > 0, info


def check_action(action: ArrayLike, shape: tuple[int, ...]) -> Array:
    """The action as finite floats of the right shape.

    Raises:
        ValueError: if it is anything else.
    """
    checked = np.asarray(action, dtype=np.float64)
    if checked.shape != shape:
        raise ValueError(f"an action has shape {shape}, one drive command for each motor, not {checked.shape}")
    # Of a few numbers a list is far the quickest to search.
    if checked.ndim == 1:
        sane = all(-LARGEST < command < LARGEST for command in checked.tolist())
    else:
        sane = bool(np.all(np.abs(checked) < LARGEST))
    if not sane:
        raise ValueError(f"an action must be finite, each command within ± {LARGEST:g}: no NaN, no infinity")
    return checked
