"""Arithmetic of the kernel: sine and cosine, vectors, and symmetric matrices of three and six
rows."""

from __future__ import annotations

import numpy as np

from cablebot_gym.physics.compiling import fma, inline


@inline
def dot(a, b):
    """Scalar product of two vectors."""
    return fma(a[2], b[2], fma(a[1], b[1], a[0] * b[0]))


@inline
def cross(a, b):
    """Vector product of two vectors."""
    return (
        fma(a[1], b[2], -(a[2] * b[1])),
        fma(a[2], b[0], -(a[0] * b[2])),
        fma(a[0], b[1], -(a[1] * b[0])),
    )


@inline
def add(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline
def subtract(a, b):
    """a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline
def scaled(factor, x):
    """factor x."""
    return factor * x[0], factor * x[1], factor * x[2]


@inline
def load_vector(array, row, at, lanes):
    """Three rows from ``row`` on for lane ``at``."""
    return array[row * lanes + at], array[(row + 1) * lanes + at], array[(row + 2) * lanes + at]


@inline
def store_vector(array, row, at, lanes, value):
    """Stores three rows from ``row`` on of lane ``at``."""
    array[row * lanes + at] = value[0]
    array[(row + 1) * lanes + at] = value[1]
    array[(row + 2) * lanes + at] = value[2]


@inline
def sincos(angle):
    """Vectorisable sine and cosine: Cody–Waite reduction to ±π/4, then the minimax polynomials of
    fdlibm."""
    turns = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - turns * 1.5707963267341256
    x = x - turns * 6.077100506506192e-11
    z = x * x
    sine = fma(z, 1.58969099521155010221e-10, -2.50507602534068634195e-08)
    sine = fma(z, fma(z, sine, 2.75573137070700676789e-06), -1.98412698298579493134e-04)
    sine = fma(z, fma(z, sine, 8.33333333332248946124e-03), -1.66666666666666324348e-01)
    sine = fma(x * z, sine, x)
    cosine = fma(z, -1.13596475577881948265e-11, 2.08757232129817482790e-09)
    cosine = fma(z, fma(z, cosine, -2.75573143513906633035e-07), 2.48015872894767294178e-05)
    cosine = fma(z, fma(z, cosine, -1.38888888888741095749e-03), 4.16666666666666019037e-02)
    cosine = fma(z * z, cosine, fma(z, -0.5, 1.0))
    # Conditional expressions become selects without branches, so that loops over lanes vectorise.
    quadrant = turns - 4.0 * np.floor(turns * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    s = cosine if odd else sine
    c = sine if odd else cosine
    s = -s if quadrant >= 2.0 else s
    c = -c if (quadrant == 1.0) | (quadrant == 2.0) else c
    return s, c


@inline
def atan2(y, x):
    """Vectorisable ``math.atan2``: reduction to ± π/8, then the minimax polynomial of fdlibm."""
    wide, high = abs(x), abs(y)
    longer = max(wide, high)
    shorter = min(wide, high)
    # Conditional expressions become selects, as in :func:`sincos`.
    steep = shorter > 0.4142135623730950488 * longer
    numerator = shorter - longer if steep else shorter
    denominator = longer + shorter if steep else longer
    t = numerator / denominator
    z = t * t
    r = fma(z, 1.62858201153657823623e-02, -3.65315727442169155270e-02)
    r = fma(z, fma(z, r, 4.97687799461593236017e-02), -5.83357013379057348645e-02)
    r = fma(z, fma(z, r, 6.66107313738753120669e-02), -7.69187620504482999495e-02)
    r = fma(z, fma(z, r, 9.09088713343650656196e-02), -1.11111104054623557880e-01)
    r = fma(z, fma(z, r, 1.42857142725034663711e-01), -1.99999999998764832476e-01)
    r = fma(z, r, 3.33333333333329318027e-01)
    angle = fma(-t * z, r, t)
    angle = angle + 0.78539816339744830962 if steep else angle
    angle = 1.57079632679489661923 - angle if high > wide else angle
    angle = 3.14159265358979323846 - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@inline
def add_scaled(factor, x, base):
    """base + factor x."""
    return fma(factor, x[0], base[0]), fma(factor, x[1], base[1]), fma(factor, x[2], base[2])


@inline
def add_outer(a, x, y):
    """a + x yᵀ for parallel x and y. The symmetric a is stored as (xx, xy, xz, yy, yz, zz)."""
    return (
        fma(x[0], y[0], a[0]),
        fma(x[0], y[1], a[1]),
        fma(x[0], y[2], a[2]),
        fma(x[1], y[1], a[3]),
        fma(x[1], y[2], a[4]),
        fma(x[2], y[2], a[5]),
    )


@inline
def symmetric_inverse(a):
    """Inverse of a symmetric 3 × 3 matrix by cofactors, with one division."""
    xx, xy, xz = cross((a[1], a[3], a[4]), (a[2], a[4], a[5]))
    per = 1.0 / dot((a[0], a[1], a[2]), (xx, xy, xz))
    yy = fma(a[0], a[5], -(a[2] * a[2]))
    yz = fma(a[1], a[2], -(a[0] * a[4]))
    zz = fma(a[0], a[3], -(a[1] * a[1]))
    return xx * per, xy * per, xz * per, yy * per, yz * per, zz * per


@inline
def symmetric_times(a, x):
    """Symmetric 3 × 3 matrix times a vector."""
    return (
        dot((a[0], a[1], a[2]), x),
        dot((a[1], a[3], a[4]), x),
        dot((a[2], a[4], a[5]), x),
    )


@inline
def factor_symmetric(a, b, c):
    """Factors of the symmetric 6 × 6 matrix ((a, b), (bᵀ, c)) for :func:`solve_factored`: its Schur
    complement."""
    inverse = symmetric_inverse(a)
    column0 = (b[0][0], b[1][0], b[2][0])
    column1 = (b[0][1], b[1][1], b[2][1])
    column2 = (b[0][2], b[1][2], b[2][2])
    e0 = symmetric_times(inverse, column0)
    e1 = symmetric_times(inverse, column1)
    e2 = symmetric_times(inverse, column2)
    complement = (
        c[0] - dot(column0, e0),
        c[1] - dot(column0, e1),
        c[2] - dot(column0, e2),
        c[3] - dot(column1, e1),
        c[4] - dot(column1, e2),
        c[5] - dot(column2, e2),
    )
    return inverse, (e0, e1, e2), symmetric_inverse(complement)


@inline
def solve_factored(factors, f, g):
    """Both halves of the solution for the right side (f, g)."""
    inverse, e, complement = factors
    right = subtract(g, (dot(e[0], f), dot(e[1], f), dot(e[2], f)))
    lower_half = symmetric_times(complement, right)
    upper_half = symmetric_times(inverse, f)
    upper_half = add_scaled(-lower_half[2], e[2], upper_half)
    upper_half = add_scaled(-lower_half[1], e[1], upper_half)
    upper_half = add_scaled(-lower_half[0], e[0], upper_half)
    return upper_half, lower_half
