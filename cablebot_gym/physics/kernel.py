"""The compiled plant: fixed-step RK4 of many robots at once, with the equations of :mod:`textbook`.

The Newton-Euler equations of a platform in space are written in the platform frame, with y = (Rᵀp̈, ω̇) as the unknowns.
Here p is the position of the centre of mass c, and b_i is the platform anchor as seen from it:

    q_i  = ‖s_i‖,  s_i = Rᵀ(p − A_i) + b_i,  u_i = s_i/q_i,  n_i = b_i × u_i,  row_i = (u_i, n_i)
    q̇_i = u_i·w_i,  w_i = Rᵀṗ + ω × b_i,  q̈_i = row_i·y + bias_i,  bias_i = u_i·(ω×(ω×b_i)) + (w_i·w_i − q̇_i²)/q_i
    t_i  = κ_i/r_i + (J_i/r_i²) q̈_i + (c_i/r_i²) q̇_i,   T_i = max(0, t_i)  (unilateral)   or   T_i = t_i  (bilateral)
    (m I₃, I) y = (Rᵀ(m g e_z + F), RᵀM − ω × Iω) − Σ row_i T_i

For a point mass y = p̈ and row_i = u_i. For a platform in a plane y = (p̈, φ̈) and row_i = (u_i, R b_i × u_i) in the base
frame.

A swivel pulley adds terms to the bias, see :func:`_swivelled`. Elastic cables have the tensions of
:func:`textbook.cable_springs` at the angle β of their pulley, ``J β̈ = κ − c β̇ − torque of the cable``, and the set of
taut cables follows from their strain. Without joint springs the pulley is the motor.

F and M are the external force and moment at the centre of mass in the base frame; usually they are zero. The torque
limits and the motors' friction hold at every stage of RK4, not only once per step: the error of a saturated motor falls
with the fourth power of the step, too. κ is the motor torque less the friction (rigid) or the spring torque. The Euler
accelerations are computed last. A cable is slack when t_i ≤ 0. The set of taut cables is unique because the problem is
strictly convex, so the result does not depend on the start of the search.

Memory: robots are stored in tiles of ``lanes`` lanes. Each tile is a flat array of rows, ``array[row * lanes + lane]``,
so the innermost loops run over lanes and vectorise. They vectorise only with ``forceinline`` and
``error_model="numpy"``.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from cablebot_gym.physics.inlining import compile_time_constant, entry_point, helper, inline

LANES = 32
"""Robots per tile in a batch. The rows of a tile then fit into the first-level cache of a core."""

# Rows of the parameters: platform, CABLE_PARAMETERS rows for each cable, and of lopsided robots, from body_parameter(m)
# on, I_xy, I_xz, I_yz and the centre of mass. Other robots do without these rows: they would be 4 % slower, since rows
# whose distance is a multiple of 4 KiB share a set of the first-level cache. From stretch_parameter(m, lopsided) on,
# robots with elastic cables or swivel pulleys have STRETCH_PARAMETERS further rows for each cable.
MASS, INERTIA, GRAVITY, FRICTION_SPEED, FORCE, MOMENT, FIRST_CABLE_PARAMETER = 0, 1, 4, 5, 6, 9, 12
BASE, PLATFORM, PER_RADIUS, INERTIA_PER_RADIUS2, DAMPING_PER_RADIUS2, STALL, SLOPE = 0, 3, 6, 7, 8, 9, 10
STIFFNESS, PER_MOTOR_INERTIA, MOTOR_DAMPING, HOME_LENGTH, LAG, COULOMB_FRICTION = 11, 12, 13, 14, 15, 16
CABLE_PARAMETERS = 17
PRODUCTS, CENTER, BODY_PARAMETERS = 0, 3, 6
RADIUS, PER_PULLEY_INERTIA, AXIAL_STIFFNESS, AXIAL_DAMPING, FULL_LENGTH, EXTRA_LENGTH, SWIVEL = 0, 1, 2, 3, 4, 5, 6
STRETCH_PARAMETERS = 7

# Rows of the record, which persists between calls: state, action, and peaks and flags of the last control period. With
# joint springs and elastic cables, PULLEY_RECORDS rows for each pulley follow, angle and speed.
POSE, VELOCITY, POSITION_PEAK, ROTATION_PEAK, FIRST_CABLE_RECORD = 0, 6, 12, 13, 14
DEMAND, TORQUE, TENSION, SPEED, SLACK, MOTOR_ANGLE, MOTOR_SPEED, LEAST_TENSION, LAGGED = 0, 1, 2, 3, 4, 5, 6, 7, 8
CABLE_RECORDS, PULLEY_RECORDS = 9, 2

# Rows of the scratch memory, which is not used between calls. Some serve two kinds of robots. _TRIG of a platform in a
# plane: sine and cosine of φ.
_START, _SUM, _STAGE, _RATE = 0, 12, 24, 36
_ROTATION, _BODY_VELOCITY, _OMEGA, _SPIN, _LOAD, _TRIG = 42, 51, 54, 57, 60, 66
_Y, _WRONG, _LEAST_SUM, _PAIR, _FIRST_CABLE = 70, 76, 77, 78, 82
_CENTRE = _LEAST_SUM  # of platforms that turn
_ROW, _LENGTH_RATE, _BIAS, _REQUEST, _DRIVE, _TAUT, _FREE_TENSION = 0, 6, 7, 8, 9, 10, 11
# Flexible robots: _MOTOR_START, _MOTOR_SUM and _MOTOR_STAGE have two rows each, angle β′ and speed β̇′.
_LENGTH, _MOTOR_START, _MOTOR_SUM, _MOTOR_STAGE, _MOTOR_RATE, _TORQUE = 12, 13, 15, 17, 19, 20
_RESULTS = 21
_GAP, _DECAY, _KNOWN = 25, 26, 27  # lagged minus requested torque, its decay in half a physics step, known tension
_CABLE_ROWS = 28
# Forward kinematics: _START and _SUM have the best pose and the step from there; their last rows serve sums and flags.
_SQUARES, _TRIAL, _ENDED = 9, 10, 11
# The pulleys between joint springs and elastic cables, after all cables.
_PULLEY_START, _PULLEY_SUM, _PULLEY_STAGE, _PULLEY_RATE, _PULLEY_ROWS = 0, 2, 4, 6, 7

TENSIONS, TORQUES, SPEEDS, WINDINGS = 0, 1, 2, 3
"""Order of the results of the inverse dynamics."""


@compile_time_constant
class Form(NamedTuple):
    """Constants of the compiled code, which is compiled once for each form of robots."""

    dimensions: int
    """Number of coordinates of the position: 2 or 3."""
    coordinates: int
    """Number of coordinates n: with ``dimensions`` it determines the kind of the platform."""
    cables: int
    """Number of cables m."""
    jointed: bool
    """Whether there are springs between motors and pulleys."""
    elastic: bool
    """Whether the cables stretch."""
    swivel: bool
    """Whether the cables run over swivel pulleys."""
    lopsided: bool
    """Whether a platform in space has products of inertia or a centre of mass that is not the origin of its frame. True
    for every platform in a plane."""

    @property
    def flexible(self) -> bool:
        """Whether the motors move independently of the platform."""
        return self.jointed or self.elastic

    @property
    def double(self) -> bool:
        """Whether there are pulleys between joint springs and elastic cables."""
        return self.jointed and self.elastic

    @property
    def robot_text(self) -> str:
        """The kind of robot in words, without the number of lanes."""
        body = "point mass" if self.coordinates == self.dimensions else "platform"
        place = "in space" if self.dimensions == 3 else "in a plane"
        springs = [text for flag, text in ((self.jointed, "joint springs"), (self.elastic, "elastic cables")) if flag]
        return " with ".join([f"{body} {place} on {self.cables} cables", *([" and ".join(springs)] if springs else [])])


def body_parameter(cables: int) -> int:
    """Row of the first parameter that only lopsided robots have."""
    return FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * cables


def stretch_parameter(cables: int, lopsided: bool) -> int:
    """Row of the first parameter that only robots with elastic cables or swivel pulleys have."""
    return FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * cables + BODY_PARAMETERS * lopsided


def pulley_record(cables: int) -> int:
    """Row of the angle of the first pulley between a joint spring and an elastic cable."""
    return FIRST_CABLE_RECORD + CABLE_RECORDS * cables


def parameter_rows(form: Form) -> int:
    """Number of parameter rows of a tile."""
    stretch = STRETCH_PARAMETERS * form.cables * (form.elastic or form.swivel)
    return stretch_parameter(form.cables, form.lopsided) + stretch


def record_rows(form: Form) -> int:
    """Number of record rows of a tile."""
    return pulley_record(form.cables) + PULLEY_RECORDS * form.cables * (form.elastic and form.jointed)


def scratch_rows(form: Form) -> int:
    """Number of rows of the scratch memory."""
    return _FIRST_CABLE + _CABLE_ROWS * form.cables + _PULLEY_ROWS * form.cables * (form.elastic and form.jointed)


# ---------------------------------------------------------------------------------------------- small helpers


def _fused(context, a, b, c):
    """Explicit fused a b + c. Otherwise the compiler rounds differently for one lane and for a tile."""

    def generate(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


_fma: Any = intrinsic(_fused)


_body, _stretch_parameter, _pulley_record = (inline(row) for row in (body_parameter, stretch_parameter, pulley_record))


@inline
def _dot(a, b):
    return _fma(a[2], b[2], _fma(a[1], b[1], a[0] * b[0]))


@inline
def _cross(a, b):
    return (
        _fma(a[1], b[2], -(a[2] * b[1])),
        _fma(a[2], b[0], -(a[0] * b[2])),
        _fma(a[0], b[1], -(a[1] * b[0])),
    )


@inline
def _load(array, row, at, lanes):
    """Three rows from ``row`` on for lane ``at``."""
    return array[row * lanes + at], array[(row + 1) * lanes + at], array[(row + 2) * lanes + at]


@inline
def _store(array, row, at, lanes, value):
    array[row * lanes + at] = value[0]
    array[(row + 1) * lanes + at] = value[1]
    array[(row + 2) * lanes + at] = value[2]


@inline
def _sincos(angle):
    """Vectorisable sine and cosine: Cody–Waite reduction to ±π/4, then the minimax polynomials of fdlibm."""
    turns = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - turns * 1.5707963267341256
    x = x - turns * 6.077100506506192e-11
    z = x * x
    sine = _fma(z, 1.58969099521155010221e-10, -2.50507602534068634195e-08)
    sine = _fma(z, _fma(z, sine, 2.75573137070700676789e-06), -1.98412698298579493134e-04)
    sine = _fma(z, _fma(z, sine, 8.33333333332248946124e-03), -1.66666666666666324348e-01)
    sine = _fma(x * z, sine, x)
    cosine = _fma(z, -1.13596475577881948265e-11, 2.08757232129817482790e-09)
    cosine = _fma(z, _fma(z, cosine, -2.75573143513906633035e-07), 2.48015872894767294178e-05)
    cosine = _fma(z, _fma(z, cosine, -1.38888888888741095749e-03), 4.16666666666666019037e-02)
    cosine = _fma(z * z, cosine, _fma(z, -0.5, 1.0))
    quadrant = turns - 4.0 * np.floor(turns * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    s = cosine if odd else sine
    c = sine if odd else cosine
    s = -s if quadrant >= 2.0 else s
    c = -c if (quadrant == 1.0) | (quadrant == 2.0) else c
    return s, c


@inline
def _atan2(y, x):
    """Vectorisable ``math.atan2``: reduction to ± π/8, then the minimax polynomial of fdlibm."""
    wide, high = abs(x), abs(y)
    longer, shorter = max(wide, high), min(wide, high)
    steep = shorter > 0.4142135623730950488 * longer
    t = (shorter - longer if steep else shorter) / (longer + shorter if steep else longer)
    z = t * t
    r = _fma(z, 1.62858201153657823623e-02, -3.65315727442169155270e-02)
    r = _fma(z, _fma(z, r, 4.97687799461593236017e-02), -5.83357013379057348645e-02)
    r = _fma(z, _fma(z, r, 6.66107313738753120669e-02), -7.69187620504482999495e-02)
    r = _fma(z, _fma(z, r, 9.09088713343650656196e-02), -1.11111104054623557880e-01)
    r = _fma(z, _fma(z, r, 1.42857142725034663711e-01), -1.99999999998764832476e-01)
    r = _fma(z, r, 3.33333333333329318027e-01)
    angle = _fma(-t * z, r, t)
    angle = angle + 0.78539816339744830962 if steep else angle
    angle = 1.57079632679489661923 - angle if high > wide else angle
    angle = 3.14159265358979323846 - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


# -------------------------------------------------------------------------------- swivel pulleys: one lane at a time


@inline
def _swivelled(lengths, radius, s, v):
    """Direction, length and bend of a cable over a swivel pulley of the signed radius, from the anchors' difference s.

    As :class:`kinematics._Swivelled`, in the base frame. The bend (v·n)²/f + (u_h/d)(v·e)² is the part of q̈ that comes
    from the turning of the free length f: in the plane of the pulley, where n is normal to the cable, and with the
    pulley about its axis, where d is the distance from the axis and e points sideways. The length is zero if
    ``lengths`` is False.
    """
    rho, side = abs(radius), -1.0 if radius < 0.0 else 1.0
    reach = math.sqrt(s[0] * s[0] + s[1] * s[1])
    per_reach = 1.0 / reach
    height, across = side * s[2], reach - rho
    square = across * across + height * height
    free = math.sqrt(square - rho * rho)
    out, down = (free * across - rho * height) / square, (rho * across + free * height) / square
    x, y = s[0] * per_reach, s[1] * per_reach
    normal, sideways = out * side * v[2] - down * (x * v[0] + y * v[1]), x * v[1] - y * v[0]
    bend = normal * normal / free + out * sideways * sideways * per_reach
    length = 0.0
    if lengths:
        length = free + rho * (math.pi + _atan2(-out, down))
    return (out * x, out * y, side * down), length, bend


# ---------------------------------------------------------------------------------- spatial robot: one lane at a time


@inline
def _spatial_platform(form, p, w, at, lanes):
    """Rotation, velocity in the platform frame and the terms without cables, from the state of the stage."""
    sx, cx = _sincos(w[(_STAGE + 3) * lanes + at])
    sy, cy = _sincos(w[(_STAGE + 4) * lanes + at])
    sz, cz = _sincos(w[(_STAGE + 5) * lanes + at])
    velocity = _load(w, _STAGE + 6, at, lanes)
    roll, pitch, yaw = _load(w, _STAGE + 9, at, lanes)
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
    inertia = _load(p, INERTIA, at, lanes)
    momentum = (inertia[0] * omega[0], inertia[1] * omega[1], inertia[2] * omega[2])
    body_velocity = (_dot(first, velocity), _dot(second, velocity), _dot(third, velocity))
    if form.lopsided:
        momentum = _times(_tensor(form, p, at, lanes), omega)
        centre = _load(p, _body(form.cables) + CENTER, at, lanes)
        turning = _cross(omega, centre)
        body_velocity = _ahead(1.0, turning, body_velocity)
        position = _ahead(centre[2], third, _load(w, _STAGE, at, lanes))
        _store(w, _CENTRE, at, lanes, _ahead(centre[0], first, _ahead(centre[1], second, position)))
    gyro = _cross(momentum, omega)
    push, moment = _load(p, FORCE, at, lanes), _load(p, MOMENT, at, lanes)
    force = (push[0], push[1], _fma(p[MASS * lanes + at], p[GRAVITY * lanes + at], push[2]))
    _store(w, _ROTATION, at, lanes, first)
    _store(w, _ROTATION + 3, at, lanes, second)
    _store(w, _ROTATION + 6, at, lanes, third)
    _store(w, _BODY_VELOCITY, at, lanes, body_velocity)
    _store(w, _OMEGA, at, lanes, omega)
    _store(w, _SPIN, at, lanes, spin)
    _store(w, _LOAD, at, lanes, (_dot(first, force), _dot(second, force), _dot(third, force)))
    _store(
        w,
        _LOAD + 3,
        at,
        lanes,
        (gyro[0] + _dot(first, moment), gyro[1] + _dot(second, moment), gyro[2] + _dot(third, moment)),
    )
    _store(w, _TRIG, at, lanes, (sx, cx, sy))
    w[(_TRIG + 3) * lanes + at] = cy


@inline
def _tensor(form, p, at, lanes):
    """Inertia tensor, stored as the matrices of :func:`_add_outer`."""
    xx, yy, zz = _load(p, INERTIA, at, lanes)
    if form.lopsided:
        xy, xz, yz = _load(p, _body(form.cables) + PRODUCTS, at, lanes)
        return xx, xy, xz, yy, yz, zz
    return xx, 0.0, 0.0, yy, 0.0, zz


@inline
def _to_base(vector, offset, w, at, lanes):
    """offset + R vector."""
    first, second = _load(w, _ROTATION, at, lanes), _load(w, _ROTATION + 3, at, lanes)
    third = _load(w, _ROTATION + 6, at, lanes)
    return _ahead(vector[0], first, _ahead(vector[1], second, _ahead(vector[2], third, offset)))


@inline
def _spatial_cable(form, lengths, p, w, at, lanes, i):
    """Direction, moment arm, length rate and bias of cable i."""
    anchor = _load(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE, at, lanes)
    b = _load(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + PLATFORM, at, lanes)
    position = _load(w, _CENTRE if form.lopsided else _STAGE, at, lanes)
    omega = _load(w, _OMEGA, at, lanes)
    velocity = _load(w, _BODY_VELOCITY, at, lanes)
    d = (position[0] - anchor[0], position[1] - anchor[1], position[2] - anchor[2])
    turning = _cross(omega, b)
    point = (velocity[0] + turning[0], velocity[1] + turning[1], velocity[2] + turning[2])
    if form.swivel:
        radius = p[(_stretch_parameter(form.cables, form.lopsided) + STRETCH_PARAMETERS * i + SWIVEL) * lanes + at]
        s, v = _to_base(b, d, w, at, lanes), _to_base(point, (0.0, 0.0, 0.0), w, at, lanes)
        u, length, bend = _swivelled(lengths, radius, s, v)
        u = (
            _dot(_load(w, _ROTATION, at, lanes), u),
            _dot(_load(w, _ROTATION + 3, at, lanes), u),
            _dot(_load(w, _ROTATION + 6, at, lanes), u),
        )
        rate = _dot(u, point)
    else:
        s = (
            _dot(_load(w, _ROTATION, at, lanes), d) + b[0],
            _dot(_load(w, _ROTATION + 3, at, lanes), d) + b[1],
            _dot(_load(w, _ROTATION + 6, at, lanes), d) + b[2],
        )
        length = math.sqrt(_dot(s, s))
        per_length = 1.0 / length
        u = (s[0] * per_length, s[1] * per_length, s[2] * per_length)
        rate = _dot(u, point)
        bend = (_dot(point, point) - rate * rate) * per_length
    bias = _dot(u, _cross(omega, turning)) + bend
    row = _FIRST_CABLE + _CABLE_ROWS * i
    _store(w, row + _ROW, at, lanes, u)
    _store(w, row + _ROW + 3, at, lanes, _cross(b, u))
    if lengths:
        w[(row + _LENGTH) * lanes + at] = length
    w[(row + _LENGTH_RATE) * lanes + at] = rate
    w[(row + _BIAS) * lanes + at] = bias


@inline
def _weights(p, w, at, lanes, i):
    """(J/r²) and the tension without the unknown part of q̈; both are zero for a slack cable."""
    taut = w[(_FIRST_CABLE + _CABLE_ROWS * i + _TAUT) * lanes + at]
    mu = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + INERTIA_PER_RADIUS2) * lanes + at]
    return taut * mu, taut * w[(_FIRST_CABLE + _CABLE_ROWS * i + _KNOWN) * lanes + at]


@inline
def _known_tensions(form, p, w, at, lanes):
    """κ/r + (J/r²)·bias + (c/r²) q̇ of all cables."""
    for i in range(form.cables):
        par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
        drive = w[(row + _DRIVE) * lanes + at] * p[(par + PER_RADIUS) * lanes + at]
        damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * w[(row + _LENGTH_RATE) * lanes + at]
        inertia = p[(par + INERTIA_PER_RADIUS2) * lanes + at]
        w[(row + _KNOWN) * lanes + at] = _fma(inertia, w[(row + _BIAS) * lanes + at], drive + damping)


@inline
def _add_cable(a, b, c, f, g, p, w, at, lanes, i):
    """Adds cable i to the left side ((a, b), (bᵀ, c)) and subtracts its known tension from the right side (f, g)."""
    mu, known = _weights(p, w, at, lanes, i)
    a, b, c = _add_row(a, b, c, mu, w, at, lanes, i)
    f, g = _add_pull(f, g, known, w, at, lanes, i)
    return a, b, c, f, g


@inline
def _add_row(a, b, c, weight, w, at, lanes, i):
    """Adds weight · row_i row_iᵀ to ((a, b), (bᵀ, c))."""
    row = _FIRST_CABLE + _CABLE_ROWS * i + _ROW
    u, n = _load(w, row, at, lanes), _load(w, row + 3, at, lanes)
    heavy = (weight * u[0], weight * u[1], weight * u[2])
    a = _add_outer(a, heavy, u)
    c = _add_outer(c, (weight * n[0], weight * n[1], weight * n[2]), n)
    return a, (_ahead(heavy[0], n, b[0]), _ahead(heavy[1], n, b[1]), _ahead(heavy[2], n, b[2])), c


@inline
def _add_pull(f, g, tension, w, at, lanes, i):
    """Subtracts the pull of cable i, row_i · tension, from (f, g)."""
    row = _FIRST_CABLE + _CABLE_ROWS * i + _ROW
    return _ahead(-tension, _load(w, row, at, lanes), f), _ahead(-tension, _load(w, row + 3, at, lanes), g)


@inline
def _ahead(factor, x, base):
    """base + factor x."""
    return _fma(factor, x[0], base[0]), _fma(factor, x[1], base[1]), _fma(factor, x[2], base[2])


@inline
def _add_outer(a, x, y):
    """a + x yᵀ for parallel x and y. The symmetric a is stored as (xx, xy, xz, yy, yz, zz)."""
    return (
        _fma(x[0], y[0], a[0]),
        _fma(x[0], y[1], a[1]),
        _fma(x[0], y[2], a[2]),
        _fma(x[1], y[1], a[3]),
        _fma(x[1], y[2], a[4]),
        _fma(x[2], y[2], a[5]),
    )


@inline
def _inverse(a):
    """Inverse of a symmetric 3 × 3 matrix by cofactors, with one division."""
    xx, xy, xz = _cross((a[1], a[3], a[4]), (a[2], a[4], a[5]))
    per = 1.0 / _dot((a[0], a[1], a[2]), (xx, xy, xz))
    yy = _fma(a[0], a[5], -(a[2] * a[2]))
    yz = _fma(a[1], a[2], -(a[0] * a[4]))
    zz = _fma(a[0], a[3], -(a[1] * a[1]))
    return xx * per, xy * per, xz * per, yy * per, yz * per, zz * per


@inline
def _times(a, x):
    """Symmetric 3 × 3 matrix times a vector."""
    return (
        _dot((a[0], a[1], a[2]), x),
        _dot((a[1], a[3], a[4]), x),
        _dot((a[2], a[4], a[5]), x),
    )


@inline
def _factored(a, b, c):
    """Factors of the symmetric 6 × 6 matrix ((a, b), (bᵀ, c)) for :func:`_solved`: its Schur complement."""
    inverse = _inverse(a)
    column0, column1, column2 = (b[0][0], b[1][0], b[2][0]), (b[0][1], b[1][1], b[2][1]), (b[0][2], b[1][2], b[2][2])
    e0, e1, e2 = _times(inverse, column0), _times(inverse, column1), _times(inverse, column2)
    complement = (
        c[0] - _dot(column0, e0),
        c[1] - _dot(column0, e1),
        c[2] - _dot(column0, e2),
        c[3] - _dot(column1, e1),
        c[4] - _dot(column1, e2),
        c[5] - _dot(column2, e2),
    )
    return inverse, (e0, e1, e2), _inverse(complement)


@inline
def _solved(factors, f, g):
    """Both halves of the solution for the right side (f, g)."""
    inverse, e, complement = factors
    half = _times(complement, (g[0] - _dot(e[0], f), g[1] - _dot(e[1], f), g[2] - _dot(e[2], f)))
    return _ahead(-half[0], e[0], _ahead(-half[1], e[1], _ahead(-half[2], e[2], _times(inverse, f)))), half


@inline
def _spatial_solve(form, p, w, at, lanes):
    """y for the current set of taut cables. The cables are not in a loop: a loop that carries tuples is slower."""
    mass, zero = p[MASS * lanes + at], (0.0, 0.0, 0.0)
    a, b, c = (mass, 0.0, 0.0, mass, 0.0, mass), (zero, zero, zero), _tensor(form, p, at, lanes)
    f, g = _load(w, _LOAD, at, lanes), _load(w, _LOAD + 3, at, lanes)
    a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 0)
    a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 1)
    a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 2)
    a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 3)
    a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 4)
    a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 5)
    if form.cables > 6:
        a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 6)
    if form.cables > 7:
        a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, 7)
    for i in range(8, form.cables):
        a, b, c, f, g = _add_cable(a, b, c, f, g, p, w, at, lanes, i)
    push, turn = _solved(_factored(a, b, c), f, g)
    _store(w, _Y, at, lanes, push)
    _store(w, _Y + 3, at, lanes, turn)


@inline
def _from_centre(form, sign, y, turn, p, w, at, lanes):
    """y₁ − ω̇ × c − ω × (ω × c), from the centre of mass to the origin of the frame; back with ``sign`` −1."""
    if form.lopsided:
        centre, omega = _load(p, _body(form.cables) + CENTER, at, lanes), _load(w, _OMEGA, at, lanes)
        y = _ahead(-sign, _cross(turn, centre), _ahead(-sign, _cross(omega, _cross(omega, centre)), y))
    return y


@inline
def _spatial_acceleration(form, p, w, at, lanes):
    """Ẍ from y: p̈ = R y₁ less the motion of the centre of mass about the origin, Θ̈ = P⁻¹(ω̇ − Ṗ Θ̇)."""
    first, second, third = (
        _load(w, _ROTATION, at, lanes),
        _load(w, _ROTATION + 3, at, lanes),
        _load(w, _ROTATION + 6, at, lanes),
    )
    turn, spin = _load(w, _Y + 3, at, lanes), _load(w, _SPIN, at, lanes)
    y = _from_centre(form, 1.0, _load(w, _Y, at, lanes), turn, p, w, at, lanes)
    x, y_, z = turn[0] - spin[0], turn[1] - spin[1], turn[2] - spin[2]
    sx, cx, sy = _load(w, _TRIG, at, lanes)
    yaw = (sx * y_ + cx * z) / w[(_TRIG + 3) * lanes + at]
    _store(
        w,
        _RATE,
        at,
        lanes,
        _ahead(y[0], first, _ahead(y[1], second, (third[0] * y[2], third[1] * y[2], third[2] * y[2]))),
    )
    _store(w, _RATE + 3, at, lanes, (x + sy * yaw, cx * y_ - sx * z, yaw))


# ----------------------------------------------------------------------- point mass in a plane: one lane at a time


@inline
def _planar_cable(p, w, at, lanes, i):
    """Direction, length rate and bias of cable i. The row is (u, 0) instead of (u, n)."""
    par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE
    dx = w[_STAGE * lanes + at] - p[par * lanes + at]
    dy = w[(_STAGE + 1) * lanes + at] - p[(par + 1) * lanes + at]
    vx, vy = w[(_STAGE + 6) * lanes + at], w[(_STAGE + 7) * lanes + at]
    length = math.sqrt(dx * dx + dy * dy)
    per_length = 1.0 / length
    ux, uy = dx * per_length, dy * per_length
    rate = ux * vx + uy * vy
    row = _FIRST_CABLE + _CABLE_ROWS * i
    w[(row + _ROW) * lanes + at] = ux
    w[(row + _ROW + 1) * lanes + at] = uy
    w[(row + _LENGTH) * lanes + at] = length
    w[(row + _LENGTH_RATE) * lanes + at] = rate
    w[(row + _BIAS) * lanes + at] = (vx * vx + vy * vy - rate * rate) * per_length


@inline
def _planar_solve(form, p, w, at, lanes):
    """y = Ẍ for the current set of taut cables, from two equations. Gravity acts along y."""
    mass = p[MASS * lanes + at]
    xx, xy, yy, fx = mass, 0.0, mass, p[FORCE * lanes + at]
    fy = _fma(mass, p[GRAVITY * lanes + at], p[(FORCE + 1) * lanes + at])
    for i in range(form.cables):
        row = _FIRST_CABLE + _CABLE_ROWS * i
        mu, known = _weights(p, w, at, lanes, i)
        ux, uy = w[(row + _ROW) * lanes + at], w[(row + _ROW + 1) * lanes + at]
        xx, xy, yy = xx + mu * ux * ux, xy + mu * ux * uy, yy + mu * uy * uy
        fx, fy = fx - known * ux, fy - known * uy
    per = 1.0 / (xx * yy - xy * xy)
    w[_Y * lanes + at] = (yy * fx - xy * fy) * per
    w[(_Y + 1) * lanes + at] = (xx * fy - xy * fx) * per


# ------------------------------------------------ point mass in space, platform in a plane: one lane at a time


@inline
def _point_load(p, w, at, lanes):
    """Weight and external force of a point mass in space."""
    push = _load(p, FORCE, at, lanes)
    _store(w, _LOAD, at, lanes, (push[0], push[1], _fma(p[MASS * lanes + at], p[GRAVITY * lanes + at], push[2])))


@inline
def _point_cable(form, lengths, p, w, at, lanes, i):
    """Direction, length rate and bias of cable i."""
    anchor = _load(p, FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + BASE, at, lanes)
    position, velocity = _load(w, _STAGE, at, lanes), _load(w, _STAGE + 6, at, lanes)
    d = (position[0] - anchor[0], position[1] - anchor[1], position[2] - anchor[2])
    if form.swivel:
        radius = p[(_stretch_parameter(form.cables, False) + STRETCH_PARAMETERS * i + SWIVEL) * lanes + at]
        u, length, bend = _swivelled(lengths, radius, d, velocity)
        rate = _dot(u, velocity)
    else:
        length = math.sqrt(_dot(d, d))
        per_length = 1.0 / length
        u = (d[0] * per_length, d[1] * per_length, d[2] * per_length)
        rate = _dot(u, velocity)
        bend = (_dot(velocity, velocity) - rate * rate) * per_length
    row = _FIRST_CABLE + _CABLE_ROWS * i
    _store(w, row + _ROW, at, lanes, u)
    if lengths:
        w[(row + _LENGTH) * lanes + at] = length
    w[(row + _LENGTH_RATE) * lanes + at] = rate
    w[(row + _BIAS) * lanes + at] = bend


@inline
def _plane_platform(form, p, w, at, lanes):
    """Sine and cosine of φ, motion of the centre of mass, and the terms without cables. Gravity acts along y."""
    sine, cosine = _sincos(w[(_STAGE + 2) * lanes + at])
    omega = w[(_STAGE + 8) * lanes + at]
    row = _body(form.cables) + CENTER
    cx, cy = p[row * lanes + at], p[(row + 1) * lanes + at]
    sx, sy = cosine * cx - sine * cy, sine * cx + cosine * cy
    w[_TRIG * lanes + at], w[(_TRIG + 1) * lanes + at] = sine, cosine
    w[_CENTRE * lanes + at], w[(_CENTRE + 1) * lanes + at] = sx, sy
    w[_BODY_VELOCITY * lanes + at] = w[(_STAGE + 6) * lanes + at] - omega * sy
    w[(_BODY_VELOCITY + 1) * lanes + at] = w[(_STAGE + 7) * lanes + at] + omega * sx
    w[_LOAD * lanes + at] = p[FORCE * lanes + at]
    weight = p[MASS * lanes + at] * p[GRAVITY * lanes + at]
    w[(_LOAD + 1) * lanes + at] = weight + p[(FORCE + 1) * lanes + at]
    w[(_LOAD + 2) * lanes + at] = p[(MOMENT + 2) * lanes + at]


@inline
def _plane_cable(p, w, at, lanes, i):
    """Direction, moment arm, length rate and bias of cable i, in the base frame."""
    par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
    bx, by = p[(par + PLATFORM) * lanes + at], p[(par + PLATFORM + 1) * lanes + at]
    sine, cosine, omega = w[_TRIG * lanes + at], w[(_TRIG + 1) * lanes + at], w[(_STAGE + 8) * lanes + at]
    ax, ay = cosine * bx - sine * by, sine * bx + cosine * by
    dx = w[_STAGE * lanes + at] + w[_CENTRE * lanes + at] + ax - p[(par + BASE) * lanes + at]
    dy = w[(_STAGE + 1) * lanes + at] + w[(_CENTRE + 1) * lanes + at] + ay - p[(par + BASE + 1) * lanes + at]
    vx, vy = w[_BODY_VELOCITY * lanes + at] - omega * ay, w[(_BODY_VELOCITY + 1) * lanes + at] + omega * ax
    length = math.sqrt(dx * dx + dy * dy)
    per_length = 1.0 / length
    ux, uy = dx * per_length, dy * per_length
    rate = ux * vx + uy * vy
    row = _FIRST_CABLE + _CABLE_ROWS * i
    _store(w, row + _ROW, at, lanes, (ux, uy, ax * uy - ay * ux))
    w[(row + _LENGTH) * lanes + at] = length
    w[(row + _LENGTH_RATE) * lanes + at] = rate
    centripetal = omega * omega * (ux * ax + uy * ay)
    w[(row + _BIAS) * lanes + at] = (vx * vx + vy * vy - rate * rate) * per_length - centripetal


@inline
def _three_masses(form, p, at, lanes):
    """Diagonal of the mass matrix: (m, m, m) of a point mass, (m, m, I_zz) of a platform in a plane."""
    mass = p[MASS * lanes + at]
    return mass, mass, p[(INERTIA + 2) * lanes + at] if form.dimensions == 2 else mass


@inline
def _three_solve(form, p, w, at, lanes):
    """y for the current set of taut cables, from three equations."""
    xx, yy, zz = _three_masses(form, p, at, lanes)
    xy, xz, yz = 0.0, 0.0, 0.0
    fx, fy, fz = _load(w, _LOAD, at, lanes)
    for i in range(form.cables):
        mu, known = _weights(p, w, at, lanes, i)
        ux, uy, uz = _load(w, _FIRST_CABLE + _CABLE_ROWS * i + _ROW, at, lanes)
        hx, hy, hz = mu * ux, mu * uy, mu * uz
        xx, xy, xz = _fma(hx, ux, xx), _fma(hx, uy, xy), _fma(hx, uz, xz)
        yy, yz, zz = _fma(hy, uy, yy), _fma(hy, uz, yz), _fma(hz, uz, zz)
        fx, fy, fz = _fma(-known, ux, fx), _fma(-known, uy, fy), _fma(-known, uz, fz)
    _store(w, _Y, at, lanes, _times(_inverse((xx, xy, xz, yy, yz, zz)), (fx, fy, fz)))


@inline
def _plane_acceleration(sign, row, target, w, at, lanes):
    """Ẍ in ``target`` from y in ``row``, from the centre of mass to the origin of the frame; back with ``sign`` −1."""
    sx, sy = w[_CENTRE * lanes + at], w[(_CENTRE + 1) * lanes + at]
    omega, turn = w[(_STAGE + 8) * lanes + at], w[(row + 2) * lanes + at]
    square = omega * omega
    w[target * lanes + at] = w[row * lanes + at] + sign * (turn * sy + square * sx)
    w[(target + 1) * lanes + at] = w[(row + 1) * lanes + at] - sign * (turn * sx - square * sy)
    w[(target + 2) * lanes + at] = turn


# -------------------------------------------------------------------------------- all robots: cables that only pull


@inline
def _along(form, w, at, lanes, i):
    """row_i · y."""
    row = _FIRST_CABLE + _CABLE_ROWS * i + _ROW
    along = w[row * lanes + at] * w[_Y * lanes + at]
    along += w[(row + 1) * lanes + at] * w[(_Y + 1) * lanes + at]
    if form.coordinates > 2:
        along += w[(row + 2) * lanes + at] * w[(_Y + 2) * lanes + at]
    if form.coordinates == 6:
        along += _dot(_load(w, row + 3, at, lanes), _load(w, _Y + 3, at, lanes))
    return along


@inline
def _free_tension(form, p, w, at, lanes, i):
    """t_i: the tension if positive; otherwise the cable is slack and −r t_i is the take-up torque u."""
    mu = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + INERTIA_PER_RADIUS2) * lanes + at]
    known = w[(_FIRST_CABLE + _CABLE_ROWS * i + _KNOWN) * lanes + at]
    tension = known + mu * _along(form, w, at, lanes, i)
    w[(_FIRST_CABLE + _CABLE_ROWS * i + _FREE_TENSION) * lanes + at] = tension
    return tension


@inline
def _pulled_lane(form, p, w, at, lanes):
    """y for the tensions of elastic cables."""
    mass = p[MASS * lanes + at]
    if form.coordinates == 6:
        f, g = _load(w, _LOAD, at, lanes), _load(w, _LOAD + 3, at, lanes)
        for i in range(form.cables):
            f, g = _add_pull(f, g, w[(_FIRST_CABLE + _CABLE_ROWS * i + _KNOWN) * lanes + at], w, at, lanes, i)
        _store(w, _Y, at, lanes, (f[0] / mass, f[1] / mass, f[2] / mass))
        _store(w, _Y + 3, at, lanes, _times(_inverse(_tensor(form, p, at, lanes)), g))
    elif form.coordinates == 3:
        masses, (fx, fy, fz) = _three_masses(form, p, at, lanes), _load(w, _LOAD, at, lanes)
        for i in range(form.cables):
            tension = w[(_FIRST_CABLE + _CABLE_ROWS * i + _KNOWN) * lanes + at]
            ux, uy, uz = _load(w, _FIRST_CABLE + _CABLE_ROWS * i + _ROW, at, lanes)
            fx, fy, fz = _fma(-tension, ux, fx), _fma(-tension, uy, fy), _fma(-tension, uz, fz)
        _store(w, _Y, at, lanes, (fx / masses[0], fy / masses[1], fz / masses[2]))
    else:
        fx, fy = p[FORCE * lanes + at], _fma(mass, p[GRAVITY * lanes + at], p[(FORCE + 1) * lanes + at])
        for i in range(form.cables):
            row = _FIRST_CABLE + _CABLE_ROWS * i
            tension = w[(row + _KNOWN) * lanes + at]
            fx = _fma(-tension, w[(row + _ROW) * lanes + at], fx)
            fy = _fma(-tension, w[(row + _ROW + 1) * lanes + at], fy)
        w[_Y * lanes + at], w[(_Y + 1) * lanes + at] = fx / mass, fy / mass


@inline
def _solve_lane(form, p, w, at, lanes):
    if form.coordinates == 6:
        _spatial_solve(form, p, w, at, lanes)
    elif form.coordinates == 3:
        _three_solve(form, p, w, at, lanes)
    else:
        _planar_solve(form, p, w, at, lanes)


@helper
def _settle_lane(form, p, w, at, lanes):
    """Finds the taut set of one lane. All wrong cables change sides; after too many trials, only the last one does.

    The second rule is Murty's least-index rule, which terminates for every P-matrix, such as that of this problem.
    """
    for trial in range(10 + 2 ** min(form.cables, 20)):
        wrong = 0
        for i in range(form.cables):
            taut = (_FIRST_CABLE + _CABLE_ROWS * i + _TAUT) * lanes + at
            pulls = 1.0 if _free_tension(form, p, w, at, lanes, i) > 0.0 else 0.0
            if pulls != w[taut]:
                wrong = i + 1
                if trial < 10:
                    w[taut] = pulls
        if wrong == 0:
            return
        if trial >= 10:
            taut = (_FIRST_CABLE + _CABLE_ROWS * (wrong - 1) + _TAUT) * lanes + at
            w[taut] = 1.0 - w[taut]
        _solve_lane(form, p, w, at, lanes)


# -------------------------------------------------------------------------------------------- all robots: a tile


@inline
def _kinematics(form, lengths, p, w, lanes):
    if form.coordinates == 6:
        for at in range(lanes):
            _spatial_platform(form, p, w, at, lanes)
    elif form.coordinates == 3:
        for at in range(lanes):
            if form.dimensions == 2:
                _plane_platform(form, p, w, at, lanes)
            else:
                _point_load(p, w, at, lanes)
    for i in range(form.cables):
        for at in range(lanes):
            if form.coordinates == 6:
                _spatial_cable(form, lengths, p, w, at, lanes, i)
            elif form.dimensions == 3:
                _point_cable(form, lengths, p, w, at, lanes, i)
            elif form.coordinates == 3:
                _plane_cable(p, w, at, lanes, i)
            else:
                _planar_cable(p, w, at, lanes, i)


@inline
def _dynamics(form, unilateral, p, w, lanes):
    """Accelerations of the stage, with the taut sets of all lanes."""
    if form.elastic:
        for at in range(lanes):
            _pulled_lane(form, p, w, at, lanes)
    else:
        _taut_sets(form, unilateral, p, w, lanes)
    _accelerations(form, p, w, lanes)


@inline
def _accelerations(form, p, w, lanes):
    """Ẍ from y, in the rows from :func:`_acceleration_row` on."""
    for at in range(lanes):
        if form.coordinates == 6:
            _spatial_acceleration(form, p, w, at, lanes)
        elif form.coordinates == 3 and form.dimensions == 2:
            _plane_acceleration(1.0, _Y, _RATE, w, at, lanes)


@inline
def _acceleration_row(form):
    """Row of Ẍ after :func:`_dynamics`: y itself of point masses."""
    return _Y if form.dimensions == form.coordinates else _RATE


@inline
def _taut_sets(form, unilateral, p, w, lanes):
    """y and the taut sets of all lanes whose cables do not stretch."""
    for at in range(lanes):
        _known_tensions(form, p, w, at, lanes)
        _solve_lane(form, p, w, at, lanes)
    for at in range(lanes):
        wrong = 0.0
        for i in range(form.cables):
            pulls = 1.0 if _free_tension(form, p, w, at, lanes, i) > 0.0 else 0.0
            taut = w[(_FIRST_CABLE + _CABLE_ROWS * i + _TAUT) * lanes + at]
            wrong += (pulls - taut) * (pulls - taut)
        w[_WRONG * lanes + at] = wrong
    if unilateral:
        wrong = 0.0
        for at in range(lanes):
            wrong = max(wrong, w[_WRONG * lanes + at])
        if wrong > 0.0:
            for at in range(lanes):
                if w[_WRONG * lanes + at] > 0.0:
                    _settle_lane(form, p, w, at, lanes)


@inline
def _springs(form, unilateral, p, w, lanes):
    """Torque of the joint springs on the pulleys, κ = K (β′ − β), and the motors' accelerations (Eq. 4).

    With unilateral cables κ = K max(β′ − β, 0): a negative twist is slack cable on the pulley.
    """
    for i in range(form.cables):
        par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
        for at in range(lanes):
            wound = p[(par + HOME_LENGTH) * lanes + at] - w[(row + _LENGTH) * lanes + at]
            angle = wound * p[(par + PER_RADIUS) * lanes + at]
            twist = w[(row + _MOTOR_STAGE) * lanes + at] - angle
            twist = max(twist, 0.0) if unilateral else twist
            spring = p[(par + STIFFNESS) * lanes + at] * twist
            friction = p[(par + MOTOR_DAMPING) * lanes + at] * w[(row + _MOTOR_STAGE + 1) * lanes + at]
            rest = w[(row + _TORQUE) * lanes + at] - spring - friction
            w[(row + _DRIVE) * lanes + at] = spring
            w[(row + _MOTOR_RATE) * lanes + at] = rest * p[(par + PER_MOTOR_INERTIA) * lanes + at]


@inline
def _pulley(form, i):
    """Scratch row of pulley i between its joint spring and its elastic cable."""
    return _FIRST_CABLE + _CABLE_ROWS * form.cables + _PULLEY_ROWS * i


@inline
def _stretch(form, unilateral, p, w, lanes):
    """Tensions of elastic cables, see :func:`textbook.cable_springs`, and the accelerations of pulleys and motors.

    The joint springs push, too: cables that are slack do not hold their pulleys.
    """
    for i in range(form.cables):
        par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
        more = _stretch_parameter(form.cables, form.lopsided) + STRETCH_PARAMETERS * i
        pulley = _pulley(form, i) + _PULLEY_STAGE if form.jointed else row + _MOTOR_STAGE
        for at in range(lanes):
            radius, stiffness = p[(more + RADIUS) * lanes + at], p[(more + AXIAL_STIFFNESS) * lanes + at]
            angle, speed = w[pulley * lanes + at], w[(pulley + 1) * lanes + at]
            per_free = 1.0 / (p[(more + FULL_LENGTH) * lanes + at] - radius * angle)
            length = w[(row + _LENGTH) * lanes + at] + p[(more + EXTRA_LENGTH) * lanes + at]
            strain, rate = length * per_free - 1.0, (w[(row + _LENGTH_RATE) * lanes + at] + radius * speed) * per_free
            tension = stiffness * strain + p[(more + AXIAL_DAMPING) * lanes + at] * rate
            wound = 0.5 * stiffness * strain * strain
            if unilateral:
                tension = 0.0 if strain <= 0.0 else max(tension, 0.0)
                wound = 0.0 if strain <= 0.0 else wound
            w[(row + _KNOWN) * lanes + at] = w[(row + _FREE_TENSION) * lanes + at] = tension
            w[(row + _TAUT) * lanes + at] = 1.0 if tension > 0.0 else 0.0
            damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * radius * radius * speed
            pulling = radius * (tension + wound) + damping
            torque, per_inertia = w[(row + _TORQUE) * lanes + at], p[(more + PER_PULLEY_INERTIA) * lanes + at]
            if form.jointed:
                twist = p[(par + STIFFNESS) * lanes + at] * (w[(row + _MOTOR_STAGE) * lanes + at] - angle)
                w[(_pulley(form, i) + _PULLEY_RATE) * lanes + at] = (twist - pulling) * per_inertia
                friction = p[(par + MOTOR_DAMPING) * lanes + at] * w[(row + _MOTOR_STAGE + 1) * lanes + at]
                rest = torque - twist - friction
                w[(row + _MOTOR_RATE) * lanes + at] = rest * p[(par + PER_MOTOR_INERTIA) * lanes + at]
            else:
                w[(row + _MOTOR_RATE) * lanes + at] = (torque - pulling) * per_inertia


@inline
def _motor_speed(form, p, w, at, lanes, i):
    if form.flexible:
        return w[(_FIRST_CABLE + _CABLE_ROWS * i + _MOTOR_STAGE + 1) * lanes + at]
    per_radius = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + PER_RADIUS) * lanes + at]
    return -w[(_FIRST_CABLE + _CABLE_ROWS * i + _LENGTH_RATE) * lanes + at] * per_radius


@inline
def _request(form, lags, h, p, w, record, lanes):
    """Requested torques of a control period, from the actions within ±1 and the motor speeds at its start."""
    for i in range(form.cables):
        par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
        rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
        for at in range(lanes):
            speed = _motor_speed(form, p, w, at, lanes, i)
            action = min(max(record[(rec + DEMAND) * lanes + at], -1.0), 1.0)
            stall, slope = p[(par + STALL) * lanes + at], p[(par + SLOPE) * lanes + at]
            w[(row + _REQUEST) * lanes + at] = stall * action - slope * speed
            record[(rec + SPEED) * lanes + at] = speed
        if lags:
            for at in range(lanes):
                lag, gap, decay = p[(par + LAG) * lanes + at], 0.0, 0.0
                if lag > 0.0:
                    gap = record[(rec + LAGGED) * lanes + at] - w[(row + _REQUEST) * lanes + at]
                    decay = math.exp(-0.5 * h / lag)
                w[(row + _GAP) * lanes + at], w[(row + _DECAY) * lanes + at] = gap, decay


@inline
def _drive(form, lags, stage, p, w, lanes):
    """Torques of a stage: the requested torque after its lag, clipped to U± at the present motor speed."""
    for i in range(form.cables):
        par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
        if lags and stage in (1, 3):  # the stages are at 0, 1/2, 1/2 and 1 of the step
            for at in range(lanes):
                w[(row + _GAP) * lanes + at] *= w[(row + _DECAY) * lanes + at]
        for at in range(lanes):
            stall, drop = p[(par + STALL) * lanes + at], p[(par + SLOPE) * lanes + at]
            drop *= _motor_speed(form, p, w, at, lanes, i)
            torque = w[(row + _REQUEST) * lanes + at]
            if lags:
                torque += w[(row + _GAP) * lanes + at]
            torque = min(max(torque, -stall - drop), stall - drop)
            w[(row + (_TORQUE if form.flexible else _DRIVE)) * lanes + at] = torque


@inline
def _coulomb(p, at, lanes, i, speed):
    """Coulomb friction τ_c ω/√(ω² + ω₀²) of motor i."""
    friction = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + COULOMB_FRICTION) * lanes + at]
    smooth = p[FRICTION_SPEED * lanes + at]
    return friction * speed / math.sqrt(speed * speed + smooth * smooth)


@inline
def _rub(form, p, w, lanes):
    """Subtracts the Coulomb friction from the motor torques."""
    for i in range(form.cables):
        row = _FIRST_CABLE + _CABLE_ROWS * i + (_TORQUE if form.flexible else _DRIVE)
        for at in range(lanes):
            w[row * lanes + at] -= _coulomb(p, at, lanes, i, _motor_speed(form, p, w, at, lanes, i))


@inline
def _note_tensions(form, period_starts, unilateral, w, record, lanes):
    """Counts slack cables and updates the least tensions at the start of a physics step.

    Stores the tensions at the start of the control period.
    """
    for i in range(form.cables):
        row = _FIRST_CABLE + _CABLE_ROWS * i
        rec = FIRST_CABLE_RECORD + CABLE_RECORDS * i
        for at in range(lanes):
            tension = w[(row + _FREE_TENSION) * lanes + at]
            slack = 1.0 - w[(row + _TAUT) * lanes + at] if unilateral else (0.0 if tension > 0.0 else 1.0)
            tension = max(tension, 0.0) if unilateral else tension
            if period_starts:
                record[(rec + TENSION) * lanes + at] = tension
                record[(rec + LEAST_TENSION) * lanes + at] = tension
                record[(rec + SLACK) * lanes + at] = slack
            else:
                record[(rec + LEAST_TENSION) * lanes + at] = min(tension, record[(rec + LEAST_TENSION) * lanes + at])
                record[(rec + SLACK) * lanes + at] += slack


@inline
def _blend(stage, h, w, at, lanes, start, total, value, rate_row):
    """RK4 update of one row: the value of the next stage or, after the last stage, the new state."""
    ahead = h if stage == 2 else 0.5 * h
    weight = 2.0 if stage in (1, 2) else 1.0
    rate, begin = w[rate_row * lanes + at], w[start * lanes + at]
    sum_ = weight * rate + (w[total * lanes + at] if stage > 0 else 0.0)
    if stage < 3:
        w[total * lanes + at] = sum_
        w[value * lanes + at] = begin + ahead * rate
    else:
        end = begin + h / 6.0 * sum_
        w[start * lanes + at] = end
        w[value * lanes + at] = end


@inline
def _rk4(
    form,
    lags,
    rubs,
    period_starts,
    unilateral,
    h,
    p,
    w,
    record,
    lanes,
):
    """One physics step of a tile; _START becomes the new state."""
    for stage in range(4):
        _kinematics(form, form.flexible, p, w, lanes)
        if stage == 0 and period_starts:
            _request(form, lags, h, p, w, record, lanes)
        _drive(form, lags, stage, p, w, lanes)
        if stage == 0 and period_starts:
            for i in range(form.cables):
                row, rec = _FIRST_CABLE + _CABLE_ROWS * i, FIRST_CABLE_RECORD + CABLE_RECORDS * i
                for at in range(lanes):
                    record[(rec + TORQUE) * lanes + at] = w[(row + (_TORQUE if form.flexible else _DRIVE)) * lanes + at]
        if rubs:
            _rub(form, p, w, lanes)
        if form.elastic:
            _stretch(form, unilateral, p, w, lanes)
        elif form.jointed:
            _springs(form, unilateral, p, w, lanes)
        _dynamics(form, unilateral, p, w, lanes)
        if stage == 0:
            _note_tensions(form, period_starts, unilateral, w, record, lanes)
        # Positions first: their rate is the velocity of the stage, which changes next.
        for half in range(2):
            rate_row = _STAGE + 6 if half == 0 else _acceleration_row(form)
            for j in range(form.coordinates):
                value = 6 * half + j
                for at in range(lanes):
                    _blend(stage, h, w, at, lanes, _START + value, _SUM + value, _STAGE + value, rate_row + j)
        if form.flexible:
            for half in range(2):
                rate_row = _MOTOR_STAGE + 1 if half == 0 else _MOTOR_RATE
                for i in range(form.cables):
                    row = _FIRST_CABLE + _CABLE_ROWS * i
                    start, total, value = row + _MOTOR_START + half, row + _MOTOR_SUM + half, row + _MOTOR_STAGE + half
                    for at in range(lanes):
                        _blend(stage, h, w, at, lanes, start, total, value, row + rate_row)
        if form.double:
            for half in range(2):
                rate_row = _PULLEY_STAGE + 1 if half == 0 else _PULLEY_RATE
                for i in range(form.cables):
                    row = _pulley(form, i)
                    start, total, value = (
                        row + _PULLEY_START + half,
                        row + _PULLEY_SUM + half,
                        row + _PULLEY_STAGE + half,
                    )
                    for at in range(lanes):
                        _blend(stage, h, w, at, lanes, start, total, value, row + rate_row)


@inline
def _note_errors(form, period_starts, w, record, at, lanes, paths, path, line):
    """Updates the largest position and rotation error after a physics step, against a line of a path.

    A view of the line would count a reference.
    """
    dx, dy = w[_START * lanes + at] - paths[path, line, 0], w[(_START + 1) * lanes + at] - paths[path, line, 1]
    square, rotation = dx * dx + dy * dy, 0.0
    if form.dimensions == 3:
        dz = w[(_START + 2) * lanes + at] - paths[path, line, 2]
        square += dz * dz
    for j in range(form.dimensions, form.coordinates):
        rotation = max(rotation, abs(w[(_START + j) * lanes + at] - paths[path, line, j]))
    position = math.sqrt(square)
    if not period_starts:
        position = max(position, record[POSITION_PEAK * lanes + at])
        rotation = max(rotation, record[ROTATION_PEAK * lanes + at])
    record[POSITION_PEAK * lanes + at] = position
    record[ROTATION_PEAK * lanes + at] = rotation


@inline
def _load_tile(form, record, w, lanes):
    """Copies the state to the scratch memory. The search starts with the last known slack cables."""
    for j in range(form.coordinates):
        for at in range(lanes):
            w[(_START + j) * lanes + at] = record[(POSE + j) * lanes + at]
            w[(_STAGE + j) * lanes + at] = record[(POSE + j) * lanes + at]
            w[(_START + 6 + j) * lanes + at] = record[(VELOCITY + j) * lanes + at]
            w[(_STAGE + 6 + j) * lanes + at] = record[(VELOCITY + j) * lanes + at]
    for i in range(form.cables):
        for at in range(lanes):
            slack = record[(FIRST_CABLE_RECORD + CABLE_RECORDS * i + SLACK) * lanes + at]
            w[(_FIRST_CABLE + _CABLE_ROWS * i + _TAUT) * lanes + at] = 0.0 if slack > 0.0 else 1.0
    if form.flexible:
        for i in range(form.cables):
            row, rec = _FIRST_CABLE + _CABLE_ROWS * i, FIRST_CABLE_RECORD + CABLE_RECORDS * i
            for at in range(lanes):
                for half in range(2):
                    value = record[(rec + MOTOR_ANGLE + half) * lanes + at]
                    w[(row + _MOTOR_START + half) * lanes + at] = value
                    w[(row + _MOTOR_STAGE + half) * lanes + at] = value
    if form.double:
        for i in range(form.cables):
            for half in range(2):
                for at in range(lanes):
                    value = record[(_pulley_record(form.cables) + PULLEY_RECORDS * i + half) * lanes + at]
                    w[(_pulley(form, i) + _PULLEY_START + half) * lanes + at] = value
                    w[(_pulley(form, i) + _PULLEY_STAGE + half) * lanes + at] = value


@inline
def _advance(form, lanes, unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, steps, h):
    for tile in range(record.shape[0]):
        p, r = parameters[tile], record[tile]
        _load_tile(form, r, w, lanes)
        if not unilateral:
            for i in range(form.cables):
                for at in range(lanes):
                    w[(_FIRST_CABLE + _CABLE_ROWS * i + _TAUT) * lanes + at] = 1.0
        for substep in range(steps):
            _rk4(
                form,
                lags,
                rubs,
                substep == 0,
                unilateral,
                h,
                p,
                w,
                r,
                lanes,
            )
            for at in range(lanes):
                lane = tile * lanes + at
                line = min(step[lane] * steps + substep + 1, ends[path[lane]])
                _note_errors(form, substep == 0, w, r, at, lanes, paths, path[lane], line)
        for at in range(lanes):
            step[tile * lanes + at] += 1
        for j in range(form.coordinates):
            for at in range(lanes):
                r[(POSE + j) * lanes + at] = w[(_START + j) * lanes + at]
                r[(VELOCITY + j) * lanes + at] = w[(_START + 6 + j) * lanes + at]
        for i in range(form.cables):
            row, rec = _FIRST_CABLE + _CABLE_ROWS * i, FIRST_CABLE_RECORD + CABLE_RECORDS * i
            if form.double:
                for half in range(2):
                    for at in range(lanes):
                        value = w[(_pulley(form, i) + _PULLEY_START + half) * lanes + at]
                        r[(_pulley_record(form.cables) + PULLEY_RECORDS * i + half) * lanes + at] = value
            if form.flexible:
                for half in range(2):
                    for at in range(lanes):
                        r[(rec + MOTOR_ANGLE + half) * lanes + at] = w[(row + _MOTOR_START + half) * lanes + at]
            if lags:
                for at in range(lanes):
                    lagged = w[(row + _REQUEST) * lanes + at] + w[(row + _GAP) * lanes + at]
                    r[(rec + LAGGED) * lanes + at] = lagged


@inline
def _evaluate(form, lanes, unilateral, parameters, record, w, acceleration):
    for tile in range(record.shape[0]):
        p, r = parameters[tile], record[tile]
        _load_tile(form, r, w, lanes)
        for i in range(form.cables):
            row, rec = _FIRST_CABLE + _CABLE_ROWS * i, FIRST_CABLE_RECORD + CABLE_RECORDS * i
            for at in range(lanes):
                w[(row + (_TORQUE if form.flexible else _DRIVE)) * lanes + at] = r[(rec + TORQUE) * lanes + at]
                w[(row + _TAUT) * lanes + at] = 1.0
        _kinematics(form, form.flexible, p, w, lanes)
        _rub(form, p, w, lanes)
        if form.elastic:
            _stretch(form, unilateral, p, w, lanes)
        elif form.jointed:
            _springs(form, unilateral, p, w, lanes)
        _dynamics(form, unilateral, p, w, lanes)
        _note_tensions(form, True, unilateral, w, r, lanes)
        for j in range(form.coordinates):
            for at in range(lanes):
                acceleration[tile, j * lanes + at] = w[(_acceleration_row(form) + j) * lanes + at]


# --------------------------------------------------------------------------------------------- inverse dynamics


@inline
def _spatial_y(form, p, w, at, lanes):
    """y from Ẍ, the inverse of :func:`_spatial_acceleration`: y₁ = Rᵀp̈, ω̇ = P Θ̈ + Ṗ Θ̇."""
    push = _load(w, _RATE, at, lanes)
    roll, pitch, yaw = _load(w, _RATE + 3, at, lanes)
    spin = _load(w, _SPIN, at, lanes)
    sx, cx, sy = _load(w, _TRIG, at, lanes)
    level = w[(_TRIG + 3) * lanes + at] * yaw
    turn = (roll - sy * yaw, cx * pitch + sx * level, cx * level - sx * pitch)
    turn = (turn[0] + spin[0], turn[1] + spin[1], turn[2] + spin[2])
    y = (
        _dot(_load(w, _ROTATION, at, lanes), push),
        _dot(_load(w, _ROTATION + 3, at, lanes), push),
        _dot(_load(w, _ROTATION + 6, at, lanes), push),
    )
    _store(w, _Y, at, lanes, _from_centre(form, -1.0, y, turn, p, w, at, lanes))
    _store(w, _Y + 3, at, lanes, turn)


@inline
def _spatial_wrench(form, p, w, at, lanes):
    """Stores the wrench (f, g) = Σ row_i T_i that y requires in _LOAD."""
    y, load = _load(w, _Y, at, lanes), _load(w, _LOAD, at, lanes)
    turn, moment, inertia = _load(w, _Y + 3, at, lanes), _load(w, _LOAD + 3, at, lanes), _load(p, INERTIA, at, lanes)
    g = (
        _fma(-inertia[0], turn[0], moment[0]),
        _fma(-inertia[1], turn[1], moment[1]),
        _fma(-inertia[2], turn[2], moment[2]),
    )
    if form.lopsided:
        g = _ahead(-1.0, _times(_tensor(form, p, at, lanes), turn), moment)
    _store(w, _LOAD, at, lanes, _ahead(-p[MASS * lanes + at], y, load))
    _store(w, _LOAD + 3, at, lanes, g)


@inline
def _spatial_tensions(w, at, lanes):
    """Solves Σ row_i T_i = (f, g) for the tensions of six cables: T_i = row_i · (Σ row_i row_iᵀ)⁻¹ (f, g).

    The matrix is the square of one that may be badly conditioned, hence a second pass with what the first one left.
    """
    f, g = _load(w, _LOAD, at, lanes), _load(w, _LOAD + 3, at, lanes)
    zero = (0.0, 0.0, 0.0)
    a, b, c = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (zero, zero, zero), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    a, b, c = _add_row(a, b, c, 1.0, w, at, lanes, 0)
    a, b, c = _add_row(a, b, c, 1.0, w, at, lanes, 1)
    a, b, c = _add_row(a, b, c, 1.0, w, at, lanes, 2)
    a, b, c = _add_row(a, b, c, 1.0, w, at, lanes, 3)
    a, b, c = _add_row(a, b, c, 1.0, w, at, lanes, 4)
    a, b, c = _add_row(a, b, c, 1.0, w, at, lanes, 5)
    factors = _factored(a, b, c)
    for i in range(6):
        w[(_FIRST_CABLE + _CABLE_ROWS * i + _RESULTS + TENSIONS) * lanes + at] = 0.0
    f, g = _add_tensions(factors, f, g, w, at, lanes)
    _add_tensions(factors, f, g, w, at, lanes)


@inline
def _add_tensions(factors, f, g, w, at, lanes):
    """Adds the tensions for (f, g) to the results; returns the residual."""
    push, turn = _solved(factors, f, g)
    for i in range(6):
        row = _FIRST_CABLE + _CABLE_ROWS * i
        part = _dot(_load(w, row + _ROW, at, lanes), push) + _dot(_load(w, row + _ROW + 3, at, lanes), turn)
        w[(row + _RESULTS + TENSIONS) * lanes + at] += part
        f, g = _add_pull(f, g, part, w, at, lanes, i)
    return f, g


@inline
def _three_tensions(w, at, lanes):
    """Solves Σ row_i T_i = f for the tensions of three cables by Cramer's rule."""
    row, f = _FIRST_CABLE + _ROW, _load(w, _LOAD, at, lanes)
    one, two = _load(w, row, at, lanes), _load(w, row + _CABLE_ROWS, at, lanes)
    three = _load(w, row + 2 * _CABLE_ROWS, at, lanes)
    first, second, third = _cross(two, three), _cross(three, one), _cross(one, two)
    per, results = 1.0 / _dot(one, first), _FIRST_CABLE + _RESULTS + TENSIONS
    w[results * lanes + at] = _dot(first, f) * per
    w[(results + _CABLE_ROWS) * lanes + at] = _dot(second, f) * per
    w[(results + 2 * _CABLE_ROWS) * lanes + at] = _dot(third, f) * per


