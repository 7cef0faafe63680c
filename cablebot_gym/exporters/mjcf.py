"""A robot as MJCF, the format of MuJoCo. The export does not need MuJoCo.

Coordinates are those of the robot, z down. In space the platform is a free body, ``qpos = (p,
quaternion of R)`` and ``qvel = (ṗ, ω_body)``. A point mass slides along the axes, and a platform in
a plane turns on a hinge too, ``qpos = X``.

A rigid transmission is reflected to its cable: a tendon with ``armature = J/r²`` and ``damping =
c/r²``, and a motor with ``gear = −1/r``. With joint springs or elastic cables, ``qpos`` ends in the
wound lengths r β′ of winches, see :class:`_Springs`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from textwrap import fill
from typing import Any, Literal
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from cablebot_gym.kinematics import Array, cable_lengths, cable_vectors, structure_jacobian
from cablebot_gym.robots import KIND_TEXTS, Robot

Controls = Literal["actions", "torques"]
"""Controls of the motors: actions in [−1, 1], which follow the torque-speed lines, or torques [N·m]
without limits. Positive controls wind the cables in."""

_WINCH_ROOM = 10
"""Distance of a winch from its base anchor, as a multiple of the diagonal of the workspace plus the
deflection of its spring at stall. A winch that passed its base anchor would reverse the tendon; a
larger distance leaves fewer digits for the deflection."""

_INTRODUCTION = """\
SI units and radians. {gravity}
All numbers are in the frame of the robot. The camera "upright" shows it upright.

ctrl is the action of each motor in [-1, 1], positive ones wind in: the torque is the stall torque
times ctrl, minus the slope of the torque-speed line times the speed of the motor.
{state}

