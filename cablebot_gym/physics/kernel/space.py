"""Platforms and point masses in space: kinematics and accelerations of one lane."""

from __future__ import annotations

import math

from cablebot_gym.physics.compiling import fma, inline
from cablebot_gym.physics.kernel.arithmetic import (
    add,
    add_scaled,
    atan2,
    cross,
    dot,
    load_vector,
    scaled,
    sincos,
    store_vector,
    subtract,
    symmetric_times,
)
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
    OMEGA,
    PLATFORM,
    PRODUCTS,
    RATE,
    ROTATION,
    ROW,
    SPIN,
    STAGE,
    STRETCH_PARAMETERS,
    SWIVEL,
    TRIG,
    UNKNOWNS,
    body_row,
    stretch_row,
)


@inline
def _swivelled(lengths, radius, s, v):
    """Direction, length and bend of a cable over a swivel pulley of the signed radius, from the
    anchors' difference s.

    As :class:`kinematics._Swivelled`, in the base frame. The bend (v·n)²/f + (u_h/d)(v·e)² is the
    part of q̈ that comes from the turning of the free length f: in the plane of the pulley, where n
    is normal to the cable, and with the pulley about its axis, where d is the distance from the
    axis and e points sideways. The length is zero if ``lengths`` is False.
    """
    rho = abs(radius)
    side = -1.0 if radius < 0.0 else 1.0  # a select, as in :func:`sincos`
    reach = math.sqrt(s[0] * s[0] + s[1] * s[1])
    per_reach = 1.0 / reach
    height = side * s[2]
    across = reach - rho
    square = across * across + height * height
    free = math.sqrt(square - rho * rho)
    out = (free * across - rho * height) / square
    down = (rho * across + free * height) / square
    x = s[0] * per_reach
    y = s[1] * per_reach
    normal = out * side * v[2] - down * (x * v[0] + y * v[1])
    sideways = x * v[1] - y * v[0]
    bend = normal * normal / free + out * sideways * sideways * per_reach
    length = 0.0
    if lengths:
        length = free + rho * (math.pi + atan2(-out, down))
    return (out * x, out * y, side * down), length, bend


@inline
def _straight(s, v):
    """Direction, length, rate and bend of a cable between anchors that differ by s, with the rate
    v."""
    length = math.sqrt(dot(s, s))
    per_length = 1.0 / length
    u = scaled(per_length, s)
    rate = dot(u, v)
    return u, length, rate, (dot(v, v) - rate * rate) * per_length


@inline
def _to_body(vector, w, at, lanes):
    """Rᵀ vector."""
    return (
        dot(load_vector(w, ROTATION, at, lanes), vector),
        dot(load_vector(w, ROTATION + 3, at, lanes), vector),
        dot(load_vector(w, ROTATION + 6, at, lanes), vector),
    )


@inline
def _to_base(vector, offset, w, at, lanes):
    """offset + R vector."""
    offset = add_scaled(vector[2], load_vector(w, ROTATION + 6, at, lanes), offset)
    offset = add_scaled(vector[1], load_vector(w, ROTATION + 3, at, lanes), offset)
    return add_scaled(vector[0], load_vector(w, ROTATION, at, lanes), offset)


@inline
def _store_cable(lengths, u, length, rate, bias, w, at, lanes, i):
    """Stores direction, length, rate and bias of cable i."""
    row = FIRST_CABLE + CABLE_ROWS * i
    store_vector(w, row + ROW, at, lanes, u)
    if lengths:
        w[(row + LENGTH) * lanes + at] = length
    w[(row + LENGTH_RATE) * lanes + at] = rate
    w[(row + BIAS) * lanes + at] = bias


@inline
def _weight_and_force(p, at, lanes):
    """Weight and external force in the base frame."""
    fx, fy, fz = load_vector(p, FORCE, at, lanes)
    return fx, fy, fma(p[MASS * lanes + at], p[GRAVITY * lanes + at], fz)


