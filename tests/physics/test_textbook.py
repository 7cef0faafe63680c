"""Tensions, torques and accelerations of the textbook equations against linear programs, statics
and themselves."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from oracles.plants import QUAD, ROUGH, UNEQUAL, each_of, random_motion
from oracles.platforms import CRANE
from scipy.optimize import linprog

from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL


def least_by_linear_program(structure, load, minimum, cost):
    cables = structure.shape[0]
    return linprog(
        cost, A_eq=-structure.T, b_eq=load, bounds=[(minimum, None)] * cables, method="highs"
    )


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
    best = least_by_linear_program(structure, load, minimum, np.ones(robot.cables))
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
    balance = np.column_stack([-structure.T, zero])
    below = np.column_stack([np.eye(8), -np.ones(8)])
    cost = np.append(np.zeros(8), 1.0)
    least = linprog(cost, A_ub=below, b_ub=np.zeros(8), A_eq=balance, b_eq=load).fun
    limited = robot.replace(maximum_tension=1.02 * least)
    free, kept = (
        choose(either, structure, load, np.zeros(8), np.zeros(8), 1.0)
        for either in (robot, limited)
    )
    assert free.max() > limited.maximum_tension > kept.max()
    assert_allclose(-structure.T @ kept, load, atol=1e-6)
