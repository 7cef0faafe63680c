"""Cache of plans on disk. The file name contains a hash of everything that a plan depends on."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from typing import Any

import numpy as np

from cablebot_gym.motions import Trajectory
from cablebot_gym.planning.motion import PlannedMotion
from cablebot_gym.robots import Robot
from cablebot_gym.task import to_jsonable
from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.files import atomic_write, cache_folder, read_cached

_SAMPLES = 1000.0
"""Rate at which the fingerprint samples a reference [Hz]."""


def fingerprint(module: str, robot: Robot, trajectory: Trajectory, **more: Any) -> str:
    """Hash of a robot, a reference, further data, the code and the versions of Python and of the
    solver.

    Args:
        module: module that uses the data; the hash includes its code and its imports.
        robot: nominal robot.
        trajectory: reference motion; the hash includes its sampled poses and velocities.
        more: JSON-able data or dataclasses.
    """
    times = np.arange(round(trajectory.duration * _SAMPLES) + 1) / _SAMPLES
    reference = trajectory(times)
    plain = {name: to_jsonable(value) for name, value in more.items()}
    data = [
        robot.to_dict(),
        trajectory.name,
        trajectory.duration,
        plain,
        source_hash(module),
        _versions(),
    ]
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
    for values in (reference.position, reference.velocity):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:24]


def _versions() -> list[str]:
    """Versions of Python and of the packages that plan, of which CasADi may be missing."""
    versions = [platform.python_version()]
    for name in ("casadi", "numpy", "scipy", "numba"):
        with suppress(PackageNotFoundError):
            versions.append(version(name))
    return versions


def load_or_compute(
    name: str, read: Callable[[bytes], Any], make: Callable[[], Any], write: Callable[[Any], bytes]
) -> Any:
    """The cached value of a file, or the value of ``make``, which is then written to the cache.

    A damaged file is replaced. If the folder is not writable, nothing is cached.

    Args:
        name: file name in the cache folder.
        read: decodes the bytes of the file.
        make: computes the value.
        write: encodes the value as bytes.
    """
    path = cache_folder() / name
    stored = read_cached(path, read)
    if stored is not None:
        return stored
    value = make()
    data = write(value)
    with suppress(OSError):
        atomic_write(path, lambda temporary: temporary.write_bytes(data))
    return value


def cached_plan(
    module: str,
    robot: Robot,
    trajectory: Trajectory,
    make: Callable[[], PlannedMotion],
    **more: Any,
) -> PlannedMotion:
    """The cached plan of a robot and a reference.

    Args:
        module: module that makes the plan; a change of its code or its imports makes it again.
        robot: nominal robot.
        trajectory: reference motion.
        make: makes the plan.
        more: further data on which it depends, see :func:`fingerprint`.
    """
    name = _plan_file(module, robot, trajectory, **more)
    plan: PlannedMotion = load_or_compute(name, _read_plan, make, _plan_bytes)
    return plan


def stored_plan(
    module: str, robot: Robot, trajectory: Trajectory, **more: Any
) -> PlannedMotion | None:
    """The plan that :func:`cached_plan` would read; None if the cache does not have it."""
    return read_cached(cache_folder() / _plan_file(module, robot, trajectory, **more), _read_plan)


def _plan_file(module: str, robot: Robot, trajectory: Trajectory, **more: Any) -> str:
    return f"plan-{fingerprint(module, robot, trajectory, **more)}.npz"


def _plan_bytes(plan: PlannedMotion) -> bytes:
    buffer = BytesIO()
    np.savez(buffer, **plan.to_arrays())  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_plan(data: bytes) -> PlannedMotion:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        return PlannedMotion.from_arrays(file)
