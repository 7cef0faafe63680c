"""Robots of WireX, ``.wcrfx``: geometry, platform, and the first winch and cable of the file."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_winches.importers.source import FRAME_CHANGE, TENSOR, FileValues, child_of, symmetric

ROOT = "models"
"""Root element of the files."""

DEFAULTS = {
    "mass": 25.0,
    "f_max": 720.0,
    "r_drum": 0.1,
    "inertia": 0.001527,
    "weight": 0.023,
    "max_velocity": 2.0,
}
"""Values that WireX writes into files of robots that it knows nothing about."""

DEFAULT_CENTER = (0.0, 1.0, 0.2)
"""Centre of gravity that WireX writes if it knows none [m], which is beside most platforms."""

_UP_TO_DOWN = np.array([1.0, -1.0, -1.0])


def read(root: Element, path: Path, cable_set: str | None) -> FileValues:
    """The robot of a file.

    Raises:
        ValueError: if an element is missing, or the platform does not move in all six or all three
            directions.
    """
    if cable_set is not None:
        raise ValueError("a .wcrfx file has no cable sets: remove --cable-set")
    robot = child_of(root, "robot")
    pattern = robot.get("motionpattern", "")
    if pattern not in ("3R3T", "3T"):
        raise ValueError(f"its motion pattern is {pattern!r}. Only 3R3T and 3T are imported")
    chains = list(child_of(robot, "geometry").iter("chain"))
    base = _anchors(chains, "base")
    platform = _anchors(chains, "platform")
    body = child_of(robot, "platform")
    label = f"WireX, {path.name}"
    values = FileValues(
        name=path.stem,
        base_anchors=base,
        platform_anchors=platform,
        mass=_number(body, "mass"),
        sources={"base_anchors": f"{label}; {FRAME_CHANGE}", "mass": label + _doubt(body, "mass")},
    )
    if pattern == "3R3T":
        values.sources["platform_anchors"] = f"{label}; {FRAME_CHANGE}"
        _add_inertia(values, body, label, platform)
    else:  # the anchors of a body that does not turn shift the base
        values.base_anchors = base - platform
        values.platform_anchors = None
    radii = {_number(child_of(chain, "base"), "radius", 0.0) for chain in chains}
    if any(radii):
        text = ", ".join(f"{radius:g} m" for radius in sorted(radii))
        values.notes.append(
            f"swivel pulleys of {text} are left out, as WireX does by default: see swivel_radius"
        )
    _add_winch(values, root, label)
    _add_cable(values, root, label)
    return values


def _anchors(chains: list[Element], tag: str) -> Array:
    """Ends of the cables at base or platform, shape (m, 3)."""
    return np.array([_vector(child_of(chain, tag)) for chain in chains]).reshape(-1, 3)


def _number(element: Element, name: str, default: float | None = None) -> float:
    if default is not None and name not in element.attrib:
        return default
    text = element.get(name, "")
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"<{element.tag}> needs a number {name}, not {text!r}") from None
    if not math.isfinite(value):
        raise ValueError(f"<{element.tag}> has {name} = {text}; it must be finite")
    return value


def _vector(element: Element) -> Array:
    """A point, z down."""
    return _UP_TO_DOWN * [_number(element, axis) for axis in "xyz"]


def _doubt(element: Element, name: str) -> str:
    """Remark for a value that many files share."""
    if _number(element, name) == DEFAULTS[name]:
        return "; WireX's default, probably not measured"
    return ""


def _add_inertia(values: FileValues, body: Element, label: str, anchors: Array) -> None:
    """Centre of mass and inertia; assumed where the file has what WireX writes for every robot."""
    values.sources["center_of_mass"] = (
        "assumed: the origin of the platform frame; the file has WireX's default"
    )
    element = body.find("centerofgravity")
    if element is not None:
        center = _vector(element)
        if not np.allclose(center, _UP_TO_DOWN * DEFAULT_CENTER):
            values.center_of_mass = center
            values.sources["center_of_mass"] = f"{label}; {FRAME_CHANGE}"
    tensor = body.find("inertiatensor")
    if tensor is not None and all(tensor.get(name) for name in TENSOR[:3]):
        signs = np.outer(_UP_TO_DOWN, _UP_TO_DOWN)
        values.inertia = signs * symmetric(*(_number(tensor, name, 0.0) for name in TENSOR))
        values.sources["inertia"] = (
            f"{label}; the entries are those of the tensor, as WireX uses them; {FRAME_CHANGE}"
        )
        return
    sides = np.maximum(np.ptp(anchors, axis=0), np.ptp(anchors) / 10) ** 2
    moments = values.mass * (sides.sum() - sides) / 12
    values.inertia = np.diag([float(f"{moment:.4g}") for moment in moments])
    values.sources["inertia"] = (
        "assumed: a homogeneous box around the platform anchors; the file has only Ixx"
    )


def _add_winch(values: FileValues, root: Element, label: str) -> None:
    """Force, speed, drum and inertia of the first winch."""
    winch = root.find("winch")
    if winch is None:
        values.notes.append("the file has no winch")
        return
    cable, motor, drum = (winch.find(tag) for tag in ("cable", "motor", "drum"))
    if drum is not None and _number(drum, "r_drum", 0.0) > 0:
        values.drum_radius = _number(drum, "r_drum")
        values.sources["transmission.pulley_radius"] = label + _doubt(drum, "r_drum")
    if cable is not None and _number(cable, "f_max", 0.0) > 0:
        values.largest_tensions = np.full(len(values.base_anchors), _number(cable, "f_max"))
        values.sources["motors.stall_torque"] = (
            f"{label}: f_max at the drum{_doubt(cable, 'f_max')}"
        )
    if cable is not None and _number(cable, "max_velocity", 0.0) > 0:
        values.cable_speed = _number(cable, "max_velocity")
        values.sources["motors.free_speed"] = (
            f"{label}: max_velocity of the cable{_doubt(cable, 'max_velocity')}"
        )
    if motor is not None and _number(motor, "inertia", 0.0) > 0:
        values.winch_inertia = _number(motor, "inertia") * _number(motor, "gear_ratio", 1.0) ** 2
        text = f"{label}: inertia of the motor × gear_ratio²{_doubt(motor, 'inertia')}"
        values.sources["transmission.pulley_inertia"] = text


def _add_cable(values: FileValues, root: Element, label: str) -> None:
    """Mass and stiffness of the first cable."""
    cable = root.find("cable")
    if cable is None:
        values.notes.append("the file has no cable")
        return
    if _number(cable, "weight", 0.0) > 0:
        values.cable_density = _number(cable, "weight")
        values.sources["cable_density"] = label + _doubt(cable, "weight")
    stiffness = _number(cable, "elasticity", 0.0) * math.pi * _number(cable, "radius", 0.0) ** 2
    if stiffness > 0:
        text = f"elasticity and radius give EA = {stiffness:.4g} N"
        values.notes.append(
            f"the cables do not stretch here; {text}, for transmission.axial_stiffness"
        )