@inline
def _two_tensions(w, at, lanes):
    """Solves Σ u_i T_i = f for the tensions of two cables in a plane."""
    row, other = _FIRST_CABLE + _ROW, _FIRST_CABLE + _CABLE_ROWS + _ROW
    ax, ay, bx, by = w[row * lanes + at], w[(row + 1) * lanes + at], w[other * lanes + at], w[(other + 1) * lanes + at]
    fx, fy, results = w[_LOAD * lanes + at], w[(_LOAD + 1) * lanes + at], _FIRST_CABLE + _RESULTS + TENSIONS
    per = 1.0 / (ax * by - ay * bx)
    w[results * lanes + at] = (fx * by - fy * bx) * per
    w[(results + _CABLE_ROWS) * lanes + at] = (ax * fy - ay * fx) * per


@inline
def _planar_tensions(form, minimum, w, lanes):
    """Smallest T with Σ u_i T_i = f and T_i ≥ ``minimum``, pair by pair as :func:`textbook.tension_distribution`."""
    for at in range(lanes):
        fx, fy = w[_LOAD * lanes + at], w[(_LOAD + 1) * lanes + at]
        for i in range(form.cables):
            row = _FIRST_CABLE + _CABLE_ROWS * i + _ROW
            fx, fy = fx - minimum * w[row * lanes + at], fy - minimum * w[(row + 1) * lanes + at]
        w[_LOAD * lanes + at], w[(_LOAD + 1) * lanes + at] = fx, fy
        w[_LEAST_SUM * lanes + at] = np.inf
        for j in range(4):
            w[(_PAIR + j) * lanes + at] = 0.0
    for i in range(form.cables):
        for j in range(i + 1, form.cables):
            for at in range(lanes):
                _try_pair(w, at, lanes, i, j)
    for i in range(form.cables):
        for at in range(lanes):
            one, other = w[_PAIR * lanes + at], w[(_PAIR + 1) * lanes + at]
            pull = w[(_PAIR + 2) * lanes + at] if one == i else (w[(_PAIR + 3) * lanes + at] if other == i else 0.0)
            row = _FIRST_CABLE + _CABLE_ROWS * i + _RESULTS + TENSIONS
            w[row * lanes + at] = minimum + max(pull, 0.0)


