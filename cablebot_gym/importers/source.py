"""Values of a robot in a file of another program, and the robot that they give with assumptions for
missing values."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import GRAVITY, Motors, Plane, Robot, Transmission
from cablebot_gym.utils.files import read_text

SIZE_OVER_DRUM = 100.0
"""Assumed ratio of the width of the base to the drum radius, between 20 of a small robot and 220 of
a large one."""

DRUM_RADII = (0.01, 0.5)
"""Least and largest assumed drum radius [m]."""

CABLE_SPEED = 2.0
"""Assumed speed of a cable at the free speed of its motor [m/s]."""

MASS_FRACTION = 0.1
"""Assumed inertia of a winch, reflected to its cable, as a fraction of the platform's mass."""

FORCE_RESERVE = 4.0
"""Assumed largest tension, as a multiple of the platform's weight."""

FRAME = "turned by 180° about x, so that z points down"
"""Change of the frame of a robot in space, in the sources."""


@dataclass(kw_only=True)
class Source:
    """Values of a file in SI units and in the frame of this package, z down."""

    name: str
    """Name of the robot."""
    base: Array
    """Base anchors, shape (m, d) [m]."""
    platform: Array | None
    """Platform anchors, shape (m, d) [m]; None for a point mass."""
    mass: float
    """Platform mass [kg]."""
    inertia: Array | None = None
    """Tensor about the centre of mass, shape (3, 3), or (1,) in a plane [kg·m²]; None for a point
    mass."""
    center_of_mass: Array | None = None
    """Centre of mass, shape (d,) [m]; None for the origin."""
    home: Array | None = None
    """Home pose, shape (n,) [m, rad]; None if the file has none."""
    plane: Plane = "horizontal"
    """Plane of a planar robot."""
    swivel_radius: tuple[float, ...] = ()
    """Radii of the swivel pulleys, one per cable [m]; empty if there are none."""
    least_tension: float | None = None
    """Least tension [N]; None if the file has none."""
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


@dataclass(frozen=True, kw_only=True)
class ImportedRobot:
    """A robot from a file of another program."""

    robot: Robot
    """The robot. Its ``sources`` say where each value comes from; those of assumed values start
    with ``assumed``."""
    notes: tuple[str, ...]
    """Further content of the file, with the reason why it is left out."""

    def to_toml(self) -> str:
        """The robot as a TOML file for :func:`~cablebot_gym.robots.names.load_robot`."""
        data = self.robot.to_dict()
        motors, transmission = data.pop("motors"), data.pop("transmission")
        lines = ["# SI units and radians; z points down. Check it with `cablebot robot check`."]
        lines += _toml_lines(data, unused=(None, ()))
        lines += ["", "[motors]", *_toml_lines(motors, unused=(None, 0.0))]
        lines += ["", "[transmission]", *_toml_lines(transmission, unused=(None, 0.0))]
        lines += ["", "[sources]"]
        for name, text in self.sources.items():
            lines.append(f"{json.dumps(name)} = {_toml_value(text)}")
        return "\n".join(lines) + "\n"

    @property
    def sources(self) -> Mapping[str, str]:
        """Source of each value by the field of the robot."""
        return self.robot.sources


def _toml_lines(values: Mapping[str, Any], unused: tuple[Any, ...]) -> Iterator[str]:
    """Lines of the values, except for those that have no effect."""
    for name, value in values.items():
        if value in unused:
            continue
        if isinstance(value, tuple) and isinstance(value[0], tuple):
            rows = "".join(f"  {_toml_value(row)},\n" for row in value)
            yield f"{name} = [\n{rows}]"
        else:
            yield f"{name} = {_toml_value(value)}"


def _toml_value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(float(value) + 0.0)  # without −0.0


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file. Its document type is not read, and entities are refused: they can
    grow without limit.

    Raises:
        ValueError: if the file cannot be read, or is not such XML.
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


