"""Largest payloads without simulation under the interpretations of the paper."""

from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR
from cablebot_reproduction.exact import (
    exact_limit,
    exact_profile,
    paper_circle,
    state_space_limit,
    state_space_profile,
)
from cablebot_reproduction.interpretation import Interpretation


def reserve(profile):
    """Distance of the torques to their closest limit."""
    return np.minimum(profile.upper - profile.torques, profile.torques - profile.lower)


@pytest.mark.parametrize("alpha", ["least", "constant"])
@pytest.mark.parametrize("line", ["physical", "flat", "cable", "reversed"])
def test_torques_touch_the_limits_at_the_largest_payload(line, alpha):
    interpretation = Interpretation(line=line, alpha=alpha)
    for robot in (interpretation.planar, interpretation.spatial("payload")):
        limit = exact_limit(interpretation, robot)
        profile = exact_profile(interpretation, robot, limit.payload)
        assert reserve(profile).min() == pytest.approx(0.0, abs=1e-3)
        k, motor = np.unravel_index(reserve(profile).argmin(), profile.torques.shape)
        assert motor + 1 == limit.motor
        assert profile.times[k] == pytest.approx(limit.time, abs=1e-3)
        overloaded = exact_profile(interpretation, robot, limit.payload + 0.05)
        assert reserve(overloaded).min() < 0


@pytest.mark.parametrize("line", ["physical", "pulley", "flat"])
def test_state_space_touches_the_limits_at_the_largest_payload(line):
    interpretation = Interpretation(line=line)
    robot = interpretation.flexible("payload")
    limit = state_space_limit(interpretation, robot)
    profile = state_space_profile(interpretation, robot, limit.payload)
    assert reserve(profile).min() == pytest.approx(0.0, abs=1e-8)


def test_lower_line_can_limit_the_payload(monkeypatch):
    """At the largest payload a torque is on U⁻ and none is close to U⁺."""
    limits = textbook.torque_limits

    def raised(robot, speed):
        lower, upper = limits(robot, speed)
        return lower + 2.9, upper + 2.9

    monkeypatch.setattr(textbook, "torque_limits", raised)
    interpretation = Interpretation(line="reversed", alpha="constant")
    limit = exact_limit(interpretation, PLANAR)
    at_limit = exact_profile(interpretation, PLANAR, limit.payload)
    below = at_limit.torques - at_limit.lower
    k, motor = np.unravel_index(below.argmin(), below.shape)
    assert below[k, motor] == pytest.approx(0.0, abs=1e-6)
    assert np.all(at_limit.upper - at_limit.torques > 0.1)
    assert motor + 1 == limit.motor
    assert at_limit.times[k] == pytest.approx(limit.time, abs=1e-6)


def test_constant_alpha_keeps_minimum_tension_and_acceleration():
    interpretation = Interpretation(alpha="constant", minimum_tension=3.0)
    robot, payload = interpretation.planar, 0.7
    profile = exact_profile(interpretation, robot, payload)
    motion = paper_circle(robot)(profile.times)
    state = (motion.position, motion.velocity, motion.acceleration)
    inertial = textbook.required_torques(robot, np.zeros_like(profile.torques), *state)
    tension = (profile.torques - inertial) / robot.pulley_radius
    assert tension.min() == pytest.approx(3.0)
    structure = textbook.jacobian(robot, motion.position)
    pull = -np.einsum("kmc,km->kc", structure, tension)
    assert pull == pytest.approx((robot.mass + payload) * motion.acceleration, abs=1e-9)
    null = np.cross(structure[:, :, 0], structure[:, :, 1])
    alpha = np.abs(np.sum(tension * null, axis=1) / np.linalg.norm(null, axis=1))
    assert np.ptp(alpha) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("form", "divisor"), [("corrected", 4e-4), ("verbatim", 1.0004)])
def test_motors_of_the_state_space_satisfy_eq_24(form, divisor):
    interpretation = Interpretation(eq24=form)
    robot, payload = interpretation.flexible("payload"), 0.5
    circle, mass = paper_circle(robot), robot.mass + payload

    def spring(time):
        motion = circle(np.array(time))
        state = (motion.position, motion.velocity, motion.acceleration)
        tensions = textbook.required_tensions(robot, mass, *state)
        return textbook.required_torques(robot, tensions, *state), textbook.pulley_angle(
            robot, motion.position
        )

    def acceleration(time, motor_angle):
        kappa, angle = spring(time)
        return kappa, (kappa + robot.stiffness * (angle - motor_angle)) / divisor

    def rates(time, state):
        return np.concatenate([state[6:], acceleration(time, state[:6])[1]])

    kappa, angle = spring(0.0)
    start = np.concatenate([angle + kappa / robot.stiffness, np.zeros(6)])
    solve = partial(solve_ivp, rates, rtol=1e-9, atol=1e-10, max_step=1e-3)
    before_jump = solve((0.0, 0.5), start).y[:, -1]
    after_jump = solve((0.5 + 1e-9, 0.6), before_jump).y[:, -1]
    kappa, motor_acceleration = acceleration(0.6, after_jump[:6])
    profile = state_space_profile(interpretation, robot, payload)
    k = np.argmin(np.abs(profile.times - 0.6))
    assert profile.torques[k] == pytest.approx(kappa + 4e-4 * motor_acceleration, abs=2e-3)
