"""The corrections of docs/errata.md against what does not know the paper: Lagrange's equation in finite differences,
MuJoCo, a change of units, bisection, plain integrators. Where it is cheap, the printed form is shown to be wrong."""

from __future__ import annotations

import inspect
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy
from oracles.mujoco_model import MujocoRobot
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import linprog

from cablebot_baselines.classical import PD, RobustPD
from cablebot_baselines.paper.load_iteration import iterate_load, load_coefficient
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, RPM, SPATIAL, Motors
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.uncertainty import UNCERTAINTIES

PAGE = Path(__file__).parents[1] / "docs" / "errata.md"

RUBBING = PLANAR.replace(transmission=PLANAR.transmission.replace(damping=0.02))
"""The planar robot with friction, so that no term of Eqs. 1 and 2 vanishes."""
UNEVEN = SPATIAL.replace(inertia=(0.9, 0.3, 0.7))
"""The spatial robot with three different moments: with I_xx = I_yy some wrong terms cancel."""
FLEXIBLE = FLEX_SPATIAL.replace(mass=11.0)
"""Table 5 with the K of §5.2.3."""
KP, KD = 30.0, 20.0
"""Gains of Tables 4 and 5."""
TIMES = (0.1, 0.35, 0.8)


# --- what does not know the paper -------------------------------------------------------------------------------------


def differentiated(function, at, step=1e-3):
    """df/dt by central differences of fourth order."""
    near, far = function(at + step) - function(at - step), function(at + 2 * step) - function(at - 2 * step)
    return (8 * near - far) / (12 * step)


def rotation(angles):
    """Rz(φ) Ry(θ) Rx(ψ), one turn after the other; takes complex angles."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def lengths(robot, pose):
    """q(X); takes a complex pose."""
    arms = robot.platform if robot.planar else robot.platform @ rotation(pose[3:]).T
    return np.sqrt(np.sum((pose[: robot.base.shape[1]] + arms - robot.base) ** 2, axis=1))


def structure(robot, pose):
    """S = ∂q/∂X (m, n) by complex steps, exact to rounding."""
    return np.stack([lengths(robot, pose + 1e-30j * e).imag / 1e-30 for e in np.eye(robot.coordinates)], axis=1)


def lagrangian(robot, mass, pose, velocity, pulleys):
    """Kinetic less potential energy of the platform and, where asked for, of the pulleys. z points down."""
    moving = pose + 1e-30j * velocity
    energy = mass * np.sum(velocity[:3] ** 2) / 2
    if not robot.planar:
        spin = rotation(pose[3:]).T @ rotation(moving[3:]).imag / 1e-30
        omega = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        energy += np.sum(np.array(robot.inertia) * omega**2) / 2 + mass * robot.gravity * pose[2]
    if pulleys:
        energy += np.sum(robot.pulley_inertia * (lengths(robot, moving).imag / 1e-30 / robot.pulley_radius) ** 2) / 2
    return energy


def gradient(function, at):
    return np.array([differentiated(lambda s, e=e: function(at + s * e), 0.0) for e in np.eye(len(at))])


def motion(robot, time):
    """X, Ẋ, Ẍ of some smooth motion well inside the workspace, in closed form."""
    n = robot.coordinates
    size = np.array([0.1, 0.1] if robot.planar else [0.08, 0.08, 0.05, 0.2, 0.2, 0.2])
    rate, phase = np.linspace(4.0, 7.0, n), np.linspace(0.3, 5.0, n)
    middle = robot.home + (np.zeros(2) if robot.planar else np.array([0, 0, 0.3, 0, 0, 0]))
    sine, cosine = np.sin(rate * time + phase), np.cos(rate * time + phase)
    return middle + size * sine, size * rate * cosine, -size * rate**2 * sine


def momentum(robot, mass, pose, velocity, pulleys):
    return gradient(lambda v: lagrangian(robot, mass, pose, v, pulleys), velocity)


def needed_force(robot, time, *, pulleys):
    """d/dt ∂L/∂Ẋ − ∂L/∂X on the motion: the generalised force that it needs from outside, (n,)."""
    x, v, _ = motion(robot, time)
    inner = gradient(lambda pose: lagrangian(robot, robot.mass, pose, v, pulleys), x)
    return differentiated(lambda t: momentum(robot, robot.mass, *motion(robot, t)[:2], pulleys), time) - inner


def winding(robot, time):
    """β̇ and β̈ of the motion, from lengths alone."""
    speed = [-differentiated(lambda t: lengths(robot, motion(robot, t)[0]), time + s) for s in (0.0, -1e-3, 1e-3)]
    second = differentiated(lambda t: -structure(robot, motion(robot, t)[0]) @ motion(robot, t)[1], time)
    return speed[0] / robot.pulley_radius, second / robot.pulley_radius


class Units:
    """What numbers become when kilogram, metre and second are replaced by other units."""

    def __init__(self, kg, m, s):
        self.kg, self.m, self.s = kg, m, s
        self.force, self.torque, self.damping = kg * m / s**2, kg * m**2 / s**2, kg * m**2 / s

    def robot(self, robot):
        inertia = self.kg * self.m**2
        given, to_length = robot.transmission, np.array([self.m] * min(robot.coordinates, 3) + [1.0] * 3)
        return robot.replace(
            base_anchors=self.m * robot.base,
            platform_anchors=self.m * robot.platform,
            mass=self.kg * robot.mass,
            inertia=inertia * np.array(robot.inertia),
            gravity=robot.gravity * self.m / self.s**2,
            home_pose=to_length * robot.home,
            motors=Motors(
                stall_torque=self.torque * robot.motors.stall_torque, free_speed=robot.motors.free_speed / self.s
            ),
            transmission=given.replace(
                pulley_radius=self.m * given.pulley_radius,
                pulley_inertia=inertia * given.pulley_inertia,
                damping=self.damping * given.damping,
                stiffness=given.stiffness and self.torque * given.stiffness,
                motor_inertia=given.motor_inertia and inertia * given.motor_inertia,
            ),
        )

    def motion(self, pose, velocity, acceleration):
        to_length = np.array([self.m] * 3 + [1.0] * 3)
        return pose * to_length, velocity * to_length / self.s, acceleration * to_length / self.s**2


OTHER_UNITS = Units(1e3, 1e2, 60.0)
"""Gram, centimetre, and a sixtieth of a second."""


def by_columns(function, at, step=1e-6):
    """Jacobian of a batched function (N, n) → (N, k) by central differences, (k, n)."""
    points = np.concatenate([at + step * np.eye(len(at)), at - step * np.eye(len(at))])
    ahead, behind = np.split(function(points), 2)
    return (ahead - behind).T / (2 * step)


# --- §2: models -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", TIMES)
def test_eq1_derivative_by_the_tension_loses_a_term_that_the_power_balance_needs(time):
    x, v, a = motion(UNEVEN, time)
    r, turning = 0.05, -structure(UNEVEN, x) / 0.05
    friction = UNEVEN.damping * (turning @ v)
    torques = np.linalg.solve(turning.T, needed_force(UNEVEN, time, pulleys=True)) + friction
    tensions = np.linalg.solve(r * turning.T, needed_force(UNEVEN, time, pulleys=False))
    rate = -textbook.jacobian_rate(UNEVEN, x, v) / r
    corrected = (torques - 8e-4 * (rate @ v + turning @ a) - friction) / r
    np.testing.assert_allclose(corrected, tensions, rtol=0, atol=1e-6)
    printed = (torques - 8e-4 * (turning @ a) - friction) / r  # ∂β/∂X does not depend on T
    assert np.abs(printed - tensions).max() > 0.1


@pytest.mark.parametrize("time", TIMES)
def test_eq2_with_the_jacobian_of_eq3_takes_the_pulleys_inertia_away(time):
    (x, v, a), (speed, _) = motion(RUBBING, time), winding(RUBBING, time)
    r, j, c = 0.05, RUBBING.pulley_inertia[:, None], RUBBING.damping[:, None]
    turning = -structure(RUBBING, x) / r
    rate = differentiated(lambda t: -structure(RUBBING, motion(RUBBING, t)[0]) / r, time)
    needed = r * (needed_force(RUBBING, time, pulleys=True) + turning.T @ (RUBBING.damping * speed))

    def equation(s):
        return (r * 1.0 * np.eye(2) + s @ (j * turning)) @ a + s @ ((j * rate + c * turning) @ v)

    theta = np.arctan2(*(x - RUBBING.base).T[::-1])  # from the anchor to the platform
    s = -np.array([np.cos(theta), np.sin(theta)])
    np.testing.assert_allclose(equation(s), needed, rtol=0, atol=1e-8)
    np.testing.assert_allclose(s, r * turning.T, rtol=0, atol=1e-12)  # S τ is r times the generalised force of τ
    assert np.abs(equation(-s) - needed).max() > 0.01


@pytest.mark.parametrize("time", TIMES)
def test_eq3_with_angles_for_rates_or_a_second_velocity_breaks_lagranges_equation(time):
    x, v, a = motion(UNEVEN, time)
    needed, inertia = needed_force(UNEVEN, time, pulleys=False), np.array(UNEVEN.inertia)
    inertial = textbook.mass_matrix(UNEVEN, 10.0, x) @ a
    bias = textbook.bias(UNEVEN, 10.0, x, v)
    np.testing.assert_allclose(inertial + bias, needed, rtol=0, atol=1e-6)
    (c1, c2, _), (s1, s2, _) = np.cos(x[3:]), np.sin(x[3:])
    to_omega = np.array([[1, 0, -s2], [0, c1, s1 * c2], [0, -s1, c1 * c2]])
    omega = to_omega @ v[3:]
    exchanged = bias.copy()
    exchanged[3:] += to_omega.T @ np.cross(omega, inertia * (to_omega @ x[3:]) - inertia * omega)
    assert np.abs(inertial + exchanged - needed).max() > 0.1
    twice = np.concatenate([bias[:3], bias[3:] * v[3:]])  # "C(X, Ẋ) Ẋ", C being a vector
    assert np.abs(inertial + twice - needed).max() > 0.1


def test_eq3_z_axis_upwards_would_need_cables_that_push():
    tensions = textbook.required_tensions(SPATIAL, 10.0, SPATIAL.home, np.zeros(6), np.zeros(6))
    assert tensions.min() > 20
    upwards = np.linalg.solve(-structure(SPATIAL, SPATIAL.home).T, [0, 0, 98.1, 0, 0, 0])  # g = (0, 0, +m g)
    assert upwards.max() < -20


def test_eq4_is_a_force_law_and_no_constraint():
    time, j, jm, k = sympy.symbols("t J J_m K", positive=True)
    beta, motor = (sympy.Function(name)(time) for name in ("beta", "beta_m"))
    energy = j * beta.diff(time) ** 2 / 2 + jm * motor.diff(time) ** 2 / 2 - k * (beta - motor) ** 2 / 2
    pulley, drive = (
        (energy.diff(angle.diff(time)).diff(time) - energy.diff(angle)).expand() for angle in (beta, motor)
    )
    assert sympy.expand(pulley - (j * beta.diff(time, 2) + k * (beta - motor))) == 0  # = −r T
    assert sympy.expand(drive - (jm * motor.diff(time, 2) - k * (beta - motor))) == 0  # = τ
    assert sympy.expand(pulley + drive - (j * beta.diff(time, 2) + jm * motor.diff(time, 2))) == 0  # = τ − r T, Eq. 5
    # A constraint between β and β′, holonomic or not, would leave some direction of their state space unreachable.
    plant = sympy.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-k / j, k / j, 0, 0], [k / jm, -k / jm, 0, 0]])
    by_motor = sympy.Matrix([0, 0, 0, 1 / jm])
    assert sympy.Matrix.hstack(*(plant**power * by_motor for power in range(4))).rank() == 4


@pytest.mark.parametrize("time", TIMES)
def test_eq6_product_the_other_way_round_does_not_exist(time):
    x, v, a = motion(UNEVEN, time)
    speed, second = winding(UNEVEN, time)
    np.testing.assert_allclose(textbook.pulley_speed(UNEVEN, x, v), speed, rtol=0, atol=1e-8)
    np.testing.assert_allclose(textbook.pulley_acceleration(UNEVEN, x, v, a), second, rtol=0, atol=1e-7)
    x, v, a = motion(RUBBING, time)
    with pytest.raises(ValueError, match="mismatch"):
        a @ (-structure(RUBBING, x) / 0.05)
    winds_in = textbook.pulley_speed(RUBBING, x, v) * differentiated(lambda s: lengths(RUBBING, x + s * v), 0.0)
    assert winds_in.max() < 0  # which the paper leaves open: β grows where the cable gets shorter


def spring_loaded(time):
    """β̈, β̈′, τ and T of the flexible robot on the motion, from Newton's law of pulley and motor."""
    tensions = np.array([30.0, 35.0, 40.0, 45.0, 50.0, 55.0])

    def motor(at):
        pose = motion(FLEXIBLE, at)[0]
        spring = 0.05 * tensions + 4e-4 * winding(FLEXIBLE, at)[1]
        return -lengths(FLEXIBLE, pose) / 0.05 + spring / 3.0

    second = winding(FLEXIBLE, time)[1]
    motor_second = differentiated(lambda at: differentiated(motor, at, 4e-3), time, 4e-3)
    torques = 4e-4 * motor_second + 0.05 * tensions + 4e-4 * second
    return second, motor_second, torques, tensions


