"""Checks of sizes, inertia and equilibrium, as functions of numbers and arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.robots.parts import COORDINATE_NAMES, Kind
from cablebot_gym.utils.checks import numbers

LARGEST_SIZE = 3000.0
"""Largest ratio of the width of the base to a pulley radius. It is 20 for the paper's robots and
220 for CoGiRo."""

LARGEST_PULLEY = 5.0
"""Largest radius of a pulley [m]."""

LARGEST_REACH = 50.0
"""Largest ratio of the platform anchors' distance from the centre of mass to the radius of
gyration, which is near one for a rigid body with anchors at its surface."""

_METRES = "lengths are in metres: divide millimetres by 1000"

_SMALLEST_TENSION = 1e-9
"""Tension above which a cable counts as taut, as a fraction of the weight or of 1 N."""


def check_widths(base: Array, pulley_radius: Array, swivel_radius: Any) -> None:
    """Checks that base anchors and pulleys are not in millimetres: the limits are far beyond every
    cable robot that was built."""
    size = float(np.max(np.ptp(base, axis=0)))
    radius = float(pulley_radius.min())
    if size > LARGEST_SIZE * radius:
        raise ValueError(
            f"base_anchors are {size:g} m wide and pulley_radius is {radius:g} m; {_METRES}"
        )
    for name, radii in (("pulley_radius", pulley_radius), ("swivel_radius", swivel_radius)):
        largest = np.max(radii)
        if largest > LARGEST_PULLEY:
            raise ValueError(f"{name} is {largest:g} m; {_METRES}")


def check_reach(reach: float, gyration: float) -> None:
    """Checks that the platform anchors are not in millimetres.

    Args:
        reach: largest distance of a platform anchor from the centre of mass [m].
        gyration: largest radius of gyration [m].
    """
    if reach > LARGEST_REACH * gyration:
        raise ValueError(
            f"platform_anchors reach {reach:g} m from the centre of mass, and the radius of gyration is "
            f"{gyration:.3g} m; {_METRES}"
        )


def check_ranges(ranges: Any, fields: Mapping[str, Any]) -> None:
    """Checks the ranges of values that are not known exactly.

    Args:
        ranges: the table of a robot.
        fields: values by the names that it may have.
    """
    if not isinstance(ranges, Mapping):
        raise ValueError(
            f"ranges must be a table of [low, high] by the name of the field, not {ranges!r}"
        )
    for name, ends in ranges.items():
        if not isinstance(fields.get(name), int | float | tuple):
            raise ValueError(
                f"ranges: {name!r} is not a field with one number; such fields are 'mass' and "
                "'motors.stall_torque'"
            )
        low, high = numbers(f"ranges: {name}", ends, shapes=[(2,)], form="[low, high]")
        if low > high:
            raise ValueError(f"ranges: {name}: {low:g} is above {high:g}; write [low, high]")


def check_inertia(inertia: tuple[Any, ...], tensor: Array) -> None:
    """Checks that a rigid body can have this tensor, shape (3, 3), given as ``inertia``."""
    if not np.allclose(tensor, tensor.T, rtol=1e-9, atol=0):
        raise ValueError("inertia: the tensor must be symmetric")
    moments = np.linalg.eigvalsh(tensor)
    if moments.min() <= 0:
        raise ValueError(f"inertia {inertia}: all principal moments must be greater than 0")
    # A thin plate has moments with equality, up to rounding.
    if 2 * moments.max() > moments.sum() + 1e-9 * moments.max():
        raise ValueError(
            f"inertia {inertia}: no principal moment may exceed the sum of the other two; products of "
            "inertia have the sign of the tensor, I_xy = −∫xy dm"
        )


def check_cables_differ(base: Array, platform: Array) -> None:
    """Checks that no two cables have the same anchors."""
    ends = np.concatenate([base, platform], axis=1)
    for i, j in combinations(range(len(ends)), 2):
        if np.allclose(ends[i], ends[j], rtol=0, atol=1e-9):
            raise ValueError(f"cables {i + 1} and {j + 1} coincide; give them different anchors")


def free_coordinate(kind: Kind, jacobian: Array) -> str:
    """Coordinate with the largest component in the direction that no cable resists."""
    direction = np.linalg.svd(jacobian)[2][-1]
    return COORDINATE_NAMES[kind][int(np.argmax(np.abs(direction)))]


def is_surrounded(jacobian: Array) -> bool:
    """Whether cables surround a point in a plane: no open half plane is free of them."""
    angles = np.sort(np.arctan2(jacobian[:, 1], jacobian[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + 2 * math.pi))
    # Two opposite cables leave a gap of exactly π, up to rounding.
    return bool(gaps.max() < math.pi - 1e-9)


def is_balanced(jacobian: Array, wrench: Array) -> bool:
    """Whether positive tensions T give ``Sᵀ T = wrench``, for S of shape (m, n)."""
    cables, coordinates = jacobian.shape
    if cables == coordinates:  # the tensions are unique
        return bool(np.linalg.solve(jacobian.T, wrench).min() > _SMALLEST_TENSION)
    from scipy.optimize import linprog  # slow to import

    # The largest t ≤ 1 with T_i ≥ t: positive if and only if positive tensions balance the weight.
    scale = max(float(np.abs(wrench).max()), 1.0)
    solution = linprog(
        [0.0] * cables + [-1.0],
        A_ub=np.column_stack([-np.eye(cables), np.ones(cables)]),
        b_ub=np.zeros(cables),
        A_eq=np.column_stack([jacobian.T, np.zeros(coordinates)]),
        b_eq=wrench / scale,
        bounds=[(0, None)] * cables + [(None, 1.0)],
    )
    return bool(solution.success) and -float(solution.fun or 0.0) > _SMALLEST_TENSION