@inline
def _try_pair(w, at, lanes, i, j):
    """Stores cables i and j and their tensions in _PAIR if they give the force with the smallest sum so far."""
    first_row, second_row = _FIRST_CABLE + _CABLE_ROWS * i + _ROW, _FIRST_CABLE + _CABLE_ROWS * j + _ROW
    ax, ay = w[first_row * lanes + at], w[(first_row + 1) * lanes + at]
    bx, by = w[second_row * lanes + at], w[(second_row + 1) * lanes + at]
    fx, fy = w[_LOAD * lanes + at], w[(_LOAD + 1) * lanes + at]
    determinant = ax * by - ay * bx
    first, second = (fx * by - fy * bx) / determinant, (ax * fy - ay * fx) / determinant
    # A force along one of the two cables gives a tiny negative value by rounding.
    slack = 1e-12 * (1.0 + abs(first) + abs(second))
    pulls = (first >= -slack) & (second >= -slack) & (abs(determinant) > 1e-12)
    better = pulls & (first + second < w[_LEAST_SUM * lanes + at])
    w[_LEAST_SUM * lanes + at] = first + second if better else w[_LEAST_SUM * lanes + at]
    w[_PAIR * lanes + at] = i if better else w[_PAIR * lanes + at]
    w[(_PAIR + 1) * lanes + at] = j if better else w[(_PAIR + 1) * lanes + at]
    w[(_PAIR + 2) * lanes + at] = first if better else w[(_PAIR + 2) * lanes + at]
    w[(_PAIR + 3) * lanes + at] = second if better else w[(_PAIR + 3) * lanes + at]


