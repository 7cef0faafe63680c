"""Tables of numbers in CSV files that people bring: waypoints of motions, logs of winches.

A message about a cell names the file, the line, the column and the value.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.utils.checks import unknown_name_error
from cablebot_gym.utils.files import read_text

_LETTERS = {"ψ": "psi", "θ": "theta", "φ": "phi"}
"""Names of angles, as their symbols can be hard to type. Files may have the symbols too."""

_NAME_AND_UNIT = re.compile(r"(.*?)\s*[\[(](.*)[\])]")
"""Head of a column with its unit, such as ``x [m]`` or ``x (m)``."""

_SAME_UNIT = str.maketrans("", "", " ·*⋅")
"""N·m may be written as Nm."""


def column_name(symbol: str) -> str:
    """Name of the column of a coordinate by its symbol: ``phi`` for ``φ``, ``x`` for ``x``."""
    return _LETTERS.get(symbol, symbol)


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns of numbers, and the lines of the file that they come from."""

    name: str
    """Kind and name of the file in messages, such as ``log 'run.csv'``."""
    columns: Mapping[str, NDArray[np.float64]]
    """Values by the name of the column, each (K,). Empty cells are NaN."""
    lines: tuple[int, ...] = ()
    """Line of each row in the file, from 1 on; empty if the rows follow a header in line 1."""

    def line(self, row: int) -> int:
        """Line of a row in the file."""
        return self.lines[row] if self.lines else row + 2

    def refuse(self, column: str, is_wrong: NDArray[np.bool_], problem: str) -> None:
        """Refuses the first wrong cell of a column.

        Args:
            column: name of the column.
            is_wrong: whether the cell of each row is wrong, shape (K,).
            problem: what is wrong or valid. It follows the value in the message.

        Raises:
            ValueError: if a cell is wrong.
        """
        for row in np.flatnonzero(is_wrong):
            value = self.columns[column][row]
            text = "empty" if math.isnan(value) else f"{value:.12g}"
            raise ValueError(f"{self.name}: line {self.line(row)}: {column} is {text}{problem}")

    def refuse_decrease(self, column: str, rows: NDArray[np.intp]) -> None:
        """Refuses a number that is not larger than the one before it.

        Args:
            column: name of the column.
            rows: the rows to compare, shape (k,), such as those where another column has a value.

        Raises:
            ValueError: if there is such a number.
        """
        values = self.columns[column]
        for index in np.flatnonzero(np.diff(values[rows]) <= 0):
            before, row = rows[index : index + 2]
            after = f", after {values[before]:.12g} in line {self.line(before)}"
            self.refuse(
                column,
                np.arange(len(values)) == row,
                f"{after}. It must increase: remove or correct a line",
            )


def read_table(path: str | Path, kind: str, units: Mapping[str, str]) -> Table:
    """The numbers of a CSV file, whose first line names the columns in any order.

    Lines without values are left out, and a cell that is empty or ``nan`` is NaN. The name of a
    column may have its unit, as in ``x [m]``.

    Args:
        path: the file.
        kind: kind of the file in messages, such as ``log``.
        units: units of the valid columns by their names; empty for a number without unit.

    Raises:
        ValueError: if the file is not such a table.
    """
    name = f"{kind} {str(path)!r}"
    rows = {}
    try:
        reader = csv.reader(read_text(path).splitlines())
        for row in reader:
            if any(map(str.strip, row)):
                rows[reader.line_num] = row
    except (OSError, csv.Error) as error:
        raise ValueError(f"cannot read {name}: {getattr(error, 'strerror', error)}") from error
    try:
        if not rows:
            raise ValueError(f"it is empty. Its first line must name columns of {', '.join(units)}")
        header = _columns(rows.pop(min(rows)), units)
        cells = [_numbers(line, row, header) for line, row in rows.items()]
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    table = np.reshape(cells, (len(rows), len(header)))
    return Table(name=name, columns=dict(zip(header, table.T, strict=True)), lines=tuple(rows))


def _columns(heads: list[str], units: Mapping[str, str]) -> list[str]:
    """Names of the columns from the cells of the first line."""
    valid = f"Its first line must name columns of {', '.join(units)}"
    if ";" in heads[0]:
        raise ValueError(
            "its columns are separated by ';'. Save it with commas between columns and points in numbers"
        )
    if all(map(_is_number, heads)):
        raise ValueError(f"it has no header. {valid}")
    names: list[str] = []
    for head in map(str.strip, heads):
        match = _NAME_AND_UNIT.fullmatch(head)
        name, unit = match.groups() if match else (head, "")
        name = column_name(name)
        if name not in units:
            raise unknown_name_error("column", name, units)
        if name in names:
            raise ValueError(f"column {name!r} appears twice. Remove one of them")
        if unit and unit.translate(_SAME_UNIT) != units[name].translate(_SAME_UNIT):
            raise ValueError(
                f"column {head!r} must be in {units[name]}. Convert its numbers, and call it {name!r}"
            )
        names.append(name)
    return names


def _numbers(line: int, row: list[str], header: list[str]) -> list[float]:
    """The numbers of a line; NaN for empty cells."""
    if len(row) != len(header):
        raise ValueError(
            f"line {line} has {len(row)} values, and the first line {len(header)} columns"
        )
    for name, text in zip(header, row, strict=True):
        if not _is_number(text):
            raise ValueError(
                f"line {line}: {name} is {text!r}, which is not a finite number with a decimal point"
            )
    return [float(text.strip() or "nan") for text in row]


def _is_number(text: str) -> bool:
    """Whether a cell is empty, NaN or a finite number."""
    try:
        return not math.isinf(float(text.strip() or "nan"))
    except ValueError:
        return False
