"""The upper certificate against hand calculation, quadrature of its own proof, and all that carries
a payload."""

import dataclasses
import json
import math
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from oracles import one_dimension
from scipy.optimize import brentq

from cablebot_gym.bounds.certificate import (
    planar_certificate,
    proved_mass,
    upper_bound,
)
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import find_trajectory

CIRCLE = find_trajectory("paper-planar", 2)
BEST_KNOWN = 3.850
"""Total mass [kg] that ``cablebot best-known CableBot-Planar-v0 --trajectory paper-planar``
verifies within 10 mm."""


@cache
def certificate(name="paper-planar", position=0.01, passes=1):
    return planar_certificate(
        PLANAR, find_trajectory(name, 2), ErrorBounds(position=position), passes=passes
    )


# --- above all that is carried ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_certificate_is_slightly_above_the_best_known_motion():
    refined = certificate(passes=2)
    coarse = certificate()
    assert BEST_KNOWN < refined.total_mass < 1.017 * BEST_KNOWN
    assert refined.payload == pytest.approx(refined.total_mass - 1.0)
    assert coarse.total_mass >= refined.total_mass
    data = json.loads(json.dumps(coarse.to_dict(), allow_nan=False))
    assert data["payload"] == coarse.payload
    assert data["error_bounds"] == {"position": 0.01}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inertia", "free_speed", "damping"), [(0.02, 1e9, 0.0), (0.02, 100.0, 0.05)]
)
def test_certificate_in_one_dimension_matches_the_closed_form(inertia, free_speed, damping):
    drive = {"inertia": inertia, "free_speed": free_speed, "damping": damping}
    robot = one_dimension.line_robot(**drive)
    bounds = ErrorBounds(position=one_dimension.BOUND)
    bound = planar_certificate(robot, one_dimension.Accelerating(), bounds, passes=1)
    largest = one_dimension.largest_mass(**drive)
    assert largest < bound.total_mass < 1.03 * largest


# --- the proof, by quadrature of its own ------------------------------------------------------------------------------


def fine_times(multiplier):
    """Midpoints of a fine grid in each interval between knots, and their distance."""
    count = 400 * (len(multiplier.force) - 2)
    step = (multiplier.end - multiplier.start) / count
    return multiplier.start + (np.arange(count) + 0.5) * step, step


RADIUS = PLANAR.pulley_radius
PULL = PLANAR.stall_torque / RADIUS - PLANAR.minimum_tension
SLOPE = (PLANAR.speed_slope + PLANAR.damping) / RADIUS**2
INERTIA = PLANAR.pulley_inertia / RADIUS**2
"""s, k and μ."""


def test_multiplier_bounds_the_force_in_the_tube():
    multiplier = certificate().multiplier
    rng = np.random.default_rng(0)
    times = rng.uniform(multiplier.start, multiplier.end, 20000)
    angle = rng.uniform(0, 2 * np.pi, times.shape)
    radius = 0.01 * np.sqrt(rng.uniform(0, 1, times.shape))
    error = (radius * np.stack([np.cos(angle), np.sin(angle)])).T
    towards = -textbook.jacobian(PLANAR, CIRCLE(times).position + error)
    (w, _, _), (phi, _, _) = multiplier(times)
    pull = np.einsum("tij,tj->ti", towards, w)
    assert np.all(phi >= np.maximum(pull, 0.0))
    assert np.abs(phi - pull).min() < 1e-4 * phi.max()  # and it is used


def left_side(mass, multiplier, error):
    """M ∫ w·p̈ − T₀ ∫ w·D − Σ ∫ φ_i (s_i + k_i q̇_i + μ_i q̈_i) of a motion ``p_d + error``, before
    any integration by parts."""
    times, step = fine_times(multiplier)
    x = CIRCLE(times)
    motion = [
        order + change
        for order, change in zip(
            (x.position, x.velocity, x.acceleration), error(times), strict=True
        )
    ]
    (w, _, _), (phi, _, _) = multiplier(times)
    length_rate = -RADIUS * textbook.pulley_speed(PLANAR, *motion[:2])
    length_second = -RADIUS * textbook.pulley_acceleration(PLANAR, *motion)
    most = PULL + SLOPE * length_rate + INERTIA * length_second
    together = -textbook.jacobian(PLANAR, motion[0]).sum(axis=1)
    least = PLANAR.minimum_tension * np.sum(w * together)
    return float(mass * np.sum(w * motion[2]) - least - np.sum(phi * most)) * step


