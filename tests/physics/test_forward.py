"""Forward kinematics: poses from cable lengths."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.plants import each_of, nightly, random_motion, with_transmission
from oracles.platforms import PLATFORMS
from scipy.optimize import least_squares

from cablebot_gym.physics import textbook
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.robots import SPATIAL, find_robot

ROBOTS = {name: find_robot(name) for name in ("planar", "spatial", "cogiro", "ipanema-3")}
ROBOTS["camera"] = PLATFORMS["camera"]
ROBOTS["turning"] = with_transmission(PLATFORMS["turning"], load_friction=0.05)
"""``cogiro`` has swivel pulleys. ``turning`` has a platform in a plane, and load friction, which is in
the equations of motion that the iteration borrows. ``spatial`` has no redundant cable."""

each_robot = each_of(
    ROBOTS["planar"],
    ROBOTS["spatial"],
    ROBOTS["turning"],
    *nightly(*(ROBOTS[name] for name in ("cogiro", "ipanema-3", "camera"))),
)


@each_robot
def test_lengths_give_the_least_squares_pose(robot):
    """The pose itself, if they are exact."""
    _, poses, *_ = random_motion(robot, (100,), spread=0.1)
    error = np.random.default_rng(0).uniform(-1, 1, poses.shape)
    if not robot.planar:
        poses[:, 2] += 0.2  # below the base of the suspended robot
    lengths = textbook.cable_lengths(robot, poses)
    guess = poses + 0.02 * error
    assert np.abs(forward_kinematics(robot, lengths, guess) - poses).max() < 1e-10
    wrong = (lengths + np.random.default_rng(1).normal(0, 5e-3, lengths.shape))[:8]
    found = forward_kinematics(robot, wrong, guess[:8])
    for k, measured in enumerate(wrong):
        best = least_squares(
            lambda x, measured=measured: textbook.cable_lengths(robot, x) - measured,
            guess[k],
            jac=lambda x: textbook.jacobian(robot, x),
            xtol=1e-15,
            ftol=1e-15,
        )
        assert_allclose(found[k], best.x, atol=1e-7)
        # a lane of a tile does not see the other ones, or wait for them
        assert_array_equal(forward_kinematics(robot, measured, guess[k]), found[k])


def test_lengths_of_another_robot_raise():
    with pytest.raises(ValueError, match="do not match spatial"):
        forward_kinematics(SPATIAL, np.ones(8), SPATIAL.home)
