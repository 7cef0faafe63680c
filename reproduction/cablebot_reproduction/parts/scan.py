"""Number of geometries that give the published payloads."""

from __future__ import annotations

from itertools import product

import numpy as np

from cablebot_gym.bounds import exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_reproduction.exact import COARSE, exact_limit
from cablebot_reproduction.outcome import Outcome
from cablebot_reproduction.robots import paper_circle
from cablebot_reproduction.texts import PUBLISHED

ROUNDING = 0.06
"""Maximum difference from the published payload that counts as a match [kg]."""

SIZES = {
    "half side": 1.0,
    "circumradius": np.sqrt(3) / 2,
    "inradius": np.sqrt(3),
    "half altitude": 2 / np.sqrt(3),
}
"""Possible meanings of "half of the triangle", with the resulting size of the triangle relative to
the first."""

BASE_TURNS = np.radians(np.arange(0, 120, 10))
"""Rotations of the base triangle about z [rad]. Larger angles give the same shapes with other motor
numbers."""

PLATFORM_TURNS = np.radians(np.arange(-60, 60, 5))
"""Rotations of the platform triangle relative to the inverted base triangle [rad]."""

PLANAR_TURNS = np.radians(np.arange(0, 121, 2))
"""Rotations of the planar triangle [rad]. Larger angles give the same triangles with other motor
numbers."""


def geometries() -> list[tuple[float, int]]:
    """Largest payload of exact tracking [kg] and limiting motor of all spatial geometries.

    The payload is -inf if the platform alone does not keep all cables taut. Geometries without
    equilibrium in the home pose are omitted.
    """
    results = []
    trajectory = paper_circle(SPATIAL)
    sizes = list(SIZES.values())
    for base, platform, base_turn, turn in product(sizes, sizes, BASE_TURNS, PLATFORM_TURNS):
        try:
            robot = SPATIAL.replace(
                base_anchors=base * _turned(SPATIAL.base, base_turn),
                platform_anchors=platform * _turned(SPATIAL.platform, base_turn + turn),
            )
        except ValueError:
            continue
        limit = exact_payload(robot, trajectory, grid=COARSE)
        payload = -np.inf
        if limit.lowest <= 0:
            payload = limit.payload
        results.append((payload, limit.motor or 0))
    return results


def _turned(points: Array, angle: float) -> Array:
    """Points rotated about z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


def scan() -> Outcome:
    """Counts of geometries, and extreme payloads."""
    found = geometries()
    payload, motor = np.array(found).T
    positive = payload[payload > 0]
    is_hit = np.abs(payload - PUBLISHED["spatial_payload_kg"]) <= ROUNDING
    planar = []
    for turn in PLANAR_TURNS:
        robot = PLANAR.replace(base_anchors=_turned(PLANAR.base, turn))
        planar.append(exact_limit(robot).payload)
    return Outcome(
        numbers={
            "geometries": len(SIZES) ** 2 * len(BASE_TURNS) * len(PLATFORM_TURNS),
            "with_equilibrium": len(found),
            "with_positive_payload": len(positive),
            "hits": is_hit.sum(),
            "hits_second_motor": (is_hit & (motor == 2)).sum(),
            "least_kg": positive.min(),
            "largest_kg": positive.max(),
            "planar_best_added_kg": max(planar),
            "planar_best_turn_deg": np.degrees(PLANAR_TURNS[np.argmax(planar)]),
        }
    )
