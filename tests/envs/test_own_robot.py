"""Defaults of a robot that brings none: motion, error bounds, end of the scan; and a start that is
not held."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.episodes import PLANAR as PLANAR_ID

from cablebot_gym.bounds.robot_check import check_motion
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.robots import PLANAR, Defaults, Motors, Robot, find_robot
from cablebot_gym.task import find_error_bounds
from cablebot_gym.trajectories import find_trajectory

CORNERS = ((-2.0, -1.0), (2.0, -1.0), (2.0, 1.5), (-2.0, 1.5))
BASE = Robot(
    name="mine",
    base_anchors=CORNERS,
    mass=3.0,
    motors=Motors(stall_torque=4.0, free_speed=100.0),
    transmission=PLANAR.transmission,
    home_pose=(0.2, 0.3),
)
HANGING = BASE.replace(
    base_anchors=[(*corner, -3.0) for corner in CORNERS], home_pose=(0.2, 0.3, -1.0)
)
ROBOTS = {
    "planar": BASE,
    "vertical": BASE.replace(plane="vertical"),
    "point": HANGING,
    "platform": find_robot("ttk4900").replace(defaults=Defaults()),
    "fast": find_robot("fast").replace(defaults=Defaults()),
}
"""Robots without data of their motion, by kind and size: from 1.5 m to 600 m."""


@pytest.mark.parametrize("name", ROBOTS)
def test_default_motion_is_smooth_and_within_the_limits(name):
    """And the scan of payloads covers that of exact tracking."""
    robot = ROBOTS[name]
    check = check_motion(robot)  # raises if the motion leaves the workspace
    assert check.limit.least <= 0 < check.limit.largest
    top = default_payload_max(robot, check.trajectory, check.error_bounds)
    assert check.limit.largest < top < 60 * max(robot.mass, check.limit.largest)
    reference = check.trajectory(np.linspace(0, check.trajectory.duration, 101))
    assert_allclose(reference.position[[0, -1]], [robot.home, robot.home], atol=1e-12)
    widths = [np.ptp(poses, axis=0)[:2].min() for poses in (reference.position, robot.pose_bounds)]
    assert widths[0] > 0.01 * widths[1]
    for order in ("velocity", "acceleration", "jerk", "snap"):
        assert np.abs(getattr(reference, order)[[0, -1]]).max() < 1e-9


@pytest.mark.parametrize("construct", [gym.make, gym.make_vec])
def test_start_that_the_motors_cannot_hold_is_a_warning(construct):
    construct(PLANAR_ID, robot=BASE.to_dict()).reset(seed=0)  # without a warning
    motors = BASE.motors.replace(stall_torque=0.3)
    weak = BASE.replace(name=construct.__name__, plane="vertical", motors=motors)
    message = r"cannot be held at the start of .*: no tensions from 1 N to 6 N .* All episodes fail"
    with pytest.warns(UserWarning, match=message):
        construct(fitting_env_id(weak), robot=weak)


SMALL = PLANAR.replace(
    base_anchors=(0.3 * PLANAR.base).tolist(),
    transmission=PLANAR.transmission.replace(pulley_radius=0.01),
)


@pytest.mark.parametrize(
    ("robot", "position"),
    [
        (PLANAR, 0.01),
        (ROBOTS["fast"], 0.5),
        (SMALL, 0.002),
        (SMALL.replace(defaults=Defaults(error_bounds={"position": 0.003})), 0.003),
    ],
)
def test_position_bound_follows_from_the_width(robot, position):
    assert find_error_bounds(None, robot).position == position


@pytest.mark.parametrize(
    ("robot", "top"),
    [
        (PLANAR, 10.0),
        (find_robot("cogiro"), 1500.0),
        (PLANAR.replace(motors=PLANAR.motors.replace(stall_torque=20.0)), 52.0),
    ],
)
def test_scan_ends_at_the_range_or_at_what_the_motors_hold(robot, top):
    motion = find_trajectory(default_trajectory(robot), robot.kind)
    assert default_payload_max(robot, motion, find_error_bounds(None, robot)) == top
