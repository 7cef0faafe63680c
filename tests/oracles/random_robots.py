"""Random robots of all kinds: light and heavy, weak and strong, suspended and with cables below."""

import math
from contextlib import suppress

import numpy as np

from cablebot_gym.robots import PLANAR
from oracles.platforms import CAMERA, CRANE, FLAT, HANGING, TURNING

KINDS = (PLANAR, HANGING, FLAT, TURNING, CAMERA, CRANE)


def random_robot(seed):
    """The first variant of a robot, both of which follow from a seed, that its cables hold at
    home."""
    rng = np.random.default_rng(seed)
    robot = KINDS[rng.integers(len(KINDS))]
    for _ in range(1000):
        with suppress(ValueError):  # no tensions hold its home pose
            return robot.replace(name=f"random-{seed}", **_random_values(rng, robot))


def _random_values(rng, robot):
    scale, strength, radius = 10 ** rng.uniform([-2, -0.3, -2], [1, 1.5, -1])
    mass = scale * robot.mass
    force = 9.81 * mass * strength
    cables = int(rng.integers(max(3, robot.coordinates + robot.weightless), 9))
    chosen = rng.integers(robot.cables, size=cables)
    noise = rng.uniform(-0.3, 0.3, (cables, robot.dimensions))
    base = robot.base[chosen] + noise * np.ptp(robot.base, axis=0).max()
    if rng.random() < 0.5:  # every second cable to the other side of the platform
        base[::2, -1] = 2 * robot.home[robot.dimensions - 1] - base[::2, -1]
    inertia = 0.05 * mass * radius**2
    springs = [
        {},
        {"stiffness": 3 * force * radius, "motor_inertia": inertia},
        {"axial_stiffness": 100 * force, "axial_damping": force},
    ]
    values = {
        "base_anchors": base,
        "mass": mass,
        "motors": {"stall_torque": force * radius, "free_speed": 5 / radius},
        "transmission": {"pulley_radius": radius, "pulley_inertia": inertia} | rng.choice(springs),
        "minimum_tension": rng.choice([0, 1, 0.01 * force]),
        "maximum_tension": rng.choice([math.inf, 2 + 0.3 * force]),
        "cable_density": 1e-5 * mass,
    }
    if not robot.point_mass:
        values["platform_anchors"] = robot.platform[chosen] + 0.3 * noise
        values["inertia"] = np.multiply(scale, robot.inertia)
    return values
