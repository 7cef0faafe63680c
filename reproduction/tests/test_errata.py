"""The corrections of docs/errata.md: for each erratum, the corrected form holds and the printed form
fails."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import sympy
from lagrange import (
    FLEXIBLE,
    KD,
    KP,
    RADIUS,
    RUBBING,
    TIME,
    UNEVEN,
    momentum,
    motion,
    mujoco_state,
    needed_force,
    parts_of_law,
    slope,
    turning,
)
from numpy.linalg import eigvals, pinv, solve
from numpy.testing import assert_allclose
from oracles.plants import with_transmission
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import brentq

from cablebot_baselines.laws import PD
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, RPM, SPATIAL
from cablebot_gym.uncertainty import UNCERTAINTIES
from cablebot_reproduction.load_iteration import iterate_load, load_coefficient

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "reproduction" / "docs" / "errata.md").read_text(encoding="utf-8")
CIRCLE = find_trajectory("paper-spatial", 6)
PLANAR_CIRCLE = find_trajectory("paper-planar", 2)


def states(trajectory, times):
    path = trajectory(times)
    return path.position, path.velocity, path.acceleration


# Each erratum yields a reference, the corrected form, and printed forms.


def eq1_and_eq7():
    """J multiplies the whole acceleration; ∂β/∂X does not depend on T."""
    _, v, a = motion(UNEVEN)
    g, rate = turning(UNEVEN)
    j = 8e-4
    torques = solve(g.T, needed_force(UNEVEN, pulleys=True))  # without friction, which cancels
    tensions = solve(g.T, needed_force(UNEVEN, pulleys=False))
    yield (
        tensions,
        torques - j * (rate @ v + g @ a),
        torques - j * (g @ a),
        torques - j * rate @ v - g @ a,
    )


def eq2():
    """With the S of Eq. 3 the pulleys would reduce the inertia."""
    x, v, a = motion(RUBBING)
    g, rate = turning(RUBBING)

    def side(s):
        inertia = RADIUS * np.eye(2) + s @ (8e-4 * g)
        return inertia @ a + s @ ((8e-4 * rate + 0.02 * g) @ v)

    theta = np.arctan2(*(x - RUBBING.base).T[::-1])  # from the anchor to the platform
    s = -np.array([np.cos(theta), np.sin(theta)])
    force = needed_force(RUBBING, pulleys=True) + g.T @ (0.02 * g @ v)
    yield RADIUS * force, side(s), side(-s)


def eq3():
    """Angles in place of rates; C, which is a vector, times the rates."""
    x, v, a = motion(UNEVEN)
    inertia = np.array(UNEVEN.inertia)
    bias = textbook.bias(UNEVEN, 10.0, x, v)
    (c1, c2, _), (s1, s2, _) = np.cos(x[3:]), np.sin(x[3:])
    to_omega = np.array([[1, 0, -s2], [0, c1, s1 * c2], [0, -s1, c1 * c2]])
    omega = to_omega @ v[3:]
    angles = bias.copy()
    angles[3:] += to_omega.T @ np.cross(omega, inertia * (to_omega @ x[3:]) - inertia * omega)
    rest = needed_force(UNEVEN, pulleys=False) - textbook.mass_matrix(UNEVEN, 10.0, x) @ a
    yield rest[3:], bias[3:], angles[3:], bias[3:] * v[3:]


def eq4():
    """A constraint between β and β′ would leave some of the four states unreachable."""
    plant = sympy.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, 0, 0], [2, -2, 0, 0]])
    by_motor = sympy.Matrix([0, 0, 0, 2])
    reached = sympy.Matrix.hstack(*(plant**power * by_motor for power in range(4)))
    yield reached.rank(), 4, 2


def eq9_and_eq10():
    """Each acceleration needs both rows; S has no inverse, and two motors would have to push."""
    x, v, _ = motion(RUBBING)
    g, rate = turning(RUBBING)
    s = RADIUS * g.T
    matrix = RADIUS * np.eye(2) + s @ (8e-4 * g)
    bias = s @ ((8e-4 * rate + 0.02 * g) @ v)

    def accelerations(torques):
        return textbook.forward_dynamics(RUBBING, 1.0, x, v, torques, cable="bilateral")[0]

    torques = np.array([2.0, 1.0, 3.0])
    right = s @ torques - bias
    yield accelerations(torques), solve(matrix, right), right / np.diag(matrix)
    requested = np.array([3.0, -4.0])
    yield requested, accelerations(pinv(s) @ (matrix @ requested + bias))
    pose, _, acceleration = states(PLANAR_CIRCLE, np.linspace(0, 1, 101))
    for pair in ([0, 1], [1, 2], [0, 2]):
        pull = -np.swapaxes(textbook.jacobian(PLANAR, pose)[:, pair], 1, 2)
        assert solve(pull, acceleration[..., None]).min() < -1


def eq11():
    """A of the pseudoinverse is S."""
    s = RADIUS * turning(RUBBING)[0].T
    force = np.array([3.0, -4.0])
    null = np.linalg.svd(s)[2][2]
    another = s + 0.1 * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    torques, printed = (s.T @ solve(a @ a.T, force) for a in (s, another))
    yield force, s @ (torques + 7.0 * null), s @ printed


def eq14():
    """The law is PD: a force of 1 N/kg leaves the error −η/K_P, where PID would leave none."""
    zero = np.zeros(1)
    reference = ("reference_pose", "reference_velocity", "reference_acceleration")
    blocks = dict.fromkeys((*reference, "velocity"), zero)
    law = PD(gains=(2000.0, 10.0))
    yield -1.0, *(law(blocks | {"pose": zero + error}) for error in (1 / 2000, 0.0))


def eq15_and_eq16():
    """With the printed sign all cables would push."""
    x, v, a = motion(SPATIAL)
    s = textbook.jacobian(SPATIAL, x)
    g, rate = turning(SPATIAL)
    force = textbook.mass_matrix(SPATIAL, 10.0, x) @ a + textbook.bias(SPATIAL, 10.0, x, v)
    torques = solve(g.T, needed_force(SPATIAL, pulleys=True))
    pulleys = 8e-4 * (rate @ v + g @ a)
    corrected = -RADIUS * solve(s.T, force)
    yield torques, corrected + pulleys, -corrected + pulleys


def eq17_and_eq20():
    """Each coordinate is followed by its rate."""

    def interleaved(at):
        return np.stack(motion(UNEVEN, at)[:2], axis=1).ravel()  # x, ẋ, y, ẏ, …

    def printed(at):
        return np.concatenate(motion(UNEVEN, at)[:2])

    failures = [slope(state, TIME)[::2] - state(TIME)[1::2] for state in (interleaved, printed)]
    yield 0.0, *failures


def eq21():
    """The pulleys add to the inertia of the platform."""
    x, v, a = motion(FLEXIBLE)
    g, rate = turning(FLEXIBLE)
    j = 4e-4
    spring = solve(g.T, needed_force(FLEXIBLE, pulleys=True))  # τ − J′ β̈′
    right = g.T @ (spring - j * rate @ v) - textbook.bias(FLEXIBLE, 11.0, x, v)
    mass = textbook.mass_matrix(FLEXIBLE, 11.0, x)
    yield a, solve(mass + j * g.T @ g, right), solve(mass - j * g.T @ g, right)


def eq21_and_eq23():
    """The platform is accelerated by the springs, K (β′ − β), and by no motor torque (MuJoCo)."""
    x, v, _ = motion(FLEXIBLE)
    wound = textbook.static_motor_angle(FLEXIBLE, 11.0, x)
    torques = np.full(6, 5.0)
    moved = mujoco_state(x, v, wound, np.zeros(6)).accelerations(torques)
    spring = FLEXIBLE.stiffness * (wound - textbook.pulley_angle(FLEXIBLE, x))
    forms = []
    for torque in (spring, torques):
        forms.append(textbook.forward_dynamics(FLEXIBLE, 11.0, x, v, torque, cable="bilateral")[0])
    yield moved, *forms


def eq22():
    """With β̈′ from v, the loop of one joint with the load M has no s³ term: the roots sum to zero.
    Motor friction c that the law knows adds one."""
    m, j, k, kp, kd, c, s = sympy.symbols("M J K K_P K_D c s")
    torque = (m + j) * (kp + kd * s) - c * s  # by which the law pulls β back
    loop = (j * s**2 + c * s + k) * (m * s**2 + k) - k**2 + k * torque
    assert sympy.Poly(loop, s).coeff_monomial(s**3) == m * c
    return ()


def eq24():
    """The inertia of the motors cancels: MuJoCo, wound by β′ = β + κ/K and driven by Eq. 22, moves
    as asked."""

    def spring(at):
        return textbook.inverse_dynamics(FLEXIBLE, 11.0, *motion(FLEXIBLE, at)).torques

    def pulley(at):
        return textbook.pulley_angle(FLEXIBLE, motion(FLEXIBLE, at)[0])

    def motor(at):
        return pulley(at) + spring(at) / FLEXIBLE.stiffness

    x, v, a = motion(FLEXIBLE)
    second = slope(lambda at: slope(motor, at), TIME)
    peer = mujoco_state(x, v, motor(TIME), slope(motor, TIME))
    torques = spring(TIME) + 4e-4 * second
    yield a, peer.accelerations(torques)
    right = spring(TIME) + 3.0 * (pulley(TIME) - motor(TIME))
    yield peer.motor_accelerations(torques), second, right / (1 + 4e-4), right / 4e-4


def units():
    """Dimensions of Eqs. 24, 25, 37 and of Tables 4 and 5: a quantity, corrected, printed."""
    kg, m, s = sympy.symbols("kg m s", positive=True)
    newton = kg * m / s**2
    torque = newton * m
    for quantity, corrected, printed in (
        (1 / s**2, torque / (kg * m**2), torque / (1 + kg * m**2)),  # τ/J′
        (1 / s**2, torque / (kg * m**2), torque),  # K/J′
        (torque, torque * s / s, torque * s * m / s),  # k₂ β̇ and not k₂ q̇
        (torque, torque * s / s, torque / s),  # c β̇
        (torque, torque, newton),  # K (β′ − β)
    ):
        assert sympy.simplify(corrected / quantity) == 1
        assert sympy.simplify(printed / quantity) != 1
    return ()


def eq25():
    """An undamped oscillator grows without bound at resonance."""
    j, w, t = sympy.symbols("J omega t", positive=True)
    growing = sympy.sin(w * t) / (2 * j * w**2) - t * sympy.cos(w * t) / (2 * j * w)
    left = j * growing.diff(t, 2) + j * w**2 * growing
    assert sympy.simplify(left - sympy.sin(w * t)) == 0
    return ()


def eq27_and_eq30():
    """γ has the pulleys; η against a plant that is heavier than the model."""
    x, v, asked = motion(SPATIAL)
    g, _ = turning(SPATIAL)
    true = with_transmission(SPATIAL.replace(mass=11.5), pulley_inertia=3e-3)
    (alpha, gamma), (model_alpha, model_gamma) = (
        parts_of_law(robot, x, v) for robot in (true, SPATIAL)
    )
    complete = np.stack([momentum(SPATIAL, x, e) for e in np.eye(6)], axis=1)  # linear in Ẋ
    printed = [solve(g.T, textbook.mass_matrix(SPATIAL, mass, x)) for mass in (11.5, 10.0)]
    yield solve(g.T, complete), model_gamma, printed[1]
    torques = model_alpha + model_gamma @ asked
    reached, _ = textbook.forward_dynamics(true, 11.5, x, v, torques, cable="bilateral")

    def eta(gamma, model_gamma):
        return solve(gamma, model_gamma @ asked + model_alpha - alpha) - asked

    yield reached - asked, eta(gamma, model_gamma), eta(*printed)


def eq31():
    """The printed signs are positive feedback, and the integral of the velocity's error keeps the
    initial error."""
    slow = np.roots([1, KD, KP]).max()
    yield slow, *(eigvals([[0, 1], [-s * KP, -s * KD]]).real.max() for s in (1, -1))
    integral = [[0, 1, 0], [0, -KD, KP], [0, -1, 0]]
    error = [[0, 1, 0], [-KP, -KD, 0], [0, -1, 0]]
    yield 0.0, *(expm(8 * np.array(loop))[0, 0] for loop in (error, integral))


def eq34():
    """Δv has to point along s = BᵀPe for e = z_d − z, and against it for e = z − z_d."""
    p = solve_continuous_lyapunov(np.array([[0, -KP], [1, -KD]]), -np.eye(2))
    rng = np.random.default_rng(0)
    for sign in (1, -1):  # e = ± (z_d − z)
        e = 0.01 * rng.standard_normal((100, 2))
        s = e @ p[1]
        eta = rng.uniform(-1, 1, 100)
        for printed in (1, -1):
            added = printed * sign * np.sign(s)
            second = -e @ [KP, KD] - sign * (eta + added)
            rate = 2 * np.sum(e @ p * np.stack([e[:, 1], second], axis=1), axis=1)
            assert bool(np.all(rate < 0)) is (printed == 1)
    return ()


def eq36():
    """The printed A has no P, and ρ divides the whole bracket by 1 − ζ."""
    for sign in (1, -1):
        system = np.array([[0, 1], [-sign * KP, -sign * KD]])
        solution = solve_continuous_lyapunov(system.T, -np.eye(2))
        assert bool(np.linalg.eigvalsh(solution).min() > 0) is (sign == 1)
    zeta, known, unknown, rho = 0.15, 3.0, 2.0, sympy.symbols("rho")
    (bound,) = sympy.solve(rho - zeta * (known + rho) - unknown, rho)
    yield (
        float(bound),
        (zeta * known + unknown) / (1 - zeta),
        zeta * known / (1 - zeta) + unknown,
    )


def largest_load():
    """The largest payload within the torque limits on Table 3's circle, 500 instants."""
    state = states(CIRCLE, np.arange(500) / 500)

    def reserve(payload):
        required = textbook.inverse_dynamics(SPATIAL, 10.0 + payload, *state)
        drop = 10.0 / (1000 * RPM) * required.speeds
        return min((10.0 - drop - required.torques).min(), (required.torques + 10.0 + drop).min())

    return brentq(reserve, 0.0, 20.0, xtol=1e-9)


