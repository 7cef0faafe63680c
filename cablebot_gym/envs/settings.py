"""Constructor keywords and reset options of the environments, with their checks."""

# Annotations are evaluated here, without "from __future__ import annotations": KEYWORDS reads them.

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Annotated, Any, NamedTuple, Self, get_args

import numpy as np
from gymnasium import logger
from gymnasium.spaces import Box
from numpy.typing import NDArray

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.own_motion import own_motion
from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import Measurement, find_measurement
from cablebot_gym.motions import Trajectory, find_trajectory
from cablebot_gym.physics.statics import hold_payload
from cablebot_gym.physics.textbook import fastest_decay_rate, highest_frequency
from cablebot_gym.robots import KIND_TEXTS, Cable, Robot, find_robot, has_paper_geometry
from cablebot_gym.task import (
    ErrorBounds,
    check_workspace,
    find_error_bounds,
    motion_questions,
)
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty
from cablebot_gym.utils.checks import (
    check_keywords,
    choice,
    mapping,
    number,
    numbers,
    whole,
)

LONGEST_PHYSICS_STEP = 1e-3
"""Largest default physics step [s]. With it, the error of RK4 on the paper's robots is below 1e-9 over
0.5 s. Longer steps would be accurate enough, but limits are checked once a step: with steps of 2 ms,
violations are found later."""

MODE_LOSS = {"planar": 1e-6, "spatial": 1e-5}
"""Largest fraction of its energy that RK4 may take from the fastest mode of a flexible robot per
second, with the default physics step: ``planar`` for planar point masses, ``spatial`` for all other
kinds. A step h takes φ⁶/72, with φ = ω h. A planar robot can oscillate in this mode alone. A spatial
robot without torque falls, and loses less than 1e-6 of its kinetic energy; held at rest, it can lose
the whole fraction."""

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


class Scope(NamedTuple):
    """The environments for which a value is checked."""

    robot: Robot
    """Nominal robot."""
    n_envs: int
    """Number of environments, N."""


Check = Callable[[str, Any, Scope], Any]
"""Function of a name, a value and its scope. It returns the value in canonical form, or raises a
ValueError that names it."""

_PER_ENVIRONMENT = "one number, or one per environment"


def _frequency(name: str, value: Any, scope: Scope) -> float:
    if value is None:
        return scope.robot.defaults.control_frequency
    return number(name, value, above=0)


def _or_none(check: Check) -> Check:
    """The check of a value that may be None, too."""

    def check_value(name: str, value: Any, scope: Scope) -> Any:
        if value is None:
            return None
        return check(name, value, scope)

    return check_value


def _payload(name: str, value: Any, scope: Scope) -> Array:
    shapes = [(), (scope.n_envs,)]
    return numbers(name, value, shapes=shapes, form=_PER_ENVIRONMENT, least=0, unit="kg")


def _payload_range(name: str, value: Any, scope: Scope) -> tuple[float, float]:
    shapes = [(2,)]
    ends = numbers(name, value, shapes=shapes, form="(low, high)", least=0, unit="kg")
    low, high = ends.tolist()
    return low, number(name, high, least=low, unit="kg")


def _factor(name: str, value: Any, scope: Scope) -> Array:
    return numbers(name, value, shapes=[(), (scope.n_envs,)], form=_PER_ENVIRONMENT, least=0)


def _boolean(name: str, value: Any, scope: Scope) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, not {value!r}")
    return bool(value)


def _booleans(name: str, value: Any, scope: Scope) -> NDArray[np.bool_]:
    booleans = np.array(value)
    if booleans.dtype != np.bool_ or booleans.shape not in ((), (scope.n_envs,)):
        raise ValueError(
            f"{name} must be True or False, or one of these per environment, not {value!r}"
        )
    return booleans


def _initial_error(name: str, value: Any, scope: Scope) -> Array:
    n = scope.robot.coordinates
    if isinstance(value, Real) and value == 0:
        return np.zeros(n)
    form = f"None, 0 or {n} coordinates, or {n} per environment"
    return numbers(name, value, shapes=[(n,), (scope.n_envs, n)], form=form)


def _initial_error_range(name: str, value: Any, scope: Scope) -> Array:
    return numbers(name, value, shapes=[(scope.robot.coordinates,)], least=0)


def _uncertainties(name: str, value: Any, scope: Scope) -> tuple[Uncertainty, ...]:
    values = [value]
    if isinstance(value, (list, tuple)):
        values = list(value)
    if len(values) not in (1, scope.n_envs):
        raise ValueError(
            f"{name} must be one, or a list of {scope.n_envs}, one per environment, not of {len(values)}"
        )
    return tuple(find_uncertainty(item, scope.robot) for item in values)


