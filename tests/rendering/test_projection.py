"""Outlines of platforms and bases."""

from __future__ import annotations

import numpy as np

from cablebot_gym.rendering.projection import outline

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


def test_outline_has_the_corners_in_order_without_inner_points():
    points = np.concatenate([SQUARE[[2, 0, 3, 1, 0]], [[1.5, 1.0]]])
    np.testing.assert_array_equal(outline(points), SQUARE)


def test_outline_of_a_bar_keeps_its_anchors():
    """A platform on two anchors raised in the painter."""
    bar = SQUARE[[0, 0, 1, 1]]
    np.testing.assert_array_equal(outline(bar), bar)
