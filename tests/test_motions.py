"""The reference motions against the paper's tables, their formulas and slopes, and the rules of
the protocol."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_gym.motions import (
    ORDERS,
    TRAJECTORIES,
    BetweenDwells,
    Dwell,
    Lemniscate,
    PaperCircle,
    PointToPoint,
    SmoothCircle,
    Waypoints,
    find_trajectory,
)

POSE = (0.02, -0.03, 0.12, 0.01, -0.02, 0.03)
END = tuple(-2 * value + 0.1 for value in POSE)
every_name = pytest.mark.parametrize("name", TRAJECTORIES)


def stacked(reference):
    return np.stack([getattr(reference, order) for order in ORDERS])


# --- the paper's tables -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "radius", "constants"), [("planar", 0.2165, []), ("spatial", 0.1, [0.1] * 4)]
)
def test_paper_circle_is_that_of_tables_1_and_3(robot, radius, constants):
    t = np.linspace(0, 1, 501)
    speeds_up = t <= 0.5
    angle = 4 * np.pi * np.where(speeds_up, t, 1 - t) ** 2
    x, y = np.cos(angle), np.where(speeds_up, 1, -1) * np.sin(angle)
    circle = TRAJECTORIES[f"paper-{robot}"]()
    position = circle(t).position
    assert_allclose(position[:, :2], radius * np.stack([x, y], axis=1), rtol=0, atol=1e-15)
    assert_array_equal(position[:, 2:], [constants] * 501)
    named = TRAJECTORIES[f"circle-{robot}"](dwell=0)
    assert_array_equal(stacked(named(t)), stacked(circle(t)))
    with pytest.raises(ValueError, match="unknown key of trajectory 'dwell'"):
        find_trajectory({"name": f"paper-{robot}", "dwell": 0.3}, robot)


# --- positions and derivatives ------------------------------------------------------------------------------------

PAPER = PaperCircle(radius=0.3, center=POSE, duration=1.7)
MOTIONS = {
    "paper": PAPER,
    "circle": SmoothCircle(radius=0.3, center=POSE, duration=1.7),
    "dwell": Dwell(pose=POSE, duration=1.7),
    "line": PointToPoint(start=POSE, end=END, duration=1.7),
    "lemniscate": Lemniscate(amplitude=(0.3, 0.2), center=POSE, duration=1.7),
}


def test_positions_follow_a_blend_that_is_smooth_at_its_ends():
    """∫ u⁴ (1 − u)⁴ du, the C⁴ blend with the lowest degree, in the angle or along the line."""
    times = np.linspace(0, 1.7, 41)
    rate = np.polynomial.Polynomial([0, 1]) ** 4 * np.polynomial.Polynomial([1, -1]) ** 4
    rise = rate.integ()
    blend = (rise(times / 1.7) / rise(1.0))[:, None]
    angle = 2 * np.pi * blend
    rest = np.tile(POSE[2:], (41, 1))
    in_plane = {
        "circle": 0.3 * np.hstack([np.cos(angle), np.sin(angle)]),
        "lemniscate": np.hstack([0.3 * np.sin(angle), 0.2 * np.sin(2 * angle)]),
    }
    for name, shift in in_plane.items():
        expected = np.hstack([shift + POSE[:2], rest])
        assert_allclose(MOTIONS[name](times).position, expected, rtol=0, atol=1e-12)
    expected = POSE + (np.array(END) - POSE) * blend
    assert_allclose(MOTIONS["line"](times).position, expected, rtol=0, atol=1e-12)


SPLINE = Waypoints(times=(0.0, 1.0, 2.5, 3.0), poses=((0, 0), (0.1, 0.1), (0.1, -0.1), (0, 0)))
LINES = Waypoints(times=SPLINE.times, poses=SPLINE.poses, blend=0.4, name="lines")


SMOOTH = [
    SPLINE,
    LINES,
    *(find_trajectory({"name": "loop-point", "seed": seed}, 3) for seed in (0, 8, 10_424)),
    *(TRAJECTORIES[name]() for name in TRAJECTORIES if not name.startswith(("paper", "circle"))),
]
"""Without the circle of the paper, whose acceleration jumps half way."""


@pytest.mark.parametrize(
    ("motion", "start", "end"),
    [
        *((motion, 0.0, motion.duration) for motion in SMOOTH),
        (PAPER, 1e-4, 0.8499),
        (PAPER, 0.8501, 1.6999),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_derivatives_are_slopes_also_where_parts_meet(motion, start, end):
    times = np.linspace(start, end, 2001)
    values = stacked(motion(times))[1:]
    slope = (stacked(motion(times + 1e-5)) - stacked(motion(times - 1e-5)))[:-1] / 2e-5
    scale = np.abs(values).max(axis=(1, 2), keepdims=True) + 1e-9
    assert_allclose(slope / scale, values / scale, atol=1e-3)  # the next derivative jumps


# --- dwells -------------------------------------------------------------------------------------------------------


@given(
    dwell=st.just(0.0) | st.floats(1e-3, 5),
    case=st.sampled_from(sorted(MOTIONS)),
    fraction=st.floats(-0.5, 1.5),
)
def test_motion_between_dwells_is_shifted_and_rests_at_its_ends(dwell, case, fraction):
    motion = MOTIONS[case]
    between = BetweenDwells(motion=motion, dwell=dwell)
    assert between.duration == pytest.approx(motion.duration + 2 * dwell, rel=1e-15)
    time = dwell + fraction * motion.duration
    expected = stacked(motion(time - dwell))
    if time < dwell:
        expected[1:] = 0.0
    assert_array_equal(stacked(between(time)), expected)
    after = [dwell * 1.5 + motion.duration, 99.0]
    for times, end in (([-1.0, 0.0, dwell / 2], 0.0), (after, motion.duration)):
        values = stacked(between(times))
        assert_array_equal(values[0], [motion(end).position] * len(times))
        assert dwell == 0 or not values[1:].any()


def test_motion_with_dwells_takes_no_others():
    with pytest.raises(ValueError, match="motion has dwells already"):
        BetweenDwells(motion=find_trajectory("loop-planar", 2))


# --- motions in files ---------------------------------------------------------------------------------------------

FILE = """
from cablebot_gym.motions import PointToPoint
class Shift(PointToPoint):
    def __init__(self):
        super().__init__(start=(0.0, 0.0), end=(0.1, 0.0))
