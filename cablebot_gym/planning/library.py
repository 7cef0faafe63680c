"""Plans that have been made once are kept: in memory, and on disk by a hash of all that they depend on."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_gym.planning.motion import Margins, PlannedMotion
from cablebot_gym.planning.program import MotionProgram
from cablebot_gym.planning.stage_functions import import_casadi
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits, as_plain
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.files import write_whole

CACHE_VARIABLE = "CABLEBOT_CACHE"
"""Environment variable that names another folder for the cache."""

_SAMPLES = 1000.0
"""Instants per second at which a reference is told apart from others [Hz]."""


def cache_folder() -> Path:
    """Where plans and best payloads are kept: ``$CABLEBOT_CACHE``, or ``cablebot_gym`` in the user's cache folder."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "cablebot_gym"


def fingerprint(module: str, robot: Robot, trajectory: Trajectory, **more: Any) -> str:
    """Of a robot, of what a reference does, of further data, and of the code and solver that plan from them.

    Args:
        module: that plans; what it imports counts too.
        robot: nominal.
        trajectory: the reference, told apart by what it does.
        more: JSON-able data, or dataclasses of them.
    """
    times = np.arange(round(trajectory.duration * _SAMPLES) + 1) / _SAMPLES
    reference = trajectory(times)
    plain = {name: as_plain(value) for name, value in more.items()}
    data = [robot.to_dict(), trajectory.name, trajectory.duration, plain, source_hash(module), _versions()]
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
    for values in (reference.position, reference.velocity):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:24]


def _versions() -> list[str]:
    return [platform.python_version(), *(version(name) for name in ("casadi", "numpy", "scipy", "numba"))]


def kept(name: str, read: Callable[[bytes], Any], make: Callable[[], Any], write: Callable[[Any], bytes]) -> Any:
    """What a file of the cache holds, or what ``make`` returns, which is then kept as ``write`` has it.

    A file that cannot be read is made anew; a folder that cannot be written to keeps nothing.
    """
    if (there := known(name, read)) is not None:
        return there
    made = make()
    data = write(made)
    with suppress(OSError):
        write_whole(cache_folder() / name, lambda temporary: _write(temporary, data))
    return made


def known(name: str, read: Callable[[bytes], Any]) -> Any:
    """What a file of the cache holds, which ``read`` makes of its bytes.

    None if it is not there, half a file, or something else by that name.
    """
    with suppress(Exception):
        return read((cache_folder() / name).read_bytes())
    return None


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def planned(
    robot: Robot,
    trajectory: Trajectory,
    limits: Limits,
    *,
    intervals: int,
    margins: Margins | None = None,
    lightest: float | None = None,
    period: float = 0.0,
) -> PlannedMotion:
    """The motion of a :class:`~cablebot_gym.planning.program.MotionProgram`, made once and kept; arguments as there.

    Raises:
        Infeasible: if there is no motion inside the limits.
        ImportError: if CasADi is missing.
    """
    import_casadi()
    margins = margins or Margins()
    settings = {"limits": limits, "margins": margins, "intervals": intervals, "lightest": lightest, "period": period}
    key = fingerprint("cablebot_gym.planning.program", robot, trajectory, **settings)

    def make() -> PlannedMotion:
        program = MotionProgram(
            robot, trajectory, limits, intervals=intervals, margins=margins, lightest=lightest, period=period
        )
        return program.solve()

    plan: PlannedMotion = kept(f"plan-{key}.npz", _read_plan, make, _plan_bytes)
    return plan


def _plan_bytes(plan: PlannedMotion) -> bytes:
    buffer = BytesIO()
    np.savez(buffer, **plan.to_arrays())  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_plan(data: bytes) -> PlannedMotion:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        return PlannedMotion.from_arrays(file)
