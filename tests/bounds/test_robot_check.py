"""Checks of a robot: payload along the motion, workspace, modes, sag, and cables that touch."""

import math

import numpy as np
import pytest
from oracles.plants import each_of, with_transmission
from oracles.platforms import SWIVELLED

from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.bounds.robot_check import check_model, check_motion, modes
from cablebot_gym.envs.settings import make_settings
from cablebot_gym.kinematics import segment_distance
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.statics import hold_payload, holds
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot, find_robot
from cablebot_gym.task import ErrorBounds

CAMERA = find_robot("stadium-camera")


@each_of(PLANAR, SPATIAL)
def test_payload_limit_is_the_closed_form(robot):
    motion = f"smooth-circle-{robot.kind}"
    exact = exact_payload(robot, find_trajectory(motion, robot.kind), minimum_tension=1.0)
    check = check_motion(robot, trajectory=motion)
    # which looks at more instants
    assert exact.payload <= check.limit.largest <= 1.005 * exact.payload
    assert f"cable {exact.motor} at the torque limit" in check.limit.reason


def test_payload_is_held_up_to_the_limit():
    limit = check_motion(CAMERA).limit
    assert [check_motion(CAMERA, payload=limit.largest + side).held for side in (-0.01, 0.01)] == [
        True,
        False,
    ]
    assert "2, 3 at the torque limit" in limit.reason
    pose = np.array([[*limit.pose]])
    assert [bool(holds(CAMERA, pose, payload)[0]) for payload in (limit.largest, 200.0)] == [
        True,
        False,
    ]


def test_slow_motion_carries_the_platform_alone():
    """Rounding asked for a payload of 26 kg or 1e-7 kg, and times in ms passed."""
    for name, duration in (("lemniscate-planar", 30.0), ("line-planar", 900.0)):
        motion = {"name": name, "duration": duration}
        assert check_motion(PLANAR, trajectory=motion).limit.least == 0
    with pytest.raises(ValueError, match=r"lasts 900001 s: .* Is it in ms\? Then divide"):
        check_motion(PLANAR, trajectory=motion | {"duration": 9e5, "dwell": 0.5})


BIFILAR = Robot(
    name="bar on two cables in a plane",
    base_anchors=((-1.0, 0.0), (1.0, 0.0)),
    platform_anchors=((-0.5, 0.0), (0.5, 0.0)),
    plane="vertical",
    mass=4.0,
    inertia=(0.5,),
    center_of_mass=(0.0, 0.1),
    home_pose=(0.0, 1.0, 0.0),
    motors=CAMERA.motors,
    transmission=CAMERA.transmission,
)


@pytest.mark.parametrize(
    ("robot", "keywords", "message"),
    [
        (BIFILAR, {}, "needs at least 3 cables, not 2"),
        (SWIVELLED.replace(swivel_axes=[(0, 0.1, -1)] * 8), {}, "vertical axes only"),
        (with_transmission(CAMERA, load_friction=0.1), {"cable": "bilateral"}, "only pull"),
    ],
)
def test_unsupported_robots_are_refused_by_simulation_and_check(robot, keywords, message):
    with pytest.raises(ValueError, match=message):
        make_settings(robot=robot, count=1, **keywords)
    if not keywords:
        with pytest.raises(ValueError, match=message):
            check_model(robot)


def test_maximum_tension_limits_the_payload_at_rest():
    home = check_model(CAMERA.replace(maximum_tension=200.0)).home
    weight = CAMERA.cables * 200.0 * 18.0 / math.hypot(18.0, 60.0, 40.0)
    assert home.largest == pytest.approx(weight / CAMERA.gravity - CAMERA.mass, rel=1e-6)
    assert home.reason.endswith("at the maximum tension of 200 N")


def test_ceiling_is_the_payload_at_rest_for_the_maximum_tension():
    """At the start pose, half the position bound lower, where the cables are steeper."""
    robot = SPATIAL.replace(maximum_tension=100.0)
    check = check_motion(robot, trajectory="dwell-spatial", payload=9.0)
    rise = 0.105 / math.hypot(0.105, 0.47, (2 * 0.148 - 0.47) / math.sqrt(3))
    assert check.ceiling == pytest.approx(600 * rise / robot.gravity - robot.mass, rel=1e-6)
    assert not check.possible
    assert check_motion(SPATIAL, trajectory="dwell-spatial", payload=9.0).possible