def eq37():
    """The printed reserve finds half of the load; the load drives the torque to one limit."""
    forms = [iterate_load(SPATIAL, CIRCLE, guess=5.0, corrected=c).payload for c in (True, False)]
    yield largest_load(), *forms
    for offset, rise in ((2.0, -0.5), (-2.0, 0.5)):  # motors of 5 N·m
        empty = np.full(3, offset)
        full = empty + 0.1 * rise
        load = 0.1 * load_coefficient(PLANAR, full, empty, np.zeros(3), corrected=True)
        by_sign_of_torque = (5.0 - abs(offset)) / abs(rise)
        yield (5.0 + abs(offset)) / abs(rise), load, by_sign_of_torque


def eq38():
    """abs() hides an overloaded motor."""
    full, empty = np.full(3, 7.0), np.full(3, 6.0)  # motors of 5 N·m
    forms = [
        load_coefficient(PLANAR, full, empty, np.zeros(3), corrected=c)[0] for c in (True, False)
    ]
    yield -1.0, *forms


def eq41():
    """S τ is linear in the mass; τ is not where the pair of cables above T_min changes."""
    state = states(PLANAR_CIRCLE, np.linspace(0, 1, 101))
    torques = []
    for mass in (0.1, 2.1, 4.1):
        torques.append(textbook.inverse_dynamics(PLANAR, mass, *state, minimum=5.0).torques)
    bent = torques[0] - 2 * torques[1] + torques[2]
    yield 0.0, np.einsum("kij,ki->kj", textbook.jacobian(PLANAR, state[0]), bent), bent


