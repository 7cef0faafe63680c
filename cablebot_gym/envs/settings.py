"""Constructor keywords and reset options of the environments, with their checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from numbers import Real
from typing import Any, cast, get_args

import numpy as np
from gymnasium import logger
from gymnasium.spaces import Box
from numpy.typing import NDArray

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.own_motion import own_motion
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import Measurement, find_measurement
from cablebot_gym.physics import textbook
from cablebot_gym.physics.textbook import fastest_decay_rate, highest_frequency
from cablebot_gym.robots import Cable, Robot, find_robot, has_paper_geometry
from cablebot_gym.task import ErrorBounds, at_rest, check_workspace, find_error_bounds, start_pose
from cablebot_gym.trajectories import Trajectory, find_trajectory
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty
from cablebot_gym.utils.checks import choice, mapping, number, numbers, whole

LONGEST_PHYSICS_STEP = 1e-3
"""Largest default physics step [s]. On the paper's robots, RK4's error over 0.5 s is below 1e-9 at
this step. Accuracy allows longer steps, but checks of slack and errors every 2 ms find later
violations."""

FREQUENCY = 500.0
"""Default number of actions per second [Hz]."""

MODE_LOSS = {"planar": 1e-6, "spatial": 1e-5}
"""Bound of the fraction of its energy that a flexible robot's fastest mode loses per second to RK4
with the default physics step. RK4 dissipates φ⁶/72 per step h, with φ = ω h. A planar robot can
oscillate in this mode alone. A spatial robot without torque falls, and loses less than 1e-6 of its
kinetic energy. A robot that is held at rest can lose the whole fraction."""

MOST_SUBSTEPS = 1000
"""Largest default number of physics steps per control period. A need for more indicates an error in
the stiffness."""

STABLE_PHASE = 2.6
"""Largest product of the physics step and the fastest rate of a robot at its home pose. RK4 is
stable up to 2√2 for an undamped oscillation and up to 2.78 for a decay by friction or along the
torque-speed line. Elsewhere in the workspace the springs oscillate up to 6 % faster."""

DEFAULT_WEIGHTS = {
    "inside": 1.0,
    "position": 0.05,
    "rotation": 0.05,
    "saturation": 0.02,
    "violation": 0.1,
}
"""Default weights of the reward terms. They order success before failure; the single environment's
manual proves it."""

OBSERVATION_DTYPES = ("float64", "float32")
"""Number types of the observation. The simulation and the evaluation use float64."""

FOREIGN_OPTIONS = ("reset_mask", "minari_autoseed")
"""Reset options of Gymnasium's vector API and of Minari, which the checks here ignore."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Checked constructor keywords of an environment; made by :func:`make_settings`."""

    robot: Robot
    """Nominal robot. The true robot is equal to it, except for ``uncertainty``."""
    payload: float | Array
    """Nominal payload [kg], scalar or (N,); ≥ 0. The true payload is equal to it, except for
    ``uncertainty``."""
    payload_range: tuple[float, float] | None
    """(low, high) of a uniform nominal payload, drawn in each episode [kg]; None for
    ``payload``."""
    payload_known: bool | Array
    """Whether the payload is known to the controller, scalar or (N,)."""
    model_payload_factor: float | Array
    """Ratio of the payload of the controller's model to the nominal payload, scalar or (N,); ≥ 0.

    No effect if the payload is unknown.
    """
    trajectory: Trajectory
    """Default reference motion."""
    initial_error: Array | None
    """Start pose minus reference pose, (n,) or (N, n) [m, rad]; None for
    :func:`cablebot_gym.task.start_pose`."""
    initial_error_range: Array | None
    """Half widths of a uniform start error, (n,) [m, rad], drawn in each episode and added to the
    start pose."""
    uncertainty: tuple[Uncertainty, ...]
    """Uncertainty of the plant, as a tuple of one for all environments, or of N."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors. A larger error is a violation, and they scale the reward."""
    measurement: Measurement
    """Sensors whose readings are in the observation."""
    cable: Cable
    """``unilateral``: cables only pull; ``bilateral``: cables also push, as in the paper's
    equations."""
    control_frequency: float
    """Actions per second [Hz]."""
    substeps: int
    """Physics steps per control period."""
    termination_radius: float
    """Position error beyond which an episode terminates [m]."""
    slack_time: float
    """Longest time for which a cable may be slack before the episode terminates [s]."""
    terminate_on_violation: bool
    """Whether an episode terminates at the first violation of a limit."""
    weights: Array
    """Weights of the reward terms, in the order of ``REWARD_TERMS``."""
    normalised_observation: bool
    """Whether the observation is that of
    :meth:`~cablebot_gym.envs.observation.ObservationLayout.normalise`."""
    observation_dtype: str
    """Number type of the observation and its space: ``float64`` or ``float32``."""

    def observation_space(self) -> Box:
        """Observation space of one environment."""
        layout = observation_layout(self.robot, self.measurement)
        return layout.space(normalised=self.normalised_observation, dtype=self.observation_dtype)

    def note_unheld_start(self) -> None:
        """Warns, once, if the motors cannot hold even the least payload at the start of a motion
        from rest."""
        if not at_rest(self.trajectory(0.0)):
            return
        payload = float(
            np.min(self.payload if self.payload_range is None else self.payload_range[0])
        )
        pose = start_pose(self.robot, self.trajectory, self.error_bounds)
        _note_unheld_pose(self.robot, payload, self.trajectory.name, tuple(pose.tolist()))

    @property
    def period(self) -> float:
        """Length of a control period [s]."""
        return 1 / self.control_frequency

    @property
    def physics_step(self) -> float:
        """Length of a physics step [s]."""
        return self.period / self.substeps


