"""Motions by name, from files and from data."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_gym.motions.base import (
    COORDINATES,
    ORDERS,
    Trajectory,
    is_trajectory,
    sampled,
)
from cablebot_gym.motions.curves import (
    Dwell,
    Lemniscate,
    PaperCircle,
    PointToPoint,
    SmoothCircle,
)
from cablebot_gym.motions.loops import RandomLoop
from cablebot_gym.motions.sequences import DWELL, BetweenDwells
from cablebot_gym.motions.spline import Waypoints, is_waypoint_file, read_waypoints
from cablebot_gym.robots import COORDINATE_NAMES, Kind, Robot, find_robot
from cablebot_gym.utils.checks import mapping, number, unknown_name_error
from cablebot_gym.utils.files import check_not_a_file
from cablebot_gym.utils.imports import import_object
from cablebot_gym.utils.user_code import raised


def _between_dwells(make: Callable[..., Trajectory], **fields: Any) -> Callable[..., BetweenDwells]:
    """Factory of a motion between dwells. It accepts ``dwell`` and the fields of the motion as
    optional keywords."""
    make = partial(make, **fields)

    def between_dwells(*, dwell: float = DWELL, **fields: Any) -> BetweenDwells:
        return BetweenDwells(motion=make(**fields), dwell=dwell)

    # _fields_of reads the valid keywords from the signature.
    parameters = [*inspect.signature(make).parameters.values()]
    dwell = inspect.signature(between_dwells).parameters["dwell"]
    between_dwells.__signature__ = inspect.Signature([*parameters, dwell])  # type: ignore[attr-defined]
    return between_dwells


def _fields_of(name: Any) -> set[str]:
    """Fields of a named motion; empty if there is none of this name."""
    if is_waypoint_file(name):
        return {"duration", "dwell", "blend", "times", "poses"}
    if name not in TRAJECTORIES:
        return set()
    return set(inspect.signature(TRAJECTORIES[name]).parameters) - {"name"}


def _motions_of(
    kind: Kind,
    *,
    center: tuple[float, ...],
    circle: dict[str, Any],
    line: dict[str, Any],
    lemniscate: dict[str, Any],
    loop: dict[str, Any],
) -> dict[str, Callable[..., Trajectory]]:
    """Named motions of a kind, from the fields of their classes.

    Args:
        kind: kind of the robots.
        center: pose of the dwell, and center of the other motions that have no center of their own.
        circle: the circle. The smooth one takes twice its duration.
        line: the line.
        lemniscate: the lemniscate.
        loop: the random loops.
    """
    smooth_circle = circle | {"duration": 2 * circle["duration"]}
    motions: dict[str, Callable[..., Trajectory]] = {}
    for motion, make, own_fields in (
        ("circle", PaperCircle, circle),
        ("smooth-circle", SmoothCircle, smooth_circle),
        ("line", PointToPoint, line),
        ("lemniscate", Lemniscate, lemniscate),
        ("loop", RandomLoop, loop),
    ):
        fields = own_fields
        if motion != "line":
            fields = {"center": center} | own_fields
        name = f"{motion}-{kind}"
        motions[name] = _between_dwells(make, name=name, **fields)
    motions[f"dwell-{kind}"] = partial(Dwell, name=f"dwell-{kind}", pose=center)
    return motions


_PLANAR_CIRCLE: dict[str, Any] = {"radius": 0.2165, "center": (0.0, 0.0), "duration": 1.0}
"""Table 1."""
_SPATIAL_CIRCLE: dict[str, Any] = {
    "radius": 0.1,
    "center": (0.0, 0.0, 0.1, 0.1, 0.1, 0.1),
    "duration": 1.0,
}
"""Table 3."""
_LEVEL = (0.0, 0.0, 0.0)

TRAJECTORIES: dict[str, Callable[..., Trajectory]] = {
    # The loops have about the radii of the paper's circles, and their accelerations are above those
    # of the circles (35 and 16 m/s²). Loops in space start low, where motors hold more at
    # rest than the cables carry along the motion: this payload measures the dynamics. For the same
    # reason they are level on average and their reach in depth and tilt is small, in which the
    # tensions at rest change fast.
    **_motions_of(
        "planar",
        center=(0.0, 0.0),
        circle=_PLANAR_CIRCLE,
        line={"start": (-0.1, -0.1), "end": (0.1, 0.15)},
        lemniscate={"amplitude": (0.2, 0.1)},
        loop={
            "start": (0.0, 0.0),
            "reach": (0.2165,),
            "acceleration": (36.0,),
        },
    ),
    **_motions_of(
        "spatial",
        center=(0.0, 0.0, 0.1, *_LEVEL),
        circle=_SPATIAL_CIRCLE,
        line={"start": (-0.05, -0.05, 0.1, *_LEVEL), "end": (0.05, 0.05, 0.15, 0.05, 0.05, 0.05)},
        lemniscate={"amplitude": (0.1, 0.05)},
        loop={
            "center": (0.0, 0.0, 0.115, *_LEVEL),
            "start": (0.0, 0.0, 0.2, *_LEVEL),
            "reach": (0.11, 0.005, 0.01),
            "acceleration": (22.0, 5.0, 8.0),
        },
    ),
    # Sized for the robots of the environments, stadium-camera and ttk4900.
    **_motions_of(
        "point",
        center=(0.0, 0.0, -12.0),
        circle={"radius": 10.0, "duration": 10.0},
        line={"start": (-10.0, -5.0, -10.0), "end": (10.0, 5.0, -14.0), "duration": 10.0},
        lemniscate={"amplitude": (10.0, 5.0), "duration": 20.0},
        loop={
            "start": (0.0, 0.0, -6.0),
            "reach": (2.0, 0.2),
            "acceleration": (9.0, 4.0),
        },
    ),
    **_motions_of(
        "planar-platform",
        center=_LEVEL,
        circle={"radius": 0.15, "duration": 4.0},
        line={"start": (-0.15, -0.075, -0.05), "end": (0.15, 0.075, 0.05), "duration": 4.0},
        lemniscate={"amplitude": (0.15, 0.075), "duration": 8.0},
        loop={
            "start": (0.0, 0.15, 0.0),
            "reach": (0.15, 0.02),
            "acceleration": (25.0, 30.0),
        },
    ),
    "paper-planar": partial(PaperCircle, name="paper-planar", **_PLANAR_CIRCLE),
    "paper-spatial": partial(PaperCircle, name="paper-spatial", **_SPATIAL_CIRCLE),
}
"""Factories of the named motions. Each accepts the fields of its class as optional keywords, and
``dwell`` if the motion is :class:`~cablebot_gym.motions.sequences.BetweenDwells`: all except
``paper-…``, the paper's circles as printed, and ``dwell-…``."""


