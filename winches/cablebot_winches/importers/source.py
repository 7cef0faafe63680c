"""Values of a robot from a file of another program, and a robot from these values, with assumptions
for missing ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import GRAVITY, Motors, Plane, Robot, Transmission
from cablebot_gym.robots.parts import as_tuples
from cablebot_gym.robots.record import HomePoseError
from cablebot_gym.utils.files import read_text
from cablebot_winches.robot_file import to_toml

ASSUMED_BASE_WIDTH_OVER_DRUM_RADIUS = 100.0
"""Assumed ratio of the width of the base to the drum radius. Small robots have about 20, large ones
220."""

ASSUMED_DRUM_RADII = (0.01, 0.5)
"""Least and largest assumed drum radius [m]."""

ASSUMED_FREE_CABLE_SPEED = 2.0
"""Assumed speed of a cable at the free speed of its motor [m/s]."""

ASSUMED_WINCH_MASS_OVER_PLATFORM_MASS = 0.1
"""Assumed inertia of a winch, reflected to its cable, as a fraction of the platform's mass."""

ASSUMED_LARGEST_TENSION_OVER_PLATFORM_WEIGHT = 4.0
"""Assumed largest tension, as a multiple of the platform's weight."""

TENSOR = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Names of the entries of an inertia tensor in both formats, in the order of :func:`symmetric`.

Both programs use them as entries, I_xy = −∫xy dm, and not as products of inertia."""

FRAME_CHANGE = "turned by 180° about x, so that z points down"
"""Change of the frame of a robot in space, as the sources of its values describe it."""


@dataclass(kw_only=True)
class FileValues:
    """Values of a robot in a file, in SI units and in the frame of this package, z down.

    It is not frozen, because the readers fill it step by step.
    """

    name: str
    """Name of the robot."""
    base_anchors: Array
    """Base anchors, shape (m, d) [m]."""
    platform_anchors: Array | None
    """Platform anchors, shape (m, d) [m]; None for a point mass."""
    mass: float
    """Platform mass [kg]."""
    inertia: Array | None = None
    """Tensor about the centre of mass, shape (3, 3), or (1,) in a plane [kg·m²]; None for a point
    mass. A platform without inertia becomes a point mass."""
    center_of_mass: Array | None = None
    """Centre of mass, shape (d,) [m]; None for the origin."""
    home_pose: Array | None = None
    """Home pose, shape (n,) [m, rad]; None if the file has none."""
    plane: Plane = "horizontal"
    """Plane of a planar robot."""
    swivel_radii: tuple[float, ...] = ()
    """Radii of the swivel pulleys, one per cable [m]; empty if there are none."""
    minimum_tension: float | None = None
    """Minimum tension of every cable [N]; None if the file has none."""
    largest_tensions: Array | None = None
    """Largest tension of each cable [N]; None if the file has none."""
    drum_radius: float | None = None
    """Drum radius [m]; None if the file has none."""
    cable_speed: float | None = None
    """Largest speed of a cable [m/s]; None if the file has none."""
    winch_inertia: float | None = None
    """Inertia of a winch at its drum [kg·m²]; None if the file has none."""
    cable_density: float = 0.0
    """Mass of a cable per length [kg/m]."""
    sources: dict[str, str] = field(default_factory=dict)
    """Source of each value that the file has, by the field of the robot."""
    notes: list[str] = field(default_factory=list)
    """Further content of the file, with the reason why it is left out."""


class _UncheckedRobot(Robot):
    """A robot for its file alone: no tensions hold its home pose."""

    def __post_init__(self) -> None:
        for part in fields(self):
            object.__setattr__(self, part.name, as_tuples(getattr(self, part.name)))


@dataclass(frozen=True, kw_only=True)
class ImportedRobot:
    """A robot from a file of another program."""

    robot: Robot
    """The robot. Its ``sources`` say where each value comes from; those of assumed values start
    with ``assumed``."""
    notes: tuple[str, ...]
    """Further content of the file, with the reason why it is left out."""
    question: str = ""
    """Why no pose of the robot is held, with what may be wrong; empty if its home pose is held.
    Its file has to be corrected before it can be loaded."""

    def to_toml(self) -> str:
        """The robot as a TOML file for :func:`~cablebot_gym.robots.names.load_robot`."""
        return to_toml(self.robot)

    @property
    def sources(self) -> Mapping[str, str]:
        """Source of each value, by the field of the robot."""
        return self.robot.sources


def read_xml(path: str | Path) -> ElementTree.Element:
    """The root of an XML file.

    Its document type is not read. Entities are refused: expanded, they can grow without limit.

    Raises:
        ValueError: if the file cannot be read, is not valid XML, or defines entities. The message
            starts with "it", because ``import_robot`` puts the file's name before it.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise ValueError(f"it cannot be read: {error.strerror or error}") from error
    if "<!ENTITY" in text:
        raise ValueError("it defines XML entities. Remove them")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"it is not valid XML: {error}") from error


