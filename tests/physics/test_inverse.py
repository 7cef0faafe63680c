"""The compiled inverse dynamics against the textbook, and the textbook's pulley accelerations against Eq. 6."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.plant import Plant
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Transmission

# Every motor and axis different, one pulley without inertia; springs change nothing.
UNEQUAL = SPATIAL.replace(
    name="unequal",
    inertia=(0.9, 0.3, 0.7),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    ),
)
QUAD = PLANAR.replace(
    name="quad",
    base_anchors=((-0.6, -0.3), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.6)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06), pulley_inertia=(4e-4, 0.0, 8e-4, 1e-3), damping=(0.0, 0.01, 0.02, 0.03)
    ),
    home_pose=(0.05, 0.1),
)
NINE = PLANAR.replace(
    name="nine", base_anchors=tuple((np.cos(k * np.pi / 4.5), np.sin(k * np.pi / 4.5)) for k in range(9))
)

every_robot = pytest.mark.parametrize(
    "robot", [PLANAR, QUAD, NINE, FLEX_PLANAR, SPATIAL, UNEQUAL, FLEX_SPATIAL], ids=lambda robot: robot.name
)
both_spaces = pytest.mark.parametrize("robot", [QUAD, UNEQUAL], ids=lambda robot: robot.name)


def random_motion(robot, shape, seed=1):
    """Poses all over the workspace, velocities up to 2, accelerations up to 10; masses from the robot's on."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform(*robot.pose_bounds, (*shape, robot.coordinates))
    motion = pose, rng.uniform(-2, 2, pose.shape), rng.uniform(-10, 10, pose.shape)
    return robot.mass + rng.uniform(0, 3, shape), *motion


def worst_errors(found, expected):
    """Of each member in each of the results, relative to its largest entry or 1; shape (4, ...)."""
    errors = []
    for field in dataclasses.fields(textbook.InverseDynamics):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        assert ours.shape == theirs.shape
        errors.append(np.abs(ours - theirs).max(axis=-1) / np.maximum(1, np.abs(theirs).max(axis=-1)))
    return np.stack(errors)


@pytest.mark.parametrize("minimum", [0.0, 4.0])
@every_robot
def test_the_textbook_excludes_a_wrong_tension_torque_speed_or_winding(robot, minimum):
    """Reached: 2e-16 times the condition of S, up to 1e-12; planar 1e-12, where two cables are nearly in line."""
    motion = random_motion(robot, (5000,))
    expected = textbook.inverse_dynamics(robot, *motion, minimum=minimum, strict=False)
    if robot.planar:
        impossible = np.all(expected.tensions == minimum, axis=-1)
        assert 0.02 < impossible.mean() < 0.98
    errors = worst_errors(inverse_dynamics(robot, *motion, minimum=minimum), expected)
    if not robot.planar:
        condition = np.linalg.cond(textbook.jacobian(robot, motion[1]))
        assert condition.max() > 1e4
        assert np.max(errors / condition) <= 2e-15
    assert errors.max() <= 2e-11


def test_a_second_pass_excludes_the_squared_condition_near_a_singular_pose():
    """Turned by nearly a quarter, where no moment is left: condition 50 to 5e5. Reached: 3e-17 of it, else 3e-12."""
    turn = np.pi / 2 - np.geomspace(1e-1, 1e-5, 64)
    pose = np.zeros((64, 6))
    pose[:, 2], pose[:, 5] = 0.4, turn
    _, _, velocity, acceleration = random_motion(SPATIAL, (64,))
    motion = np.full(64, SPATIAL.mass), pose, velocity, acceleration
    condition = np.linalg.cond(textbook.jacobian(SPATIAL, pose))
    assert condition.max() > 5e5
    errors = worst_errors(inverse_dynamics(SPATIAL, *motion), textbook.inverse_dynamics(SPATIAL, *motion))
    assert np.max(errors / condition) <= 2e-15