@inline
def _required_motor(form, p, w, at, lanes, i):
    """τ = r T + J β̈ + c β̇ (Eq. 1), plus Coulomb friction if rigid, and β̇ and β̈ of cable i."""
    par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
    per_radius = p[(par + PER_RADIUS) * lanes + at]
    rate = w[(row + _LENGTH_RATE) * lanes + at]
    acceleration = _along(form, w, at, lanes, i) + w[(row + _BIAS) * lanes + at]
    inertia = p[(par + INERTIA_PER_RADIUS2) * lanes + at] * acceleration
    damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * rate
    pull = w[(row + _RESULTS + TENSIONS) * lanes + at] - inertia - damping
    speed = -rate * per_radius
    friction = _coulomb(p, at, lanes, i, speed) if not form.flexible else 0.0
    w[(row + _RESULTS + TORQUES) * lanes + at] = pull / per_radius + friction
    w[(row + _RESULTS + SPEEDS) * lanes + at] = speed
    w[(row + _RESULTS + WINDINGS) * lanes + at] = -acceleration * per_radius


@inline
def _wrench(form, p, w, lanes):
    """y and the wrench that the cables have to apply, Σ row_i T_i, in _LOAD, for the motion of a tile."""
    _kinematics(form, False, p, w, lanes)
    if form.coordinates == 6:
        for at in range(lanes):
            _spatial_y(form, p, w, at, lanes)
        for at in range(lanes):
            _spatial_wrench(form, p, w, at, lanes)
        return
    for at in range(lanes):
        if form.coordinates == 3 and form.dimensions == 2:
            _plane_acceleration(-1.0, _RATE, _Y, w, at, lanes)
        else:
            for j in range(form.coordinates):
                w[(_Y + j) * lanes + at] = w[(_RATE + j) * lanes + at]
    for at in range(lanes):
        mass = p[MASS * lanes + at]
        if form.coordinates == 3:
            masses, y, load = _three_masses(form, p, at, lanes), _load(w, _Y, at, lanes), _load(w, _LOAD, at, lanes)
            rest = (load[0] - masses[0] * y[0], load[1] - masses[1] * y[1], load[2] - masses[2] * y[2])
            _store(w, _LOAD, at, lanes, rest)
        else:
            w[_LOAD * lanes + at] = -mass * w[_Y * lanes + at]
            fall = p[GRAVITY * lanes + at] - w[(_Y + 1) * lanes + at]
            w[(_LOAD + 1) * lanes + at] = mass * fall


