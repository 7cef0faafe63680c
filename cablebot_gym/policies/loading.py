"""Loads policies from installed names, files and ``package.module:factory``."""

from __future__ import annotations

import inspect
import logging
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.policies.entry import is_entry
from cablebot_gym.policies.protocol import Policy, PolicyEntry, PolicyError, as_policy, name_of, required
from cablebot_gym.policies.sb3 import fitted, load_sb3
from cablebot_gym.policies.wrapped import Wrapper
from cablebot_gym.robots import Robot, find_robot, robot_names
from cablebot_gym.utils.checks import unknown_name_error
from cablebot_gym.utils.files import check_not_a_file
from cablebot_gym.utils.imports import import_object
from cablebot_gym.utils.user_code import raised

_LOGGER = logging.getLogger("cablebot_gym")

ENTRY_POINT_GROUP = "cablebot_gym.policies"
"""Entry point group of policies. A package adds a policy by an entry point that names a :class:`PolicyEntry`."""

FILE_ENTRY_POINT_GROUP = "cablebot_gym.policy_files"
"""Entry point group of file loaders. A package adds a kind of policy file by an entry point that names a
:data:`FileLoader`."""


ESTIMATOR_ENTRY_POINT_GROUP = "cablebot_gym.estimators"
"""Entry point group of estimators, which run any policy with the sensors of winches: ``ekf+fl`` names the policy ``fl``
behind the estimator ``ekf``. An entry point names a function of the nominal robot and the policy that returns a
policy."""


FileLoader = Callable[[Path, Robot], Policy | None]
"""Makes a policy from a ``.zip`` file and a nominal robot. It returns None if the file is of another kind. It raises a
ValueError with an explanation if the file is of its kind, but is damaged or made for another robot."""


def is_own(point: EntryPoint) -> bool:
    """Whether an entry point is one of this project, and not of another installed package."""
    return point.dist is not None and point.dist.name == "cablebot-gym"


def policy_points(name: str | None = None) -> list[EntryPoint]:
    """The entry points of policies with a name, or of all policies. Those of this project come first."""
    points = entry_points(group=ENTRY_POINT_GROUP) if name is None else entry_points(group=ENTRY_POINT_GROUP, name=name)
    return sorted(points, key=is_own, reverse=True)


def policy_entries() -> dict[str, PolicyEntry]:
    """All installed policies by name, sorted. A policy whose package cannot be imported is skipped with a warning."""
    entries: dict[str, PolicyEntry] = {}
    for point in policy_points():
        try:
            entry: PolicyEntry = point.load()
            entries.setdefault(entry.name, entry)
        except Exception as error:
            _LOGGER.warning("policy %r is skipped: %s raised %s", point.name, point.value, error)
    return dict(sorted(entries.items()))


def policy_entry(name: str) -> PolicyEntry | None:
    """The installed policy with a name; None if there is none.

    Only its own package is imported if the entry point has the name of the policy, as it should.
    """
    for point in policy_points(name):
        with suppress(Exception):
            entry: PolicyEntry = point.load()
            if entry.name == name:
                return entry
    return None if name.endswith((".zip", ".py")) or ":" in name else policy_entries().get(name)


def holds_unsaturated_actions(name: str) -> bool:
    """Whether this project holds its installed policy with this name to the declaration ``unsaturated_actions``.

    False stands for every other policy, also of other packages, whose declaration is taken on trust.
    """
    return any(point.load().unsaturated_actions for point in policy_points(name) if is_own(point))


def split_estimator(name: str) -> tuple[EntryPoint | None, str]:
    """The installed estimator before the first ``+`` of the name of a policy, or None, and the name of the policy."""
    estimator, _, policy = name.partition("+")
    points = entry_points(group=ESTIMATOR_ENTRY_POINT_GROUP, name=estimator) if policy else ()
    return next(((point, policy) for point in points), (None, name))


def load_policy(name: str, robot: Robot | str, *, wrappers: Sequence[Wrapper] = ()) -> Policy:
    """A policy from an installed name, a ``.zip`` file, or ``package.module:factory``; ``ekf+…`` behind an estimator.

    A factory, a function or a class, is called with the nominal robot, or with nothing if it needs nothing. A file is
    passed to the loaders of :data:`FILE_ENTRY_POINT_GROUP` in turn. If all of them return None, the file is loaded as a
    Stable-Baselines3 model of PPO, SAC, TD3, A2C or DDPG. If sb3-contrib is installed, models of TQC, CrossQ,
    RecurrentPPO, TRPO and ARS are loaded as well, and if SBX is installed, its models.

    Args:
        name: the name.
        robot: nominal robot, its name, or an environment id.
        wrappers: wrappers of the training, the innermost first, see
            :data:`~cablebot_gym.policies.wrapped.Wrapper`. The statistics of a ``VecNormalize`` beside a
            Stable-Baselines3 file are used without being named, and a note on standard error says so.

    Raises:
        ValueError: if the name is unknown, or if the policy cannot be loaded or does not fit the robot. The message
            lists the valid names.
        PolicyError: if the code of the policy tries to end the process.
    """
    robot = as_robot(robot)
    if is_entry(name):
        raise ValueError(f"entry {name!r} runs in a process of its own only: `cablebot dlcc --isolate` does it")
    estimator, inner = split_estimator(name)
    if estimator is not None:
        return as_policy(estimator.load()(robot, load_policy(inner, robot, wrappers=wrappers)))
    entry = policy_entry(name)
    if entry is not None:
        return fitted(entry.factory(robot), robot, f"policy {name!r}", wrappers)
    if name.endswith(".zip"):
        return _load_file(Path(name), robot, wrappers)
    if ":" in name or name.endswith(".py"):
        return fitted(_made(_load_factory(name), robot, name), robot, f"policy {name!r}", wrappers)
    forms = "a learned bundle or an SB3 file ending in .zip, file.py:factory, or package.module:factory"
    check_not_a_file("policy", name, f"{forms}, or the folder of an entry with its card")
    raise unknown_name_error("policy", name, policy_entries(), f", {forms}")