@pytest.mark.parametrize("time", TIMES)
def test_eq7_pulleys_inertia_multiplies_both_terms(time):
    x, v, a = motion(FLEXIBLE, time)
    _, motor_second, torques, tensions = spring_loaded(time)
    turning, rate = -structure(FLEXIBLE, x) / 0.05, -textbook.jacobian_rate(FLEXIBLE, x, v) / 0.05
    corrected = (torques - 4e-4 * motor_second - 4e-4 * (rate @ v + turning @ a)) / 0.05
    np.testing.assert_allclose(corrected, tensions, rtol=0, atol=1e-6)
    printed = (torques - 4e-4 * motor_second - (4e-4 * rate @ v + turning @ a)) / 0.05
    assert np.abs(printed - tensions).max() > 100


# --- §3.1: planar law -------------------------------------------------------------------------------------------------


def planar_terms(time):
    """M_eq, N and S of Eq. 2 on the motion."""
    x, v, _ = motion(RUBBING, time)
    turning, rate = -structure(RUBBING, x) / 0.05, -textbook.jacobian_rate(RUBBING, x, v) / 0.05
    s = 0.05 * turning.T
    return 0.05 * np.eye(2) + s @ (8e-4 * turning), s @ ((8e-4 * rate + 0.02 * turning) @ v), s


@pytest.mark.parametrize("time", TIMES)
def test_eq9_division_by_components_couples_x_and_y_wrongly(time):
    matrix, bias, s = planar_terms(time)
    torques = np.array([2.0, 1.0, 3.0])
    expected, _ = textbook.forward_dynamics(RUBBING, 1.0, *motion(RUBBING, time)[:2], torques, cable="bilateral")
    np.testing.assert_allclose(np.linalg.solve(matrix, s @ torques - bias), expected, rtol=0, atol=1e-9)
    assert np.abs((s @ torques - bias) / np.diag(matrix) - expected).max() > 0.01


