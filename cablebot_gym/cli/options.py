"""Options that several commands share, and functions that convert their values."""

from __future__ import annotations

import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from cablebot_gym.cli.records import Options
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.console import command_line
from cablebot_gym.utils.files import read_text
from cablebot_gym.utils.foreign import foreign_json

if TYPE_CHECKING:
    from cablebot_gym.policies import LoadedPolicy
    from cablebot_gym.robots import Robot

FittingEnvId = Annotated[
    str | None,
    typer.Argument(
        metavar="[ID]",
        help="Environment id, such as CableBot-Spatial-v0. The default is the one that fits --robot. `cablebot list` "
        "shows all.",
    ),
]
"""The id of a command, for :func:`fitting_id`."""

_POLICY = (
    "Name of an installed policy, a .zip file (trained policy or SB3 model), package.module:factory, or "
    "file.py:factory"
)
PolicyName = Annotated[str, typer.Option("--policy", help=f"{_POLICY}.")]
PolicyNames = Annotated[
    str, typer.Option("--policy", help=f"{_POLICY}; or several, separated by commas.")
]
Payload = Annotated[
    float | None,
    typer.Option(
        "--payload",
        help="Payload [kg]. The default is the least one of the robot's payload range, else 0.",
    ),
]
RobotName = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="TOML or JSON file, or name of a robot; `cablebot list` shows the names.",
    ),
]
Draws = Annotated[
    int | None,
    typer.Option(
        "--draws",
        help="Number of sampled episodes of each policy and payload. The default is 512 if the uncertainty is random "
        "or the policy is stochastic, else 1.",
    ),
]
Isolate = Annotated[
    bool | None,
    typer.Option(
        "--isolate/--no-isolate",
        help=(
            "Run the policy in a process of its own, which gets only observations and tasks, behind bubblewrap "
            "where that is installed. The default isolates every policy that is not shipped with this project, and "
            "every one with a wrapper. --no-isolate trusts the policy, and marks its result."
        ),
        show_default=False,
    ),
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", help="Number of worker processes. The default is one per core."),
]
Json = Annotated[bool, typer.Option("--json", help="Print only JSON.")]

SEED_BITS = 53
"""Number of bits of a secret seed: every JSON parser reads such integers exactly."""

NOT_ISOLATED = (
    "the policy could change its evaluation; leave --no-isolate out for a score that holds"
)
"""Note about a policy that is neither isolated nor shipped."""

LEAST_BOUND = 0.1
"""Least valid error bound [mm, mrad]. A smaller value is probably in metres or radians."""


def _read_data(parameter: typer.CallbackParam, text: str | None) -> Any:
    """The value of an option: JSON or the content of a .json file as data, and any other text
    unchanged.

    Raises:
        ValueError: if the file cannot be read, or the JSON is invalid.
    """
    option = f"--{parameter.name}"
    if text is not None and text.lower().endswith(".json"):
        try:
            text = read_text(text)
        except OSError as error:
            raise ValueError(
                f"{option}: cannot read {text!r} ({error.strerror or error})"
            ) from error
        except ValueError as error:
            raise ValueError(f"{option}: {error}") from error
        if not text.lstrip().startswith("{"):
            raise ValueError(f"{option}: the file must hold a JSON object, {{…}}")
    if text is None or not text.lstrip().startswith("{"):
        return text
    try:
        return foreign_json(text)
    except ValueError as error:
        raise ValueError(f"{option} is not valid JSON: {error}") from error


