"""The corrections of docs/errata.md to the models and to the laws of rigid robots."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose
from oracles.lagrange import (
    RADIUS,
    RUBBING,
    UNEVEN,
    by_columns,
    each_time,
    motion,
    needed_force,
    outer_loop,
    slope,
    turning,
)
from scipy.integrate import solve_ivp

from cablebot_baselines.classical import PD
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.trajectories import find_trajectory

# --- §2: models -------------------------------------------------------------------------------------------------------


@each_time
def test_eq1_and_eq7_inertia_times_the_whole_acceleration(time):
    """Eq. 7 is Eq. 1 with the torque of the spring in place of the motor's."""
    (_, v, a) = motion(UNEVEN, time)
    (g, rate) = turning(UNEVEN, time)
    j = 8e-4
    friction = 0.01 * (g @ v)
    torques = np.linalg.solve(g.T, needed_force(UNEVEN, time, pulleys=True)) + friction
    tensions = np.linalg.solve(RADIUS * g.T, needed_force(UNEVEN, time, pulleys=False))
    corrected = (torques - j * (rate @ v + g @ a) - friction) / RADIUS
    assert_allclose(corrected, tensions, rtol=0, atol=1e-6)
    # in Eq. 1, ∂β/∂X does not depend on T
    for printed in (j * (g @ a), j * rate @ v + g @ a):
        assert np.abs((torques - printed - friction) / RADIUS - tensions).max() > 0.1


@each_time
def test_eq2_with_the_jacobian_of_eq3_loses_the_pulleys_inertia(time):
    (x, v, a) = motion(RUBBING, time)
    (g, rate) = turning(RUBBING, time)
    required = RADIUS * (needed_force(RUBBING, time, pulleys=True) + g.T @ (0.02 * g @ v))

    def equation(s):
        return (RADIUS * np.eye(2) + s @ (8e-4 * g)) @ a + s @ ((8e-4 * rate + 0.02 * g) @ v)

    theta = np.arctan2(*(x - RUBBING.base).T[::-1])  # from the anchor to the platform
    s = -np.array([np.cos(theta), np.sin(theta)])
    assert_allclose(equation(s), required, rtol=0, atol=1e-8)
    # S τ is r times the generalised force of τ
    assert_allclose(s, RADIUS * g.T, rtol=0, atol=1e-12)
    assert np.abs(equation(-s) - required).max() > 0.01


@each_time
def test_eq3_angles_for_rates_break_lagranges_equation(time):
    (x, v, a) = motion(UNEVEN, time)
    inertia = np.array(UNEVEN.inertia)
    required = needed_force(UNEVEN, time, pulleys=False)
    inertial = textbook.mass_matrix(UNEVEN, 10.0, x) @ a
    bias = textbook.bias(UNEVEN, 10.0, x, v)
    assert_allclose(inertial + bias, required, rtol=0, atol=1e-6)
    (c1, c2, _), (s1, s2, _) = np.cos(x[3:]), np.sin(x[3:])
    to_omega = np.array([[1, 0, -s2], [0, c1, s1 * c2], [0, -s1, c1 * c2]])
    omega = to_omega @ v[3:]
    exchanged = bias.copy()
    exchanged[3:] += to_omega.T @ np.cross(omega, inertia * (to_omega @ x[3:]) - inertia * omega)
    twice = np.concatenate([bias[:3], bias[3:] * v[3:]])  # "C(X, Ẋ) Ẋ", C being a vector
    for printed in (exchanged, twice):
        assert np.abs(inertial + printed - required).max() > 0.1


def test_eq4_is_a_force_law_and_no_constraint():
    """A constraint between β and β′ would leave some direction of their state space unreachable."""
    j, jm, k = sympy.symbols("J J_m K", positive=True)
    plant = sympy.Matrix(
        [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [-k / j, k / j, 0, 0],
            [k / jm, -k / jm, 0, 0],
        ]
    )
    by_motor = sympy.Matrix([0, 0, 0, 1 / jm])
    assert sympy.Matrix.hstack(*(plant**power * by_motor for power in range(4))).rank() == 4


# --- §3.1: planar law -------------------------------------------------------------------------------------------------


@each_time
def test_eq9_and_eq10_need_both_rows_and_a_pseudoinverse(time):
    """Division by components couples x and y wrongly; S has no inverse, and M_eq S⁻¹ does not
    exist."""
    (x, v, _) = motion(RUBBING, time)
    (g, rate) = turning(RUBBING, time)
    s = RADIUS * g.T
    matrix = RADIUS * np.eye(2) + s @ (8e-4 * g)
    bias = s @ ((8e-4 * rate + 0.02 * g) @ v)

    def accelerations(torques):
        return textbook.forward_dynamics(RUBBING, 1.0, x, v, torques, cable="bilateral")[0]

    torques = np.array([2.0, 1.0, 3.0])
    requested = np.array([3.0, -4.0])
    right = s @ torques - bias
    assert_allclose(
        np.linalg.solve(matrix, right),
        accelerations(torques),
        rtol=0,
        atol=1e-9,
    )
    assert np.abs(right / np.diag(matrix) - accelerations(torques)).max() > 0.01
    with pytest.raises(ValueError, match="mismatch"):
        matrix @ np.linalg.pinv(s)
    reached = accelerations(np.linalg.pinv(s) @ (matrix @ requested + bias))
    assert_allclose(reached, requested, rtol=0, atol=1e-9)