@each_of(SPATIAL, FLEX_SPATIAL)
def test_stall_torque_holds_the_payload_at_the_start(robot):
    """At the start pose, half the position bound lower."""
    motion = find_trajectory("circle-spatial", 6)
    bounds = ErrorBounds(position=0.02)
    payload = hold_payload(robot, motion, bounds)
    lowered = motion(0.0).position + 0.01 * np.eye(6)[2]
    torque = textbook.static_torque(robot, robot.mass + payload, lowered)
    assert (torque / robot.stall_torque).max() == pytest.approx(1.0, abs=1e-12)
    assert payload > hold_payload(robot, motion, ErrorBounds(position=0.01)) + 0.5


@pytest.mark.parametrize(
    ("robot", "motion"), [(SPATIAL, "paper-spatial"), (FLEX_PLANAR, "circle-planar")]
)
def test_hold_payload_is_unlimited_for_a_weightless_robot_or_one_that_keeps_moving(robot, motion):
    trajectory = find_trajectory(motion, robot.kind)
    assert hold_payload(robot, trajectory, ErrorBounds()) == math.inf


def test_infeasible_motion_names_the_cause():
    """Near the mast, the other cables cannot have their minimum tension."""
    tight = CAMERA.replace(minimum_tension=900.0)
    check = check_motion(tight)
    assert not check.held
    assert check.limit.largest == -math.inf
    assert check.cables == ()
    assert "at the minimum tension of 900 N" in check.limit.reason


@pytest.mark.parametrize(
    ("payload", "density", "tolerance"),
    [(0.0, 0.0, 1e-9), (20.0, 0.0, 1e-9), (0.0, 0.012, 3e-4)],
    ids=["unloaded", "loaded", "sagging"],
)
def test_softest_mode_of_a_camera_is_a_mass_on_springs(payload, density, tolerance):
    """Up and down, all cables stretch and turn alike: k = Σ EA/l (h/q)² + T/q (1 − (h/q)²). Sag
    adds q λ²/12 to the length that stretches (Irvine)."""
    robot = find_robot("flex-stadium-camera").replace(cable_density=density)
    mass = 14 + payload
    height = 18.0
    length = math.hypot(60, 40, height)
    steepness = height / length
    tension = mass * robot.gravity / (4 * steepness)
    free_length = (length + 30) / (1 + tension / 320e3)
    bending = (density * robot.gravity * math.hypot(60, 40) / tension) ** 2
    free_length *= 1 + bending * 320e3 / tension / 12 * length / (length + 30)
    stiffness = 4 * 320e3 / free_length * steepness**2 + 4 * tension / length * (1 - steepness**2)
    softest = modes(robot, payload)[0]
    assert softest.locked
    assert softest.direction == "z"
    assert 2 * math.pi * softest.frequency == pytest.approx(
        math.sqrt(stiffness / mass), rel=tolerance
    )
    assert modes(CAMERA) == []


def test_crossing_cables_are_questioned():
    platform = find_robot("ttk4900")
    swapped = platform.replace(platform_anchors=platform.platform[[1, 0, 2, 3]])
    texts = check_motion(swapped).questions
    assert any(
        text.startswith("cables 1 and 2 come within 0 mm at home_pose: do they touch")
        for text in texts
    )


def test_segment_distance_is_the_least_over_points():
    generator = np.random.default_rng(0)
    ends = generator.normal(size=(4, 50, 3))
    steps = np.linspace(0, 1, 201)[:, None, None]
    points_of_one, points_of_two = (a + steps * (b - a) for a, b in (ends[:2], ends[2:]))
    brute = np.linalg.norm(points_of_one[:, None] - points_of_two[None], axis=-1).min(axis=(0, 1))
    distances = segment_distance(*ends)
    assert np.all(distances <= brute + 1e-12)
    np.testing.assert_allclose(distances, brute, atol=2e-2)