@pytest.mark.parametrize("shape", [(), (0,), (1,), (31,), (32,), (33,), (2, 0), (3, 1, 23)])
@both_spaces
def test_a_batch_excludes_results_of_another_member_or_shape(robot, shape):
    """Whatever the batch, each member has the very bits it has alone."""
    mass, *motion = random_motion(robot, shape, seed=2)
    found = inverse_dynamics(robot, mass, *motion, minimum=2.0)
    for field in dataclasses.fields(found):
        value = getattr(found, field.name)
        assert value.shape == (*shape, robot.cables)
        for index in np.ndindex(shape):
            alone = inverse_dynamics(robot, mass[index], *(part[index] for part in motion), minimum=2.0)
            np.testing.assert_array_equal(value[index], getattr(alone, field.name))


@both_spaces
def test_broadcasting_excludes_arguments_of_one_member_taken_for_the_batch(robot):
    """One mass, one acceleration, an integer, a read-only and a reversed array are all right."""
    _, pose, velocity, _ = random_motion(robot, (40,), seed=3)
    velocity.flags.writeable = False
    rest = np.zeros(robot.coordinates, int)
    found = inverse_dynamics(robot, 7, pose[::-1], velocity, rest)
    full = np.full(40, 7.0), np.ascontiguousarray(pose[::-1]), velocity.copy(), np.zeros(pose.shape)
    np.testing.assert_array_equal(worst_errors(found, inverse_dynamics(robot, *full)), 0)


@both_spaces
def test_an_error_excludes_reading_beyond_arrays_of_the_wrong_shape(robot):
    mass, *motion = random_motion(robot, (4,))
    other = PLANAR if robot is UNEQUAL else SPATIAL
    with pytest.raises(ValueError, match="coordinates"):
        inverse_dynamics(other, mass, *motion)
    with pytest.raises(ValueError, match="broadcast"):
        inverse_dynamics(robot, mass[:3], *motion)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("part", range(4))
@both_spaces
def test_a_number_that_is_none_excludes_damage_to_the_neighbours(robot, part, bad):
    motion = random_motion(robot, (70,), seed=4)
    healthy = inverse_dynamics(robot, *motion, minimum=1.0)
    motion[part][41] = bad
    found = inverse_dynamics(robot, *motion, minimum=1.0)
    others = np.arange(70) != 41
    for field in dataclasses.fields(found):
        np.testing.assert_array_equal(getattr(found, field.name)[others], getattr(healthy, field.name)[others])
    if not robot.planar:  # without a direction, planar cables keep the minimum
        assert not np.any(np.isfinite(found.tensions[41]))


@pytest.mark.parametrize("cable", ["unilateral", "bilateral"])
def test_the_plant_excludes_torques_that_do_not_give_the_motion(cable):
    """Forward dynamics of the same kernel give the acceleration back, where the cables pull."""
    rng = np.random.default_rng(5)
    pose = UNEQUAL.home + np.array([0, 0, 0.3, 0, 0, 0]) + rng.uniform(-0.05, 0.05, (64, 6))
    velocity, acceleration = rng.uniform(-1, 1, (2, 64, 6))
    needed = inverse_dynamics(UNEQUAL, UNEQUAL.mass, pose, velocity, acceleration)
    taut = np.all(needed.tensions > 0, axis=-1) | (cable == "bilateral")
    assert taut.sum() > 20
    plant = Plant(UNEQUAL, 64, cable=cable)
    plant.set_state(np.arange(64), pose, velocity)
    found, tensions = plant.evaluate(needed.torques)
    np.testing.assert_allclose(found[taut], acceleration[taut], rtol=0, atol=1e-10)
    np.testing.assert_allclose(tensions[taut], needed.tensions[taut], rtol=0, atol=1e-9)


@every_robot
def test_eq_6_excludes_windings_other_than_the_pulley_accelerations(robot):
    motion = random_motion(robot, (20,))
    found = textbook.inverse_dynamics(robot, *motion, strict=False).pulley_accelerations
    np.testing.assert_allclose(found, textbook.pulley_acceleration(robot, *motion[1:]), rtol=1e-13, atol=1e-11)
