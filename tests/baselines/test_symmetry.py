"""Networks that turn and mirror with the robot: it is its symmetry, and they keep it exactly."""

from __future__ import annotations

import numpy as np
import pytest

from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, SPATIAL
from cablebot_gym.trajectories import find_trajectory

pytest.importorskip("torch")
from cablebot_baselines.learned.features import REFERENCE_FEATURES, feature_symmetry  # needs torch
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining
from cablebot_baselines.learned.steering import Shift
from cablebot_baselines.learned.symmetry import symmetries

FEATURES = (*REFERENCE_FEATURES, "reference_jerk", "reference_snap")
LOOP = {"name": "loop-planar", "seed": 3}


def training(**settings):
    return GradientTraining(
        robot=FLEX_PLANAR,
        trajectories=[find_trajectory(LOOP, 2)],
        action_mapping=Shift(action_period=0.02, degree=4),
        features=FEATURES,
        settings=GradientSettings(symmetric=True, spread=0.5, **settings),
    )


@pytest.mark.parametrize("robot", [PLANAR, FLEX_PLANAR], ids=lambda robot: robot.name)
def test_what_a_moved_motion_asks_of_the_motors_is_what_the_motion_asks_of_others(robot):
    """A move that the robot does not have, or one that is missing."""
    moves = symmetries(robot)
    assert len(moves) == 6
    assert sorted(np.linalg.det(moves).round(9)) == [-1, -1, -1, 1, 1, 1]
    motion = find_trajectory(LOOP, 2)(np.linspace(0.1, 1.0, 20))

    def demands(move):
        parts = (blocks @ move.T for blocks in (motion.position, motion.velocity, motion.acceleration))
        needed = inverse_dynamics(robot, 3.0, *parts, minimum=5.0)
        return normalised_action(robot, needed.torques, needed.speeds)

    orders = set()
    for move in moves:
        now, then = demands(move), demands(np.eye(2))
        order = [int(np.abs(then - column[:, None]).max(axis=0).argmin()) for column in now.T]
        np.testing.assert_allclose(now, then[:, order], atol=1e-9)
        orders.add(tuple(order))
    assert len(orders) == 6, "each moves the motors in its own way"


def test_robots_that_are_not_regular_have_fewer():
    def one_motor(**changes):
        return FLEX_PLANAR.replace(transmission=FLEX_PLANAR.transmission.replace(**changes))

    assert len(symmetries(one_motor(stiffness=(9.0, 9.0, 8.0)))) == 2, "the two lower cables may be swapped"
    assert len(symmetries(one_motor(stiffness=(9.0, 8.0, 7.0)))) == 1
    corners = 2 * np.pi * np.arange(12) / 12
    twelve = PLANAR.replace(base_anchors=np.stack([np.cos(corners), np.sin(corners)], axis=1))
    assert len(symmetries(twelve)) == 24, "and nobody tries all orders of twelve cables"
    for shift, count in (((0.0, 0.1), 2), ((0.01, 0.1), 1)):
        anchors = np.array(PLANAR.base_anchors)
        anchors[2] += shift
        assert len(symmetries(PLANAR.replace(base_anchors=anchors))) == count


@pytest.mark.parametrize("hidden", [(), (4,), (4, 3), (3, 2, 5)])
def test_a_network_says_of_a_moved_motion_what_it_says_of_the_motion(hidden):
    """Blocks of units that are swapped in another order than the inputs, or a mean that is not in the middle."""
    made = training(hidden=hidden)
    network = made.network
    rng = np.random.default_rng(0)
    seen = network.mean + network.scale * rng.normal(size=(6, network.inputs))
    said = network(seen)
    assert np.abs(said).min() > 1e-4
    for move in symmetries(FLEX_PLANAR):
        moved = network(seen @ feature_symmetry(FEATURES, FLEX_PLANAR, move).T)
        np.testing.assert_allclose(moved, said @ move.T, atol=1e-12)
    # Symmetry takes nothing else away: inputs that are no image of each other have answers of their own.
    assert not hidden or np.abs(network(-seen) + said).max() > 1e-3


def test_training_keeps_the_symmetry_and_changes_the_weights():
    made = training(hidden=(3, 3), iterations=6)
    before = made.network.weights[1].copy()
    made.round(0)
    after = made.network
    assert np.abs(after.weights[1] - before).max() > 1e-4
    seen = after.mean + after.scale * np.random.default_rng(0).normal(size=(1, after.inputs))
    turn = symmetries(FLEX_PLANAR)[3]
    np.testing.assert_allclose(
        after(seen @ feature_symmetry(FEATURES, FLEX_PLANAR, turn).T), after(seen) @ turn.T, atol=1e-12
    )


def test_spatial_robots_and_features_that_nobody_turned_are_refused():
    with pytest.raises(ValueError, match="planar robots, but 'spatial' is spatial: remove symmetric"):
        symmetries(SPATIAL)
    with pytest.raises(ValueError, match="feature 'motor_angle' is invalid with symmetric"):
        feature_symmetry(["motor_angle"], FLEX_PLANAR, np.eye(2))
