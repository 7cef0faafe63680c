"""Defaults of a robot that brings none: error bounds, end of the scan; and a start that is not
held."""

import gymnasium as gym
import pytest

from cablebot_gym.envs import fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, Defaults, find_robot
from cablebot_gym.task import find_error_bounds


def test_start_that_the_motors_cannot_hold_is_a_warning():
    """That ``gym.make`` warns of no other start, the random robots test."""
    motors = PLANAR.motors.replace(stall_torque=0.3)
    weak = PLANAR.replace(name="mine", plane="vertical", motors=motors)
    message = r"cannot be held at the start of .*: its motors are too weak\. All episodes fail"
    with pytest.warns(UserWarning, match=message):
        gym.make_vec(fitting_env_id(weak), robot=weak)


def test_least_tension_follows_strength_and_weight():
    weak = PLANAR.replace(maximum_tension=20.0)
    light = find_robot("stadium-camera").replace(mass=0.1, minimum_tension=0.0)
    least = [textbook.allocated_minimum(robot) for robot in (PLANAR, weak, light)]
    assert least == [5.0, 2.0, pytest.approx(0.50633, abs=1e-5)]  # half of the tensions at home


SMALL = PLANAR.replace(
    base_anchors=(0.3 * PLANAR.base).tolist(),
    transmission=PLANAR.transmission.replace(pulley_radius=0.01),
)


@pytest.mark.parametrize(
    ("robot", "position"),
    [
        (PLANAR, 0.01),
        (find_robot("fast").replace(defaults=Defaults()), 0.5),
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
