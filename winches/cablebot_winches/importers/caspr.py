"""Robots of CASPR with one rigid body: ``NAME_bodies.xml`` and ``NAME_cables.xml``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from cablebot_gym.kinematics import Array, rotation_matrix
from cablebot_gym.utils.checks import choice
from cablebot_winches.importers.source import (
    FRAME_CHANGE,
    TENSOR,
    FileValues,
    child_of,
    read_xml,
    symmetric,
)

ROOTS = ("bodies_system", "cables")
"""Root elements of the two files."""

SMALLEST_FORCE = 0.01
"""Least tension above which ``force_min`` is a property of the robot, and not a number close to
zero [N]."""


@dataclass(frozen=True)
class _Joint:
    """A joint between the base and the body."""

    axes: tuple[int, ...]
    """Axes of the file along which the body moves."""
    turn: float | None = None
    """Sign of the file's angle in this package's plane; None if the body does not turn in a
    plane."""
    spatial: bool = False
    """Whether the body turns in space."""
    moment: int = 2
    """Axis of the moment of inertia in a plane."""

    @property
    def frame(self) -> Array:
        """Matrix from the file's axes, z up, to this package's, where the vertical axis points
        down."""
        matrix = np.eye(3)[list(self.axes)]
        if self.axes == (0, 1, 2):
            matrix[1:] *= -1.0  # half a turn about x keeps the frame right-handed
        elif self.vertical:
            matrix[-1] *= -1.0
        return matrix

    @property
    def turns(self) -> bool:
        """Whether the body turns."""
        return self.spatial or self.turn is not None

    @property
    def vertical(self) -> bool:
        """Whether gravity acts in the plane of the joint."""
        return len(self.axes) == 2 and self.axes[-1] == 2


JOINTS = {
    "SPATIAL_EULER_XYZ": _Joint((0, 1, 2), spatial=True),
    "T_XYZ": _Joint((0, 1, 2)),
    "PLANAR_XY": _Joint((0, 1), turn=1.0),
    # the angle of the file turns from z to x, which is from −y to x here
    "PLANAR_XZ": _Joint((0, 2), turn=1.0, moment=1),
    "PLANAR_YZ": _Joint((1, 2), turn=-1.0, moment=0),
    "P_XY": _Joint((0, 1)),
    "P_XZ": _Joint((0, 2)),
}
"""Joints of CASPR between base and body that are kinds of robots here."""


def read(path: Path, cable_set: str | None) -> FileValues:
    """The robot of two files, of which ``path`` is one.

    Raises:
        ValueError: if a file is missing, or the robot has several bodies, another joint or cables
            over several points.
    """
    bodies, cables = map(read_xml, _files(path))
    links = list(bodies.iter("link_rigid"))
    if len(links) != 1:
        raise ValueError(
            f"it has {len(links)} bodies. Only robots with one rigid body are imported"
        )
    element = child_of(links[0], "joint")
    joint = JOINTS.get(element.get("type", ""))
    if joint is None:
        raise ValueError(
            f"its joint is {element.get('type')}. Only {', '.join(JOINTS)} are imported"
        )
    name = path.stem.rpartition("_")[0]
    values = _body(name, links[0], element, joint)
    cables = _cable_set(cables, cable_set)
    label = f"CASPR, {name}_cables.xml, set {cables.get('id')}"
    _add_cables(values, cables, joint, label, _center(links[0]))
    values.notes.append(
        "q_min and q_max are not read: without `workspace`, it is the box of the base anchors"
    )
    return values


def _files(path: Path) -> tuple[Path, Path]:
    """The files of the bodies and of the cables."""
    name, _, content = path.stem.rpartition("_")
    if content not in ("bodies", "cables"):
        raise ValueError(
            "its name must end in _bodies.xml or _cables.xml, with the other file beside it"
        )
    bodies = path.with_name(f"{name}_bodies{path.suffix}")
    cables = path.with_name(f"{name}_cables{path.suffix}")
    for file in (bodies, cables):
        if not file.is_file():
            raise ValueError(f"{file.name} is missing beside it")
    return bodies, cables


def _numbers(text: str | None, count: int, what: str) -> Array:
    """Finite numbers of a text."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        form = "1 finite number" if count == 1 else f"{count} finite numbers"
        raise ValueError(f"{what} must be {form}, not {text!r}")
    return np.array(values)


