"""What an environment is made with, and what may differ from episode to episode: checked once, in words."""

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
from cablebot_gym.task import Limits, find_limits
from cablebot_gym.trajectories import Trajectory, find_trajectory
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty
from cablebot_gym.utils.suggestions import no_such

LONGEST_PHYSICS_STEP = 1e-3
"""Default bound of the physics step [s]. RK4's error over 0.5 s is below 1e-9 there on the paper's robots; the bound is
not accuracy but judgement: slack and errors seen every 2 ms flatter a payload by about 0.05 kg."""

MODE_LOSS = {"planar": 1e-6, "spatial": 1e-5}
"""Default bound of the share of its energy that RK4 takes from a flexible robot's fastest mode in a second. It takes
φ⁶/72 in a step h, with φ = ω h. A planar robot may swing in that mode alone; a spatial one that nobody drives falls,
and loses less than 1e-6 of the kinetic energy that it gets. A robot that is held may lose the whole share."""

MOST_SUBSTEPS = 1000
"""Largest number of physics steps that is chosen without being asked for: beyond it springs are stiff by mistake."""

STABLE_PHASE = 2.6
"""Largest rate of a flexible robot at home times the physics step: RK4 is stable to 2√2 on an undamped oscillation and
to 2.78 on a decay, and elsewhere in the workspace the springs swing up to 6 % faster."""

DEFAULT_WEIGHTS = {"position": 1.0, "rotation": 1.0, "saturation": 0.1, "slack": 0.1, "failure": 1.0}
"""Weights of the reward's terms."""

FOREIGN_OPTIONS = ("reset_mask", "minari_autoseed")
"""Reset options that belong to Gymnasium's vector API and to Minari."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The constructor keywords of every environment, checked. Plain JSON-able values make a JSON-able spec.

    Raises:
        ValueError: if a value is not valid; the message names the keyword.
    """

    robot: Robot
    """Nominal robot; the true one too, but for ``uncertainty``."""
    payload: float | Array
    """Default payload [kg], one or (N,); ≥ 0. The true one too, but for ``uncertainty``."""
    payload_range: tuple[float, float] | None
    """Uniform payload, drawn anew each episode [kg]; overrides ``payload``."""
    payload_known: bool | Array
    """Whether the observation tells the payload, one or (N,)."""
    trajectory: Trajectory
    """Default reference motion."""
    initial_error: Array
    """Start pose less reference pose, (n,) or (N, n) [m, rad]."""
    initial_error_range: Array | None
    """Half widths of a uniform start error, (n,) [m, rad]; added to ``initial_error``."""
    uncertainty: tuple[Uncertainty, ...]
    """What the controller does not know, one for all or N."""
    limits: Limits
    """Bounds that scale the reward."""
    cable: Cable
    """``unilateral``: cables only pull; ``bilateral``: the paper's equations as they stand."""
    control_frequency: float
    """Drive commands per second [Hz]."""
    substeps: int
    """Physics steps per control period."""
    termination_radius: float
    """Position error that ends an episode [m]."""
    slack_time: float
    """How long a cable may be slack before the episode ends [s]."""
    weights: Array
    """Weights of the reward's terms, in the order of ``REWARD_TERMS``."""

    @property
    def period(self) -> float:
        """Length of a control period [s]."""
        return 1 / self.control_frequency

    @property
    def physics_step(self) -> float:
        """Length of a physics step [s]."""
        return self.period / self.substeps


def check_keywords(keywords: Mapping[str, Any]) -> None:
    """Refuses keywords that no environment has.

    Raises:
        ValueError: naming the known ones.
    """
    known = [name for name in inspect.signature(make_settings).parameters if name not in ("robot", "count")]
    if unknown := [name for name in keywords if name not in known]:
        raise ValueError(f"unknown keyword {unknown[0]!r}; an environment takes robot, {', '.join(known)}")


def default_trajectory(robot: Robot) -> str:
    """Name of the motion of a robot's environment: the paper's circle."""
    return "paper-planar" if robot.planar else "paper-spatial"


def make_settings(
    *,
    robot: str | dict[str, Any] | Robot,
    count: int,
    payload: Any = 0.0,
    payload_range: Any = None,
    payload_known: Any = True,
    trajectory: Any = None,
    initial_error: Any = 0.0,
    initial_error_range: Any = None,
    uncertainty: Any = None,
    limits: Any = None,
    cable: str = "unilateral",
    control_frequency: float = 500.0,
    substeps: int | None = None,
    termination_radius: float = 0.1,
    slack_time: float = 0.1,
    reward_weights: Mapping[str, float] | None = None,
) -> Settings:
    """Settings from an environment's keywords; arguments as for :class:`Settings`, checked by :func:`check_options`."""
    robot = find_robot(robot)
    trajectory = default_trajectory(robot) if trajectory is None else trajectory
    episode = check_options(
        {
            "payload": payload,
            "payload_known": payload_known,
            "trajectory": trajectory,
            "initial_error": initial_error,
            "uncertainty": uncertainty,
            "limits": limits,
        },
        robot,
        count,
    )
    modes: tuple[Cable, ...] = get_args(Cable)
    if cable not in modes:
        raise ValueError(no_such("cable", cable, modes))
    frequency = _positive("control_frequency", control_frequency)
    if substeps is None:
        longest = LONGEST_PHYSICS_STEP
        if robot.flexible:
            fastest = max(_fastest(robot, one) for one in episode["uncertainty"])
            longest = min(longest, _lossless_step(robot), STABLE_PHASE / fastest)
        wanted = 1 / (frequency * longest)
        if wanted > MOST_SUBSTEPS:
            raise ValueError(
                f"{robot.name!r} swings or settles at up to {fastest / (2 * math.pi):.3g} Hz, which takes {wanted:.3g} "
                f"physics steps in a control period: soften its springs, raise its inertias, or give substeps"
                if robot.flexible
                else f"control_frequency {frequency:g} Hz takes {wanted:.3g} physics steps in a period: raise it"
            )
        substeps = max(1, math.ceil(wanted - 1e-9))
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
    """Physics step at which RK4 takes :data:`MODE_LOSS` from the fastest mode [s]."""
    swing = highest_frequency(robot)
    phase: float = (72 * MODE_LOSS["planar" if robot.planar else "spatial"] / swing) ** 0.2
    return phase / swing


