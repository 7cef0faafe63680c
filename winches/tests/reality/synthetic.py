"""Synthetic logs in the forms of the public ones."""

import hashlib
import io

import numpy as np

from cablebot_winches.reality.sources import Source


def csv_text(rows, header=""):
    text = io.StringIO()
    np.savetxt(text, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return text.getvalue().encode()


def source_of(files):
    """A source that expects these contents by path."""
    hashes = {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
    return Source(repository="owner/name", commit="c" * 40, license="MIT", files=hashes)


def written(files, folder):
    """Writes files by path into a folder, and returns it."""
    for path, content in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    return folder


LOADS = (5, 17, 33)


def sagging(slope=1.5e-3, copied=()):
    """Files of three loads with a linear sag [m/kg] on a grid. The points in ``copied`` have the
    rows of the largest load in the file of the least one."""
    axes = np.meshgrid(np.linspace(-3, 3, 5), np.linspace(-1, 1, 5), [0.0, 1.0], indexing="ij")
    commanded = np.stack(axes, axis=-1).reshape(-1, 3)
    files = {}
    for load in LOADS:
        offset = np.array([0.01, -0.02, 0.5 - slope * load])
        measured = commanded + offset
        files[load] = 1e3 * np.hstack([measured, commanded])
    for point in copied:
        files[5][point] = files[33][point]
    return {f"datasets/final/real_{load}kg.csv": csv_text(rows) for load, rows in files.items()}
