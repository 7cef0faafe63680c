"""The robots as data: the paper's values verbatim, and errors for robots that are not physically
possible."""

import contextlib
import copy
import dataclasses
import json
import math
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import PLANAR as PLANAR_ID
from oracles.episodes import check_equal, make
from oracles.plants import UNEQUAL, each_of
from oracles.platforms import CAMERA, CRANE, PLATFORMS

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import (
    FLEX_SPATIAL,
    PLANAR,
    RPM,
    SPATIAL,
    Defaults,
    Robot,
    Transmission,
    find_robot,
)
from cablebot_gym.task import ErrorBounds, find_error_bounds

NAN = math.nan
INF = math.inf
WALLED = PLANAR.replace(name="walled", workspace=((-0.3, 0.3), (-0.2, 0.4)))
ELASTIC = SPATIAL.replace(
    transmission=SPATIAL.transmission.replace(axial_stiffness=5e4),
    swivel_radius=0.02,
    center_of_mass=(0, 0, 0.1),
)

# --- the paper's tables -------------------------------------------------------------------------------------------


def test_robots_have_the_values_of_tables_2_4_7_and_8():
    """A1 lower left, A2 lower right, A3 top; k₂ = τ_s/ω_n (Eq. 37).

    Table 2 has no c; the 11 kg of Table 4 have 1 kg of load.
    """
    for robot, mass, stall, damping in ((PLANAR, 1, 5, 0), (SPATIAL, 10, 10, 0.01)):
        assert (robot.mass, robot.motors.stall_torque) == (mass, stall)
        assert robot.transmission == Transmission(
            pulley_radius=0.05, pulley_inertia=0.0008, damping=damping
        )
        assert robot.motors.free_speed == pytest.approx(1000 * 2 * math.pi / 60) == 1000 * RPM
        assert_allclose(robot.speed_slope, stall / 104.71975511965978, rtol=1e-15)
    root = math.sqrt(3)
    triangle = np.array([[-1, -1 / root], [1, -1 / root], [0, 2 / root]])
    assert_allclose(PLANAR.base, triangle / 2, rtol=0, atol=1e-15)  # side 1 m
    assert_array_equal(PLANAR.home, [0, 0])
    assert (SPATIAL.inertia, SPATIAL.gravity) == ((0.58, 0.58, 1.16), 9.81)
    base = 0.47 * triangle
    platform = -0.148 * triangle[[2, 1, 0]]  # P1, P2, P3
    assert_allclose(SPATIAL.base, np.pad(base[[0, 1, 1, 2, 2, 0]], [(0, 0), (0, 1)]), atol=1e-15)
    ends = np.pad(platform[[0, 0, 2, 2, 1, 1]], [(0, 0), (0, 1)])
    assert_allclose(SPATIAL.platform, ends, atol=1e-15)
    assert_array_equal(SPATIAL.home, [0, 0, 0.1, 0, 0, 0])


# --- kinds --------------------------------------------------------------------------------------------------------


def test_data_have_the_keys_of_used_options_only():
    """Hashes of plans and stored results depend on these data."""
    keys = {
        "axial_stiffness",
        "extra_length",
        "center_of_mass",
        "plane",
        "maximum_tension",
        "swivel_radius",
        "sources",
        "ranges",
        "defaults",
    }
    assert not keys & {*SPATIAL.to_dict(), *SPATIAL.to_dict()["transmission"]}


def test_workspace_is_the_box_of_the_anchors_or_the_given_one():
    corners = SPATIAL.base[:, :2]
    low, high = SPATIAL.pose_bounds
    diagonal = np.linalg.norm(np.ptp(corners, axis=0))
    assert_allclose(low, [*corners.min(axis=0), 0, -1, -1, -1], rtol=1e-15)
    assert_allclose(high, [*corners.max(axis=0), diagonal, 1, 1, 1], rtol=1e-15)
    assert_array_equal(WALLED.pose_bounds, [[-0.3, -0.2], [0.3, 0.4]])
    for anchors, home, floor in ((-3, -2, 0), (-0.5, 0.1, 0.7435), (0, 2.5, 5)):
        base = np.add(SPATIAL.base, [0, 0, anchors])
        robot = SPATIAL.replace(base_anchors=base, home_pose=(0, 0, home, 0, 0, 0))
        assert_allclose(robot.pose_bounds[:, 2], (anchors, floor), rtol=1e-4)


# --- errors -------------------------------------------------------------------------------------------------------