def default_trajectory(robot: Robot) -> str | Mapping[str, Any]:
    """Default reference motion of a robot: that of its data, the circle of a robot with the paper's
    geometry, or :func:`~cablebot_gym.envs.own_motion.own_motion`."""
    if robot.defaults.trajectory is not None:
        return robot.defaults.trajectory
    if has_paper_geometry(robot):
        return f"circle-{robot.kind}"
    return own_motion(robot)


def make_settings(
    *,
    robot: str | dict[str, Any] | Robot,
    count: int,
    payload: Any = None,
    payload_range: Any = None,
    payload_known: Any = True,
    model_payload_factor: Any = 1.0,
    trajectory: Any = None,
    initial_error: Any = None,
    initial_error_range: Any = None,
    uncertainty: Any = None,
    error_bounds: Any = None,
    measurement: Any = None,
    cable: str = "unilateral",
    control_frequency: float = FREQUENCY,
    substeps: int | None = None,
    termination_radius: float | None = None,
    slack_time: float = 0.1,
    terminate_on_violation: bool = False,
    reward_weights: Mapping[str, float] | None = None,
    normalised_observation: bool = False,
    observation_dtype: str = "float64",
) -> Settings:
    """Checked settings of ``count`` environments from their keywords, which :class:`Settings`
    describes.

    Values are objects or JSON-able data. None stands for the default: no payload, the motion of
    :func:`default_trajectory`, the start pose of :func:`cablebot_gym.task.start_pose`, no
    uncertainty, pose and velocity as the measurement, the default error bounds and their
    termination radius, :data:`DEFAULT_WEIGHTS`, and :func:`fewest_substeps`. ``uncertainty`` can be
    a list with one item per environment.

    Raises:
        ValueError: if a value is invalid; the message names the keyword.
    """
    robot = find_robot(robot)
    options = {
        "payload": 0.0 if payload is None else payload,
        "payload_known": payload_known,
        "model_payload_factor": model_payload_factor,
        "trajectory": default_trajectory(robot) if trajectory is None else trajectory,
        "initial_error": initial_error,
        "uncertainty": uncertainty,
        "error_bounds": error_bounds,
    }
    episode = check_options(options, robot, count)
    frequency = number("control_frequency", control_frequency, above=0)
    if substeps is None:
        substeps = fewest_substeps(robot, episode["uncertainty"], frequency)
    substeps = whole("substeps", substeps, least=1)
    check_stability(robot, episode["uncertainty"], frequency, substeps)
    if payload_range is not None:
        if payload is not None:
            raise ValueError(
                "payload and payload_range exclude each other: payload_range draws a payload per episode"
            )
        ends = numbers(
            "payload_range", payload_range, shapes=[(2,)], form="(low, high)", least=0, unit="kg"
        )
        low, high = ends.tolist()
        payload_range = low, number("payload_range", high, least=low, unit="kg")
    radius = (
        episode["error_bounds"].termination_radius
        if termination_radius is None
        else termination_radius
    )
    if initial_error_range is not None:
        shapes = [(robot.coordinates,)]
        initial_error_range = numbers(
            "initial_error_range", initial_error_range, shapes=shapes, least=0
        )
    weights = DEFAULT_WEIGHTS | mapping("reward_weights", reward_weights or {}, REWARD_TERMS)
    return Settings(
        robot=robot,
        payload_range=payload_range,
        initial_error_range=initial_error_range,
        measurement=find_measurement(measurement, robot),
        cable=cast(Cable, choice("cable", cable, get_args(Cable))),
        control_frequency=frequency,
        substeps=substeps,
        termination_radius=number("termination_radius", radius, above=0),
        slack_time=number("slack_time", slack_time, least=0),
        terminate_on_violation=_boolean("terminate_on_violation", terminate_on_violation),
        normalised_observation=_boolean("normalised_observation", normalised_observation),
        observation_dtype=choice("observation_dtype", observation_dtype, OBSERVATION_DTYPES),
        weights=np.array(
            [number(f"reward weight {name!r}", weights[name]) for name in REWARD_TERMS]
        ),
        **episode,
    )


