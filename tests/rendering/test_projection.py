"""Perspective projection, and outlines of platforms and bases."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cablebot_gym.rendering.projection import fit_camera, outline

CORNER = np.array([100.0, 50.0])
SIZE = np.array([400.0, 300.0])
WINDOW = (*CORNER, *SIZE)
CLOUD = np.random.default_rng(4).uniform(-1, 1, (60, 3))
ANGLES = [(0.0, math.pi / 2), (0.4, 0.5), (2.5, 0.0), (-1.0, 1.2)]


@pytest.mark.parametrize(("azimuth", "elevation"), ANGLES)
def test_fitted_points_fill_the_window(azimuth, elevation):
    camera = fit_camera(CLOUD, WINDOW, azimuth=azimuth, elevation=elevation)
    page = camera.project(CLOUD)
    low = page.min(axis=0)
    high = page.max(axis=0)
    assert np.all(low >= CORNER - 1e-6)
    assert np.all(high <= CORNER + SIZE + 1e-6)
    assert np.max((high - low) / SIZE) > 0.999
    assert (low + high) / 2 == pytest.approx(CORNER + SIZE / 2)
    axes = np.array([camera.right, camera.down, camera.forward])
    assert axes @ axes.T == pytest.approx(np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_z_points_downwards_in_the_picture():
    camera = fit_camera(CLOUD, WINDOW, azimuth=0.4, elevation=0.5)
    (x, y), (x_below, y_below) = camera.project([[0, 0, 0], [0, 0, 0.5]])
    assert y_below > y + 10
    assert x_below == pytest.approx(x, abs=15)  # upright, but for the perspective


SQUARE = 2.0 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def test_outline_of_a_bar_keeps_its_anchors():
    """A platform on two anchors raised in the painter."""
    bar = SQUARE[[0, 0, 1, 1]]
    np.testing.assert_array_equal(outline(bar), bar)
