"""Robots of every kind of platform, with anchors and inertias that share no symmetry."""

import numpy as np

from cablebot_gym.robots import Motors, Robot, Transmission

DRIVE = {
    "motors": Motors(stall_torque=60.0, free_speed=100.0),
    "transmission": Transmission(pulley_radius=0.05, pulley_inertia=4e-3, damping=0.02),
}


def _rectangle(x, y):
    return np.array([(-x, -y), (x, -y), (x, y), (-x, y)])


CAMERA = Robot(
    name="camera",
    base_anchors=[(-5.0, -3.0, 0.0), (5.2, -3.1, 0.1), (4.9, 3.0, -0.1), (-5.1, 3.2, 0.05)],
    mass=12.0,
    home_pose=(0.3, -0.2, 3.0),
    workspace=((-4.0, 9.5), (-2.5, 2.5), (1.0, 5.0)),
    **DRIVE,
)
"""Suspended point mass with four cables."""

TURNING = Robot(
    name="turning",
    base_anchors=[*_rectangle(1.5, 1.2), (0.1, -1.4)],
    platform_anchors=[*_rectangle(-0.2, 0.1), (0.02, 0.03)],
    mass=3.0,
    inertia=(0.05,),
    center_of_mass=(0.03, -0.02),
    plane="vertical",
    home_pose=(0.1, 0.0, 0.05),
    workspace=((-1.0, 1.0), (-0.8, 0.8), (-0.6, 0.6)),
    **DRIVE,
)
"""Platform in a vertical plane with five cables."""

FLAT = TURNING.replace(name="flat", plane="horizontal", center_of_mass=())
"""Platform in a horizontal plane."""

HANGING = Robot(
    name="hanging",
    base_anchors=[(-1.0, 0.0), (1.2, 0.1)],
    mass=5.0,
    plane="vertical",
    home_pose=(0.1, 1.0),
    **DRIVE,
)
"""Point mass in a vertical plane with two cables."""

_UPPER = np.array(
    [
        (-3.5, -2.7),
        (-3.6, -2.5),
        (-3.6, 2.6),
        (-3.4, 2.8),
        (3.6, 2.7),
        (3.7, 2.5),
        (3.7, -2.6),
        (3.5, -2.8),
    ]
)
_LOWER = [(0.5, -0.49, 0.0), (-0.5, 0.35, -1.0), (-0.5, -0.27, 0.0), (0.49, 0.35, -1.0)]

CRANE = Robot(
    name="crane",
    base_anchors=np.column_stack([_UPPER, [-0.01, 0.02, 0.0, 0.03, 0.0, 0.01, -0.02, 0.0]]),
    platform_anchors=[*_LOWER, *((-x, -y, z) for x, y, z in _LOWER)],
    mass=91.0,
    inertia=((36.6, -0.45, 3.0), (-0.45, 36.0, -1.5), (3.0, -1.5, 25.4)),
    center_of_mass=(-0.034, -0.013, -0.264),
    home_pose=(0.2, 0.1, 4.0, 0.02, -0.03, 0.05),
    **DRIVE,
)
"""Suspended platform with eight cables, a tilted inertia and a centre of mass above the origin."""

SWIVELLED = CRANE.replace(name="swivelled", swivel_radius=0.05)
PLATFORMS = {robot.name: robot for robot in (HANGING, FLAT, TURNING, CAMERA, CRANE)}
"""The robots by name."""