def _value(element: Element, tag: str) -> float:
    return float(_numbers(child_of(element, tag).text, 1, f"<{tag}>")[0])


def _vector(element: Element, tag: str) -> Array:
    return _numbers(child_of(element, tag).text, 3, f"<{tag}>")


def _center(link: Element) -> Array:
    """Centre of mass from the joint in the file's frame [m]."""
    return _vector(child_of(link, "physical"), "com_location")


def _body(name: str, link: Element, element: Element, joint: _Joint) -> FileValues:
    """The body of a robot without its cables."""
    physical = child_of(link, "physical")
    label = f"CASPR, {name}_bodies.xml"
    no_cables = np.empty((0, len(joint.axes)))
    values = FileValues(
        name=name,
        base_anchors=no_cables,
        platform_anchors=no_cables,
        mass=_value(physical, "mass"),
        home_pose=_home(link, element, joint),
        plane="vertical" if joint.vertical else "horizontal",
        sources={"mass": label, "home_pose": f"{label}: q_initial"},
    )
    if not joint.turns:
        values.platform_anchors = None
        return values
    frame = joint.frame
    tensor = _inertia(physical)
    values.center_of_mass = frame @ _center(link)
    values.sources["center_of_mass"] = label
    values.inertia = tensor[joint.moment, joint.moment].reshape(1)
    if joint.spatial:
        values.inertia = frame @ tensor @ frame.T
        diagonal = np.diag(values.inertia)
        if not np.any(values.inertia - np.diag(diagonal)):
            values.inertia = diagonal
    values.sources["inertia"] = f"{label}; the entries are those of the tensor, as CASPR uses them"
    return values


def _home(link: Element, element: Element, joint: _Joint) -> Array:
    """Home pose from the initial coordinates of the joint and its offset."""
    frame = joint.frame
    axes = len(frame)
    angles = 3 if joint.spatial else int(joint.turns)
    pose = _numbers(element.get("q_initial"), axes + angles, "q_initial")
    signs = frame.sum(axis=1)  # each row of the frame has one entry, ± 1
    offset = np.zeros(3)
    parent = link.find("parent")
    if parent is not None:
        offset = _vector(parent, "location")
    rotation = pose[axes:]
    if joint.spatial:
        rotation = _euler_angles(frame @ _rotation_of_file(rotation) @ frame.T)
    elif joint.turn is not None:
        rotation = joint.turn * rotation
    return np.concatenate([signs * pose[:axes] + frame @ offset, rotation])


def _inertia(physical: Element) -> Array:
    """Inertia tensor about the centre of mass, along the file's axes [kg·m²]."""
    element = child_of(physical, "inertia")
    tensor = symmetric(*(_value(element, name) for name in TENSOR))
    reference = element.get("ref", "")
    if reference == "joint":
        mass = _value(physical, "mass")
        center = _vector(physical, "com_location")
        shift = (center @ center) * np.eye(3) - np.outer(center, center)
        tensor = tensor - mass * shift
    elif reference != "com":
        raise ValueError(f"<inertia> has ref {reference!r}. CASPR has com and joint")
    return tensor


def _rotation_of_file(angles: Array) -> Array:
    """Rx(α) Ry(β) Rz(γ), in the order opposite to this package's."""
    return np.asarray(rotation_matrix(-angles).T)


def _euler_angles(rotation: Array) -> Array:
    """Angles (ψ, θ, φ) of R = Rz(φ) Ry(θ) Rx(ψ)."""
    psi = math.atan2(rotation[2, 1], rotation[2, 2])
    theta = -math.asin(np.clip(rotation[2, 0], -1.0, 1.0))
    return np.array([psi, theta, math.atan2(rotation[1, 0], rotation[0, 0])])


