"""The compiled inverse dynamics against the textbook, and the textbook's pulley accelerations
against Eq. 6."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from oracles.plants import (
    FLEX_UNEQUAL,
    NINE,
    QUAD,
    ROUGH,
    UNEQUAL,
    each_of,
    nightly,
    random_motion,
    rigid_robots,
)
from oracles.platforms import CAMERA, CRANE, HANGING, TURNING

from cablebot_gym.kinematics import times_vector
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import PLANAR, SPATIAL

TRIPOD = CAMERA.replace(name="tripod", base_anchors=(*CAMERA.base_anchors[:2], (0.1, 4.0, 0.0)))
"""As many cables as coordinates in space."""
TRIANGLE = TURNING.replace(
    name="triangle",
    base_anchors=((-1.5, -1.2), (1.5, -1.2), (0.3, -1.4)),
    platform_anchors=((-0.2, -0.1), (0.2, -0.1), (-0.2, -0.1)),
)
"""As many cables as coordinates in a plane."""
every_robot = each_of(
    *(PLANAR, QUAD, SPATIAL, UNEQUAL, TRIANGLE),
    *nightly(NINE, FLEX_UNEQUAL, *ROUGH, CAMERA, CRANE, HANGING, TRIPOD, TURNING),
)


def worst_errors(results, expected):
    """Of each member in each of the results, relative to its largest entry or 1; shape (4, ...)."""
    errors = []
    for name, reference in vars(expected).items():
        values = getattr(results, name)
        assert values.shape == reference.shape
        size = np.maximum(1, np.abs(reference).max(axis=-1))
        errors.append(np.abs(values - reference).max(axis=-1) / size)
    return np.stack(errors)


@pytest.mark.parametrize("minimum", [0.0, 4.0])
@every_robot
def test_results_are_those_of_the_textbook(robot, minimum):
    """Unique tensions, and the same choice of redundant ones. Loads that no tensions hold have the
    same results of a planar robot only. Reached: 1e-12, where cables are nearly in line. A member
    of a batch has the bits that it has alone."""
    motion = random_motion(robot, (40, 1, 25), spread=1.0 if robot.weightless else 0.3)
    expected = textbook.inverse_dynamics(robot, *motion, minimum=minimum, strict=False)
    pulls = times_vector(textbook.jacobian(robot, motion[1]).mT, expected.tensions)
    held = np.abs(textbook.load(robot, *motion) + pulls).max(axis=-1) < 1e-6
    assert held.mean() > 0.02
    results = inverse_dynamics(robot, *motion, minimum=minimum)
    assert worst_errors(results, expected)[:, held | robot.planar].max() <= 2e-11
    for index in np.ndindex(3, 1, 5):
        alone = inverse_dynamics(robot, *(values[index] for values in motion), minimum=minimum)
        for name, values in vars(alone).items():
            assert_array_equal(getattr(results, name)[index], values)


@rigid_robots
def test_arguments_are_broadcast(robot):
    """One mass, an integer acceleration, a read-only and a reversed array are all right."""
    mass, pose, velocity, _ = random_motion(robot, (40,), seed=3)
    velocity.flags.writeable = False
    at_rest = np.zeros(robot.coordinates, int)
    results = inverse_dynamics(robot, 7, pose[::-1], velocity, at_rest)
    plain = np.full(40, 7.0), pose[::-1].copy(), velocity.copy(), np.zeros(pose.shape)
    assert_array_equal(worst_errors(results, inverse_dynamics(robot, *plain)), 0)
    nothing = inverse_dynamics(robot, *random_motion(robot, (0,)))
    assert nothing.tensions.shape == (0, robot.cables)
    with pytest.raises(ValueError, match="broadcast"):
        inverse_dynamics(robot, mass[:3], pose, velocity, at_rest)
    with pytest.raises(ValueError, match="coordinates"):
        inverse_dynamics(NINE if robot is UNEQUAL else SPATIAL, mass, pose, velocity, at_rest)
