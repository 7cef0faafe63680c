"""Sag of heavy cables against a numerical integration, and the settled platform against its
equilibrium."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import each_of
from scipy.integrate import solve_ivp

from cablebot_gym.kinematics import cable_vectors
from cablebot_gym.physics import textbook
from cablebot_gym.physics.sag import catenary, sag, settle
from cablebot_gym.physics.tensions.distribution import least_norm
from cablebot_gym.robots import find_robot

CASES = [
    (9.0, -8.0, 20.0, 2.0),
    (40.0, 0.0, 40.0, 3.0),
    (0.5, 12.0, 2e4, 5.0),
    (3.0, 12.0, 3.0, 2.0),
]
"""Horizontal and vertical distance [m], chord tension [N] and weight per length [N/m]: sags of 1 to
80 %, of less than 0.01 %, and of a cable that is furthest from its chord near the upper end."""


def integrated(across, rise, tension, weight):
    """Positions between the ends [m], vertical distance from the chord there, and length of the
    cable minus that of the chord [m]. The force of an element changes by its weight alone, and it
    points along the cable."""
    horizontal = tension * across / np.hypot(across, rise)
    half = weight * across / (2 * horizontal)
    start = horizontal * np.sinh(
        np.arcsinh(rise * weight / (2 * horizontal * np.sinh(half))) - half
    )
    chord_slope = rise / across

    def element(_, state):
        slope = state[1] / horizontal
        stretch = np.hypot(1, slope)
        return [chord_slope - slope, weight * stretch, stretch - np.hypot(1, chord_slope)]

    end = solve_ivp(
        element,
        (0, across),
        [0, start, 0],
        rtol=1e-12,
        atol=1e-14,
        method="DOP853",
        dense_output=True,
    )
    # the closed form of the first slope is that of this chord
    assert end.y[0, -1] == pytest.approx(0, abs=1e-7)
    positions = np.linspace(0, across, 20001)
    return positions, end.sol(positions)[0], end.y[2, -1]


@pytest.mark.parametrize(("across", "rise", "tension", "weight"), CASES)
def test_catenary_is_the_integrated_equilibrium(across, rise, tension, weight):
    _, below, more = integrated(across, rise, tension, weight)
    depth, extra = catenary(across, rise, tension, weight)
    assert more == pytest.approx(float(extra), rel=1e-6)
    distance = below * across / np.hypot(across, rise)
    assert distance.max() == pytest.approx(float(depth), rel=1e-6)


def test_cable_that_no_force_holds_has_an_infinite_sag():
    """And a vertical cable has none."""
    assert_allclose(catenary(1.0, 1.0, [0.0, 1e-3], 10.0), np.inf)
    assert_allclose(catenary(0.0, 3.0, 10.0, 1.0), [0, 0])


def test_stiffness_factor_is_the_derivative_of_the_chord():
    """Of a catenary with a given free length."""
    robot = find_robot("flex-cogiro")
    tension = np.full(8, 200.0)
    step = 0.01
    loose = sag(robot, robot.home, tension)
    more = sag(robot, robot.home, tension + step).extra_length
    less = sag(robot, robot.home, tension - step).extra_length
    straight = loose.length / robot.axial_stiffness
    assert_allclose(
        loose.stiffness_factor, straight / (straight - (more - less) / (2 * step)), rtol=2e-3
    )
    assert (loose.stiffness_factor < 0.9).all()


TILTED = find_robot("cogiro").replace(name="tilted", home_pose=(0.5, -0.4, -2.0, 0.05, 0.1, -0.1))


SETTLED = [find_robot(name) for name in ("flex-cogiro", "flex-ttk4900", "stadium-camera")]


@each_of(*SETTLED, TILTED)
def test_settled_platform_is_in_equilibrium_with_its_cables(robot):
    structure = textbook.jacobian(robot, robot.home)
    load = textbook.bias(robot, robot.mass, robot.home, np.zeros(robot.coordinates))
    straight = least_norm(structure, load, robot.minimum_tension).tensions
    settled = settle(robot, robot.mass, robot.home, straight)
    loose = sag(robot, robot.home, settled.tensions)
    half = robot.gravity * robot.per_motor(robot.cable_density) * loose.length / 2

    def energy(pose):
        return -half @ cable_vectors(robot.base, robot.platform, pose)[..., -1]

    weight = []
    for step in 1e-4 * np.eye(robot.coordinates):
        weight.append((energy(robot.home + step) - energy(robot.home - step)) / 2e-4)
    largest = np.abs(load).max()
    assert_allclose(-structure.T @ settled.tensions, load + weight, rtol=1e-6, atol=1e-6 * largest)
    soft = loose.length / robot.axial_stiffness if robot.elastic else 0.0
    stretch = (
        settled.tensions - straight
    ) * soft - loose.extra_length  # of the catenary, not of the parabola
    assert_allclose(structure @ settled.pose_change, stretch, rtol=0.02, atol=1e-6)