def child_of(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    """The first child with a tag.

    Raises:
        ValueError: if there is none.
    """
    child = element.find(tag)
    if child is None:
        raise ValueError(f"<{element.tag}> has no <{tag}>")
    return child


def symmetric(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> Array:
    """The symmetric matrix with these entries."""
    rows = [
        [xx, xy, xz],
        [xy, yy, yz],
        [xz, yz, zz],
    ]
    return np.array(rows)


def with_assumptions(values: FileValues) -> ImportedRobot:
    """The robot with the values of a file, and with assumptions for missing values.

    Raises:
        ValueError: if a value is not physical.
    """
    sources = dict(values.sources)
    robot_fields: dict[str, Any] = {
        "name": values.name,
        "base_anchors": values.base_anchors,
        "mass": values.mass,
        "plane": values.plane,
        "cable_density": values.cable_density,
    }
    # Without inertia, the platform becomes a point mass.
    if values.platform_anchors is not None and values.inertia is not None:
        robot_fields["platform_anchors"] = values.platform_anchors
        robot_fields["inertia"] = values.inertia
        if values.center_of_mass is not None and np.any(values.center_of_mass):
            robot_fields["center_of_mass"] = values.center_of_mass
    if values.swivel_radii:
        robot_fields["swivel_radius"] = values.swivel_radii
    if values.minimum_tension is None:
        sources["minimum_tension"] = "assumed: the default of this package"
    else:
        robot_fields["minimum_tension"] = values.minimum_tension
    drum_radius = _drum_radius(values, sources)
    robot_fields["motors"] = _motors(values, drum_radius, sources)
    robot_fields["transmission"] = _transmission(values, drum_radius, sources)
    notes = list(values.notes)
    robot, question = _robot_at_home(values, robot_fields, sources, notes)
    return ImportedRobot(robot=robot, notes=tuple(notes), question=question)


def _drum_radius(values: FileValues, sources: dict[str, str]) -> float:
    """Drum radius [m]. If it is assumed, ``sources`` gets an entry that says so."""
    if values.drum_radius is not None:
        return values.drum_radius
    sources["transmission.pulley_radius"] = (
        f"assumed: 1/{ASSUMED_BASE_WIDTH_OVER_DRUM_RADIUS:g} of the width of the base"
    )
    width = float(np.max(np.ptp(values.base_anchors, axis=0)))
    least, largest = ASSUMED_DRUM_RADII
    radius = np.clip(width / ASSUMED_BASE_WIDTH_OVER_DRUM_RADIUS, least, largest)
    return _six_digits(radius)


def _motors(values: FileValues, drum_radius: float, sources: dict[str, str]) -> Motors:
    """The motors. For each assumption, ``sources`` gets an entry that says so."""
    tensions = values.largest_tensions
    if tensions is None:
        factor = ASSUMED_LARGEST_TENSION_OVER_PLATFORM_WEIGHT
        tensions = np.full(len(values.base_anchors), factor * values.mass * GRAVITY)
        sources["motors.stall_torque"] = (
            f"assumed: tension of {factor:g} × the platform's weight at the drum"
        )
    cable_speed = values.cable_speed
    if cable_speed is None:
        cable_speed = ASSUMED_FREE_CABLE_SPEED
        sources["motors.free_speed"] = f"assumed: a cable runs at {cable_speed:g} m/s without load"
    torques = tuple(_six_digits(torque) for torque in tensions * drum_radius)
    free_speed = _six_digits(cable_speed / drum_radius)
    if len(set(torques)) == 1:
        return Motors(stall_torque=torques[0], free_speed=free_speed)
    return Motors(stall_torque=torques, free_speed=free_speed)


def _transmission(values: FileValues, drum_radius: float, sources: dict[str, str]) -> Transmission:
    """The transmission, in which the drum is called pulley. For each assumption, ``sources`` gets
    an entry that says so."""
    inertia = values.winch_inertia
    if inertia is None:
        fraction = ASSUMED_WINCH_MASS_OVER_PLATFORM_MASS
        inertia = fraction * values.mass * drum_radius**2
        sources["transmission.pulley_inertia"] = (
            f"assumed: at the cable, a winch has {fraction:g} of the platform's mass"
        )
    sources["transmission.damping"] = "assumed: no friction"
    return Transmission(pulley_radius=drum_radius, pulley_inertia=_six_digits(inertia))


def _six_digits(value: float) -> float:
    """A derived value with six significant digits."""
    return float(f"{value:.6g}") + 0.0  # + 0.0 turns −0.0 into 0.0


def _robot_at_home(
    values: FileValues, robot_fields: dict[str, Any], sources: dict[str, str], notes: list[str]
) -> tuple[Robot, str]:
    """The robot at the home pose of the file, or at the first pose of a search that positive
    tensions hold; if none is held, the robot at the first pose, unchecked, and a question.

    If the home pose of the file is not held, ``notes`` gets a text that says so.

    Raises:
        ValueError: if another value is not physical.
    """
    first_error = None
    first_pose: tuple[float, ...] = ()
    for pose in _home_poses(values):
        rounded_pose = tuple(_six_digits(coordinate) for coordinate in pose)
        try:
            robot = Robot(**robot_fields, home_pose=rounded_pose, sources=sources)
        except HomePoseError as error:
            if first_error is None:
                first_error = error
                first_pose = rounded_pose
            continue
        is_searched = values.home_pose is None or first_error is not None
        if not is_searched:
            return robot, ""
        if values.home_pose is not None:
            notes.append(f"the initial pose is left out: {first_error}")
        text = (
            "assumed: on the vertical line through the middle of the base anchors, the held pose "
            "nearest to the middle"
        )
        return robot.replace(sources={**sources, "home_pose": text}), ""
    if values.home_pose is None:
        sources["home_pose"] = "assumed: the middle of the base anchors"
    question = f"{first_error}. No other pose was found either"
    if values.platform_anchors is not None and values.center_of_mass is not None:
        offset = np.linalg.norm(values.center_of_mass - values.platform_anchors.mean(axis=0))
        question += f", and the centre of mass is {offset:.3g} m from the middle of the platform anchors: is it right"
    robot = _UncheckedRobot(**robot_fields, home_pose=first_pose, sources=sources)
    return robot, f"{question}? Correct the values in the new file"


def _home_poses(values: FileValues) -> Iterator[Array]:
    """The home pose of the file, then poses of a search: the middle of the base anchors, and other
    poses on the vertical line through it if gravity acts along the robot's last axis."""
    if values.home_pose is not None:
        yield values.home_pose
    low = values.base_anchors.min(axis=0)
    high = values.base_anchors.max(axis=0)
    middle = (low + high) / 2
    size = float(np.max(high - low))
    is_spatial = len(middle) == 3
    angles = 0
    if values.platform_anchors is not None:
        angles = 3 if is_spatial else 1
    steps = [0.0]
    if is_spatial or values.plane == "vertical":
        # nearest first; + is down
        for twentieths in range(1, 21):
            step = size * twentieths / 20
            steps += [step, -step]
    for step in steps:
        position = middle.copy()
        position[-1] += step
        yield np.concatenate([position, np.zeros(angles)])