def completed(source: Source) -> ImportedRobot:
    """The robot of a source, with assumptions for what it lacks.

    Raises:
        ValueError: if no pose is found that positive tensions hold, or a value is not physical.
    """
    sources, m = dict(source.sources), len(source.base)
    fields = {
        "name": source.name,
        "base_anchors": source.base,
        "mass": source.mass,
        "plane": source.plane,
        "swivel_radius": source.swivel_radius or 0.0,
        "cable_density": source.cable_density,
    }
    if source.platform is not None and source.inertia is not None:
        fields |= {"platform_anchors": source.platform, "inertia": source.inertia}
        if source.center_of_mass is not None and np.any(source.center_of_mass):
            fields["center_of_mass"] = source.center_of_mass
    if source.least_tension:
        fields["minimum_tension"] = source.least_tension
    else:
        sources["minimum_tension"] = "assumed: the default of this package"
    radius = _drum_radius(source, sources)
    tensions = source.largest_tensions
    if tensions is None:
        tensions = np.full(m, FORCE_RESERVE * source.mass * GRAVITY)
        sources["motors.stall_torque"] = (
            f"assumed: tension of {FORCE_RESERVE:g} × the platform's weight at the drum"
        )
    speed = source.cable_speed
    if speed is None:
        speed = CABLE_SPEED
        sources["motors.free_speed"] = f"assumed: a cable runs at {CABLE_SPEED:g} m/s without load"
    inertia = source.winch_inertia
    if inertia is None:
        inertia = MASS_FRACTION * source.mass * radius**2
        sources["transmission.pulley_inertia"] = (
            f"assumed: at the cable, a winch has {MASS_FRACTION:g} of the platform's mass"
        )
    sources["transmission.damping"] = "assumed: no friction"
    torques = tuple(_rounded(tensions * radius))
    if len(set(torques)) == 1:
        torques = torques[0]
    fields["motors"] = Motors(stall_torque=torques, free_speed=_rounded(speed / radius))
    fields["transmission"] = Transmission(pulley_radius=radius, pulley_inertia=_rounded(inertia))
    notes = list(source.notes)
    robot = _at_home(source, fields, sources, notes)
    return ImportedRobot(robot=robot, notes=tuple(notes))


def _rounded(values: Any) -> Any:
    """Derived values with six digits."""
    if np.ndim(values):
        return [_rounded(value) for value in values]
    return float(f"{values:.6g}") + 0.0  # without −0.0


def _drum_radius(source: Source, sources: dict[str, str]) -> float:
    if source.drum_radius is not None:
        return source.drum_radius
    width = float(np.max(np.ptp(source.base, axis=0)))
    sources["transmission.pulley_radius"] = (
        f"assumed: 1/{SIZE_OVER_DRUM:g} of the width of the base"
    )
    return float(_rounded(np.clip(width / SIZE_OVER_DRUM, *DRUM_RADII)))


def _at_home(
    source: Source, fields: dict[str, Any], sources: dict[str, str], notes: list[str]
) -> Robot:
    """The robot at the home pose of the source, or at the first pose of a search that positive
    tensions hold."""
    refusal = None
    for pose in _home_poses(source):
        try:
            robot = Robot(**fields, home_pose=tuple(_rounded(pose)), sources=sources)
        except ValueError as error:
            refusal = refusal or error
            continue
        if source.home is not None and refusal is not None:
            notes.append(f"the initial pose is left out: {refusal}")
        if source.home is None or refusal is not None:
            text = "assumed: below the middle of the base anchors, the pose nearest to their mean height that is held"
            return robot.replace(sources={**sources, "home_pose": text})
        return robot
    raise ValueError(str(refusal))


def _home_poses(source: Source) -> Iterator[Array]:
    """The pose of the source, then poses on a vertical line through the middle of the base
    anchors."""
    if source.home is not None:
        yield source.home
    low, high = source.base.min(axis=0), source.base.max(axis=0)
    middle, depth = (low + high) / 2, float(np.max(high - low))
    angles = {(2, True): 1, (3, True): 3}.get((len(middle), source.platform is not None), 0)
    steps = [0.0]
    if len(middle) == 3 or source.plane == "vertical":
        steps = [sign * depth * step / 20 for step in range(21) for sign in (1, -1)]
    for step in steps:
        position = middle.copy()
        position[-1] += step
        yield np.concatenate([position, np.zeros(angles)])
