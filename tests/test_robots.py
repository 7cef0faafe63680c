"""The robots as data: the paper's values verbatim, and refusals of what is not physical."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from cablebot_gym.kinematics import structure_jacobian
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, ROBOTS, RPM, SPATIAL, Motors, Robot, Transmission, find_robot

NAN, INF = math.nan, math.inf

UNEQUAL = SPATIAL.replace(
    name="unequal",
    inertia=(0.9, 0.3, 0.7),
    motors=Motors(stall_torque=(8.0, 9.0, 10.0, 11.0, 12.0, 13.0), free_speed=(50.0, 60.0, 70.0, 80.0, 90.0, 100.0)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    ),
    workspace=((-0.4, 0.4), (-0.25, 0.5), (0.05, 0.8), (-0.9, 0.9), (-0.8, 0.8), (-0.7, 0.7)),
)
WALLED = PLANAR.replace(name="walled", workspace=((-0.3, 0.3), (-0.2, 0.4)))

# --- the paper's tables -------------------------------------------------------------------------------------------


def test_tables_2_and_7_exclude_a_planar_robot_with_other_values():
    assert PLANAR.mass == 1  # m, Table 2; m_n, Table 7
    assert PLANAR.transmission == Transmission(pulley_radius=0.05, pulley_inertia=0.0008, damping=0)  # r, J; no c given
    assert PLANAR.motors.stall_torque == 5  # τ_s [N·m]
    assert PLANAR.motors.free_speed == pytest.approx(1000 * 2 * math.pi / 60, rel=1e-15)  # ω_n = 1,000 rpm
    assert (PLANAR.cables, PLANAR.coordinates, PLANAR.planar) == (3, 2, True)
    sides = np.linalg.norm(PLANAR.base - np.roll(PLANAR.base, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 1.0, rtol=1e-15)  # triangle side [m]
    np.testing.assert_allclose(PLANAR.base.mean(axis=0), 0, atol=1e-15)
    half, root = 0.5, math.sqrt(3)  # A1 lower left, A2 lower right, A3 top
    expected = [[-half, -half / root], [half, -half / root], [0, 1 / root]]
    np.testing.assert_allclose(PLANAR.base, expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(PLANAR.home, [0, 0])


def test_tables_4_and_8_exclude_a_spatial_robot_with_other_values():
    a, b, root = 0.47, 0.148, math.sqrt(3)
    assert SPATIAL.mass == 10  # m_n, Table 8; Table 4's 11 has 1 kg of load
    assert SPATIAL.inertia == (0.58, 0.58, 1.16)
    assert SPATIAL.transmission == Transmission(pulley_radius=0.05, pulley_inertia=0.0008, damping=0.01)
    assert SPATIAL.motors.stall_torque == 10
    assert SPATIAL.motors.free_speed == pytest.approx(1000 * 2 * math.pi / 60, rel=1e-15)
    assert (SPATIAL.cables, SPATIAL.coordinates, SPATIAL.planar) == (6, 6, False)
    assert SPATIAL.gravity == 9.81
    base = {"A1": (-a, -a / root, 0), "A2": (a, -a / root, 0), "A3": (0, 2 * a / root, 0)}
    platform = {"P1": (0, -2 * b / root, 0), "P2": (-b, b / root, 0), "P3": (b, b / root, 0)}
    ring = ["A1P1", "A2P1", "A2P3", "A3P3", "A3P2", "A1P2"]
    np.testing.assert_allclose(SPATIAL.base, [base[cable[:2]] for cable in ring], rtol=1e-15)
    np.testing.assert_allclose(SPATIAL.platform, [platform[cable[2:]] for cable in ring], rtol=1e-15)
    np.testing.assert_array_equal(SPATIAL.home, [0, 0, 0.1, 0, 0, 0])


def test_the_stall_line_excludes_a_slope_in_rpm_or_upside_down():
    """k₂ = τ_s/ω_n (Eq. 37): at ω_n nothing is left of the stall torque."""
    assert pytest.approx(math.pi / 30) == RPM
    for robot, stall in ((PLANAR, 5.0), (SPATIAL, 10.0)):
        np.testing.assert_allclose(robot.stall_torque - robot.speed_slope * 1000 * RPM, 0, atol=1e-13)
        np.testing.assert_allclose(robot.speed_slope, stall / 104.71975511965978, rtol=1e-15)


# --- what is not physical is refused ------------------------------------------------------------------------------

THREE = PLANAR.base_anchors
SIX = SPATIAL.base_anchors


@pytest.mark.parametrize(
    ("robot", "changes", "message"),
    [
        (PLANAR, {"base_anchors": ()}, "base_anchors must hold"),
        (PLANAR, {"base_anchors": ((0.0,), (1.0,))}, "base_anchors must hold"),
        (PLANAR, {"base_anchors": (*THREE, (0.0, 0.0, 1.0))}, "base_anchors must hold"),
        (PLANAR, {"base_anchors": THREE[:1]}, "at least 2 cables, not 1; add base_anchors"),
        (PLANAR, {"platform_anchors": SPATIAL.platform_anchors}, "leave platform_anchors and inertia empty"),
        (PLANAR, {"inertia": (1.0, 1.0, 1.0)}, "leave platform_anchors and inertia empty"),
        (SPATIAL, {"base_anchors": SIX[:5]}, "must have six cables, not 5; give six base_anchors"),
        (SPATIAL, {"base_anchors": (*SIX, (0.1, 0.1, 0.0))}, "must have six cables, not 7"),
        (SPATIAL, {"platform_anchors": ()}, "platform_anchors must hold"),
        (SPATIAL, {"platform_anchors": tuple(p[:2] for p in SPATIAL.platform_anchors)}, "platform_anchors must hold"),
        (SPATIAL, {"inertia": ()}, "inertia must hold the three"),
        (SPATIAL, {"inertia": (1.0, 1.0)}, "inertia must hold the three"),
        (SPATIAL, {"home_pose": (0.0, 0.0, 0.1)}, "home_pose must hold 6 coordinates, not 3"),
        (PLANAR, {"home_pose": (0.0, 0.0, 0.1)}, "home_pose must hold 2 coordinates, not 3"),
        (PLANAR, {"workspace": ((-1.0, 1.0),)}, "workspace must hold one"),
        (PLANAR, {"workspace": ((-1.0, 1.0), (-1.0, 0.0, 1.0))}, "workspace must hold one"),
        (PLANAR, {"workspace": ((-1.0, 1.0), (1.0, -1.0))}, "workspace must be finite and have low < high"),
        (PLANAR, {"workspace": ((-1.0, 1.0), (-1.0, INF))}, "workspace must be finite and have low < high"),
        (PLANAR, {"workspace": ((-1.0, 1.0), (NAN, 1.0))}, "workspace must be finite and have low < high"),
        (SPATIAL, {"inertia": (0.1, 0.1, 0.3)}, "inertia .*: no principal moment may exceed the sum"),
        (SPATIAL, {"inertia": (0.3, 0.1, 0.1)}, "inertia .*: no principal moment may exceed the sum"),
        (SPATIAL, {"inertia": (0.5, 0.0, 0.5)}, "inertia must be greater than 0"),
        (PLANAR, {"base_anchors": (*THREE, THREE[1])}, "cables 2 and 4 coincide"),
        (
            SPATIAL,
            {
                "base_anchors": (SIX[0], *SIX[:5]),
                "platform_anchors": (SPATIAL.platform_anchors[0], *SPATIAL.platform_anchors[:5]),
            },
            "cables 1 and 2 coincide",
        ),
        (PLANAR, {"home_pose": (0.9, 0.0)}, r"home_pose .* outside the workspace \[-[\d.]+, -[\d.]+\] to \["),
        (SPATIAL, {"home_pose": (0.0, 0.0, -0.1, 0.0, 0.0, 0.0)}, "home_pose .* outside the workspace"),
        (WALLED, {"home_pose": (0.31, 0.0)}, "home_pose .* outside the workspace"),
        (PLANAR, {"base_anchors": (*THREE, (0.0, 0.0))}, "zero length at home_pose"),
    ],
)
def test_a_message_that_names_the_field_excludes_a_robot_of_the_wrong_shape(robot, changes, message):
    with pytest.raises(ValueError, match=message):
        robot.replace(**changes)


def numbered(robot, field, value):
    """The robot with the value in its field ``name`` or ``owner.name``."""
    owner, _, name = field.partition(".")
    return robot.replace(**{owner: dataclasses.replace(getattr(robot, owner), **{name: value}) if name else value})


POSITIVE = ["mass", "motors.stall_torque", "motors.free_speed", "transmission.pulley_radius"]
NOT_NEGATIVE = ["transmission.pulley_inertia", "transmission.damping", "gravity"]


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
@pytest.mark.parametrize(
    ("field", "value"),
    [(field, value) for field in POSITIVE for value in (0.0, -1.0, NAN, INF, -INF)]
    + [(field, value) for field in NOT_NEGATIVE for value in (-1e-6, NAN, INF, -INF)],
)
def test_a_message_that_names_the_field_excludes_a_number_that_is_not_physical(robot, field, value):
    with pytest.raises(ValueError, match=f"{field} must be"):
        numbered(robot, field, value)


@pytest.mark.parametrize("field", [*POSITIVE[1:], *NOT_NEGATIVE[:2]])
@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
def test_one_value_per_motor_excludes_too_few_too_many_and_a_single_bad_one(robot, field):
    values = tuple(np.linspace(0.5, 1.0, robot.cables).tolist())
    changed = numbered(robot, field, values)
    assert len(set(changed.per_motor(values).tolist())) == robot.cables
    for wrong in (values[1:], (*values, 1.0)):
        with pytest.raises(ValueError, match=f"{field} must be one number or one for each of the {robot.cables}"):
            numbered(robot, field, wrong)
    for bad in (-1.0, NAN):
        with pytest.raises(ValueError, match=f"{field} must be"):
            numbered(robot, field, (*values[1:], bad))


@pytest.mark.parametrize("field", ["base_anchors", "platform_anchors", "home_pose"])
@pytest.mark.parametrize("bad", [NAN, INF])
def test_a_message_that_names_the_field_excludes_points_that_are_not_finite(field, bad):
    value = getattr(SPATIAL, field)
    spoilt = (bad, *value[1:]) if field == "home_pose" else ((value[0][0], bad, 0.0), *value[1:])
    with pytest.raises(ValueError, match=f"{field} must be finite"):
        SPATIAL.replace(**{field: spoilt})


@pytest.mark.parametrize("field", ["mass", "gravity"])
@pytest.mark.parametrize("value", [(1.0, 2.0), (), "3"], ids=repr)
@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
def test_a_message_that_names_the_field_excludes_a_list_or_text_in_place_of_one_number(robot, field, value):
    with pytest.raises(ValueError, match=f"{field} must be"):
        robot.replace(**{field: value})


# --- the home pose ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pose", [(-0.45, 0.5), (0.4, 0.3), (0.0, -0.4)])
def test_a_refusal_excludes_a_planar_home_pose_outside_the_triangle(pose):
    with pytest.raises(ValueError, match="do not surround home_pose"):
        PLANAR.replace(home_pose=pose, workspace=((-1.0, 1.0), (-1.0, 1.0)))


def test_a_refusal_excludes_a_planar_home_pose_on_the_triangles_edge():
    """Two of the cables pull against each other there, and nothing holds against the third."""
    with pytest.raises(ValueError, match="do not surround home_pose"):
        PLANAR.replace(base_anchors=((-0.5, 0.0), (0.5, 0.0), (0.0, 1.0)), home_pose=(0.1, 0.0))


def test_a_refusal_excludes_two_cables_which_cannot_hold_a_plane():
    with pytest.raises(ValueError, match="do not surround home_pose"):
        PLANAR.replace(
            base_anchors=((-1.0, 0.0), (1.0, 0.0)), workspace=((-1.0, 1.0), (-1.0, 1.0)), home_pose=(0.2, 0.0)
        )


def test_a_refusal_excludes_a_platform_triangle_that_is_not_inverted():
    b, root = 0.148, math.sqrt(3)
    p1, p2, p3 = (-b, -b / root, 0.0), (b, -b / root, 0.0), (0.0, 2 * b / root, 0.0)
    with pytest.raises(ValueError, match="no positive tensions hold home_pose"):
        SPATIAL.replace(platform_anchors=(p1, p1, p3, p3, p2, p2))


def test_a_refusal_excludes_a_hanging_robot_turned_or_without_gravity():
    with pytest.raises(ValueError, match="no positive tensions hold home_pose"):
        SPATIAL.replace(home_pose=(0.0, 0.0, 0.1, 0.0, 0.8, 0.9))
    with pytest.raises(ValueError, match="no positive tensions hold home_pose"):
        SPATIAL.replace(gravity=0.0)
    assert PLANAR.replace(gravity=0.0).gravity == 0.0  # no effect there


# --- nothing unphysical passes ------------------------------------------------------------------------------------


def leaves(data, path=()):
    """Paths to all numbers in a robot's data."""
    if isinstance(data, dict):
        return [leaf for key, value in data.items() for leaf in leaves(value, (*path, key))]
    if isinstance(data, (list, tuple)):
        return [leaf for key, value in enumerate(data) for leaf in leaves(value, (*path, key))]
    return [] if isinstance(data, str) or data is None else [path]