@pytest.mark.parametrize("time", TIMES)
def test_eq10_structure_matrix_has_no_inverse(time):
    matrix, bias, s = planar_terms(time)
    asked = np.array([3.0, -4.0])
    with pytest.raises(np.linalg.LinAlgError, match="square"):
        np.linalg.inv(s)
    with pytest.raises(ValueError, match="mismatch"):
        matrix @ np.linalg.pinv(s)  # the printed order does not exist for any kind of inverse
    torques = np.linalg.pinv(s) @ (matrix @ asked + bias)
    found, _ = textbook.forward_dynamics(RUBBING, 1.0, *motion(RUBBING, time)[:2], torques, cable="bilateral")
    np.testing.assert_allclose(found, asked, rtol=0, atol=1e-9)


def test_eq10_two_motors_alone_would_have_to_push():
    path = find_trajectory("paper-planar", 2)(np.linspace(0, 1, 101))
    for pair in ([0, 1], [1, 2], [0, 2]):
        pull = -np.stack([structure(PLANAR, x)[pair].T for x in path.position])
        assert np.linalg.solve(pull, path.acceleration[..., None]).min() < -1


@pytest.mark.parametrize("time", TIMES)
def test_eq11_matrix_a_is_s(time):
    _, _, s = planar_terms(time)
    wanted = np.array([3.0, -4.0])
    null = np.linalg.svd(s)[2][2]
    null = null * np.sign(null[0])
    assert null.min() > 0  # inside the triangle: α raises every torque at once
    particular = s.T @ np.linalg.solve(s @ s.T, wanted)
    np.testing.assert_allclose(s @ (particular + 7.0 * null), wanted, rtol=0, atol=1e-12)
    another = s + 0.1 * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.abs(s @ s.T @ np.linalg.solve(another @ another.T, wanted) - wanted).max() > 0.1
    alpha = np.max((5.0 - particular) / null)
    least = [linprog(cost, A_eq=s, b_eq=wanted, bounds=[(5.0, None)] * 3).fun for cost in np.eye(3)]
    np.testing.assert_allclose(particular + alpha * null, least, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("stiffness", "damping"), [(2000.0, 10.0), (30.0, 20.0)])
def test_eq14_law_is_pd_and_leaves_an_error_under_a_constant_force(stiffness, damping):
    """Eqs. 12–14, 17–19: z̈ = v + η. With the integral that the text speaks of, η would be worn off."""
    outer, desired = PD(gains=(stiffness, damping)), np.array([0.2, 0.0])

    def loop(_, state):
        zero = np.zeros(1)
        part = {"pose": state[:1], "velocity": state[1:], "reference_pose": desired[:1]}
        part |= {"reference_velocity": zero, "reference_acceleration": zero}
        return np.array([state[1], outer(part)[0] + 1.0])

    matrix = by_columns(lambda states: np.stack([loop(0.0, state) for state in states]), np.zeros(2))
    root = np.sqrt(complex(damping**2 - 4 * stiffness))
    poles = (-damping + np.array([root, -root])) / 2
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(matrix)), np.sort_complex(poles), rtol=1e-6)
    end = solve_ivp(loop, (0.0, 8.0), np.zeros(2), rtol=1e-9, atol=1e-12).y[:, -1]
    assert desired[0] - end[0] == pytest.approx(-1.0 / stiffness, rel=1e-3)


# --- §3.2: spatial law ------------------------------------------------------------------------------------------------


def test_eq15_printed_sign_lets_the_platform_fall_at_twice_gravity():
    still, transposed = np.zeros(6), structure(SPATIAL, SPATIAL.home).T
    x, v, a = motion(SPATIAL, 0.1)
    tensions = np.linalg.solve(-structure(SPATIAL, x).T, needed_force(SPATIAL, 0.1, pulleys=False))
    inverse = np.linalg.inv(textbook.mass_matrix(SPATIAL, 10.0, x))
    bias = textbook.bias(SPATIAL, 10.0, x, v)
    np.testing.assert_allclose(inverse @ (-bias - structure(SPATIAL, x).T @ tensions), a, rtol=0, atol=1e-6)
    hanging = np.linalg.solve(-transposed, [0, 0, -98.1, 0, 0, 0])
    assert hanging.min() > 20
    gravity = textbook.bias(SPATIAL, 10.0, SPATIAL.home, still)
    printed = np.linalg.solve(textbook.mass_matrix(SPATIAL, 10.0, SPATIAL.home), -gravity + transposed @ hanging)
    assert printed[2] == pytest.approx(2 * 9.81)  # z points down


@pytest.mark.parametrize("time", TIMES)
def test_eq16_printed_sign_asks_cables_to_push(time):
    x, v, a = motion(SPATIAL, time)
    pulled = np.linalg.solve(-structure(SPATIAL, x).T, needed_force(SPATIAL, time, pulleys=False))
    whole = np.linalg.solve(-structure(SPATIAL, x).T / 0.05, needed_force(SPATIAL, time, pulleys=True))
    corrected = textbook.required_tensions(SPATIAL, 10.0, x, v, a)
    np.testing.assert_allclose(corrected, pulled, rtol=0, atol=1e-6)
    torques = textbook.required_torques(SPATIAL, corrected, x, v, a)
    np.testing.assert_allclose(torques, whole + 0.01 * winding(SPATIAL, time)[0], rtol=0, atol=1e-7)
    home = np.linalg.solve(structure(SPATIAL, SPATIAL.home).T, textbook.bias(SPATIAL, 10.0, SPATIAL.home, np.zeros(6)))
    assert home.max() < -20


