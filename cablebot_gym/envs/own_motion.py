"""Default motion of a robot without one: a lemniscate about its home pose, sized by its workspace
and its motors."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from cablebot_gym.motions import Reference, find_trajectory
from cablebot_gym.physics.statics import payload_interval, resting
from cablebot_gym.robots import Robot

FRACTIONS = (0.5, 0.25, 0.12, 0.06, 0.03)
"""Tried widths of the lemniscate, as fractions of the distance from the home pose to the border of
the workspace."""

DURATIONS = tuple(np.geomspace(1.0, 60.0, 24).tolist())
"""Tried durations of the lemniscate [s]."""

_SAMPLES = 101
"""Number of checked instants."""


def own_motion(robot: Robot) -> dict[str, Any]:
    """Data of the default motion of a robot that has none, for
    :func:`~cablebot_gym.motions.names.find_trajectory`.

    It is the widest lemniscate of :data:`FRACTIONS` on which the motors hold half of the payload
    that they hold at the home pose, in the shortest of :data:`DURATIONS` in which they move half of
    that, at most the mass of the platform. The lemniscate is smooth up to the fourth derivative, as
    robots with springs need it. If there is none, the robot dwells at its home pose.
    """
    return dict(_own_motion(robot))


@lru_cache(maxsize=64)
def _own_motion(robot: Robot) -> dict[str, Any]:
    home = robot.home[None]
    least, at_home = payload_interval(robot, resting(home))
    if least <= 0 < at_home:
        for motion in _lemniscates(robot):
            path = _reference(motion, robot)
            least, held = payload_interval(robot, resting(path.position))
            if least > 0 or held < at_home / 2:
                continue
            for duration in DURATIONS:
                motion["duration"] = float(f"{duration:.2g}")
                least, moved = payload_interval(robot, _reference(motion, robot))
                if least <= 0 and moved >= min(held / 2, robot.mass):
                    return motion
    return {"name": f"dwell-{robot.kind}", "pose": list(robot.home_pose)}


def _lemniscates(robot: Robot) -> Iterator[dict[str, Any]]:
    """Lemniscates about the home pose, the widest one first; none if the home pose is at the border
    of x or y."""
    low, high = robot.pose_bounds
    clearance = np.minimum(high - robot.home, robot.home - low)[:2]
    if clearance.min() <= 0:
        return
    for fraction in FRACTIONS:
        width, height = fraction * clearance * (1.0, 0.5)
        amplitude = [float(f"{width:.2g}"), float(f"{height:.2g}")]
        yield {
            "name": f"lemniscate-{robot.kind}",
            "amplitude": amplitude,
            "center": list(robot.home_pose),
        }


def _reference(motion: dict[str, Any], robot: Robot) -> Reference:
    trajectory = find_trajectory(motion, robot.kind)
    return trajectory(np.linspace(0.0, trajectory.duration, _SAMPLES))