def spoilt(robot, path, value):
    data = json.loads(json.dumps(robot.to_dict()))
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return data


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL, UNEQUAL, WALLED], ids=lambda robot: robot.name)
def test_every_number_of_a_robot_excludes_nan_and_infinity(robot):
    paths = leaves(robot.to_dict())
    assert len(paths) > 10
    for path in paths:
        for value in (NAN, INF, -INF, None, "many"):
            with pytest.raises(ValueError, match=r"."):
                Robot.from_dict(spoilt(robot, path, value))


def largest_common_tension(jacobian, load):
    """The largest t with −Sᵀ T = load and every T_i ≥ t; without a load, of tensions whose sum is 1."""
    cables = jacobian.shape[0]
    rows, right = np.c_[-jacobian.T, np.zeros(jacobian.shape[1])], load
    if not np.any(load):
        rows, right = np.r_[rows, [[1.0] * cables + [0.0]]], np.append(right, 1.0)
    found = linprog(
        np.append(np.zeros(cables), -1.0),
        A_eq=rows,
        b_eq=right,
        A_ub=np.c_[-np.eye(cables), np.ones(cables)],
        b_ub=np.zeros(cables),
        bounds=[(None, None)] * (cables + 1),
        method="highs",
    )
    return -found.fun if found.status == 0 else -1.0