@cache
def _note_unheld_pose(robot: Robot, payload: float, motion: str, pose: tuple[float, ...]) -> None:
    minimum = textbook.allocated_minimum(robot)
    torque = textbook.static_torque(robot, robot.mass + payload, pose, minimum=minimum)
    excess = np.abs(torque) - robot.stall_torque
    motor = int(np.argmax(excess))
    if excess[motor] > 0:
        logger.warn(
            f"robot {robot.name!r} with {payload:g} kg cannot be held at the start of {motion!r}: motor "
            f"{motor + 1} needs {abs(torque[motor]):.3g} N·m and has {robot.stall_torque[motor]:.3g} N·m. All episodes "
            "fail; `cablebot robot check` shows what the robot holds"
        )


def fewest_substeps(
    robot: Robot,
    uncertainties: tuple[Uncertainty, ...] = (Uncertainty(),),
    control_frequency: float = FREQUENCY,
) -> int:
    """Default number of physics steps per control period: the fewest that satisfy
    :data:`LONGEST_PHYSICS_STEP`, :data:`MODE_LOSS` and :data:`STABLE_PHASE`.

    Raises:
        ValueError: if there would be more than :data:`MOST_SUBSTEPS`.
    """
    fastest = max(_fastest_rate(robot, uncertainty) for uncertainty in uncertainties)
    longest = min(LONGEST_PHYSICS_STEP, STABLE_PHASE / fastest)
    if robot.flexible:
        frequency = highest_frequency(robot)
        phase = (
            72 * MODE_LOSS["planar" if robot.kind == "planar" else "spatial"] / frequency
        ) ** 0.2
        longest = min(longest, phase / frequency)
    needed = 1 / (control_frequency * longest)
    if needed > MOST_SUBSTEPS:
        raise ValueError(
            f"robot {robot.name!r} needs {needed:.3g} physics steps in a control period: raise control_frequency, use "
            "softer springs, less friction or larger inertias, or set substeps"
        )
    return max(1, math.ceil(needed - 1e-9))


def _fastest_rate(robot: Robot, uncertainty: Uncertainty) -> float:
    """Largest rate at which a robot can oscillate or settle under an uncertainty [rad/s]."""
    true = uncertainty.fastest(robot)
    return max(highest_frequency(true) if robot.flexible else 0.0, fastest_decay_rate(true))