def random_loop(kind: str, seed: int) -> Trajectory:
    """The random loop of a seed between dwells, for a kind of robots."""
    return find_trajectory({"name": f"loop-{kind}", "seed": seed}, kind)


def trajectory_names(kind: Robot | int | str | None = None) -> list[str]:
    """Names in :data:`TRAJECTORIES`.

    Args:
        kind: restricts the names to this kind of robot, or to robots with this number of
            coordinates; None for all.
    """
    if kind is None:
        return list(TRAJECTORIES)
    kinds = _kinds(kind)
    return [name for name in TRAJECTORIES if _kind_of(name) in kinds]


def _kind_of(name: str) -> Kind:
    """Kind of robots of a named motion: the longest one that ends its name."""
    return max((kind for kind in COORDINATES if name.endswith(f"-{kind}")), key=len)


def _kinds(kind: Any) -> list[Kind]:
    """The kind, that of the robot, or the kinds with this number of coordinates."""
    kinds = [name for name, n in COORDINATES.items() if kind in (name, n)]
    return kinds or [find_robot(kind).kind]


def find_trajectory(
    trajectory: str | Path | Mapping[str, Any] | Trajectory, kind: Robot | int | str
) -> Trajectory:
    """A trajectory for a robot from a name, from a dict with a name and fields, or from a
    trajectory object.

    Args:
        trajectory: a name of :func:`trajectory_names`, JSON-able data such as ``{"name":
            "circle-spatial", "duration": 1.5, "dwell": 0.5}``, where ``duration`` is that of the
            motion between the dwells, an object that satisfies
            :class:`~cablebot_gym.motions.base.Trajectory`, or the place of one:
            ``file.py:name`` or ``package.module:name``. The object there may also be a
            function or a class that makes the trajectory without arguments. ``file.csv`` has
            waypoints, see :class:`~cablebot_gym.motions.spline.Waypoints` and its ``blend``,
            with dwells as the named motions; its columns are ``t`` [s] and the coordinates [m, rad]. Without ``t`` it
            needs a duration: ``{"name": "file.csv", "duration": 4.0}``.
        kind: the robot, as for :func:`~cablebot_gym.robots.names.find_robot`, its kind, or its
            number of coordinates n.

    Raises:
        ValueError: if the name, a field or a value is invalid, or the trajectory is for another
            kind of robot.
    """
    kinds = _kinds(kind)
    coordinates = COORDINATES[kinds[0]]
    if isinstance(trajectory, Path):
        trajectory = str(trajectory)
    if isinstance(trajectory, str) and (":" in trajectory or trajectory.endswith(".py")):
        trajectory = _imported(trajectory)
    elif isinstance(trajectory, str):
        trajectory = {"name": trajectory}
    if isinstance(trajectory, Mapping):
        trajectory = _named(dict(trajectory), kinds)
    elif not is_trajectory(trajectory):
        forms = ", a dict with one of these as 'name', or pass a Trajectory"
        raise unknown_name_error("trajectory", trajectory, trajectory_names(kind), forms)
    number("duration", trajectory.duration, above=0, unit="s")
    if trajectory.coordinates != coordinates:
        raise ValueError(
            f"{trajectory.name!r} has {trajectory.coordinates} coordinates and the robot has {coordinates}"
        )
    return trajectory


