"""The corrections of docs/errata.md against Lagrange's equation in finite differences, MuJoCo, dimensions,
bisection and plain integrators. Where it is cheap, the printed form is shown to be wrong."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal
from oracles.mujoco_model import MujocoRobot
from oracles.plants import (
    State,
    differentiated,
    energies,
    textbook_rates,
    with_transmission,
)
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import linprog

from cablebot_baselines.classical import PD, RobustPD
from cablebot_baselines.paper.load_iteration import (
    iterate_load,
    load_coefficient,
)
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, RPM, SPATIAL
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.uncertainty import UNCERTAINTIES

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "errata.md"
RUBBING = with_transmission(PLANAR, damping=0.02)
"""The planar robot with friction, so that no term of Eqs. 1 and 2 vanishes."""
UNEVEN = SPATIAL.replace(inertia=(0.9, 0.3, 0.7))
"""The spatial robot with three different moments: with I_xx = I_yy some wrong terms cancel."""
FLEXIBLE = FLEX_SPATIAL.replace(mass=11.0)
"""Table 5 with the K of §5.2.3."""
KP = 30.0
KD = 20.0
"""Gains of Tables 4 and 5."""
RADIUS = 0.05
each_time = pytest.mark.parametrize("time", [0.1, 0.8])

# --- independent references -------------------------------------------------------------------------------------------


def slope(function, at, step=1e-3):
    """df/dt at a time."""
    return differentiated(lambda time: function(at + time), step)


def motion(robot, time):
    """X, Ẋ, Ẍ of some smooth motion well inside the workspace, in closed form."""
    n = robot.coordinates
    size = np.array([0.1, 0.1] if robot.planar else [0.08, 0.08, 0.05, 0.2, 0.2, 0.2])
    rate = np.linspace(4.0, 7.0, n)
    phase = np.linspace(0.3, 5.0, n)
    middle = robot.home + (np.zeros(2) if robot.planar else np.array([0, 0, 0.3, 0, 0, 0]))
    sine = np.sin(rate * time + phase)
    cosine = np.cos(rate * time + phase)
    return middle + size * sine, size * rate * cosine, -size * rate**2 * sine


def momentum(robot, pose, velocity):
    """∂L/∂Ẋ."""
    return gradient(lambda v: lagrangian(robot, pose, v), velocity)


def lagrangian(robot, pose, velocity):
    no_motors = np.zeros((2, 1, robot.cables))
    kinetic, potential = energies(robot, State(pose[None], velocity[None], *no_motors))
    return (kinetic - potential)[0]


def gradient(function, at):
    return np.array([slope(lambda s, e=e: function(at + s * e), 0.0) for e in np.eye(len(at))])


def needed_force(robot, time, *, pulleys):
    """d/dt ∂L/∂Ẋ − ∂L/∂X on the motion: the generalised force that it needs from outside, (n,)."""
    robot = with_transmission(
        robot,
        pulley_inertia=pulleys * robot.pulley_inertia,
        stiffness=None,
        motor_inertia=None,
    )
    x, v, _ = motion(robot, time)
    rate = slope(lambda t: momentum(robot, *motion(robot, t)[:2]), time)
    return rate - gradient(lambda pose: lagrangian(robot, pose, v), x)


def turning(robot, time):
    """G = ∂β/∂X and Ġ on the motion."""
    x, v, _ = motion(robot, time)
    return -textbook.jacobian(robot, x) / RADIUS, -textbook.jacobian_rate(robot, x, v) / RADIUS


def by_columns(function, at, step=1e-6):
    """Jacobian of a batched function (N, n) → (N, k) by central differences, (k, n)."""
    ahead, behind = np.split(
        function(np.concatenate([at + step * np.eye(len(at)), at - step * np.eye(len(at))])),
        2,
    )
    return (ahead - behind).T / (2 * step)


def flexible_rates(robot, states, torques):
    """Rates of (X, Ẋ, β′, β̇′), (N, 24)."""
    rates, _ = textbook_rates(robot, State(*np.split(states, 4, axis=1)), torques)
    return np.concatenate(list(vars(rates).values()), axis=1)


def resting(robot):
    angle = textbook.static_motor_angle(robot, robot.mass, robot.home)
    return np.concatenate([robot.home, np.zeros(6), angle, np.zeros(6)])


def mujoco_state(state):
    """The flexible robot in MuJoCo at (X, Ẋ, β′, β̇′)."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    pose, velocity, angle, speed = np.split(np.concatenate(state) if isinstance(state, tuple) else state, 4)
    peer = MujocoRobot(FLEXIBLE)
    peer.set_state(pose, velocity)
    peer.set_motors(angle, speed)
    return peer