def test_eq10_two_motors_alone_would_have_to_push():
    path = find_trajectory("paper-planar", 2)(np.linspace(0, 1, 101))
    for pair in ([0, 1], [1, 2], [0, 2]):
        pull = -np.swapaxes(textbook.jacobian(PLANAR, path.position)[:, pair], 1, 2)
        assert np.linalg.solve(pull, path.acceleration[..., None]).min() < -1


@each_time
def test_eq11_matrix_a_is_s(time):
    s = RADIUS * turning(RUBBING, time)[0].T
    desired_force = np.array([3.0, -4.0])
    null = np.linalg.svd(s)[2][2]
    null = null * np.sign(null[0])
    assert null.min() > 0  # inside the triangle: α raises every torque at once
    particular = s.T @ np.linalg.solve(s @ s.T, desired_force)
    assert_allclose(s @ (particular + 7.0 * null), desired_force, rtol=0, atol=1e-12)
    another = s + 0.1 * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert (
        np.abs(s @ s.T @ np.linalg.solve(another @ another.T, desired_force) - desired_force).max()
        > 0.1
    )


@pytest.mark.parametrize(("stiffness", "damping"), [(2000.0, 10.0), (30.0, 20.0)])
def test_eq14_law_is_pd_and_leaves_an_error_under_a_force(stiffness, damping):
    """Eqs. 12–14, 17–19: z̈ = v + η. With the integral that the text speaks of, η would leave no
    error."""
    law = PD(gains=(stiffness, damping))

    def loop(_, state):
        return np.array([state[1], outer_loop(law, state[:1], state[1:], 0.2)[0] + 1.0])

    matrix = by_columns(
        lambda states: np.stack([loop(0.0, state) for state in states]),
        np.zeros(2),
    )
    root = np.sqrt(complex(damping**2 - 4 * stiffness))
    poles = (-damping + np.array([root, -root])) / 2
    assert_allclose(
        np.sort_complex(np.linalg.eigvals(matrix)),
        np.sort_complex(poles),
        rtol=1e-6,
    )
    end = solve_ivp(loop, (0.0, 8.0), np.zeros(2), rtol=1e-9, atol=1e-12).y[0, -1]
    assert 0.2 - end == pytest.approx(-1.0 / stiffness, rel=1e-3)


# --- §3.2: spatial law ------------------------------------------------------------------------------------------------


def test_eq15_and_eq16_printed_sign_drops_the_platform():
    (x, v, a), still = motion(SPATIAL, 0.1), np.zeros(6)
    tensions = np.linalg.solve(
        -textbook.jacobian(SPATIAL, x).T,
        needed_force(SPATIAL, 0.1, pulleys=False),
    )
    assert_allclose(
        textbook.required_tensions(SPATIAL, 10.0, x, v, a),
        tensions,
        rtol=0,
        atol=1e-6,
    )
    g, _ = turning(SPATIAL, 0.1)
    complete = np.linalg.solve(g.T, needed_force(SPATIAL, 0.1, pulleys=True)) + 0.01 * g @ v
    torques = textbook.required_torques(SPATIAL, tensions, x, v, a)
    assert_allclose(torques, complete, rtol=0, atol=1e-7)
    transposed = textbook.jacobian(SPATIAL, SPATIAL.home).T
    gravity = textbook.bias(SPATIAL, 10.0, SPATIAL.home, still)
    hanging = np.linalg.solve(-transposed, gravity)
    # so z points down (Eq. 3); upwards, and with the sign of Eq. 16, all cables push
    assert hanging.min() > 20
    printed = np.linalg.solve(
        textbook.mass_matrix(SPATIAL, 10.0, SPATIAL.home),
        -gravity + transposed @ hanging,
    )
    assert printed[2] == pytest.approx(2 * 9.81)
    assert np.linalg.solve(transposed, gravity).max() < -20


@each_time
def test_eq17_and_eq20_need_each_coordinate_before_its_rate(time):
    def interleaved(at):
        return np.stack(motion(UNEVEN, at)[:2], axis=1).ravel()  # x, ẋ, y, ẏ, …

    def printed(at):
        return np.concatenate(motion(UNEVEN, at)[:2])

    for state, follows in ((interleaved, True), (printed, False)):
        assert np.allclose(slope(state, time)[::2], state(time)[1::2], rtol=0, atol=1e-6) is follows
    inputs = motion(UNEVEN, time)[2]
    rows = slope(interleaved, time)[1::2]
    assert_allclose(rows, inputs, rtol=1e-6)  # row i has the input i/2; row 4 is ÿ and not ψ̈
    assert abs(rows[1] - inputs[3]) > 0.1