def tables():
    """Friction of Table 4 on the planar robot, inertia of Table 4, Table 5 and Table 6."""
    robots = [with_transmission(PLANAR, damping=damping) for damping in (0.0, 0.01)]
    loads = [exact_payload(robot, PLANAR_CIRCLE) for robot in robots]
    assert loads[0].payload - loads[1].payload == pytest.approx(0.12, abs=0.01)
    corners = 2 * 0.148 / math.sqrt(3)
    assert 11 * corners**2 == pytest.approx(0.32, abs=0.005)
    assert SPATIAL.inertia[2] == 1.16 == sum(SPATIAL.inertia[:2])
    rotors = FLEXIBLE.pulley_inertia + FLEXIBLE.motor_inertia
    assert rotors == pytest.approx(SPATIAL.pulley_inertia)
    assert UNCERTAINTIES["table6"](SPATIAL).wrench.force_std ** 2 == pytest.approx(0.2)
    return ()


def text_of_5_1():
    """K_P e of 10 kg and of the pulleys has to carry one more kilogram: 32 mm, where R is 10 mm."""
    lift = textbook.jacobian(SPATIAL, SPATIAL.home)[:, 2]
    carrying = 10.0 + 8e-4 / RADIUS**2 * np.sum(lift**2)
    yield 0.032, round(9.81 / (carrying * KP), 3), 0.0


