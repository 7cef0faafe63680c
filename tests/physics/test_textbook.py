"""Tensions, torques and accelerations of the textbook equations against linear programs, statics and themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space
from scipy.optimize import linprog
from scipy.special import logsumexp

from cablebot_gym.kinematics import cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL, Transmission
from cablebot_gym.trajectories import find_trajectory

QUAD = PLANAR.replace(
    name="quad",
    base_anchors=((-0.6, -0.3), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.6)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06), pulley_inertia=(4e-4, 0.0, 8e-4, 1e-3), damping=(0.0, 0.01, 0.02, 0.03)
    ),
    home_pose=(0.05, 0.1),
)
UNEQUAL = SPATIAL.replace(
    name="unequal",
    inertia=(0.9, 0.3, 0.7),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    ),
)
every_robot = pytest.mark.parametrize("robot", [PLANAR, QUAD, SPATIAL, UNEQUAL], ids=lambda robot: robot.name)


def random_motion(robot, count, seed=3):
    """Poses around home, within the polygon of the anchors, and velocities and accelerations of any direction."""
    rng = np.random.default_rng(seed)
    reach = np.array([0.12, 0.12] if robot.planar else [0.1, 0.1, 0.05, 0.2, 0.2, 0.2])
    pose = robot.home + rng.uniform(-reach, reach, (count, robot.coordinates))
    if not robot.planar:
        pose[:, 2] += 0.3
    return pose, rng.uniform(-1, 1, pose.shape), rng.uniform(-5, 5, pose.shape)


def least_by_linear_program(structure, load, minimum, cost):
    cables = structure.shape[0]
    return linprog(cost, A_eq=-structure.T, b_eq=load, bounds=[(minimum, None)] * cables, method="highs")


coordinate = st.floats(-0.2, 0.2)
force = st.floats(-20, 20).filter(lambda value: value == 0 or abs(value) > 1e-3)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(coordinate, coordinate, force, force, st.sampled_from([0.0, 1.0, 5.0]), st.sampled_from([PLANAR, QUAD]))
def test_a_linear_program_excludes_tensions_that_are_not_the_least(x, y, fx, fy, minimum, robot):
    structure, load = textbook.jacobian(robot, [x, y]), np.array([fx, fy])
    best = least_by_linear_program(structure, load, minimum, np.ones(robot.cables))
    assume(best.status == 0)  # a corner of the box may lie outside the triangle
    found = textbook.tension_distribution(structure, load, minimum)
    np.testing.assert_allclose(-structure.T @ found, load, rtol=0, atol=1e-10)
    assert found.min() >= minimum
    assert found.sum() == pytest.approx(best.fun, rel=1e-7, abs=1e-7)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(coordinate, coordinate, force, force, st.sampled_from([0.0, 1.0, 5.0]))
def test_three_cables_exclude_any_tension_below_the_least_ones(x, y, fx, fy, minimum):
    """physics.md §4: the least α minimises every tension at once."""
    structure, load = textbook.jacobian(PLANAR, [x, y]), np.array([fx, fy])
    assume(least_by_linear_program(structure, load, minimum, np.ones(3)).status == 0)
    found = textbook.tension_distribution(structure, load, minimum)
    for cable in range(3):
        least = least_by_linear_program(structure, load, minimum, np.eye(3)[cable])
        assert found[cable] == pytest.approx(least.fun, rel=1e-7, abs=1e-7)
    assert found.min() == pytest.approx(minimum, abs=1e-9)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(coordinate, coordinate, force, force, st.sampled_from([0.5, 5.0]))
def test_soft_tensions_exclude_another_force_and_a_kink(x, y, fx, fy, softness):
    """By another way: least-norm tensions, and a soft maximum of what each cable needs of the null space."""
    structure, load, minimum = textbook.jacobian(PLANAR, [x, y]), np.array([fx, fy]), 5.0
    assume(least_by_linear_program(structure, load, minimum, np.ones(3)).status == 0)
    null = null_space(structure.T)[:, 0]
    null = null / null.sum()
    norm = -np.linalg.pinv(structure.T) @ load
    expected = norm + softness * logsumexp((minimum - norm) / null / softness) * null
    found = textbook.smooth_tension_distribution(
        structure, textbook.tension_distribution(structure, load, minimum), minimum, softness
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert found.min() >= minimum


def test_a_force_along_a_cable_excludes_a_least_tension_lost_to_rounding():
    for robot in (PLANAR, QUAD):
        structure = textbook.jacobian(robot, robot.home)
        for cable in range(robot.cables):
            expected = 7.0 * np.eye(robot.cables)[cable]
            found = textbook.tension_distribution(structure, -structure.T @ expected, 0.0)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(textbook.tension_distribution(structure, np.zeros(2), 0.0), 0.0)


def test_a_batch_excludes_least_tensions_taken_from_another_member():
    rng = np.random.default_rng(8)
    pose, load = rng.uniform(-0.15, 0.15, (4, 5, 2)), rng.uniform(-9, 9, (4, 5, 2))
    batch = textbook.tension_distribution(textbook.jacobian(QUAD, pose), load, 2.0)
    assert batch.shape == (4, 5, 4)
    for index in np.ndindex(4, 5):
        single = textbook.tension_distribution(textbook.jacobian(QUAD, pose[index]), load[index], 2.0)
        np.testing.assert_allclose(batch[index], single, rtol=0, atol=1e-13)


@pytest.mark.parametrize("robot", [PLANAR, QUAD], ids=lambda robot: robot.name)
def test_an_error_excludes_negative_tensions_outside_the_polygon(robot):
    outside = np.array([0.0, -0.7])
    away = np.array([0.0, -5.0])
    with pytest.raises(ValueError, match="outside the polygon"):
        textbook.tension_distribution(textbook.jacobian(robot, outside), away, 0.0)
    with pytest.raises(ValueError, match="outside the polygon"):  # one member of a batch is enough
        textbook.required_tensions(robot, 1.0, np.stack([robot.home, outside]), np.zeros(2), np.stack([away, away]))
    poses, loads = np.stack([robot.home, outside]), np.stack([away, away])
    going_on = textbook.tension_distribution(textbook.jacobian(robot, poses), loads, 2.0, strict=False)
    np.testing.assert_array_equal(going_on[1], 2.0)  # a control law gets the minimum, and its neighbour the solution
    assert going_on[0].max() > 2.5
    towards = textbook.tension_distribution(textbook.jacobian(robot, outside), -away, 0.0)
    assert towards.min() >= 0  # inwards, cables can pull from there too


@pytest.mark.parametrize("minimum", [0.0, 3.0])
@every_robot
def test_forward_after_inverse_dynamics_excludes_a_term_that_only_one_of_them_has(robot, minimum):
    pose, velocity, acceleration = random_motion(robot, 200)
    mass = robot.mass + np.linspace(0, 3, 200)
    tension = textbook.required_tensions(robot, mass, pose, velocity, acceleration, minimum=minimum)
    torques = textbook.required_torques(robot, tension, pose, velocity, acceleration)
    at_once = textbook.inverse_dynamics(robot, mass, pose, velocity, acceleration, minimum=minimum)
    speeds = textbook.pulley_speed(robot, pose, velocity)
    for one, other in ((at_once.tensions, tension), (at_once.torques, torques), (at_once.speeds, speeds)):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)
    found, pulled = textbook.forward_dynamics(robot, mass, pose, velocity, torques, cable="bilateral")
    np.testing.assert_allclose(found, acceleration, rtol=0, atol=1e-10)
    np.testing.assert_allclose(pulled, tension, rtol=0, atol=1e-9)
    taut = np.all(tension > 0.1, axis=1)
    if robot.planar and minimum == 0.0:
        assert not taut.any()  # the least tensions leave one cable without any
        return
    assert taut.sum() > 20
    found, pulled = textbook.forward_dynamics(robot, mass[taut], pose[taut], velocity[taut], torques[taut])
    np.testing.assert_allclose(found, acceleration[taut], rtol=0, atol=1e-10)
    np.testing.assert_allclose(pulled, tension[taut], rtol=0, atol=1e-9)


@pytest.mark.parametrize("robot", [SPATIAL, UNEQUAL], ids=lambda robot: robot.name)
def test_affinity_in_the_mass_excludes_a_payload_that_counts_twice_or_has_inertia(robot):
    """τ(m) = p + m s, with s the same at every mass: what the closed form of the DLCC rests on (§5)."""
    pose, velocity, acceleration = random_motion(robot, 100)

    def torques(mass):
        tension = textbook.required_tensions(robot, mass, pose, velocity, acceleration)
        return textbook.required_torques(robot, tension, pose, velocity, acceleration)

    slope = torques(11.0) - torques(10.0)
    assert np.abs(slope).max() > 0.1
    np.testing.assert_allclose(torques(17.0), torques(10.0) + 7 * slope, rtol=0, atol=1e-9)
    load = np.zeros((100, 6))
    load[:, :3] = acceleration[:, :3] - [0, 0, robot.gravity]
    weightless = -np.linalg.solve(np.swapaxes(textbook.jacobian(robot, pose), 1, 2), load[..., None])[..., 0]
    np.testing.assert_allclose(slope, robot.pulley_radius * weightless, rtol=0, atol=1e-9)


@pytest.mark.parametrize("payload", [0.0, 4.0])
def test_a_static_hang_excludes_vertical_tensions_that_do_not_carry_the_weight(payload):
    mass, still = SPATIAL.mass + payload, np.zeros(6)
    tension = textbook.required_tensions(SPATIAL, mass, SPATIAL.home, still, still)
    vectors = cable_vectors(SPATIAL.base, SPATIAL.platform, SPATIAL.home)
    upwards = vectors[:, 2] / np.linalg.norm(vectors, axis=1)  # z points down, so a hanging cable's z is positive
    assert tension @ upwards == pytest.approx(mass * 9.81, rel=1e-12)
    np.testing.assert_allclose(tension, tension.mean(), rtol=1e-12)  # three-fold symmetry
    torques = textbook.required_torques(SPATIAL, tension, SPATIAL.home, still, still)
    np.testing.assert_allclose(torques, 0.05 * tension, rtol=1e-14)
    acceleration, _ = textbook.forward_dynamics(SPATIAL, mass, SPATIAL.home, still, torques)
    np.testing.assert_allclose(acceleration, 0, atol=1e-12)


def test_the_papers_spatial_path_excludes_slack_cables_at_10_kg():
    path = find_trajectory("paper-spatial", 6)(np.linspace(0, 1, 2001))
    tension = textbook.required_tensions(SPATIAL, 10.0, path.position, path.velocity, path.acceleration)
    assert tension.min() == pytest.approx(25.9, abs=0.05)
    assert tension.max() < 200


def test_the_papers_planar_path_excludes_a_least_tension_that_jumps_off_its_minimum():
    path = find_trajectory("paper-planar", 2)(np.linspace(0, 1, 1001))
    tension = textbook.required_tensions(PLANAR, 1.0, path.position, path.velocity, path.acceleration, minimum=5.0)
    np.testing.assert_allclose(tension.min(axis=1), 5.0, rtol=1e-12)
    assert tension.max() > 20


@every_robot
def test_slack_cables_exclude_a_take_up_that_lets_the_cable_push(robot):
    """0 ≤ T ⟂ u ≥ 0 with u = r T − τ + J β̈ + c β̇ from the accelerations, however the taut set was found."""
    rng = np.random.default_rng(9)
    pose, velocity, _ = random_motion(robot, 200)
    torques = rng.uniform(-0.5, 1, (200, robot.cables)) * robot.stall_torque
    acceleration, tension = textbook.forward_dynamics(robot, robot.mass, pose, velocity, torques)
    take_up = robot.pulley_radius * tension - torques
    take_up += robot.pulley_inertia * textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    take_up += robot.damping * textbook.pulley_speed(robot, pose, velocity)
    slack = tension == 0
    assert 0.1 < slack.mean() < 0.9
    assert tension.min() >= 0
    assert take_up[slack].min() >= -1e-11
    np.testing.assert_allclose(take_up[~slack], 0, atol=1e-11)
    load = np.einsum("nij,nj->ni", textbook.mass_matrix(robot, robot.mass, pose), acceleration)
    load += textbook.bias(robot, robot.mass, pose, velocity)
    pulled = -np.einsum("nij,ni->nj", textbook.jacobian(robot, pose), tension)
    np.testing.assert_allclose(pulled, load, rtol=0, atol=1e-10)


def test_masses_of_a_batch_exclude_one_mass_for_all():
    pose, velocity, _ = random_motion(SPATIAL, 3)
    masses = np.array([10.0, 12.0, 15.0])
    matrix, bias = textbook.mass_matrix(SPATIAL, masses, pose), textbook.bias(SPATIAL, masses, pose, velocity)
    np.testing.assert_array_equal(matrix[:, 2, 2], masses)
    np.testing.assert_allclose(bias[:, 2], -9.81 * masses, rtol=1e-15)
    np.testing.assert_array_equal(matrix[:, 3:, 3:], textbook.mass_matrix(SPATIAL, 10.0, pose)[:, 3:, 3:])