@inline
def spatial_platform(form, p, w, at, lanes):
    """Rotation, velocity in the platform frame and the terms without cables, from the state of the
    stage."""
    sx, cx = sincos(w[(STAGE + 3) * lanes + at])
    sy, cy = sincos(w[(STAGE + 4) * lanes + at])
    sz, cz = sincos(w[(STAGE + 5) * lanes + at])
    velocity = load_vector(w, STAGE + 6, at, lanes)
    roll, pitch, yaw = load_vector(w, STAGE + 9, at, lanes)
    # The columns of R
    column0 = (cz * cy, sz * cy, -sy)
    column1 = (cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx)
    column2 = (cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx)
    omega = (roll - sy * yaw, cx * pitch + sx * cy * yaw, cx * cy * yaw - sx * pitch)
    # Ṗ Θ̇, the difference of ω̇ and P Θ̈
    spin = (
        -cy * pitch * yaw,
        -sx * roll * pitch + (cx * cy * roll - sx * sy * pitch) * yaw,
        -cx * roll * pitch - (sx * cy * roll + cx * sy * pitch) * yaw,
    )
    inertia = load_vector(p, INERTIA, at, lanes)
    momentum = (inertia[0] * omega[0], inertia[1] * omega[1], inertia[2] * omega[2])
    body_velocity = (dot(column0, velocity), dot(column1, velocity), dot(column2, velocity))
    if form.lopsided:
        momentum = symmetric_times(inertia_tensor(form, p, at, lanes), omega)
        centre = load_vector(p, body_row(form.cables) + CENTER, at, lanes)
        turning = cross(omega, centre)
        body_velocity = add_scaled(1.0, turning, body_velocity)
        position = add_scaled(centre[2], column2, load_vector(w, STAGE, at, lanes))
        position = add_scaled(centre[1], column1, position)
        store_vector(w, CENTRE, at, lanes, add_scaled(centre[0], column0, position))
    gyro = cross(momentum, omega)
    moment = load_vector(p, MOMENT, at, lanes)
    force = _weight_and_force(p, at, lanes)
    body_force = (dot(column0, force), dot(column1, force), dot(column2, force))
    body_moment = (dot(column0, moment), dot(column1, moment), dot(column2, moment))
    store_vector(w, ROTATION, at, lanes, column0)
    store_vector(w, ROTATION + 3, at, lanes, column1)
    store_vector(w, ROTATION + 6, at, lanes, column2)
    store_vector(w, BODY_VELOCITY, at, lanes, body_velocity)
    store_vector(w, OMEGA, at, lanes, omega)
    store_vector(w, SPIN, at, lanes, spin)
    store_vector(w, LOAD, at, lanes, body_force)
    store_vector(w, LOAD + 3, at, lanes, add(gyro, body_moment))
    store_vector(w, TRIG, at, lanes, (sx, cx, sy))
    w[(TRIG + 3) * lanes + at] = cy


@inline
def inertia_tensor(form, p, at, lanes):
    """Inertia tensor, stored as the matrices of :func:`add_outer`."""
    xx, yy, zz = load_vector(p, INERTIA, at, lanes)
    if form.lopsided:
        xy, xz, yz = load_vector(p, body_row(form.cables) + PRODUCTS, at, lanes)
        return xx, xy, xz, yy, yz, zz
    return xx, 0.0, 0.0, yy, 0.0, zz


@inline
def spatial_cable(form, lengths, p, w, at, lanes, i):
    """Direction, moment arm, length rate and bias of cable i."""
    par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
    b = load_vector(p, par + PLATFORM, at, lanes)
    position_row = STAGE
    if form.lopsided:
        position_row = CENTRE
    omega = load_vector(w, OMEGA, at, lanes)
    d = subtract(load_vector(w, position_row, at, lanes), load_vector(p, par + BASE, at, lanes))
    turning = cross(omega, b)
    point = add(load_vector(w, BODY_VELOCITY, at, lanes), turning)
    if form.swivel:
        more = stretch_row(form.cables, form.lopsided) + STRETCH_PARAMETERS * i
        s = _to_base(b, d, w, at, lanes)
        v = _to_base(point, (0.0, 0.0, 0.0), w, at, lanes)
        u, length, bend = _swivelled(lengths, p[(more + SWIVEL) * lanes + at], s, v)
        u = _to_body(u, w, at, lanes)
        rate = dot(u, point)
    else:
        u, length, rate, bend = _straight(add(_to_body(d, w, at, lanes), b), point)
    bias = dot(u, cross(omega, turning)) + bend
    _store_cable(lengths, u, length, rate, bias, w, at, lanes, i)
    store_vector(w, FIRST_CABLE + CABLE_ROWS * i + ROW + 3, at, lanes, cross(b, u))