def _cable_set(cables: Element, name: str | None) -> Element:
    """The cable set with a name, or the default one."""
    sets = {element.get("id", ""): element for element in cables.iter("cable_set")}
    if not sets:
        raise ValueError("it has no cable set")
    if name is None:
        name = cables.get("default_cable_set", "")
        if name not in sets:
            name = next(iter(sets))
    return sets[choice("cable set", name, sets)]


def _add_cables(
    values: FileValues, cables: Element, joint: _Joint, label: str, center: Array
) -> None:
    """Anchors and tensions of the cables of a set."""
    frame = joint.frame
    across = [axis for axis in range(3) if axis not in joint.axes]
    bases = []
    anchors = []
    radii = []
    forces = []
    for index, cable in enumerate(cables, 1):
        name = cable.get("name") or f"cable {index}"
        if "passive" in cable.tag:
            raise ValueError(f"{name!r} is a passive spring. Only cables with a motor are imported")
        base, anchor, radius = _ends(cable, name, center)
        if np.any(np.abs(base - anchor)[across] > 1e-9):
            raise ValueError(f"{name!r} leaves the plane in which the body moves")
        bases.append(frame @ base)
        anchors.append(frame @ anchor)
        radii.append(radius)
        properties = child_of(cable, "properties")
        forces.append([_value(properties, "force_min"), _value(properties, "force_max")])
        if cable.tag != "cable_ideal" and not any("springs" in note for note in values.notes):
            values.notes.append(
                f"the springs of the cables ({cable.tag}) are left out: see transmission"
            )
    if not forces:
        raise ValueError(f"cable set {cables.get('id')!r} has no cables")
    anchor_label = label
    if joint.axes == (0, 1, 2):
        anchor_label += f"; {FRAME_CHANGE}"
    elif joint.vertical:
        anchor_label += "; the second axis points down"
    values.base_anchors = np.array(bases)
    values.sources["base_anchors"] = anchor_label
    if joint.turns:
        values.platform_anchors = np.array(anchors)
        values.sources["platform_anchors"] = anchor_label
    else:  # the anchors of a body that does not turn shift the base
        values.base_anchors -= np.array(anchors)
    if any(radii):
        values.swivel_radii = tuple(radii)
        values.sources["swivel_radius"] = label
    least, largest = np.array(forces).T
    if least.max() > SMALLEST_FORCE:
        values.minimum_tension = float(least.max())
        values.sources["minimum_tension"] = f"{label}: force_min"
    values.largest_tensions = largest
    values.sources["motors.stall_torque"] = (
        f"assumed: the torque of force_max at the assumed drum ({label})"
    )


def _ends(cable: Element, name: str, center: Array) -> tuple[Array, Array, float]:
    """Ends of a cable at base and body in the file's frame, and the radius of its swivel pulley
    [m]."""
    points: dict[int, Array] = {}
    radius = 0.0
    attachments = list(child_of(cable, "attachments"))
    for attachment in attachments:
        if attachment.tag == "base_rotating_pulley":
            entry = _vector(attachment, "cable_entry_vector")
            if not (entry[0] == entry[1] == 0 and entry[2] > 0):
                raise ValueError(
                    f"{name!r} does not reach its pulley from below: choose another --cable-set"
                )
            points[0] = _vector(attachment, "fixed_location")
            radius = _value(attachment, "pulley_radius")
        elif attachment.tag == "attachment":
            points[int(_value(attachment, "link"))] = _vector(attachment, "location")
        else:
            raise ValueError(
                f"{name!r} has <{attachment.tag}>, which has no model: choose another --cable-set"
            )
    if len(attachments) != 2 or sorted(points) != [0, 1]:
        raise ValueError(f"{name!r} does not run from the base straight to the body")
    anchor = points[1]
    if cable.get("attachment_reference") == "com":
        anchor = anchor + center
    return points[0], anchor, radius