# --- §2: models -------------------------------------------------------------------------------------------------------


@each_time
def test_eq1_and_eq7_inertia_times_the_whole_acceleration(time):
    """Eq. 7 is Eq. 1 with the torque of the spring in place of the motor's."""
    (_, v, a), (g, rate), j = motion(UNEVEN, time), turning(UNEVEN, time), 8e-4
    friction = 0.01 * (g @ v)
    torques = np.linalg.solve(g.T, needed_force(UNEVEN, time, pulleys=True)) + friction
    tensions = np.linalg.solve(RADIUS * g.T, needed_force(UNEVEN, time, pulleys=False))
    corrected = (torques - j * (rate @ v + g @ a) - friction) / RADIUS
    assert_allclose(corrected, tensions, rtol=0, atol=1e-6)
    for printed in (
        j * (g @ a),
        j * rate @ v + g @ a,
    ):  # in Eq. 1, ∂β/∂X does not depend on T
        assert np.abs((torques - printed - friction) / RADIUS - tensions).max() > 0.1


@each_time
def test_eq2_with_the_jacobian_of_eq3_loses_the_pulleys_inertia(time):
    (x, v, a), (g, rate) = motion(RUBBING, time), turning(RUBBING, time)
    required = RADIUS * (needed_force(RUBBING, time, pulleys=True) + g.T @ (0.02 * g @ v))

    def equation(s):
        return (RADIUS * np.eye(2) + s @ (8e-4 * g)) @ a + s @ ((8e-4 * rate + 0.02 * g) @ v)

    theta = np.arctan2(*(x - RUBBING.base).T[::-1])  # from the anchor to the platform
    s = -np.array([np.cos(theta), np.sin(theta)])
    assert_allclose(equation(s), required, rtol=0, atol=1e-8)
    assert_allclose(s, RADIUS * g.T, rtol=0, atol=1e-12)  # S τ is r times the generalised force of τ
    assert np.abs(equation(-s) - required).max() > 0.01


@each_time
def test_eq3_angles_for_rates_break_lagranges_equation(time):
    (x, v, a), inertia = motion(UNEVEN, time), np.array(UNEVEN.inertia)
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
    """Division by components couples x and y wrongly; S has no inverse, and M_eq S⁻¹ does not exist."""
    (x, v, _), (g, rate) = motion(RUBBING, time), turning(RUBBING, time)
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
    assert np.abs(s @ s.T @ np.linalg.solve(another @ another.T, desired_force) - desired_force).max() > 0.1


def outer_loop(law, pose, velocity, reference=0.0, acceleration=0.0):
    """The acceleration that an outer loop asks for, about a resting reference."""
    blocks = {
        "pose": pose,
        "velocity": velocity,
        "reference_pose": reference + 0 * pose,
    }
    return law(
        blocks
        | {
            "reference_velocity": 0 * pose,
            "reference_acceleration": acceleration + 0 * pose,
        }
    )


@pytest.mark.parametrize(("stiffness", "damping"), [(2000.0, 10.0), (30.0, 20.0)])
def test_eq14_law_is_pd_and_leaves_an_error_under_a_force(stiffness, damping):
    """Eqs. 12–14, 17–19: z̈ = v + η. With the integral that the text speaks of, η would leave no error."""
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
    assert hanging.min() > 20  # so z points down (Eq. 3); upwards, and with the sign of Eq. 16, all cables push
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


# --- §3.3: joint springs ----------------------------------------------------------------------------------------------


@each_time
def test_eq21_inertia_of_the_pulleys_adds_to_the_platform(time):
    (x, v, a), (g, rate), j = (
        motion(FLEXIBLE, time),
        turning(FLEXIBLE, time),
        4e-4,
    )
    spring = np.linalg.solve(g.T, needed_force(FLEXIBLE, time, pulleys=True))  # τ − J′ β̈′
    right = -textbook.bias(FLEXIBLE, 11.0, x, v) + g.T @ (spring - j * rate @ v)
    mass = textbook.mass_matrix(FLEXIBLE, 11.0, x)
    assert_allclose(np.linalg.solve(mass + j * g.T @ g, right), a, rtol=0, atol=1e-5)
    assert np.abs(np.linalg.solve(mass - j * g.T @ g, right) - a).max() > 0.1


