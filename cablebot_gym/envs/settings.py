"""Constructor keywords and reset options of the environments, with their checks."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, get_args

import numpy as np

from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import fastest_motor_rate, highest_frequency
from cablebot_gym.robots import Cable, Robot, find_robot
from cablebot_gym.task import ErrorBounds, find_error_bounds
from cablebot_gym.trajectories import Trajectory, find_trajectory
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty
from cablebot_gym.utils.checks import unknown_name_error

LONGEST_PHYSICS_STEP = 1e-3
"""Largest default physics step [s]. On the paper's robots, RK4's error over 0.5 s is below 1e-9 at this step. Accuracy
allows longer steps, but checks of slack and errors every 2 ms raise the DLCC by about 0.05 kg."""

MODE_LOSS = {"planar": 1e-6, "spatial": 1e-5}
"""Bound of the fraction of its energy that a flexible robot's fastest mode loses per second to RK4 with the default
physics step. RK4 dissipates φ⁶/72 per step h, with φ = ω h. A planar robot can oscillate in this mode alone. A spatial
robot without torque falls, and loses less than 1e-6 of its kinetic energy. A robot that is held at rest can lose the
whole fraction."""

MOST_SUBSTEPS = 1000
"""Largest default number of physics steps per control period. A need for more indicates an error in the stiffness."""

STABLE_PHASE = 2.6
"""Largest product of the physics step and the fastest rate of a flexible robot at its home pose. RK4 is stable up to
2√2 for an undamped oscillation and up to 2.78 for a decay. Elsewhere in the workspace the springs oscillate up to 6 %
faster."""

DEFAULT_WEIGHTS = {"position": 1.0, "rotation": 1.0, "saturation": 0.1, "slack": 0.1, "failure": 1.0}
"""Default weights of the reward terms."""

FOREIGN_OPTIONS = ("reset_mask", "minari_autoseed")
"""Reset options of Gymnasium's vector API and of Minari, which the checks here ignore."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Checked constructor keywords of an environment; made by :func:`make_settings`."""

    robot: Robot
    """Nominal robot. The true robot is equal to it, except for ``uncertainty``."""
    payload: float | Array
    """Nominal payload [kg], scalar or (N,); ≥ 0. The true payload is equal to it, except for ``uncertainty``."""
    payload_range: tuple[float, float] | None
    """(low, high) of a uniform nominal payload, drawn in each episode [kg]; replaces ``payload``. None for no draw."""
    payload_known: bool | Array
    """Whether the payload is known to the controller, scalar or (N,)."""
    model_payload_factor: float | Array
    """Ratio of the payload of the controller's model to the nominal payload, scalar or (N,); ≥ 0.

    No effect if the payload is unknown.
    """
    trajectory: Trajectory
    """Default reference motion."""
    initial_error: Array
    """Start pose minus reference pose, (n,) or (N, n) [m, rad]."""
    initial_error_range: Array | None
    """Half widths of a uniform start error, (n,) [m, rad], drawn in each episode and added to ``initial_error``."""
    uncertainty: tuple[Uncertainty, ...]
    """Uncertainty of the plant, as a tuple of one for all environments, or of N."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors, which scale the reward."""
    cable: Cable
    """``unilateral``: cables only pull; ``bilateral``: cables also push, as in the paper's equations."""
    control_frequency: float
    """Actions per second [Hz]."""
    substeps: int
    """Physics steps per control period."""
    termination_radius: float
    """Position error beyond which an episode terminates [m]."""
    slack_time: float
    """Longest time for which a cable may be slack before the episode terminates [s]."""
    weights: Array
    """Weights of the reward terms, in the order of ``REWARD_TERMS``."""

    @property
    def period(self) -> float:
        """Length of a control period [s]."""
        return 1 / self.control_frequency

    @property
    def physics_step(self) -> float:
        """Length of a physics step [s]."""
        return self.period / self.substeps


def check_keywords(keywords: Mapping[str, Any]) -> None:
    """Checks that all keywords exist.

    Raises:
        ValueError: if a keyword is unknown; the message lists the known keywords.
    """
    known = [name for name in inspect.signature(make_settings).parameters if name not in ("robot", "count")]
    if unknown := [name for name in keywords if name not in known]:
        raise ValueError(
            f"unknown keyword {unknown[0]!r}; the keywords of an environment are robot, {', '.join(known)}"
        )


def default_trajectory(robot: Robot) -> str:
    """Name of the default reference motion of a robot: the paper's circle."""
    return "paper-planar" if robot.planar else "paper-spatial"


