"""Computations of the reproduction against independent ones."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from cablebot_baselines.laws import PD, FeedbackLinearization, PaperFlexible, RobustPD
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_reproduction import linearised, robots
from cablebot_reproduction.exact import (
    circle_state,
    exact_limit,
    instants,
    reserve,
    state_space_limit,
    state_space_profile,
)
from cablebot_reproduction.fourth_order import FourthOrder
from cablebot_reproduction.parts import robust
from cablebot_reproduction.simulation import FeedForward, composite, episode

FLEXIBLE = robots.flexible_robot()


@pytest.mark.parametrize("line", robots.LINES)
def test_constant_alpha_touches_a_limit(line):
    """The tensions are the least ones at the instant that needs the largest α."""
    limit = exact_limit(PLANAR, line, minimum_tension=3.0, alpha="constant")
    times = instants(PLANAR)
    state = circle_state(PLANAR, times)
    structure = textbook.jacobian(PLANAR, state[0])
    null = np.cross(structure[..., 0], structure[..., 1])
    null /= np.linalg.norm(null, axis=1, keepdims=True) * np.sign(null[0, 0])
    least = textbook.required_tensions(PLANAR, PLANAR.mass + limit.payload, *state, minimum=3.0)
    alpha = np.sum(null * least, axis=1, keepdims=True)
    tensions = least + (alpha.max() - alpha) * null
    torques = textbook.required_torques(PLANAR, tensions, *state)
    speed = robots.line_speed(line, PLANAR) * textbook.pulley_speed(PLANAR, *state[:2])
    lower, upper = textbook.torque_limits(PLANAR, speed)
    margin = np.minimum(upper - torques, torques - lower)
    k, motor = np.unravel_index(margin.argmin(), margin.shape)
    assert margin[k, motor] == pytest.approx(0.0, abs=1e-7)
    assert (motor + 1, times[k]) == (limit.motor, pytest.approx(limit.time))


@pytest.mark.parametrize("eq24", ["corrected", "verbatim"])
def test_state_space_satisfies_eq_24_up_to_its_limit(eq24):
    limit = state_space_limit(FLEXIBLE, eq24=eq24)
    profile = state_space_profile(FLEXIBLE, limit.payload, eq24=eq24)
    assert reserve(profile).min() == pytest.approx(0.0, abs=1e-8)
    circle = robots.paper_circle(FLEXIBLE)
    divisor = 4e-4 if eq24 == "corrected" else 1.0004
    mass = FLEXIBLE.mass + limit.payload

    def spring(time):
        motion = circle(np.array(time))
        state = motion.position, motion.velocity, motion.acceleration
        kappa = textbook.inverse_dynamics(FLEXIBLE, mass, *state).torques
        return kappa, textbook.pulley_angle(FLEXIBLE, motion.position) + kappa / 3.0

    def rates(time, state):
        return np.concatenate([state[6:], 3.0 * (spring(time)[1] - state[:6]) / divisor])

    start = np.concatenate([spring(0.0)[1], np.zeros(6)])
    end = solve_ivp(rates, (0.0, 0.4), start, rtol=1e-9, atol=1e-10, max_step=1e-3).y[:, -1]
    kappa, rest_angle = spring(0.4)
    expected = kappa + 4e-4 * 3.0 * (rest_angle - end[:6]) / divisor
    k = np.argmin(np.abs(profile.times - 0.4))
    assert profile.torques[k] == pytest.approx(expected, abs=2e-3)


def test_open_choices_change_the_robots_as_named():
    assert robots.spatial_robot() == SPATIAL
    turned = robots.spatial_robot(triangles="turned")
    poses = np.array([[0.05, 0.02, 0.1, 0.1, -0.05, 0.0], [-0.05, -0.02, 0.1, -0.1, 0.05, 0.0]])
    lengths = cable_lengths(SPATIAL.base, SPATIAL.platform, poses[0])
    assert cable_lengths(turned.base, turned.platform, poses[1]) == pytest.approx(lengths)
    for apex, direction in zip(robots.APEXES, [(0, 1), (-1, 0), (0, -1), (1, 0)], strict=True):
        third = robots.planar_robot(apex).base[2]
        assert third / np.linalg.norm(third) == pytest.approx(direction)
    with pytest.raises(ValueError, match="no positive tensions"):
        robots.spatial_robot(triangles="aligned")


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL])
def test_open_loop_torques_depend_on_the_reference_only(robot):
    pose = robot.home + 0.02
    velocity, acceleration = np.random.default_rng(3).standard_normal((2, robot.coordinates))
    reference = ("pose", "velocity", "acceleration")
    values = (pose, velocity, acceleration)
    blocks = {f"reference_{name}": value for name, value in zip(reference, values, strict=True)}
    mass = np.array(robot.mass)
    state = {"pose": pose, "velocity": velocity}
    exact, _ = FeedbackLinearization(robot).torques(blocks | state, mass)
    elsewhere = {"pose": pose + 0.01, "velocity": velocity - 0.01}
    torques, speeds = FeedForward(robot).torques(blocks | elsewhere, mass)
    assert_allclose(torques, exact, rtol=1e-9)
    assert_allclose(speeds, textbook.pulley_speed(robot, *elsewhere.values()), rtol=1e-9)


class Recording(RobustPD):
    """Records the robust term."""

    def __call__(self, blocks):
        requested = super().__call__(blocks)
        self.terms.append(requested - PD(gains=self.gains)(blocks))
        return requested


@pytest.mark.parametrize("prefix", robust.CASES)
def test_added_input_is_the_term_of_the_same_instant(prefix):
    case = robust.CASES[prefix]
    law = case.robust(case.robot)
    law.outer = Recording(gains=law.outer.gains)
    object.__setattr__(law.outer, "terms", [])
    loop = episode(lambda _: law, case.robot, uncertainty="table6")
    added = robust.added_input(law.outer, loop, case.robot)
    recorded = np.concatenate(law.outer.terms)[1:500]  # the first instant is not recorded
    assert_allclose(added.term, recorded, atol=1e-9)


def test_errors_grow_at_the_rate_of_the_linearised_loop():
    robot = robots.flexible_robot(mass=11.0, stiffness=2.0)
    robot = linearised.unsaturated_actions(robot)
    rate = linearised.growth_rate(PaperFlexible(robot), robot)
    loop = record_rollout(
        PaperFlexible(robot),
        "CableBot-FlexSpatial-v0",
        robot=robot,
        trajectory="paper-spatial",
        error_bounds={"position": 0.1},
        cable="bilateral",
    )
    error = loop.arrays["tracking_error_peak"]
    growth = np.log(error[150:200].max() / error[50:100].max()) / 0.2
    assert growth == pytest.approx(rate, rel=0.1)
    assert -2 < linearised.growth_rate(composite(robot), robot) < -1  # the slow pole: −1.6
    assert -18 < linearised.growth_rate(FourthOrder(robot), robot) < -12  # two poles at −15
