"""Random robots of all kinds: light and heavy, weak and strong, suspended and with cables below."""

import math

import numpy as np

from cablebot_gym.robots import Motors, Robot, Transmission

KINDS = ("planar", "planar-platform", "point", "spatial")
CABLES = {"planar": (3, 8), "planar-platform": (4, 8), "point": (4, 8), "spatial": (6, 8)}
"""Least and largest number of cables by kind."""


def random_robot(seed):
    """A robot that follows from a seed; candidates whose home pose no tensions hold are rejected."""
    rng = np.random.default_rng(seed)
    for number in range(1000):
        candidate = _candidate(rng, f"random-{seed}-{number}")
        try:
            return Robot(**candidate)
        except ValueError:
            continue
    raise AssertionError(f"no robot was found for seed {seed}")


def _candidate(rng, name):
    kind = KINDS[rng.integers(len(KINDS))]
    in_plane = kind.startswith("planar")
    is_vertical = in_plane and rng.random() < 0.6
    cables = int(rng.integers(*CABLES[kind], endpoint=True))
    size = 10 ** rng.uniform(-0.3, 1.0)
    mass = 10 ** rng.uniform(-1.5, 2.0)
    radius = size * 10 ** rng.uniform(-2.0, -1.2)
    force = mass * 9.81 * 10 ** rng.uniform(-0.3, 1.5)
    values = {
        "name": name,
        "base_anchors": _anchors(rng, size, cables, in_plane, is_vertical),
        "mass": mass,
        "motors": Motors(stall_torque=force * radius, free_speed=3 * size / radius),
        "transmission": _transmission(rng, mass, force, radius),
        "minimum_tension": float(rng.choice([0.0, 0.01 * force, 1.0])),
        "cable_density": float(rng.choice([0.0, 1e-4 * mass / size])),
        "home_pose": np.zeros({"planar": 2, "point": 3, "planar-platform": 3, "spatial": 6}[kind]),
    }
    if rng.random() < 0.3:
        values["maximum_tension"] = 2.0 + force * rng.uniform(0.1, 1.0)
    if is_vertical:
        values["plane"] = "vertical"
    if kind in ("planar-platform", "spatial"):
        corners = rng.uniform(-0.1, 0.1, (cables, 2 if in_plane else 3))
        values["platform_anchors"] = size * corners
        values["inertia"] = np.full(1 if in_plane else 3, 0.02 * mass * size**2)
    return values


def _anchors(rng, size, cables, in_plane, is_vertical):
    """Anchors around the origin; half of the robots under gravity are suspended, with z or y down."""
    turn = (np.arange(cables) + rng.uniform(-0.3, 0.3, cables)) * math.tau / cables
    around = size * np.column_stack([np.cos(turn), np.sin(turn)])
    if in_plane:
        if is_vertical and rng.random() < 0.5:
            around[:, 1] = -np.abs(around[:, 1]) - 0.2 * size
        return around
    height = size * rng.uniform(-1.0, -0.4, cables)
    if rng.random() < 0.5:
        height[::2] *= -1
    return np.column_stack([around, height])


def _transmission(rng, mass, force, radius):
    values = {"pulley_radius": radius, "pulley_inertia": 0.05 * mass * radius**2}
    springs = rng.choice(["rigid", "rigid", "joint", "elastic"])
    if springs == "joint":
        values["stiffness"] = force * radius * 10 ** rng.uniform(0.0, 1.0)
        values["motor_inertia"] = values["pulley_inertia"]
    if springs == "elastic":
        values["axial_stiffness"] = force * 10 ** rng.uniform(1.5, 2.5)
        values["axial_damping"] = 0.02 * values["axial_stiffness"]
    values["damping"] = 0.02 * values["pulley_inertia"]
    return Transmission(**values)