@inline
def centre_to_origin(form, sign, y, turn, p, w, at, lanes):
    """y₁ − ω̇ × c − ω × (ω × c), from the centre of mass to the origin of the frame; back with
    ``sign`` −1."""
    if form.lopsided:
        centre = load_vector(p, body_row(form.cables) + CENTER, at, lanes)
        omega = load_vector(w, OMEGA, at, lanes)
        y = add_scaled(-sign, cross(omega, cross(omega, centre)), y)
        y = add_scaled(-sign, cross(turn, centre), y)
    return y


@inline
def spatial_acceleration(form, p, w, at, lanes):
    """Ẍ from y: p̈ = R y₁ less the motion of the centre of mass about the origin, Θ̈ = P⁻¹(ω̇ − Ṗ
    Θ̇)."""
    turn = load_vector(w, UNKNOWNS + 3, at, lanes)
    y = centre_to_origin(form, 1.0, load_vector(w, UNKNOWNS, at, lanes), turn, p, w, at, lanes)
    push = scaled(y[2], load_vector(w, ROTATION + 6, at, lanes))
    push = add_scaled(y[1], load_vector(w, ROTATION + 3, at, lanes), push)
    push = add_scaled(y[0], load_vector(w, ROTATION, at, lanes), push)
    wx, wy, wz = subtract(turn, load_vector(w, SPIN, at, lanes))
    sx, cx, sy = load_vector(w, TRIG, at, lanes)
    yaw = (sx * wy + cx * wz) / w[(TRIG + 3) * lanes + at]
    store_vector(w, RATE, at, lanes, push)
    store_vector(w, RATE + 3, at, lanes, (wx + sy * yaw, cx * wy - sx * wz, yaw))


@inline
def point_load(p, w, at, lanes):
    """Weight and external force of a point mass in space."""
    store_vector(w, LOAD, at, lanes, _weight_and_force(p, at, lanes))


@inline
def point_cable(form, lengths, p, w, at, lanes, i):
    """Direction, length rate and bias of cable i."""
    anchor = load_vector(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE, at, lanes)
    d = subtract(load_vector(w, STAGE, at, lanes), anchor)
    velocity = load_vector(w, STAGE + 6, at, lanes)
    if form.swivel:
        more = stretch_row(form.cables, False) + STRETCH_PARAMETERS * i
        u, length, bend = _swivelled(lengths, p[(more + SWIVEL) * lanes + at], d, velocity)
        rate = dot(u, velocity)
    else:
        u, length, rate, bend = _straight(d, velocity)
    _store_cable(lengths, u, length, rate, bend, w, at, lanes, i)


@inline
def spatial_y(form, p, w, at, lanes):
    """y from Ẍ, the inverse of :func:`spatial_acceleration`: y₁ = Rᵀp̈, ω̇ = P Θ̈ + Ṗ Θ̇."""
    push = load_vector(w, RATE, at, lanes)
    roll, pitch, yaw = load_vector(w, RATE + 3, at, lanes)
    sx, cx, sy = load_vector(w, TRIG, at, lanes)
    level = w[(TRIG + 3) * lanes + at] * yaw
    turn = (roll - sy * yaw, cx * pitch + sx * level, cx * level - sx * pitch)
    turn = add(turn, load_vector(w, SPIN, at, lanes))
    y = centre_to_origin(form, -1.0, _to_body(push, w, at, lanes), turn, p, w, at, lanes)
    store_vector(w, UNKNOWNS, at, lanes, y)
    store_vector(w, UNKNOWNS + 3, at, lanes, turn)
