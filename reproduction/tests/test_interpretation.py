"""The options of the interpretation and their effect on the robots; test_published has those of
sizes, masses and stiffnesses."""

import numpy as np
import pytest

from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_reproduction.interpretation import Interpretation

DEFAULT = Interpretation()


def test_default_robots_are_those_of_the_package():
    assert DEFAULT.planar == PLANAR
    assert DEFAULT.spatial("payload").to_dict() == SPATIAL.to_dict()
    assert DEFAULT.flexible("payload").to_dict() == FLEX_SPATIAL.to_dict()


def test_turned_robot_is_rotated_about_z():
    turned = Interpretation(triangles="turned").spatial("payload")
    lengths = cable_lengths(
        SPATIAL.base, SPATIAL.platform, np.array([0.05, 0.02, 0.1, 0.1, -0.05, 0.0])
    )
    turned_lengths = cable_lengths(
        turned.base, turned.platform, np.array([-0.05, -0.02, 0.1, -0.1, 0.05, 0.0])
    )
    assert turned_lengths == pytest.approx(lengths)
    assert turned.base[4] == pytest.approx([0.0, -SPATIAL.base[4, 1], 0.0])


@pytest.mark.parametrize(
    ("apex", "direction"), [("up", (0, 1)), ("left", (-1, 0)), ("down", (0, -1)), ("right", (1, 0))]
)
def test_planar_apex_is_the_direction_of_the_third_motor(apex, direction):
    third = Interpretation(planar_apex=apex).planar.base[2]
    assert third / np.linalg.norm(third) == pytest.approx(direction)


def test_cable_line_uses_the_rate_of_the_cable_length():
    pose = np.array([0.05, 0.02, 0.1, 0.1, 0.1, 0.1])
    velocity = np.array([0.3, -0.2, 0.1, 0.4, 0.1, -0.3])
    step = 1e-6
    longer = cable_lengths(SPATIAL.base, SPATIAL.platform, pose + step * velocity)
    shorter = cable_lengths(SPATIAL.base, SPATIAL.platform, pose - step * velocity)
    speed = textbook.pulley_speed(SPATIAL, pose, velocity)
    rate = Interpretation(line="cable").line_speed(SPATIAL) * speed
    assert rate == pytest.approx((longer - shorter) / (2 * step), abs=1e-8)
    assert Interpretation(line="reversed").line_speed(SPATIAL) == pytest.approx(-1.0)


@pytest.mark.parametrize("line", ["cable", "reversed", "pulley"])
def test_line_that_no_motor_has_allows_no_closed_loop(line):
    interpretation = Interpretation(line=line)
    assert not interpretation.flexible_loop_possible
    assert interpretation.closed_loop_robot(FLEX_SPATIAL) == FLEX_SPATIAL
    # a rigid motor turns with its pulley
    assert interpretation.closed_loop_possible is (line == "pulley")


@pytest.mark.parametrize(
    "choice", [{"line": "sideways"}, {"stiffness": "4"}, {"minimum_tension": -1.0}]
)
def test_invalid_choice_raises(choice):
    with pytest.raises(ValueError, match=next(iter(choice))):
        Interpretation(**choice)