@inline
def _tile_of_motion(form, lanes, first, p, w, mass, motion):
    """Copies a motion to a tile. The unused lanes of the last tile repeat the last robot."""
    count = mass.shape[0]
    for at in range(lanes):
        lane = min(first + at, count - 1)
        p[MASS * lanes + at] = mass[lane]
        for j in range(form.coordinates):
            w[(_STAGE + j) * lanes + at] = motion[0, lane, j]
            w[(_STAGE + 6 + j) * lanes + at] = motion[1, lane, j]
            w[(_RATE + j) * lanes + at] = motion[2, lane, j]


@inline
def _required(form, lanes, parameters, minimum, p, w, mass, motion, results):
    """Inverse dynamics of all lanes in tiles."""
    count = mass.shape[0]
    for row in range(parameters.shape[0]):
        for at in range(lanes):
            p[row * lanes + at] = parameters[row]
    for first in range(0, count, lanes):
        _tile_of_motion(form, lanes, first, p, w, mass, motion)
        _wrench(form, p, w, lanes)
        if form.coordinates == 6:
            for at in range(lanes):
                _spatial_tensions(w, at, lanes)
        elif form.coordinates == 3:
            for at in range(lanes):
                _three_tensions(w, at, lanes)
        elif form.cables == 2:
            for at in range(lanes):
                _two_tensions(w, at, lanes)
        else:
            _planar_tensions(form, minimum, w, lanes)
        for i in range(form.cables):
            for at in range(lanes):
                _required_motor(form, p, w, at, lanes, i)
        for result in range(4):
            for at in range(min(lanes, count - first)):
                for i in range(form.cables):
                    value = w[(_FIRST_CABLE + _CABLE_ROWS * i + _RESULTS + result) * lanes + at]
                    results[result, first + at, i] = value


