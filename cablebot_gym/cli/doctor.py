"""``cablebot doctor``: checks of the installed packages, the folders, the policies and the
simulated physics."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, entry_points, requires, version

import gymnasium as gym
import numpy as np
import typer

from cablebot_gym.envs import ENV_IDS
from cablebot_gym.physics.compiling import compiled_at_once
from cablebot_gym.physics.compiling.code_cache import REMEDY, code_folders
from cablebot_gym.physics.textbook import (
    holding_torque,
    normalised_action,
    static_torque,
)
from cablebot_gym.policies import ENTRY_POINT_GROUP, PolicyEntry
from cablebot_gym.robots import find_robot
from cablebot_gym.task import Task
from cablebot_gym.utils.console import results_console
from cablebot_gym.utils.files import CACHE_VARIABLE, cache_folder, is_writable_dir

PACKAGE = "cablebot-gym"

NO_EXTRAS = ("all", "docs", "test", "test-all")
"""Extras that are not reported: the union of the others, and those for developers."""

PAYLOAD = 1.5
"""Payload of the self-test [kg]."""

STEPS = 50
"""Length of the self-test [control steps]."""

TOLERANCE = 1e-9
"""Largest allowed motion in the self-test [m]. It covers rounding errors only."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one check."""

    name: str
    """Subject of the check."""
    ok: bool | None
    """Whether the check passed; None if it does not apply, for example because an extra is not
    installed."""
    text: str
    """Description of the result."""


def examine() -> Iterator[Finding]:
    """Runs all checks, one after the other. A check that raises is a fault, and the others
    follow."""
    checks: dict[str, Callable[[], Iterable[Finding]]] = {
        "python": _python,
        "packages": _packages,
        "compiled code": _compiled_code,
        "plans and best known payloads": _plans,
        "policies": _policies,
    }
    for env_id in ENV_IDS:
        checks[f"self-test {env_id}"] = partial(_statics_test, env_id)
    for name, check in checks.items():
        try:
            yield from check()
        except Exception as error:
            yield Finding(name=name, ok=False, text=f"{type(error).__name__}: {error}")


def _python() -> Iterator[Finding]:
    yield Finding(
        name="python",
        ok=True,
        text=f"{platform.python_version()} on {platform.platform(terse=True)}",
    )


def _packages() -> Iterator[Finding]:
    """One finding for the required packages, and one for each extra."""
    yield Finding(name=PACKAGE, ok=True, text=version(PACKAGE))
    required: dict[str, list[str]] = {}
    for line in requires(PACKAGE) or []:
        mark = re.search(r"extra == ['\"]([\w-]+)['\"]", line)
        required.setdefault(mark[1] if mark else "", []).append(
            re.split(r"[^\w.-]", line, maxsplit=1)[0]
        )
    for extra, names in required.items():
        if extra in NO_EXTRAS:
            continue
        versions = {name: _version(name) for name in names}
        missing = [name for name, number in versions.items() if number is None]
        text = ", ".join(
            f"{name} {number}" for name, number in versions.items() if number is not None
        )
        if missing:
            command = f"pip install '{PACKAGE}[{extra}]'" if extra else f"pip install {PACKAGE}"
            text = f"{', '.join(missing)} not installed. To install: {command}"
        ok = True if not missing else None if extra else False
        yield Finding(name=f"extra {extra}" if extra else "requirements", ok=ok, text=text)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _compiled_code() -> Iterator[Finding]:
    """The folders of compiled code."""
    folders = code_folders()
    files = [path for folder in folders for path in sorted(folder.glob("*.nbc"))]
    count = f"{len(files)} compiled files" if files else "no compiled files yet"
    is_usable = is_writable_dir(folders[-1])
    text = f"{', '.join(map(str, folders))}: {count}"
    if not is_usable:
        text += f". No cache folder is writable, so new code is not kept: {REMEDY}"
    yield Finding(name="compiled code", ok=is_usable or bool(files), text=text)


def _plans() -> Iterator[Finding]:
    folder = cache_folder()
    text = str(folder)
    is_usable = is_writable_dir(folder)
    if not is_usable:
        text += f" is not writable, so every process computes its content again: set {CACHE_VARIABLE} to another folder"
    yield Finding(name="plans and best known payloads", ok=is_usable, text=text)


def _policies() -> Iterator[Finding]:
    """One finding for each policy that fails to load for one of its environments, and one for all
    other policies."""
    names: list[str] = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            entry: PolicyEntry = point.load()
            for env_id in entry.env_ids:
                entry.factory(find_robot(env_id))
        except Exception as error:
            extra_missing = isinstance(error, ImportError) and f"pip install '{PACKAGE}[" in str(
                error
            )
            text = f"{type(error).__name__}: {error}"
            yield Finding(
                name=f"policy {point.name}", ok=None if extra_missing else False, text=text
            )
        else:
            names.append(point.name)
    yield Finding(
        name="policies", ok=bool(names), text=f"{len(names)} load: {', '.join(sorted(names))}"
    )


def _statics_test(env_id: str) -> Iterator[Finding]:
    """Applies the static torques of the textbook equations to the compiled plant, which must then
    stay at rest.

    Raises:
        ArithmeticError: if the platform moves.
    """
    kind = find_robot(env_id).kind
    env = gym.make(env_id, trajectory=f"dwell-{kind}", initial_error=0.0, payload=PAYLOAD)
    try:
        _, info = env.reset(seed=0)
        task: Task = env.unwrapped.task  # type: ignore[attr-defined]
        robot = task.robot
        pose = task.trajectory(0.0).position
        torque = holding_torque(robot, static_torque(robot, robot.mass + PAYLOAD, pose))
        action = normalised_action(robot, torque, np.zeros(robot.cables))
        with compiled_at_once():
            for _ in range(STEPS):
                _, _, _, _, info = env.step(action)
        distance = float(info["tracking_error_peak"])
    finally:
        env.close()
    if not distance <= TOLERANCE:
        raise ArithmeticError(
            f"the platform moves by {1e3 * distance:.3g} mm under static torques, so the compiled physics are wrong"
        )
    text = f"{PAYLOAD:g} kg at rest under static torques, within {1e3 * distance:.0e} mm"
    yield Finding(name=f"self-test {env_id}", ok=True, text=text)


def print_findings(findings: Iterable[Finding]) -> bool:
    """Prints each finding as it arrives. Returns whether no check failed."""
    console = results_console()
    all_ok = True
    for finding in findings:
        mark = {True: "ok  ", False: "BAD ", None: "–   "}[finding.ok]
        console.print(f"{mark}{finding.name}: {finding.text}", soft_wrap=True, highlight=False)
        all_ok &= finding.ok is not False
    return all_ok


def doctor() -> None:
    """Check installed packages, folders, policies and the simulated physics.

    The exit status is 1 if a check fails.

    Example: cablebot doctor
    """
    if not print_findings(examine()):
        raise typer.Exit(1)
