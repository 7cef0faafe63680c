"""Questions about values of a robot that are possible but unusual, with the unit that was probably
meant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics.hanging import home_at_rest
from cablebot_gym.robots import (
    GRAVITY,
    RPM,
    Robot,
    holds_upside_down,
    reach_and_gyration,
    vertical_remedy,
)
from cablebot_gym.task import find_error_bounds


@dataclass(frozen=True)
class _Quantity:
    """A quantity that follows from a robot, its usual range, and the question if it is outside."""

    value: float
    low: float
    high: float
    question: str


def doubtful_values(robot: Robot) -> Iterator[str]:
    """Questions about the robot. The ranges include every robot of the library with a wide
    margin."""
    for quantity in (
        *_motor_strength(robot),
        *_motor_losses(robot),
        *_lengths(robot),
        *_platform(robot),
        *_springs(robot),
        *_defaults(robot),
    ):
        if not quantity.low <= quantity.value <= quantity.high:
            yield quantity.question
    low, high = robot.pose_bounds
    box = robot.base.min(axis=0), robot.base.max(axis=0)
    sides = robot.dimensions - (not robot.weightless)
    is_wider = np.any(low[:sides] < box[0][:sides] - 1e-9)
    is_wider |= np.any(high[:sides] > box[1][:sides] + 1e-9)
    if is_wider and not robot.hanging:
        yield "workspace is wider than the base anchors: give (low, high) within them"
    vertical = robot.dimensions - 1
    on_floor = box[0][vertical] >= 0 and robot.home[vertical] > 0
    if on_floor and robot.cables > robot.coordinates and holds_upside_down(robot):
        axis = "xyz"[vertical]
        yield f"all anchors are at {axis} ≥ 0 and would hold the platform upside down too: {vertical_remedy(robot)}"


def _size(robot: Robot) -> float:
    """Width of the base [m]."""
    return float(np.max(np.ptp(robot.base, axis=0)))


def _force(robot: Robot) -> float:
    """Force of the strongest motor at its cable [N]."""
    return float(np.max(robot.stall_torque / robot.pulley_radius))


def _motor_strength(robot: Robot) -> Iterator[_Quantity]:
    size = _size(robot)
    force = _force(robot)
    free_speed = robot.stall_torque / robot.speed_slope
    speed = float(np.max(free_speed * robot.pulley_radius))
    yield _Quantity(
        speed,
        1e-3 * size,
        min(max(11.0, size), 60.0, 12 * size),
        f"motors.free_speed gives {speed:.4g} m/s at the cable of a robot of {size:.3g} m: is it in rad/s at the "
        f"pulley? Multiply rpm by {RPM:.4f} and divide by the gear ratio",
    )
    earth = robot.mass * GRAVITY
    yield _Quantity(
        force,
        0.0,
        100 * earth,
        f"motors.stall_torque gives {force:.3g} N at the cable, over 100 times the weight of {earth:.3g} N: is it in "
        "N·m, pulley_radius in m, and mass in kg?",
    )
    least_force = robot.mass * robot.gravity
    if robot.weightless:
        least_force = 0.05 * earth
    together = robot.cables * force
    yield _Quantity(
        together,
        least_force,
        math.inf,
        f"all motors together pull with {together:.3g} N and the weight is {earth:.3g} N: is motors.stall_torque in "
        "N·m at the pulley, and mass in kg?",
    )
    name = "motor_inertia" if robot.jointed else "pulley_inertia"
    seconds = float(np.max(getattr(robot, name) * free_speed / robot.stall_torque))
    yield _Quantity(
        seconds,
        0.0,
        5.0,
        f"a motor without load needs {seconds:.3g} s to its free speed: is transmission.{name} in kg·m²? 1 kg·cm² is "
        "1e-4 kg·m²",
    )


def _motor_losses(robot: Robot) -> Iterator[_Quantity]:
    force = _force(robot)
    free_speed = robot.stall_torque / robot.speed_slope
    drag = float(np.max(robot.damping * free_speed / robot.stall_torque))
    yield _Quantity(
        drag,
        0.0,
        1.0,
        f"at the free speed, transmission.damping takes {drag:.3g} times the stall torque: is it in N·m·s/rad?",
    )
    friction = float(np.max(robot.coulomb_friction / robot.stall_torque))
    yield _Quantity(
        friction,
        0.0,
        0.5,
        f"transmission.coulomb_friction is {friction:.3g} times the stall torque: are both in N·m at the pulley?",
    )
    share = float(robot.load_friction.max())
    text = f"transmission.load_friction is {share:.3g} of the load: is it a fraction?"
    yield _Quantity(share, 0.0, 0.3, text)
    lag = float(robot.motor_lag.max())
    yield _Quantity(lag, 0.0, 0.2, f"motors.lag is {lag:.3g} s: is it in s? 1 ms is 0.001")
    least = robot.minimum_tension / force
    yield _Quantity(
        least,
        0.0,
        0.5,
        f"minimum_tension is {least:.3g} times the largest tension of {force:.3g} N: is it in N?",
    )
    if robot.maximum_tension != math.inf:
        largest = robot.maximum_tension / force
        yield _Quantity(
            largest,
            0.02,
            50.0,
            f"maximum_tension is {largest:.3g} times the {force:.3g} N of the strongest motor: is it in N?",
        )


def _lengths(robot: Robot) -> Iterator[_Quantity]:
    size = _size(robot)
    radius = robot.pulley_radius
    for name, value, least in (
        ("pulley_radius", radius, 1 / 1300),
        ("swivel_radius", np.asarray(robot.swivel_radius, float), 0.0),
    ):
        yield _Quantity(
            float(value.min() if value.min() < least * size else value.max()) / size,
            least,
            0.25,
            f"base_anchors are {size:.3g} m wide and {name} is {float(value.max()):.3g} m: are both in m?",
        )
    density = float(np.max(robot.cable_density))
    if density > 0:
        strength = _force(robot) / density
        yield _Quantity(
            strength,
            2e3,
            math.inf,
            f"cable_density is {density:.3g} kg/m for cables that carry {_force(robot):.3g} N: is it in kg/m? 1 g/m is "
            "0.001",
        )


def _platform(robot: Robot) -> Iterator[_Quantity]:
    if not robot.weightless:
        gravity = f"gravity is {robot.gravity:g} m/s²: is it in m/s²? On Earth it is {GRAVITY}"
        yield _Quantity(robot.gravity, 1.0, 30.0, gravity)
    if robot.point_mass:
        return
    reach, gyration = reach_and_gyration(robot)
    yield _Quantity(
        gyration / reach,
        0.1,
        2.0,
        f"the radius of gyration is {gyration:.3g} m and the platform anchors reach {reach:.3g} m from the centre of "
        "mass: is inertia in kg·m², about the centre of mass?",
    )
    angle = float(np.max(np.abs(robot.pose_bounds[:, robot.dimensions :])))
    yield _Quantity(angle, 0.0, 2 * math.pi, "the angles of workspace exceed 2π: are they in rad?")


def _springs(robot: Robot) -> Iterator[_Quantity]:
    if not robot.flexible:
        return
    tensions = home_at_rest(robot, robot.mass, robot.minimum_tension).tensions
    torque = robot.pulley_radius * tensions
    if robot.jointed:
        wound = float(np.max(np.abs(torque) / robot.stiffness))
        yield _Quantity(
            wound,
            0.0,
            6.5,
            f"the platform alone winds a joint spring by {wound:.3g} rad: is transmission.stiffness in N·m/rad? "
            "Multiply a stiffness per degree by 57.3",
        )
    if not robot.elastic:
        return
    length = (
        cable_lengths(robot.base, robot.platform, robot.home, robot.swivel) + robot.extra_length
    )
    tension = np.maximum(tensions, robot.minimum_tension)
    unit = "is transmission.axial_stiffness EA in N? Multiply a stiffness in N/m by the length"
    strain = float(np.max(tension / robot.axial_stiffness))
    stretch = 1e3 * float(np.max(length * tension / robot.axial_stiffness))
    yield _Quantity(
        strain,
        1e-7,
        0.003,
        f"the platform alone stretches a cable by {stretch:.3g} mm, or {strain:.2g} of it: {unit}",
    )
    strain = float(np.max(robot.stall_torque / robot.pulley_radius / robot.axial_stiffness))
    yield _Quantity(
        strain, 0.0, 0.025, f"the stall torque stretches a cable by {strain:.1%}: {unit}"
    )
    extra = float(robot.extra_length.max())
    text = f"transmission.extra_length is {extra:.3g} m of a robot of {_size(robot):.3g} m: is it in m?"
    yield _Quantity(extra, 0.0, 10 * _size(robot), text)


def _defaults(robot: Robot) -> Iterator[_Quantity]:
    size = _size(robot)
    try:
        bounds = find_error_bounds(None, robot)
    except ValueError as error:  # beyond the workspace
        yield _Quantity(math.inf, 0.0, 0.0, f"defaults: {error}")
        return
    yield _Quantity(
        bounds.position / size,
        1e-5,
        0.1,
        f"defaults.error_bounds.position is {bounds.position:g} m of a robot of {size:.3g} m: is it in m?",
    )
    text = f"defaults.error_bounds.rotation is {bounds.rotation:g} rad: is it in rad? 1 degree is 0.0175"
    yield _Quantity(bounds.rotation, 1e-5, 0.3, text)
    if robot.defaults.payload_range is not None:
        most = robot.defaults.payload_range[1]
        heavy = robot.mass + most
        held = robot.cables * _force(robot) / GRAVITY
        yield _Quantity(
            heavy,
            0.0,
            20 * held,
            f"defaults.payload_range ends at {most:g} kg, and all motors together lift {held:.3g} kg: is it in kg?",
        )