@pytest.mark.parametrize("time", TIMES)
def test_eq17_even_row_i_belongs_to_input_i_half(time):
    def state(at):
        return np.stack(motion(UNEVEN, at)[:2], axis=1).ravel()  # x, ẋ, y, ẏ, …

    inputs, rates = motion(UNEVEN, time)[2], differentiated(state, time)
    for i in range(2, 13, 2):
        assert rates[i - 1] == pytest.approx(inputs[i // 2 - 1], rel=1e-6)
    assert abs(rates[3] - inputs[3]) > 0.1  # v_i of row i: row 4 is ÿ, v₄ is ψ̈, and there is no v₈


# --- §3.3: joint springs ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", TIMES)
def test_eq20_order_of_the_states_contradicts_the_rows_of_eq21(time):
    def both(at):
        """X, Ẋ, and some motor angles and speeds."""
        x, v, _ = motion(FLEXIBLE, at)
        return x, v, np.sin(3 * at) * np.arange(1.0, 7.0), 3 * np.cos(3 * at) * np.arange(1.0, 7.0)

    def printed(at):
        return np.concatenate(both(at))

    def interleaved(at):
        x, v, angle, speed = both(at)
        return np.concatenate([np.stack([x, v], axis=1).ravel(), np.stack([angle, speed], axis=1).ravel()])

    for state, follows in ((printed, False), (interleaved, True)):
        rows, following = differentiated(state, time)[::2], state(time)[1::2]
        assert np.allclose(rows, following, rtol=0, atol=1e-6) is follows
    assert len(printed(time)) == 24  # Eq. 8 counts coordinates, 12; "the last 12 equations" are the motors'


@pytest.mark.parametrize("time", TIMES)
def test_eq21_pulleys_inertia_adds_to_the_platforms(time):
    x, v, a = motion(FLEXIBLE, time)
    s, r, j = structure(FLEXIBLE, x), 0.05, 4e-4
    turning, rate = -s / r, -textbook.jacobian_rate(FLEXIBLE, x, v) / r
    spring = np.linalg.solve(turning.T, needed_force(FLEXIBLE, time, pulleys=True))  # τ − J′ β̈′
    mass, bias = textbook.mass_matrix(FLEXIBLE, 11.0, x), textbook.bias(FLEXIBLE, 11.0, x, v)
    right = -bias - s.T @ (spring - j * rate @ v) / r
    corrected = mass - s.T @ (j * turning) / r
    np.testing.assert_allclose(np.linalg.solve(corrected, right), a, rtol=0, atol=1e-5)
    np.testing.assert_allclose(corrected, mass + j / r**2 * s.T @ s, rtol=0, atol=1e-12)
    printed = mass + s.T @ (j * turning) / r
    assert np.abs(np.linalg.solve(printed, right) - a).max() > 0.1


def mujoco_state(pose, velocity, angle, speed):
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    peer = MujocoRobot(FLEXIBLE)
    peer.set_state(pose, velocity)
    peer.set_motors(angle, speed)
    return peer


def test_eq21_motor_torque_is_not_in_the_platforms_rows():
    x, v, _ = motion(FLEXIBLE, 0.1)
    wound = textbook.static_motor_angle(FLEXIBLE, 11.0, x)
    peer = mujoco_state(x, v, wound, np.zeros(6))
    by_none, by_five = (peer.accelerations(np.full(6, torque)) for torque in (0.0, 5.0))
    np.testing.assert_allclose(by_five, by_none, rtol=0, atol=1e-9)
    motors = peer.motor_accelerations(np.full(6, 5.0)) - peer.motor_accelerations(np.zeros(6))
    np.testing.assert_allclose(motors, 5.0 / 4e-4, rtol=1e-9)
    by_spring = mujoco_state(x, v, wound + 0.1, np.zeros(6)).accelerations(np.zeros(6))
    spring = FLEXIBLE.stiffness * (wound - textbook.pulley_angle(FLEXIBLE, x))
    expected, _ = textbook.forward_dynamics(FLEXIBLE, 11.0, x, v, spring, cable="bilateral")
    np.testing.assert_allclose(by_none, expected, rtol=0, atol=1e-8)  # K (β′ − β) in the place of τ − J′ β̈′
    assert np.abs(by_spring - by_none).max() > 1


def paper_law(robot, states, *, gains=(KP, KD), reference=0.0):
    """τ of Eq. 22 with β̈′ taken from v, v of Eq. 18 about home, for states (N, 24); damping left out."""
    x, v = states[:, :6], states[:, 6:12]
    asked = reference + gains[0] * (robot.home - x) - gains[1] * v
    needed = textbook.inverse_dynamics(robot, robot.mass, x, v, asked)
    return needed.torques + robot.motor_inertia * needed.pulley_accelerations


def flexible_rates(robot, states, torques, friction=0.0):
    """Rates of (X, Ẋ, β′, β̇′), (N, 24)."""
    x, v, angle, speed = np.split(states, 4, axis=1)
    spring = robot.stiffness * (angle - textbook.pulley_angle(robot, x))
    accelerations, _ = textbook.forward_dynamics(robot, robot.mass, x, v, spring, cable="bilateral")
    return np.concatenate(
        [v, accelerations, speed, (torques - spring - friction * speed) / robot.motor_inertia], axis=1
    )


def resting(robot):
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home)
    return np.concatenate([robot.home, np.zeros(6), angle, np.zeros(6)])


def springs(stiffness):
    return FLEXIBLE.replace(transmission=FLEXIBLE.transmission.replace(stiffness=stiffness))


def test_eq22_does_not_determine_a_torque_from_the_measured_acceleration():
    """τ = r T + J β̈ + J′ β̈′ as the law and J′ β̈′ = τ − κ of Eq. 4 are the same equation, but for r T + J β̈ = κ."""
    torque, second, wanted, spring = sympy.symbols("tau beta_m wanted kappa")
    inertia = sympy.symbols("J_m", positive=True)
    law, motor = sympy.Eq(torque, wanted + inertia * second), sympy.Eq(inertia * second, torque - spring)
    assert sympy.solve([law, motor], [torque, second]) == []
    agreed = sympy.solve([law.subs(wanted, spring), motor], [torque, second])
    assert agreed == {torque: spring + inertia * second}  # any β̈′ will do


@pytest.mark.parametrize("stiffness", [2.0, 3.0])
def test_eq22_measured_one_sample_late_diverges_within_a_tenth_of_a_second(stiffness):
    period, inertia = 1 / 500, 4e-4
    plant = expm(period * np.array([[0, 1, 0], [-stiffness / inertia, 0, 1 / inertia], [0, 0, 0]]))
    loop = np.zeros((3, 3))  # β′, β̇′ and β̇′ one sample ago, the pulley held: τ = J′ (β̇′ − its last value)/h
    loop[:2] = plant[:2, [0, 1, 2]] @ np.array([[1, 0, 0], [0, 1, 0], [0, inertia / period, -inertia / period]])
    loop[2, 1] = 1.0
    rate = np.log(np.abs(np.linalg.eigvals(loop)).max()) / period
    assert rate == pytest.approx(np.cbrt(stiffness / (inertia * period)) / 2, rel=0.1)  # s³ + K/(J′ h) = 0
    assert rate * 0.1 > 6


@pytest.mark.parametrize("damping", [1.0, 20.0, 100.0])
@pytest.mark.parametrize("stiffness", [0.1, 3.0, 1e3, 1e6])
def test_eq22_loop_of_one_joint_has_no_cubic_term(stiffness, damping):
    load, motor = 0.04, 4e-4  # M and J′ [kg·m²]
    law = -(load + motor) * np.array([KP, damping])  # τ = (M + J′)(−K_P β − K_D β̇)
    loop = np.array(
        [
            [0, 1, 0, 0],
            [-stiffness / load, 0, stiffness / load, 0],
            [0, 0, 0, 1],
            [(law[0] + stiffness) / motor, law[1] / motor, -stiffness / motor, 0],
        ]
    )
    rest = stiffness * (load + motor) / (load * motor)
    np.testing.assert_allclose(np.poly(loop), [1, 0, rest, rest * damping, rest * KP], rtol=1e-6, atol=1e-6 * rest)
    fastest = np.linalg.eigvals(loop).real.max()
    assert fastest > 0
    if stiffness == 1e6:
        assert fastest == pytest.approx(damping / 2, rel=0.01)  # no stiffness saves it


@pytest.mark.parametrize(("stiffness", "rate"), [(1.0, None), (2.0, 9.5), (3.0, 9.7), (100.0, None), (1e4, None)])
def test_eq22_whole_robot_is_unstable_with_every_stiffness(stiffness, rate):
    """No motor's acceleration depends on its own speed, nor the platform's on its velocity: the trace is zero."""
    robot = springs(stiffness)
    loop = by_columns(lambda states: flexible_rates(robot, states, paper_law(robot, states)), resting(robot))
    poles = np.linalg.eigvals(loop)
    assert abs(np.trace(loop)) < 1e-6 * np.abs(poles).max()
    assert poles.real.max() > 5
    if rate:
        assert poles.real.max() == pytest.approx(rate, rel=0.02)


@pytest.mark.parametrize(("friction", "stable"), [(0.0, False), (0.007, False), (0.01, True)])
def test_eq22_is_saved_by_motor_friction_above_kd_times_the_motors_inertia(friction, stable):
    """K_D J′ is 0.008 N·m·s/rad."""
    robot = springs(3.0)

    def rates(states):
        told = friction * textbook.pulley_speed(robot, states[:, :6], states[:, 6:12])
        return flexible_rates(robot, states, paper_law(robot, states) + told, friction)

    assert bool(np.linalg.eigvals(by_columns(rates, resting(robot))).real.max() < 0) is stable


def test_eq23_platform_does_not_have_the_acceleration_that_the_law_asks_for():
    state = resting(FLEXIBLE)
    state[12:18] += 0.2  # the springs hold more than the platform's weight
    found = []
    for asked in (0.0, 2.0):
        torques = paper_law(FLEXIBLE, state[None], reference=np.full(6, asked))[0]
        peer = mujoco_state(state[:6], state[6:12], state[12:18], state[18:])
        found.append(peer.accelerations(torques))
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)  # no change by v
    assert np.linalg.norm(found[0]) > 1


