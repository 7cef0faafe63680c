"""Inverse dynamics of a tile: tensions, torques and speeds that a motion demands."""

from __future__ import annotations

import numpy as np

from cablebot_gym.physics.compiling import fma, inline
from cablebot_gym.physics.kernel.arithmetic import (
    add_scaled,
    cross,
    dot,
    factor_symmetric,
    load_vector,
    solve_factored,
    store_vector,
    subtract,
    symmetric_times,
)
from cablebot_gym.physics.kernel.motors import coulomb_friction, load_friction
from cablebot_gym.physics.kernel.plane import plane_acceleration, three_masses
from cablebot_gym.physics.kernel.rows import (
    BIAS,
    CABLE_PARAMETERS,
    CABLE_ROWS,
    DAMPING_PER_RADIUS2,
    FIRST_CABLE,
    FIRST_CABLE_PARAMETER,
    GRAVITY,
    INERTIA,
    INERTIA_PER_RADIUS2,
    LEAST_SUM,
    LENGTH_RATE,
    LOAD,
    MASS,
    PAIR,
    PER_RADIUS,
    PULLEY_ACCELERATIONS,
    RATE,
    RESULTS,
    ROW,
    SPEEDS,
    STAGE,
    TENSIONS,
    TORQUES,
    UNKNOWNS,
)
from cablebot_gym.physics.kernel.space import inertia_tensor, spatial_y
from cablebot_gym.physics.kernel.stage import copy_parameters, stage_kinematics
from cablebot_gym.physics.kernel.taut import add_pull, add_row, length_acceleration


@inline
def _spatial_wrench(form, p, w, at, lanes):
    """Stores the wrench (f, g) = Σ row_i T_i that y requires in LOAD."""
    y = load_vector(w, UNKNOWNS, at, lanes)
    load = load_vector(w, LOAD, at, lanes)
    turn = load_vector(w, UNKNOWNS + 3, at, lanes)
    moment = load_vector(w, LOAD + 3, at, lanes)
    if form.lopsided:
        g = add_scaled(-1.0, symmetric_times(inertia_tensor(form, p, at, lanes), turn), moment)
    else:
        inertia = load_vector(p, INERTIA, at, lanes)
        g = (
            fma(-inertia[0], turn[0], moment[0]),
            fma(-inertia[1], turn[1], moment[1]),
            fma(-inertia[2], turn[2], moment[2]),
        )
    store_vector(w, LOAD, at, lanes, add_scaled(-p[MASS * lanes + at], y, load))
    store_vector(w, LOAD + 3, at, lanes, g)


@inline
def _spatial_tensions(w, at, lanes):
    """Solves Σ row_i T_i = (f, g) for the tensions of six cables: T_i = row_i · (Σ row_i row_iᵀ)⁻¹
    (f, g).

    The matrix is the square of one that may be badly conditioned, hence a second pass with what the
    first one left.
    """
    f = load_vector(w, LOAD, at, lanes)
    g = load_vector(w, LOAD + 3, at, lanes)
    zero = (0.0, 0.0, 0.0)
    a = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    b = (zero, zero, zero)
    c = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    a, b, c = add_row(a, b, c, 1.0, w, at, lanes, 0)
    a, b, c = add_row(a, b, c, 1.0, w, at, lanes, 1)
    a, b, c = add_row(a, b, c, 1.0, w, at, lanes, 2)
    a, b, c = add_row(a, b, c, 1.0, w, at, lanes, 3)
    a, b, c = add_row(a, b, c, 1.0, w, at, lanes, 4)
    a, b, c = add_row(a, b, c, 1.0, w, at, lanes, 5)
    factors = factor_symmetric(a, b, c)
    for i in range(6):
        w[(FIRST_CABLE + CABLE_ROWS * i + RESULTS + TENSIONS) * lanes + at] = 0.0
    f, g = _add_tensions(factors, f, g, w, at, lanes)
    _add_tensions(factors, f, g, w, at, lanes)


@inline
def _add_tensions(factors, f, g, w, at, lanes):
    """Adds the tensions for (f, g) to the results; returns the residual."""
    push, turn = solve_factored(factors, f, g)
    for i in range(6):
        row = FIRST_CABLE + CABLE_ROWS * i
        tension = dot(load_vector(w, row + ROW, at, lanes), push)
        tension += dot(load_vector(w, row + ROW + 3, at, lanes), turn)
        w[(row + RESULTS + TENSIONS) * lanes + at] += tension
        f, g = add_pull(f, g, tension, w, at, lanes, i)
    return f, g


@inline
def _three_tensions(w, at, lanes):
    """Solves Σ row_i T_i = f for the tensions of three cables by Cramer's rule."""
    row = FIRST_CABLE + ROW
    f = load_vector(w, LOAD, at, lanes)
    a = load_vector(w, row, at, lanes)
    b = load_vector(w, row + CABLE_ROWS, at, lanes)
    c = load_vector(w, row + 2 * CABLE_ROWS, at, lanes)
    b_cross_c = cross(b, c)
    per = 1.0 / dot(a, b_cross_c)
    results = FIRST_CABLE + RESULTS + TENSIONS
    w[results * lanes + at] = dot(b_cross_c, f) * per
    w[(results + CABLE_ROWS) * lanes + at] = dot(cross(c, a), f) * per
    w[(results + 2 * CABLE_ROWS) * lanes + at] = dot(cross(a, b), f) * per