def test_eq21_and_eq23_platform_has_no_motor_torque():
    x, v, _ = motion(FLEXIBLE, 0.1)
    wound = textbook.static_motor_angle(FLEXIBLE, 11.0, x)
    peer = mujoco_state((x, v, wound, np.zeros(6)))
    by_none, by_five = (peer.accelerations(np.full(6, torque)) for torque in (0.0, 5.0))
    assert_allclose(by_five, by_none, rtol=0, atol=1e-9)
    motors = peer.motor_accelerations(np.full(6, 5.0)) - peer.motor_accelerations(np.zeros(6))
    assert_allclose(motors, 5.0 / 4e-4, rtol=1e-9)
    spring = FLEXIBLE.stiffness * (wound - textbook.pulley_angle(FLEXIBLE, x))
    expected, _ = textbook.forward_dynamics(FLEXIBLE, 11.0, x, v, spring, cable="bilateral")
    assert_allclose(by_none, expected, rtol=0, atol=1e-8)  # K (β′ − β) in the place of τ − J′ β̈′
    by_spring = mujoco_state((x, v, wound + 0.1, np.zeros(6))).accelerations(np.zeros(6))
    assert np.abs(by_spring - by_none).max() > 1


def test_eq22_measured_acceleration_determines_no_torque():
    """τ = r T + J β̈ + J′ β̈′ as the law and J′ β̈′ = τ − κ of Eq. 4 are the same equation, but for r T + J β̈ = κ."""
    torque, second, desired_force, spring = sympy.symbols("tau beta_m wanted kappa")
    inertia = sympy.symbols("J_m", positive=True)
    law = sympy.Eq(torque, desired_force + inertia * second)
    motor = sympy.Eq(inertia * second, torque - spring)
    assert sympy.solve([law, motor], [torque, second]) == []
    agreed = sympy.solve([law.subs(desired_force, spring), motor], [torque, second])
    assert agreed == {torque: spring + inertia * second}  # any β̈′ will do


@pytest.mark.parametrize("stiffness", [2.0, 3.0])
def test_eq22_measured_one_sample_late_diverges(stiffness):
    period = 1 / 500
    inertia = 4e-4
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
    load = 0.04
    motor = 4e-4  # M and J′ [kg·m²]
    law = -(load + motor) * np.array([KP, damping])  # τ = (M + J′)(−K_P β − K_D β̇)
    loop = np.array(
        [
            [0, 1, 0, 0],
            [-stiffness / load, 0, stiffness / load, 0],
            [0, 0, 0, 1],
            [
                (law[0] + stiffness) / motor,
                law[1] / motor,
                -stiffness / motor,
                0,
            ],
        ]
    )
    stiff_rate = stiffness * (load + motor) / (load * motor)
    assert_allclose(
        np.poly(loop),
        [1, 0, stiff_rate, stiff_rate * damping, stiff_rate * KP],
        rtol=1e-6,
        atol=1e-6 * stiff_rate,
    )
    fastest = np.linalg.eigvals(loop).real.max()
    assert fastest > 0
    if stiffness == 1e6:
        assert fastest == pytest.approx(damping / 2, rel=0.01)  # no stiffness saves it


@pytest.mark.parametrize(
    ("stiffness", "friction", "low", "high"),
    [
        (2.0, 0.0, 9.3, 9.7),
        (3.0, 0.0, 9.5, 9.9),
        (1e4, 0.0, 5, 100),
        (3.0, 0.007, 0, 100),
        (3.0, 0.01, -100, 0),
    ],
)
def test_eq22_is_unstable_without_motor_friction(stiffness, friction, low, high):
    """K_D J′ is 0.008 N·m·s/rad. β̈′ is taken from v. Without friction the trace of the loop is zero."""
    robot = with_transmission(FLEXIBLE, stiffness=stiffness, motor_damping=friction)

    def rates(states):
        x = states[:, :6]
        v = states[:, 6:12]
        required = textbook.inverse_dynamics(robot, 11.0, x, v, KP * (robot.home - x) - KD * v)
        torques = required.torques + robot.motor_inertia * required.pulley_accelerations + friction * required.speeds
        return flexible_rates(robot, states, torques)

    loop = by_columns(rates, resting(robot))
    poles = np.linalg.eigvals(loop)
    assert low < poles.real.max() < high
    if friction == 0.0:
        assert abs(np.trace(loop)) < 1e-6 * np.abs(poles).max()