DRUM = {"pulley_radius": 0.05, "pulley_inertia": 8e-4}
THREE = PLANAR.base_anchors
PLATFORM = SPATIAL.platform_anchors
WIDE = ((-1.0, 1.0), (-1.0, 1.0))
# the triangles of base and platform point in one direction
UPRIGHT = -np.array(PLATFORM)[[2, 3, 0, 1, 4, 5]]
UPSIDE_DOWN = [(x, y, 2 * CAMERA.home[2] - z) for x, y, z in CAMERA.base]
"""Anchors as in a frame with z up."""
ONE_ABOVE = [*UPSIDE_DOWN[:3], (*UPSIDE_DOWN[3][:2], CAMERA.home[2] - 0.1)]


@pytest.mark.parametrize(
    ("robot", "changes", "message"),
    [
        (PLANAR, {"base_anchors": ()}, "base_anchors must be one"),
        (SPATIAL, {"inertia": (0.3, 0.1, 0.1)}, "no principal moment may exceed the sum"),
        (PLANAR, {"workspace": ((-1.0, 1.0), (1.0, -1.0))}, "workspace must have low < high"),
        (
            SPATIAL,
            {"workspace": (*WIDE, (0, 1), (-1, 1), (-1.6, 1), (-1, 1))},
            "θ must stay within",
        ),
        (PLANAR, {"base_anchors": (*THREE, THREE[1])}, "cables 2 and 4 coincide"),
        (WALLED, {"home_pose": (0.31, 0.0)}, "home_pose .* outside the workspace"),
        (PLANAR, {"base_anchors": (*THREE, (0.0, 0.0))}, "zero length at home_pose"),
        (PLANAR, {"gravity": 3.7}, "gravity does not act in a horizontal plane"),
        (
            PLANAR,
            {"base_anchors": 1000 * np.array(THREE)},
            "are 1000 m wide and .* divide millimetres by 1000",
        ),
        (
            SPATIAL,
            {"platform_anchors": 1000 * np.array(PLATFORM)},
            "reach 170.896 m .* divide millimetres by 1000",
        ),
        (
            PLANAR,
            {"transmission": {"pulley_radius": 50, "pulley_inertia": 8e-4}},
            "pulley_radius is 50 m",
        ),
        (
            SPATIAL,
            {"inertia": ((0.6, 0.1, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, 1.1))},
            "the tensor must be symmetric",
        ),
        (SPATIAL, {"inertia": (0.58, 0.58, -1.16)}, "all principal moments must be greater than 0"),
        (SPATIAL, {"plane": "vertical"}, "plane is for planar robots"),
        (PLANAR, {"swivel_radius": 0.01}, "swivel_radius is for robots in space"),
        (PLANAR, {"center_of_mass": (0.1, 0.0)}, "center_of_mass must be empty for a point mass"),
        (
            CAMERA,
            {"base_anchors": UPSIDE_DOWN},
            "anchors are below the platform .* z points down here",
        ),
        (CAMERA, {"base_anchors": ONE_ABOVE}, r"upside down they would\. z points down here"),
        (CRANE, {"center_of_mass": (1.0, 0.0, 0.0)}, "no positive tensions hold home_pose"),
        (
            SPATIAL,
            {"minimum_tension": 5.0, "maximum_tension": 5.0},
            "maximum_tension of 5 N must exceed minimum_tension, 5 N; remove it",
        ),
        (SPATIAL, {"maximum_tension": NAN}, "maximum_tension must be a finite number"),
        (PLANAR, {"motors": {"stall_torque": (5, 5), "free_speed": 9}}, "stall_torque must be"),
        (PLANAR, {"transmission": DRUM | {"damping": (0, 0, -1e-6)}}, "damping must be"),
        (
            SPATIAL,
            {"platform_anchors": UPRIGHT},
            "the cables act in 5 of 6 directions, and ψ is free; move the pose",
        ),
        (PLANAR, {"transmission": DRUM | {"stiffness": 3.0}}, "needs stiffness and motor_inertia"),
        (PLANAR, {"transmission": DRUM | {"motor_damping": 0.01}}, "has no motor_damping"),
        (
            FLEX_SPATIAL,
            {"transmission": FLEX_SPATIAL.to_dict()["transmission"] | {"axial_stiffness": 2e4}},
            "exclude each other: remove stiffness and motor_inertia",
        ),
        (SPATIAL, {"ranges": [("mass", (1.0, 2.0))]}, r"must be a table of \[low, high\]"),
        (SPATIAL, {"ranges": {"motors": (1.0, 2.0)}}, "'motors' is not a field with one number"),
        (SPATIAL, {"ranges": {"mass": (2.0, 1.0)}}, "mass: 2 is above 1; write"),
    ],
)
def test_impossible_robot_raises(robot, changes, message):
    with pytest.raises(ValueError, match=message):
        robot.replace(**changes)


def places_of_numbers(data):
    """Containers and keys of all numbers in a robot's data."""
    places = []
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        if isinstance(value, (dict, list)):
            places += places_of_numbers(value)
        elif isinstance(value, (int, float)):
            places.append((data, key))
    return places


