"""Identification of a robot: estimates, the robot with them, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cablebot_gym.identification.log import Log, pose_columns
from cablebot_gym.identification.regression import (
    CONFIDENCE,
    CONSTANT,
    TOO_WIDE,
    WIDEST,
    Estimate,
    fit,
    half_widths,
)
from cablebot_gym.identification.samples import (
    Samples,
    blocks,
    drive_samples,
    has_pose,
    load_torque,
    parameter_names,
    platform_motion,
)
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import PARAMETERS, ParameterDistribution, Uncertainty

OFFSET = "length_offset"
"""Name of the measured cable length less that of the angle, which is zero at the home pose."""

UNITS = {CONSTANT: "N·m/A", "pulley_radius": "m", OFFSET: "m"}
"""Units of parameters that are not in :data:`~cablebot_gym.uncertainty.PARAMETERS`."""


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Size of the residual of a motor, or of the equations of the platform."""

    motor: int
    """Index of the motor, or :data:`~cablebot_gym.identification.samples.PLATFORM`."""
    rms: float
    """RMS of measured minus modelled response [N·m, A, or N]."""
    response: float
    """RMS of the measured response in the same unit."""


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of an identification."""

    robot: Robot
    """The robot with the determined parameters."""
    uncertainty: Uncertainty
    """Their intervals, as uniform deviations from the values of the robot."""
    estimates: tuple[Estimate, ...]
    """All parameters, determined or not."""
    residuals: tuple[Residual, ...]
    """Sizes of the residuals."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data, motors counted from 1, and None in place of what is not finite."""
        estimates = []
        for item in self.estimates:
            data = asdict(item) | {"unit": unit_of(item.name), "determined": item.is_determined}
            data["motors"] = [motor + 1 for motor in item.motors]
            for name in ("value", "half_width"):
                if not np.isfinite(data[name]):
                    data[name] = None
            estimates.append(data)
        residuals = [asdict(item) | {"motor": item.motor + 1} for item in self.residuals]
        return {"confidence": CONFIDENCE, "estimates": estimates, "residuals": residuals}


def unit_of(name: str) -> str:
    """SI unit of an identified parameter."""
    if name in UNITS:
        return UNITS[name]
    return PARAMETERS[name].unit


def identify(robot: Robot, logs: Sequence[Log], *, payload: float = 0.0) -> Identification:
    """Identifies what the logs determine of the drives of a robot.

    Args:
        robot: robot with geometry and masses. Parameters that are not determined keep its values.
        logs: logs of :func:`~cablebot_gym.identification.log.read_log`.
        payload: payload of logs of a platform without a column for it [kg].

    Raises:
        ValueError: if the logs have not what the equations need. The message names the column.
    """
    source = f"identified by `cablebot identify` from {', '.join(log.name for log in logs)}"
    estimates = _geometry(robot, logs, payload)
    robot = _with_estimates(robot, estimates, source)
    samples = drive_samples(robot, logs, payload)
    names = parameter_names(robot)
    drives = fit(samples, names, {name: getattr(robot, name) for name in names})
    estimates += drives.estimates
    return Identification(
        robot=_with_estimates(robot, drives.estimates, source),
        uncertainty=_uncertainty(estimates),
        estimates=tuple(estimates),
        residuals=_residuals(samples, drives.residual),
    )


