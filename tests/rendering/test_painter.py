"""Pictures: each thing that is to be seen changes them, where it belongs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablebot_gym.envs import env_robot
from cablebot_gym.rendering import Moment, Scene
from cablebot_gym.rendering.painter import Painter, as_array, tension_colour
from cablebot_gym.robots import find_robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import find_trajectory

ROBOTS = {kind: find_robot(env_robot(f"CableBot-{kind.title()}-v0")) for kind in ("planar", "spatial")}
VERMILLION, BLUE = (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2)


def scene_of(kind):
    robot = ROBOTS[kind]
    trajectory = find_trajectory(f"paper-{kind}", robot.coordinates)
    return Scene(robot=robot, trajectory=trajectory, error_bounds=ErrorBounds(), title="fl")


def moment_of(kind, **changes):
    robot = ROBOTS[kind]
    stall = robot.stall_torque
    calm = Moment(
        time=0.25,
        payload=3.0,
        pose=np.array(find_trajectory(f"paper-{kind}", robot.coordinates)(0.25).position),
        tensions=np.full(robot.cables, 0.1 * stall[0] / robot.pulley_radius[0]),
        torques=0.2 * stall,
        torque_limits=np.array([-0.9 * stall, 0.8 * stall]),
        commanded_action=np.full(robot.cables, 0.3),
        slack=np.zeros(robot.cables, np.bool_),
        position_error=0.002,
        rotation_error=0.001 if kind == "spatial" else 0.0,
    )
    return replace(calm, **changes)


@pytest.fixture(params=list(ROBOTS))
def kind(request):
    return request.param


def count(picture, colour):
    return int(np.sum(np.all(picture == colour, axis=-1)))


def changed(kind, **changes):
    """Where a picture differs from the calm one: (left, top, right, bottom) of the differing pixels, as shares."""
    painter = Painter(scene_of(kind))
    calm, other = painter.array(moment_of(kind)), painter.array(moment_of(kind, **changes))
    rows, columns = np.nonzero(np.any(calm != other, axis=-1))
    assert len(rows), "nothing is seen of it"
    return columns.min() / 640, rows.min() / 480, columns.max() / 640, rows.max() / 480


def test_picture_has_the_size_and_is_not_empty(kind):
    picture = Painter(scene_of(kind), (800, 500)).array(moment_of(kind))
    assert (picture.shape, picture.dtype) == ((500, 800, 3), np.uint8)
    assert 0.02 < np.mean(np.any(picture < 200, axis=-1)) < 0.5


def test_same_moment_gives_the_same_picture_whatever_was_painted_before(kind):
    painter = Painter(scene_of(kind))
    first = painter.array(moment_of(kind))
    painter.array(moment_of(kind, position_error=1.0, slack=np.ones(ROBOTS[kind].cables, np.bool_)), note="ended")
    assert np.array_equal(painter.array(moment_of(kind)), first)
    assert np.array_equal(Painter(scene_of(kind)).array(moment_of(kind)), first)


def test_motor_that_is_asked_for_more_than_it_has_is_marked_in_its_own_place(kind):
    places = []
    for motor in range(ROBOTS[kind].cables):
        action = np.full(ROBOTS[kind].cables, 0.3)
        action[motor] = -1.2
        left, top, right, bottom = changed(kind, commanded_action=action)
        assert left > 0.7
        assert right - left < 0.04
        assert 0.09 < top < bottom < 0.76
        places.append(left)
    assert places == sorted(places)


def test_bars_grow_with_torque_and_downwards_when_it_is_negative():
    painter, stall = Painter(scene_of("planar")), ROBOTS["planar"].stall_torque

    def blue_rows(fraction):
        panel = painter.array(moment_of("planar", torques=fraction * stall))[:360, 510:]
        return np.nonzero(np.any(np.all(panel == BLUE, axis=-1), axis=1))[0]

    small, large, negative = blue_rows(0.2), blue_rows(0.6), blue_rows(-0.6)
    assert len(large) == pytest.approx(3 * len(small), abs=6)
    assert large.max() == pytest.approx(negative.min(), abs=5)
    assert len(negative) == pytest.approx(len(large), abs=5)


def test_motor_limits_move_with_speed(kind):
    error_bounds = moment_of(kind).torque_limits.copy()
    error_bounds[:, 1] *= 0.5
    left, top, right, bottom = changed(kind, torque_limits=error_bounds)
    assert left > 0.7
    assert right - left < 0.04
    assert top < 0.3 < 0.5 < bottom  # both of them


@pytest.mark.parametrize(("name", "rows"), [("position_error", (0.85, 0.9)), ("rotation_error", (0.89, 0.95))])
def test_gauge_is_red_beyond_its_bound_and_not_before(name, rows):
    painter = Painter(scene_of("spatial"))
    within = painter.array(moment_of("spatial", **{name: 0.0099}))
    beyond = painter.array(moment_of("spatial", **{name: 0.0101}))
    band = slice(int(rows[0] * 480), int(rows[1] * 480))
    assert count(within[band, :450], VERMILLION) == 0
    assert count(beyond[band, :450], VERMILLION) > 500


def test_error_far_beyond_stays_on_its_gauge(kind):
    assert changed(kind, position_error=1e6)[2] < 0.75


def test_planar_robot_has_no_rotation_gauge():
    with pytest.raises(AssertionError, match="nothing is seen"):
        changed("planar", rotation_error=0.5)


def test_slack_cable_is_drawn_otherwise_and_no_other_one_is(kind):
    robot = ROBOTS[kind]
    slack = np.arange(robot.cables) == 0
    left, top, right, bottom = changed(kind, slack=slack)
    painter = Painter(scene_of(kind))
    base = painter._camera.project(painter._base)[0] / (2 * np.array([640, 480]))
    assert left - 0.05 < base[0] < right + 0.05  # from its own anchor
    assert top - 0.05 < base[1] < bottom + 0.05
    assert right < 0.72


def test_cables_take_the_colour_of_their_tension(kind):
    painter, robot = Painter(scene_of(kind)), ROBOTS[kind]
    full = np.full(robot.cables, np.max(robot.stall_torque / robot.pulley_radius))
    loose, tight = (painter.array(moment_of(kind, tensions=fraction * full))[:, :450] for fraction in (0.0, 1.0))
    assert count(tight, tension_colour(1.0)) > 400 > 100 > count(loose, tension_colour(1.0))
    assert count(loose, tension_colour(0.0)) > 200 > 100 > count(tight, tension_colour(0.0))


def test_colours_of_tension_end_where_the_scale_does_and_grow_darker():
    assert tension_colour(-1.0) == tension_colour(0.0) == (0x8F, 0xBF, 0xE0)
    assert tension_colour(7.0) == tension_colour(1.0) == (0x8C, 0x1C, 0x13)
    luminance = [np.dot(tension_colour(fraction), (0.2126, 0.7152, 0.0722)) for fraction in np.linspace(0, 1, 5)]
    assert luminance[0] > luminance[1] > luminance[2] > luminance[4]


def steel(picture):
    """Where the payload's ball is, (rows, columns)."""
    near = np.abs(picture[60:400, :450].astype(int) - (0x4A, 0x4E, 0x55)) < 24
    return np.nonzero(np.all(near, axis=-1))