@each_of(WALLED, UNEQUAL)
def test_every_number_of_a_robot_must_be_finite(robot):
    data = json.loads(json.dumps(robot.to_dict()))
    places = places_of_numbers(data)
    assert len(places) > 10
    for container, key in places:
        number = container[key]
        for value in (NAN, INF, None, "many"):
            container[key] = value
            with pytest.raises(ValueError, match=r"."):
                Robot.from_dict(data)
        container[key] = number


# --- data in and out ----------------------------------------------------------------------------------------------


def arrays_of(robot):
    """All arrays of a robot by name."""
    arrays = {}
    for name in dir(robot):
        with contextlib.suppress(ValueError):  # of joints that a robot lacks
            value = getattr(robot, name)
            if isinstance(value, np.ndarray) and not name.startswith("_"):
                arrays[name] = value
    return arrays


@pytest.mark.parametrize(
    "duplicate",
    [
        copy.copy,
        copy.deepcopy,
        lambda robot: pickle.loads(pickle.dumps(robot)),
        lambda robot: find_robot(json.loads(json.dumps(robot.to_dict()))),
    ],
    ids=["copy", "deepcopy", "pickle", "json"],
)
@each_of(WALLED, UNEQUAL, ELASTIC, *PLATFORMS.values())
def test_robots_and_their_copies_cannot_be_changed(robot, duplicate):
    """Policies share a robot, and a copy of an array is writable in NumPy, also after pickling.
    Defaults do not change the plant: robots that differ in them are equal."""
    limited = robot.replace(defaults=Defaults(payload_range=(0.5, 3.0)))
    copied = duplicate(limited)
    assert (copied, hash(copied)) == (robot, hash(robot))
    assert copied.defaults == limited.defaults
    expected = arrays_of(robot)
    assert len(expected) > 10
    arrays = arrays_of(copied)
    check_equal(arrays, expected)
    for value in [*arrays.values(), *expected.values()]:
        with pytest.raises(ValueError, match="read-only"):
            value *= 0.5
        with pytest.raises(ValueError, match="WRITEABLE"):
            value.flags.writeable = True
    with pytest.raises(dataclasses.FrozenInstanceError):
        copied.mass = 1.0


# --- files --------------------------------------------------------------------------------------------------------

FILE = """
name = "square"
base_anchors = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
mass = 2.0
home_pose = [0.0, 0.0]
motors = {stall_torque = 8.0, free_speed = 100.0}
transmission = {pulley_radius = 0.05, pulley_inertia = 8e-4}
[defaults]
trajectory = {name = "line-planar", duration = 0.5}
error_bounds = {position = 0.005}
payload_range = [0.5, 3.0]
"""


@pytest.fixture
def robot_file(tmp_path):
    path = tmp_path / "square.toml"
    path.write_text(FILE, encoding="utf-8")
    return path


@pytest.mark.landing
def test_defaults_of_a_robot_file_reach_environments_and_scores(robot_file):
    env = make(PLANAR_ID, robot=str(robot_file))
    env.reset(seed=0)
    task = env.task
    assert (task.robot.name, task.trajectory.duration) == ("square", 1.1)
    # The bound that the file leaves out is the usual one.
    assert task.error_bounds == ErrorBounds(position=0.005, rotation=0.01)
    result = evaluate_dlcc("fl", PLANAR_ID, robot=robot_file, resolution=1.0)
    assert (result.details.payload_max, result.details.error_bounds["position"]) == (3.0, 0.005)
    bounds = find_error_bounds({"rotation": 0.02}, task.robot)
    assert bounds == ErrorBounds(position=0.005, rotation=0.02)


def test_motion_file_of_a_robot_file_is_beside_it(robot_file):
    text = FILE.replace('{name = "line-planar", duration = 0.5}', '"own.py:motion"')
    robot_file.write_text(text, encoding="utf-8")
    assert find_robot(robot_file).defaults.trajectory == f"{robot_file.parent / 'own.py'}:motion"
    robot_file.write_text(FILE.replace("line-planar", "WAY.CSV"), encoding="utf-8")
    motion = {"name": str(robot_file.parent / "WAY.CSV"), "duration": 0.5}
    assert find_robot(robot_file).defaults.trajectory == motion


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass", "mas", "unknown key of robot 'mas'; choose one of name, .*; did you mean 'mass'?"),
        ("2.0", "", "Invalid value"),
        ("position", "postion", "did you mean 'position'?"),
        ("[0.5, 3.0]", "[3.0, 0.5]", "payload_range must be a finite number greater than 3 kg"),
    ],
)
def test_error_in_a_robot_file_names_the_file_and_the_key(robot_file, old, new, message):
    robot_file.write_text(FILE.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=f"square.toml.*{message}"):
        find_robot(robot_file)
