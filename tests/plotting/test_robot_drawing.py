"""Drawing of a robot."""

from __future__ import annotations

import pytest

from cablebot_gym.bounds.robot_check import check_model
from cablebot_gym.robots import SPATIAL

pytest.importorskip("matplotlib")

from cablebot_gym.plotting import draw_robot


def test_numbers_of_cables_do_not_overlap():
    """In the y–z view, two cables of the spatial robot start at the same point."""
    figure = draw_robot(check_model(SPATIAL))
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [number.get_window_extent() for number in axes.texts]
        assert [box.count_overlaps(boxes) for box in boxes] == [1] * len(boxes)  # with itself