def _reward_weights(name: str, value: Any, scope: Scope) -> Array:
    """Finite weights in the order of the terms; a negative one makes a penalty of a reward."""
    weights = DEFAULT_WEIGHTS | mapping(name, value or {}, REWARD_TERMS)
    return np.array([number(f"reward weight {term!r}", weights[term]) for term in REWARD_TERMS])


def _noise_seeds(name: str, value: Any, scope: Scope) -> list[int]:
    """Seeds of all environments; one integer is the seed of the first one and counts up, as in
    Gymnasium."""
    if not isinstance(value, (list, tuple, np.ndarray)):
        first_seed = whole(name, value)
        return list(range(first_seed, first_seed + scope.n_envs))
    if len(value) != scope.n_envs:
        raise ValueError(
            f"{name} must be one integer, or {scope.n_envs}, one per environment, not {len(value)}"
        )
    return [whole(name, seed) for seed in value]


class Keyword(NamedTuple):
    """A constructor keyword of the environments."""

    check: Check
    meaning: str
    """Meaning and unit in one line of Markdown."""
    default_text: str = ""
    """The default in the manual; empty if the value says it."""
    reset_option: bool = False
    """Whether it is a reset option, too, which applies to one episode."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of N environments: the checked values of their constructor keywords, or, with the
    reset options of an episode, those of this episode.

    Each field is a keyword, and this is the only place that defines it: type, default, check,
    meaning and whether it is a reset option. A field without a default gets one from its check or
    from :func:`make_settings`. A value that is given once per environment has a leading axis N.
    """

    robot: Annotated[
        Robot,
        Keyword(
            lambda name, value, scope: scope.robot,
            "a name, a `.toml` file, `Robot.to_dict()` data or a `Robot`",
            "by id",
        ),
    ]
    payload: Annotated[
        float | Array,
        Keyword(
            _payload,
            "nominal payload [kg]; the true payload is equal to it, unless it is uncertain",
            reset_option=True,
        ),
    ] = 0.0
    payload_range: Annotated[
        tuple[float, float] | None,
        Keyword(
            _or_none(_payload_range),
            "(low, high) of a uniform nominal payload, drawn in each episode, in place of `payload`",
        ),
    ] = None
    payload_known: Annotated[
        bool | Array,
        Keyword(_booleans, "whether the payload is known to the controller", reset_option=True),
    ] = True
    model_payload_factor: Annotated[
        float | Array,
        Keyword(
            _factor,
            "ratio of the model payload to the nominal payload; no effect if payload unknown",
            reset_option=True,
        ),
    ] = 1.0
    trajectory: Annotated[
        Trajectory,
        Keyword(
            lambda name, value, scope: find_trajectory(value, scope.robot.kind),
            'reference motion: a name, `{"name": …, …}` or a `Trajectory`',
            "that of the robot",
            reset_option=True,
        ),
    ]
    initial_error: Annotated[
        Array | None,
        Keyword(
            _or_none(_initial_error),
            'start pose minus reference pose, n values; None for the start pose under "Start"',
            reset_option=True,
        ),
    ] = None
    initial_error_range: Annotated[
        Array | None,
        Keyword(
            _or_none(_initial_error_range),
            "n half widths of a uniform error, drawn in each episode, added to the start pose",
        ),
    ] = None
    uncertainty: Annotated[
        tuple[Uncertainty, ...],
        Keyword(
            _uncertainties,
            "difference between the true and the nominal robot, see below",
            "None",
            reset_option=True,
        ),
    ]
    error_bounds: Annotated[
        ErrorBounds,
        Keyword(
            lambda name, value, scope: find_error_bounds(value, scope.robot),
            '`{"position": …, "rotation": …}`, bounds of the tracking errors',
            "those of the robot",
            reset_option=True,
        ),
    ]
    measurement: Annotated[
        Measurement,
        Keyword(
            lambda name, value, scope: find_measurement(value, scope.robot),
            'sensors: "pose", "winches", "winches+tensions+imu", or data, see "Observation space"',
            '"pose"',
        ),
    ]
    cable: Annotated[
        Cable,
        Keyword(
            lambda name, value, scope: choice(name, value, get_args(Cable)),
            'cables only pull; "bilateral": cables can also push',
        ),
    ] = "unilateral"
    control_frequency: Annotated[
        float,
        Keyword(_frequency, "actions per second [Hz]; None for that of the robot"),
    ] = None  # type: ignore[assignment]  # the check replaces None
    substeps: Annotated[
        int,
        Keyword(
            _or_none(lambda name, value, scope: whole(name, value, least=1)),
            "physics steps per control period",
            "steps ≤ 1 ms, shorter for stiff springs",
        ),
    ]
    terminate_on_violation: Annotated[
        bool,
        Keyword(_boolean, "whether the first violation of a limit terminates the episode"),
    ] = False
    reward_weights: Annotated[
        Array, Keyword(_reward_weights, "weights by reward term", 'see "Reward"')
    ]
    normalised_observation: Annotated[
        bool,
        Keyword(_boolean, 'whether the observation is normalised, see "Observation space"'),
    ] = False
    observation_dtype: Annotated[
        str,
        Keyword(
            lambda name, value, scope: choice(
                name, getattr(value, "__name__", value), OBSERVATION_DTYPES
            ),
            'number type of the observation and its space; "float32" for learning',
        ),
    ] = "float64"

    def observation_space(self) -> Box:
        """Observation space of one environment."""
        layout = observation_layout(self.robot, self.measurement)
        return layout.space(normalised=self.normalised_observation, dtype=self.observation_dtype)

    def with_options(self, options: Mapping[str, Any]) -> Self:
        """Settings of an episode with reset options, checked by :func:`check_options`."""
        changes = {name: value for name, value in options.items() if name in KEYWORDS}
        if not changes:  # most resets; a copy would make them slower
            return self
        # A value that is given for the episode replaces the random draw.
        if "payload" in changes:
            changes["payload_range"] = None
        if "initial_error" in changes:
            changes["initial_error_range"] = None
        if "uncertainty" in changes:
            check_stability(
                self.robot, changes["uncertainty"], self.control_frequency, self.substeps
            )
        return replace(self, **changes)

    def note_unheld_start(self) -> None:
        """Warns if the motors cannot hold even the least payload at the start of a motion from
        rest."""
        payload = float(np.min(self.payload))
        if self.payload_range is not None:
            payload = self.payload_range[0]
        held = hold_payload(self.robot, self.trajectory, self.error_bounds)
        if payload > held:
            logger.warn(
                f"robot {self.robot.name!r} with {payload:g} kg cannot be held at the start of "
                f"{self.trajectory.name!r}: its motors are too weak. All episodes fail; `cablebot robot check` shows "
                "what the robot holds"
            )

    @property
    def period(self) -> float:
        """Length of a control period [s]."""
        return 1 / self.control_frequency

    @property
    def physics_step(self) -> float:
        """Length of a physics step [s]."""
        return self.period / self.substeps