def shift():
    return Shift()
ready, number = Shift(), 3
"""


def test_motion_of_a_file_is_an_object_class_or_function(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = tmp_path / "own_motion_of_a_test.py"
    path.write_text(FILE, encoding="utf-8")
    for name in ("ready", "Shift", "shift"):
        motion = find_trajectory(f"{path}:{name}", 2)
        assert motion(99.0).position.tolist() == [0.1, 0.0]
        assert find_trajectory(f"{path}:{name}", 2) is motion, (
            "one object, so that environments share one table"
        )
    with pytest.raises(ValueError, match="gives 3, which is no Trajectory"):
        find_trajectory(f"{path}:number", 2)


# --- the ends -----------------------------------------------------------------------------------------------------


@every_name
def test_motion_rests_outside_its_duration(name):
    """The last instant still belongs to the motion: the paper's circle brakes at t = 1 s, with −8π
    rad/s² at (R, 0). Batches of times equal single ones."""
    motion = TRAJECTORIES[name]()
    after = motion([np.nextafter(motion.duration, np.inf), motion.duration + 7.0, np.inf])
    assert_array_equal(after.position, [motion(motion.duration).position] * 3)
    assert not stacked(after)[1:].any()
    assert_array_equal(stacked(motion(-0.3)), stacked(motion(0.0)))
    times = motion.duration * np.array([[-0.5, 0.0, 0.2], [0.5, 1.0, 1.5]])
    batch = stacked(motion(times.tolist()))
    for index in np.ndindex(times.shape):
        single = motion(float(times[index]))
        assert_allclose(batch[:, *index], stacked(single), rtol=1e-14, atol=1e-12)
        for values in vars(single).values():
            values[:] = 9.0  # writing into a reference does not change the motion
    assert_array_equal(batch, stacked(motion(times)))
    if name == "paper-planar":
        assert_allclose(motion(1.0).acceleration, [0, -0.2165 * 8 * np.pi], atol=1e-12)


# --- errors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("trajectory", "kind", "message"),
    [
        (
            "circle-planar",
            6,
            "unknown trajectory 'circle-planar'; .*; did you mean 'circle-spatial'",
        ),
        (Dwell(name="drift", pose=(0.0, 0.0)), 6, "'drift' has 2 coordinates and the robot has 6"),
        ({"name": "line-planar", "dwell": -0.1}, 2, "dwell must be .* at least 0 s, not -0.1"),
        ({"name": "loop-spatial", "reach": [0.1]}, 6, "reach must be 3 numbers"),
        ({"name": "line-planar", "end": POSE}, 2, "start has 2 coordinates and end has 6"),
        (
            {"name": "circle-planar", "center": (0, 0, 0, 0)},
            2,
            "center must be .x, y., .x, y, φ., .x, y, z. or ",
        ),
    ],
)
def test_wrong_request_raises(trajectory, kind, message):
    with pytest.raises(ValueError, match=message):
        find_trajectory(trajectory, kind)
