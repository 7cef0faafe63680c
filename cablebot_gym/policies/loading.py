"""How a name, a file or ``package.module:factory`` becomes a policy."""

from __future__ import annotations

import importlib
import logging
import zipfile
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from cablebot_gym.policies.protocol import Policy, PolicyEntry, as_policy, code_line
from cablebot_gym.policies.sb3 import load_sb3
from cablebot_gym.robots import Robot
from cablebot_gym.utils.suggestions import no_such

_LOGGER = logging.getLogger("cablebot_gym")

ENTRY_POINT_GROUP = "cablebot_gym.policies"
"""A package adds policies by entry points in this group, each of which names a :class:`PolicyEntry`."""

FILE_ENTRY_POINT_GROUP = "cablebot_gym.policy_files"
"""A package adds kinds of policy files by entry points in this group, each of which names a :data:`FileLoader`."""


FileLoader = Callable[[Path, Robot], Policy | None]
"""Makes a policy from a ``.zip`` and a nominal robot, or None if the file is not of its kind. It raises a ValueError in
words if the file is of its kind, but damaged or made for another robot."""


def policy_entries() -> dict[str, PolicyEntry]:
    """Every installed policy by name, sorted; one whose package cannot be imported is left out, with a warning."""
    entries = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            entries.append(point.load())
        except Exception as error:
            _LOGGER.warning("policy %r is left out: %s raised %s", point.name, point.value, error)
    return {entry.name: entry for entry in sorted(entries, key=lambda entry: entry.name)}


def load_policy(name: str, robot: Robot) -> Policy:
    """A policy from an installed name, a ``.zip`` file, or ``package.module:factory``.

    A factory is called with the nominal robot. A file is offered to the loaders of :data:`FILE_ENTRY_POINT_GROUP`; one
    that none of them takes is a Stable-Baselines3 model of PPO, SAC, TD3, A2C or DDPG, or with sb3-contrib installed
    of TQC, CrossQ, RecurrentPPO, TRPO or ARS.

    Raises:
        ValueError: if the name is unknown, or what it names cannot be loaded or does not fit the robot; the message
            says what is valid.
    """
    entries = policy_entries()
    if name in entries:
        return entries[name].factory(robot)
    if name.endswith(".zip"):
        return _load_file(Path(name), robot)
    if ":" in name:
        factory = _load_factory(name)
        try:
            made = factory(robot)
        except Exception as error:
            what = f"{type(error).__name__}: {error}{code_line(error)}"
            raise ValueError(f"policy {name!r}: the factory raised {what}") from error
        try:
            return as_policy(made)
        except TypeError as error:
            raise ValueError(f"policy {name!r} must be a function robot -> policy, but: {error}") from None
    otherwise = ", a learned bundle or an SB3 file ending in .zip, or package.module:factory"
    raise ValueError(no_such("policy", name, entries, otherwise))


def _load_factory(name: str) -> Callable[[Robot], Any]:
    module_name, _, attribute = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        meant = f"; a module is named without .py: {module_name.removesuffix('.py')}:{attribute}"
        hint = meant if module_name.endswith(".py") else ""
        raise ValueError(f"policy {name!r}: cannot import {module_name!r} ({error}){hint}") from error
    if not hasattr(module, attribute):
        raise ValueError(f"policy {name!r}: {module_name!r} has no {attribute!r}")
    factory = getattr(module, attribute)
    if isinstance(factory, PolicyEntry):
        return factory.factory
    if not callable(factory):
        raise ValueError(f"policy {name!r}: {attribute!r} must be a function robot -> policy")
    made: Callable[[Robot], Any] = factory
    return made


def _load_file(path: Path, robot: Robot) -> Policy:
    if not path.is_file():
        raise ValueError(f"policy file {str(path)!r} does not exist")
    _check_zip(path)
    for point in entry_points(group=FILE_ENTRY_POINT_GROUP):
        try:
            loader: FileLoader = point.load()
        except Exception as error:
            _LOGGER.warning("policy files of kind %r are left out: %s raised %s", point.name, point.value, error)
            continue
        try:
            policy = loader(path, robot)
        except ValueError:
            raise
        except Exception as error:
            reason = f"{point.value} raised {type(error).__name__}: {error}"
            raise ValueError(f"policy file {str(path)!r} cannot be loaded: {reason}") from error
        if policy is not None:
            return policy
    return load_sb3(path, robot)


def _check_zip(path: Path) -> None:
    """Refuses what is no zip file, and one whose checksums do not hold."""
    try:
        with zipfile.ZipFile(path) as file:
            broken = file.testzip()
    except Exception as error:  # besides zipfile's own those of the decompressors
        reason = str(error) or type(error).__name__
        raise ValueError(
            f"policy file {str(path)!r} is no zip file, or damaged or cut short ({reason}): save or copy it again"
        ) from error
    if broken is not None:
        raise ValueError(f"policy file {str(path)!r} is damaged (its part {broken!r}): save or copy it again")
