"""Robots from files of other programs: CASPR (bodies and cables as XML) and WireX (``.wcrfx``).

z points up in these files, and down in this package. A file has no complete winches, so parts are
assumed. The sources of an imported robot say where each value comes from.
"""

from __future__ import annotations

from pathlib import Path

from cablebot_winches.importers import caspr, wirex
from cablebot_winches.importers.source import ImportedRobot, read_xml, with_assumptions

__all__ = ["ImportedRobot", "import_robot"]


def import_robot(path: str | Path, *, cable_set: str | None = None) -> ImportedRobot:
    """A robot from a file of CASPR or WireX.

    Args:
        path: ``NAME_bodies.xml`` or ``NAME_cables.xml`` of CASPR, with the other one beside it, or
            a ``.wcrfx`` file.
        cable_set: cable set of the CASPR file; None for its default.

    Raises:
        ValueError: if the file cannot be read, or has a robot that this package has no model for.
    """
    path = Path(path)
    try:
        root = read_xml(path)
        if root.tag == wirex.ROOT:
            return with_assumptions(wirex.read(root, path, cable_set))
        if root.tag in caspr.ROOTS:
            return with_assumptions(caspr.read(path, cable_set))
        raise ValueError(
            f"its root is <{root.tag}>. CASPR has <bodies_system> and <cables>, WireX has <models>"
        )
    except ValueError as error:
        raise ValueError(f"cannot import {str(path)!r}: {error}") from error