def flat_state(time):
    """X, Ẋ, β′, β̇′, β̈′ and the τ of Eq. 22 on the motion, β′ from the corrected Eq. 24."""

    def motor(at):
        x, v, a = motion(FLEXIBLE, at)
        needed = textbook.inverse_dynamics(FLEXIBLE, 11.0, x, v, a)
        return textbook.pulley_angle(FLEXIBLE, x) + needed.torques / FLEXIBLE.stiffness

    def speed(at):
        return differentiated(motor, at)

    x, v, a = motion(FLEXIBLE, time)
    second = differentiated(speed, time)
    return x, v, motor(time), speed(time), second, textbook.inverse_dynamics(FLEXIBLE, 11.0, x, v, a).torques


@pytest.mark.parametrize("time", TIMES)
def test_eq24_motors_inertia_cancels(time):
    """MuJoCo, wound by β′ = β + (r T + J β̈)/K and driven by Eq. 22, moves as asked; Eq. 24 says β̈′ = 0 there."""
    x, v, angle, speed, second, rigid = flat_state(time)
    peer = mujoco_state(x, v, angle, speed)
    torques = rigid + 4e-4 * second
    np.testing.assert_allclose(peer.accelerations(torques), motion(FLEXIBLE, time)[2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(peer.motor_accelerations(torques), second, rtol=1e-5, atol=1e-2)
    for divisor in (1 + 4e-4, 4e-4):
        printed = (rigid + 3.0 * (textbook.pulley_angle(FLEXIBLE, x) - angle)) / divisor
        assert np.abs(printed - second).max() > 0.5 * np.abs(second).max()
    assert np.abs(second).max() > 10


@pytest.mark.parametrize(("divisor", "same"), [("J′", True), ("1 + J′", False)])
def test_eq24_divisor_depends_on_the_units(divisor, same):
    accelerations = []
    for units in (Units(1, 1, 1), OTHER_UNITS):
        robot = units.robot(FLEXIBLE)
        x, v, a = units.motion(*motion(FLEXIBLE, 0.1))
        needed = textbook.inverse_dynamics(robot, robot.mass, x, v, a)
        torques = needed.torques + robot.stiffness * (textbook.pulley_angle(robot, x) - 1.5)
        inertia = robot.motor_inertia + (divisor == "1 + J′")
        accelerations.append(torques / inertia * units.s**2)
    assert np.allclose(*accelerations, rtol=1e-9) is same


def test_eq25_stiffness_alone_is_no_frequency():
    """The motor swings against its held pulley at √(K/J′), 13.8 Hz; Eq. 25 has √K = 1.7 rad/s, in any unit of mass."""
    robot, state = springs(3.0), resting(springs(3.0))
    loop = by_columns(lambda states: flexible_rates(robot, states, np.zeros((1, 6))), state)
    held = loop[12:, 12:]  # β′ and β̇′, the platform held
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(held).imag), np.sqrt(3.0 / 4e-4), rtol=1e-6)
    in_other_units = OTHER_UNITS.robot(robot)
    ratio = in_other_units.stiffness / in_other_units.motor_inertia * OTHER_UNITS.s**2
    np.testing.assert_allclose(ratio, 3.0 / 4e-4)
    assert np.sqrt(in_other_units.stiffness[0]) * OTHER_UNITS.s > 2 * np.sqrt(3.0)


def test_eq25_oscillator_without_damping_is_not_stable_under_the_slightest_resonance():
    inertia, stiffness = 4e-4, 3.0
    rate, small = math.sqrt(stiffness / inertia), 1e-3
    swing = solve_ivp(
        lambda t, y: [y[1], (small * math.sin(rate * t) - stiffness * y[0]) / inertia],
        (0.0, 40 * math.pi / rate),
        [0.0, 0.0],
        rtol=1e-9,
        atol=1e-12,
        dense_output=True,
    ).sol
    for turns in (10, 20):
        times = np.linspace((turns - 1) * 2 * math.pi, turns * 2 * math.pi, 400) / rate
        assert np.abs(swing(times)[0]).max() == pytest.approx(small * times[-1] / (2 * inertia * rate), rel=0.05)


# --- §3.4: robust law -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", TIMES)
def test_eq27_gain_of_the_input_includes_the_pulleys(time):
    """γ = ∂τ/∂v from the kinetic energy: the momentum ∂L/∂Ẋ is linear in Ẋ, with the whole mass matrix."""
    x, _, _ = motion(SPATIAL, time)
    whole = np.stack([momentum(SPATIAL, 10.0, x, e, pulleys=True) for e in np.eye(6)], axis=1)
    s = structure(SPATIAL, x)
    slope = np.linalg.solve(-s.T / 0.05, whole)
    printed = -0.05 * np.linalg.solve(s.T, textbook.mass_matrix(SPATIAL, 10.0, x))
    np.testing.assert_allclose(printed - 8e-4 * s / 0.05, slope, rtol=0, atol=1e-8)
    assert np.abs(printed - slope).max() > 0.005


def controllability_margin(plant, inputs):
    """Least singular value of [λ − A, B] over the poles λ (Hautus); 0 if some state cannot be controlled."""
    ends = (np.hstack([pole * np.eye(len(plant)) - plant, inputs]) for pole in np.linalg.eigvals(plant))
    return min(np.linalg.svd(end, compute_uv=False)[-1] for end in ends)


def test_eq27_fewer_inputs_than_coordinates_are_not_uncontrollable():
    robot, state = FLEXIBLE, resting(FLEXIBLE)
    plant = by_columns(lambda states: flexible_rates(robot, states, np.zeros((1, 6))), state)
    inputs = by_columns(lambda torques: flexible_rates(robot, np.tile(state, (len(torques), 1)), torques), np.zeros(6))
    scale = np.repeat([1.0, 0.01, 1.0, 0.01], 6)  # seconds to hundredths
    plant, inputs = 0.01 * plant * scale[:, None] / scale, 0.01 * inputs * scale[:, None]
    assert controllability_margin(plant, inputs) > 1e-5
    broken = plant.copy()
    broken[18, 18:] = broken[18, :18] = 0.0
    torn = inputs.copy()
    torn[18, 0] = 0.0  # without its first motor, it is not
    assert controllability_margin(broken, torn) < 1e-10
    # Relative degree four: τ enters the fourth derivative of X, and nothing before, by an invertible matrix.
    outputs = np.eye(6, 24)
    for power in range(3):
        np.testing.assert_allclose(outputs @ np.linalg.matrix_power(plant, power) @ inputs, 0, atol=1e-6)
    assert np.linalg.cond(outputs @ np.linalg.matrix_power(plant, 3) @ inputs) < 1e3


def parts_of_law(robot, mass, pose, velocity):
    """α and γ of Eq. 27, corrected."""
    at_rest = textbook.inverse_dynamics(robot, mass, pose, velocity, np.zeros(6)).torques
    slope = by_columns(lambda a: textbook.inverse_dynamics(robot, mass, pose, velocity, a).torques, np.zeros(6), 1.0)
    return at_rest, slope


