"""Motors, joint springs and elastic cables of a tile."""

from __future__ import annotations

import math

from cablebot_gym.physics.inlining import inline
from cablebot_gym.physics.kernel.rows import (
    AXIAL_DAMPING,
    AXIAL_STIFFNESS,
    CABLE_PARAMETERS,
    CABLE_RECORDS,
    CABLE_ROWS,
    COULOMB_FRICTION,
    DAMPING_PER_RADIUS2,
    DECAY,
    DEMAND,
    DRIVE,
    EXTRA_LENGTH,
    FIRST_CABLE,
    FIRST_CABLE_PARAMETER,
    FIRST_CABLE_RECORD,
    FREE_TENSION,
    FRICTION_SPEED,
    FULL_LENGTH,
    GAP,
    HOME_LENGTH,
    KNOWN,
    LAG,
    LAGGED,
    LENGTH,
    LENGTH_RATE,
    MOTOR_DAMPING,
    MOTOR_RATE,
    MOTOR_STAGE,
    MOTOR_TORQUE,
    PER_MOTOR_INERTIA,
    PER_PULLEY_INERTIA,
    PER_RADIUS,
    PULLEY_RATE,
    PULLEY_ROWS,
    PULLEY_STAGE,
    RADIUS,
    REQUEST,
    SLOPE,
    SPEED,
    STALL,
    STIFFNESS,
    STRETCH_PARAMETERS,
    TAUT,
    stretch_row,
)


@inline
def twist_springs(form, unilateral, p, w, lanes):
    """Torque of the joint springs on the pulleys, κ = K (β′ − β), and the motors' accelerations
    (Eq. 4).

    With unilateral cables κ = K max(β′ − β, 0): a negative twist is slack cable on the pulley.
    """
    for i in range(form.cables):
        par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
        row = FIRST_CABLE + CABLE_ROWS * i
        for at in range(lanes):
            wound = p[(par + HOME_LENGTH) * lanes + at] - w[(row + LENGTH) * lanes + at]
            angle = wound * p[(par + PER_RADIUS) * lanes + at]
            twist = w[(row + MOTOR_STAGE) * lanes + at] - angle
            twist = max(twist, 0.0) if unilateral else twist
            spring = p[(par + STIFFNESS) * lanes + at] * twist
            friction = (
                p[(par + MOTOR_DAMPING) * lanes + at] * w[(row + MOTOR_STAGE + 1) * lanes + at]
            )
            rest = w[(row + MOTOR_TORQUE) * lanes + at] - spring - friction
            w[(row + DRIVE) * lanes + at] = spring
            w[(row + MOTOR_RATE) * lanes + at] = rest * p[(par + PER_MOTOR_INERTIA) * lanes + at]


@inline
def pulley_row(form, i):
    """Scratch row of pulley i between its joint spring and its elastic cable."""
    return FIRST_CABLE + CABLE_ROWS * form.cables + PULLEY_ROWS * i


@inline
def stretch_cables(form, unilateral, p, w, lanes):
    """Tensions of elastic cables, see :func:`textbook.cable_springs`, and the accelerations of
    pulleys and motors.

    The joint springs push, too: cables that are slack do not hold their pulleys.
    """
    for i in range(form.cables):
        par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
        row = FIRST_CABLE + CABLE_ROWS * i
        more = stretch_row(form.cables, form.lopsided) + STRETCH_PARAMETERS * i
        pulley = pulley_row(form, i) + PULLEY_STAGE if form.jointed else row + MOTOR_STAGE
        for at in range(lanes):
            radius = p[(more + RADIUS) * lanes + at]
            stiffness = p[(more + AXIAL_STIFFNESS) * lanes + at]
            angle = w[pulley * lanes + at]
            speed = w[(pulley + 1) * lanes + at]
            per_free = 1.0 / (p[(more + FULL_LENGTH) * lanes + at] - radius * angle)
            length = w[(row + LENGTH) * lanes + at] + p[(more + EXTRA_LENGTH) * lanes + at]
            strain = length * per_free - 1.0
            rate = (w[(row + LENGTH_RATE) * lanes + at] + radius * speed) * per_free
            tension = stiffness * strain + p[(more + AXIAL_DAMPING) * lanes + at] * rate
            wound = 0.5 * stiffness * strain * strain
            if unilateral:
                tension = 0.0 if strain <= 0.0 else max(tension, 0.0)
                wound = 0.0 if strain <= 0.0 else wound
            w[(row + KNOWN) * lanes + at] = w[(row + FREE_TENSION) * lanes + at] = tension
            w[(row + TAUT) * lanes + at] = 1.0 if tension > 0.0 else 0.0
            damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * radius * radius * speed
            pulling = radius * (tension + wound) + damping
            torque = w[(row + MOTOR_TORQUE) * lanes + at]
            per_inertia = p[(more + PER_PULLEY_INERTIA) * lanes + at]
            if form.jointed:
                twist = p[(par + STIFFNESS) * lanes + at] * (
                    w[(row + MOTOR_STAGE) * lanes + at] - angle
                )
                w[(pulley_row(form, i) + PULLEY_RATE) * lanes + at] = (
                    twist - pulling
                ) * per_inertia
                friction = (
                    p[(par + MOTOR_DAMPING) * lanes + at] * w[(row + MOTOR_STAGE + 1) * lanes + at]
                )
                rest = torque - twist - friction
                w[(row + MOTOR_RATE) * lanes + at] = (
                    rest * p[(par + PER_MOTOR_INERTIA) * lanes + at]
                )
            else:
                w[(row + MOTOR_RATE) * lanes + at] = (torque - pulling) * per_inertia


