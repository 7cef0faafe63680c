"""The corrections of docs/errata.md to loads, tables and text; and the page itself."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.lagrange import (
    FLEXIBLE,
    KD,
    KP,
    motion,
    outer_loop,
    parts_of_law,
)
from oracles.plants import (
    with_transmission,
)
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from cablebot_baselines.classical import PD
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, RPM, SPATIAL
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.uncertainty import UNCERTAINTIES
from cablebot_reproduction.load_iteration import (
    iterate_load,
    load_coefficient,
)

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "reproduction" / "docs" / "errata.md"

# --- §5: load ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bisected():
    """The largest payload within the torque limits on Table 3's circle, 500 instants, by
    bisection."""
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
    complete, half = (
        iterate_load(SPATIAL, circle, guess=5.0, corrected=corrected) for corrected in (True, False)
    )
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
        coefficient = load_coefficient(
            SPATIAL, full, empty.torques, empty.speeds, corrected=True
        ).min()
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
        torques = [
            textbook.inverse_dynamics(robot, mass, x, v, a, minimum=minimum).torques
            for mass in masses
        ]
        return torques[0] - 2 * torques[1] + torques[2], textbook.jacobian(robot, x)

    bent, s = second_difference(PLANAR, (0.1, 2.1, 4.1), 5.0)
    assert_allclose(np.einsum("kij,ki->kj", s, bent), 0, atol=1e-12)  # S τ is, as Eq. 41 says
    # τ is not: it has a kink where the pair of cables above T_min changes
    assert np.abs(bent).max() > 0.1
    # none at T_min = 0
    assert_allclose(second_difference(PLANAR, (0.1, 2.1, 4.1), 0.0)[0], 0, atol=1e-12)
    assert_allclose(second_difference(SPATIAL, (10.0, 12.0, 14.0), 0.0)[0], 0, atol=1e-10)


# --- tables and text --------------------------------------------------------------------------------------------------


def test_table2_and_table4_friction_and_mass_move_the_load():
    """Without the friction of Table 4 by 0.12 kg; by the kilogram between Tables 4 and 8."""
    planar = find_trajectory("paper-planar", 2)
    spatial = find_trajectory("paper-spatial", 6)
    loads = [
        exact_payload(with_transmission(PLANAR, damping=c), planar, frequency=500.0).payload
        for c in (0.0, 0.01)
    ]
    assert loads[0] - loads[1] == pytest.approx(0.12, abs=0.01)
    ten, eleven = (
        exact_payload(SPATIAL.replace(mass=mass), spatial, frequency=500.0) for mass in (10.0, 11.0)
    )
    assert ten.payload - eleven.payload == pytest.approx(1.0, abs=1e-6)
    assert ten.total_mass == pytest.approx(eleven.total_mass, abs=1e-6)


def test_table4_no_platform_of_this_size_has_this_inertia():
    """The largest I_zz of 11 kg within a triangle puts all of them into its corners: 0.32 of 1.16
    kg·m²."""
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
    # of a flat plate: no misprint
    assert SPATIAL.inertia[0] + SPATIAL.inertia[1] == pytest.approx(SPATIAL.inertia[2])


def test_table5_inertias_are_halves_of_table4():
    """J + J′ of Table 5 is J of Table 4. K = 2 and 3 are robots whose springs are wound by angles
    1.5 times apart."""
    assert FLEXIBLE.pulley_inertia[0] + FLEXIBLE.motor_inertia[0] == pytest.approx(
        SPATIAL.pulley_inertia[0]
    )
    robots = [with_transmission(FLEXIBLE, stiffness=k) for k in (2.0, 3.0)]
    soft, stiff = (textbook.static_motor_angle(robot, 11.0, SPATIAL.home) for robot in robots)
    assert_allclose(soft, 1.5 * stiff, rtol=1e-12)


def test_table6_variance_is_in_square_newtons():
    # N²: 0.45 N, not 0.2
    assert UNCERTAINTIES["table6"](SPATIAL).wrench.force_std ** 2 == pytest.approx(0.2)
    x, v, _ = motion(SPATIAL, 0.1)
    light, model = (parts_of_law(SPATIAL.replace(mass=mass), x, v)[1] for mass in (9.0, 10.0))
    assert 0.1 < np.linalg.norm(np.linalg.solve(light, model) - np.eye(6), 2) < 1 / 0.9 - 1 + 0.01


def test_text_of_5_1_error_leaves_its_bound():
    """1 kg at rest: K_P e of 10 kg has to carry it, e = m g/(m̂ K_P), about 33 mm, where R is 10
    mm."""
    law = PD(gains=(KP, KD))

    def rates(_, state):
        x = state[:6]
        v = state[6:]
        torques = textbook.inverse_dynamics(
            SPATIAL, 10.0, x, v, outer_loop(law, x, v, SPATIAL.home)
        ).torques
        return np.concatenate(
            [
                v,
                textbook.forward_dynamics(SPATIAL, 11.0, x, v, torques, cable="bilateral")[0],
            ]
        )

    start = np.concatenate([SPATIAL.home, np.zeros(6)])
    end = solve_ivp(rates, (0.0, 6.0), start, rtol=1e-6, atol=1e-9).y[:6, -1]
    # J β̈(v) of the law carries a little too: (D + (J/r²) SᵀS) K_P e, with S where it has sagged
    # to.
    carrying = 10.0 + 8e-4 / 0.05**2 * np.sum(textbook.jacobian(SPATIAL, end)[:, 2] ** 2)
    assert end[2] - 0.1 == pytest.approx(9.81 / (carrying * KP), rel=1e-3)
    assert end[2] - 0.1 > 3 * 0.01


def test_text_of_6_load_drops_by_no_thirty_percent():
    """Nor is it with the platform counted."""
    drops = [1 - (platform + 1.4) / (platform + 2.56) for platform in (0.0, 10.0, 11.0)]
    assert drops == pytest.approx([0.45, 0.09, 0.09], abs=0.006)


# --- the page ---------------------------------------------------------------------------------------------------------


def test_page_names_every_test_and_every_equation():
    """Each section names a test that exists, and each test beside this file is named."""
    sections = re.split(r"^## (.+)$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    named = [re.findall(r"((?:reproduction/)?tests/[\w/]+\.py)::(test_\w+)", text) for text in sections[::2]]
    assert all(named)
    for file, name in {pair for pairs in named for pair in pairs}:
        assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
    here = set()
    for path in Path(__file__).parent.glob("test_printed_*.py"):
        here |= set(re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE))
    assert here <= {name for pairs in named for _, name in pairs}
    ranges = re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", " ".join(sections[1::2]))
    covered = set()
    for lowest, highest in ranges:
        covered |= set(range(int(lowest), int(highest or lowest) + 1))
    assert covered == set(range(1, 42))