def find_policy(policy: Any, robot: Robot, *, name: str | None = None, wrappers: Sequence[Wrapper] = ()) -> Policy:
    """A policy from a name as for :func:`load_policy`, a policy object, a callable, or a class that makes a policy.

    Args:
        policy: the policy.
        robot: nominal robot.
        name: name of the policy in messages; None for its own name.
        wrappers: as for :func:`load_policy`.

    Raises:
        TypeError: if the object is neither a policy nor a callable.
        ValueError: if the policy cannot be made, or does not fit the robot.
        PolicyError: if the code of the policy tries to end the process.
    """
    if isinstance(policy, str):
        return load_policy(policy, robot, wrappers=wrappers)
    name = name or name_of(policy)
    made = _made(policy, robot, name) if isinstance(policy, type) else as_policy(policy)
    return fitted(made, robot, f"policy {name!r}", wrappers)


def as_robot(robot: Robot | str) -> Robot:
    """The robot of an environment id; otherwise as :func:`~cablebot_gym.robots.find_robot`.

    Raises:
        ValueError: if the name is unknown.
    """
    if isinstance(robot, Robot):
        return robot
    names = [*ENV_ROBOTS, *robot_names()]
    if robot not in names and not Path(robot).suffix and not Path(robot).exists():
        raise unknown_name_error("environment or robot", robot, names, ", a robot file, or pass a Robot")
    return find_robot(ENV_ROBOTS.get(robot, robot))


def _made(factory: Callable[..., Any], robot: Robot, name: str) -> Policy:
    """The policy of a factory, which is called with the robot, or with nothing if it takes nothing."""
    try:
        created = factory(*_arguments(factory, robot))
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise _failure(error, name, raised(error, "the factory raised")) from error
    try:
        return as_policy(created)
    except TypeError as error:
        raise ValueError(f"policy {name!r}: the factory must return a policy; {error}") from None


def _arguments(factory: Callable[..., Any], robot: Robot) -> list[Robot]:
    try:
        signature = inspect.signature(factory)
    except ValueError:  # some callables of C have none
        return [robot]
    optional = isinstance(factory, type) and "robot" not in signature.parameters and not required(factory)
    for arguments in ([], [robot]) if optional else ([robot], []):
        with suppress(TypeError):
            signature.bind(*arguments)
            return arguments
    own = name_of(factory)
    raise TypeError(f"it takes {signature}, but is called with the robot: def make(robot): return {own}(…)")


def _load_factory(name: str) -> Callable[..., Any]:
    try:
        factory = import_object(name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        reason = error if isinstance(error, Exception) else raised(error)
        raise _failure(error, name, f"cannot import it ({reason})") from error
    if isinstance(factory, PolicyEntry):
        return factory.factory
    if isinstance(factory, Policy) and not isinstance(factory, type):
        return lambda: factory
    if not callable(factory):
        raise ValueError(f"policy {name!r}: it must be a function that takes a robot and returns a policy")
    checked: Callable[..., Any] = factory
    return checked


def _failure(error: BaseException, name: str, cause: str) -> ValueError | PolicyError:
    """A PolicyError for an attempt to end the process, such as SystemExit, and a ValueError for other errors."""
    return ValueError(f"policy {name!r}: {cause}") if isinstance(error, Exception) else PolicyError.of(name, cause)


def _load_file(path: Path, robot: Robot, wrappers: Sequence[Wrapper]) -> Policy:
    if not path.is_file():
        raise ValueError(f"policy file {str(path)!r} does not exist")
    _check_zip(path)
    for point in entry_points(group=FILE_ENTRY_POINT_GROUP):
        try:
            loader: FileLoader = point.load()
        except Exception as error:
            _LOGGER.warning("policy files of kind %r are skipped: %s raised %s", point.name, point.value, error)
            continue
        try:
            policy = loader(path, robot)
        except ValueError:
            raise
        except Exception as error:
            reason = f"{point.value} raised {type(error).__name__}: {error}"
            raise ValueError(f"policy file {str(path)!r} cannot be loaded: {reason}") from error
        if policy is not None:
            return fitted(policy, robot, f"policy file {str(path)!r}", wrappers)
    return load_sb3(path, robot, wrappers)


def _check_zip(path: Path) -> None:
    """Raises a ValueError if a file is not a zip file or if a checksum is wrong."""
    with suppress(Exception), zipfile.ZipFile(path) as file:
        if file.testzip() is None:
            return
    raise ValueError(f"policy file {str(path)!r} is not a zip file, or it is damaged: save or copy it again")