@inline
def _demanded(form, lanes, parameters, p, w, mass, motion, structure, load, results):
    """S, load, pulley speeds and pulley accelerations of all lanes in tiles."""
    count = mass.shape[0]
    for row in range(parameters.shape[0]):
        for at in range(lanes):
            p[row * lanes + at] = parameters[row]
    for first in range(0, count, lanes):
        _tile_of_motion(form, lanes, first, p, w, mass, motion)
        _wrench(form, p, w, lanes)
        for i in range(form.cables):
            par, row = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i, _FIRST_CABLE + _CABLE_ROWS * i
            for at in range(min(lanes, count - first)):
                per_radius = p[(par + PER_RADIUS) * lanes + at]
                results[0, first + at, i] = -w[(row + _LENGTH_RATE) * lanes + at] * per_radius
                acceleration = _along(form, w, at, lanes, i) + w[(row + _BIAS) * lanes + at]
                results[1, first + at, i] = -acceleration * per_radius
                for j in range(form.coordinates):
                    structure[first + at, i, j] = w[(row + _ROW + j) * lanes + at]
        for at in range(min(lanes, count - first)):
            for j in range(form.coordinates):
                load[first + at, j] = -w[(_LOAD + j) * lanes + at]


# -------------------------------------------------------------------------------------------- forward kinematics


