"""The corrections of docs/errata.md to the laws of flexible robots and to the robust law."""

import math

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal
from oracles.lagrange import (
    FLEXIBLE,
    KD,
    KP,
    by_columns,
    each_time,
    flexible_rates,
    momentum,
    motion,
    mujoco_state,
    needed_force,
    outer_loop,
    parts_of_law,
    resting,
    slope,
    turning,
)
from oracles.plants import (
    with_transmission,
)
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_lyapunov

from cablebot_baselines.classical import RobustPD
from cablebot_gym.physics import textbook
from cablebot_gym.robots import SPATIAL

# --- §3.3: joint springs ----------------------------------------------------------------------------------------------


@each_time
def test_eq21_inertia_of_the_pulleys_adds_to_the_platform(time):
    (x, v, a) = motion(FLEXIBLE, time)
    (g, rate) = turning(FLEXIBLE, time)
    j = 4e-4
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
    """τ = r T + J β̈ + J′ β̈′ as the law and J′ β̈′ = τ − κ of Eq. 4 are the same equation, but for
    r T + J β̈ = κ."""
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
    # β′, β̇′ and β̇′ one sample ago, the pulley held: τ = J′ (β̇′ − its last value)/h
    loop = np.zeros((3, 3))
    loop[:2] = plant[:2, [0, 1, 2]] @ np.array(
        [[1, 0, 0], [0, 1, 0], [0, inertia / period, -inertia / period]]
    )
    loop[2, 1] = 1.0
    rate = np.log(np.abs(np.linalg.eigvals(loop)).max()) / period
    # s³ + K/(J′ h) = 0
    assert rate == pytest.approx(np.cbrt(stiffness / (inertia * period)) / 2, rel=0.1)
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
    """K_D J′ is 0.008 N·m·s/rad. β̈′ is taken from v. Without friction the trace of the loop is
    zero."""
    robot = with_transmission(FLEXIBLE, stiffness=stiffness, motor_damping=friction)

    def rates(states):
        x = states[:, :6]
        v = states[:, 6:12]
        required = textbook.inverse_dynamics(robot, 11.0, x, v, KP * (robot.home - x) - KD * v)
        torques = (
            required.torques
            + robot.motor_inertia * required.pulley_accelerations
            + friction * required.speeds
        )
        return flexible_rates(robot, states, torques)

    loop = by_columns(rates, resting(robot))
    poles = np.linalg.eigvals(loop)
    assert low < poles.real.max() < high
    if friction == 0.0:
        assert abs(np.trace(loop)) < 1e-6 * np.abs(poles).max()


@each_time
def test_eq24_inertia_of_the_motors_cancels(time):
    """MuJoCo, wound by β′ = β + (r T + J β̈)/K and driven by Eq. 22, moves as asked; Eq. 24 says
    β̈′ = 0 there."""

    def required(at):
        return textbook.inverse_dynamics(FLEXIBLE, 11.0, *motion(FLEXIBLE, at)).torques

    def motor(at):
        return (
            textbook.pulley_angle(FLEXIBLE, motion(FLEXIBLE, at)[0])
            + required(at) / FLEXIBLE.stiffness
        )

    (x, v, a) = motion(FLEXIBLE, time)
    angle = motor(time)
    second = slope(lambda at: slope(motor, at), time)
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
        assert np.abs(swing(times)[0]).max() == pytest.approx(
            small * times[-1] / (2 * inertia * rate), rel=0.05
        )


# --- §3.4: robust law -------------------------------------------------------------------------------------------------


@each_time
def test_eq27_and_eq30_gain_of_the_input_has_the_pulleys(time):
    """γ = ∂τ/∂v from the kinetic energy; η of Eq. 30 against a plant that is heavier than the
    model."""
    x, v, requested = motion(SPATIAL, time)
    true = with_transmission(SPATIAL.replace(mass=11.5), pulley_inertia=3e-3)
    (alpha, gamma) = parts_of_law(true, x, v)
    (model_alpha, model_gamma) = parts_of_law(SPATIAL, x, v)
    g, _ = turning(SPATIAL, time)
    complete = np.stack([momentum(SPATIAL, x, e) for e in np.eye(6)], axis=1)  # linear in Ẋ
    assert_allclose(model_gamma, np.linalg.solve(g.T, complete), rtol=0, atol=1e-8)
    printed = [
        np.linalg.solve(g.T, textbook.mass_matrix(SPATIAL, mass, x)) for mass in (11.5, 10.0)
    ]
    assert np.abs(printed[1] - model_gamma).max() > 0.005
    torques = model_alpha + model_gamma @ requested
    reached, _ = textbook.forward_dynamics(true, 11.5, x, v, torques, cable="bilateral")

    def eta(gamma, model_gamma):
        return np.linalg.solve(gamma, model_gamma @ requested + model_alpha - alpha) - requested

    assert_allclose(eta(gamma, model_gamma), reached - requested, rtol=0, atol=1e-7)
    assert np.abs(eta(*printed) - (reached - requested)).max() > 0.1


def test_eq27_fewer_inputs_than_coordinates_are_controllable():
    """Relative degree four: τ enters the fourth derivative of X, and nothing before, by an
    invertible matrix."""
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
    # the test of Hautus
    assert min(np.linalg.svd(end, compute_uv=False)[-1] for end in ends) > 1e-5
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
    """Poles of z̈ = v in the error e = ± (z_d − z), v − z̈_d = sign (K_D (ż_d − ż) + K_P (z_d −
    z))."""
    # as printed, and corrected
    for sign, least, most in ((-1, 1, 100), (1, -100, -1)):
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
    """V, mean ‖e‖ and the residual of Eq. 32 along a run of z̈ = v + η: 15 % too heavy, in an
    unknown force.

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
    # ψ's twice
    printed = np.array([row for k in (0, 1, 2, 3, 3, 4, 5) for row in (np.zeros(6), np.eye(6)[k])])
    with pytest.raises(ValueError, match="mismatch"):
        printed.T @ np.eye(12)
    # an input is the second derivative of its own error
    corrected = np.kron(np.eye(6), [[0.0], [1.0]])
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
    """ρ has to bound ‖ψ‖, which ρ itself enlarges: at the worst of what ζ, γ̄ and φ allow, it is
    just enough."""
    rng = np.random.default_rng(3)
    zeta = rng.uniform(0.05, 0.9, 200)
    (gain, phi, requested, drift) = rng.uniform(0.1, 5, (4, 200))
    known = zeta * (requested + drift)
    unknown = gain * phi

    def slack(rho):
        # less ‖η(v)‖ at v = ‖z̈_d‖ + ‖Ae‖ + ρ
        return rho - (zeta * (requested + drift + rho) + unknown)

    assert_allclose(slack((known + unknown) / (1 - zeta)), 0, atol=1e-9)
    assert slack(known / (1 - zeta) + unknown).max() < 0
