"""Motions that leave the workspace raise before an episode starts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.robots import PLANAR
from cablebot_gym.task import ErrorBounds, check_workspace
from cablebot_gym.trajectories import find_trajectory

PLANAR_ID = "CableBot-Planar-v0"
OUTSIDE = {"name": "circle-planar", "radius": 3.0}


@pytest.mark.parametrize("fly", [evaluate_dlcc, record_rollout])
def test_motion_outside_the_workspace_raises(fly):
    with pytest.raises(ValueError, match=r"'circle-planar' leaves the workspace of 'planar' at t = 0.000 s: x = 3 "):
        fly("fl", PLANAR_ID, trajectory=OUTSIDE)


def test_motion_may_leave_the_workspace_by_the_error_bounds():
    """A bound of another coordinate, or one side of the workspace alone."""
    motion = find_trajectory("paper-spatial", 6)
    poses = motion(np.linspace(0.0, motion.duration, 2001)).position
    error_bounds = ErrorBounds(position=0.01, rotation=0.02)
    for channel in range(6):
        for side in (0, 1):
            for beyond, fits in ((0.0, True), (0.005, True), (0.015, channel >= 3), (0.03, False)):
                bounds = np.array([poses.min(axis=0), poses.max(axis=0)])
                bounds[side, channel] += beyond * (1 - 2 * side)
                robot = SimpleNamespace(name="box", coordinates=6, pose_bounds=bounds)
                if fits:
                    check_workspace(robot, motion, error_bounds)
                else:
                    with pytest.raises(ValueError, match="leaves the workspace"):
                        check_workspace(robot, motion, error_bounds)
                if beyond > 0:
                    with pytest.raises(ValueError, match="leaves the workspace"):
                        check_workspace(robot, motion)
    check_workspace(PLANAR, find_trajectory("paper-planar", 2))
