"""``cablebot doctor``: what is installed, where compiled code is kept, and whether the plants obey the equations."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from pathlib import Path

import gymnasium as gym
import numpy as np
import typer

from cablebot_gym.cli.app import COMMAND_GROUP
from cablebot_gym.envs import ENV_IDS, env_robot
from cablebot_gym.physics import kernel
from cablebot_gym.physics.textbook import MINIMUM_TENSION, drive_command, static_torque
from cablebot_gym.planning.library import cache_folder
from cablebot_gym.policies import ENTRY_POINT_GROUP, FILE_ENTRY_POINT_GROUP, PolicyEntry
from cablebot_gym.robots import find_robot
from cablebot_gym.task import Task
from cablebot_gym.utils.console import results_console

PACKAGE = "cablebot-gym"

NO_EXTRAS = ("all", "docs", "test")
"""Extras that no user misses: made of others, or for those who work on the project."""

PAYLOAD = 1.5
"""That is held in the self-test [kg]."""

STEPS = 50
"""Control steps for which it is held."""

STILL = 1e-9
"""How far it may move meanwhile [m]: rounding, no more."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that was looked at."""

    name: str
    """What was looked at."""
    good: bool | None
    """None: a matter of taste, such as an extra that is not installed."""
    words: str
    """What was found."""


def examine() -> Iterator[Finding]:
    """Looks at everything, one thing after the other."""
    yield Finding(name="python", good=True, words=f"{platform.python_version()} on {platform.platform(terse=True)}")
    yield from _packages()
    yield _compile_cache()
    yield _writable("plans and best payloads", cache_folder())
    yield from _packages_found_twice()
    yield from _policies()
    for env_id in ENV_IDS:
        yield _checked(f"self-test {env_id}", partial(_hangs_still, env_id))


def _packages() -> Iterator[Finding]:
    """The packages that are always needed, then one finding for each extra."""
    yield Finding(name=PACKAGE, good=True, words=version(PACKAGE))
    needed: dict[str, list[str]] = {}
    for line in requires(PACKAGE) or []:
        mark = re.search(r"extra == ['\"]([\w-]+)['\"]", line)
        needed.setdefault(mark[1] if mark else "", []).append(re.split(r"[^\w.-]", line, maxsplit=1)[0])
    for extra, names in needed.items():
        if extra in NO_EXTRAS:
            continue
        found = {name: _version(name) for name in names}
        missing = [name for name, number in found.items() if number is None]
        words = ", ".join(f"{name} {number}" for name, number in found.items() if number is not None)
        if missing:
            how = f"pip install '{PACKAGE}[{extra}]'" if extra else f"pip install {PACKAGE}"
            words = f"{', '.join(missing)} not installed: {how}"
        good = True if not missing else None if extra else False
        yield Finding(name=f"extra {extra}" if extra else "needs", good=good, words=words)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _compile_cache() -> Finding:
    folder = Path(str(kernel.advance_one_planar.stats.cache_path))  # numba's choice
    compiled = len(list(folder.glob("*.nbc")))
    finding = _writable("compiled code", folder)
    words = f"{finding.words}, {compiled} files" if compiled else f"{finding.words}, nothing compiled yet"
    return finding if not finding.good else Finding(name=finding.name, good=True, words=words)


def _writable(name: str, folder: Path) -> Finding:
    there = folder
    while not there.exists() and there != there.parent:
        there = there.parent
    if os.access(there, os.W_OK):
        return Finding(name=name, good=True, words=str(folder))
    return Finding(
        name=name, good=False, words=f"{folder} cannot be written to: every process would start from nothing"
    )


def _packages_found_twice() -> Iterator[Finding]:
    """A finding for each package with entry points of ours that another folder of that name hides."""
    groups = (COMMAND_GROUP, ENTRY_POINT_GROUP, FILE_ENTRY_POINT_GROUP)
    for package in sorted({point.module.partition(".")[0] for group in groups for point in entry_points(group=group)}):
        folders = dict.fromkeys(Path(entry, package).resolve() for entry in sys.path)
        found = [folder for folder in folders if (folder / "__init__.py").is_file()]
        if len(found) > 1:
            words = f"{found[0]} hides {found[1]}. Rename that folder, or work in another one."
            yield Finding(name=f"package {package}", good=False, words=words)


def _policies() -> Iterator[Finding]:
    """A finding for each policy that cannot be made for one of its environments, and one that counts the others."""
    names: list[str] = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            entry: PolicyEntry = point.load()
            for env_id in entry.env_ids:
                entry.factory(find_robot(env_robot(env_id)))
        except Exception as error:
            extra_missing = isinstance(error, ImportError) and f"pip install '{PACKAGE}[" in str(error)
            words = f"{type(error).__name__}: {error}"
            yield Finding(name=f"policy {point.name}", good=None if extra_missing else False, words=words)
        else:
            names.append(point.name)
    yield Finding(name="policies", good=bool(names), words=f"{len(names)} load: {', '.join(sorted(names))}")


def _checked(name: str, test: Callable[[], str]) -> Finding:
    try:
        return Finding(name=name, good=True, words=test())
    except Exception as error:
        return Finding(name=name, good=False, words=f"{type(error).__name__}: {error}")


def _hangs_still(env_id: str) -> str:
    """The compiled plant, held by the torques that the textbook's statics ask for: it has to stay where it is."""
    kind = "planar" if "Planar" in env_id else "spatial"
    env = gym.make(env_id, trajectory=f"hold-{kind}", payload=PAYLOAD)
    try:
        _, info = env.reset(seed=0)
        task: Task = env.unwrapped.task  # type: ignore[attr-defined]
        robot, pose = task.robot, task.trajectory(0.0).position
        least = MINIMUM_TENSION if robot.planar else 0.0
        torque = static_torque(robot, robot.mass + PAYLOAD, pose, minimum=least)
        command = drive_command(robot, torque, np.zeros(robot.cables))
        for _ in range(STEPS):
            _, _, _, _, info = env.step(command)
        moved = float(info["tracking_error_peak"])
    finally:
        env.close()
    if not moved <= STILL:
        raise ArithmeticError(
            f"held by the torques of statics it moves by {moved:.3g} m: do not trust what is compiled"
        )
    return f"{PAYLOAD:g} kg held still to {moved:.0e} m"


def print_findings(findings: Iterable[Finding]) -> bool:
    """Prints each as it comes; whether all is well."""
    console, well = results_console(), True
    for finding in findings:
        mark = {True: "ok  ", False: "BAD ", None: "–   "}[finding.good]
        console.print(f"{mark}{finding.name}: {finding.words}", soft_wrap=True, highlight=False)
        well &= finding.good is not False
    return well


def doctor() -> None:
    """Versions, extras, compile cache, and a self-test of every plant. The exit status is 1 if something is wrong.

    Example: cablebot doctor
    """
    if not print_findings(examine()):
        raise typer.Exit(1)