TrajectoryData = Annotated[
    str | None,
    typer.Option(
        "--trajectory",
        callback=_read_data,
        help='Name of a trajectory, JSON such as \'{"name": "circle-spatial", "duration": 1.5}\', a .json file, a '
        ".csv file of waypoints with the columns t [s], x, y, … [m, rad], or file.py:name of a Trajectory or of a "
        "function that makes one. `cablebot list` shows names and fields. The default is that of the "
        "robot: for the paper's robots the paper's circle between two dwells, for a robot without a motion a "
        "lemniscate about the home pose.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class TaskOptions(Options):
    """Conditions that describe the task alone, as a user types them."""

    title: ClassVar[str] = "Conditions"

    robot: Annotated[
        str | None,
        "Name, or TOML or JSON file, of a robot of the kind of ID, with its default motion, error bounds and "
        "payloads.",
    ] = None
    trajectory: TrajectoryData = None
    position_bound: Annotated[
        float | None,
        "Largest allowed position error [mm]. The default is in the robot's data; without data, 10 within "
        "0.1 to 1 % of the width of the base.",
    ] = None
    rotation_bound: Annotated[
        float | None,
        "Largest allowed rotation error of the task criterion [mrad]. The default is in the robot's data; "
        "without data, 10.",
    ] = None
    control_frequency: Annotated[
        float | None, "Control steps per second [Hz]. The default is in the robot's data, or 500."
    ] = None

    def keywords(self) -> dict[str, Any]:
        """Keywords of an evaluation: the options that are given, with ``error_bounds`` [m, rad] for the
        bounds, and without the wrappers of the policy."""
        keywords: dict[str, Any] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if value != item.default and item.name not in _NO_KEYWORDS:
                keywords[item.name] = value
        if self.error_bounds:
            keywords["error_bounds"] = self.error_bounds
        return keywords

    @property
    def error_bounds(self) -> dict[str, float]:
        """The error bounds that are given [m, rad]."""
        given = {"position": (self.position_bound, "mm"), "rotation": (self.rotation_bound, "mrad")}
        bounds = {}
        for name, (value, unit) in given.items():
            if value is not None:
                checked = number(f"--{name}-bound", value, least=LEAST_BOUND, unit=unit)
                bounds[name] = checked / 1000
        return bounds


@dataclass(frozen=True, kw_only=True)
class ConditionOptions(TaskOptions):
    """Conditions of an evaluation, as a user types them."""

    payload_known: Annotated[
        bool,
        typer.Option(
            "--payload-known/--payload-unknown",
            help="Whether the policy's model includes the payload.",
        ),
    ] = True
    model_payload_factor: Annotated[
        float, "Payload of the policy's model over the nominal payload."
    ] = 1.0
    uncertainty: Annotated[
        str | None,
        typer.Option(
            callback=_read_data,
            help=(
                "Model error: a name such as table6, names joined by +, JSON, or a .json file. "
                "`cablebot list` shows the names and fields."
            ),
        ),
    ] = None
    measurement: Annotated[
        str | None,
        typer.Option(
            callback=_read_data,
            help=(
                "Sensors of the policy: pose, winches, winches+tensions, winches+tensions+imu, JSON such as "
                '\'{"kind": "winches", "encoder_resolution": 0.001}\', or a .json file. '
                "With winches, --policy ekf+fl runs the policy fl behind an estimator."
            ),
        ),
    ] = None
    wrapper: Annotated[
        list[str] | None,
        "Wrapper of the policy's training, file.py:name or package.module:name; again for each further one, "
        "the innermost first. The last one may be a file with the statistics of Stable-Baselines3's VecNormalize. "
        "Installed policies take no wrapper.",
    ] = None
    seed: Annotated[
        int | None,
        "Seed of the environments. The default is 0; in `dlcc` and `compare` with an isolated policy, a secret "
        "number that is printed after the evaluation.",
    ] = None

    @property
    def wrappers(self) -> list[str]:
        """Wrappers of the training of the policy, the innermost first."""
        return self.wrapper or []


_NO_KEYWORDS = ("position_bound", "rotation_bound", "wrapper")
"""Options of conditions that are no keywords of an evaluation."""


def fitting_id(env_id: str | None, robot: str | None) -> str:
    """The environment id, or the one that fits ``--robot`` if there is none.

    Raises:
        ValueError: if there is neither.
    """
    from cablebot_gym.envs import ENV_IDS, fitting_env_id

    if env_id is not None:
        return env_id
    if robot is None:
        raise ValueError(
            f"give an environment id, one of {', '.join(ENV_IDS)}, or a robot with --robot"
        )
    return fitting_env_id(robot)


def with_seed(conditions: ConditionOptions, *, is_secret: bool) -> ConditionOptions:
    """The options with a secret seed if they have none and a policy is isolated."""
    if conditions.seed is None and is_secret:
        return replace(conditions, seed=secrets.randbits(SEED_BITS))
    return conditions


def command_again(command: str, *arguments: object, conditions: TaskOptions, **options: Any) -> str:
    """The command line of a command with the conditions that differ from their defaults.

    Args:
        command: command of ``cablebot``.
        arguments: its positional arguments.
        conditions: the conditions.
        options: further options, as for :func:`~cablebot_gym.utils.console.command_line`.
    """
    for item in fields(conditions):
        value = getattr(conditions, item.name)
        if item.name == "payload_known":  # its flag is --payload-unknown
            options["payload_unknown"] = not value
        elif value != item.default:
            options[item.name] = value
    return command_line(command, *arguments, **options)


def robot_of(env_id: str, conditions: TaskOptions) -> Robot:
    """The robot in ``--robot``, or that of the environment.

    Imports and checks the motion. The import has to precede the start of an isolated policy, which
    inherits the search path of modules.

    Raises:
        ValueError: if the id is unknown, the robot does not fit, or there is no such motion.
    """
    from cablebot_gym.envs import check_robot
    from cablebot_gym.envs.settings import default_trajectory
    from cablebot_gym.motions import find_trajectory
    from cablebot_gym.robots import find_robot

    check_robot(env_id, conditions.robot)
    robot = find_robot(conditions.robot or env_id)
    trajectory = conditions.trajectory or default_trajectory(robot)
    find_trajectory(trajectory, robot.kind)
    return robot


def loaded_policies(
    names: Sequence[str], robot: Robot, wrappers: Sequence[str], *, isolate: bool | None
) -> list[LoadedPolicy]:
    """The policies with these names, made for a robot, in processes of their own where ``--isolate``
    asks for them. The wrappers apply to those that are not installed.

    Raises:
        ValueError: if there is no policy, if one cannot be loaded, or if there are wrappers and only
            installed policies.
    """
    from cablebot_gym.isolation import IsolatedPolicy
    from cablebot_gym.policies import PolicySpec, load

    if not names:
        raise ValueError("name at least one policy, such as fl")
    specs = [PolicySpec.parse(name) for name in names]
    if wrappers and all(spec.installed for spec in specs):
        raise ValueError(f"--wrapper does not apply to installed policies, such as {names[0]}")
    policies = []
    for name, spec in zip(names, specs, strict=True):
        layers = () if spec.installed else wrappers
        is_isolated = isolate
        if is_isolated is None:
            is_isolated = bool(layers) or not spec.shipped
        if is_isolated:
            policies.append(IsolatedPolicy(name, robot, wrappers=layers).loaded)
        else:
            policies.append(load(name, robot, wrappers=layers))
    return policies


def split_names(text: str | None) -> list[str]:
    """Names from a list separated by commas. A comma before ``option=`` is part of a name:
    ``fl:gains=tuned,minimum_tension=3,observing`` has two."""
    names = re.split(r",(?!\s*\w+=)", text or "")
    return [name.strip() for name in names if name.strip()]


def counted(count: int, noun: str) -> str:
    """A count with its noun, such as ``2 draws``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def check_figure_folder(out: Path | None, *names: str) -> None:
    """Checks before a long computation that matplotlib is installed and that the files can be
    written.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
        OSError: if the folder or a file is not writable.
    """
    if out is not None:
        from cablebot_gym.plotting.figures import import_matplotlib
        from cablebot_gym.utils.files import check_writable_dir, check_writable_file

        import_matplotlib()
        check_writable_dir(out)
        for name in names:
            check_writable_file(out / name)