def test_eq30_uncertainty_has_the_pulleys_in_gamma():
    """ż = v + η (Eqs. 28–30) on a rigid robot heavier than told, against the plant; printed γ gives another η."""
    true = SPATIAL.replace(mass=11.5, transmission=SPATIAL.transmission.replace(pulley_inertia=3e-3))
    x, v, asked = motion(SPATIAL, 0.1)
    (alpha, gamma), (told_alpha, told_gamma) = parts_of_law(true, 11.5, x, v), parts_of_law(SPATIAL, 10.0, x, v)
    torques = told_alpha + told_gamma @ asked
    found, _ = textbook.forward_dynamics(true, 11.5, x, v, torques, cable="bilateral")

    def eta(gamma, told):
        return np.linalg.solve(gamma, told @ asked + told_alpha - alpha) - asked

    np.testing.assert_allclose(eta(gamma, told_gamma), found - asked, rtol=0, atol=1e-7)
    printed = [
        np.linalg.solve(-structure(SPATIAL, x).T / 0.05, textbook.mass_matrix(SPATIAL, mass, x))
        for mass in (11.5, 10.0)
    ]
    assert np.abs(eta(*printed) - (found - asked)).max() > 0.1


@pytest.mark.parametrize("error", [1, -1], ids=["z_d - z", "z - z_d"])
def test_eq31_is_positive_feedback_and_eq18_is_not(error):
    """Poles of z̈ = v in the error's own state, whatever the error is called."""

    def poles(sign):
        # v − z̈_d = sign (k₁ (ż_d − ż) + k₂ (z_d − z)); e = ± (z_d − z) has ë = ∓ (v − z̈_d).
        def rates(states):
            missing, missing_rate = error * states[:, 0], error * states[:, 1]
            return np.stack([states[:, 1], -error * sign * (KD * missing_rate + KP * missing)], axis=1)

        return np.linalg.eigvals(by_columns(rates, np.zeros(2)))

    assert poles(-1).real.max() > 1  # as printed
    assert poles(1).real.max() < -1


@pytest.mark.parametrize(("proportional", "end"), [("z_d - z", 0.0), ("integral of the velocity's", 0.02)])
def test_eq31_integral_of_the_velocity_error_never_sees_where_the_robot_started(proportional, end):
    """Signs corrected; 0.02 m off at first, desired rest at 0. The integral is e(t) − e(0)."""

    def loop(_, state):
        z, rate, integral = state
        missing = -z if proportional == "z_d - z" else integral
        return [rate, -KD * rate + KP * missing, -rate]

    final = solve_ivp(loop, (0.0, 8.0), [0.02, 0.0, 0.0], rtol=1e-9, atol=1e-12).y[0, -1]
    assert final == pytest.approx(end, abs=1e-5)


LYAPUNOV = solve_continuous_lyapunov(np.array([[0, -KP], [1, -KD]]), -np.eye(2))


def robust_run(error, sign):
    """V, ‖e‖ and ψ's equation along a run of z̈ = v + η: a platform 15 % too heavy in an unknown force.

    e = ±(z_d − z), Δv = sign ρ BᵀPe/‖BᵀPe‖ with a layer of 1e-4, the rest of v is Eq. 18's.
    """
    zeta, force = 0.15, 1.0

    def parts(time, state):
        desired = 0.1 * np.array([np.sin(3 * time), 3 * np.cos(3 * time), -9 * np.sin(3 * time)])
        e = error * (desired[:2] - state)
        s = LYAPUNOV[1] @ e
        rho = (zeta * (abs(desired[2]) + np.linalg.norm([e[1], KP * e[0] + KD * e[1]])) + force) / (1 - zeta)
        extra = sign * rho * s / max(abs(s), 1e-4)
        asked = desired[2] + error * (KP * e[0] + KD * e[1]) + extra
        eta = (1 / 1.15 - 1) * asked - force * np.cos(2 * time)
        return e, asked, eta, extra, desired

    run = solve_ivp(
        lambda time, state: [state[1], sum(parts(time, state)[1:3])],
        (0.0, 2.0),
        [0.02, 0.0],
        rtol=1e-8,
        atol=1e-10,
        t_eval=np.linspace(0.0, 2.0, 401),
        method="LSODA",
    )
    errors = np.array([parts(time, state)[0] for time, state in zip(run.t, run.y.T, strict=True)])
    residual = []
    for time, state in zip(run.t, run.y.T, strict=True):
        e, asked, eta, extra, desired = parts(time, state)
        second = error * (desired[2] - asked - eta)
        residual.append(second + KD * e[1] + KP * e[0] - (eta + extra))
    return np.einsum("ki,ij,kj->k", errors, LYAPUNOV, errors), np.abs(errors[:, 0]).mean(), np.array(residual)


@pytest.mark.parametrize(("error", "sign"), [(1, 1), (-1, -1)], ids=["z_d - z, plus", "z - z_d, minus"])
def test_eq34_sign_belongs_to_the_error_and_the_other_raises_it(error, sign):
    value, mean, residual = robust_run(error, sign)
    _, raised, _ = robust_run(error, -sign)
    _, plain, _ = robust_run(error, 0)
    outside = int(np.argmax(value < 1e-5))
    assert outside > 10
    assert np.all(np.diff(value[:outside]) < 0)
    assert mean < 0.5 * plain
    assert raised > 2.5 * plain
    # Eq. 32, + (ψ + Δv) on its right, is right for e = z − z_d alone; Eq. 33's ψ is η.
    assert np.allclose(residual, 0, atol=1e-9) is (error == -1)


def test_eq36_printed_system_has_no_lyapunov_matrix():
    printed, corrected = (np.kron(np.eye(6), [[0.0, 1.0], [sign * KP, sign * KD]]) for sign in (1, -1))
    solution = solve_continuous_lyapunov(corrected.T, -np.eye(12))
    np.testing.assert_allclose(corrected.T @ solution + solution @ corrected, -np.eye(12), atol=1e-12)
    assert np.linalg.eigvalsh(solution).min() > 0
    of_printed = solve_continuous_lyapunov(printed.T, -np.eye(12))
    np.testing.assert_allclose(printed.T @ of_printed + of_printed @ printed, -np.eye(12), atol=1e-10)
    assert np.linalg.eigvalsh(of_printed).min() < 0  # the only solution


def test_eq36_input_matrix_has_two_rows_too_many():
    def unit(column):
        return np.eye(6)[column]

    pairs = [unit(0), unit(1), unit(2), unit(3), unit(3), unit(4), unit(5)]  # as printed, ψ's twice
    printed = np.array([row for pair in pairs for row in (np.zeros(6), pair)])
    with pytest.raises(ValueError, match="mismatch"):
        printed.T @ np.eye(12)
    corrected = np.delete(printed, [8, 9], axis=0)

    def state_rate(inputs):  # e = (e_x, ė_x, e_y, …): an input is the second derivative of its own error
        return np.stack([np.stack([np.zeros(6), row], axis=1).ravel() for row in inputs])

    np.testing.assert_allclose(by_columns(state_rate, np.zeros(6)), corrected, atol=1e-12)


def test_eq36_norm_of_metres_and_radians_depends_on_the_unit_of_length():
    outer, e = RobustPD(gains=(KP, KD), boundary_layer=1e-9, phi=0.0), np.array([0.01, 0.0, 0.0, 0.02, 0.0, 0.0])
    zero, turning, extra = np.zeros(6), np.array([0.0, 0.0, 0.0, 5.0, 0.0, 0.0]), []
    for unit in (1.0, 100.0):
        scale = np.array([unit] * 3 + [1.0] * 3)
        part = {"reference_pose": scale * e, "pose": zero, "reference_velocity": zero, "velocity": zero}
        asked = outer(part | {"reference_acceleration": turning})
        extra.append((asked - turning - KP * scale * e) / scale)
    assert extra[0][3] > 0.1
    assert extra[1][3] < 0.5 * extra[0][3]  # the same errors, in centimetres


