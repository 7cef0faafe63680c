"""Waypoints of a motion that users bring as a CSV file: times in s, lengths in m, angles in rad, z
down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.utils.csv_table import Table, column_name, read_table

Array = NDArray[np.float64]

SUFFIX = ".csv"
"""Suffix of files with waypoints, in small or capital letters."""

LONGEST_LENGTH = 1000.0
"""Largest coordinate of a position [m]. The largest cable robot is 600 m wide, so a larger one was
meant in mm."""


def is_waypoint_file(name: object) -> bool:
    """Whether the name of a motion is that of a file with waypoints."""
    return isinstance(name, str) and name.lower().endswith(SUFFIX)


def read_waypoints(path: Path, kinds: Sequence[str]) -> tuple[Array | None, Array]:
    """Times and poses of the waypoints in a CSV file, see
    :func:`~cablebot_gym.utils.csv_table.read_table`.

    Args:
        path: the file.
        kinds: symbols of the coordinates, such as ``xyφ``, for each kind of robot that fits.

    Returns:
        Times from 0 on, shape (k,) [s], None if the file has no column ``t``; poses, shape (k, n)
        [m, rad].

    Raises:
        ValueError: if the file is not such a table. The message names the line.
    """
    units = {"t": "s"}
    for symbol in "".join(kinds):
        units[column_name(symbol)] = "m" if symbol in "xyz" else "rad"
    table = read_table(path, "trajectory file", units)
    poses = _poses(table, kinds)
    for name, values in table.columns.items():
        table.refuse(name, np.isnan(values), ". A waypoint has a number in each column")
        if units[name] == "m":
            is_far = np.abs(values) > LONGEST_LENGTH
            table.refuse(name, is_far, " m. Lengths are in metres: divide millimetres by 1000")
    times = table.columns.get("t")
    if times is None:
        return None, poses
    table.refuse_decrease("t", np.arange(len(times)))
    return times - times[0], poses


def _poses(table: Table, kinds: Sequence[str]) -> Array:
    """Poses in the columns of a table, shape (k, n), which it has for one of the kinds."""
    valid = []
    for symbols in kinds:
        names = [column_name(symbol) for symbol in symbols]
        valid.append(",".join(["t", *names]))
        if set(names) == table.columns.keys() - {"t"}:
            poses = np.stack([table.columns[name] for name in names], axis=1)
            if len(poses) < 2:
                raise ValueError(f"{table.name}: it needs at least two waypoints")
            return poses
    raise ValueError(
        f"{table.name}: its first line is '{','.join(table.columns)}'. It must be {' or '.join(valid)} "
        "(t in s, lengths in m, angles in rad; without t, give a duration)"
    )