place = st.floats(-1, 1).map(lambda value: round(value, 3))
point = st.tuples(place, place)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(point, min_size=3, max_size=5), point)
def test_a_linear_program_excludes_planar_homes_that_nothing_holds_and_refusals_of_good_ones(anchors, home):
    ends = np.array([*anchors, home])
    distances = np.linalg.norm(ends[:, None] - ends, axis=-1)[np.triu_indices(len(ends), 1)]
    assume(distances.min() > 0.01)
    jacobian = structure_jacobian(ends[:-1], np.zeros_like(ends[:-1]), home)
    least = largest_common_tension(jacobian, np.zeros(2))
    assume(abs(least) > 1e-5)  # neither on an edge, where rounding decides
    changes = {"base_anchors": tuple(anchors), "home_pose": home, "workspace": ((-1.5, 1.5), (-1.5, 1.5))}
    if least > 0 and np.linalg.matrix_rank(jacobian, tol=1e-6) == 2:
        np.testing.assert_array_equal(PLANAR.replace(**changes).home, home)
    else:
        with pytest.raises(ValueError, match="do not surround home_pose"):
            PLANAR.replace(**changes)


factor = st.floats(-0.5, 2.0).map(lambda value: round(value, 6))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(factor, min_size=8, max_size=8), st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6), st.randoms())
def test_random_spatial_robots_exclude_one_that_passes_and_is_not_physical(factors, shift, random):
    mass, gravity, stall, speed, radius, inertia, damping, moment = factors
    changes = {
        "mass": 10 * mass,
        "gravity": 9.81 * gravity,
        "motors": Motors(stall_torque=10 * stall, free_speed=100 * speed),
        "transmission": Transmission(pulley_radius=radius, pulley_inertia=inertia, damping=damping),
        "inertia": (0.58, 0.58, 1.16 * moment),
        "home_pose": tuple((np.array(shift) * [0.4, 0.4, 0.4, 0.3, 0.3, 0.3] + [0, 0, 0.3, 0, 0, 0]).tolist()),
    }
    kept = random.sample(sorted(changes), random.randint(1, 6))
    try:
        robot = SPATIAL.replace(**{key: changes[key] for key in kept})
    except ValueError:
        return
    assert min(robot.mass, robot.gravity, *robot.inertia) > 0
    assert min(robot.stall_torque.min(), robot.speed_slope.min(), robot.pulley_radius.min()) > 0
    assert min(robot.pulley_inertia.min(), robot.damping.min()) >= 0
    assert 2 * max(robot.inertia) <= sum(robot.inertia) * (1 + 1e-8)
    assert np.all(robot.home >= robot.pose_bounds[0])
    assert np.all(robot.home <= robot.pose_bounds[1])
    weight = np.array([0, 0, -robot.mass * robot.gravity, 0, 0, 0])
    assert largest_common_tension(structure_jacobian(robot.base, robot.platform, robot.home), weight) > 0


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.floats(0.05, 2), st.floats(0.05, 2), st.floats(0.1, 2), st.floats(0, 3), st.floats(0, 3))
def test_physical_values_exclude_a_check_that_refuses_too_much(mass, stall, radius, inertia, damping):
    robot = SPATIAL.replace(
        mass=10 * mass,
        motors=Motors(stall_torque=10 * stall, free_speed=1.0),
        transmission=Transmission(pulley_radius=radius, pulley_inertia=inertia, damping=damping),
    )
    np.testing.assert_array_equal(robot.damping, np.full(6, damping))
    np.testing.assert_array_equal(robot.speed_slope, np.full(6, 10 * stall))


