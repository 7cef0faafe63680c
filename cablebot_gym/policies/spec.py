"""A policy's name becomes one :class:`~cablebot_gym.policies.protocol.LoadedPolicy`, once."""

from __future__ import annotations

import inspect
import logging
import zipfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, cast

from cablebot_gym.measurement import POSE, Measurement
from cablebot_gym.policies.adapters import as_policy
from cablebot_gym.policies.options import (
    parse_options,
    split_options,
    supports,
    unsupported_error,
)
from cablebot_gym.policies.protocol import (
    LoadedPolicy,
    Policy,
    PolicyEntry,
    PolicyError,
    declarations,
    name_of,
    required_arguments,
)
from cablebot_gym.policies.sb3 import behind_wrappers, load_model
from cablebot_gym.policies.wrappers import Wrapper
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.checks import unknown_name_error
from cablebot_gym.utils.files import check_not_a_file
from cablebot_gym.utils.imports import import_object
from cablebot_gym.utils.user_code import raised

_LOGGER = logging.getLogger("cablebot_gym")

_NAME = attrgetter("name")

ENTRY_POINT_GROUP = "cablebot_gym.policies"
"""Entry point group of policies. A package adds a policy by an entry point that names a
:class:`PolicyEntry`. The entry point has the name of the policy."""

FILE_ENTRY_POINT_GROUP = "cablebot_gym.policy_files"
"""Entry point group of file loaders. A package adds a kind of policy file by an entry point that
names a :data:`FileLoader`."""

ESTIMATOR_ENTRY_POINT_GROUP = "cablebot_gym.estimators"
"""Entry point group of estimators, which run any policy with the sensors of winches: ``ekf+fl``
names the policy ``fl`` behind the estimator ``ekf``. An entry point names a function of the nominal
robot and the policy that returns a policy."""

FileLoader = Callable[[Path, Robot], Policy | None]
"""Makes a policy from a ``.zip`` file and a nominal robot. It returns None if the file is of
another kind. It raises a ValueError with an explanation if the file is of its kind, but is damaged
or made for another robot."""


POLICY_SUFFIXES = (".zip",)
"""Suffixes of policy files."""

PolicyKind = Literal["installed", "file", "factory", "unknown"]
"""Kind of a policy's name: name of an installed policy, also with options; ``.zip`` file;
``package.module:factory`` or ``file.py:factory``."""


@dataclass(frozen=True, kw_only=True)
class PolicySpec:
    """A policy's name, read without importing or running any code."""

    estimators: tuple[EntryPoint, ...]
    """Installed estimators in front of the policy, the outermost first: ``ekf`` of ``ekf+fl``."""
    target: str
    """The name without the estimators."""
    options: str
    """Options of an installed policy as text: ``gains=tuned`` of ``fl:gains=tuned``."""
    kind: PolicyKind
    """Kind of the target."""
    points: tuple[EntryPoint, ...]
    """Entry points of the installed policy. Those of this project come first."""

    @classmethod
    def parse(cls, text: str) -> PolicySpec:
        """The parts of a policy's name."""
        estimators: list[EntryPoint] = []
        target = text
        while "+" in target:
            name, _, policy = target.partition("+")
            candidates = list(entry_points(group=ESTIMATOR_ENTRY_POINT_GROUP, name=name))
            if not policy or not candidates:
                break
            estimators.append(candidates[0])
            target = policy
        installed_name, options = split_options(target)
        points = _own_first(entry_points(group=ENTRY_POINT_GROUP, name=installed_name))
        kind: PolicyKind = "unknown"
        if points:
            kind = "installed"
        elif target.endswith(POLICY_SUFFIXES):
            kind = "file"
        elif ":" in target or target.endswith(".py"):
            kind = "factory"
        return cls(
            estimators=tuple(estimators),
            target=target,
            options=options,
            kind=kind,
            points=points,
        )

    @property
    def installed(self) -> bool:
        """Whether it is the name of an installed policy alone."""
        return self.kind == "installed" and not self.estimators

    @property
    def shipped(self) -> bool:
        """Whether this project ships all the code that the name stands for: the policy, and the
        estimators in front of it."""
        is_own_policy = self.kind == "installed" and is_own(self.points[0])
        return is_own_policy and all(is_own(point) for point in self.estimators)

    def entry(self) -> PolicyEntry | None:
        """The entry of the installed policy, imported; None if there is none.

        An entry that cannot be imported, or has another name than its entry point, is skipped with
        a warning.
        """
        return _first_entry(self.points)