def _fastest(robot: Robot, uncertainty: Uncertainty) -> float:
    """Largest rate at which a motor of a flexible robot may swing or settle [rad/s]."""
    true = uncertainty.fastest(robot)
    return max(highest_frequency(true), fastest_motor_rate(true))


def check_stability(
    robot: Robot, uncertainties: tuple[Uncertainty, ...], control_frequency: float, substeps: int
) -> None:
    """Refuses physics steps that are too long for the joint springs, as stiff as the uncertainties may make them.

    Raises:
        ValueError: with the frequency and the number of substeps that would do.
    """
    if not robot.flexible:
        return
    fastest = max(_fastest(robot, uncertainty) for uncertainty in uncertainties)
    if fastest / (control_frequency * substeps) > STABLE_PHASE:
        needed = math.ceil(fastest / (control_frequency * STABLE_PHASE))
        raise ValueError(
            f"substeps={substeps} cannot integrate {robot.name!r}, whose motors swing or settle at "
            f"{fastest / (2 * math.pi):.3g} Hz: use at least {needed}, or leave substeps out where it is made"
        )


def check_options(options: Mapping[str, Any] | None, robot: Robot, count: int) -> dict[str, Any]:
    """Episode options, checked and in their canonical form; options that belong to others are left out.

    Raises:
        ValueError: if a key is unknown, naming the known ones, or a value is not valid.
    """
    checks: dict[str, Callable[[Any], Any]] = {
        "payload": lambda value: _payload(value, count),
        "payload_known": lambda value: _known(value, count),
        "trajectory": lambda value: find_trajectory(value, robot.coordinates),
        "initial_error": lambda value: _initial_error(value, robot.coordinates, count),
        "uncertainty": lambda value: _uncertainties(value, robot, count),
        "limits": find_limits,
    }
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"options must be a dict with keys out of {', '.join(checks)}, not {options!r}")
    options = {key: value for key, value in (options or {}).items() if key not in FOREIGN_OPTIONS}
    if unknown := [key for key in options if key not in checks]:
        raise ValueError(f"unknown option {unknown[0]!r}; the options are {', '.join(checks)}")
    return {key: checks[key](value) for key, value in options.items()}


def _payload(value: Any, count: int) -> Array:
    payload = _numbers("payload", value)
    if payload.shape not in ((), (count,)):
        raise ValueError(f"payload must be one number of kg or {count}, one for each environment, not {payload.shape}")
    if not np.all(np.isfinite(payload)) or np.any(payload < 0):
        raise ValueError(f"payload must be at least 0 kg and finite, not {value!r}")
    return payload


def _known(value: Any, count: int) -> Array:
    known = np.array(value)
    if known.dtype != np.bool_ or known.shape not in ((), (count,)):
        several = f", or {count} of them" if count > 1 else ""
        raise ValueError(f"payload_known must be True or False{several}, not {value!r}")
    return known


def _initial_error(value: Any, n: int, count: int) -> Array:
    error = _numbers("initial_error", value)
    if error.shape not in ((n,), (count, n)) and not (error.shape == () and error == 0):
        several = f", or {count} rows of {n}" if count > 1 else ""
        raise ValueError(f"initial_error must hold {n} coordinates{several}, not shape {error.shape}")
    if not np.all(np.isfinite(error)):
        raise ValueError("initial_error must be finite")
    return np.zeros(n) if error.shape == () else error


def _uncertainties(value: Any, robot: Robot, count: int) -> tuple[Uncertainty, ...]:
    values = list(value) if isinstance(value, (list, tuple)) else [value]
    if len(values) not in (1, count):
        raise ValueError(f"uncertainty must be one, or {count}, one for each environment, not {len(values)}")
    return tuple(find_uncertainty(one, robot) for one in values)


def _half_widths(value: Any, n: int) -> Array | None:
    if value is None:
        return None
    widths = _numbers("initial_error_range", value)
    if widths.shape != (n,) or not np.all(np.isfinite(widths)) or np.any(widths < 0):
        raise ValueError(f"initial_error_range must hold {n} half widths of at least 0, not {value!r}")
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
        raise ValueError(f"reward_weights must be a dict with keys out of {', '.join(REWARD_TERMS)}, not {value!r}")
    weights = dict(value or {})
    if unknown := [name for name in weights if name not in REWARD_TERMS]:
        raise ValueError(f"unknown reward term {unknown[0]!r}; the terms are {', '.join(REWARD_TERMS)}")
    merged = [_numbers("reward_weights", (DEFAULT_WEIGHTS | weights)[name]) for name in REWARD_TERMS]
    if any(weight.shape != () or not np.isfinite(weight) for weight in merged):
        raise ValueError(f"reward_weights must be one finite number for each term, not {value!r}")
    return np.array(merged)


def _positive(name: str, value: Any, *, zero: bool = False) -> float:
    good = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    if not good or value < 0 or (value == 0 and not zero):
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
