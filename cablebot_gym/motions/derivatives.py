"""Derivatives of motions with respect to time; the first axis of each array is their order, 0 to 4."""

from __future__ import annotations

import numpy as np

from cablebot_gym.kinematics import Array


def scaled(derivatives: Array, factor: float) -> Array:
    """Derivatives 0 to 4 of ``f(factor · t)`` from those of f; the first axis is the order."""
    return np.stack([derivative * factor**order for order, derivative in enumerate(derivatives)])


def composed(outer: Array, inner: Array) -> Array:
    """Derivatives 0 to 4 of ``f(φ(t))`` by Faà di Bruno's formula.

    Args:
        outer: f and its derivatives with respect to φ at φ(t), shape (5, ...).
        inner: φ and its time derivatives, shape (5, ...).
    """
    f, f1, f2, f3, f4 = outer
    _, p1, p2, p3, p4 = inner
    return np.stack(
        [
            f,
            f1 * p1,
            f2 * p1**2 + f1 * p2,
            f3 * p1**3 + 3 * f2 * p1 * p2 + f1 * p3,
            f4 * p1**4 + 6 * f3 * p1**2 * p2 + f2 * (3 * p2**2 + 4 * p1 * p3) + f1 * p4,
        ]
    )


def sine_derivatives(angle: Array) -> Array:
    """sin and its derivatives 1 to 5, shape (6, ...). Rows 0 to 4 are those of sin, rows 1 to 5
    those of cos."""
    sine = np.sin(angle)
    cosine = np.cos(angle)
    return np.stack([sine, cosine, -sine, -cosine, sine, cosine])


def turn_from_rest(fraction: Array) -> Array:
    """Angle of the paper's circle and its derivatives 1 to 4 at fractions of the duration, shape
    (5, ...): a turn with constant angular acceleration up to half time and the opposite after it.

    The higher derivatives are zero, at the jumps as well.
    """
    accelerates = fraction <= 0.5
    from_rest = np.where(accelerates, fraction, 1 - fraction)
    acceleration = np.where(accelerates, 8 * np.pi, -8 * np.pi)
    turned = 4 * np.pi * from_rest**2
    angle = np.where(accelerates, turned, 2 * np.pi - turned)
    zero = np.zeros_like(angle)
    return np.stack([angle, 8 * np.pi * from_rest, acceleration, zero, zero])


def circle(center: tuple[float, ...], radius: float, angle: Array) -> Array:
    """Motion on a circle from the angle and its time derivatives, shape (5, ..., n)."""
    waves = radius * sine_derivatives(angle[0])
    return in_plane(center, waves[1:], waves[:5], angle)


def in_plane(center: tuple[float, ...], x: Array, y: Array, angle: Array) -> Array:
    """Derivatives of ``center + (x(φ(t)), y(φ(t)), 0, …)`` from x, y, φ and their derivatives,
    shape (5, ..., n)."""
    derivatives = np.zeros((*angle.shape, len(center)))
    derivatives[0] = center
    derivatives[..., 0] += composed(x, angle)
    derivatives[..., 1] += composed(y, angle)
    return derivatives
