"""Equivariant networks: the symmetries of robots, and networks that have them exactly."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_baselines.learned.features import feature_symmetry
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining
from cablebot_baselines.learned.runs import read_yaml
from cablebot_baselines.learned.steering import Shift
from cablebot_baselines.learned.symmetry import symmetries
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, SPATIAL
from cablebot_gym.trajectories import find_trajectory

FEATURES = read_yaml("CableBot-FlexPlanar-v0", Path("gradient-loops"))["features"]
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
def test_transformed_motion_permutes_the_motors(robot):
    transforms = symmetries(robot)
    assert sorted(np.linalg.det(transforms).round(9)) == [-1, -1, -1, 1, 1, 1]
    motion = find_trajectory(LOOP, 2)(np.linspace(0.1, 1.0, 20))

    def actions(transform):
        derivatives = (
            blocks @ transform.T
            for blocks in (motion.position, motion.velocity, motion.acceleration)
        )
        required = inverse_dynamics(robot, 3.0, *derivatives, minimum=5.0)
        return normalised_action(robot, required.torques, required.speeds)

    permutations = set()
    before = actions(np.eye(2))
    for transform in transforms:
        after = actions(transform)
        permutation = [
            int(np.abs(before - column[:, None]).max(axis=0).argmin()) for column in after.T
        ]
        assert_allclose(after, before[:, permutation], atol=1e-9)
        permutations.add(tuple(permutation))
    assert len(permutations) == 6


def test_number_of_symmetries_of_irregular_robots():
    def stiffness(*values):
        return FLEX_PLANAR.replace(transmission=FLEX_PLANAR.transmission.replace(stiffness=values))

    assert len(symmetries(stiffness(9.0, 9.0, 8.0))) == 2
    assert len(symmetries(stiffness(9.0, 8.0, 7.0))) == 1
    for shift, count in (((0.0, 0.1), 2), ((0.01, 0.1), 1)):
        anchors = np.array(PLANAR.base_anchors)
        anchors[2] += shift
        assert len(symmetries(PLANAR.replace(base_anchors=anchors))) == count


@pytest.mark.parametrize(
    ("hidden", "iterations"),
    [((), 0), ((3, 2, 5), 0), pytest.param((3, 3), 6, marks=pytest.mark.slow)],
)
def test_network_is_equivariant_before_and_after_training(hidden, iterations):
    trainer = training(hidden=hidden, iterations=max(iterations, 1))
    before = trainer.network
    if iterations:
        trainer.round(0)
        assert np.abs(trainer.network.weights[1] - before.weights[1]).max() > 1e-4
    network = trainer.network
    inputs = network.mean + network.scale * np.random.default_rng(0).normal(
        size=(6, network.inputs)
    )
    outputs = network(inputs)
    assert np.abs(outputs).min() > 1e-4
    for transform in symmetries(FLEX_PLANAR):
        transformed = network(inputs @ feature_symmetry(FEATURES, transform).T)
        assert_allclose(transformed, outputs @ transform.T, atol=1e-12)
    assert not hidden or np.abs(network(-inputs) + outputs).max() > 1e-3  # it is not odd by itself


def test_spatial_robots_and_other_features_raise():
    with pytest.raises(ValueError, match="planar robots, but 'spatial' is spatial"):
        symmetries(SPATIAL)
    with pytest.raises(ValueError, match="feature 'motor_angle' is invalid with symmetric"):
        feature_symmetry(["motor_angle"], np.eye(2))
