"""Identification of a robot: estimates, the robot with them, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import PARAMETERS, ParameterDistribution, Uncertainty
from cablebot_gym.utils.results import Result
from cablebot_winches.identification.delay import speed_delay
from cablebot_winches.identification.lengths import OFFSET, LengthFit, fit_lengths
from cablebot_winches.identification.log import Log, pose_columns
from cablebot_winches.identification.regression import (
    CONFIDENCE,
    CONSTANT,
    ParameterEstimate,
    WinchFit,
    fit,
)
from cablebot_winches.identification.samples import (
    PLATFORM,
    Samples,
    drive_samples,
    parameter_names,
)
from cablebot_winches.identification.units import questions

UNITS = {CONSTANT: "N·m/A", "pulley_radius": "m", OFFSET: "m"}
"""Units of parameters that are not in :data:`~cablebot_gym.uncertainty.PARAMETERS`."""


DRY = 1e-9
"""``friction_speed`` of dry friction [rad/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Measured and modelled response of one equation at K instants."""

    equation: str
    """Name of the equation: ``motor 1``, ``length 1``, or ``platform x``."""
    unit: str
    """Unit of the response: N·m, A, N or m."""
    time: Array
    """Times of the log, (K,) [s]."""
    log: NDArray[np.int64]
    """Index of the log, (K,)."""
    measured: Array
    """Measured response, (K,)."""
    residual: Array
    """Measured minus modelled response, (K,)."""

    @property
    def rms(self) -> float:
        """RMS of the residual."""
        return _rms(self.residual)

    @property
    def measured_rms(self) -> float:
        """RMS of the measured response."""
        return _rms(self.measured)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True, kw_only=True, repr=False)
class Identification(Result):
    """Result of an identification."""

    robot: Robot
    """The robot with the determined parameters."""
    uncertainty: Uncertainty
    """Their intervals, as uniform deviations from the values of the robot."""
    estimates: tuple[ParameterEstimate, ...]
    """All parameters, determined or not."""
    responses: tuple[Response, ...]
    """Measured and modelled responses of all equations."""
    logs: tuple[str, ...]
    """Names of the logs."""
    unknown_motors: tuple[int, ...]
    """Indices of the motors without a log of a motion, which keep the values of the robot."""
    questions: tuple[str, ...]
    """Values far from those of the robot, which a wrong unit would explain, as sentences."""

    def __str__(self) -> str:
        determined = sum(item.is_determined for item in self.estimates)
        text = f"{determined} of {len(self.estimates)} parameters of {self.robot.name!r} determined"
        text += f" from {', '.join(self.logs)}."
        if self.unknown_motors:
            text += f" No log of {motors_text(self.unknown_motors)}."
        return text

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
        residuals = []
        for response in self.responses:
            residuals.append(
                {
                    "equation": response.equation,
                    "unit": response.unit,
                    "rms": response.rms,
                    "measured_rms": response.measured_rms,
                }
            )
        return {
            "confidence": CONFIDENCE,
            "estimates": estimates,
            "residuals": residuals,
            "unknown_motors": [motor + 1 for motor in self.unknown_motors],
            "questions": list(self.questions),
        }


def unit_of(name: str) -> str:
    """SI unit of an identified parameter."""
    if name in UNITS:
        return UNITS[name]
    return PARAMETERS[name].unit


def shown_unit(unit: str) -> tuple[str, float]:
    """Unit in which values in an SI unit are shown, and their factor: lengths are in mm."""
    if unit == "m":
        return "mm", 1e3
    return unit, 1.0


def identify(
    robot: Robot, logs: Sequence[Log], *, payload: float = 0.0, same_winches: bool = False
) -> Identification:
    """Identifies what the logs determine of the drives of a robot.

    Args:
        robot: robot with geometry and masses. Parameters that are not determined keep its values.
        logs: logs of :func:`~cablebot_winches.identification.log.read_log`.
        payload: payload of logs of a platform without a column for it [kg].
        same_winches: whether all winches have the same friction, inertia and torque constant, also
            those without a log.

    Raises:
        ValueError: if the logs have not what the equations need. The message names the column.
    """
    nominal = robot
    source = f"identified by `cablebot identify` from {', '.join(log.file for log in logs)}"
    has_torques = any(log.motors() for log in logs)
    delay_width = 0.0
    if has_torques:
        delay, delay_width = speed_delay(robot, logs, payload)
        logs = [replace(log, delay=delay) for log in logs]
    # Tensions from torques need the friction, and the friction needs the radius.
    passes = 1 + (robot.flexible and has_torques)
    for _ in range(passes):
        robot = robot.replace(sources=nominal.sources)
        lengths = fit_lengths(robot, logs, payload)
        estimates = [item for length in lengths for item in length.estimates]
        estimates.sort(key=lambda item: (item.name, item.motors))
        robot = _with_estimates(robot, estimates, source)
        responses = _length_responses(lengths)
        if has_torques:
            samples = drive_samples(robot, logs, payload)
            alternatives = _alternatives(robot, logs, payload, delay_width)
            names = parameter_names(robot)
            values = {name: getattr(robot, name) for name in names}
            drives = fit(
                samples, names, values, alternatives=alternatives, same_winches=same_winches
            )
            estimates += drives.estimates
            robot = _with_estimates(robot, drives.estimates, source)
            responses = _drive_responses(robot, samples, drives) + responses
    if not estimates:
        pose = ", ".join(pose_columns(robot))
        raise ValueError(
            f"{logs[0].name}: no motor has a column torque_1 [N·m] or current_1 [A] for its friction, "
            f"nor angle_1 [rad] with the pose {pose} for its cable length"
        )
    identified = {motor for item in estimates for motor in item.motors}
    return Identification(
        robot=robot,
        unknown_motors=tuple(sorted(set(range(robot.cables)) - identified)),
        questions=tuple(questions(nominal, logs, estimates)),
        uncertainty=_uncertainty(estimates),
        estimates=tuple(estimates),
        responses=tuple(responses),
        logs=tuple(log.file for log in logs),
    )


def _alternatives(
    robot: Robot, logs: Sequence[Log], payload: float, delay_width: float
) -> list[Samples]:
    """Samples of the drives with dry friction, and with the delay of the speeds at the end of its
    interval."""
    speed = robot.transmission.friction_speed
    dry = robot.replace(transmission=robot.transmission.replace(friction_speed=DRY))
    later = [replace(log, delay=log.delay + delay_width) for log in logs]
    return [
        drive_samples(dry, logs, payload, friction_speed=speed),
        drive_samples(robot, later, payload),
    ]


def _length_responses(fits: Sequence[LengthFit]) -> list[Response]:
    """Measured cable lengths and their residuals."""
    responses = []
    for item in fits:
        if len(item.residual):
            response = Response(
                equation=f"length {item.motor + 1}",
                unit="m",
                time=item.samples.time,
                log=item.samples.log,
                measured=item.samples.length,
                residual=item.residual,
            )
            responses.append(response)
    return responses


def _drive_responses(robot: Robot, samples: Samples, drives: WinchFit) -> list[Response]:
    """Measured torques or currents and their residuals, and those of the platform's equations."""
    responses = []
    # The numbers of the platform's equations count downwards from PLATFORM.
    for number in sorted(np.unique(samples.motor).tolist(), key=lambda item: (item < 0, abs(item))):
        rows = samples.motor == number
        equation, unit = f"motor {number + 1}", "N·m"
        if samples.is_current:
            unit = "A"
        if number < 0:
            equation, unit = f"platform {pose_columns(robot)[PLATFORM - number]}", "N"
        response = Response(
            equation=equation,
            unit=unit,
            time=samples.time[rows],
            log=samples.log[rows],
            measured=samples.response[rows],
            residual=drives.residual[rows],
        )
        responses.append(response)
    return responses


def _with_estimates(robot: Robot, estimates: Sequence[ParameterEstimate], source: str) -> Robot:
    """The robot with the determined parameters and their sources, and without their ranges."""
    changes: dict[str, Any] = {}
    sources = dict(robot.sources)
    ranges = dict(robot.ranges)
    determined = [
        item for item in estimates if item.is_determined and item.name not in (CONSTANT, OFFSET)
    ]
    for name in dict.fromkeys(item.name for item in determined):
        items = [item for item in determined if item.name == name]
        field = np.array(getattr(robot, name))
        for item in items:
            field[list(item.motors)] = float(f"{item.value:.6g}")
        changes[name] = tuple(field.tolist())
        if len(set(changes[name])) == 1:
            changes[name] = changes[name][0]
        key = f"transmission.{name}"
        # The interval is in the uncertainty; a range may have one value for all motors only.
        ranges.pop(key, None)
        sources[key] = _source(items, robot.cables, source, sources.get(key, "not identified"))
    transmission = robot.transmission.replace(**changes)
    return robot.replace(transmission=transmission, sources=sources, ranges=ranges)


def _source(items: Sequence[ParameterEstimate], motors: int, source: str, former: str) -> str:
    """Source of the values of all motors, by motors where they differ."""
    texts: dict[str, list[int]] = {}
    for item in items:
        width = 100 * item.half_width / item.value
        text = f"{source}; {100 * CONFIDENCE:g} % interval within ± {width:.2g} %"
        if item.given:
            text += f"; given {item.given}"
        texts.setdefault(text, []).extend(item.motors)
    known = [motor for chosen in texts.values() for motor in chosen]
    others = [motor for motor in range(motors) if motor not in known]
    if others:
        texts[former] = others
    if len(texts) == 1:
        return next(iter(texts))
    return "; ".join(f"{motors_text(chosen)}: {text}" for text, chosen in texts.items())


def motors_text(motors: Sequence[int]) -> str:
    """Motors in words, counted from 1: ``motor 1``, or ``motors 2, 3, 4``."""
    numbers = ", ".join(str(motor + 1) for motor in motors)
    if len(motors) == 1:
        return f"motor {numbers}"
    return f"motors {numbers}"


def _uncertainty(estimates: Sequence[ParameterEstimate]) -> Uncertainty:
    """Relative deviations within the widest interval of each determined parameter."""
    parameters = {}
    for name in PARAMETERS:
        items = [item for item in estimates if item.name == name and item.is_determined]
        if items:
            width = max(float(f"{item.half_width / item.value:.6g}") for item in items)
            parameters[name] = ParameterDistribution(low=-width, high=width, each=len(items) > 1)
    return Uncertainty(parameters=parameters)