What differs from the simulation of cablebot-gym:
"""


@dataclass(frozen=True, kw_only=True)
class ExportedRobot:
    """A robot as a file of another program."""

    text: str
    """Content of the file."""
    robot: Robot
    """The robot of the file: without dry friction, and with cables that end in points."""
    notes: tuple[str, ...]
    """Differences between the file and the simulation of this package."""


def export_mjcf(
    robot: Robot,
    *,
    payload: float = 0.0,
    timestep: float = 1e-3,
    holding_torques: Array | None = None,
) -> ExportedRobot:
    """The robot as MJCF with actions as controls.

    Args:
        robot: any robot.
        payload: payload at the centre of mass [kg], which does not change the inertia.
        timestep: duration of one RK4 step [s].
        holding_torques: torques r T that hold robot and payload at home, shape (m,) [N·m], for the
            keyframe ``home``; None for no keyframe.
    """
    simplified = _without_friction(_with_points(robot))
    root = mjcf_tree(simplified, payload=payload, timestep=timestep)
    notes = _notes(robot)
    if holding_torques is not None:
        _add_home(root, simplified, holding_torques)
        if np.any(holding_torques > robot.stall_torque):
            notes.append("The motors cannot hold the payload at home.")
    text = (
        f"{robot.name}: {KIND_TEXTS[robot.kind]}, {robot.cables} cables, payload {payload:g} kg\n\n"
    )
    text += _INTRODUCTION.format(gravity=_gravity_text(robot), state=_state_text(robot))
    for note in notes:
        text += fill(note, 100, initial_indent="* ", subsequent_indent="  ") + "\n"
    indent(root)
    comment = re.sub("-+", "-", text)  # two hyphens are not allowed in a comment
    return ExportedRobot(
        text=f"<!--\n{comment}-->\n{tostring(root, encoding='unicode')}\n",
        robot=simplified,
        notes=tuple(notes),
    )


def mjcf_tree(
    robot: Robot, *, payload: float = 0.0, timestep: float = 1e-3, controls: Controls = "actions"
) -> Element:
    """The elements of MJCF of a robot, without its swivel pulleys and dry friction.

    The arguments are as in :func:`export_mjcf`.
    """
    diagonal = _diagonal(robot)
    center = _padded(robot.home[: robot.dimensions])
    root = Element("mujoco", model=robot.name)
    _add(root, "compiler", angle="radian", inertiafromgeom="false")
    gravity = _padded(robot.gravity_vector)
    _add(root, "option", timestep=timestep, integrator="RK4", gravity=gravity)
    # The extent for the display; that of all bodies would include the distant winches.
    _add(root, "statistic", center=center, extent=diagonal)
    defaults = _add(root, "default")
    _add(defaults, "site", size=diagonal / 200)
    _add(defaults, "tendon", width=diagonal / 800)
    world = _add(root, "worldbody")
    _add_camera(world, robot, center, diagonal)
    _add_sites(world, "base", robot.base)
    _add_platform(world, robot, robot.mass + payload)
    tendons = _add(root, "tendon")
    if robot.flexible:
        _add_winches(world, tendons, robot)
    if not robot.elastic:
        _add_pulleys(tendons, robot)
    _add_motors(_add(root, "actuator"), robot, controls)
    return root


@dataclass(frozen=True, kw_only=True)
class _Springs:
    """Springs between platform and winches; each array has shape (m,).

    A winch is a body with the mass J/r². It slides along x, away from its base anchor, by r β′. A
    tendon from the platform over the base anchor to the winch has the length q + r β′ + ``room``.
    It is a spring that only pulls.
    """

    mass: Array
    """Mass of a winch [kg]."""
    friction: Array
    """Viscous damping of a winch [N·s/m]."""
    stiffness: Array
    """Stiffness at the cable [N/m]."""
    damping: Array
    """Damping at the cable [N·s/m]."""
    room: Array
    """Distance of a winch from its base anchor at β′ = 0 [m]."""


def _springs(robot: Robot) -> _Springs:
    square = robot.pulley_radius**2
    if robot.jointed:
        mass = robot.motor_inertia / square
        friction = robot.motor_damping / square
        stiffness = robot.stiffness / square
        damping = np.zeros(robot.cables)
    else:
        mass = robot.pulley_inertia / square
        friction = robot.damping / square
        length = _lengths(robot, robot.home) + robot.extra_length
        stiffness = robot.axial_stiffness / length
        damping = robot.axial_damping / length
    deflection = robot.stall_torque / robot.pulley_radius / stiffness
    return _Springs(
        mass=mass,
        friction=friction,
        stiffness=stiffness,
        damping=damping,
        room=_WINCH_ROOM * (_diagonal(robot) + deflection),
    )


def _with_points(robot: Robot) -> Robot:
    """The robot with base anchors where its cables leave their swivel pulleys at home."""
    if robot.swivel is None:
        return robot
    vectors = cable_vectors(robot.base, robot.platform, robot.home)
    upright = np.tile([0.0, 0.0, 1.0], (robot.cables, 1))
    axes = np.asarray(robot.swivel_axes or upright)
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    # A pulley turns about its axis towards the platform: its centre lies normal to the axis.
    normal = vectors - np.sum(vectors * axes, axis=1, keepdims=True) * axes
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    centers = robot.per_motor(robot.swivel_radius)[:, None] * normal
    directions = structure_jacobian(robot.base, robot.platform, robot.home, robot.swivel)[:, :3]
    # A cable is a tangent, so its free length is the distance from the centre along it.
    free_length = np.sum((vectors - centers) * directions, axis=1)
    points = robot.base + vectors - free_length[:, None] * directions
    transmission = robot.transmission
    if robot.elastic:  # the cable on the pulley stretches, too
        on_pulley = _lengths(robot, robot.home) - free_length
        transmission = transmission.replace(extra_length=robot.extra_length + on_pulley)
    return robot.replace(
        base_anchors=points, swivel_radius=0.0, swivel_axes=(), transmission=transmission
    )


def _without_friction(robot: Robot) -> Robot:
    """The robot without the friction that MJCF has no model for."""
    smooth = robot.transmission.replace(coulomb_friction=0.0, load_friction=0.0)
    return robot.replace(transmission=smooth)


def _notes(robot: Robot) -> list[str]:
    """Differences between a robot and its file."""
    notes = []
    if robot.elastic:
        notes.append(
            "The cables only pull, but their damping acts on slack cables, too. Their stiffness and damping are those "
            "at home. The torques on the winches lack the work that stretches wound cable."
        )
    elif robot.jointed:
        notes.append("The springs only pull, but pulleys push slack cables by their inertia.")
    else:
        notes.append("The cables push, too: the motion is that of the robot while all are taut.")
    if robot.swivel is not None:
        notes.append("The cables end in points, where they leave their swivel pulleys at home.")
    if np.any(robot.coulomb_friction):
        notes.append(
            "The Coulomb friction is left out. The attribute frictionloss of tendons and joints is similar."
        )
    if np.any(robot.load_friction):
        notes.append("The friction per load is left out.")
    if np.any(robot.motor_lag):
        notes.append("The lag of a motor acts on its action, not on its torque.")
    notes.append(
        "The torques follow the speeds of the motors at once. The environments take the speeds at the start of each "
        "control period."
    )
    return notes


def _gravity_text(robot: Robot) -> str:
    if robot.weightless:
        return "Gravity does not act."
    down = "y" if robot.planar else "z"
    return f"{down} points down: gravity acts along +{down}."


def _state_text(robot: Robot) -> str:
    coordinates = "the pose"
    if robot.kind == "spatial":
        coordinates = "p and quaternion of the platform"
    if robot.flexible:
        return f"qpos: {coordinates}, then the length that each winch has wound."
    return f"qpos: {coordinates}."


def _add_camera(world: Element, robot: Robot, center: Array, distance: float) -> None:
    """Adds a camera in whose picture gravity acts downwards."""
    offset = [0, distance, 0]
    axes = [-1, 0, 0, 0, 0, -1]
    if robot.planar:
        offset = [0, 0, distance]
        axes = [1, 0, 0, 0, -1, 0]
    _add(world, "camera", name="upright", pos=center - offset, xyaxes=axes)


def _add_platform(world: Element, robot: Robot, mass: float) -> None:
    body = _add(world, "body", name="platform")
    center = _padded(robot.mass_center)
    if robot.kind == "spatial":
        body.set("pos", _text(robot.home[:3]))
        body.set("quat", _text(_home_quaternion(robot)))
        _add(body, "freejoint", name="platform")
        _add(body, "inertial", pos=center, mass=mass, **_spatial_inertia(robot))
    else:
        for name, axis in zip("xyz"[: robot.dimensions], np.eye(3), strict=False):
            _add(body, "joint", name=name, type="slide", axis=axis)
        moment = 1.0  # a point mass does not turn, but MuJoCo requires moments
        if not robot.point_mass:
            moment = robot.inertia[0]
            _add(body, "joint", name="phi", type="hinge", axis=[0, 0, 1])
        _add(body, "inertial", pos=center, mass=mass, diaginertia=[moment] * 3)
    _add_sites(body, "platform", robot.platform)


def _home_quaternion(robot: Robot) -> Array:
    """Rotation of the home pose, (w, x, y, z)."""
    rotation = Rotation.from_euler("ZYX", robot.home[:2:-1])  # φ, θ, ψ
    quaternion: Array = rotation.as_quat(scalar_first=True)
    return quaternion


def _spatial_inertia(robot: Robot) -> dict[str, Any]:
    tensor = robot.inertia_tensor
    moments = tensor.diagonal()
    products = tensor[(0, 0, 1), (1, 2, 2)]  # xy, xz, yz
    if np.any(products):
        return {"fullinertia": [*moments, *products]}
    # MuJoCo refuses a moment above the sum of the others. That of a plate equals it, and may exceed
    # it by rounding.
    return {"diaginertia": np.minimum(moments, np.sort(moments)[:2].sum())}


def _add_winches(world: Element, tendons: Element, robot: Robot) -> None:
    springs = _springs(robot)
    relaxed_length = _lengths(robot, robot.home) + springs.room
    name = "cable" if robot.elastic else "spring"
    places = _padded(robot.base)
    places[:, 0] += springs.room
    for i, place in enumerate(places):
        winch = f"winch{i + 1}"
        body = _add(world, "body", name=winch, pos=place)
        friction = springs.friction[i]
        _add(body, "joint", name=winch, type="slide", axis=[1, 0, 0], damping=friction)
        _add(body, "inertial", pos=[0, 0, 0], mass=springs.mass[i], diaginertia=[1, 1, 1])
        _add(body, "site", name=winch)
        spring = _add_tendon(tendons, f"{name}{i + 1}", i, springs.damping[i])
        spring.set("stiffness", _text(springs.stiffness[i]))
        spring.set("springlength", _text([0, relaxed_length[i]]))
        _add(spring, "site", site=winch)


def _add_pulleys(tendons: Element, robot: Robot) -> None:
    square = robot.pulley_radius**2
    for i in range(robot.cables):
        damping = robot.damping[i] / square[i]
        cable = _add_tendon(tendons, f"cable{i + 1}", i, damping)
        cable.set("armature", _text(robot.pulley_inertia[i] / square[i]))


def _add_tendon(tendons: Element, name: str, index: int, damping: float) -> Element:
    """A tendon from the platform to a base anchor."""
    tendon = _add(tendons, "spatial", name=name, damping=damping)
    _add(tendon, "site", site=f"platform{index + 1}")
    _add(tendon, "site", site=f"base{index + 1}")
    return tendon


def _add_motors(actuators: Element, robot: Robot, controls: Controls) -> None:
    for i, radius in enumerate(robot.pulley_radius):
        driven = {"joint": f"winch{i + 1}", "gear": 1 / radius}
        if not robot.flexible:
            driven = {"tendon": f"cable{i + 1}", "gear": -1 / radius}
        motor = _add(actuators, "general", name=f"motor{i + 1}", **driven)
        if controls == "torques":
            continue
        motor.set("ctrlrange", "-1 1")
        motor.set("gainprm", _text(robot.stall_torque[i]))
        motor.set("biastype", "affine")
        motor.set("biasprm", _text([0, 0, -robot.speed_slope[i]]))
        if robot.motor_lag[i] > 0:
            motor.set("dyntype", "filter")
            motor.set("dynprm", _text(robot.motor_lag[i]))


def _add_home(root: Element, robot: Robot, torques: Array) -> None:
    """Keyframe at rest at home: winches wound by the springs, and actions that hold the load."""
    positions = robot.home
    if robot.kind == "spatial":
        positions = np.append(robot.home[:3], _home_quaternion(robot))
    if robot.flexible:
        wound = torques / robot.pulley_radius / _springs(robot).stiffness
        positions = np.append(positions, wound)
    actions = torques / robot.stall_torque
    key = _add(_add(root, "keyframe"), "key", name="home", qpos=positions, ctrl=actions)
    lagged = robot.motor_lag > 0
    if np.any(lagged):
        key.set("act", _text(actions[lagged]))


def _add_sites(parent: Element, prefix: str, points: Array) -> None:
    for number, point in enumerate(_padded(points), 1):
        _add(parent, "site", name=f"{prefix}{number}", pos=point)


def _add(parent: Element, tag: str, **attributes: Any) -> Element:
    texts = {name: _text(value) for name, value in attributes.items()}
    return SubElement(parent, tag, texts)


def _text(value: Any) -> str:
    """A text, a number, or several numbers with all their digits; + 0.0 makes 0 of −0."""
    if isinstance(value, str):
        return value
    return " ".join(repr(number + 0.0) for number in np.ravel(value).astype(float).tolist())


def _padded(points: Array) -> Array:
    """Points or vectors in space, z = 0 for those in a plane."""
    missing = (0, 3 - points.shape[-1])
    return np.pad(points, [(0, 0)] * (points.ndim - 1) + [missing])


def _lengths(robot: Robot, pose: Array) -> Array:
    return cable_lengths(robot.base, robot.platform, pose, robot.swivel)


def _diagonal(robot: Robot) -> float:
    """Diagonal of the workspace [m]."""
    return float(np.linalg.norm(np.diff(robot.pose_bounds[:, : robot.dimensions], axis=0)))