def check_stability(
    robot: Robot, uncertainties: tuple[Uncertainty, ...], control_frequency: float, substeps: int
) -> None:
    """Checks that the physics step is short enough for springs and friction at the limits of the
    uncertainties.

    Raises:
        ValueError: if it is too long; the message gives the number of substeps that is sufficient.
    """
    fastest = max(_fastest_rate(robot, uncertainty) for uncertainty in uncertainties)
    if fastest / (control_frequency * substeps) > STABLE_PHASE:
        needed = math.ceil(fastest / (control_frequency * STABLE_PHASE))
        raise ValueError(
            f"substeps={substeps} is too small for the springs or the friction of robot {robot.name!r} with this "
            f"uncertainty: use at least {needed}, or omit substeps when you make the environment"
        )


def check_options(options: Mapping[str, Any] | None, robot: Robot, count: int) -> dict[str, Any]:
    """Reset options, checked and in canonical form, without :data:`FOREIGN_OPTIONS`.

    Args:
        options: values by name; None for none.
        robot: the nominal robot.
        count: number of environments, N.

    Raises:
        ValueError: if a name is unknown or a value is invalid. The message lists the known names,
            or the valid values.
    """
    n = robot.coordinates
    each = "one number, or one per environment"
    checks: dict[str, Callable[[str, Any], Any]] = {
        "payload": lambda name, value: numbers(
            name, value, shapes=[(), (count,)], form=each, least=0, unit="kg"
        ),
        "payload_known": lambda name, value: _booleans(name, value, count),
        "model_payload_factor": lambda name, value: numbers(
            name, value, shapes=[(), (count,)], form=each, least=0
        ),
        "trajectory": lambda _, value: find_trajectory(value, robot.kind),
        "initial_error": lambda name, value: _initial_error(name, value, n, count),
        "uncertainty": lambda _, value: _uncertainties(value, robot, count),
        "error_bounds": lambda _, value: find_error_bounds(value, robot),
        "noise_seed": lambda name, value: _seeds(name, value, count),
    }
    given = mapping("options", {} if options is None else options, [*checks, *FOREIGN_OPTIONS])
    checked = {
        name: checks[name](name, value)
        for name, value in given.items()
        if name not in FOREIGN_OPTIONS
    }
    if "trajectory" in checked:
        bounds = checked.get("error_bounds") or find_error_bounds(None, robot)
        check_workspace(robot, checked["trajectory"], bounds)
    return checked


def _boolean(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, not {value!r}")
    return bool(value)


def _seeds(name: str, value: Any, count: int) -> list[int]:
    """Seeds of all environments; one integer is the seed of the first one and counts up, as in
    Gymnasium."""
    if not isinstance(value, (list, tuple, np.ndarray)):
        return [whole(name, value) + index for index in range(count)]
    if len(value) != count:
        raise ValueError(
            f"{name} must be one integer, or {count}, one per environment, not {len(value)}"
        )
    return [whole(name, seed) for seed in value]


def _booleans(name: str, value: Any, count: int) -> NDArray[np.bool_]:
    known = np.array(value)
    if known.dtype != np.bool_ or known.shape not in ((), (count,)):
        raise ValueError(
            f"{name} must be True or False, or one of these per environment, not {value!r}"
        )
    return known


def _initial_error(name: str, value: Any, n: int, count: int) -> Array | None:
    if value is None:
        return None
    if isinstance(value, Real) and value == 0:
        return np.zeros(n)
    return numbers(
        name,
        value,
        shapes=[(n,), (count, n)],
        form=f"None, 0 or {n} coordinates, or {n} per environment",
    )


def _uncertainties(value: Any, robot: Robot, count: int) -> tuple[Uncertainty, ...]:
    values = list(value) if isinstance(value, (list, tuple)) else [value]
    if len(values) not in (1, count):
        raise ValueError(
            f"uncertainty must be one, or a list of {count}, one per environment, not of {len(values)}"
        )
    return tuple(find_uncertainty(item, robot) for item in values)