def is_own(point: EntryPoint) -> bool:
    """Whether an entry point is one of this project, and not of another installed package."""
    return point.dist is not None and point.dist.name == "cablebot-gym"


def policy_names() -> list[str]:
    """Names of all installed policies, sorted."""
    return sorted({point.name for point in entry_points(group=ENTRY_POINT_GROUP)})


def policy_entries() -> dict[str, PolicyEntry]:
    """All installed policies by name, sorted. A policy whose package cannot be imported is skipped
    with a warning."""
    entries = {}
    for name, points in groupby(
        sorted(entry_points(group=ENTRY_POINT_GROUP), key=_NAME), key=_NAME
    ):
        entry = _first_entry(_own_first(points))
        if entry is not None:
            entries[name] = entry
    return entries


def _own_first(points: Iterable[EntryPoint]) -> tuple[EntryPoint, ...]:
    return tuple(sorted(points, key=is_own, reverse=True))


def _first_entry(points: Iterable[EntryPoint]) -> PolicyEntry | None:
    for point in points:
        try:
            entry: PolicyEntry = point.load()
        except Exception as error:
            _LOGGER.warning("policy %r is skipped: %s raised %s", point.name, point.value, error)
            continue
        if entry.name == point.name:
            return entry
        _LOGGER.warning("policy %r is skipped: its entry has the name %r", point.name, entry.name)
    return None


def check_measurement(policy: LoadedPolicy, measurement: Measurement) -> None:
    """Checks that a policy reads what is measured.

    Raises:
        ValueError: if it reads another kind of measurement. The message names the remedy.
    """
    declared = policy.declarations.measurement
    kind = measurement.kind
    if declared == kind:
        return
    remedy = "declare measurement = 'winches'"
    estimators = sorted(entry_points(group=ESTIMATOR_ENTRY_POINT_GROUP).names)
    if kind == POSE.kind:
        remedy = "use measurement='winches'"
    elif estimators:
        remedy = f"name an estimator, such as {estimators[0]}+{policy.name}, or {remedy}"
    raise ValueError(
        f"policy {policy.name!r} reads measurement {declared!r}, not {kind!r}: {remedy}"
    )


def load_policy(name: str, robot: Robot | str, *, wrappers: Sequence[Wrapper] = ()) -> Policy:
    """A policy from an installed name, a ``.zip`` file, or ``package.module:factory``; ``ekf+…``
    behind an estimator.

    An installed name may have options, ``fl:gains=900/60,minimum_tension=3``: keyword arguments of
    its factory.

    A factory, a function or a class, is called with the nominal robot, or with nothing if it needs
    nothing. A file is passed to the loaders of :data:`FILE_ENTRY_POINT_GROUP` in turn. If all of
    them return None, the file is loaded as a Stable-Baselines3 model of PPO, SAC, TD3, A2C or DDPG.
    If sb3-contrib is installed, models of TQC, CrossQ, RecurrentPPO, TRPO and ARS are loaded as
    well, and if SBX is installed, its models.

    Args:
        name: the name.
        robot: nominal robot, its name, or an environment id.
        wrappers: wrappers of the training, the innermost first, see
            :data:`~cablebot_gym.policies.wrappers.Wrapper`.

    Raises:
        ValueError: if the name or an option is unknown, or if the policy cannot be loaded or does
            not support the kind of the robot. The message lists the valid names.
        PolicyError: if the code of the policy tries to end the process.
    """
    return load(name, find_robot(robot), wrappers=wrappers).policy


def load(
    policy: Any, robot: Robot, *, name: str | None = None, wrappers: Sequence[Wrapper] = ()
) -> LoadedPolicy:
    """Loads a policy. A policy that is loaded already is returned.

    Args:
        policy: a name as for :func:`load_policy`, a policy object, a callable, a class that makes a
            policy, or a loaded policy, such as an
            :class:`~cablebot_gym.isolation.isolated.IsolatedPolicy`.
        robot: nominal robot.
        name: name of the policy in results and messages; None for its own name.
        wrappers: as for :func:`load_policy`.

    Raises:
        TypeError: if the object is neither a policy nor a callable.
        ValueError: if the policy cannot be made, or does not fit the robot, if a loaded policy
            gets wrappers, or if a policy with wrappers of the environment has an estimator.
        PolicyError: if the code of the policy tries to end the process.
    """
    loaded = getattr(policy, "loaded", policy)
    if isinstance(loaded, LoadedPolicy):
        if wrappers:
            raise ValueError(
                f"policy {loaded.name!r} is loaded already: give the wrappers where it is loaded"
            )
        return replace(loaded, name=name or loaded.name)
    if isinstance(policy, str):
        spec = PolicySpec.parse(policy)
        target, subject = _make(spec, robot)
        estimators = spec.estimators
        shipped = spec.shipped and not wrappers
    else:
        subject = f"policy {name or name_of(policy)!r}"
        estimators = ()
        shipped = False
        if isinstance(policy, type):
            target = _call(policy, robot, subject)
        else:
            target = as_policy(policy)
    if wrappers and hasattr(target, "wrap"):
        raise ValueError(f"{subject} has wrappers: give all of them where it is loaded")
    made = target = behind_wrappers(target, robot, subject, wrappers)
    if estimators and hasattr(target, "wrap"):
        raise ValueError(
            f"{subject} acts in a wrapped environment, and estimator {estimators[0].name!r} takes "
            "policies that read the observation: of the wrappers, use VecNormalize only"
        )
    for estimator in reversed(estimators):
        made = estimator.load()(robot, made)
    name = name or name_of(policy)
    return LoadedPolicy(
        policy=made,
        name=name,
        declarations=declarations(made),
        shipped=shipped,
        wrappers=tuple(getattr(target, "wrappers", ())),
    )


