"""Platforms and point masses in a plane: kinematics and accelerations of one lane."""

from __future__ import annotations

import math

from cablebot_gym.physics.compiling import inline
from cablebot_gym.physics.kernel.arithmetic import sincos
from cablebot_gym.physics.kernel.rows import (
    BASE,
    BIAS,
    BODY_VELOCITY,
    CABLE_PARAMETERS,
    CABLE_ROWS,
    CENTER,
    CENTRE,
    FIRST_CABLE,
    FIRST_CABLE_PARAMETER,
    FORCE,
    GRAVITY,
    INERTIA,
    LENGTH,
    LENGTH_RATE,
    LOAD,
    MASS,
    MOMENT,
    PLATFORM,
    ROW,
    STAGE,
    TRIG,
    body_row,
)


@inline
def _straight_cable(dx, dy, vx, vy, w, at, lanes, i):
    """Stores direction, length, rate and bend of cable i, from the difference of its ends and its
    rate."""
    length = math.sqrt(dx * dx + dy * dy)
    per_length = 1.0 / length
    ux = dx * per_length
    uy = dy * per_length
    rate = ux * vx + uy * vy
    row = FIRST_CABLE + CABLE_ROWS * i
    w[(row + ROW) * lanes + at] = ux
    w[(row + ROW + 1) * lanes + at] = uy
    w[(row + LENGTH) * lanes + at] = length
    w[(row + LENGTH_RATE) * lanes + at] = rate
    w[(row + BIAS) * lanes + at] = (vx * vx + vy * vy - rate * rate) * per_length
    return ux, uy


@inline
def planar_cable(p, w, at, lanes, i):
    """Direction, length rate and bias of cable i. The row is (u, 0) instead of (u, n)."""
    par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE
    dx = w[STAGE * lanes + at] - p[par * lanes + at]
    dy = w[(STAGE + 1) * lanes + at] - p[(par + 1) * lanes + at]
    vx = w[(STAGE + 6) * lanes + at]
    vy = w[(STAGE + 7) * lanes + at]
    _straight_cable(dx, dy, vx, vy, w, at, lanes, i)


@inline
def plane_platform(form, p, w, at, lanes):
    """Sine and cosine of φ, motion of the centre of mass, and the terms without cables. Gravity
    acts along y."""
    sine, cosine = sincos(w[(STAGE + 2) * lanes + at])
    omega = w[(STAGE + 8) * lanes + at]
    row = body_row(form.cables) + CENTER
    cx = p[row * lanes + at]
    cy = p[(row + 1) * lanes + at]
    sx = cosine * cx - sine * cy
    sy = sine * cx + cosine * cy
    w[TRIG * lanes + at] = sine
    w[(TRIG + 1) * lanes + at] = cosine
    w[CENTRE * lanes + at] = sx
    w[(CENTRE + 1) * lanes + at] = sy
    w[BODY_VELOCITY * lanes + at] = w[(STAGE + 6) * lanes + at] - omega * sy
    w[(BODY_VELOCITY + 1) * lanes + at] = w[(STAGE + 7) * lanes + at] + omega * sx
    w[LOAD * lanes + at] = p[FORCE * lanes + at]
    weight = p[MASS * lanes + at] * p[GRAVITY * lanes + at]
    w[(LOAD + 1) * lanes + at] = weight + p[(FORCE + 1) * lanes + at]
    w[(LOAD + 2) * lanes + at] = p[(MOMENT + 2) * lanes + at]


@inline
def plane_cable(p, w, at, lanes, i):
    """Direction, moment arm, length rate and bias of cable i, in the base frame."""
    par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
    bx = p[(par + PLATFORM) * lanes + at]
    by = p[(par + PLATFORM + 1) * lanes + at]
    sine = w[TRIG * lanes + at]
    cosine = w[(TRIG + 1) * lanes + at]
    omega = w[(STAGE + 8) * lanes + at]
    ax = cosine * bx - sine * by
    ay = sine * bx + cosine * by
    x = w[STAGE * lanes + at] + w[CENTRE * lanes + at] + ax
    y = w[(STAGE + 1) * lanes + at] + w[(CENTRE + 1) * lanes + at] + ay
    dx = x - p[(par + BASE) * lanes + at]
    dy = y - p[(par + BASE + 1) * lanes + at]
    vx = w[BODY_VELOCITY * lanes + at] - omega * ay
    vy = w[(BODY_VELOCITY + 1) * lanes + at] + omega * ax
    ux, uy = _straight_cable(dx, dy, vx, vy, w, at, lanes, i)
    row = FIRST_CABLE + CABLE_ROWS * i
    w[(row + ROW + 2) * lanes + at] = ax * uy - ay * ux
    w[(row + BIAS) * lanes + at] -= omega * omega * (ux * ax + uy * ay)  # centripetal


@inline
def three_masses(form, p, at, lanes):
    """Diagonal of the mass matrix: (m, m, m) of a point mass, (m, m, I_zz) of a platform in a
    plane."""
    mass = p[MASS * lanes + at]
    if form.dimensions == 2:
        return mass, mass, p[(INERTIA + 2) * lanes + at]
    return mass, mass, mass


@inline
def plane_acceleration(sign, row, target, w, at, lanes):
    """Ẍ in ``target`` from y in ``row``, from the centre of mass to the origin of the frame; back
    with ``sign`` −1."""
    sx = w[CENTRE * lanes + at]
    sy = w[(CENTRE + 1) * lanes + at]
    omega = w[(STAGE + 8) * lanes + at]
    turn = w[(row + 2) * lanes + at]
    square = omega * omega
    w[target * lanes + at] = w[row * lanes + at] + sign * (turn * sy + square * sx)
    w[(target + 1) * lanes + at] = w[(row + 1) * lanes + at] - sign * (turn * sx - square * sy)
    w[(target + 2) * lanes + at] = turn
