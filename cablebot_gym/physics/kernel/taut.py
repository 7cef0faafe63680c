"""Accelerations of one lane for given tensions, and the set of cables that pull."""

from __future__ import annotations

from cablebot_gym.physics.compiling import fma, helper, inline
from cablebot_gym.physics.kernel.arithmetic import (
    add_outer,
    add_scaled,
    dot,
    factor_symmetric,
    load_vector,
    scaled,
    solve_factored,
    store_vector,
    symmetric_inverse,
    symmetric_times,
)
from cablebot_gym.physics.kernel.plane import three_masses
from cablebot_gym.physics.kernel.rows import (
    BIAS,
    CABLE_PARAMETERS,
    CABLE_ROWS,
    DAMPING_PER_RADIUS2,
    DRIVE,
    FIRST_CABLE,
    FIRST_CABLE_PARAMETER,
    FORCE,
    FREE_TENSION,
    GRAVITY,
    GRIP,
    INERTIA_PER_RADIUS2,
    KNOWN,
    LENGTH_RATE,
    LOAD,
    MASS,
    PER_RADIUS,
    ROW,
    TAUT,
    UNKNOWNS,
    WRONG,
)
from cablebot_gym.physics.kernel.space import inertia_tensor


@inline
def _rotor_mass(form, p, w, at, lanes, i):
    """Tension per cable acceleration: J/r², less what load friction takes."""
    mass = p[(FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i + INERTIA_PER_RADIUS2) * lanes + at]
    if form.grips:
        mass = mass * w[(FIRST_CABLE + CABLE_ROWS * i + GRIP) * lanes + at]
    return mass


@inline
def cable_weights(form, p, w, at, lanes, i):
    """(J/r²) and the tension without the unknown part of q̈; both are zero for a slack cable."""
    taut = w[(FIRST_CABLE + CABLE_ROWS * i + TAUT) * lanes + at]
    mu = _rotor_mass(form, p, w, at, lanes, i)
    return taut * mu, taut * w[(FIRST_CABLE + CABLE_ROWS * i + KNOWN) * lanes + at]


@inline
def _known_tensions(form, p, w, at, lanes):
    """κ/r + (J/r²)·bias + (c/r²) q̇ of all cables."""
    for i in range(form.cables):
        par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
        row = FIRST_CABLE + CABLE_ROWS * i
        drive = w[(row + DRIVE) * lanes + at] * p[(par + PER_RADIUS) * lanes + at]
        damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * w[(row + LENGTH_RATE) * lanes + at]
        inertia = p[(par + INERTIA_PER_RADIUS2) * lanes + at]
        known = fma(inertia, w[(row + BIAS) * lanes + at], drive + damping)
        if form.grips:
            known = known * w[(row + GRIP) * lanes + at]
        w[(row + KNOWN) * lanes + at] = known


@inline
def _add_cable(form, a, b, c, f, g, p, w, at, lanes, i):
    """Adds cable i to the left side ((a, b), (bᵀ, c)) and subtracts its known tension from the
    right side (f, g)."""
    mu, known = cable_weights(form, p, w, at, lanes, i)
    a, b, c = add_row(a, b, c, mu, w, at, lanes, i)
    f, g = add_pull(f, g, known, w, at, lanes, i)
    return a, b, c, f, g


@inline
def add_row(a, b, c, weight, w, at, lanes, i):
    """Adds weight · row_i row_iᵀ to ((a, b), (bᵀ, c))."""
    row = FIRST_CABLE + CABLE_ROWS * i + ROW
    u = load_vector(w, row, at, lanes)
    n = load_vector(w, row + 3, at, lanes)
    weighted = scaled(weight, u)
    b = (
        add_scaled(weighted[0], n, b[0]),
        add_scaled(weighted[1], n, b[1]),
        add_scaled(weighted[2], n, b[2]),
    )
    return add_outer(a, weighted, u), b, add_outer(c, scaled(weight, n), n)


@inline
def add_pull(f, g, tension, w, at, lanes, i):
    """Subtracts the pull of cable i, row_i · tension, from (f, g)."""
    row = FIRST_CABLE + CABLE_ROWS * i + ROW
    f = add_scaled(-tension, load_vector(w, row, at, lanes), f)
    g = add_scaled(-tension, load_vector(w, row + 3, at, lanes), g)
    return f, g