def make_settings(
    *,
    robot: str | dict[str, Any] | Robot,
    count: int,
    payload: Any = 0.0,
    payload_range: Any = None,
    payload_known: Any = True,
    model_payload_factor: Any = 1.0,
    trajectory: Any = None,
    initial_error: Any = 0.0,
    initial_error_range: Any = None,
    uncertainty: Any = None,
    error_bounds: Any = None,
    cable: str = "unilateral",
    control_frequency: float = 500.0,
    substeps: int | None = None,
    termination_radius: float = 0.1,
    slack_time: float = 0.1,
    reward_weights: Mapping[str, float] | None = None,
) -> Settings:
    """Checked settings of ``count`` environments from their keywords, which :class:`Settings` describes.

    Values are objects or JSON-able data. None stands for the default: the motion of :func:`default_trajectory`, no
    uncertainty, the default error bounds, :data:`DEFAULT_WEIGHTS`, and the fewest ``substeps`` that satisfy
    :data:`LONGEST_PHYSICS_STEP`, :data:`MODE_LOSS` and :data:`STABLE_PHASE`. ``uncertainty`` can be a list with one
    item per environment.

    Raises:
        ValueError: if a value is invalid; the message names the keyword.
    """
    robot = find_robot(robot)
    trajectory = default_trajectory(robot) if trajectory is None else trajectory
    episode = check_options(
        {
            "payload": payload,
            "payload_known": payload_known,
            "model_payload_factor": model_payload_factor,
            "trajectory": trajectory,
            "initial_error": initial_error,
            "uncertainty": uncertainty,
            "error_bounds": error_bounds,
        },
        robot,
        count,
    )
    modes: tuple[Cable, ...] = get_args(Cable)
    if cable not in modes:
        raise unknown_name_error("cable", cable, modes)
    frequency = _positive("control_frequency", control_frequency)
    if substeps is None:
        longest = LONGEST_PHYSICS_STEP
        if robot.flexible:
            fastest = max(_fastest_rate(robot, uncertainty) for uncertainty in episode["uncertainty"])
            longest = min(longest, _lossless_step(robot), STABLE_PHASE / fastest)
        needed = 1 / (frequency * longest)
        if needed > MOST_SUBSTEPS:
            raise ValueError(
                f"robot {robot.name!r} oscillates or settles at up to {fastest / (2 * math.pi):.3g} Hz and needs "
                f"{needed:.3g} physics steps in a control period: make its springs softer or its inertias larger, or "
                "set substeps"
                if robot.flexible
                else f"control_frequency {frequency:g} Hz needs {needed:.3g} physics steps in a period: raise it"
            )
        substeps = max(1, math.ceil(needed - 1e-9))
    if not isinstance(substeps, (int, np.integer)) or isinstance(substeps, bool) or substeps < 1:
        raise ValueError(f"substeps must be a whole number of at least 1, not {substeps!r}")
    check_stability(robot, episode["uncertainty"], frequency, int(substeps))
    return Settings(
        robot=robot,
        payload_range=_range("payload_range", payload_range),
        initial_error_range=_half_widths(initial_error_range, robot.coordinates),
        cable=modes[modes.index(cable)],
        control_frequency=frequency,
        substeps=int(substeps),
        termination_radius=_positive("termination_radius", termination_radius),
        slack_time=_positive("slack_time", slack_time, zero=True),
        weights=_weights(reward_weights),
        **episode,
    )


def _lossless_step(robot: Robot) -> float:
    """Physics step at which the energy loss of the fastest mode is :data:`MODE_LOSS` [s]."""
    frequency = highest_frequency(robot)
    phase: float = (72 * MODE_LOSS["planar" if robot.planar else "spatial"] / frequency) ** 0.2
    return phase / frequency


def _fastest_rate(robot: Robot, uncertainty: Uncertainty) -> float:
    """Largest rate at which a flexible robot can oscillate or settle under an uncertainty [rad/s]."""
    true = uncertainty.fastest(robot)
    return max(highest_frequency(true), fastest_motor_rate(true))


def check_stability(
    robot: Robot, uncertainties: tuple[Uncertainty, ...], control_frequency: float, substeps: int
) -> None:
    """Checks that the physics step is short enough for the joint springs at the limits of the uncertainties.

    Raises:
        ValueError: if it is too long; the message gives the frequency and the number of substeps that is sufficient.
    """
    if not robot.flexible:
        return
    fastest = max(_fastest_rate(robot, uncertainty) for uncertainty in uncertainties)
    if fastest / (control_frequency * substeps) > STABLE_PHASE:
        needed = math.ceil(fastest / (control_frequency * STABLE_PHASE))
        raise ValueError(
            f"substeps={substeps} is too small for robot {robot.name!r}, whose motors oscillate or settle at "
            f"{fastest / (2 * math.pi):.3g} Hz: use at least {needed}, or omit substeps when you make the environment"
        )