@each_time
def test_eq24_inertia_of_the_motors_cancels(time):
    """MuJoCo, wound by β′ = β + (r T + J β̈)/K and driven by Eq. 22, moves as asked; Eq. 24 says β̈′ = 0 there."""

    def required(at):
        return textbook.inverse_dynamics(FLEXIBLE, 11.0, *motion(FLEXIBLE, at)).torques

    def motor(at):
        return textbook.pulley_angle(FLEXIBLE, motion(FLEXIBLE, at)[0]) + required(at) / FLEXIBLE.stiffness

    (x, v, a), angle, second = (
        motion(FLEXIBLE, time),
        motor(time),
        slope(lambda at: slope(motor, at), time),
    )
    torques = required(time) + 4e-4 * second
    peer = mujoco_state((x, v, angle, slope(motor, time)))
    assert_allclose(peer.accelerations(torques), a, rtol=0, atol=1e-6)
    assert_allclose(peer.motor_accelerations(torques), second, rtol=1e-5, atol=1e-2)
    for divisor in (1 + 4e-4, 4e-4):
        printed = (required(time) + 3.0 * (textbook.pulley_angle(FLEXIBLE, x) - angle)) / divisor
        assert np.abs(printed - second).max() > 0.5 * np.abs(second).max()


KG, M, S = sympy.symbols("kg m s", positive=True)
N = KG * M / S**2
DIMENSIONS = {
    "eq24, an acceleration: τ/J′ and not τ/(1 + J′)": (
        1 / S**2,
        N * M / (KG * M**2),
        N * M / (1 + KG * M**2),
    ),
    "eq25, a squared frequency: K/J′ and not K": (
        1 / S**2,
        N * M / (KG * M**2),
        N * M,
    ),
    "eq37, a torque: k₂ β̇ and not k₂ q̇": (
        N * M,
        N * M * S / S,
        N * M * S * M / S,
    ),
    "table 4, a torque c β̇: c in N·m·s/rad and not in N·m/rad": (
        N * M,
        N * M * S / S,
        N * M / S,
    ),
    "table 5, a torque K (β′ − β): K in N·m/rad and not in N/rad": (
        N * M,
        N * M,
        N,
    ),
}
"""Dimension of a quantity, of its corrected form and of its printed form."""


@pytest.mark.parametrize("name", DIMENSIONS)
def test_printed_form_has_another_dimension(name):
    quantity, corrected, printed = DIMENSIONS[name]
    assert sympy.simplify(corrected / quantity) == 1
    assert sympy.simplify(printed / quantity) != 1