@inline
def _spatial_solve(form, p, w, at, lanes):
    """y for the current set of taut cables. The cables are not in a loop: a loop that carries
    tuples is slower."""
    mass = p[MASS * lanes + at]
    zero = (0.0, 0.0, 0.0)
    a = (mass, 0.0, 0.0, mass, 0.0, mass)
    b = (zero, zero, zero)
    c = inertia_tensor(form, p, at, lanes)
    f = load_vector(w, LOAD, at, lanes)
    g = load_vector(w, LOAD + 3, at, lanes)
    a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 0)
    a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 1)
    a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 2)
    a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 3)
    a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 4)
    a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 5)
    if form.cables > 6:
        a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 6)
    if form.cables > 7:
        a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, 7)
    for i in range(8, form.cables):
        a, b, c, f, g = _add_cable(form, a, b, c, f, g, p, w, at, lanes, i)
    push, turn = solve_factored(factor_symmetric(a, b, c), f, g)
    store_vector(w, UNKNOWNS, at, lanes, push)
    store_vector(w, UNKNOWNS + 3, at, lanes, turn)


@inline
def _planar_solve(form, p, w, at, lanes):
    """y = Ẍ for the current set of taut cables, from two equations. Gravity acts along y."""
    mass = p[MASS * lanes + at]
    xx, xy, yy = mass, 0.0, mass
    fx = p[FORCE * lanes + at]
    fy = fma(mass, p[GRAVITY * lanes + at], p[(FORCE + 1) * lanes + at])
    for i in range(form.cables):
        row = FIRST_CABLE + CABLE_ROWS * i
        mu, known = cable_weights(form, p, w, at, lanes, i)
        ux = w[(row + ROW) * lanes + at]
        uy = w[(row + ROW + 1) * lanes + at]
        xx = xx + mu * ux * ux
        xy = xy + mu * ux * uy
        yy = yy + mu * uy * uy
        fx = fx - known * ux
        fy = fy - known * uy
    per = 1.0 / (xx * yy - xy * xy)
    w[UNKNOWNS * lanes + at] = (yy * fx - xy * fy) * per
    w[(UNKNOWNS + 1) * lanes + at] = (xx * fy - xy * fx) * per


@inline
def _three_solve(form, p, w, at, lanes):
    """y for the current set of taut cables, from three equations."""
    xx, yy, zz = three_masses(form, p, at, lanes)
    xy, xz, yz = 0.0, 0.0, 0.0
    fx, fy, fz = load_vector(w, LOAD, at, lanes)
    for i in range(form.cables):
        mu, known = cable_weights(form, p, w, at, lanes, i)
        ux, uy, uz = load_vector(w, FIRST_CABLE + CABLE_ROWS * i + ROW, at, lanes)
        hx, hy, hz = mu * ux, mu * uy, mu * uz
        xx = fma(hx, ux, xx)
        xy = fma(hx, uy, xy)
        xz = fma(hx, uz, xz)
        yy = fma(hy, uy, yy)
        yz = fma(hy, uz, yz)
        zz = fma(hz, uz, zz)
        fx = fma(-known, ux, fx)
        fy = fma(-known, uy, fy)
        fz = fma(-known, uz, fz)
    y = symmetric_times(symmetric_inverse((xx, xy, xz, yy, yz, zz)), (fx, fy, fz))
    store_vector(w, UNKNOWNS, at, lanes, y)


@inline
def length_acceleration(form, w, at, lanes, i):
    """row_i · y."""
    row = FIRST_CABLE + CABLE_ROWS * i + ROW
    along = w[row * lanes + at] * w[UNKNOWNS * lanes + at]
    along += w[(row + 1) * lanes + at] * w[(UNKNOWNS + 1) * lanes + at]
    if form.coordinates > 2:
        along += w[(row + 2) * lanes + at] * w[(UNKNOWNS + 2) * lanes + at]
    if form.coordinates == 6:
        along += dot(load_vector(w, row + 3, at, lanes), load_vector(w, UNKNOWNS + 3, at, lanes))
    return along


@inline
def _free_tension(form, p, w, at, lanes, i):
    """t_i: the tension if positive; otherwise the cable is slack and −r t_i is the take-up torque
    u."""
    mu = _rotor_mass(form, p, w, at, lanes, i)
    known = w[(FIRST_CABLE + CABLE_ROWS * i + KNOWN) * lanes + at]
    tension = known + mu * length_acceleration(form, w, at, lanes, i)
    w[(FIRST_CABLE + CABLE_ROWS * i + FREE_TENSION) * lanes + at] = tension
    return tension