@inline
def _directions(w, at, lanes, i, j):
    """Directions of cables i and j in a plane."""
    row_i = FIRST_CABLE + CABLE_ROWS * i + ROW
    row_j = FIRST_CABLE + CABLE_ROWS * j + ROW
    ax = w[row_i * lanes + at]
    ay = w[(row_i + 1) * lanes + at]
    bx = w[row_j * lanes + at]
    by = w[(row_j + 1) * lanes + at]
    return ax, ay, bx, by


@inline
def _two_tensions(w, at, lanes):
    """Solves Σ u_i T_i = f for the tensions of two cables in a plane."""
    ax, ay, bx, by = _directions(w, at, lanes, 0, 1)
    fx = w[LOAD * lanes + at]
    fy = w[(LOAD + 1) * lanes + at]
    results = FIRST_CABLE + RESULTS + TENSIONS
    per = 1.0 / (ax * by - ay * bx)
    w[results * lanes + at] = (fx * by - fy * bx) * per
    w[(results + CABLE_ROWS) * lanes + at] = (ax * fy - ay * fx) * per


@inline
def _planar_tensions(form, minimum, start, w, lanes):
    """Smallest T with Σ u_i T_i = f and T_i ≥ the ``minimum`` of each robot, from ``start`` on, pair
    by pair as :func:`textbook.tension_distribution`."""
    last = minimum.shape[0] - 1
    for at in range(lanes):
        least = minimum[min(start + at, last)]
        fx = w[LOAD * lanes + at]
        fy = w[(LOAD + 1) * lanes + at]
        for i in range(form.cables):
            row = FIRST_CABLE + CABLE_ROWS * i + ROW
            fx = fx - least * w[row * lanes + at]
            fy = fy - least * w[(row + 1) * lanes + at]
        w[LOAD * lanes + at] = fx
        w[(LOAD + 1) * lanes + at] = fy
        w[LEAST_SUM * lanes + at] = np.inf
        for j in range(4):
            w[(PAIR + j) * lanes + at] = 0.0
    for i in range(form.cables):
        for j in range(i + 1, form.cables):
            for at in range(lanes):
                _try_pair(w, at, lanes, i, j)
    for i in range(form.cables):
        for at in range(lanes):
            pull = 0.0
            if w[PAIR * lanes + at] == i:
                pull = w[(PAIR + 2) * lanes + at]
            elif w[(PAIR + 1) * lanes + at] == i:
                pull = w[(PAIR + 3) * lanes + at]
            row = FIRST_CABLE + CABLE_ROWS * i + RESULTS + TENSIONS
            w[row * lanes + at] = minimum[min(start + at, last)] + max(pull, 0.0)


@inline
def _try_pair(w, at, lanes, i, j):
    """Stores cables i and j and their tensions in PAIR if they give the force with the smallest sum
    so far."""
    ax, ay, bx, by = _directions(w, at, lanes, i, j)
    fx = w[LOAD * lanes + at]
    fy = w[(LOAD + 1) * lanes + at]
    determinant = ax * by - ay * bx
    tension_i = (fx * by - fy * bx) / determinant
    tension_j = (ax * fy - ay * fx) / determinant
    # A force along one of the two cables gives a tiny negative value by rounding.
    slack = 1e-12 * (1.0 + abs(tension_i) + abs(tension_j))
    pulls = (tension_i >= -slack) & (tension_j >= -slack) & (abs(determinant) > 1e-12)
    better = pulls & (tension_i + tension_j < w[LEAST_SUM * lanes + at])
    # Every lane stores its value or the old one, a select: loops over lanes with branches do not
    # vectorise.
    w[LEAST_SUM * lanes + at] = tension_i + tension_j if better else w[LEAST_SUM * lanes + at]
    w[PAIR * lanes + at] = i if better else w[PAIR * lanes + at]
    w[(PAIR + 1) * lanes + at] = j if better else w[(PAIR + 1) * lanes + at]
    w[(PAIR + 2) * lanes + at] = tension_i if better else w[(PAIR + 2) * lanes + at]
    w[(PAIR + 3) * lanes + at] = tension_j if better else w[(PAIR + 3) * lanes + at]


