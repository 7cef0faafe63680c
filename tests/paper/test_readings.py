"""The readings of the paper: each one reaches the robots, and none is a value of its own."""

from __future__ import annotations

import numpy as np
import pytest

from cablebot_baselines.paper.interpretation import Interpretation, choices_of
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL


def test_defaults_are_the_projects_own_robots():
    interpretation = Interpretation()
    assert interpretation.planar == PLANAR
    assert interpretation.spatial("payload").to_dict() == SPATIAL.to_dict()
    assert interpretation.flexible("payload").to_dict() == FLEX_SPATIAL.to_dict()


def test_sections_disagree_about_mass_and_stiffness_and_both_are_kept():
    interpretation = Interpretation()
    assert (interpretation.spatial("control").mass, interpretation.spatial("payload").mass) == (11.0, 10.0)
    stiffness = [interpretation.flexible(source).transmission.stiffness for source in ("control", "payload")]
    assert stiffness == [2.0, 3.0]
    chosen = Interpretation(platform_mass="10", stiffness="3")
    assert chosen.spatial("control").mass == 10.0
    assert chosen.flexible("control").transmission.stiffness == 3.0


def test_circumradius_is_the_distance_of_a_corner_from_the_middle():
    robot = Interpretation(sides="circumradius").spatial("payload")
    assert np.linalg.norm(robot.base[:, :2], axis=1) == pytest.approx(0.47)
    assert np.linalg.norm(robot.platform, axis=1) == pytest.approx(0.148)
    half_side = Interpretation().spatial("payload")
    assert np.linalg.norm(half_side.base[0] - half_side.base[1]) == pytest.approx(2 * 0.47)


def test_turned_robot_is_the_same_one_seen_from_the_other_side():
    turned, robot = Interpretation(triangles="turned").spatial("payload"), SPATIAL
    assert turned.base[4] == pytest.approx([0.0, -robot.base[4, 1], 0.0])
    pose, other = np.array([0.05, 0.02, 0.1, 0.1, -0.05, 0.0]), np.array([-0.05, -0.02, 0.1, -0.1, 0.05, 0.0])
    lengths = cable_lengths(turned.base, turned.platform, other)
    assert lengths == pytest.approx(cable_lengths(robot.base, robot.platform, pose))


def test_aligned_triangles_hold_nothing_and_say_so():
    with pytest.raises(ValueError, match="no equilibrium with positive tensions"):
        Interpretation(triangles="aligned").spatial("payload")


@pytest.mark.parametrize(
    ("apex", "direction"), [("up", (0, 1)), ("left", (-1, 0)), ("down", (0, -1)), ("right", (1, 0))]
)
def test_third_planar_motor_stands_where_it_is_said(apex, direction):
    third = Interpretation(planar_apex=apex).planar.base[2]
    assert third / np.linalg.norm(third) == pytest.approx(direction)


def test_cable_line_takes_the_rate_of_the_cable_length():
    robot, pose = SPATIAL, np.array([0.05, 0.02, 0.1, 0.1, 0.1, 0.1])
    velocity, step = np.array([0.3, -0.2, 0.1, 0.4, 0.1, -0.3]), 1e-6
    ends = [cable_lengths(robot.base, robot.platform, pose + sign * step * velocity) for sign in (1, -1)]
    rate = (ends[0] - ends[1]) / (2 * step)
    speed = textbook.pulley_speed(robot, pose, velocity)
    assert Interpretation(line="cable").line_speed(robot) * speed == pytest.approx(rate, abs=1e-8)
    assert Interpretation(line="reversed").line_speed(robot) * speed == pytest.approx(-speed)


def test_flat_motors_do_not_weaken_with_speed():
    robot = Interpretation(line="flat").motors(SPATIAL)
    lower, upper = textbook.torque_limits(robot, np.full(6, 100.0))
    assert upper == pytest.approx(robot.stall_torque)
    assert lower == pytest.approx(-robot.stall_torque)


@pytest.mark.parametrize("line", ["cable", "reversed", "pulley"])
def test_lines_that_no_motor_has_are_refused_by_motors(line):
    with pytest.raises(ValueError, match="flat or physical"):
        Interpretation(line=line).motors(FLEX_SPATIAL)
    assert Interpretation(line=line).closed_loop_robot(FLEX_SPATIAL) == FLEX_SPATIAL


def test_rigid_motor_turns_with_its_pulley():
    assert Interpretation(line="pulley").motors(SPATIAL) == SPATIAL
    for line in ("cable", "reversed"):
        with pytest.raises(ValueError, match="flat or physical"):
            Interpretation(line=line).motors(SPATIAL)


@pytest.mark.parametrize("name", list(choices_of()))
def test_unknown_choice_lists_the_known_ones(name):
    with pytest.raises(ValueError, match=f"{name} must be one of .*{choices_of()[name][-1]}"):
        Interpretation(**{name: "sideways"})


def test_tension_below_zero_is_refused():
    with pytest.raises(ValueError, match="minimum_tension"):
        Interpretation(minimum_tension=-1.0)


def test_words_name_what_was_chosen_and_nothing_else():
    assert Interpretation().text() == "default"
    assert Interpretation(line="flat", minimum_tension=0.0).text() == "line = flat, minimum_tension = 0.0"


def test_total_counts_the_platform():
    assert Interpretation(payload="total").counted(PLANAR, 1.13) == pytest.approx(2.13)
    assert Interpretation().counted(PLANAR, 1.13) == 1.13