def test_heavier_payload_is_a_larger_ball_and_none_is_no_ball(kind):
    painter = Painter(scene_of(kind))
    none, light, heavy = (len(steel(painter.array(moment_of(kind, payload=kg)))[0]) for kg in (0.0, 1.0, 8.0))
    assert light - none > 100
    # Eight times the volume is four times the disc; cables hide more of the small one.
    assert 3.5 < (heavy - none) / (light - none) < 6


def test_robot_is_where_the_pose_says(kind):
    painter, moment = Painter(scene_of(kind)), moment_of(kind)
    far = moment.pose + 0.1 * np.eye(len(moment.pose))[0]
    columns = [steel(painter.array(replace(moment, pose=pose)))[1].mean() for pose in (moment.pose, far)]
    assert columns[1] - columns[0] == pytest.approx(painter._camera.pixels(0.1, np.zeros(3)) / 2, rel=0.25)


def test_trail_is_where_the_platform_has_been(kind):
    painter, moment = Painter(scene_of(kind)), moment_of(kind)
    calm = painter.array(moment).astype(int)
    way = moment.pose - np.linspace(0, 0.3, 20)[:, None] * np.eye(len(moment.pose))[0]
    differs = np.any(painter.array(moment, way) != calm, axis=-1)
    points = painter._camera.project(painter._points(way)) / 2
    rows, columns = np.nonzero(differs)
    assert len(rows) > 30
    assert columns.min() == pytest.approx(points[:, 0].min(), abs=3)
    assert np.all((rows > points[:, 1].min() - 3) & (rows < points[:, 1].max() + 3))
    assert np.array_equal(painter.array(moment, way * np.nan), calm)


def test_good_and_bad_notes_differ_by_more_than_their_words(kind):
    painter, moment = Painter(scene_of(kind)), moment_of(kind)
    assert count(painter.array(moment, note="not carried: slack")[:40], VERMILLION) > 50
    assert count(painter.array(moment, note="carried", good=True)[:40], (0x00, 0x9E, 0x73)) > 20


def test_state_that_is_not_finite_has_a_picture_all_the_same(kind):
    painter, n = Painter(scene_of(kind)), ROBOTS[kind].coordinates
    assert painter.array(moment_of(kind, pose=np.full(n, np.nan), position_error=1e6)).shape == (480, 640, 3)


def test_smaller_pictures_than_words_fit_in_are_refused():
    with pytest.raises(ValueError, match="at least 320 × 240 pixels, not 100 × 400"):
        Painter(scene_of("planar"), (100, 400))


def test_surface_and_numbers_have_the_same_orientation(kind):
    painter = Painter(scene_of(kind))
    surface = painter.paint(moment_of(kind))
    picture = as_array(surface)
    for x, y in ((3, 5), (600, 300), (90, 412)):
        assert tuple(picture[y, x]) == tuple(surface.get_at((x, y)))[:3]