@pytest.mark.parametrize("speed", [-40.0, 3.0, 40.0])
def test_proof_excludes_motions_in_the_tube(speed):
    """Above the certificate the left side is positive for every motion, so none obeys the
    limits."""

    def path(t):
        """An error that starts at rest at zero and then circles."""
        size = 0.01 * (1 - np.exp(-((20 * t) ** 3)))
        return (size * np.stack([np.cos(speed * t), np.sin(speed * t)])).T

    def error(times, h=1e-5):
        before, now, after = (path(times + shift) for shift in (-h, 0.0, h))
        return now, (after - before) / (2 * h), (after - 2 * now + before) / h**2

    bound = certificate()
    for factor in (1.0, 1.5):
        assert left_side(factor * bound.total_mass, bound.multiplier, error) > 0


def test_proved_mass_is_the_zero_of_h_by_quadrature():
    multiplier = certificate().multiplier
    times, step = fine_times(multiplier)
    position = CIRCLE(times).position
    length = textbook.cable_lengths(PLANAR, position)
    (w, _, w_second), (_, phi_rate, phi_second) = multiplier(times)
    fanning = np.sum(np.linalg.norm(w, axis=-1) * np.sum(0.01 / (length - 0.01), axis=-1))
    b = INERTIA * phi_second - SLOPE * phi_rate
    bulge = np.sum(np.maximum(b, 0) * (length - np.sqrt(length**2 - 1e-4)))
    away = np.einsum("ti,tij->tj", b, textbook.jacobian(PLANAR, position))

    def surplus(mass):
        psi = 0.01 * np.linalg.norm(mass * w_second - away, axis=-1).sum()
        tube = step * (psi + bulge + PLANAR.minimum_tension * fanning)
        return left_side(mass, multiplier, lambda t: np.zeros((3, len(t), 2))) - tube

    zero = brentq(surplus, 1.0, 10.0)
    assert zero * (1 - 1e-5) < certificate().total_mass < zero * (1 + 2e-3)


@pytest.mark.parametrize(
    "breach",
    ["too little", "negative", "at the end", pytest.param("at the start", marks=pytest.mark.slow)],
)
def test_invalid_multiplier_proves_nothing(breach):
    multiplier = certificate(passes=2 if breach == "at the start" else 1).multiplier
    tension = multiplier.tension.copy()
    if breach == "too little":
        tension *= 0.99
    elif breach == "negative":
        tension[tension == 0] = -1e-9
    else:
        tension[-1 if breach == "at the end" else 0] = 1e-3
    broken = dataclasses.replace(multiplier, tension=tension)
    assert proved_mass(PLANAR, CIRCLE, ErrorBounds(position=0.01), broken) == math.inf


# --- the hold at the start --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [SPATIAL, FLEX_SPATIAL], ids=lambda robot: robot.name)
def test_spatial_bound_is_the_payload_held_at_the_start(robot):
    motion = find_trajectory("circle-spatial", 6)
    bounds = ErrorBounds(position=0.02)
    bound = upper_bound(robot, motion, bounds)
    lowered = motion(0.0).position + 0.01 * np.eye(6)[2]
    torque = textbook.static_torque(robot, bound.total_mass, lowered)
    assert (torque / robot.stall_torque).max() == pytest.approx(1.0, abs=1e-12)
    assert (
        bound.payload
        > upper_bound(
            robot,
            motion,
            ErrorBounds(position=0.01),
        ).payload
        + 0.5
    )
    env = gym.make(f"CableBot-{'Flex' if robot.flexible else ''}Spatial-v0", error_bounds=bounds)
    for beyond in (-1e-6, 1e-6):
        info = env.reset(seed=0, options={"payload": bound.payload + beyond})[1]
        assert (info["torque_margin"].min() >= 0) == (beyond < 0)


def test_hold_bounds_nothing_without_weight_or_rest():
    assert upper_bound(SPATIAL, find_trajectory("paper-spatial", 6)).payload == math.inf
    assert upper_bound(FLEX_PLANAR, find_trajectory("circle-planar", 2)).payload == math.inf


# --- what it says, and bad input --------------------------------------------------------------------------------------


def test_reference_at_rest_has_no_bound():
    unbounded = certificate("dwell-planar")
    assert unbounded.total_mass == math.inf
    assert unbounded.multiplier is None
    assert json.loads(json.dumps(unbounded.to_dict(), allow_nan=False))["payload"] is None


@pytest.mark.parametrize(
    ("robot", "arguments", "message"),
    [
        (SPATIAL, {}, "only available for planar rigid robots"),
        (FLEX_PLANAR, {}, "only available for planar rigid robots"),
        (PLANAR, {"error_bounds": {"position": 0.5}}, "reaches the anchor of cable"),
        (PLANAR, {"passes": 0}, "passes must be an integer of at least 1"),
    ],
)
def test_bad_argument_is_rejected(robot, arguments, message):
    with pytest.raises(ValueError, match=message):
        planar_certificate(robot, **({"trajectory": CIRCLE} | arguments))
    outside = dataclasses.replace(certificate().multiplier, start=-0.1)
    with pytest.raises(ValueError, match="knots of the multiplier must lie within the motion"):
        proved_mass(PLANAR, CIRCLE, None, outside)