def check_options(options: Mapping[str, Any] | None, robot: Robot, count: int) -> dict[str, Any]:
    """Reset options, checked and in canonical form, without :data:`FOREIGN_OPTIONS`.

    Args:
        options: values by name; None for none.
        robot: the nominal robot.
        count: number of environments, N.

    Raises:
        ValueError: if a name is unknown or a value is invalid. The message lists the known names, or the valid values.
    """
    checks: dict[str, Callable[[Any], Any]] = {
        "payload": lambda value: _one_or_each("payload", " kg", value, count),
        "payload_known": lambda value: _known(value, count),
        "model_payload_factor": lambda value: _one_or_each("model_payload_factor", "", value, count),
        "trajectory": lambda value: find_trajectory(value, robot.coordinates),
        "initial_error": lambda value: _initial_error(value, robot.coordinates, count),
        "uncertainty": lambda value: _uncertainties(value, robot, count),
        "error_bounds": find_error_bounds,
    }
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"options must be a dict with the keys {', '.join(checks)}, not {options!r}")
    options = {key: value for key, value in (options or {}).items() if key not in FOREIGN_OPTIONS}
    if unknown := [key for key in options if key not in checks]:
        raise ValueError(f"unknown option {unknown[0]!r}; the options are {', '.join(checks)}")
    return {key: checks[key](value) for key, value in options.items()}


def _one_or_each(name: str, unit: str, value: Any, count: int) -> Array:
    """A value ≥ 0, scalar or one per environment (N,)."""
    numbers = _numbers(name, value)
    if numbers.shape not in ((), (count,)):
        several = f" or {count} numbers, one for each environment" if count > 1 else ""
        raise ValueError(f"{name} must be one number{several}, not an array of shape {numbers.shape}")
    if not np.all(np.isfinite(numbers)) or np.any(numbers < 0):
        raise ValueError(f"{name} must be finite and at least 0{unit}, not {value!r}")
    return numbers


def _known(value: Any, count: int) -> Array:
    known = np.array(value)
    if known.dtype != np.bool_ or known.shape not in ((), (count,)):
        several = f", or {count} of these, one for each environment," if count > 1 else ""
        raise ValueError(f"payload_known must be True or False{several}, not {value!r}")
    return known


def _initial_error(value: Any, n: int, count: int) -> Array:
    error = _numbers("initial_error", value)
    if error.shape not in ((n,), (count, n)) and not (error.shape == () and error == 0):
        several = f", or {count} rows of {n}, one for each environment" if count > 1 else ""
        raise ValueError(f"initial_error must be 0 or {n} coordinates{several}; its shape is {error.shape}")
    if not np.all(np.isfinite(error)):
        raise ValueError(f"initial_error must be finite, not {value!r}")
    return np.zeros(n) if error.shape == () else error


def _uncertainties(value: Any, robot: Robot, count: int) -> tuple[Uncertainty, ...]:
    values = list(value) if isinstance(value, (list, tuple)) else [value]
    if len(values) not in (1, count):
        raise ValueError(
            f"uncertainty must be one, or a list of {count}, one for each environment, not of {len(values)}"
        )
    return tuple(find_uncertainty(item, robot) for item in values)


def _half_widths(value: Any, n: int) -> Array | None:
    if value is None:
        return None
    widths = _numbers("initial_error_range", value)
    if widths.shape != (n,) or not np.all(np.isfinite(widths)) or np.any(widths < 0):
        raise ValueError(f"initial_error_range must be {n} finite half widths of at least 0, not {value!r}")
    return widths


def _range(name: str, value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    ends = _numbers(name, value)
    if ends.shape != (2,) or not np.all(np.isfinite(ends)) or not 0 <= ends[0] <= ends[1]:
        raise ValueError(f"{name} must be (low, high) with 0 ≤ low ≤ high, not {value!r}")
    return float(ends[0]), float(ends[1])


def _weights(value: Mapping[str, float] | None) -> Array:
    if value is not None and not isinstance(value, Mapping):
        raise ValueError(f"reward_weights must be a dict with the keys {', '.join(REWARD_TERMS)}, not {value!r}")
    weights = dict(value or {})
    if unknown := [name for name in weights if name not in REWARD_TERMS]:
        raise ValueError(f"unknown reward term {unknown[0]!r}; the terms are {', '.join(REWARD_TERMS)}")
    merged = [_numbers("reward_weights", (DEFAULT_WEIGHTS | weights)[name]) for name in REWARD_TERMS]
    if any(weight.shape != () or not np.isfinite(weight) for weight in merged):
        raise ValueError(f"each of the reward_weights must be one finite number, not {value!r}")
    return np.array(merged)


def _positive(name: str, value: Any, *, zero: bool = False) -> float:
    finite = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    if not finite or value < 0 or (value == 0 and not zero):
        raise ValueError(f"{name} must be a finite number {'of at least' if zero else 'greater than'} 0, not {value!r}")
    return float(value)


def _numbers(name: str, value: Any) -> Array:
    try:
        numbers = np.array(value)
        if numbers.dtype.kind in "iuf":
            return numbers.astype(float)
    except (TypeError, ValueError):
        pass
    raise ValueError(f"{name} must be numbers, not {value!r}")