KEYWORDS: Mapping[str, Keyword] = {
    name: hint.__metadata__[0] for name, hint in Settings.__annotations__.items()
}
"""Constructor keywords of the environments by name."""

RESET_OPTIONS: Mapping[str, Check] = {
    name: keyword.check for name, keyword in KEYWORDS.items() if keyword.reset_option
} | {"noise_seed": _noise_seeds}
"""Check of each reset option."""

FOREIGN_OPTIONS = ("reset_mask", "minari_autoseed")
"""Reset options of Gymnasium's vector API and of Minari, which the checks here ignore."""

_DEFAULTS = {name: getattr(Settings, name, None) for name in KEYWORDS}
"""Default of each keyword; None for those that get one from their check or from
:func:`make_settings`."""


def keyword_table() -> str:
    """Markdown table of the keywords, for the manual."""
    lines = ["| name | default | meaning |", "|---|---|---|"]
    for name, keyword in KEYWORDS.items():
        mark = "*" if keyword.reset_option else ""
        default = keyword.default_text
        if not default:
            default = repr(_DEFAULTS[name]).removesuffix(".0").replace("'", '"')
        lines.append(f"| `{name}`{mark} | {default} | {keyword.meaning} |")
    return "\n".join(lines)


def default_trajectory(robot: Robot) -> str | Mapping[str, Any]:
    """Default reference motion of a robot: that of its data, the circle of a robot with the paper's
    geometry, or :func:`~cablebot_gym.envs.own_motion.own_motion`."""
    if robot.defaults.trajectory is not None:
        return robot.defaults.trajectory
    if has_paper_geometry(robot):
        return f"circle-{robot.kind}"
    return own_motion(robot)


