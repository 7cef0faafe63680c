"""Waypoints of a motion that users bring as a CSV file: times in s, lengths in m, angles in rad, z
down."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.utils.files import read_text

Array = NDArray[np.float64]

SUFFIX = ".csv"
"""Suffix of files with waypoints, in small or capital letters."""

LONGEST_LENGTH = 1000.0
"""Largest coordinate of a position [m]. The largest cable robot is 600 m wide, so a larger one was
meant in mm."""

_TIME = "t"
_LETTERS = {"ψ": "psi", "θ": "theta", "φ": "phi"}
"""Names of angles in headers, as their symbols can be hard to type. Headers may have the symbols
too."""


def is_waypoint_file(name: object) -> bool:
    """Whether the name of a motion is that of a file with waypoints."""
    return isinstance(name, str) and name.lower().endswith(SUFFIX)


def read_waypoints(path: Path, kinds: Sequence[str]) -> tuple[Array | None, Array]:
    """Times and poses of the waypoints in a CSV file, whose first line names the columns in any
    order.

    Args:
        path: the file.
        kinds: symbols of the coordinates, such as ``xyφ``, for each kind of robot that fits.

    Returns:
        Times from 0 on, shape (k,) [s], None if the file has no column ``t``; poses, shape (k, n)
        [m, rad].

    Raises:
        ValueError: if the file is not such a table. The message names the line.
    """
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise ValueError(
            f"cannot read trajectory file {str(path)!r}: {error.strerror or error}"
        ) from error
    rows = {}
    try:
        for number, row in enumerate(csv.reader(lines), 1):
            cells = [cell.strip() for cell in row]
            if any(cells):
                rows[number] = cells
        return _parsed(rows, kinds)
    except (ValueError, csv.Error) as error:
        raise ValueError(f"trajectory file {str(path)!r}: {error}") from None


def _parsed(rows: dict[int, list[str]], kinds: Sequence[str]) -> tuple[Array | None, Array]:
    """Times and poses from the cells of each line by its number."""
    valid = " or ".join(_header_text(symbols) for symbols in kinds)
    if not rows:
        raise ValueError(
            f"it is empty. Its first line must be {valid}, and each further line a waypoint"
        )
    header = rows.pop(min(rows))
    symbols = _matching_kind(header, kinds, valid)
    if len(rows) < 2:
        raise ValueError("it needs at least two waypoints")
    table = np.array([_numbers(number, row, header) for number, row in rows.items()])
    columns = dict(zip(_letters(header), table.T, strict=True))
    poses = np.stack([columns[name] for name in _letters(symbols)], axis=1)
    lengths = [index for index, name in enumerate(symbols) if name in "xyz"]
    largest = np.max(np.abs(poses[:, lengths]))
    if largest > LONGEST_LENGTH:
        raise ValueError(
            f"a coordinate is {largest:g} m. Lengths are in metres: divide millimetres by 1000"
        )
    if _TIME not in columns:
        return None, poses
    times = columns[_TIME]
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        line = list(rows)[late[0] + 1]
        before = times[late[0]]
        after = times[late[0] + 1]
        raise ValueError(f"line {line} has t = {after:g} s after {before:g} s. Times must increase")
    return times - times[0], poses


def _header_text(symbols: str) -> str:
    """The header of a file in letters, such as ``t,x,y,phi``."""
    return ",".join([_TIME, *_letters(symbols)])


def _letters(names: Iterable[str]) -> list[str]:
    """Names of columns in letters."""
    return [_LETTERS.get(name, name) for name in names]


def _matching_kind(header: list[str], kinds: Sequence[str], valid: str) -> str:
    """The symbols of the coordinates whose columns the header names."""
    columns = sorted(_letters(header))
    for symbols in kinds:
        required = _letters(symbols)
        if columns in (sorted(required), sorted([_TIME, *required])):
            return symbols
    if any(";" in name for name in header):
        raise ValueError(
            "its columns are separated by ';'. Save it with commas between columns and points in numbers"
        )
    if all(_is_number(name) for name in header):
        raise ValueError(f"it has no header. Its first line must be {valid}")
    units = "t in s, lengths in m, angles in rad; without t, give a duration"
    raise ValueError(f"its first line is {','.join(header)!r}. It must be {valid} ({units})")


def _numbers(line: int, row: list[str], header: list[str]) -> list[float]:
    """The finite numbers of a line."""
    if len(row) != len(header):
        raise ValueError(
            f"line {line} has {len(row)} values, and the header has {len(header)} columns"
        )
    for name, text in zip(header, row, strict=True):
        if not _is_number(text):
            raise ValueError(f"line {line}: {name} is {text!r}, which is not a number")
        if not math.isfinite(float(text)):
            raise ValueError(f"line {line}: {name} is {text}. All numbers must be finite")
    return [float(text) for text in row]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