@inline
def _motor_speed(form, p, w, at, lanes, i):
    if form.flexible:
        return w[(FIRST_CABLE + CABLE_ROWS * i + MOTOR_STAGE + 1) * lanes + at]
    per_radius = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + PER_RADIUS) * lanes + at]
    return -w[(FIRST_CABLE + CABLE_ROWS * i + LENGTH_RATE) * lanes + at] * per_radius


@inline
def request_torques(form, lags, h, p, w, record, lanes):
    """Requested torques of a control period, from the actions within ±1 and the motor speeds at its
    start."""
    for i in range(form.cables):
        par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
        row = FIRST_CABLE + CABLE_ROWS * i
        rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
        for at in range(lanes):
            speed = _motor_speed(form, p, w, at, lanes, i)
            action = min(max(record[(rec + DEMAND) * lanes + at], -1.0), 1.0)
            stall = p[(par + STALL) * lanes + at]
            slope = p[(par + SLOPE) * lanes + at]
            w[(row + REQUEST) * lanes + at] = stall * action - slope * speed
            record[(rec + SPEED) * lanes + at] = speed
        if lags:
            for at in range(lanes):
                lag, gap, decay = p[(par + LAG) * lanes + at], 0.0, 0.0
                if lag > 0.0:
                    gap = record[(rec + LAGGED) * lanes + at] - w[(row + REQUEST) * lanes + at]
                    decay = math.exp(-0.5 * h / lag)
                w[(row + GAP) * lanes + at], w[(row + DECAY) * lanes + at] = gap, decay


@inline
def drive_motors(form, lags, stage, p, w, lanes):
    """Torques of a stage: the requested torque after its lag, clipped to U± at the present motor
    speed."""
    for i in range(form.cables):
        par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
        row = FIRST_CABLE + CABLE_ROWS * i
        if lags and stage in (1, 3):  # the stages are at 0, 1/2, 1/2 and 1 of the step
            for at in range(lanes):
                w[(row + GAP) * lanes + at] *= w[(row + DECAY) * lanes + at]
        for at in range(lanes):
            stall = p[(par + STALL) * lanes + at]
            drop = p[(par + SLOPE) * lanes + at]
            drop *= _motor_speed(form, p, w, at, lanes, i)
            torque = w[(row + REQUEST) * lanes + at]
            if lags:
                torque += w[(row + GAP) * lanes + at]
            torque = min(max(torque, -stall - drop), stall - drop)
            w[(row + (MOTOR_TORQUE if form.flexible else DRIVE)) * lanes + at] = torque


@inline
def coulomb_friction(p, at, lanes, i, speed):
    """Coulomb friction τ_c ω/√(ω² + ω₀²) of motor i."""
    friction = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + COULOMB_FRICTION) * lanes + at]
    smooth = p[FRICTION_SPEED * lanes + at]
    return friction * speed / math.sqrt(speed * speed + smooth * smooth)


@inline
def subtract_friction(form, p, w, lanes):
    """Subtracts the Coulomb friction from the motor torques."""
    for i in range(form.cables):
        row = FIRST_CABLE + CABLE_ROWS * i + (MOTOR_TORQUE if form.flexible else DRIVE)
        for at in range(lanes):
            w[row * lanes + at] -= coulomb_friction(
                p, at, lanes, i, _motor_speed(form, p, w, at, lanes, i)
            )
