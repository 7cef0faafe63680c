"""Platforms on fewer cables than coordinates: pose at rest and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import with_transmission
from oracles.platforms import CAMERA, DRIVE, SWIVELLED

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.physics.hanging import hanging_pose, home_at_rest
from cablebot_gym.robots import Robot

LENGTH = 1.3
ARM = 0.4
DROP = 0.25
MASS = 6.0
INERTIA = (0.2, 0.3, 0.25)

BIFILAR = Robot(
    name="bifilar",
    base_anchors=[(-ARM, 0.0, 0.0), (ARM, 0.0, 0.0)],
    platform_anchors=[(-ARM, 0.0, -DROP), (ARM, 0.0, -DROP)],
    mass=MASS,
    inertia=INERTIA,
    home_pose=(0.02, 0.03, LENGTH + DROP - 0.01, 0.02, -0.01, 0.03),
    workspace=((-1, 1), (-1, 1), (0.5, 3), (-1, 1), (-1, 1), (-1, 1)),
    **DRIVE,
)
"""A platform on two parallel cables, its centre of mass DROP below their ends."""

REST = np.array([0.0, 0.0, LENGTH + DROP, 0.0, 0.0, 0.0])


def hung(payload=0.0):
    return hanging_pose(BIFILAR, MASS + payload, [LENGTH, LENGTH], BIFILAR.home)


def test_platform_hangs_below_its_anchors():
    hanging = hung(payload=2.0)
    assert_allclose(hanging.pose, REST, atol=1e-9)
    assert_allclose(hanging.tensions, (MASS + 2.0) * BIFILAR.gravity / 2, rtol=1e-9)


@pytest.mark.parametrize(
    ("lengths", "guess"),
    [
        ([0.2, 2.5], BIFILAR.home),
        ([0.1, 0.1 + 3 * ARM], BIFILAR.home),
        # both cables push the platform up from its anchors' level, where the weight balances them
        ([LENGTH - 2 * DROP] * 2, REST * [1, 1, -1, 1, 1, 1]),
    ],
)
def test_lengths_without_a_pose_on_taut_cables_are_refused(lengths, guess):
    with pytest.raises(ValueError, match=r"slack|no pose at rest"):
        hanging_pose(BIFILAR, MASS, lengths, guess)


@pytest.mark.parametrize("turn", np.linspace(-1, 1, 9))
def test_platform_on_one_cable_is_refused_at_each_turn(turn):
    """Nothing holds its turn about the cable: the frequency is zero but for rounding, which is
    positive at some turns."""
    robot = BIFILAR.replace(
        base_anchors=[(0.1, 0.2, 0.0)],
        platform_anchors=[(0.03, 0.02, -DROP)],
        home_pose=(0.1, 0.2, LENGTH + DROP, 0.02, -0.03, turn),
    )
    with pytest.raises(ValueError, match="not stable"):
        home_at_rest(robot, MASS, 0.0)


@pytest.mark.parametrize(
    ("robot", "keywords", "message"),
    [
        (BIFILAR, {}, "needs at least 6 cables, not 2"),
        (SWIVELLED.replace(swivel_axes=[(0, 0.1, -1)] * 8), {}, "vertical axes only"),
        (with_transmission(CAMERA, load_friction=0.1), {"cable": "bilateral"}, "only pull"),
    ],
)
def test_simulation_refuses_what_it_does_not_know(robot, keywords, message):
    with pytest.raises(ValueError, match=message):
        make_settings(robot=robot, count=1, **keywords)