@pytest.mark.parametrize("bracket", ["around both", "before the last term"])
def test_eq36_bracket_of_rho_closes_after_the_last_term(bracket):
    """ρ has to bound ‖ψ‖, which ρ itself enlarges: at the worst of what ζ, γ̄ and φ allow, it is just enough."""
    rng = np.random.default_rng(3)
    slack = []
    for _ in range(200):
        zeta, gain, phi, asked, drift = *rng.uniform(0.05, 0.9, 1), *rng.uniform(0.1, 5, 4)
        known, unknown = zeta * (asked + drift), gain * phi
        rho = (known + unknown) / (1 - zeta) if bracket == "around both" else known / (1 - zeta) + unknown
        slack.append(rho - (zeta * (asked + drift + rho) + unknown))  # less ‖η(v)‖ at v = ‖z̈_d‖ + ‖Ae‖ + ρ
    if bracket == "around both":
        np.testing.assert_allclose(slack, 0, atol=1e-9)
    else:
        assert max(slack) < 0


# --- §5: load ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bisected():
    """Payload that the motors just bear on Table 3's circle, 500 instants, by bisection."""
    times = np.arange(500) / 500
    path = find_trajectory("paper-spatial", 6)(times)

    def borne(payload):
        needed = textbook.inverse_dynamics(SPATIAL, 10.0 + payload, path.position, path.velocity, path.acceleration)
        drop = 10.0 / (1000 * RPM) * needed.speeds
        return np.all((needed.torques <= 10.0 - drop) & (needed.torques >= -10.0 - drop))

    low, high = 0.0, 20.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if borne(middle) else (low, middle)
    return low


def test_eq37_printed_margin_finds_half_of_the_load(bisected):
    circle = find_trajectory("paper-spatial", 6)
    whole, half = (iterate_load(SPATIAL, circle, guess=5.0, corrected=corrected) for corrected in (True, False))
    assert whole.payload == pytest.approx(bisected, abs=1e-5)
    assert half.payload == pytest.approx(bisected / 2, abs=1e-5)
    assert half.converged  # and says nothing of it


def test_eq37_limit_is_the_one_that_the_load_drives_the_torque_to():
    """A torque p + m s of 5 N·m motors: the largest m, sign by τ_e − τ_n, not by τ_e."""
    grid = np.linspace(0.0, 200.0, 200001)
    for offset, slope in [(2.0, 0.5), (2.0, -0.5), (-2.0, 0.5), (-2.0, -0.5), (0.3, -1.0)]:
        true = grid[np.abs(offset + slope * grid) <= 5.0].max()
        guess = 0.1
        full, empty = np.full(3, offset + slope * guess), np.full(3, offset)
        corrected = load_coefficient(PLANAR, full, empty, np.zeros(3), corrected=True)[0] * guess
        assert corrected == pytest.approx(true, abs=2e-3)
        by_sign_of_full = abs((math.copysign(5.0, full[0]) - offset) / slope)
        assert bool(abs(by_sign_of_full - true) < 2e-3) is (offset * slope > 0)


def test_eq37_speed_is_the_motors_and_not_the_cables():
    """k₂ q̇ has to be a torque: with cable speeds the line depends on the unit of length."""
    lines = {"motor": [], "cable": []}
    for units in (Units(1, 1, 1), OTHER_UNITS):
        robot = units.robot(SPATIAL)
        x, v, _ = units.motion(*motion(SPATIAL, 0.1))
        turning = textbook.pulley_speed(robot, x, v)
        for name, speed in (("motor", turning), ("cable", -robot.pulley_radius * turning)):
            lines[name].append(textbook.torque_limits(robot, speed)[1] / units.torque)
    np.testing.assert_allclose(*lines["motor"], rtol=1e-9)
    assert np.abs(lines["cable"][0] - lines["cable"][1]).max() > 0.1


def test_eq38_absolute_value_hides_an_overloaded_motor():
    """6 N·m without load and 7 with 1 kg, of motors of 5: less than nothing can be borne."""
    printed, corrected = (
        load_coefficient(PLANAR, np.full(3, 7.0), np.full(3, 6.0), np.zeros(3), corrected=form)
        for form in (False, True)
    )
    assert printed.min() > 0
    assert corrected.max() < 0


def test_eq39_coefficient_multiplies_the_guessed_load_and_not_the_end_effectors_mass(bisected):
    path = find_trajectory("paper-spatial", 6)(np.arange(500) / 500)
    circle = (path.position, path.velocity, path.acceleration)
    empty = textbook.inverse_dynamics(SPATIAL, 10.0, *circle)
    coefficients = {}
    for guess in (2.0, 5.0):
        full = textbook.inverse_dynamics(SPATIAL, 10.0 + guess, *circle).torques
        coefficients[guess] = load_coefficient(SPATIAL, full, empty.torques, empty.speeds, corrected=True).min()
        assert coefficients[guess] * guess == pytest.approx(bisected, abs=1e-6)
    by_mass = [10.0 * coefficient for coefficient in coefficients.values()]
    assert by_mass[0] == pytest.approx(2.5 * by_mass[1])  # an answer that moves with the guess is none
    assert abs(by_mass[0] - bisected) > 1


def test_eq41_least_tensions_of_three_cables_are_not_linear_in_the_mass():
    def second_difference(robot, masses, minimum):
        path = find_trajectory(f"paper-{robot.name}", robot.coordinates)(np.linspace(0, 1, 101))
        x, v, a = path.position, path.velocity, path.acceleration
        one, two, three = (textbook.inverse_dynamics(robot, m, x, v, a, minimum=minimum).torques for m in masses)
        return one - 2 * two + three, textbook.jacobian(robot, x)

    bent, s = second_difference(PLANAR, (0.1, 2.1, 4.1), 5.0)
    np.testing.assert_allclose(np.einsum("kij,ki->kj", s, bent), 0, atol=1e-12)  # S τ is, as Eq. 41 says
    assert np.abs(bent).max() > 0.1  # τ is not: it has a kink where the pair of cables above T_min changes
    np.testing.assert_allclose(second_difference(PLANAR, (0.1, 2.1, 4.1), 0.0)[0], 0, atol=1e-12)  # none at T_min = 0
    np.testing.assert_allclose(second_difference(SPATIAL, (10.0, 12.0, 14.0), 0.0)[0], 0, atol=1e-10)


# --- tables and text --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "radius"), [("paper-planar", 0.2165), ("paper-spatial", 0.1)])
def test_table1_acceleration_jumps_half_way(name, radius):
    """Tables 1 and 3 as printed; what jumps is the tangential acceleration, from +8π to −8π radii per s²."""

    def printed(t):
        angle = np.where(t <= 0.5, 4 * np.pi * t**2, -4 * np.pi * (1 - t) ** 2)
        return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    times = np.linspace(0.0, 1.0, 201)
    path = find_trajectory(name, 2 if "planar" in name else 6)
    np.testing.assert_allclose(path(times).position[:, :2], printed(times), atol=1e-12)
    before, after = (
        differentiated(lambda t: differentiated(printed, t, 2e-5), 0.5 + side, 2e-5) for side in (-1e-4, 1e-4)
    )
    assert np.abs(after - before)[1] == pytest.approx(16 * np.pi * radius, rel=0.02)
    speeds = [differentiated(printed, 0.5 + side, 2e-5) for side in (-1e-4, 1e-4)]
    assert speeds[0][1] == pytest.approx(speeds[1][1], rel=1e-3)


