"""Pictures: the gauges at their bounds, and the robot at its pose."""

from dataclasses import replace

import numpy as np
import pytest

from cablebot_gym.envs import env_robot
from cablebot_gym.motions import find_trajectory
from cablebot_gym.rendering.moment import Moment
from cablebot_gym.rendering.painter import Painter
from cablebot_gym.robots import find_robot
from cablebot_gym.task import ErrorBounds, Task

ROBOTS = {
    kind: find_robot(env_robot(f"CableBot-{kind.title()}-v0")) for kind in ("planar", "spatial")
}
VERMILLION = (0xD5, 0x5E, 0x00)


def painter_of(kind):
    robot = ROBOTS[kind]
    task = Task(
        robot=robot,
        trajectory=find_trajectory(f"paper-{kind}", robot.coordinates),
        error_bounds=ErrorBounds(),
        control_frequency=500.0,
        cable="unilateral",
        model_payload=0.0,
        payload_known=True,
    )
    return Painter(task, "fl")


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


def test_picture_depends_on_its_moment_only(kind):
    painter = painter_of(kind)
    picture = painter.array(moment_of(kind))
    painter.array(
        moment_of(kind, position_error=1.0, slack=np.ones(ROBOTS[kind].cables, np.bool_)),
        note="ended",
    )
    assert np.array_equal(painter.array(moment_of(kind)), picture)
    assert np.array_equal(painter_of(kind).array(moment_of(kind)), picture)
    lost = moment_of(kind, pose=np.full(ROBOTS[kind].coordinates, np.nan), position_error=1e6)
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
        painter._camera.pixels(0.1, np.zeros(3)), rel=0.25
    )