def test_eq25_undamped_oscillator_grows_at_resonance():
    inertia = 4e-4
    stiffness = 3.0
    rate = math.sqrt(stiffness / inertia)
    small = 1e-3
    swing = solve_ivp(
        lambda t, y: [
            y[1],
            (small * math.sin(rate * t) - stiffness * y[0]) / inertia,
        ],
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


def parts_of_law(robot, pose, velocity):
    """α and γ of Eq. 27, corrected: torques at Ẍ = 0 and their slope."""

    def torques(a):
        return textbook.inverse_dynamics(robot, robot.mass, pose, velocity, a).torques

    return torques(np.zeros(6)), by_columns(torques, np.zeros(6), 1.0)


@each_time
def test_eq27_and_eq30_gain_of_the_input_has_the_pulleys(time):
    """γ = ∂τ/∂v from the kinetic energy; η of Eq. 30 against a plant that is heavier than the model."""
    x, v, requested = motion(SPATIAL, time)
    true = with_transmission(SPATIAL.replace(mass=11.5), pulley_inertia=3e-3)
    (alpha, gamma), (model_alpha, model_gamma) = (
        parts_of_law(true, x, v),
        parts_of_law(SPATIAL, x, v),
    )
    g, _ = turning(SPATIAL, time)
    complete = np.stack([momentum(SPATIAL, x, e) for e in np.eye(6)], axis=1)  # linear in Ẋ
    assert_allclose(model_gamma, np.linalg.solve(g.T, complete), rtol=0, atol=1e-8)
    printed = [np.linalg.solve(g.T, textbook.mass_matrix(SPATIAL, mass, x)) for mass in (11.5, 10.0)]
    assert np.abs(printed[1] - model_gamma).max() > 0.005
    torques = model_alpha + model_gamma @ requested
    reached, _ = textbook.forward_dynamics(true, 11.5, x, v, torques, cable="bilateral")

    def eta(gamma, model_gamma):
        return np.linalg.solve(gamma, model_gamma @ requested + model_alpha - alpha) - requested

    assert_allclose(eta(gamma, model_gamma), reached - requested, rtol=0, atol=1e-7)
    assert np.abs(eta(*printed) - (reached - requested)).max() > 0.1


def test_eq27_fewer_inputs_than_coordinates_are_controllable():
    """Relative degree four: τ enters the fourth derivative of X, and nothing before, by an invertible matrix."""
    state = resting(FLEXIBLE)
    plant = by_columns(lambda states: flexible_rates(FLEXIBLE, states, np.zeros((1, 6))), state)
    inputs = by_columns(
        lambda u: flexible_rates(FLEXIBLE, np.tile(state, (len(u), 1)), u),
        np.zeros(6),
    )
    scale = np.repeat([1.0, 0.01, 1.0, 0.01], 6)  # seconds to hundredths
    plant = 0.01 * plant * scale[:, None] / scale
    inputs = 0.01 * inputs * scale[:, None]
    ends = (np.hstack([pole * np.eye(24) - plant, inputs]) for pole in np.linalg.eigvals(plant))
    assert min(np.linalg.svd(end, compute_uv=False)[-1] for end in ends) > 1e-5  # the test of Hautus
    outputs = np.eye(6, 24)
    for power in range(3):
        assert_allclose(
            outputs @ np.linalg.matrix_power(plant, power) @ inputs,
            0,
            atol=1e-6,
        )
    assert np.linalg.cond(outputs @ np.linalg.matrix_power(plant, 3) @ inputs) < 1e3


@pytest.mark.parametrize("error", [1, -1], ids=["z_d - z", "z - z_d"])
def test_eq31_is_positive_feedback_and_eq18_is_not(error):
    """Poles of z̈ = v in the error e = ± (z_d − z), v − z̈_d = sign (K_D (ż_d − ż) + K_P (z_d − z))."""
    for sign, least, most in (
        (-1, 1, 100),
        (1, -100, -1),
    ):  # as printed, and corrected
        feedback = -error * sign * error * np.array([KP, KD])
        assert least < np.linalg.eigvals(np.array([[0, 1], feedback])).real.max() < most


@pytest.mark.parametrize(
    ("proportional", "end"),
    [("z_d - z", 0.0), ("integral of the velocity's", 0.02)],
)
def test_eq31_integral_of_the_velocity_error_keeps_an_error(proportional, end):
    """Signs corrected; 0.02 m off at first, desired rest at 0. The integral is e(t) − e(0)."""

    def loop(_, state):
        z, rate, integral = state
        missing = -z if proportional == "z_d - z" else integral
        return [rate, -KD * rate + KP * missing, -rate]

    final = solve_ivp(loop, (0.0, 8.0), [0.02, 0.0, 0.0], rtol=1e-9, atol=1e-12).y[0, -1]
    assert final == pytest.approx(end, abs=1e-5)


LYAPUNOV = solve_continuous_lyapunov(np.array([[0, -KP], [1, -KD]]), -np.eye(2))


def robust_run(error, sign):
    """V, mean ‖e‖ and the residual of Eq. 32 along a run of z̈ = v + η: 15 % too heavy, in an unknown force.

    e = ±(z_d − z), Δv = sign ρ BᵀPe/‖BᵀPe‖ with a layer of 1e-4, the rest of v is Eq. 18's.
    """
    zeta = 0.15
    force = 1.0

    def dynamics(time, state):
        desired = 0.1 * np.array([np.sin(3 * time), 3 * np.cos(3 * time), -9 * np.sin(3 * time)])
        e = error * (desired[:2] - state)
        s = LYAPUNOV[1] @ e
        feedback = KP * e[0] + KD * e[1]
        rho = (zeta * (abs(desired[2]) + np.linalg.norm([e[1], feedback])) + force) / (1 - zeta)
        extra = sign * rho * s / max(abs(s), 1e-4)
        requested = desired[2] + error * feedback + extra
        eta = (1 / 1.15 - 1) * requested - force * np.cos(2 * time)
        residual = error * (desired[2] - requested - eta) + feedback - (eta + extra)
        return e, requested + eta, residual

    times = np.linspace(0.0, 2.0, 401)
    options = {"t_eval": times, "rtol": 1e-8, "atol": 1e-10, "method": "LSODA"}
    run = solve_ivp(
        lambda time, state: [state[1], dynamics(time, state)[1]],
        (0.0, 2.0),
        [0.02, 0.0],
        **options,
    )
    reached = [dynamics(time, state) for time, state in zip(times, run.y.T, strict=True)]
    errors = np.array([e for e, _, _ in reached])
    value = np.einsum("ki,ij,kj->k", errors, LYAPUNOV, errors)
    return (
        value,
        np.abs(errors[:, 0]).mean(),
        np.array([residual for *_, residual in reached]),
    )


@pytest.mark.parametrize(
    ("error", "sign"),
    [(1, 1), (-1, -1)],
    ids=["z_d - z, plus", "z - z_d, minus"],
)
def test_eq34_sign_belongs_to_the_error(error, sign):
    """Eq. 32, + (ψ + Δv) on its right, is right for e = z − z_d alone; the ψ of Eq. 33 is η."""
    value, mean, residual = robust_run(error, sign)
    raised = robust_run(error, -sign)[1]
    plain = robust_run(error, 0)[1]
    outside = int(np.argmax(value < 1e-5))
    assert outside > 10
    assert np.all(np.diff(value[:outside]) < 0)
    assert mean < 0.5 * plain
    assert raised > 2.5 * plain
    assert np.allclose(residual, 0, atol=1e-9) is (error == -1)


def test_eq36_printed_system_has_no_lyapunov_matrix():
    for sign, positive in ((1, False), (-1, True)):  # as printed, and corrected
        system = np.kron(np.eye(6), [[0.0, 1.0], [sign * KP, sign * KD]])
        solution = solve_continuous_lyapunov(system.T, -np.eye(12))  # the only one
        assert_allclose(system.T @ solution + solution @ system, -np.eye(12), atol=1e-10)
        assert bool(np.linalg.eigvalsh(solution).min() > 0) is positive


def test_eq36_input_matrix_has_two_rows_too_many():
    printed = np.array([row for k in (0, 1, 2, 3, 3, 4, 5) for row in (np.zeros(6), np.eye(6)[k])])  # ψ's twice
    with pytest.raises(ValueError, match="mismatch"):
        printed.T @ np.eye(12)
    corrected = np.kron(np.eye(6), [[0.0], [1.0]])  # an input is the second derivative of its own error
    assert_array_equal(np.delete(printed, [8, 9], axis=0), corrected)


def test_eq36_norm_of_metres_and_radians_depends_on_the_unit():
    law = RobustPD(gains=(KP, KD), boundary_layer=1e-9, phi=0.0)
    e = np.array([0.01, 0.0, 0.0, 0.02, 0.0, 0.0])
    turn = np.array([0.0, 0.0, 0.0, 5.0, 0.0, 0.0])
    extra = []
    for unit in (1.0, 100.0):
        scale = np.array([unit] * 3 + [1.0] * 3)
        requested = outer_loop(law, np.zeros(6), np.zeros(6), scale * e, turn)
        extra.append((requested - turn - KP * scale * e) / scale)
    assert extra[0][3] > 0.1
    assert extra[1][3] < 0.5 * extra[0][3]  # the same errors, in centimetres


def test_eq36_bracket_of_rho_closes_after_the_last_term():
    """ρ has to bound ‖ψ‖, which ρ itself enlarges: at the worst of what ζ, γ̄ and φ allow, it is just enough."""
    rng = np.random.default_rng(3)
    zeta, (gain, phi, requested, drift) = (
        rng.uniform(0.05, 0.9, 200),
        rng.uniform(0.1, 5, (4, 200)),
    )
    known = zeta * (requested + drift)
    unknown = gain * phi

    def slack(rho):
        return rho - (zeta * (requested + drift + rho) + unknown)  # less ‖η(v)‖ at v = ‖z̈_d‖ + ‖Ae‖ + ρ

    assert_allclose(slack((known + unknown) / (1 - zeta)), 0, atol=1e-9)
    assert slack(known / (1 - zeta) + unknown).max() < 0


# --- §5: load ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bisected():
    """The largest payload within the torque limits on Table 3's circle, 500 instants, by bisection."""
    path = find_trajectory("paper-spatial", 6)(np.arange(500) / 500)

    def feasible(payload):
        required = textbook.inverse_dynamics(
            SPATIAL,
            10.0 + payload,
            path.position,
            path.velocity,
            path.acceleration,
        )
        drop = 10.0 / (1000 * RPM) * required.speeds
        return np.all((required.torques <= 10.0 - drop) & (required.torques >= -10.0 - drop))

    low = 0.0
    high = 20.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if feasible(middle) else (low, middle)
    return low


def test_eq37_printed_margin_finds_half_of_the_load(bisected):
    circle = find_trajectory("paper-spatial", 6)
    complete, half = (iterate_load(SPATIAL, circle, guess=5.0, corrected=corrected) for corrected in (True, False))
    assert complete.payload == pytest.approx(bisected, abs=1e-5)
    assert half.payload == pytest.approx(bisected / 2, abs=1e-5)
    assert half.converged  # without a warning


def test_eq37_limit_is_the_one_the_load_drives_to():
    """A torque p + m s of 5 N·m motors: the largest m, sign by τ_e − τ_n, not by τ_e."""
    grid = np.linspace(0.0, 200.0, 200001)
    for offset, rise in [
        (2.0, 0.5),
        (2.0, -0.5),
        (-2.0, 0.5),
        (-2.0, -0.5),
        (0.3, -1.0),
    ]:
        true = grid[np.abs(offset + rise * grid) <= 5.0].max()
        full = np.full(3, offset + 0.1 * rise)
        empty = np.full(3, offset)
        corrected = load_coefficient(PLANAR, full, empty, np.zeros(3), corrected=True)[0] * 0.1
        assert corrected == pytest.approx(true, abs=2e-3)
        by_sign_of_full = abs((math.copysign(5.0, full[0]) - offset) / rise)
        assert bool(abs(by_sign_of_full - true) < 2e-3) is (offset * rise > 0)


def test_eq38_absolute_value_hides_an_overloaded_motor():
    """6 N·m without load and 7 with 1 kg, of motors of 5: no load is feasible."""
    full = np.full(3, 7.0)
    empty = np.full(3, 6.0)
    assert load_coefficient(PLANAR, full, empty, np.zeros(3), corrected=False).min() > 0
    assert load_coefficient(PLANAR, full, empty, np.zeros(3), corrected=True).max() < 0


def test_eq39_coefficient_multiplies_the_guessed_load(bisected):
    path = find_trajectory("paper-spatial", 6)(np.arange(500) / 500)
    circle = (path.position, path.velocity, path.acceleration)
    empty = textbook.inverse_dynamics(SPATIAL, 10.0, *circle)
    by_mass = []
    for guess in (2.0, 5.0):
        full = textbook.inverse_dynamics(SPATIAL, 10.0 + guess, *circle).torques
        coefficient = load_coefficient(SPATIAL, full, empty.torques, empty.speeds, corrected=True).min()
        assert coefficient * guess == pytest.approx(bisected, abs=1e-6)
        by_mass.append(10.0 * coefficient)
    assert by_mass[0] == pytest.approx(2.5 * by_mass[1])  # moves with the guess
    assert abs(by_mass[0] - bisected) > 1


def test_eq41_least_tensions_are_not_linear_in_the_mass():
    def second_difference(robot, masses, minimum):
        path = find_trajectory(f"paper-{robot.name}", robot.coordinates)(np.linspace(0, 1, 101))
        x = path.position
        v = path.velocity
        a = path.acceleration
        torques = [textbook.inverse_dynamics(robot, mass, x, v, a, minimum=minimum).torques for mass in masses]
        return torques[0] - 2 * torques[1] + torques[2], textbook.jacobian(robot, x)

    bent, s = second_difference(PLANAR, (0.1, 2.1, 4.1), 5.0)
    assert_allclose(np.einsum("kij,ki->kj", s, bent), 0, atol=1e-12)  # S τ is, as Eq. 41 says
    assert np.abs(bent).max() > 0.1  # τ is not: it has a kink where the pair of cables above T_min changes
    assert_allclose(second_difference(PLANAR, (0.1, 2.1, 4.1), 0.0)[0], 0, atol=1e-12)  # none at T_min = 0
    assert_allclose(second_difference(SPATIAL, (10.0, 12.0, 14.0), 0.0)[0], 0, atol=1e-10)


# --- tables and text --------------------------------------------------------------------------------------------------


def test_table2_and_table4_friction_and_mass_move_the_load():
    """Without the friction of Table 4 by 0.12 kg; by the kilogram between Tables 4 and 8."""
    planar = find_trajectory("paper-planar", 2)
    spatial = find_trajectory("paper-spatial", 6)
    loads = [exact_payload(with_transmission(PLANAR, damping=c), planar, frequency=500.0).payload for c in (0.0, 0.01)]
    assert loads[0] - loads[1] == pytest.approx(0.12, abs=0.01)
    ten, eleven = (exact_payload(SPATIAL.replace(mass=mass), spatial, frequency=500.0) for mass in (10.0, 11.0))
    assert ten.payload - eleven.payload == pytest.approx(1.0, abs=1e-6)
    assert ten.total_mass == pytest.approx(eleven.total_mass, abs=1e-6)


def test_table4_no_platform_of_this_size_has_this_inertia():
    """The largest I_zz of 11 kg within a triangle puts all of them into its corners: 0.32 of 1.16 kg·m²."""
    circumradius = 2 * 0.148 / math.sqrt(3)
    corners = circumradius * np.array([[np.cos(a), np.sin(a)] for a in np.radians([90, 210, 330])])
    points = np.array([(i, j, 20 - i - j) for i in range(21) for j in range(21 - i)]) / 20 @ corners
    squares = np.sum(points**2, axis=1)
    best = linprog(
        -squares,
        A_eq=np.stack([np.ones(len(points)), *points.T]),
        b_eq=[11.0, 0, 0],
    )
    assert -best.fun == pytest.approx(0.32, abs=0.005)
    assert math.sqrt(1.16 / 11) == pytest.approx(0.325, abs=5e-4)  # radius of gyration
    assert SPATIAL.inertia[0] + SPATIAL.inertia[1] == pytest.approx(SPATIAL.inertia[2])  # of a flat plate: no misprint


def test_table5_inertias_are_halves_of_table4():
    """J + J′ of Table 5 is J of Table 4. K = 2 and 3 are robots whose springs are wound by angles 1.5 times apart."""
    assert FLEXIBLE.pulley_inertia[0] + FLEXIBLE.motor_inertia[0] == pytest.approx(SPATIAL.pulley_inertia[0])
    robots = [with_transmission(FLEXIBLE, stiffness=k) for k in (2.0, 3.0)]
    soft, stiff = (textbook.static_motor_angle(robot, 11.0, SPATIAL.home) for robot in robots)
    assert_allclose(soft, 1.5 * stiff, rtol=1e-12)


def test_table6_variance_is_in_square_newtons():
    assert UNCERTAINTIES["table6"](SPATIAL).wrench.force_std ** 2 == pytest.approx(0.2)  # N²: 0.45 N, not 0.2
    x, v, _ = motion(SPATIAL, 0.1)
    light, model = (parts_of_law(SPATIAL.replace(mass=mass), x, v)[1] for mass in (9.0, 10.0))
    assert 0.1 < np.linalg.norm(np.linalg.solve(light, model) - np.eye(6), 2) < 1 / 0.9 - 1 + 0.01


def test_text_of_5_1_error_leaves_its_bound():
    """1 kg at rest: K_P e of 10 kg has to carry it, e = m g/(m̂ K_P), about 33 mm, where R is 10 mm."""
    law = PD(gains=(KP, KD))

    def rates(_, state):
        x = state[:6]
        v = state[6:]
        torques = textbook.inverse_dynamics(SPATIAL, 10.0, x, v, outer_loop(law, x, v, SPATIAL.home)).torques
        return np.concatenate(
            [
                v,
                textbook.forward_dynamics(SPATIAL, 11.0, x, v, torques, cable="bilateral")[0],
            ]
        )

    start = np.concatenate([SPATIAL.home, np.zeros(6)])
    end = solve_ivp(rates, (0.0, 6.0), start, rtol=1e-6, atol=1e-9).y[:6, -1]
    # J β̈(v) of the law carries a little too: (D + (J/r²) SᵀS) K_P e, with S where it has sagged to.
    carrying = 10.0 + 8e-4 / 0.05**2 * np.sum(textbook.jacobian(SPATIAL, end)[:, 2] ** 2)
    assert end[2] - 0.1 == pytest.approx(9.81 / (carrying * KP), rel=1e-3)
    assert end[2] - 0.1 > 3 * 0.01


def test_text_of_6_load_drops_by_no_thirty_percent():
    """Nor is it with the platform counted."""
    drops = [1 - (platform + 1.4) / (platform + 2.56) for platform in (0.0, 10.0, 11.0)]
    assert drops == pytest.approx([0.45, 0.09, 0.09], abs=0.006)


# --- the page ---------------------------------------------------------------------------------------------------------


def test_page_names_every_test_and_every_equation():
    """Each section names a test that exists, and each test of this file is named."""
    sections = re.split(r"^## (.+)$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    named = [re.findall(r"(tests/[\w/]+\.py)::(test_\w+)", text) for text in sections[::2]]
    assert all(named)
    for file, name in {pair for pairs in named for pair in pairs}:
        assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
    here = re.findall(
        r"^def (test_\w+)",
        Path(__file__).read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert set(here) <= {name for pairs in named for _, name in pairs}
    ranges = re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", " ".join(sections[1::2]))
    covered = set()
    for lowest, highest in ranges:
        covered |= set(range(int(lowest), int(highest or lowest) + 1))
    assert covered == set(range(1, 42))
