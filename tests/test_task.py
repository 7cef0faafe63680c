"""Motions that leave the workspace raise before an episode starts, and the start pose."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds, Task, check_workspace
from cablebot_gym.trajectories import find_trajectory, held_out_seeds

PLANAR_ID = "CableBot-Planar-v0"
OUTSIDE = {"name": "smooth-circle-planar", "radius": 3.0}


@pytest.mark.parametrize("fly", [evaluate_dlcc, record_rollout])
def test_motion_outside_the_workspace_raises(fly):
    with pytest.raises(
        ValueError,
        match=r"'smooth-circle-planar' leaves the workspace of 'planar' at t = 0.000 s: x = 3 ",
    ):
        fly("fl", PLANAR_ID, trajectory=OUTSIDE)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("coordinate", range(6))
def test_motion_may_leave_the_workspace_by_the_error_bounds(coordinate, side):
    """A bound of another coordinate, or one side of the workspace alone."""
    motion = find_trajectory("paper-spatial", 6)
    poses = motion(np.linspace(0.0, motion.duration, 2001)).position
    error_bounds = ErrorBounds(position=0.01, rotation=0.02)

    def fits(beyond, *bounds):
        box = np.array([poses.min(axis=0), poses.max(axis=0)])
        box[side, coordinate] += beyond * (1 - 2 * side)
        robot = SimpleNamespace(
            name="box",
            kind="spatial",
            dimensions=3,
            coordinates=6,
            pose_bounds=box,
        )
        with contextlib.suppress(ValueError):
            check_workspace(robot, motion, *bounds)
            return True
        return False

    assert fits(0.0)
    assert not fits(0.005)
    assert fits(0.005, error_bounds)
    assert fits(0.015, error_bounds) == (coordinate >= 3)
    assert not fits(0.03, error_bounds)


# --- the start of an episode --------------------------------------------------------------------------------------


def held_at_rest(robot, pose):
    """Largest payload that the motors hold at rest [kg]; a spatial robot's torques are proportional
    to the mass."""
    per_mass = textbook.static_torque(robot, 1.0, pose)
    return float(np.min(robot.stall_torque / per_mass)) - robot.mass


def make_task(robot, trajectory, position=0.01):
    return Task(
        robot=robot,
        trajectory=find_trajectory(trajectory, robot.coordinates),
        error_bounds=ErrorBounds(position=position),
        control_frequency=500.0,
        cable="unilateral",
        model_payload=0.0,
        payload_known=False,
    )


@pytest.mark.parametrize("position", [0.01, 0.3])
@pytest.mark.parametrize(
    ("robot", "trajectory", "at_rest"),
    [
        (SPATIAL, "circle-spatial", True),
        (FLEX_SPATIAL, {"name": "loop-spatial", "seed": 10_003}, True),
        (SPATIAL, "dwell-spatial", True),
        (SPATIAL, {"name": "line-spatial", "dwell": 0}, True),
        (SPATIAL, {"name": "circle-spatial", "dwell": 0}, False),
        (SPATIAL, "paper-spatial", False),
        (PLANAR, "circle-planar", True),
        (PLANAR, "paper-planar", False),
    ],
)
def test_spatial_robots_start_lower_than_a_motion_at_rest(robot, trajectory, at_rest, position):
    """By half the position bound, at most 50 mm."""
    task = make_task(robot, trajectory, position)
    expected = task.trajectory(0.0).position.copy()
    if at_rest and not robot.planar:
        expected[2] += min(position / 2, 0.05)
    assert_array_equal(task.start_pose, expected)
    assert task.starts_at_rest == at_rest


@pytest.mark.parametrize("robot", [SPATIAL, FLEX_SPATIAL], ids=lambda robot: robot.name)
def test_motors_hold_about_a_kilogram_more_at_the_start_pose(robot):
    motions = [
        "circle-spatial",
        *({"name": "loop-spatial", "seed": seed} for seed in held_out_seeds(20)),
    ]
    for motion in motions:
        task = make_task(robot, motion)
        gained = held_at_rest(robot, task.start_pose) - held_at_rest(
            robot, task.trajectory(0.0).position
        )
        assert 0.9 <= gained <= 1.3
