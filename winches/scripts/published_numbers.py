"""Tables of the page winches/docs/reality.md: published numbers of real robots beside those of the model,
and what friction and the stiffness of tensions change."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cablebot_gym.benchmark.tables import markdown_table
from cablebot_gym.bounds.robot_check import check_motion, modes, two_digits
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.robots import ELASTIC, find_robot, library

FOCAL_RADIUS = 160.0
"""Radius of FAST's focal surface about the centre of the reflector's sphere [m]."""

FOCAL_DISTANCE = 103.0
"""Largest horizontal distance of the focus cabin from the middle, of a surface 206 m wide [m]."""

SPHERE_CENTER = -300.0
"""z of the centre of the reflector's sphere [m], which points down."""

CABIN_TILT = math.radians(14.0)
"""Published largest tilt of the focus cabin by the cables, doi 10.1155/2014/209167 [rad]."""

CAMERA_SPEED = 13.0
"""Published largest speed of Skycam [m/s]."""


def table() -> str:
    """The published numbers in Markdown."""
    head = ["robot", "quantity", "published", "model", "source"]
    return f"\n{markdown_table([head, *_rows()])}\n"


def effects_table() -> str:
    """Payloads of exact tracking without friction and with it, and the softest mode of the robot
    with elastic cables without the stiffness of tensions, weight and sag and with it, in
    Markdown."""
    head = ["robot", "payload [kg]", "without friction", "half payload [kg]", "softest mode [Hz]"]
    head.append("without tensions and sag")
    return f"\n{markdown_table([head, *map(_effects, library())], right=5)}\n"


def _effects(name: str) -> Sequence[str]:
    """Row of a robot of the library."""
    robot = find_robot(name)
    frictionless = robot.transmission.replace(coulomb_friction=0, load_friction=0, damping=0)
    payload = check_motion(robot).limit.largest
    without_friction = check_motion(robot.replace(transmission=frictionless)).limit.largest
    elastic = find_robot(ELASTIC + name)
    half = float(f"{check_motion(elastic).limit.largest / 2:.2g}")
    softest = modes(elastic, half)[0].frequency
    frequencies, _ = textbook.locked_modes(elastic, elastic.mass + half, elastic.home_pose, None)
    return (
        f"`{name}`",
        _three_digits(payload),
        _three_digits(without_friction),
        f"{half:g}",
        _three_digits(softest),
        _three_digits(frequencies[0]),
    )


def _three_digits(value: float) -> str:
    return f"{float(f'{value:.3g}'):g}"


def _rows() -> Iterator[Sequence[str]]:
    yield (
        "`cogiro`",
        "payload with 5 kN in a cable, along the default motion",
        "500 kg",
        f"{two_digits(check_motion(find_robot('cogiro')).limit.largest)} kg",
        "CoGiRo_description.pdf",
    )
    yield from _focus_cabin_rows()
    softest = modes(find_robot("flex-fast"))[0].frequency
    yield (
        "`flex-fast`",
        "lowest natural frequency",
        "0.12 to 0.2 Hz",
        f"{softest:.2g} Hz at the home pose",
        "Universe 2024 10 450",
    )
    yield (
        "`stadium-camera`",
        "payload at the largest speed, on the default line",
        f"a camera, at {CAMERA_SPEED:g} m/s",
        f"{two_digits(_payload_at_speed())} kg",
        "Wikipedia, Skycam",
    )


def _focus_cabin_rows() -> Iterator[Sequence[str]]:
    """FAST's cabin on its focal surface."""
    full_tilt = math.asin(FOCAL_DISTANCE / FOCAL_RADIUS)
    cases = (
        ("normal to the focal surface", 1.0, "not everywhere", "Williams, FAST.pdf, 2015"),
        ("horizontal", 0.0, "–", "–"),
        (
            f"tilted by up to {math.degrees(CABIN_TILT):.0f}° at the edge",
            CABIN_TILT / full_tilt,
            "the tilt",
            "doi 10.1155/2014/209167",
        ),
    )
    for orientation, fraction, published, source in cases:
        tensions = focal_tensions(fraction)
        held = np.mean(tensions.min(axis=1) > 0)
        text = f"{held:.0%} of the surface"
        if held == 1:
            low, high = 1e-3 * tensions.min(), 1e-3 * tensions.max()
            text += f", with {low:.0f} to {high:.0f} kN"
        yield "`fast`", f"all cables taut, cabin {orientation}", published, text, source


def focal_tensions(fraction: float, points: int = 600) -> Array:
    """Tensions of FAST's cables without payload on its focal surface, (points, 6) [N].

    Args:
        fraction: tilt of the cabin, as a fraction of that of the normal of the surface.
        points: number of points, which are spread evenly over the surface seen from above.
    """
    robot = find_robot("fast")
    # Fermat's spiral, turned by the golden angle
    index = np.arange(points) + 0.5
    distance = FOCAL_DISTANCE * np.sqrt(index / points)
    azimuth = math.pi * (3 - math.sqrt(5)) * index
    normal_tilt = np.arcsin(distance / FOCAL_RADIUS)
    poses = np.zeros((points, 6))
    poses[:, 0] = distance * np.cos(azimuth)
    poses[:, 1] = distance * np.sin(azimuth)
    poses[:, 2] = SPHERE_CENTER + FOCAL_RADIUS * np.cos(normal_tilt)
    axes = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(points)], axis=1)
    rotation = Rotation.from_rotvec(fraction * normal_tilt[:, None] * axes)
    poses[:, 3:] = rotation.as_euler("ZYX")[:, ::-1]
    structure = textbook.jacobian(robot, poses)
    weight = textbook.bias(robot, robot.mass, poses, np.zeros_like(poses))
    return np.linalg.solve(-np.swapaxes(structure, -1, -2), weight[..., None])[..., 0]


def _payload_at_speed() -> float:
    """Payload of exact tracking when the default motion of the cable camera has its published
    speed [kg]."""
    robot = find_robot("stadium-camera")
    motion = check_motion(robot).trajectory
    times = np.linspace(0, motion.duration, 1001)
    speed = np.max(np.linalg.norm(motion(times).velocity, axis=1))
    data = robot.defaults.trajectory
    assert isinstance(data, dict)
    faster = data | {"duration": data["duration"] * speed / CAMERA_SPEED}
    return check_motion(robot, trajectory=find_trajectory(faster, robot.kind)).limit.largest