# --- data in and out ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL, UNEQUAL, WALLED], ids=lambda robot: robot.name)
def test_a_json_round_trip_excludes_a_field_that_is_lost(robot):
    data = json.loads(json.dumps(robot.to_dict()))
    back = Robot.from_dict(data)
    assert back == robot
    assert hash(back) == hash(robot)
    assert set(data) == {field.name for field in dataclasses.fields(Robot)}
    again = json.loads(json.dumps(robot.to_dict()))
    assert data == again  # reading leaves the data as they were


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"payload": 1.0}, "unknown robot field 'payload'; the fields are .*base_anchors.*workspace"),
        ({"motors": {"stall_torque": 1.0}}, "invalid robot data.*free_speed"),
        ({"motors": {"stall_torque": 1.0, "free_speed": 1.0, "colour": 1.0}}, "invalid robot data.*colour"),
        ({"motors": 3.0}, "invalid robot data"),
        ({"transmission": {"pulley_radius": 0.05}}, "invalid robot data.*pulley_inertia"),
        ({"base_anchors": 3.0}, "base_anchors must hold"),
        ({"mass": -1.0}, "mass must be greater than 0"),
    ],
)
def test_a_message_excludes_data_that_are_no_robot(change, message):
    with pytest.raises(ValueError, match=message):
        Robot.from_dict(PLANAR.to_dict() | change)