@inline
def _required_motor(form, p, w, at, lanes, i):
    """τ = r T + J β̈ + c β̇ (Eq. 1), plus friction if rigid, and β̇ and β̈ of cable i."""
    par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
    row = FIRST_CABLE + CABLE_ROWS * i
    per_radius = p[(par + PER_RADIUS) * lanes + at]
    rate = w[(row + LENGTH_RATE) * lanes + at]
    acceleration = length_acceleration(form, w, at, lanes, i) + w[(row + BIAS) * lanes + at]
    inertia = p[(par + INERTIA_PER_RADIUS2) * lanes + at] * acceleration
    damping = p[(par + DAMPING_PER_RADIUS2) * lanes + at] * rate
    tension = w[(row + RESULTS + TENSIONS) * lanes + at]
    speed = -rate * per_radius
    friction = 0.0
    if not form.flexible:
        friction = coulomb_friction(p, at, lanes, i, speed)
        if form.load_friction:
            tension = tension * (1.0 + load_friction(form, p, at, lanes, i, speed))
    pull = tension - inertia - damping
    w[(row + RESULTS + TORQUES) * lanes + at] = pull / per_radius + friction
    w[(row + RESULTS + SPEEDS) * lanes + at] = speed
    w[(row + RESULTS + PULLEY_ACCELERATIONS) * lanes + at] = -acceleration * per_radius


@inline
def _wrench(form, p, w, lanes):
    """y and the wrench that the cables have to apply, Σ row_i T_i, in LOAD, for the motion of a
    tile."""
    stage_kinematics(form, False, p, w, lanes)
    if form.coordinates == 6:
        for at in range(lanes):
            spatial_y(form, p, w, at, lanes)
        for at in range(lanes):
            _spatial_wrench(form, p, w, at, lanes)
        return
    for at in range(lanes):
        if form.coordinates == 3 and form.dimensions == 2:
            plane_acceleration(-1.0, RATE, UNKNOWNS, w, at, lanes)
        else:
            for j in range(form.coordinates):
                w[(UNKNOWNS + j) * lanes + at] = w[(RATE + j) * lanes + at]
    for at in range(lanes):
        mass = p[MASS * lanes + at]
        if form.coordinates == 3:
            masses = three_masses(form, p, at, lanes)
            y = load_vector(w, UNKNOWNS, at, lanes)
            load = load_vector(w, LOAD, at, lanes)
            momentum_rate = (masses[0] * y[0], masses[1] * y[1], masses[2] * y[2])
            store_vector(w, LOAD, at, lanes, subtract(load, momentum_rate))
        else:
            w[LOAD * lanes + at] = -mass * w[UNKNOWNS * lanes + at]
            fall = p[GRAVITY * lanes + at] - w[(UNKNOWNS + 1) * lanes + at]
            w[(LOAD + 1) * lanes + at] = mass * fall


@inline
def _tile_of_motion(form, lanes, start, p, w, mass, motion):
    """Copies a motion to a tile. The unused lanes of the last tile repeat the last robot."""
    count = mass.shape[0]
    for at in range(lanes):
        lane = min(start + at, count - 1)
        p[MASS * lanes + at] = mass[lane]
        for j in range(form.coordinates):
            w[(STAGE + j) * lanes + at] = motion[0, lane, j]
            w[(STAGE + 6 + j) * lanes + at] = motion[1, lane, j]
            w[(RATE + j) * lanes + at] = motion[2, lane, j]


@inline
def required_tiles(form, lanes, parameters, minimum, p, w, mass, motion, results):
    """Inverse dynamics of all lanes in tiles."""
    count = mass.shape[0]
    copy_parameters(parameters, p, lanes)
    for start in range(0, count, lanes):
        _tile_of_motion(form, lanes, start, p, w, mass, motion)
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
            _planar_tensions(form, minimum, start, w, lanes)
        for i in range(form.cables):
            for at in range(lanes):
                _required_motor(form, p, w, at, lanes, i)
        for result in range(4):
            for at in range(min(lanes, count - start)):
                for i in range(form.cables):
                    value = w[(FIRST_CABLE + CABLE_ROWS * i + RESULTS + result) * lanes + at]
                    results[result, start + at, i] = value


@inline
def demanded_tiles(form, lanes, parameters, p, w, mass, motion, structure, load, y, results):
    """S, load, y, pulley speeds and pulley accelerations of all lanes in tiles."""
    count = mass.shape[0]
    copy_parameters(parameters, p, lanes)
    for start in range(0, count, lanes):
        _tile_of_motion(form, lanes, start, p, w, mass, motion)
        _wrench(form, p, w, lanes)
        for i in range(form.cables):
            par = FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * i
            row = FIRST_CABLE + CABLE_ROWS * i
            for at in range(min(lanes, count - start)):
                per_radius = p[(par + PER_RADIUS) * lanes + at]
                results[0, start + at, i] = -w[(row + LENGTH_RATE) * lanes + at] * per_radius
                acceleration = (
                    length_acceleration(form, w, at, lanes, i) + w[(row + BIAS) * lanes + at]
                )
                results[1, start + at, i] = -acceleration * per_radius
                for j in range(form.coordinates):
                    structure[start + at, i, j] = w[(row + ROW + j) * lanes + at]
        for at in range(min(lanes, count - start)):
            for j in range(form.coordinates):
                load[start + at, j] = -w[(LOAD + j) * lanes + at]
                y[start + at, j] = w[(UNKNOWNS + j) * lanes + at]