def _make(spec: PolicySpec, robot: Robot) -> tuple[Policy, str]:
    """The target of a name without wrappers, and the subject of messages."""
    name, subject = spec.target, f"policy {spec.target!r}"
    entry = spec.entry()
    if entry is not None:
        return _from_entry(entry, robot, spec.options), subject
    if spec.kind == "file":
        return _load_file(Path(name), robot), f"policy file {name!r}"
    if spec.kind == "factory":
        factory = _import_factory(name, subject)
        return _call(factory, robot, subject), subject
    forms = "a trained policy or an SB3 model ending in .zip, file.py:factory, or package.module:factory"
    check_not_a_file("policy", name, forms)
    raise unknown_name_error("policy", name, policy_entries(), f", {forms}")


def _from_entry(entry: PolicyEntry, robot: Robot, options: str = "") -> Policy:
    if not supports(entry, robot):
        raise unsupported_error(entry, robot, policy_entries().values())
    return entry.factory(robot, **parse_options(entry, options))


def _import_factory(name: str, subject: str) -> Callable[..., Any]:
    try:
        factory = import_object(name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        reason = error if isinstance(error, Exception) else raised(error)
        raise _failure(error, subject, f"cannot import it ({reason})") from error
    if isinstance(factory, PolicyEntry):
        return partial(_from_entry, factory)
    if isinstance(factory, Policy) and not isinstance(factory, type):
        return lambda: factory
    if not callable(factory):
        raise ValueError(
            f"{subject}: it must be a function that takes a robot and returns a policy"
        )
    return cast(Callable[..., Any], factory)


def _call(factory: Callable[..., Any], robot: Robot, subject: str) -> Policy:
    """The policy of a factory, which is called with the robot, or with nothing if it takes
    nothing."""
    try:
        created = factory(*_arguments(factory, robot))
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise _failure(error, subject, raised(error, "the factory raised")) from error
    try:
        return as_policy(created)
    except TypeError as error:
        raise ValueError(f"{subject}: the factory must return a policy; {error}") from None


def _arguments(factory: Callable[..., Any], robot: Robot) -> list[Robot]:
    with suppress(ValueError):  # some callables of C have no signature
        takes_robot = "robot" in inspect.signature(factory).parameters
        if not takes_robot and not required_arguments(factory):
            return []
    return [robot]


def _failure(error: BaseException, subject: str, cause: str) -> ValueError | PolicyError:
    """A PolicyError for an attempt to end the process, such as SystemExit, and a ValueError for
    other errors."""
    text = f"{subject}: {cause}"
    return ValueError(text) if isinstance(error, Exception) else PolicyError(text, cause=cause)


def _load_file(path: Path, robot: Robot) -> Policy:
    subject = f"policy file {str(path)!r}"
    if not path.is_file():
        raise ValueError(f"{subject} does not exist")
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{subject} is not a zip file, or it is damaged: save or copy it again")
    for point in entry_points(group=FILE_ENTRY_POINT_GROUP):
        try:
            loader: FileLoader = point.load()
        except Exception as error:
            _LOGGER.warning(
                "policy files of kind %r are skipped: %s raised %s", point.name, point.value, error
            )
            continue
        try:
            policy = loader(path, robot)
        except ValueError:
            raise
        except Exception as error:
            reason = f"{point.value} raised {type(error).__name__}: {error}"
            raise ValueError(f"{subject} cannot be loaded: {reason}") from error
        if policy is not None:
            return policy
    return cast(Policy, load_model(path))
