"""Questions about values in a wrong unit."""

import numpy as np
import pytest
from oracles.plants import each_of

from cablebot_gym.bounds.doubts import doubtful_values
from cablebot_gym.robots import (
    FLEX_SPATIAL,
    PLANAR,
    SPATIAL,
    Defaults,
    Motors,
    Robot,
    Transmission,
    find_robot,
    robot_names,
)

CAMERA = find_robot("flex-stadium-camera")
COGIRO = find_robot("flex-cogiro")

HANGING = Robot(
    name="hanging",
    base_anchors=((-2.0, -1.0, -3.0), (2.0, -1.0, -3.0), (2.0, 1.5, -3.0), (-2.0, 1.5, -3.0)),
    mass=4.0,
    motors=Motors(stall_torque=8.0, free_speed=30.0),
    transmission=Transmission(
        pulley_radius=0.04,
        pulley_inertia=5e-4,
        axial_stiffness=2e4,
    ),
    home_pose=(0.0, 0.0, -1.0),
)
"""A point mass on four cables, of the size of a laboratory."""


def changed(robot, name, value):
    """The robot with one field replaced; a text multiplies it."""
    group, _, field = name.rpartition(".")
    owner = getattr(robot, group) if group else robot
    if isinstance(value, str):
        value = np.multiply(getattr(owner, field), float(value[1:])).tolist()
    new = owner.replace(**{field: value})
    return robot.replace(**{group: new}) if group else new


@pytest.mark.parametrize(
    ("robot", "field", "value", "question"),
    [
        # rpm
        (
            HANGING,
            "motors.free_speed",
            300.0,
            "12 m/s at the cable of a robot of 4 m: is it in rad/s",
        ),
        (CAMERA, "motors.stall_torque", "×1000", "over 100 times the weight"),  # N·mm
        (HANGING, "mass", "×1000", "and mass in kg"),  # g
        (SPATIAL, "inertia", "×1e4", "is inertia in kg·m²"),  # kg·cm²
        (SPATIAL, "transmission.pulley_inertia", "×1e4", "is transmission.pulley_inertia in kg·m²"),
        (
            FLEX_SPATIAL,
            "transmission.motor_inertia",
            "×1e4",
            "is transmission.motor_inertia in kg·m²",
        ),
        (COGIRO, "transmission.damping", "×1000", "is it in N·m·s/rad"),
        (COGIRO, "transmission.coulomb_friction", "×1000", "are both in N·m at the pulley"),
        (HANGING, "motors.lag", 2.0, "is it in s? 1 ms"),
        (CAMERA, "minimum_tension", "×1000", "times the largest tension"),  # mN
        (CAMERA, "maximum_tension", 2e6, "of the strongest motor: is it in N"),  # mN
        (PLANAR, "transmission.pulley_radius", "×100", "are both in m"),  # cm
        (PLANAR, "base_anchors", "×100", "are both in m"),
        (CAMERA, "cable_density", "×1000", "1 g/m is"),
        (CAMERA, "gravity", 9810.0, "is it in m/s²"),
        # degrees
        (
            find_robot("ttk4900"),
            "workspace",
            ((-0.5, 0.5), (-0.25, 0.25), (-17.0, 17.0)),
            "exceed 2π",
        ),
        (FLEX_SPATIAL, "transmission.stiffness", 3 / 57.3, "Multiply a stiffness per degree"),
        # N/m
        (
            HANGING,
            "transmission.axial_stiffness",
            5000.0,
            "the stall torque stretches a cable by 4.0%",
        ),
        # kN
        (HANGING, "transmission.axial_stiffness", 20.0, "the platform alone stretches a cable by"),
        (HANGING, "transmission.axial_stiffness", 2e10, "the platform alone stretches a cable by"),
        (CAMERA, "workspace", ((-400, 400), (-25, 25), (-22, -2)), "wider than the base anchors"),
        (CAMERA, "transmission.extra_length", "×1000", "transmission.extra_length is"),
        # mm
        (
            HANGING,
            "defaults",
            Defaults(error_bounds={"position": 10.0}),
            "a bound of 10 mm is 0.01",
        ),
        (HANGING, "defaults", Defaults(error_bounds={"position": 1.0}), "is it in m?"),
        (SPATIAL, "defaults", Defaults(error_bounds={"rotation": 0.5}), "1 degree is"),
        (HANGING, "defaults", Defaults(payload_range=(0.0, 40000.0)), "is it in kg"),  # g
    ],
)
def test_value_in_a_wrong_unit_is_questioned(robot, field, value, question):
    questions = list(doubtful_values(changed(robot, field, value)))
    assert any(question in text for text in questions), questions


@each_of(HANGING, *map(find_robot, robot_names()))
def test_plausible_robots_pass_all_checks(robot):
    assert list(doubtful_values(robot)) == []


def test_frame_with_the_origin_on_the_floor_is_questioned():
    """Eight cables hold a platform in both directions: nothing else shows that z points up in the
    file."""
    corners = np.array(
        [(x, y, z) for z in (0.0, 3.0) for x, y in ((-2, -2), (2, -2), (2, 2), (-2, 2))]
    )
    # Each cable runs to the next corner, in alternating senses: they resist a turn.
    ends = corners[:, [1, 0, 2]] * [-0.1, 0.1, -1 / 15] + [0, 0, 0.1]
    ends[1::2, :2] *= -1
    box = HANGING.replace(
        name="box",
        base_anchors=corners,
        platform_anchors=ends,
        inertia=(0.1, 0.1, 0.1),
        home_pose=(0.0, 0.0, 1.5, 0.0, 0.0, 0.0),
    )
    assert any("z points down here" in question for question in doubtful_values(box))
    centered = box.replace(base_anchors=corners - [0, 0, 3], home_pose=(0, 0, -1.5, 0, 0, 0))
    assert not any("z points" in question for question in doubtful_values(centered))