@inline
def _locate(form, lanes, parameters, iterations, tolerance, p, w, lengths, pose, squares, ended):
    """Poses of given cable lengths: Gauss-Newton steps of all lanes in tiles.

    The dynamics at rest solve ``(m I₃, I) y = −Σ row_i (t_i + μ_i row_i·y)``. With the excess of the length as t_i,
    μ_i = 1, and the damping as mass and inertia, y is the step. A step that increases the sum of the squares is halved.
    A lane ends after a step below the tolerance.
    """
    count = lengths.shape[0]
    for row in range(parameters.shape[0]):
        for at in range(lanes):
            p[row * lanes + at] = parameters[row]
    for first in range(0, count, lanes):
        for at in range(lanes):
            lane = min(first + at, count - 1)
            for j in range(form.coordinates):
                w[(_START + j) * lanes + at] = w[(_STAGE + j) * lanes + at] = pose[lane, j]
                w[(_STAGE + 6 + j) * lanes + at] = 0.0
                w[(_SUM + j) * lanes + at] = np.nan
            for i in range(form.cables):
                row = _FIRST_CABLE + _CABLE_ROWS * i
                w[(row + _REQUEST) * lanes + at] = lengths[lane, i]
                w[(row + _TAUT) * lanes + at] = 1.0
            w[_SQUARES * lanes + at], w[_ENDED * lanes + at] = np.inf, 0.0
        for _ in range(iterations):
            _kinematics(form, True, p, w, lanes)
            for at in range(lanes):
                w[_TRIAL * lanes + at] = 0.0
            for i in range(form.cables):
                row = _FIRST_CABLE + _CABLE_ROWS * i
                for at in range(lanes):
                    excess = w[(row + _LENGTH) * lanes + at] - w[(row + _REQUEST) * lanes + at]
                    w[(row + _KNOWN) * lanes + at] = excess
                    w[_TRIAL * lanes + at] += excess * excess
            for at in range(lanes):
                _solve_lane(form, p, w, at, lanes)
            _accelerations(form, p, w, lanes)
            finished = 1.0
            for at in range(lanes):
                finished *= _take_step(form, tolerance, w, at, lanes)
            if finished == 1.0:
                break
        for at in range(min(lanes, count - first)):
            for j in range(form.coordinates):
                pose[first + at, j] = w[(_START + j) * lanes + at]
            squares[first + at], ended[first + at] = w[_SQUARES * lanes + at], w[_ENDED * lanes + at] == 1.0