@pytest.mark.parametrize("field", ["name", "base_anchors", "mass", "motors", "transmission", "home_pose"])
def test_a_message_that_names_the_field_excludes_data_that_lack_one(field):
    data = PLANAR.to_dict()
    del data[field]
    with pytest.raises(ValueError, match=f"needs the field '{field}'"):
        Robot.from_dict(data)


def test_replace_excludes_arrays_and_slopes_kept_from_the_robot_it_copies():
    before = [SPATIAL.base, SPATIAL.home, SPATIAL.pulley_radius, SPATIAL.speed_slope, SPATIAL.pose_bounds]
    wider = tuple((2 * x, 2 * y, z) for x, y, z in SPATIAL.base_anchors)
    changed = SPATIAL.replace(
        base_anchors=wider,
        home_pose=(0.0, 0.0, 0.2, 0.0, 0.0, 0.0),
        transmission=Transmission(pulley_radius=0.1, pulley_inertia=1e-3),
        motors=Motors(stall_torque=3.0, free_speed=2.0),
    )
    after = [changed.base, changed.home, changed.pulley_radius, changed.speed_slope, changed.pose_bounds]
    for old, new in zip(before, after, strict=True):
        assert not np.array_equal(old, new)
    np.testing.assert_array_equal(changed.speed_slope, np.full(6, 1.5))
    assert SPATIAL.base_anchors != wider