def test_table2_missing_friction_moves_the_planar_load():
    circle = find_trajectory("paper-planar", 2)
    as_in_table4 = PLANAR.replace(transmission=PLANAR.transmission.replace(damping=0.01))
    loads = [exact_payload(robot, circle, frequency=500.0).payload for robot in (PLANAR, as_in_table4)]
    assert loads[0] - loads[1] > 0.05


@pytest.mark.parametrize(
    ("quantity", "unit", "right"),
    [
        ("c", "N·m·s/rad", True),
        ("c", "N·m/rad", False),  # Table 4
        ("K", "N·m/rad", True),  # Table 5
        ("K", "N/rad", False),  # §5.2.3
    ],
)
def test_table4_units_of_friction_and_stiffness(quantity, unit, right):
    """κ = r T + J β̈ + c β̇ and β′ = β + κ/K describe the same motion in other units only if c and K have theirs."""
    found = []
    given = {"c": 0.01, "K": 3.0}
    for units in (Units(1, 1, 1), OTHER_UNITS):
        scales = {
            "N·m·s/rad": units.damping,
            "N·m/rad": units.torque,
            "N/rad": units.force,
        }
        own = {"c": "N·m·s/rad", "K": "N·m/rad"} | {quantity: unit}
        c, k = (given[name] * scales[own[name]] for name in ("c", "K"))
        robot = units.robot(FLEXIBLE)
        robot = robot.replace(transmission=robot.transmission.replace(damping=c, stiffness=k))
        x, v, a = units.motion(*motion(FLEXIBLE, 0.1))
        torques = textbook.inverse_dynamics(robot, robot.mass, x, v, a).torques
        found.append(textbook.pulley_angle(robot, x) + torques / robot.stiffness)
    assert np.allclose(*found, rtol=1e-9) is right


def test_table4_no_platform_of_this_size_has_this_inertia():
    """The largest I_zz of 11 kg within a triangle puts all of them into its corners."""
    for circumradius in (2 * 0.148 / math.sqrt(3), 0.148):
        corners = circumradius * np.array([[np.cos(a), np.sin(a)] for a in np.radians([90, 210, 330])])
        weights = np.array([(i, j, 20 - i - j) for i in range(21) for j in range(21 - i)]) / 20
        points = weights @ corners
        squares = np.sum(points**2, axis=1)
        best = linprog(-squares, A_eq=np.stack([np.ones(len(points)), *points.T]), b_eq=[11.0, 0, 0])
        assert best.status == 0
        assert -best.fun < 1.16 / 3
    assert math.sqrt(1.16 / 11) == pytest.approx(0.325, abs=5e-4)  # radius of gyration
    assert SPATIAL.inertia[0] + SPATIAL.inertia[1] == pytest.approx(SPATIAL.inertia[2])  # of a flat plate: so no slip


def test_table4_mass_against_table8_moves_the_load_by_a_kilogram():
    circle = find_trajectory("paper-spatial", 6)
    ten, eleven = (exact_payload(SPATIAL.replace(mass=mass), circle, frequency=500.0) for mass in (10.0, 11.0))
    assert ten.payload - eleven.payload == pytest.approx(1.0, abs=1e-6)
    assert ten.total_mass == pytest.approx(eleven.total_mass, abs=1e-6)


def test_table5_inertias_are_halves_of_table4s_and_its_stiffness_is_not_that_of_the_text():
    """J + J′ of Table 5 is J of Table 4. K = 2 and 3 are robots whose springs are wound by angles 1.5 times apart."""
    assert FLEXIBLE.pulley_inertia[0] + FLEXIBLE.motor_inertia[0] == pytest.approx(SPATIAL.pulley_inertia[0])
    wound = [springs(k).stiffness * textbook.static_motor_angle(springs(k), 11.0, SPATIAL.home) for k in (2.0, 3.0)]
    np.testing.assert_allclose(*wound, rtol=1e-12)
    soft, stiff = (textbook.static_motor_angle(springs(k), 11.0, SPATIAL.home) for k in (2.0, 3.0))
    assert (soft - stiff).min() > 0.1


def test_table6_variance_is_in_square_newtons_and_a_tenth_of_the_mass_needs_more_than_a_tenth_of_zeta():
    deviation = UNCERTAINTIES["table6"](SPATIAL).wrench.force_std
    assert deviation**2 == pytest.approx(0.2)  # N²: a deviation of 0.45 N, not 0.2
    x, v, _ = motion(SPATIAL, 0.1)
    light, told = (parts_of_law(SPATIAL, mass, x, v)[1] for mass in (9.0, 10.0))
    zeta = np.linalg.norm(np.linalg.solve(light, told) - np.eye(6), 2)
    assert 0.1 < zeta < 1 / 0.9 - 1 + 0.01


def test_text_of_5_1_error_under_a_load_that_is_not_told_leaves_its_bound():
    """1 kg at rest: the law's K_P e of 10 kg has to carry it, e = m g/(m̂ K_P), about 33 mm, where R is 10 mm."""
    outer, still = PD(gains=(KP, KD)), np.zeros(6)

    def rates(_, state):
        part = {"pose": state[:6], "velocity": state[6:], "reference_pose": SPATIAL.home}
        part |= {"reference_velocity": still, "reference_acceleration": still}
        torques = textbook.inverse_dynamics(SPATIAL, 10.0, state[:6], state[6:], outer(part)).torques
        return np.concatenate(
            [state[6:], textbook.forward_dynamics(SPATIAL, 11.0, state[:6], state[6:], torques, cable="bilateral")[0]]
        )

    end = solve_ivp(rates, (0.0, 6.0), np.concatenate([SPATIAL.home, still]), rtol=1e-6, atol=1e-9).y[:, -1]
    # J β̈(v) of the law carries a little too: (D + (J/r²) SᵀS) K_P e, with S where it has sagged to.
    carrying = 10.0 + 8e-4 / 0.05**2 * np.sum(structure(SPATIAL, end[:6])[:, 2] ** 2)
    assert end[2] - 0.1 == pytest.approx(9.81 / (carrying * KP), rel=1e-3)
    assert end[2] - 0.1 > 3 * 0.01


def test_text_of_the_conclusion_drop_of_the_load_is_no_thirty_percent():
    published = {"rigid": 2.56, "flexible": 1.4}
    drop = 1 - published["flexible"] / published["rigid"]
    assert drop == pytest.approx(0.45, abs=0.005)
    for platform in (10.0, 11.0):  # nor is it with the platform counted
        total = [platform + load for load in published.values()]
        assert abs(1 - total[1] / total[0] - 0.3) > 0.1


# --- the page ---------------------------------------------------------------------------------------------------------


def sections():
    """Headings of the page and what stands under each."""
    parts = re.split(r"^## (.+)$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def named_tests(text):
    return set(re.findall(r"tests/test_errata\.py::(test_\w+)", text))


def test_page_names_every_test_of_this_file_and_no_other():
    members = inspect.getmembers(sys.modules[__name__], inspect.isfunction)
    assert named_tests(PAGE.read_text(encoding="utf-8")) == {name for name, _ in members if name.startswith("test_")}


def test_page_has_no_section_without_a_test_and_no_equation_without_a_section():
    untested = [heading for heading, text in sections().items() if not named_tests(text)]
    assert untested == []
    covered = set()
    for heading in sections():
        for first, last in re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", heading):
            covered |= set(range(int(first), int(last or first) + 1))
    assert covered == set(range(1, 42))
    assert {f"Table {number}" for number in (1, 2, 4, 5, 6)} <= set(re.findall(r"Table \d", " ".join(sections())))