def _geometry(robot: Robot, logs: Sequence[Log], payload: float) -> list[Estimate]:
    """Drum radius and length offset of each rigid drive, or stiffness of each joint, from logs with
    pose and angle.

    A rigid drive has ``q(X) − q(X₀) = offset − r β``, a joint ``β′ − β = (r T + J β̈ + c β̇)/K``.
    """
    estimates: list[Estimate] = []
    if robot.elastic:
        return estimates
    for motor in range(robot.cables):
        column = f"angle_{motor + 1}"
        pieces = []
        for number, log in enumerate(logs):
            if has_pose(robot, log) and column in log.columns:
                pieces += _lengths(robot, log, number, motor, payload)
        if not pieces:
            continue
        inputs, outputs, time, number_of_log = map(np.concatenate, zip(*pieces, strict=True))
        jacobian = np.stack([inputs, np.ones(len(inputs))], axis=1)
        (slope, offset), *_ = np.linalg.lstsq(jacobian, outputs, rcond=None)
        residual = outputs - jacobian @ [slope, offset]
        widths = half_widths(jacobian, residual, blocks(number_of_log, time))
        reason = ""
        if widths[0] > WIDEST * abs(slope):
            reason = f"{TOO_WIDE}; add a longer motion"
        line = Estimate(
            name="pulley_radius",
            motors=(motor,),
            value=float(slope),
            half_width=float(widths[0]),
            reason=reason,
        )
        if robot.jointed:
            compliance = line.value
            width = line.half_width / compliance**2
            line = replace(line, name="stiffness", value=1 / compliance, half_width=width)
            estimates.append(line)
            continue
        width = float(widths[1])
        estimates += [line, replace(line, name=OFFSET, value=float(offset), half_width=width)]
    return sorted(estimates, key=lambda item: (item.name, item.motors))


def _lengths(
    robot: Robot, log: Log, number: int, motor: int, payload: float
) -> list[tuple[Array, ...]]:
    """Input and output of the line of :func:`_geometry`, times and number of the log."""
    column = f"angle_{motor + 1}"
    pieces: list[tuple[Array, ...]] = []
    for segment in log.segments([*pose_columns(robot), column]):
        pose, velocity, acceleration = platform_motion(robot, segment)
        angle = segment.smooth(column)
        pulley_angle = textbook.pulley_angle(robot, pose)[:, motor]
        inputs, outputs = -angle, -robot.pulley_radius[motor] * pulley_angle
        if robot.jointed:
            mass = robot.mass + payload
            tensions = textbook.required_tensions(robot, mass, pose, velocity, acceleration)
            speed, second = segment.smooth(column, 1), segment.smooth(column, 2)
            inputs = load_torque(robot, motor, tensions[:, motor], speed, second)
            outputs = angle - pulley_angle
        time = segment.smooth("time")
        pieces.append((inputs, outputs, time, np.full(len(time), number)))
    return pieces


def _with_estimates(robot: Robot, estimates: Sequence[Estimate], source: str) -> Robot:
    """The robot with the determined parameters, and their sources."""
    fields: dict[str, Array] = {}
    widths: dict[str, float] = {}
    for item in estimates:
        if item.is_determined and item.name not in (CONSTANT, OFFSET):
            field = fields.setdefault(item.name, np.array(getattr(robot, item.name)))
            field[list(item.motors)] = float(f"{item.value:.6g}")
            width = item.half_width / item.value
            widths[item.name] = max(width, widths.get(item.name, 0.0))
    changes: dict[str, Any] = {}
    sources = dict(robot.sources)
    for name, field in fields.items():
        changes[name] = tuple(field.tolist())
        if len(set(changes[name])) == 1:
            changes[name] = changes[name][0]
        text = f"{source}; {100 * CONFIDENCE:g} % interval within ± {100 * widths[name]:.2g} %"
        sources[f"transmission.{name}"] = text
    return robot.replace(transmission=robot.transmission.replace(**changes), sources=sources)


def _uncertainty(estimates: Sequence[Estimate]) -> Uncertainty:
    """Relative deviations within the widest interval of each determined parameter."""
    parameters = {}
    for name in PARAMETERS:
        items = [item for item in estimates if item.name == name and item.is_determined]
        if items:
            width = max(float(f"{item.half_width / item.value:.6g}") for item in items)
            parameters[name] = ParameterDistribution(low=-width, high=width, each=len(items) > 1)
    return Uncertainty(parameters=parameters)


def _residuals(samples: Samples, residual: Array) -> tuple[Residual, ...]:
    residuals = []
    for motor in np.unique(samples.motor):
        chosen = samples.motor == motor
        rms, response = (
            float(np.sqrt(np.mean(np.square(values[chosen]))))
            for values in (residual, samples.response)
        )
        residuals.append(Residual(motor=int(motor), rms=rms, response=response))
    return tuple(residuals)
