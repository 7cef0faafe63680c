"""Kinematics, tensions, torques and accelerations of the textbook against finite differences, linear programs, statics
and themselves."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from oracles.plants import QUAD, ROUGH, UNEQUAL, differentiated, each_of, random_motion
from oracles.platforms import CRANE, PLATFORMS, SWIVELLED
from oracles.programs import least_largest_action
from scipy.optimize import linprog

from cablebot_gym import kinematics
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL, find_robot

coordinate = st.floats(-0.2, 0.2)
force = st.floats(-20, 20).filter(lambda value: value == 0 or abs(value) > 1e-3)


@settings(max_examples=60, derandomize=True)
@given(
    coordinate,
    coordinate,
    force,
    force,
    st.sampled_from([0.0, 1.0, 5.0]),
    st.sampled_from([PLANAR, QUAD]),
)
def test_tensions_are_the_least_of_a_linear_program(x, y, fx, fy, minimum, robot):
    structure = textbook.jacobian(robot, [x, y])
    load = np.array([fx, fy])
    bounds = [(minimum, None)] * robot.cables
    best = linprog(np.ones(robot.cables), A_eq=-structure.T, b_eq=load, bounds=bounds)
    assume(best.status == 0)  # a corner of the box may lie outside the triangle
    tensions = textbook.tension_distribution(structure, load, minimum)
    assert_allclose(-structure.T @ tensions, load, rtol=0, atol=1e-10)
    assert tensions.min() >= minimum
    assert tensions.sum() == pytest.approx(best.fun, rel=1e-7, abs=1e-7)


@each_of(PLANAR, QUAD)
def test_impossible_force_raises_or_gives_the_minimum(robot):
    """One member of a batch is enough to raise. A control law gets the minimum, and the neighbour
    its solution."""
    poses = np.array([robot.home, [0.0, -0.7]])
    structures = textbook.jacobian(robot, poses)
    away = np.array([[0.0, -5.0]] * 2)
    with pytest.raises(ValueError, match="outside the polygon"):
        textbook.tension_distribution(structures, away, 0.0)
    with pytest.raises(ValueError, match="outside the polygon"):
        textbook.required_tensions(robot, 1.0, poses, np.zeros(2), away)
    tensions = textbook.tension_distribution(structures, away, 2.0, strict=False)
    alone = textbook.tension_distribution(structures[0], away[0], 2.0)
    assert_allclose(tensions, [alone, 2.0 + 0 * alone], rtol=0, atol=1e-13)
    inwards = textbook.tension_distribution(structures[1], -away[1], 0.0)
    assert inwards.min() >= 0  # cables can pull from there too


@pytest.mark.parametrize("minimum", [0.0, 3.0])
@each_of(QUAD, SPATIAL, UNEQUAL, *ROUGH[:2])
def test_forward_dynamics_invert_the_inverse_dynamics(robot, minimum):
    mass, *motion = random_motion(robot, (200,), spread=0.25)
    inverse = textbook.inverse_dynamics(robot, mass, *motion, minimum=minimum)
    tension = inverse.tensions
    assert_allclose(inverse.speeds, textbook.pulley_speed(robot, *motion[:2]), atol=1e-10)
    taut = np.all(tension > 0.1, axis=1)
    if robot.planar and minimum == 0.0:
        assert not taut.any()  # the least tensions leave one cable without any
    else:
        assert taut.sum() > 20
    for cable, members in (("bilateral", taut | True), ("unilateral", taut)):
        state = mass[members], motion[0][members], motion[1][members]
        moved, pulled = textbook.forward_dynamics(
            robot, *state, inverse.torques[members], cable=cable
        )
        assert_allclose(moved, motion[2][members], rtol=0, atol=1e-10)
        assert_allclose(pulled, tension[members], rtol=0, atol=1e-9)


@pytest.mark.parametrize("choose", [textbook.central_tensions, textbook.least_action_tensions])
def test_redundant_tensions_are_below_the_maximum_where_it_can_be(choose):
    """Close to the least largest tension, which a linear program finds. A motor of twice the
    strength would otherwise take more than its share."""
    strong = CRANE.motors.replace(stall_torque=CRANE.stall_torque * ([1.0, 2.0] * 4))
    robot = CRANE.replace(motors=strong)
    zero = np.zeros(6)
    structure = textbook.jacobian(robot, robot.home)
    load = textbook.load(robot, 150.0, robot.home, zero, zero)
    zeros = np.zeros(8)
    least = least_largest_action(structure, load, zeros, zeros + np.inf, zeros + 1, zeros)
    limited = robot.replace(maximum_tension=1.02 * least)
    free, kept = (choose(either, structure, load, zeros, zeros, 1.0) for either in (robot, limited))
    assert free.max() > limited.maximum_tension > kept.max()
    assert_allclose(-structure.T @ kept, load, atol=1e-6)


@each_of(PLANAR, SPATIAL, QUAD, *PLATFORMS.values(), SWIVELLED)
def test_pulley_speed_and_acceleration_are_slopes_of_the_angle(robot):
    _, pose, velocity, acceleration = random_motion(robot, (50,), spread=0.1)

    def moved(time):
        return pose + time * velocity + time**2 / 2 * acceleration

    def speed(time):
        return textbook.pulley_speed(robot, moved(time), velocity + time * acceleration)

    assert_array_equal(textbook.pulley_angle(robot, robot.home), 0)
    slope = differentiated(lambda time: textbook.pulley_angle(robot, moved(time)), 1e-4)
    assert_allclose(speed(0), slope, rtol=1e-9, atol=1e-8)
    pulley_acceleration = textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    slope = differentiated(speed, 1e-4)
    assert_allclose(pulley_acceleration, slope, rtol=1e-8, atol=1e-6)


def test_cable_wraps_its_swivel_pulley_on_the_right_side():
    """Straight down from the outer edge of the pulley: half a turn on the pulley and the free
    length."""
    anchor = np.zeros((1, 3))
    for swivel, depth in ((0.1, 2.0), (-0.1, -2.0)):
        length = kinematics.cable_lengths(anchor, anchor, [0.2, 0.0, depth], [swivel])
        assert_allclose(length, [np.pi * 0.1 + 2.0], rtol=1e-14)
    # four cables come from below and pull downwards
    assert np.sign(find_robot("ipanema-3").swivel).tolist() == [1] * 4 + [-1] * 4


def test_euler_rate_matrix_gives_omega_in_the_platform_frame():
    """RᵀṘ is ω_body = P Θ̇ as a matrix; Ṗ is the slope of P."""
    rng = np.random.default_rng(5)
    euler = rng.uniform(-1.5, 1.5, (100, 3))
    rates = rng.uniform(-3, 3, (100, 3))

    def slope(function):
        return differentiated(lambda time: function(euler + time * rates), 1e-4)

    to_platform = kinematics.rotation_matrix(euler).mT
    omega_matrix = to_platform @ slope(kinematics.rotation_matrix)
    omega = np.einsum("nij,nj->ni", kinematics.euler_rate_matrix(euler), rates)
    assert_allclose(omega_matrix + omega_matrix.mT, 0, atol=1e-10)
    assert_allclose(omega_matrix[:, [2, 0, 1], [1, 2, 0]], omega, atol=1e-10)
    rate = kinematics.euler_rate_matrix_rate(euler, rates)
    assert_allclose(rate, slope(kinematics.euler_rate_matrix), rtol=0, atol=1e-10)