def make_settings(*, robot: str | dict[str, Any] | Robot, count: int, **keywords: Any) -> Settings:
    """Checked settings of ``count`` environments.

    Args:
        robot: nominal robot.
        count: number of environments, N.
        keywords: objects or JSON-able data by the names of :data:`KEYWORDS`. None is valid for
            ``payload`` (no payload), ``payload_range`` and ``initial_error_range`` (no random part),
            ``trajectory`` (:func:`default_trajectory`), ``initial_error``
            (:func:`cablebot_gym.task.start_pose`), ``uncertainty`` (none), ``measurement`` (pose and
            velocity), ``error_bounds`` (those of the robot), ``reward_weights``
            (:data:`DEFAULT_WEIGHTS`) and ``substeps`` (:func:`fewest_substeps`).

    Raises:
        TypeError: if a keyword is unknown.
        ValueError: if a value is invalid; the message names the keyword.
    """
    check_keywords(keywords, KEYWORDS, make_settings)
    robot = find_robot(robot)
    check_simulated(robot)
    values = _DEFAULTS | keywords
    if keywords.get("payload") is None:
        values["payload"] = Settings.payload
    elif values["payload_range"] is not None:
        raise ValueError(
            "payload and payload_range exclude each other: payload_range draws a payload per episode"
        )
    if values["trajectory"] is None:
        values["trajectory"] = default_trajectory(robot)
    scope = Scope(robot, count)
    checked = {name: KEYWORDS[name].check(name, value, scope) for name, value in values.items()}
    _check_motion(robot, checked["trajectory"], checked["error_bounds"])
    if checked["cable"] == "bilateral" and np.any(robot.load_friction):
        raise ValueError(
            "cable='bilateral': load_friction is for cables that only pull. Omit cable, or set load_friction to 0"
        )
    uncertainties = checked["uncertainty"]
    frequency = checked["control_frequency"]
    if checked["substeps"] is None:
        checked["substeps"] = fewest_substeps(robot, uncertainties, frequency)
    check_stability(robot, uncertainties, frequency, checked["substeps"])
    return Settings(**checked)


def check_simulated(robot: Robot) -> None:
    """Checks that the simulation knows the kind of a robot.

    Raises:
        ValueError: if the platform hangs on fewer cables than coordinates, or a swivel axis is not
            vertical.
    """
    if robot.hanging:
        raise ValueError(
            f"{robot.name}: {KIND_TEXTS[robot.kind]} needs at least {robot.coordinates} cables, not {robot.cables}. "
            "With fewer it swings, and no motors can move it along a reference: add cables"
        )
    if robot.swivel_axes:
        raise ValueError("swivel_axes: the simulation knows vertical axes only. Remove swivel_axes")


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
    if options is None:
        return {}
    scope = Scope(robot, count)
    checked = {}
    for name, value in mapping("options", options, [*RESET_OPTIONS, *FOREIGN_OPTIONS]).items():
        if name not in FOREIGN_OPTIONS:
            checked[name] = RESET_OPTIONS[name](name, value, scope)
    if "trajectory" in checked:
        bounds = checked.get("error_bounds") or find_error_bounds(None, robot)
        _check_motion(robot, checked["trajectory"], bounds)
    return checked


def _check_motion(robot: Robot, motion: Trajectory, bounds: ErrorBounds) -> None:
    """Refuses a motion out of the workspace, and warns of one that may be meant otherwise."""
    check_workspace(robot, motion, bounds)
    for question in motion_questions(robot, motion):
        logger.warn(question)


def fewest_substeps(
    robot: Robot,
    uncertainties: tuple[Uncertainty, ...] = (Uncertainty(),),
    control_frequency: float | None = None,
) -> int:
    """Default number of physics steps per control period: the fewest that satisfy
    :data:`LONGEST_PHYSICS_STEP`, :data:`MODE_LOSS` and :data:`STABLE_PHASE`. The control frequency is
    that of the robot if it is None.

    Raises:
        ValueError: if there would be more than :data:`MOST_SUBSTEPS`.
    """
    fastest = max(_fastest_rate(robot, uncertainty) for uncertainty in uncertainties)
    longest = min(LONGEST_PHYSICS_STEP, STABLE_PHASE / fastest)
    if robot.flexible:
        loss = MODE_LOSS["spatial"]
        if robot.kind == "planar":
            loss = MODE_LOSS["planar"]
        rate = highest_frequency(robot)  # [rad/s]
        phase = (72 * loss / rate) ** 0.2  # φ⁶/72 in each of ω/φ steps per second
        longest = min(longest, phase / rate)
    frequency = control_frequency or robot.defaults.control_frequency
    needed = 1 / (frequency * longest)
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
