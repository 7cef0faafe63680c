"""Samples of the drive equation from logs: response = (known torque + Σ regressor · parameter)/k_t.

The equation of a motor is ``τ = L + J β̈ + c β̇ + τ_c σ + μ L σ`` with the load L, which is r T of a
rigid transmission, and the smooth direction of motion σ. k_t is 1 for logs of torques.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_winches.identification.log import CUT, SMOOTHING, Log, Segment, pose_columns

BLOCKS = 40
"""Number of blocks in time over all logs. Errors of different blocks count as independent; a log
has at least one block."""

PLATFORM = -1
"""``motor`` of the first equation of the platform, which has the torques of all motors. Those of
the further coordinates follow below it: a negative ``motor`` is an equation of the platform."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Samples of N instants, which smoothing has made dependent within their block."""

    response: Array
    """Measured torques [N·m] or currents [A], (N,)."""
    known: Array
    """Torque that needs no parameter, (N,) [N·m]."""
    regressors: Array
    """Factors of the :func:`parameter_names` of each motor, (N, m, 4)."""
    motor: NDArray[np.int64]
    """Index of the motor, or :data:`PLATFORM` less the index of a coordinate, (N,)."""
    block: NDArray[np.int64]
    """Number of the block, (N,)."""
    is_current: bool
    """Whether the responses are currents."""
    time: Array
    """Times, (N,) [s]."""
    log: NDArray[np.int64]
    """Index of the log, (N,)."""


def parameter_names(robot: Robot) -> tuple[str, ...]:
    """Fields of the transmission that the drive equation has, in the order of the regressors."""
    if robot.jointed:
        return "motor_inertia", "motor_damping", "coulomb_friction", "load_friction"
    return "pulley_inertia", "damping", "coulomb_friction", "load_friction"


def drive_samples(
    robot: Robot,
    logs: Sequence[Log],
    payload: float = 0.0,
    *,
    friction_speed: float | None = None,
) -> Samples:
    """Samples of all logs: of single winches with known loads, or of a platform with measured
    poses.

    Args:
        robot: robot with geometry, masses and radii.
        logs: logs.
        payload: payload of logs without a column for it [kg].
        friction_speed: speed that selects the samples, see :meth:`Segment.moves`. The default is
            that of the robot.

    Raises:
        ValueError: if a log has not what an equation needs.
    """
    quantities = set()
    for log in logs:
        quantities |= {f"current_{motor + 1}" in log.columns for motor in log.motors()}
    if len(quantities) == 2:
        raise ValueError(
            "some motors have torques and others currents: identify them in separate commands"
        )
    if friction_speed is None:
        friction_speed = robot.transmission.friction_speed
    pieces: list[_Piece] = []
    for number, log in enumerate(logs):
        if not log.motors():
            continue
        if has_pose(robot, log):
            pieces += _platform_pieces(robot, log, number, payload, friction_speed)
        else:
            pieces += _winch_pieces(robot, log, number, friction_speed)
    if not any(len(piece.motor) for piece in pieces):
        window = 2 * CUT * SMOOTHING
        raise ValueError(
            f"no motor moves: each needs speeds above {friction_speed:g} rad/s, the friction_speed of "
            f"{robot.name!r}, throughout {1000 * window:.0f} ms. Log a motion, or lower friction_speed"
        )
    joined = _Piece(*(np.concatenate(values) for values in zip(*map(_fields, pieces), strict=True)))
    return Samples(
        response=joined.response,
        known=joined.known,
        regressors=joined.regressors,
        motor=joined.motor,
        block=blocks(joined.log, joined.time),
        is_current=quantities.pop(),
        time=joined.time,
        log=joined.log,
    )


def has_pose(robot: Robot, log: Log) -> bool:
    """Whether a log has the pose of the platform. A part of its columns is an error."""
    columns = pose_columns(robot)
    if not any(column in log.columns for column in columns):
        return False
    log.require(*columns, purpose="the pose")
    return True


def platform_motion(robot: Robot, segment: Segment) -> tuple[Array, Array, Array]:
    """Smooth pose, velocity and acceleration, each (K, n)."""
    columns = pose_columns(robot)
    pose, velocity, acceleration = (
        np.stack([segment.smooth(column, order) for column in columns], axis=1)
        for order in range(3)
    )
    return pose, velocity, acceleration


def platform_mass(robot: Robot, segment: Segment, payload: float) -> float | Array:
    """Mass of platform and payload [kg], (K,) with a column for the payload."""
    if "payload" in segment.columns:
        return robot.mass + segment.smooth("payload")
    return robot.mass + payload


