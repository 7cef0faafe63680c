"""Pictures: the gauges at their bounds, and the robot at its pose."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from oracles.episodes import PLANAR, SPATIAL, make

from cablebot_gym.rendering.moment import Moment
from cablebot_gym.rendering.painter import Painter

IDS = {"planar": PLANAR, "spatial": SPATIAL}


@cache
def env_of(kind):
    env = make(IDS[kind])
    env.reset()
    return env


VERMILLION = (0xD5, 0x5E, 0x00)


def painter_of(kind):
    return Painter(env_of(kind).task, "fl")


def moment_of(kind, **changes):
    env = env_of(kind)
    robot = env.task.robot
    _, info = env.reset(seed=0, options={"payload": 3.0})
    return replace(Moment.from_info(robot, robot.stall_torque, env.pose, info), **changes)


@pytest.fixture(params=IDS)
def kind(request):
    return request.param


def count(picture, colour):
    return int(np.sum(np.all(picture == colour, axis=-1)))


def test_picture_depends_on_its_moment_only(kind):
    painter = painter_of(kind)
    picture = painter.array(moment_of(kind))
    painter.array(
        moment_of(
            kind, position_error=1.0, slack=np.ones(env_of(kind).task.robot.cables, np.bool_)
        ),
        note="ended",
    )
    assert np.array_equal(painter.array(moment_of(kind)), picture)
    assert np.array_equal(painter_of(kind).array(moment_of(kind)), picture)
    lost = moment_of(
        kind, pose=np.full(env_of(kind).task.robot.coordinates, np.nan), position_error=1e6
    )
    assert painter.array(lost).shape == (480, 640, 3)
    assert picture.dtype == np.uint8


@pytest.mark.parametrize(
    ("name", "rows"), [("position_error", (0.85, 0.9)), ("rotation_error", (0.89, 0.95))]
)
def test_gauge_is_red_beyond_its_bound(name, rows):
    painter = painter_of("spatial")
    within = painter.array(moment_of("spatial", **{name: 0.0099}))
    beyond = painter.array(moment_of("spatial", **{name: 0.0101}))
    band = slice(int(rows[0] * 480), int(rows[1] * 480))
    assert count(within[band, :450], VERMILLION) == 0
    assert count(beyond[band, :450], VERMILLION) > 500


def steel(picture):
    """Pixels of the payload's ball, (rows, columns)."""
    near = np.abs(picture[60:400, :450].astype(int) - (0x4A, 0x4E, 0x55)) < 24
    return np.nonzero(np.all(near, axis=-1))


def test_robot_is_at_its_pose(kind):
    painter = painter_of(kind)
    moment = moment_of(kind)
    far = moment.pose + 0.1 * np.eye(len(moment.pose))[0]
    columns = [
        steel(painter.array(replace(moment, pose=pose)))[1].mean() for pose in (moment.pose, far)
    ]
    assert columns[1] - columns[0] == pytest.approx(
        painter._camera.pixels(0.1, np.zeros(3)), rel=0.3
    )
