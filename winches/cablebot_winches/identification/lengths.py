"""Cable lengths from logs with pose and angles: drum radius, offset and axial stiffness of each
cable, or the stiffness of each joint spring.

The free length is what the drum has not wound up, and the tension stretches it:

    q(X) + extra_length = l (1 + T_ε/EA),    l = q(X₀) + extra_length + offset − r β.

T_ε is the tension without the damping of the cable. Cables that do not stretch have 1/EA = 0. With
joint springs, β is the pulley's angle, β = β′ − L/K.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import ELASTIC, Robot, library
from cablebot_winches.identification.log import Log, Segment, pose_columns
from cablebot_winches.identification.regression import (
    UNKNOWN_TENSIONS,
    ParameterEstimate,
    doubt,
    given_text,
    half_widths,
    inseparable_text,
    unexplained,
)
from cablebot_winches.identification.samples import (
    blocks,
    drive_columns,
    has_pose,
    load_torque,
    platform_mass,
    platform_motion,
    tension_from_torque,
)

OFFSET = "length_offset"
"""Name of the measured cable length less that of the angle, which is zero at the home pose."""

LEAST_MOTION = 0.01
"""Least standard deviation of a cable's length over its mean with which the drum radius is fitted:
shorter motions tell the radius no better than a stretch."""

LEAST_TENSION = 0.05
"""Least standard deviation of the tensions over their mean with which the axial stiffness is
fitted. What follows from the lengths does not count, because the radius could explain it."""

ITERATIONS = 8
"""Steps of Gauss and Newton. The equation is nearly linear, so that few are enough."""

_RADIUS, _OFFSET, _COMPLIANCE = range(3)

Source = Literal["cells", "dynamics", "torques", ""]
"""Where tensions come from: load cells, the inverse dynamics, motor torques, or nowhere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthSamples:
    """Samples of K instants of one cable."""

    length: Array
    """Length with ``extra_length`` by the measured pose, (K,) [m]."""
    angle: Array
    """Angle of the pulley, or of the motor with joint springs, (K,) [rad]."""
    tension: Array
    """Tension T_ε, (K,) [N]; NaN where it is unknown."""
    load: Array
    """Torque L of the joint spring, (K,) [N·m]; NaN where it is unknown."""
    time: Array
    """Times, (K,) [s]."""
    log: NDArray[np.int64]
    """Index of the log, (K,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthFit:
    """Measured and modelled length of one cable."""

    motor: int
    """Index of the motor."""
    estimates: tuple[ParameterEstimate, ...]
    """Estimates of its parameters."""
    samples: LengthSamples
    """The samples of the fit."""
    residual: Array
    """Measured minus modelled length, (K,) [m]."""


def fit_lengths(robot: Robot, logs: Sequence[Log], payload: float) -> list[LengthFit]:
    """Fits the length of each cable whose motor has an angle in a log with a pose.

    Args:
        robot: robot with the geometry, and with the friction that torques are corrected for.
        logs: logs; those without a pose have no part.
        payload: payload of logs without a column for it [kg].

    Raises:
        ValueError: if a log has a part of the pose's columns only, or too few samples.
    """
    fits = []
    for motor in range(robot.cables):
        pieces = []
        sources: set[Source] = set()
        for number, log in enumerate(logs):
            if has_pose(robot, log) and f"angle_{motor + 1}" in log.columns:
                source = tension_source(robot, log, motor)
                sources.add(source)
                pieces += _pieces(robot, log, number, motor, payload, source)
        if not pieces:
            continue
        samples = _joined(pieces)
        if not robot.flexible:
            fits.append(_fit_rigid(robot, motor, samples, is_hinted="torques" not in sources))
            continue
        is_known = np.isfinite(samples.tension)
        samples = _where(samples, is_known)
        if not np.any(is_known):
            fits.append(_unknown_tensions(robot, motor, samples))
        elif robot.elastic:
            fits.append(_fit(robot, motor, samples, may_stretch=True))
        else:
            fits.append(_fit_joint(robot, motor, samples))
    return fits


def tension_source(robot: Robot, log: Log, motor: int) -> Source:
    """Where the tension of a cable comes from in a log with a pose."""
    if f"tension_{motor + 1}" in log.columns:
        return "cells"
    if robot.cables == robot.coordinates:
        return "dynamics"
    if f"torque_{motor + 1}" in log.columns:
        return "torques"
    return ""


def _pieces(
    robot: Robot, log: Log, number: int, motor: int, payload: float, source: Source
) -> list[LengthSamples]:
    """Samples of the stretches of a log."""
    columns = [*pose_columns(robot), f"angle_{motor + 1}"]
    if source == "cells":
        columns.append(f"tension_{motor + 1}")
    if source == "torques":
        columns += drive_columns(log, motor)
    if "payload" in log.columns:
        columns.append("payload")
    pieces = []
    for segment in log.segments(columns):
        pose, velocity, acceleration = platform_motion(robot, segment)
        tension = np.full(len(pose), np.nan)
        if source == "dynamics":
            mass = platform_mass(robot, segment, payload)
            tensions = textbook.required_tensions(robot, mass, pose, velocity, acceleration)
            tension = tensions[:, motor]
        elif source:
            tension = _measured_tension(robot, segment, motor, source)
        angle = segment.smooth(f"angle_{motor + 1}")
        speed, second = segment.motion(motor)
        load = load_torque(robot, motor, tension, speed, second)
        length = textbook.cable_lengths(robot, pose)[:, motor] + robot.extra_length[motor]
        if robot.elastic:
            rate = np.gradient(length, segment.period) + robot.pulley_radius[motor] * speed
            tension = tension - robot.axial_damping[motor] * rate / length
        piece = LengthSamples(
            length=length,
            angle=angle,
            tension=tension,
            load=load,
            time=segment.smooth("time"),
            log=np.full(len(length), number),
        )
        pieces.append(piece)
    return pieces


def _measured_tension(robot: Robot, segment: Segment, motor: int, source: Source) -> Array:
    """Tension from a load cell, or from the torque where the motor moves [N], (K,)."""
    if source == "cells":
        return segment.smooth(f"tension_{motor + 1}")
    speed, acceleration = segment.motion(motor)
    torque = segment.smooth(f"torque_{motor + 1}")
    tension = tension_from_torque(robot, motor, torque, speed, acceleration)
    if robot.coulomb_friction[motor] > 0 or robot.load_friction[motor] > 0:
        # Friction takes any value at standstill.
        tension[~segment.moves(motor, robot.transmission.friction_speed)] = np.nan
    return tension


def _joined(pieces: Sequence[LengthSamples]) -> LengthSamples:
    """All samples of the pieces."""
    columns = {name: [vars(piece)[name] for piece in pieces] for name in vars(pieces[0])}
    return LengthSamples(**{name: np.concatenate(values) for name, values in columns.items()})


def _where(samples: LengthSamples, chosen: NDArray[np.bool_]) -> LengthSamples:
    return LengthSamples(**{name: values[chosen] for name, values in vars(samples).items()})


def _fit_rigid(robot: Robot, motor: int, samples: LengthSamples, *, is_hinted: bool) -> LengthFit:
    """Radius and offset. Where the lengths grow with a known tension, a hint that the cables
    stretch."""
    result = _fit(robot, motor, samples, may_stretch=False)
    if not is_hinted or not np.all(np.isfinite(samples.tension)):
        return result
    stretch = _fit(robot, motor, samples, may_stretch=True).estimates[-1]
    if not stretch.is_determined:
        return result
    remedy = f"write axial_stiffness = {stretch.value:.3g} under [transmission] in its TOML file"
    if robot.name in library():
        remedy = f"use --robot {ELASTIC}{robot.name}"
    reason = (
        f"the lengths grow with the tension, but the cables of this robot do not stretch; {remedy}"
    )
    return replace(result, estimates=(*result.estimates, replace(stretch, reason=reason)))


def _unknown_tensions(robot: Robot, motor: int, no_samples: LengthSamples) -> LengthFit:
    """The refusal of a stiffness without any tension."""
    name = "stiffness"
    if robot.elastic:
        name = "axial_stiffness"
    reason = f"{UNKNOWN_TENSIONS}, or torque_1, … of a motion without standstill"
    estimate = ParameterEstimate(name=name, motors=(motor,), reason=reason)
    return LengthFit(motor=motor, estimates=(estimate,), samples=no_samples, residual=np.empty(0))


def _fit(robot: Robot, motor: int, samples: LengthSamples, *, may_stretch: bool) -> LengthFit:
    """Least squares of the equation of the free length. ``may_stretch`` fits the compliance 1/EA,
    which else keeps the value of the robot."""
    tension = np.zeros(len(samples.length))
    compliance = 0.0
    if robot.elastic:
        compliance = 1 / robot.axial_stiffness[motor]
    if robot.elastic or may_stretch:
        tension = samples.tension
    angle = samples.angle
    if robot.jointed:
        angle = angle - samples.load / robot.stiffness[motor]
    home = textbook.cable_lengths(robot, robot.home)[motor] + robot.extra_length[motor]
    values = np.array([robot.pulley_radius[motor], 0.0, compliance])
    fitted = [_OFFSET]
    too_short = ""
    too_alike = ""
    if np.std(samples.length) > LEAST_MOTION * np.mean(samples.length):
        fitted.insert(0, _RADIUS)
    else:
        too_short = inseparable_text("pulley_radius")
    if may_stretch:
        columns = np.stack([-angle, np.ones(len(angle)), samples.length * tension], axis=1)
        if unexplained(columns[:, [*fitted, _COMPLIANCE]])[-1] < LEAST_TENSION**2:
            too_alike = inseparable_text("axial_stiffness")
        else:
            fitted.append(_COMPLIANCE)
    for _ in range(ITERATIONS):
        radius, offset, compliance = values
        stretch = 1 + compliance * tension
        free = home + offset - radius * angle
        columns = np.stack([-angle * stretch, stretch, free * tension], axis=1)
        jacobian = columns[:, fitted]
        residual = samples.length - free * stretch
        values[fitted] += np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    widths = np.full(3, np.nan)
    widths[fitted] = half_widths(jacobian, residual, blocks(samples.log, samples.time))
    radius, offset, compliance = values
    estimates = [
        _estimate("pulley_radius", motor, radius, widths[_RADIUS], too_short),
        ParameterEstimate(name=OFFSET, motors=(motor,), value=offset, half_width=widths[_OFFSET]),
    ]
    if may_stretch:
        compliance_width = widths[_COMPLIANCE]
        estimates.append(
            _stiffness("axial_stiffness", motor, compliance, compliance_width, too_alike)
        )
    given = []
    if too_short:
        given.append(given_text("pulley_radius", robot.pulley_radius[[motor]]))
    if too_alike and robot.elastic:
        given.append(given_text("axial_stiffness", robot.axial_stiffness[[motor]]))
    return LengthFit(
        motor=motor,
        estimates=tuple(_given(item, given) for item in estimates),
        samples=samples,
        residual=residual,
    )


def _given(estimate: ParameterEstimate, given: Sequence[str]) -> ParameterEstimate:
    """An estimate with the values of the robot that it rests on; none if it is refused."""
    if not estimate.is_determined:
        return estimate
    return replace(estimate, given=", ".join(given))


def _estimate(
    name: str, motor: int, value: float, half_width: float, reason: str
) -> ParameterEstimate:
    """An estimate with its doubts; without a value if there is a reason why it is not fitted."""
    if reason:
        return ParameterEstimate(name=name, motors=(motor,), reason=reason)
    estimate = ParameterEstimate(
        name=name, motors=(motor,), value=float(value), half_width=float(half_width)
    )
    return replace(estimate, reason=doubt(estimate))


def _stiffness(
    name: str, motor: int, compliance: float, half_width: float, reason: str
) -> ParameterEstimate:
    """The estimate of a stiffness from that of its inverse."""
    if reason:
        return ParameterEstimate(name=name, motors=(motor,), reason=reason)
    return _estimate(name, motor, 1 / compliance, half_width / compliance**2, "")


def _fit_joint(robot: Robot, motor: int, samples: LengthSamples) -> LengthFit:
    """Stiffness of a joint spring, ``β′ − β(X) = L/K`` and an offset of the angle."""
    radius = robot.pulley_radius[motor]
    home = textbook.cable_lengths(robot, robot.home)[motor]
    jacobian = np.stack([samples.load, np.ones(len(samples.load))], axis=1)
    twist = samples.angle - (home - samples.length) / radius
    solution = np.linalg.lstsq(jacobian, twist, rcond=None)[0]
    residual = twist - jacobian @ solution
    widths = half_widths(jacobian, residual, blocks(samples.log, samples.time))
    stiffness = _stiffness("stiffness", motor, solution[0], widths[0], "")
    estimate = _given(stiffness, [given_text("pulley_radius", robot.pulley_radius[[motor]])])
    return LengthFit(
        motor=motor, estimates=(estimate,), samples=samples, residual=radius * residual
    )
