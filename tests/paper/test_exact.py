"""Largest payloads without simulation under the interpretations of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cablebot_baselines.paper.exact import (
    exact_limit,
    exact_profile,
    paper_circle,
    state_space_limit,
    state_space_profile,
)
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_gym.bounds import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.trajectories import Reference, find_trajectory


@dataclass(frozen=True)
class Backwards:
    """A motion from its end to its start."""

    forwards: object
    name = "backwards"
    duration = 2.0
    coordinates = 6

    def __call__(self, times):
        motion = self.forwards(self.duration - np.asarray(times))
        changed = {"velocity": -motion.velocity, "jerk": -motion.jerk}
        return Reference(**vars(motion) | changed)


def test_reversed_line_has_the_payload_of_the_reversed_motion():
    """Damping would be reversed as well, so the robot has none; its motors are slow, so that the line matters."""
    robot = SPATIAL.replace(transmission=SPATIAL.transmission.replace(damping=0.0))
    robot = robot.replace(motors=robot.motors.replace(free_speed=30.0))
    trajectory = find_trajectory({"name": "lemniscate-spatial", "duration": 2.0}, 6)
    reversed_line = exact_payload(robot, trajectory, line_speed=-1.0)
    assert reversed_line.payload == pytest.approx(exact_payload(robot, Backwards(trajectory)).payload, rel=1e-9)
    assert reversed_line.payload != pytest.approx(exact_payload(robot, trajectory).payload, rel=1e-3)


def room(profile):
    """Distance of the torques to their closest limit."""
    return np.minimum(profile.upper - profile.torques, profile.torques - profile.lower)


@pytest.mark.parametrize("alpha", ["least", "constant"])
@pytest.mark.parametrize("line", ["physical", "flat", "cable", "reversed"])
def test_torques_touch_the_limits_at_the_largest_payload(line, alpha):
    interpretation = Interpretation(line=line, alpha=alpha)
    for robot in (interpretation.planar, interpretation.spatial("payload")):
        limit = exact_limit(interpretation, robot)
        profile = exact_profile(interpretation, robot, limit.payload)
        assert room(profile).min() == pytest.approx(0.0, abs=1e-3)
        k, motor = np.unravel_index(room(profile).argmin(), profile.torques.shape)
        assert (motor + 1, profile.times[k]) == (limit.motor, pytest.approx(limit.time, abs=1e-3))
        assert room(exact_profile(interpretation, robot, limit.payload + 0.05)).min() < 0


@pytest.mark.parametrize("line", ["physical", "pulley", "flat"])
def test_torques_of_the_state_space_touch_the_limits_at_the_largest_payload(line):
    interpretation = Interpretation(line=line)
    robot = interpretation.flexible("payload")
    limit = state_space_limit(interpretation, robot)
    assert room(state_space_profile(interpretation, robot, limit.payload)).min() == pytest.approx(0.0, abs=1e-8)


def assert_limited_by_lower_line(profile, limit, low, high):
    """The bisection of the payload ends where a torque reaches U⁻."""
    assert room(profile(low)).min() >= 0
    while high - low > 1e-7:
        middle = (low + high) / 2
        low, high = (middle, high) if room(profile(middle)).min() >= 0 else (low, middle)
    assert limit.payload == pytest.approx(low, abs=1e-6)
    found = profile(limit.payload)
    below = found.torques - found.lower
    k, motor = np.unravel_index(below.argmin(), below.shape)
    assert below[k, motor] == pytest.approx(0.0, abs=1e-6)
    assert np.all(found.upper - found.torques > 0.1)
    assert (motor + 1, found.times[k]) == (limit.motor, pytest.approx(limit.time, abs=1e-6))


@pytest.mark.slow
def test_lower_line_can_limit_the_payload(monkeypatch):
    reversed_line = Interpretation(line="reversed")
    light = reversed_line.flexible("payload").replace(gravity=0.3)  # the motors also have to push the platform
    profile = partial(state_space_profile, reversed_line, light)
    assert_limited_by_lower_line(profile, state_space_limit(reversed_line, light), 0.0, 20.0)
    limits = textbook.torque_limits
    shifted = lambda robot, speed: tuple(line + 2.9 for line in limits(robot, speed))  # noqa: E731
    monkeypatch.setattr(textbook, "torque_limits", shifted)
    constant = Interpretation(line="reversed", alpha="constant")
    assert_limited_by_lower_line(partial(exact_profile, constant, PLANAR), exact_limit(constant, PLANAR), -0.95, 0.5)


def test_constant_alpha_keeps_the_minimum_tension_and_the_acceleration():
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


def test_payloads_of_the_state_space_agree_with_independent_calculations():
    """1.34 and 1.99 kg with the line at the pulley speed."""
    interpretations = [Interpretation(line="pulley", eq24=form) for form in ("corrected", "verbatim")]
    limits = [state_space_limit(one, one.flexible("payload")) for one in interpretations]
    assert [limit.payload for limit in limits] == pytest.approx([1.34, 1.99], abs=0.005)
    assert [limit.motor for limit in limits] == [2, 2]
    assert [limit.time for limit in limits] == pytest.approx([0.5, 0.5], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["corrected", "verbatim"])
def test_motors_of_the_state_space_satisfy_eq_24(form):
    interpretation = Interpretation(eq24=form)
    robot, payload = interpretation.flexible("payload"), 0.5
    circle, mass = paper_circle(robot), robot.mass + payload
    divisor = 4e-4 if form == "corrected" else 1.0004

    def spring(time):
        motion = circle(time)
        state = (motion.position, motion.velocity, motion.acceleration)
        tensions = textbook.required_tensions(robot, mass, *state)
        return textbook.required_torques(robot, tensions, *state), textbook.pulley_angle(robot, motion.position)

    def rates(time, x):
        kappa, angle = spring(np.array(time))
        return np.concatenate([x[6:], (kappa + robot.stiffness * (angle - x[:6])) / divisor])

    kappa, angle = spring(np.array(0.0))
    start = np.concatenate([angle + kappa / robot.stiffness, np.zeros(6)])
    solve = partial(solve_ivp, rates, rtol=1e-9, atol=1e-10, max_step=1e-3)
    after = solve((0.5 + 1e-9, 0.6), solve((0.0, 0.5), start).y[:, -1])
    kappa, angle = spring(np.array(0.6))
    torque = kappa + 4e-4 * (kappa + robot.stiffness * (angle - after.y[:6, -1])) / divisor
    profile = state_space_profile(interpretation, robot, payload)
    k = np.argmin(np.abs(profile.times - 0.6))
    assert profile.torques[k] == pytest.approx(torque, abs=2e-3)