@inline
def _take_step(form, tolerance, w, at, lanes):
    """Accepts the pose of the stage or halves the step to it; returns whether the lane had ended before."""
    before = w[_ENDED * lanes + at]
    better = (w[_TRIAL * lanes + at] <= w[_SQUARES * lanes + at] + 1e-24) | (before == 1.0)  # NaN is not better
    w[_SQUARES * lanes + at] = w[_TRIAL * lanes + at] if better else w[_SQUARES * lanes + at]
    size = 0.0
    for j in range(form.coordinates):
        start = w[(_STAGE + j) * lanes + at] if better else w[(_START + j) * lanes + at]
        step = w[(_acceleration_row(form) + j) * lanes + at] if better else w[(_SUM + j) * lanes + at] / 2
        step = 0.0 if before == 1.0 else step
        size += abs(step)
        w[(_START + j) * lanes + at], w[(_SUM + j) * lanes + at] = start, step
        w[(_STAGE + j) * lanes + at] = start + step
    w[_ENDED * lanes + at] = 1.0 if size <= tolerance else 0.0
    return before


# ------------------------------------------------------------------------------------------------- entry points


class Compiled(NamedTuple):
    """Functions for one form of robots, which numba compiles at their first call.

    Shapes: parameters (tiles, parameter_rows·lanes), record (tiles, record_rows·lanes), w (scratch_rows·lanes,), paths
    (trajectories, lines, n): reference poses at physics steps, ends (trajectories,): last line of each path, path and
    step (tiles·lanes,): index of its path and control step of each lane. Of the inverse dynamics: parameters
    (parameter_rows,) of one robot, p (parameter_rows·lanes,) for a tile of copies, mass (N,), motion (3, N, n) =
    (X, Ẋ, Ẍ), structure (N, m, n), load (N, n).
    """

    advance: Any
    """``(unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, substeps, h)``: one control period;
    changes ``record`` and ``step``. ``lags`` and ``rubs``: whether some motor has a lag or Coulomb friction; without
    them the code is faster."""
    evaluate: Any
    """``(unilateral, parameters, record, w, acceleration)``: accelerations (tiles, n·lanes) and, in ``record``, the
    tensions for the torques in ``record``."""
    required: Any
    """``(parameters, minimum, p, w, mass, motion, results)``: tensions, torques, pulley speeds and pulley accelerations
    (4, N, m), in the order of TENSIONS to WINDINGS. As many cables as coordinates: the unique tensions; more cables,
    only of point masses in a plane: the smallest tensions of at least ``minimum``."""
    demanded: Any
    """``(parameters, p, w, mass, motion, structure, load, results)``: what a tension distribution needs, ``−Sᵀ T =
    load``, and pulley speeds and pulley accelerations (2, N, m). The coordinates of S and load are those of y."""
    locate: Any
    """``(parameters, iterations, tolerance, p, w, lengths, pose, squares, ended)``: poses (N, n), which are the guesses
    before, of cable lengths (N, m); sums of the squared length errors and whether the last step was below the
    tolerance, (N,). ``parameters`` have mass and inertia for the damping, no gravity, and J/r² = 1."""


@cache
def compiled(form: Form, lanes: int) -> Compiled:
    """The functions for a form: one source, compiled for one lane and for a tile, for each kind and each number of
    cables, whose loops are unrolled. Numba compiles for the form because the functions close over it."""

    compile_form = partial(entry_point, robot=form.robot_text)

    @compile_form
    def advance(unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, substeps, h):
        _advance(form, lanes, unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, substeps, h)

    @compile_form
    def evaluate(unilateral, parameters, record, w, acceleration):
        _evaluate(form, lanes, unilateral, parameters, record, w, acceleration)

    @compile_form
    def required(parameters, minimum, p, w, mass, motion, results):
        _required(form, lanes, parameters, minimum, p, w, mass, motion, results)

    @compile_form
    def demanded(parameters, p, w, mass, motion, structure, load, results):
        _demanded(form, lanes, parameters, p, w, mass, motion, structure, load, results)

    @compile_form
    def locate(parameters, iterations, tolerance, p, w, lengths, pose, squares, ended):
        _locate(form, lanes, parameters, iterations, tolerance, p, w, lengths, pose, squares, ended)

    return Compiled(advance, evaluate, required, demanded, locate)