def test_replace_excludes_a_copy_that_is_not_checked():
    with pytest.raises(ValueError, match="mass must be"):
        SPATIAL.replace(mass=-1.0)
    with pytest.raises(TypeError):
        SPATIAL.replace(payload=1.0)


def test_unequal_motors_exclude_values_in_another_order():
    np.testing.assert_array_equal(UNEQUAL.pulley_radius, [0.03, 0.04, 0.05, 0.06, 0.07, 0.08])
    np.testing.assert_array_equal(UNEQUAL.pulley_inertia, [4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0])
    np.testing.assert_array_equal(UNEQUAL.damping, [0.0, 0.01, 0.02, 0.03, 0.04, 0.05])
    np.testing.assert_array_equal(UNEQUAL.stall_torque, [8, 9, 10, 11, 12, 13])
    np.testing.assert_allclose(UNEQUAL.speed_slope, [8 / 50, 9 / 60, 10 / 70, 11 / 80, 12 / 90, 13 / 100], rtol=1e-15)


@pytest.mark.parametrize(
    "name",
    ["base", "platform", "home", "pose_bounds", "pulley_radius", "pulley_inertia", "damping", "stall_torque"],
)
def test_frozen_arrays_exclude_a_robot_changed_behind_its_checks(name):
    for robot in (PLANAR, SPATIAL, UNEQUAL):
        with pytest.raises(ValueError, match="read-only"):
            getattr(robot, name)[..., 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        SPATIAL.mass = 1.0


def test_the_default_workspace_excludes_depths_above_the_base_and_the_given_one_excludes_the_default():
    diagonal = math.hypot(0.94, 3 * 0.47 / math.sqrt(3))
    low, high = SPATIAL.pose_bounds
    np.testing.assert_allclose(low, [-0.47, -0.47 / math.sqrt(3), 0, -1, -1, -1], rtol=1e-15)
    np.testing.assert_allclose(high, [0.47, 2 * 0.47 / math.sqrt(3), diagonal, 1, 1, 1], rtol=1e-15)
    np.testing.assert_array_equal(WALLED.pose_bounds, [[-0.3, -0.2], [0.3, 0.4]])


# --- finding one --------------------------------------------------------------------------------------------------


def test_find_robot_excludes_another_robot_than_the_one_asked_for():
    assert find_robot("planar") is PLANAR
    assert find_robot("spatial") is SPATIAL
    assert find_robot(UNEQUAL) is UNEQUAL
    assert find_robot(json.loads(json.dumps(UNEQUAL.to_dict()))) == UNEQUAL
    assert {name: robot.name for name, robot in ROBOTS.items()} == {name: name for name in ROBOTS}
    assert set(ROBOTS) == {"planar", "spatial", "flex-planar", "flex-spatial"}


@pytest.mark.parametrize("name", ["Planar", "", "cubical", 3])
def test_find_robots_message_excludes_an_unknown_name_without_the_choices(name):
    with pytest.raises(ValueError, match="choose one of planar, spatial, flex-planar, flex-spatial, or pass a Robot"):
        find_robot(name)


def test_parts_that_are_no_parts_are_refused_in_words():
    with pytest.raises(ValueError, match=r"transmission must be a Transmission, such as robot.transmission.replace"):
        FLEX_SPATIAL.replace(transmission={"stiffness": 30.0})
    softer = FLEX_SPATIAL.transmission.replace(stiffness=np.full(6, 2.0))
    assert FLEX_SPATIAL.replace(transmission=softer).stiffness.tolist() == [2.0] * 6
    hash(FLEX_SPATIAL.replace(transmission=softer, motors=FLEX_SPATIAL.motors.replace(stall_torque=[9.0] * 6)))
