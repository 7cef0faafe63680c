"""Platforms and point masses in space: kinematics and accelerations of one lane."""

from __future__ import annotations

import math

from cablebot_gym.physics.inlining import inline
from cablebot_gym.physics.kernel.arithmetic import (
    add_scaled,
    atan2,
    cross,
    dot,
    fma,
    load_vector,
    sincos,
    store_vector,
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
    rho, side = abs(radius), -1.0 if radius < 0.0 else 1.0
    reach = math.sqrt(s[0] * s[0] + s[1] * s[1])
    per_reach = 1.0 / reach
    height, across = side * s[2], reach - rho
    square = across * across + height * height
    free = math.sqrt(square - rho * rho)
    out = (free * across - rho * height) / square
    down = (rho * across + free * height) / square
    x, y = s[0] * per_reach, s[1] * per_reach
    normal = out * side * v[2] - down * (x * v[0] + y * v[1])
    sideways = x * v[1] - y * v[0]
    bend = normal * normal / free + out * sideways * sideways * per_reach
    length = 0.0
    if lengths:
        length = free + rho * (math.pi + atan2(-out, down))
    return (out * x, out * y, side * down), length, bend


@inline
def spatial_platform(form, p, w, at, lanes):
    """Rotation, velocity in the platform frame and the terms without cables, from the state of the
    stage."""
    sx, cx = sincos(w[(STAGE + 3) * lanes + at])
    sy, cy = sincos(w[(STAGE + 4) * lanes + at])
    sz, cz = sincos(w[(STAGE + 5) * lanes + at])
    velocity = load_vector(w, STAGE + 6, at, lanes)
    roll, pitch, yaw = load_vector(w, STAGE + 9, at, lanes)
    first = (cz * cy, sz * cy, -sy)  # the columns of R
    second = (cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx)
    third = (cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx)
    omega = (roll - sy * yaw, cx * pitch + sx * cy * yaw, cx * cy * yaw - sx * pitch)
    # Ṗ Θ̇, the difference of ω̇ and P Θ̈
    spin = (
        -cy * pitch * yaw,
        -sx * roll * pitch + (cx * cy * roll - sx * sy * pitch) * yaw,
        -cx * roll * pitch - (sx * cy * roll + cx * sy * pitch) * yaw,
    )
    inertia = load_vector(p, INERTIA, at, lanes)
    momentum = (inertia[0] * omega[0], inertia[1] * omega[1], inertia[2] * omega[2])
    body_velocity = (dot(first, velocity), dot(second, velocity), dot(third, velocity))
    if form.lopsided:
        momentum = symmetric_times(inertia_tensor(form, p, at, lanes), omega)
        centre = load_vector(p, body_row(form.cables) + CENTER, at, lanes)
        turning = cross(omega, centre)
        body_velocity = add_scaled(1.0, turning, body_velocity)
        position = add_scaled(centre[2], third, load_vector(w, STAGE, at, lanes))
        store_vector(
            w,
            CENTRE,
            at,
            lanes,
            add_scaled(centre[0], first, add_scaled(centre[1], second, position)),
        )
    gyro = cross(momentum, omega)
    push = load_vector(p, FORCE, at, lanes)
    moment = load_vector(p, MOMENT, at, lanes)
    force = (push[0], push[1], fma(p[MASS * lanes + at], p[GRAVITY * lanes + at], push[2]))
    store_vector(w, ROTATION, at, lanes, first)
    store_vector(w, ROTATION + 3, at, lanes, second)
    store_vector(w, ROTATION + 6, at, lanes, third)
    store_vector(w, BODY_VELOCITY, at, lanes, body_velocity)
    store_vector(w, OMEGA, at, lanes, omega)
    store_vector(w, SPIN, at, lanes, spin)
    store_vector(w, LOAD, at, lanes, (dot(first, force), dot(second, force), dot(third, force)))
    store_vector(
        w,
        LOAD + 3,
        at,
        lanes,
        (gyro[0] + dot(first, moment), gyro[1] + dot(second, moment), gyro[2] + dot(third, moment)),
    )
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
def _to_base(vector, offset, w, at, lanes):
    """offset + R vector."""
    first = load_vector(w, ROTATION, at, lanes)
    second = load_vector(w, ROTATION + 3, at, lanes)
    third = load_vector(w, ROTATION + 6, at, lanes)
    return add_scaled(
        vector[0], first, add_scaled(vector[1], second, add_scaled(vector[2], third, offset))
    )


@inline
def spatial_cable(form, lengths, p, w, at, lanes, i):
    """Direction, moment arm, length rate and bias of cable i."""
    anchor = load_vector(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE, at, lanes)
    b = load_vector(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + PLATFORM, at, lanes)
    position = load_vector(w, CENTRE if form.lopsided else STAGE, at, lanes)
    omega = load_vector(w, OMEGA, at, lanes)
    velocity = load_vector(w, BODY_VELOCITY, at, lanes)
    d = (position[0] - anchor[0], position[1] - anchor[1], position[2] - anchor[2])
    turning = cross(omega, b)
    point = (velocity[0] + turning[0], velocity[1] + turning[1], velocity[2] + turning[2])
    if form.swivel:
        radius = p[
            (stretch_row(form.cables, form.lopsided) + STRETCH_PARAMETERS * i + SWIVEL) * lanes + at
        ]
        s = _to_base(b, d, w, at, lanes)
        v = _to_base(point, (0.0, 0.0, 0.0), w, at, lanes)
        u, length, bend = _swivelled(lengths, radius, s, v)
        u = (
            dot(load_vector(w, ROTATION, at, lanes), u),
            dot(load_vector(w, ROTATION + 3, at, lanes), u),
            dot(load_vector(w, ROTATION + 6, at, lanes), u),
        )
        rate = dot(u, point)
    else:
        s = (
            dot(load_vector(w, ROTATION, at, lanes), d) + b[0],
            dot(load_vector(w, ROTATION + 3, at, lanes), d) + b[1],
            dot(load_vector(w, ROTATION + 6, at, lanes), d) + b[2],
        )
        length = math.sqrt(dot(s, s))
        per_length = 1.0 / length
        u = (s[0] * per_length, s[1] * per_length, s[2] * per_length)
        rate = dot(u, point)
        bend = (dot(point, point) - rate * rate) * per_length
    bias = dot(u, cross(omega, turning)) + bend
    row = FIRST_CABLE + CABLE_ROWS * i
    store_vector(w, row + ROW, at, lanes, u)
    store_vector(w, row + ROW + 3, at, lanes, cross(b, u))
    if lengths:
        w[(row + LENGTH) * lanes + at] = length
    w[(row + LENGTH_RATE) * lanes + at] = rate
    w[(row + BIAS) * lanes + at] = bias


@inline
def centre_to_origin(form, sign, y, turn, p, w, at, lanes):
    """y₁ − ω̇ × c − ω × (ω × c), from the centre of mass to the origin of the frame; back with
    ``sign`` −1."""
    if form.lopsided:
        centre = load_vector(p, body_row(form.cables) + CENTER, at, lanes)
        omega = load_vector(w, OMEGA, at, lanes)
        y = add_scaled(
            -sign, cross(turn, centre), add_scaled(-sign, cross(omega, cross(omega, centre)), y)
        )
    return y


@inline
def spatial_acceleration(form, p, w, at, lanes):
    """Ẍ from y: p̈ = R y₁ less the motion of the centre of mass about the origin, Θ̈ = P⁻¹(ω̇ − Ṗ
    Θ̇)."""
    first = load_vector(w, ROTATION, at, lanes)
    second = load_vector(w, ROTATION + 3, at, lanes)
    third = load_vector(w, ROTATION + 6, at, lanes)
    turn = load_vector(w, UNKNOWNS + 3, at, lanes)
    spin = load_vector(w, SPIN, at, lanes)
    y = centre_to_origin(form, 1.0, load_vector(w, UNKNOWNS, at, lanes), turn, p, w, at, lanes)
    x = turn[0] - spin[0]
    y_ = turn[1] - spin[1]
    z = turn[2] - spin[2]
    sx, cx, sy = load_vector(w, TRIG, at, lanes)
    yaw = (sx * y_ + cx * z) / w[(TRIG + 3) * lanes + at]
    store_vector(
        w,
        RATE,
        at,
        lanes,
        add_scaled(
            y[0],
            first,
            add_scaled(y[1], second, (third[0] * y[2], third[1] * y[2], third[2] * y[2])),
        ),
    )
    store_vector(w, RATE + 3, at, lanes, (x + sy * yaw, cx * y_ - sx * z, yaw))


@inline
def point_load(p, w, at, lanes):
    """Weight and external force of a point mass in space."""
    push = load_vector(p, FORCE, at, lanes)
    store_vector(
        w,
        LOAD,
        at,
        lanes,
        (push[0], push[1], fma(p[MASS * lanes + at], p[GRAVITY * lanes + at], push[2])),
    )


@inline
def point_cable(form, lengths, p, w, at, lanes, i):
    """Direction, length rate and bias of cable i."""
    anchor = load_vector(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE, at, lanes)
    position = load_vector(w, STAGE, at, lanes)
    velocity = load_vector(w, STAGE + 6, at, lanes)
    d = (position[0] - anchor[0], position[1] - anchor[1], position[2] - anchor[2])
    if form.swivel:
        radius = p[(stretch_row(form.cables, False) + STRETCH_PARAMETERS * i + SWIVEL) * lanes + at]
        u, length, bend = _swivelled(lengths, radius, d, velocity)
        rate = dot(u, velocity)
    else:
        length = math.sqrt(dot(d, d))
        per_length = 1.0 / length
        u = (d[0] * per_length, d[1] * per_length, d[2] * per_length)
        rate = dot(u, velocity)
        bend = (dot(velocity, velocity) - rate * rate) * per_length
    row = FIRST_CABLE + CABLE_ROWS * i
    store_vector(w, row + ROW, at, lanes, u)
    if lengths:
        w[(row + LENGTH) * lanes + at] = length
    w[(row + LENGTH_RATE) * lanes + at] = rate
    w[(row + BIAS) * lanes + at] = bend


@inline
def spatial_y(form, p, w, at, lanes):
    """y from Ẍ, the inverse of :func:`spatial_acceleration`: y₁ = Rᵀp̈, ω̇ = P Θ̈ + Ṗ Θ̇."""
    push = load_vector(w, RATE, at, lanes)
    roll, pitch, yaw = load_vector(w, RATE + 3, at, lanes)
    spin = load_vector(w, SPIN, at, lanes)
    sx, cx, sy = load_vector(w, TRIG, at, lanes)
    level = w[(TRIG + 3) * lanes + at] * yaw
    turn = (roll - sy * yaw, cx * pitch + sx * level, cx * level - sx * pitch)
    turn = (turn[0] + spin[0], turn[1] + spin[1], turn[2] + spin[2])
    y = (
        dot(load_vector(w, ROTATION, at, lanes), push),
        dot(load_vector(w, ROTATION + 3, at, lanes), push),
        dot(load_vector(w, ROTATION + 6, at, lanes), push),
    )
    store_vector(w, UNKNOWNS, at, lanes, centre_to_origin(form, -1.0, y, turn, p, w, at, lanes))
    store_vector(w, UNKNOWNS + 3, at, lanes, turn)
