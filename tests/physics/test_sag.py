"""Sag of heavy cables against a numerical integration."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.platforms import CAMERA
from scipy.integrate import solve_ivp

from cablebot_gym.physics.sag import sag
from cablebot_gym.robots import find_robot

TENSIONS = np.array([2000.0, 400.0, 300.0, 1000.0])
"""Chord tensions of the camera [N]: sags of 0.1 to 1 % of the length."""


def integrated(across, rise, tension, weight):
    """Largest distance from the chord, and length of the cable minus that of the chord [m]. The force
    of an element changes by its weight alone, and it points along the cable."""
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

    tolerances = {"rtol": 1e-12, "atol": 1e-14, "method": "DOP853", "dense_output": True}
    end = solve_ivp(element, (0, across), [0, start, 0], **tolerances)
    below = end.sol(np.linspace(0, across, 20001))[0]
    return below.max() * across / np.hypot(across, rise), end.y[2, -1]


def test_sag_is_that_of_the_integrated_equilibrium():
    robot = CAMERA.replace(cable_density=0.05)
    loose = sag(robot, robot.home, TENSIONS)
    chords = robot.home - robot.base
    for i, tension in enumerate(TENSIONS):
        across = np.hypot(*chords[i, :2])
        depth, more = integrated(across, chords[i, 2], tension, 0.05 * robot.gravity)
        assert loose.sag[i] == pytest.approx(depth, rel=1e-3)
        assert loose.extra_length[i] == pytest.approx(more, rel=2e-3)


def test_cables_sag_from_a_horizontal_plane():
    robot = find_robot("planar").replace(cable_density=0.1)
    loose = sag(robot, robot.home, [1.0, 2.0, 0.0])
    half = loose.length[0] / 2
    assert_allclose(loose.sag, [0.1 * robot.gravity * half**2 / 2, loose.sag[0] / 2, np.inf])


def test_stiffness_factor_is_the_derivative_of_the_chord():
    """Of a cable with a given free length."""
    robot = find_robot("flex-cogiro")
    tension = np.full(8, 200.0)
    step = 0.01
    loose = sag(robot, robot.home, tension)
    more = sag(robot, robot.home, tension + step).extra_length
    less = sag(robot, robot.home, tension - step).extra_length
    straight = loose.length / robot.axial_stiffness
    assert_allclose(
        loose.stiffness_factor, straight / (straight - (more - less) / (2 * step)), rtol=1e-6
    )
    assert (loose.stiffness_factor < 0.9).all()
