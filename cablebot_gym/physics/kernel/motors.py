"""Motors, joint springs and elastic cables of a tile."""

from __future__ import annotations

import math

from cablebot_gym.physics.compiling import inline
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
    GRIP,
    HOME_LENGTH,
    KNOWN,
    LAG,
    LAGGED,
    LENGTH,
    LENGTH_RATE,
    LOAD_FRICTION,
    MOTOR_DAMPING,
    MOTOR_RATE,
    MOTOR_STAGE,
    MOTOR_TORQUE,
    PER_MOTOR_INERTIA,
    PER_PULLEY_INERTIA,
    PER_RADIUS,
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
            if unilateral:
                twist = max(twist, 0.0)
            spring = p[(par + STIFFNESS) * lanes + at] * twist
            w[(row + DRIVE) * lanes + at] = spring
            speed = w[(row + MOTOR_STAGE + 1) * lanes + at]
            friction = p[(par + MOTOR_DAMPING) * lanes + at] * speed
            if form.load_friction:
                friction += load_friction(form, p, at, lanes, i, speed) * abs(spring)
            net_torque = w[(row + MOTOR_TORQUE) * lanes + at] - spring - friction
            per_inertia = p[(par + PER_MOTOR_INERTIA) * lanes + at]
            w[(row + MOTOR_RATE) * lanes + at] = net_torque * per_inertia


@inline
def torque_row(form):
    """Row of the motor torque of a cable: that on the pulley if the transmission is rigid."""
    if form.flexible:
        return MOTOR_TORQUE
    return DRIVE


@inline
def stretch_cables(form, unilateral, p, w, lanes):
    """Tensions of elastic cables, see :func:`textbook.cable_springs`, and the accelerations of their
    pulleys, which turn with the motors."""
    for i in range(form.cables):
        par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
        row = FIRST_CABLE + CABLE_ROWS * i
        more = stretch_row(form.cables, form.lopsided) + STRETCH_PARAMETERS * i
        pulley = row + MOTOR_STAGE
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
            if unilateral:  # selects, as in :func:`sincos`
                tension = 0.0 if strain <= 0.0 else max(tension, 0.0)
                wound = 0.0 if strain <= 0.0 else wound
            w[(row + KNOWN) * lanes + at] = tension
            w[(row + FREE_TENSION) * lanes + at] = tension
            w[(row + TAUT) * lanes + at] = 1.0 if tension > 0.0 else 0.0
            damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * radius * radius * speed
            pulling = radius * (tension + wound) + damping
            per_inertia = p[(more + PER_PULLEY_INERTIA) * lanes + at]
            net_torque = w[(row + MOTOR_TORQUE) * lanes + at] - pulling
            if form.load_friction:
                share = load_friction(form, p, at, lanes, i, speed)
                net_torque -= share * abs(radius * (tension + wound))
            w[(row + MOTOR_RATE) * lanes + at] = net_torque * per_inertia


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
                lag = p[(par + LAG) * lanes + at]
                gap, decay = 0.0, 0.0
                if lag > 0.0:
                    gap = record[(rec + LAGGED) * lanes + at] - w[(row + REQUEST) * lanes + at]
                    decay = math.exp(-0.5 * h / lag)
                w[(row + GAP) * lanes + at] = gap
                w[(row + DECAY) * lanes + at] = decay


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
            drop = p[(par + SLOPE) * lanes + at] * _motor_speed(form, p, w, at, lanes, i)
            torque = w[(row + REQUEST) * lanes + at]
            if lags:
                torque += w[(row + GAP) * lanes + at]
            torque = min(max(torque, -stall - drop), stall - drop)
            w[(row + torque_row(form)) * lanes + at] = torque


@inline
def coulomb_friction(p, at, lanes, i, speed):
    """Coulomb friction τ_c ω/√(ω² + ω₀²) of motor i."""
    friction = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + COULOMB_FRICTION) * lanes + at]
    smooth = p[FRICTION_SPEED * lanes + at]
    return friction * speed / math.sqrt(speed * speed + smooth * smooth)


@inline
def load_friction(form, p, at, lanes, i, speed):
    """Load friction of motor i over its load, μ ω/√(ω² + ω₀²)."""
    more = stretch_row(form.cables, form.lopsided) + STRETCH_PARAMETERS * i
    smooth = p[FRICTION_SPEED * lanes + at]
    share = p[(more + LOAD_FRICTION) * lanes + at]
    return share * speed / math.sqrt(speed * speed + smooth * smooth)


@inline
def subtract_friction(form, p, w, lanes):
    """Subtracts the Coulomb friction from the motor torques."""
    for i in range(form.cables):
        row = FIRST_CABLE + CABLE_ROWS * i + torque_row(form)
        for at in range(lanes):
            speed = _motor_speed(form, p, w, at, lanes, i)
            w[row * lanes + at] -= coulomb_friction(p, at, lanes, i, speed)


@inline
def grip_cables(form, p, w, lanes):
    """Stores r T over the torque that the tension takes from the motor, 1/(1 + μ ω/√(ω² + ω₀²))."""
    for i in range(form.cables):
        for at in range(lanes):
            speed = _motor_speed(form, p, w, at, lanes, i)
            share = load_friction(form, p, at, lanes, i, speed)
            w[(FIRST_CABLE + CABLE_ROWS * i + GRIP) * lanes + at] = 1.0 / (1.0 + share)
