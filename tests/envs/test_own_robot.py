"""Defaults of a robot that brings none: motion, error bounds, end of the scan; and a start that is not held."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.bounds.robot_check import check_motion
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL, Defaults, Motors, Robot, find_robot
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
HANGING = BASE.replace(base_anchors=[(*corner, -3.0) for corner in CORNERS], home_pose=(0.2, 0.3, -1.0))
SWAPPED = find_robot("ttk4900").replace(defaults=Defaults())
SCALED = SPATIAL.replace(
    base_anchors=(3 * SPATIAL.base).tolist(),
    platform_anchors=(3 * SPATIAL.platform).tolist(),
    home_pose=(0, 0, 1.0, 0, 0, 0),
)
OWN = {
    "planar": BASE,
    "vertical": BASE.replace(plane="vertical"),
    "point": HANGING,
    "platform": SWAPPED,
    "spatial": SCALED,
    "camera": find_robot("stadium-camera").replace(defaults=Defaults()),
    "fast": find_robot("fast").replace(defaults=Defaults()),
}
"""Robots without data of their motion, by kind and size: from 1.5 m to 600 m."""

each_own = pytest.mark.parametrize("name", OWN)


@each_own
def test_default_motion_is_a_smooth_move_that_the_motors_can_follow(name):
    robot = OWN[name]
    check = check_motion(robot)  # raises if the motion leaves the workspace
    assert check.limit.least <= 0 < check.limit.largest
    reference = check.trajectory(np.linspace(0, check.trajectory.duration, 101))
    np.testing.assert_allclose(reference.position[[0, -1]], [robot.home, robot.home], atol=1e-12)
    assert np.ptp(reference.position, axis=0)[:2].min() > 0.01 * np.ptp(robot.pose_bounds, axis=0)[:2].min()
    for order in ("velocity", "acceleration", "jerk", "snap"):
        assert np.abs(getattr(reference, order)[[0, -1]]).max() < 1e-9


def test_motion_of_a_robot_comes_before_that_of_the_paper_and_the_lemniscate():
    own = Defaults(trajectory="smooth-circle-planar")
    robots = [PLANAR.replace(defaults=own), PLANAR.replace(mass=2.0), BASE]
    assert [find_trajectory(default_trajectory(robot), "planar").name for robot in robots] == [
        *("smooth-circle-planar", "circle-planar", "lemniscate-planar")
    ]


def test_robot_that_cannot_move_dwells():
    weak = HANGING.replace(motors=HANGING.motors.replace(stall_torque=0.1))
    assert default_trajectory(weak) == {"name": "dwell-point", "pose": [0.2, 0.3, -1.0]}


def test_episode_of_an_own_robot_does_not_end_at_its_first_step():
    env = gym.make("CableBot-Planar-v0", robot=BASE.to_dict())
    with warnings.catch_warnings(action="error"):
        env.reset(seed=0)
    _, _, terminated, truncated, info = env.step(np.zeros(4))
    assert (terminated, truncated, info["termination_reason"]) == (False, False, 0)


@pytest.mark.parametrize("make", [gym.make, gym.make_vec], ids=["single", "vector"])
def test_start_that_the_motors_cannot_hold_is_a_warning(make):
    weak = BASE.replace(name=make.__name__, plane="vertical", motors=BASE.motors.replace(stall_torque=0.3))
    with pytest.warns(UserWarning, match=r"cannot be held at the start of .*: motor \d needs .* All episodes fail"):
        make(fitting_env_id(weak), robot=weak)


def test_motion_outside_the_workspace_raises():
    far = {"name": "lemniscate-planar", "amplitude": [3.0, 0.1]}
    with pytest.raises(ValueError, match="leaves the workspace of 'mine'"):
        gym.make("CableBot-Planar-v0", robot=BASE, trajectory=far)
    env = gym.make("CableBot-Planar-v0", robot=BASE)
    with pytest.raises(ValueError, match="leaves the workspace of 'mine'"):
        env.reset(options={"trajectory": far})


@pytest.mark.parametrize(
    ("robot", "position"),
    [(PLANAR, 0.01), (SPATIAL, 0.01), (BASE, 0.01), (OWN["camera"], 0.1), (OWN["fast"], 0.5)],
)
def test_position_bound_follows_from_the_width(robot, position):
    assert find_error_bounds(None, robot).position == position
    small = PLANAR.replace(
        base_anchors=(0.3 * PLANAR.base).tolist(), transmission=PLANAR.transmission.replace(pulley_radius=0.01)
    )
    assert find_error_bounds(None, small).position == 0.002
    assert find_error_bounds(None, small.replace(defaults=Defaults(error_bounds={"position": 0.003}))).position == 0.003


@pytest.mark.parametrize(
    ("robot", "top"),
    [
        (PLANAR, 10.0),
        (SPATIAL, 20.0),
        (FLEX_SPATIAL.replace(transmission=FLEX_SPATIAL.transmission.replace(stiffness=9.0)), 20.0),  # as in maps
        (find_robot("cogiro"), 1500.0),
        (PLANAR.replace(motors=PLANAR.motors.replace(stall_torque=20.0)), 52.0),
    ],
)
def test_scan_ends_at_the_range_or_at_what_the_motors_hold(robot, top):
    motion = find_trajectory(default_trajectory(robot), robot.kind)
    assert default_payload_max(robot, motion, find_error_bounds(None, robot)) == top


@each_own
def test_scan_of_an_own_robot_covers_exact_tracking(name):
    robot = OWN[name]
    check = check_motion(robot)
    top = default_payload_max(robot, check.trajectory, check.error_bounds)
    assert check.limit.largest < top < 60 * max(robot.mass, check.limit.largest)