def text_of_6():
    """1.4 kg of 2.56 kg are 45 % less, and 9 % with the platform."""
    drops = [1 - (platform + 1.4) / (platform + 2.56) for platform in (0.0, 10.0)]
    yield [0.45, 0.09], np.round(drops, 2), [0.3, 0.3]


ERRATA = {
    form.__name__: form
    for form in (
        *(eq1_and_eq7, eq2, eq3, eq4, eq9_and_eq10, eq11, eq14, eq15_and_eq16, eq17_and_eq20),
        *(eq21, eq21_and_eq23, eq22, eq24, eq25, eq27_and_eq30, eq31, eq34, eq36, eq37),
        *(eq38, eq41, units, tables, text_of_5_1, text_of_6),
    )
}


@pytest.mark.parametrize("name", ERRATA)
def test_corrected_form_holds_and_printed_form_fails(name):
    for reference, corrected, *printed_forms in ERRATA[name]():
        size = np.abs(reference).max() or 1.0
        assert_allclose(corrected, reference * np.ones_like(corrected), rtol=0, atol=1e-5 * size)
        for printed in printed_forms:
            assert np.abs(np.subtract(printed, reference)).max() > 1e-3 * size


def test_page_covers_every_equation_and_names_every_erratum():
    headings = re.findall(r"^## (.+)$", PAGE, re.MULTILINE)
    covered = set()
    for lowest, highest in re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", " ".join(headings)):
        covered |= set(range(int(lowest), int(highest or lowest) + 1))
    assert covered == set(range(1, 42))
    named = set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^Test.*$", PAGE, re.MULTILINE))))
    assert named == set(ERRATA)
