"""Motions that leave the workspace raise before an episode starts, and the start pose."""

import contextlib
import re
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cablebot_gym.bounds.robot_check import check_motion
from cablebot_gym.envs.settings import make_settings
from cablebot_gym.motions import BetweenDwells, Dwell, Waypoints, find_trajectory
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds, at_rest, check_workspace, start_pose


@pytest.mark.parametrize("coordinate", range(6))
def test_motion_may_leave_the_workspace_by_the_error_bounds(coordinate):
    """A bound of another coordinate, or one side of the workspace alone."""
    motion = find_trajectory("paper-spatial", 6)
    poses = motion(np.linspace(0.0, motion.duration, 2001)).position
    bounds = ErrorBounds(position=0.01, rotation=0.02)
    fields = {
        "name": "box",
        "kind": "spatial",
        "dimensions": 3,
        "coordinates": 6,
        "weightless": True,
    }
    for side in (0, 1):
        for beyond, fits in ((0.0, True), (0.005, True), (0.015, coordinate >= 3), (0.03, False)):
            box = np.array([poses.min(axis=0), poses.max(axis=0)])
            box[side, coordinate] += beyond * (1 - 2 * side)
            robot = SimpleNamespace(**fields, pose_bounds=box)
            with contextlib.nullcontext() if fits else pytest.raises(ValueError, match="leaves"):
                check_workspace(robot, motion, bounds)


HALL = SPATIAL.replace(base_anchors=SPATIAL.base - [0, 0, 3], home_pose=(0, 0, -1.5, 0, 0, 0))
WIDE = HALL.replace(workspace=(*[(-2, 2)] * 2, (-3, 3), *[(-1, 1)] * 3))
FAR = PLANAR.replace(home_pose=(0.3, -0.1), workspace=((-0.4, 0.4), (-0.2, 0.2)))
SQUARE = ((0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1), (0, 0))


def square(blend):
    return BetweenDwells(motion=Waypoints(times=range(5), poses=SQUARE, blend=blend))


def at(*pose):
    return Dwell(pose=(*pose, 0, 0))


@pytest.mark.parametrize(
    ("robot", "motion", "message"),
    [
        (HALL, at(0, 0, 1.5, 0), "z points down here. If it points up"),
        (HALL, at(5, 0, -1.5, 0), "change the motion or the workspace"),
        (HALL, at(0, 0, -1.5, 5), "multiply degrees by π/180"),
        (HALL, at(0, 0, -1500, 0), "divide millimetres by 1000"),
        (WIDE, at(0, 0, 1.5, 0), "3 m from home_pose: is it mirrored"),
        (WIDE, at(1, 2, -2.5, 0), "^$"),
        (FAR, Dwell(pose=(-0.2, 0)), "is it in the base frame of 'planar'"),
        (PLANAR, square(0.0), 'by 61.22 mm, 2.56 s after its start, .*give it "blend": 0.5'),
        (PLANAR, square(0.5), "^$"),
    ],
)
def test_motion_of_another_frame_or_unit_is_questioned(robot, motion, message):
    """A robot check said what the robot carries below the floor."""
    try:
        text = " ".join(check_motion(robot, trajectory=motion).questions)
    except ValueError as error:
        text = str(error)
    assert re.search(message, text)


def test_environment_refuses_what_a_check_refuses_and_warns_where_it_asks():
    place = r"leaves the workspace of 'planar' at t = 0.000 s: x = 3 "
    with pytest.raises(ValueError, match=place):
        make_settings(robot=PLANAR, count=1, trajectory=Dwell(pose=(3, 0)))
    with pytest.warns(UserWarning, match="leaves the lines between its waypoints"):
        make_settings(robot=PLANAR, count=1, trajectory=square(0.0))


# --- the start of an episode --------------------------------------------------------------------------------------


@pytest.mark.parametrize("position", [0.01, 0.3])
@pytest.mark.parametrize(
    ("robot", "trajectory", "rests"),
    [
        (SPATIAL, "circle-spatial", True),
        (FLEX_SPATIAL, {"name": "loop-spatial", "seed": 10_003}, True),
        (SPATIAL, {"name": "line-spatial", "dwell": 0}, True),
        (SPATIAL, {"name": "circle-spatial", "dwell": 0}, False),
        (SPATIAL, "paper-spatial", False),
        (PLANAR, "circle-planar", True),
    ],
)
def test_spatial_robots_start_lower_than_a_motion_at_rest(robot, trajectory, rests, position):
    """By half the position bound, at most 50 mm."""
    motion = find_trajectory(trajectory, robot.coordinates)
    start = motion(0.0)
    expected = start.position.copy()
    if rests and not robot.planar:
        expected[2] += min(position / 2, 0.05)
    assert_array_equal(start_pose(robot, motion, ErrorBounds(position=position)), expected)
    assert at_rest(start) == rests