def load_torque(
    robot: Robot, motor: int, tension: Array, speed: Array, acceleration: Array
) -> Array:
    """Load L of a motor [N·m], (K,): r T of a rigid transmission; with elastic cables also what
    they wind up, and with joint springs inertia and damping of the pulley."""
    still = robot.pulley_radius * tension[:, None]
    torque: Array = textbook.holding_torque(robot, still)[:, motor]
    if robot.jointed:
        torque = torque + robot.pulley_inertia[motor] * acceleration + robot.damping[motor] * speed
    return torque


def tension_from_torque(
    robot: Robot, motor: int, torque: Array, speed: Array, acceleration: Array
) -> Array:
    """Cable tension [N], (K,): the inverse of the drive equation with the friction and inertia of
    the robot."""
    parameters = [getattr(robot, name)[motor] for name in parameter_names(robot)]
    factors = drive_factors(robot, speed, acceleration, np.ones(len(speed)))
    load = torque - factors[:, :-1] @ parameters[:-1]
    load = load / (1 + factors[:, -1] * parameters[-1])
    if robot.jointed:
        load = load - robot.pulley_inertia[motor] * acceleration - robot.damping[motor] * speed
    pulling: Array = load / robot.pulley_radius[motor]
    if robot.elastic:
        # The root of T (1 + T/(2 EA)) = pulling that is near it.
        pulling = 2 * pulling / (1 + np.sqrt(1 + 2 * pulling / robot.axial_stiffness[motor]))
    return pulling


@dataclass(frozen=True, eq=False)
class _Piece:
    """Samples of a stretch of a log, with their times and the number of the log."""

    response: Array
    known: Array
    regressors: Array
    motor: NDArray[np.int64]
    time: Array
    log: NDArray[np.int64]


def _fields(piece: _Piece) -> tuple[Array, ...]:
    return tuple(vars(piece).values())


def _winch_pieces(robot: Robot, log: Log, number: int, friction_speed: float) -> list[_Piece]:
    """Samples of a log of winches with hanging masses or measured tensions."""
    pieces = []
    for motor in log.motors():
        load, tension = f"load_{motor + 1}", f"tension_{motor + 1}"
        if tension not in log.columns and load not in log.columns:
            pose = ", ".join(pose_columns(robot))
            raise ValueError(
                f"{log.name}: the tension of cable {motor + 1} is unknown; add {load} [kg] of a "
                f"hanging mass, {tension} [N], or the pose of the platform, {pose}"
            )
        source = tension if tension in log.columns else load
        for segment in log.segments([*drive_columns(log, motor), source]):
            pull = segment.smooth(source)
            if source == load:
                _, acceleration = segment.motion(motor)
                pull = pull * (robot.gravity + robot.pulley_radius[motor] * acceleration)
            pieces.append(_motor_piece(robot, segment, number, motor, friction_speed, pull))
    return pieces


def _platform_pieces(
    robot: Robot, log: Log, number: int, payload: float, friction_speed: float
) -> list[_Piece]:
    """Samples of a log of a platform: tensions from load cells or, with as many cables as
    coordinates, from the inverse dynamics; otherwise the equations of the platform."""
    motors = log.motors()
    columns = pose_columns(robot)
    for motor in motors:
        columns += drive_columns(log, motor)
    if "payload" in log.columns:
        columns.append("payload")
    cells = [f"tension_{motor + 1}" for motor in motors]
    is_measured = all(cell in log.columns for cell in cells)
    if is_measured:
        columns += cells
    is_unique = robot.cables == robot.coordinates
    if not is_measured and not is_unique:
        _check_projection(robot, log)
    pieces = []
    for segment in log.segments(columns):
        mass = platform_mass(robot, segment, payload)
        pose, velocity, acceleration = platform_motion(robot, segment)
        if not is_measured and not is_unique:
            wrench = textbook.load(robot, mass, pose, velocity, acceleration)
            pieces.append(_platform_piece(robot, segment, number, friction_speed, pose, wrench))
            continue
        tensions = None
        if not is_measured:
            tensions = textbook.required_tensions(robot, mass, pose, velocity, acceleration)
        for motor, cell in zip(motors, cells, strict=True):
            tension = segment.smooth(cell) if tensions is None else tensions[:, motor]
            pieces.append(_motor_piece(robot, segment, number, motor, friction_speed, tension))
    return pieces


def _check_projection(robot: Robot, log: Log) -> None:
    """Checks that the equations of the platform are linear in the parameters and complete."""
    cells = [f"tension_{motor + 1}" for motor in range(robot.cables)]
    if robot.cables < robot.coordinates:
        log.require(*cells, purpose="a robot with fewer cables than coordinates")
    if robot.jointed:
        log.require(*cells, purpose="a robot with joint springs and redundant cables")
    torques = [f"torque_{motor + 1}" for motor in range(robot.cables)]
    log.require(*torques, purpose="a robot with more cables than coordinates and no load cells")


