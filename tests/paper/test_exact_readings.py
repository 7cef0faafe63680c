"""Largest payloads without simulation under the readings, against what they must be."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

LINES = ("physical", "flat", "cable", "reversed")


@dataclass(frozen=True)
class Backwards:
    """A motion run from its end to its start."""

    forwards: object

    name = "backwards"

    @property
    def duration(self):
        return self.forwards.duration

    @property
    def coordinates(self):
        return self.forwards.coordinates

    def __call__(self, times):
        motion = self.forwards(self.duration - np.asarray(times))
        return Reference(
            position=motion.position,
            velocity=-motion.velocity,
            acceleration=motion.acceleration,
            jerk=-motion.jerk,
            snap=motion.snap,
        )


@pytest.mark.parametrize(
    ("robot", "trajectory"),
    [(PLANAR, find_trajectory("lemniscate-planar", 2)), (SPATIAL, find_trajectory("lemniscate-spatial", 6))],
)
def test_reversed_line_is_the_motion_run_backwards(robot, trajectory):
    robot = robot.replace(transmission=robot.transmission.replace(damping=0.0))  # damping would be reversed as well
    robot = robot.replace(motors=robot.motors.replace(free_speed=30.0))  # so that the line matters
    forwards = exact_payload(robot, trajectory, line_speed=-1.0)
    backwards = exact_payload(robot, Backwards(trajectory))
    assert forwards.payload == pytest.approx(backwards.payload, rel=1e-9)
    assert forwards.payload != pytest.approx(exact_payload(robot, trajectory).payload, rel=1e-3)


def test_line_of_a_multiple_of_the_speed_is_the_line_of_slower_motors():
    slow = SPATIAL.replace(motors=replace(SPATIAL.motors, free_speed=SPATIAL.motors.free_speed / 2))
    circle = find_trajectory("paper-spatial", 6)
    assert exact_payload(SPATIAL, circle, line_speed=2.0).payload == pytest.approx(
        exact_payload(slow, circle).payload, rel=1e-12
    )


@pytest.mark.parametrize("alpha", ["least", "constant"])
@pytest.mark.parametrize("line", LINES)
def test_torques_touch_the_limits_at_the_largest_payload_and_nowhere_cross(line, alpha):
    interpretation = Interpretation(line=line, alpha=alpha)
    for robot in (interpretation.planar, interpretation.spatial("payload")):
        limit = exact_limit(interpretation, robot)
        profile = exact_profile(interpretation, robot, limit.payload)
        room = np.minimum(profile.upper - profile.torques, profile.torques - profile.lower)
        assert room.min() == pytest.approx(0.0, abs=1e-3)
        k, motor = np.unravel_index(room.argmin(), room.shape)
        assert motor + 1 == limit.motor
        assert profile.times[k] == pytest.approx(limit.time, abs=1e-3)
        heavier = exact_profile(interpretation, robot, limit.payload + 0.05)
        assert np.any((heavier.torques > heavier.upper) | (heavier.torques < heavier.lower))


def test_one_alpha_for_all_times_keeps_the_minimum_and_no_more():
    interpretation = Interpretation(alpha="constant", minimum_tension=3.0)
    robot, payload = interpretation.planar, 0.7
    profile = exact_profile(interpretation, robot, payload)
    motion = paper_circle(robot)(profile.times)
    inertial = textbook.required_torques(
        robot, np.zeros_like(profile.torques), motion.position, motion.velocity, motion.acceleration
    )
    tension = (profile.torques - inertial) / robot.pulley_radius
    assert tension.min() == pytest.approx(3.0)
    structure = textbook.jacobian(robot, motion.position)
    pull = -np.einsum("kmc,km->kc", structure, tension)
    assert pull == pytest.approx((robot.mass + payload) * motion.acceleration, abs=1e-9)
    null = np.cross(structure[:, :, 0], structure[:, :, 1])
    alpha = np.abs(np.sum(tension * null, axis=1) / np.linalg.norm(null, axis=1))
    assert np.ptp(alpha) == pytest.approx(0.0, abs=1e-8)


def test_published_range_of_the_state_space_is_found_again():
    """Independent runs gave 1.34 to 1.99 kg by reading, with the line at the pulley's speed."""
    limits = [
        state_space_limit(interpretation, interpretation.flexible("payload"))
        for interpretation in (Interpretation(line="pulley", eq24=form) for form in ("corrected", "verbatim"))
    ]
    assert [limit.payload for limit in limits] == pytest.approx([1.34, 1.99], abs=0.005)
    assert [limit.motor for limit in limits] == [2, 2]
    assert [limit.time for limit in limits] == pytest.approx([0.5, 0.5], abs=1e-3)


@pytest.mark.parametrize("form", ["corrected", "verbatim"])
def test_motors_of_the_state_space_obey_eq_24(form):
    interpretation = Interpretation(eq24=form)
    robot, payload = interpretation.flexible("payload"), 0.5
    circle, mass = paper_circle(robot), robot.mass + payload
    divisor = 4e-4 if form == "corrected" else 1.0004

    def spring(time):
        motion = circle(time)
        state = (motion.position, motion.velocity, motion.acceleration)
        tensions = textbook.required_tensions(robot, mass, *state)
        kappa = textbook.required_torques(robot, tensions, *state)
        return kappa, textbook.pulley_angle(robot, motion.position)

    def rates(time, x):
        kappa, angle = spring(np.array(time))
        return np.concatenate([x[6:], (kappa + robot.stiffness * (angle - x[:6])) / divisor])

    kappa, angle = spring(np.array(0.0))
    start = np.concatenate([angle + kappa / robot.stiffness, np.zeros(6)])
    first = solve_ivp(rates, (0.0, 0.5), start, rtol=1e-9, atol=1e-10, max_step=1e-3)
    after = solve_ivp(rates, (0.5 + 1e-9, 0.6), first.y[:, -1], rtol=1e-9, atol=1e-10, max_step=1e-3)
    kappa, angle = spring(np.array(0.6))
    torque = kappa + 4e-4 * (kappa + robot.stiffness * (angle - after.y[:6, -1])) / divisor
    profile = state_space_profile(interpretation, robot, payload)
    k = np.argmin(np.abs(profile.times - 0.6))
    assert profile.torques[k] == pytest.approx(torque, abs=2e-3)


def test_only_the_jump_makes_the_motors_of_the_state_space_ring():
    interpretation = Interpretation(stiffness="2")
    robot = interpretation.flexible("control")
    profile = state_space_profile(interpretation, robot, 0.0)
    ripple = np.diff(profile.torques, n=2, axis=0)
    before, after = (
        (profile.times[1:-1] > low) & (profile.times[1:-1] < high) for low, high in ((0.3, 0.499), (0.501, 0.7))
    )
    assert np.abs(ripple[after]).max() > 10 * np.abs(ripple[before]).max()


def test_affine_limit_of_the_state_space_is_where_its_torques_touch():
    for line in ("physical", "pulley", "flat"):
        interpretation = Interpretation(line=line)
        robot = interpretation.flexible("payload")
        limit = state_space_limit(interpretation, robot)
        profile = state_space_profile(interpretation, robot, limit.payload)
        room = np.minimum(profile.upper - profile.torques, profile.torques - profile.lower)
        assert room.min() == pytest.approx(0.0, abs=1e-8)