@inline
def pulled_lane(form, p, w, at, lanes):
    """y for the tensions of elastic cables."""
    mass = p[MASS * lanes + at]
    if form.coordinates == 6:
        f = load_vector(w, LOAD, at, lanes)
        g = load_vector(w, LOAD + 3, at, lanes)
        for i in range(form.cables):
            tension = w[(FIRST_CABLE + CABLE_ROWS * i + KNOWN) * lanes + at]
            f, g = add_pull(f, g, tension, w, at, lanes, i)
        per_inertia = symmetric_inverse(inertia_tensor(form, p, at, lanes))
        store_vector(w, UNKNOWNS, at, lanes, (f[0] / mass, f[1] / mass, f[2] / mass))
        store_vector(w, UNKNOWNS + 3, at, lanes, symmetric_times(per_inertia, g))
    elif form.coordinates == 3:
        masses = three_masses(form, p, at, lanes)
        f = load_vector(w, LOAD, at, lanes)
        for i in range(form.cables):
            tension = w[(FIRST_CABLE + CABLE_ROWS * i + KNOWN) * lanes + at]
            u = load_vector(w, FIRST_CABLE + CABLE_ROWS * i + ROW, at, lanes)
            f = add_scaled(-tension, u, f)
        y = (f[0] / masses[0], f[1] / masses[1], f[2] / masses[2])
        store_vector(w, UNKNOWNS, at, lanes, y)
    else:
        fx = p[FORCE * lanes + at]
        fy = fma(mass, p[GRAVITY * lanes + at], p[(FORCE + 1) * lanes + at])
        for i in range(form.cables):
            row = FIRST_CABLE + CABLE_ROWS * i
            tension = w[(row + KNOWN) * lanes + at]
            fx = fma(-tension, w[(row + ROW) * lanes + at], fx)
            fy = fma(-tension, w[(row + ROW + 1) * lanes + at], fy)
        w[UNKNOWNS * lanes + at] = fx / mass
        w[(UNKNOWNS + 1) * lanes + at] = fy / mass


@inline
def solve_lane(form, p, w, at, lanes):
    """y for the current set of taut cables."""
    if form.coordinates == 6:
        _spatial_solve(form, p, w, at, lanes)
    elif form.coordinates == 3:
        _three_solve(form, p, w, at, lanes)
    else:
        _planar_solve(form, p, w, at, lanes)


@helper
def _settle_lane(form, p, w, at, lanes):
    """Finds the taut set of one lane. All wrong cables change sides; after too many trials, only
    the last one does.

    The second rule is Murty's least-index rule, which terminates for every P-matrix, such as that
    of this problem.
    """
    for trial in range(10 + 2 ** min(form.cables, 20)):
        wrong = 0
        for i in range(form.cables):
            taut = (FIRST_CABLE + CABLE_ROWS * i + TAUT) * lanes + at
            pulls = 1.0 if _free_tension(form, p, w, at, lanes, i) > 0.0 else 0.0
            if pulls != w[taut]:
                wrong = i + 1
                if trial < 10:
                    w[taut] = pulls
        if wrong == 0:
            return
        if trial >= 10:
            taut = (FIRST_CABLE + CABLE_ROWS * (wrong - 1) + TAUT) * lanes + at
            w[taut] = 1.0 - w[taut]
        solve_lane(form, p, w, at, lanes)


@inline
def taut_sets(form, unilateral, p, w, lanes):
    """y and the taut sets of all lanes whose cables do not stretch."""
    for at in range(lanes):
        _known_tensions(form, p, w, at, lanes)
        solve_lane(form, p, w, at, lanes)
    for at in range(lanes):
        wrong = 0.0
        for i in range(form.cables):
            pulls = 1.0 if _free_tension(form, p, w, at, lanes, i) > 0.0 else 0.0
            taut = w[(FIRST_CABLE + CABLE_ROWS * i + TAUT) * lanes + at]
            wrong += (pulls - taut) * (pulls - taut)
        w[WRONG * lanes + at] = wrong
    if unilateral:
        wrong = 0.0
        for at in range(lanes):
            wrong = max(wrong, w[WRONG * lanes + at])
        if wrong > 0.0:
            for at in range(lanes):
                if w[WRONG * lanes + at] > 0.0:
                    _settle_lane(form, p, w, at, lanes)