def drive_columns(log: Log, motor: int) -> list[str]:
    """Columns of response and motion of a motor."""
    motion = f"speed_{motor + 1}"
    if motion not in log.columns:
        motion = f"angle_{motor + 1}"
        if motion not in log.columns:
            log.require(f"speed_{motor + 1}", purpose=f"motor {motor + 1}")
    response = f"torque_{motor + 1}"
    if response not in log.columns:
        response = f"current_{motor + 1}"
    return [motion, response]


def drive_factors(robot: Robot, speed: Array, acceleration: Array, load: Array) -> Array:
    """Factors of the parameters, (..., 4)."""
    direction = _direction(robot, speed)
    return np.stack([acceleration, speed, direction, direction * np.abs(load)], axis=-1)


def _direction(robot: Robot, speed: Array) -> Array:
    """Smooth direction of motion σ."""
    direction: Array = speed / textbook.smooth_magnitude(robot, speed)
    return direction


def _motor_piece(
    robot: Robot, segment: Segment, number: int, motor: int, friction_speed: float, tension: Array
) -> _Piece:
    """Samples of one motor where it moves."""
    speed, acceleration = segment.motion(motor)
    response = "torque"
    if f"torque_{motor + 1}" not in segment.columns:
        response = "current"
    load = load_torque(robot, motor, tension, speed, acceleration)
    regressors = np.zeros((len(load), robot.cables, 4))
    regressors[:, motor] = drive_factors(robot, speed, acceleration, load)
    moves = segment.moves(motor, friction_speed)
    return _Piece(
        segment.smooth(f"{response}_{motor + 1}")[moves],
        load[moves],
        regressors[moves],
        np.full(np.count_nonzero(moves), motor),
        segment.smooth("time")[moves],
        np.full(np.count_nonzero(moves), number),
    )


def _platform_piece(
    robot: Robot, segment: Segment, number: int, friction_speed: float, pose: Array, wrench: Array
) -> _Piece:
    """Samples of the equations of the platform, ``Sᵀ T = −w`` with the tensions ``T = (τ − friction
    − inertia)/r'``.

    r' has the load friction of the robot, ``r' = r (1 + μ σ) (1 + ε/2)``. The tensions of redundant
    cables are unknown and have no part in these equations.
    """
    jacobian = textbook.jacobian(robot, pose)
    # Moments become forces at the platform anchors.
    span = max(float(np.max(np.abs(robot.platform))), 1e-3)
    scale = np.where(np.arange(robot.coordinates) < robot.dimensions, 1.0, 1 / span)
    responses = []
    factors = []
    moves = np.ones(len(pose), bool)
    for motor in range(robot.cables):
        speed, acceleration = segment.motion(motor)
        torque = segment.smooth(f"torque_{motor + 1}")
        per_load = robot.load_friction[motor] * _direction(robot, speed)
        radius = robot.pulley_radius[motor] * (1 + per_load)
        if robot.elastic:
            tension = tension_from_torque(robot, motor, torque, speed, acceleration)
            radius = radius * (1 + tension / robot.axial_stiffness[motor] / 2)
        pull = jacobian[:, motor] * scale / radius[:, None]
        responses.append(pull * torque[:, None])
        without_load = drive_factors(robot, speed, acceleration, np.zeros(len(speed)))
        factors.append(pull[:, :, None] * without_load[:, None])
        moves &= segment.moves(motor, friction_speed)
    instants = np.count_nonzero(moves)
    rows = instants * robot.coordinates
    regressors = np.stack(factors, axis=2)[moves]
    return _Piece(
        np.sum(responses, axis=0)[moves].ravel(),
        (-wrench * scale)[moves].ravel(),
        regressors.reshape(rows, *regressors.shape[2:]),
        np.tile(PLATFORM - np.arange(robot.coordinates), instants),
        np.repeat(segment.smooth("time")[moves], robot.coordinates),
        np.full(rows, number),
    )


def blocks(log: NDArray[np.int64], time: Array) -> NDArray[np.int64]:
    """Number of the block of each sample, the same for all motors at an instant."""
    spans = []
    for number in np.unique(log):
        spans.append(np.ptp(time[log == number]))
    duration = max(sum(spans) / BLOCKS, 1e-9)
    block = np.zeros(len(time), np.int64)
    first = 0
    for number, span in zip(np.unique(log), spans, strict=True):
        chosen = log == number
        count = max(1, round(span / duration))
        progress = (time[chosen] - time[chosen].min()) / max(span, 1e-9)
        block[chosen] = first + np.minimum(progress * count, count - 1).astype(np.int64)
        first += count
    return block