def _named(fields: dict[str, Any], kinds: list[Kind]) -> Trajectory:
    """The motion with the name and the fields in a dict, for one of the kinds.

    Raises:
        ValueError: if the name, a field or a value is invalid, or the motion is for another kind.
    """
    name = fields.pop("name", None)
    if is_waypoint_file(name):
        mapping("trajectory", fields, sorted(_fields_of(name)))
        return _between_waypoints(str(name), kinds, **fields)
    if isinstance(name, str) and name in TRAJECTORIES and _kind_of(name) in kinds:
        mapping("trajectory", fields, sorted(_fields_of(name)))
        motion = TRAJECTORIES[name](**fields)
        if motion.coordinates == COORDINATES[kinds[0]]:
            return motion
    check_not_a_file(
        "trajectory", name, "file.py:name, or a .csv file; of a .json file, pass the data in Python"
    )
    names = dict.fromkeys(valid for kind in kinds for valid in trajectory_names(kind))
    raise unknown_name_error("trajectory", name, names)


def _between_waypoints(
    name: str,
    kinds: list[Kind],
    *,
    duration: float | None = None,
    dwell: float = DWELL,
    blend: float = 0.0,
    times: Any = None,
    poses: Any = None,
) -> BetweenDwells:
    """The motion through the waypoints of a file between dwells, or through ``poses``, so that
    stored data suffice.

    The duration scales the times of the file.
    """
    if poses is None:
        times, poses = read_waypoints(Path(name), [COORDINATE_NAMES[kind] for kind in kinds])
        if times is None:
            times = np.arange(len(poses))
            if duration is None:
                raise ValueError(
                    f'trajectory file {name!r} has no column t. Add it, or give a duration: {{"name": "{name}", '
                    '"duration": 4}'
                )
        if duration is not None:
            times = times / times[-1] * number("duration", duration, above=0, unit="s")
    motion = Waypoints(name=Path(name).name, times=times, poses=poses, blend=blend)
    return BetweenDwells(motion=motion, dwell=dwell)


@cache
def _imported(name: str) -> Trajectory:
    """The trajectory at ``file.py:name`` or ``package.module:name``; the same object in all calls.

    Raises:
        ValueError: if there is no such object, its code raises, or it neither is nor makes a
            trajectory.
    """
    try:
        trajectory = import_object(name)
        if callable(trajectory) and not is_trajectory(trajectory):
            trajectory = trajectory()
    except (ValueError, ImportError, KeyboardInterrupt):
        raise
    except BaseException as error:
        remedy = "Name a Trajectory, or a function without arguments that returns one"
        raise ValueError(f"trajectory {name!r}: {raised(error)}. {remedy}") from error
    if not is_trajectory(trajectory):
        raise ValueError(
            f"trajectory {name!r} gives {trajectory!r}, which is no Trajectory: an object with name, duration, "
            "coordinates and a call that returns a Reference"
        )
    sampled(trajectory, np.array([0.0, trajectory.duration]), ORDERS[:3])
    return trajectory
