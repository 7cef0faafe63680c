"""Motions through the waypoints of a CSV file."""

import json
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_gym.motions import Waypoints, find_trajectory
from cablebot_gym.motions.base import RATES
from cablebot_gym.task import to_jsonable

TEXT = "t,x,y\n5,0,0\n6,0.1,0.1\n7.5,0.1,-0.1\n8,0,0\n"


@pytest.fixture
def write_file(tmp_path):
    def write(text=TEXT, name="way.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write


def test_spline_meets_the_waypoints_and_rests_at_both_ends(write_file):
    motion = find_trajectory(write_file(), "planar")
    assert (motion.name, motion.duration, motion.dwell) == ("way.csv", 3.6, 0.3)
    reference = motion(np.array([0.0, 0.3, 1.3, 2.8, 3.3, 3.6, 99.0]))
    expected = [[0, 0], [0, 0], [0.1, 0.1], [0.1, -0.1], [0, 0], [0, 0], [0, 0]]
    assert_allclose(reference.position, expected, atol=1e-9)
    for time in (0.0, motion.motion.duration):
        for rate in RATES:
            assert not getattr(motion.motion(time), rate).any()


def test_motion_survives_json_and_pickle_without_its_file(write_file, tmp_path):
    motion = find_trajectory(write_file(), "planar")
    (tmp_path / "way.csv").unlink()
    assert find_trajectory(json.loads(json.dumps(to_jsonable(motion))), "planar") == motion
    assert pickle.loads(pickle.dumps(motion)) == motion


@pytest.mark.parametrize(
    ("kind", "text", "pose"),
    [
        ("planar", "y , x\n\n0,0\n0.2,0.1\n", [0.1, 0.2]),
        ("planar-platform", "x,y,phi\n0,0,0\n0.1,0.2,0.3\n", [0.1, 0.2, 0.3]),
        ("point", "x,y,z\n0,0,0\n0.1,0.2,0.3\n", [0.1, 0.2, 0.3]),
        ("spatial", "x,y,z,psi,theta,phi\n0,0,0,0,0,0\n1,2,3,4,5,6\n", [1, 2, 3, 4, 5, 6]),
    ],
)
def test_coordinates_alone_take_a_duration(write_file, kind, text, pose):
    name = write_file(text, "WAY.CSV")
    motion = find_trajectory({"name": name, "duration": 4, "dwell": 0}, kind)
    assert motion.duration == 4
    assert_allclose(motion(4.0).position, pose)
    with pytest.raises(
        ValueError, match=r"has no column t\. Add it, or give a duration: \{\"name\""
    ):
        find_trajectory(name, kind)


def test_duration_scales_the_times_of_the_file(write_file):
    motion = find_trajectory({"name": write_file(), "duration": 6.0}, "planar").motion
    assert motion.times == (0.0, 2.0, 5.0, 6.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it is empty. Its first line must name columns of t, x, y$"),
        ("t;x;y\n0;0;0\n", "separated by ';'. Save it with commas"),
        ("t,x\n0,0\n", r"its first line is 't,x'. It must be t,x,y .t in s, lengths in m"),
        ("t,x,x\n0,0,0\n", "column 'x' appears twice"),
        ("t,X,y\n0,0,0\n", "unknown column 'X'; choose one of t, x, y; did you mean 'x'"),
        ("t,x [mm],y\n0,0,0\n", r"column 'x \[mm\]' must be in m. Convert its numbers"),
        ("t [s], x [m] ,y\n0,0,0\n", "it needs at least two waypoints"),
        ("t,x,y\n0,0,0\n1,1\n", "line 3 has 2 values, and the first line 3 columns"),
        ("t,x,y\n0,0,0\n1,1;5,1\n", "line 3: x is '1;5', which is not a finite number"),
        ("t,x,y\n0,0,0\n1,inf,1\n", "line 3: x is 'inf', which is not a finite number"),
        ("t,x,y\n0,0,0\n1,,1\n", "line 3: x is empty. A waypoint has a number in each column"),
        (
            "t,x,y\n0,0,0\n\n1,1,1\n1,1,1\n",
            "line 5: t is 1, after 1 in line 4. It must increase: remove or correct a line",
        ),
    ],
)
def test_wrong_file_is_refused_with_its_line(write_file, text, message):
    with pytest.raises(ValueError, match=f"trajectory file '.*way.csv': .*{message}"):
        find_trajectory(write_file(text), "planar")


def test_missing_file_and_invalid_waypoints_raise(tmp_path):
    with pytest.raises(ValueError, match=r"cannot read trajectory file '.*none\.csv': No such"):
        find_trajectory(tmp_path / "none.csv", "planar")
    for times, message in (
        ((0.0, 1.0, 1.0, 2.0), "times must be at least two numbers that increase from 0"),
        ((0.0, 1e-9, 1.0, 2.0), "spaced too unevenly"),
    ):
        with pytest.raises(ValueError, match=message):
            Waypoints(times=times, poses=((0, 0), (1, 1), (0, 1), (1, 0)))
