"""The observer of a robot that is not exactly known, and the law that acts by its estimates."""

import gymnasium as gym
import numpy as np
import pytest
from driving import drive
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose
from oracles.bits import compare_ways
from oracles.episodes import ROBOTS
from oracles.plants import FLEX_UNEQUAL, QUAD, UNEQUAL, each_of, nightly, random_motion
from oracles.platforms import CAMERA, CRANE, TURNING

from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import make_composite
from cablebot_baselines.laws.observer_law import ObserverLaw
from cablebot_baselines.observer import filtering
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.filtering import delayed_weights, dynamics_of
from cablebot_gym.physics import textbook
from cablebot_gym.robots import find_robot
from cablebot_gym.uncertainty import ExternalWrench, Uncertainty, find_uncertainty

PERIOD = 2e-3
LARGEST = {
    "CableBot-Planar-v0": 1.5,
    "CableBot-Spatial-v0": 6.0,
    "CableBot-FlexPlanar-v0": 1.5,
}
"""Payloads that exact tracking carries [kg]."""


def episodes(env_id, uncertainty, payload, steps, **keywords):
    """Estimates of every step, the truth, and the peaks of the position error of N episodes."""
    robot = ROBOTS[env_id]
    uncertainty = find_uncertainty(uncertainty, robot)
    expectation = Expectation.of(robot, uncertainty)
    if robot.flexible:
        base = make_composite(expectation.robot)
    else:
        base = FeedbackLinearization(expectation.robot, gains=(400.0, 40.0))
    law = ObserverLaw(base, expectation, largest_payload=LARGEST[env_id])
    env = gym.make_vec(
        env_id,
        num_envs=len(payload),
        uncertainty=uncertainty,
        payload_known=False,
        autoreset_mode=AutoresetMode.DISABLED,
        **keywords,
    )
    estimates = []
    errors = []
    for step in drive(law, env, steps, seed=7, options={"payload": payload}):
        estimates.append(law.observer.estimate(step.state.observer))
        errors.append(step.info["tracking_error"])
    return estimates, env.unwrapped.truth, np.array(errors)


# --- expectation ------------------------------------------------------------------------------------------------------


def test_expectation_has_the_medians_and_spreads_of_an_uncertainty():
    """Friction of `hardware` is 0.5 to 1.5 % of the stall torque, delay 0 or 1 period, lag 1 to 2
    ms."""
    robot = find_robot("spatial")
    expected = Expectation.of(robot, find_uncertainty("hardware", robot))
    assert_allclose(expected.robot.coulomb_friction, 0.01 * robot.stall_torque)
    assert_allclose(expected.robot.stall_torque, robot.stall_torque)
    assert np.max(expected.robot.motor_lag) == 0
    assert expected.effect_times(PERIOD) == pytest.approx((1e-3, 4e-3))
    assert expected.strength_spread == pytest.approx(0.03 / np.sqrt(3), rel=0.2)
    assert_allclose(expected.wrench_spread, [0.5] * 3 + [0.05] * 3)


# --- model ------------------------------------------------------------------------------------------------------------


@each_of(QUAD, UNEQUAL, TURNING, *nightly(CAMERA, CRANE, FLEX_UNEQUAL))
def test_dynamics_keep_the_force_balance_of_the_textbook(robot):
    """For any torques and wrench, and with 1 kg more."""
    mass, pose, velocity, _ = random_motion(robot, (20,), seed=5)
    rng = np.random.default_rng(0)
    torque = rng.normal(size=(20, robot.cables))
    wrench = rng.normal(size=(20, robot.coordinates))
    dynamics = dynamics_of(robot, mass, pose, velocity)
    acceleration = dynamics.acceleration(torque, wrench)
    motion = pose, velocity, acceleration
    speed = textbook.pulley_speed(robot, pose, velocity)
    drag = robot.pulley_inertia * textbook.pulley_acceleration(robot, *motion)
    tension = (torque - drag - robot.damping * speed) / robot.pulley_radius
    structure = textbook.jacobian(robot, pose)
    load = textbook.load(robot, mass, *motion)
    pull = np.einsum("kmn,km->kn", structure, tension)
    tolerance = {"rtol": 0, "atol": 1e-11 * np.abs(load).max()}
    assert_allclose(load + pull, wrench, **tolerance)
    heavier = textbook.times_vector(dynamics.matrix_per_mass, acceleration)
    heavier += load + dynamics.bias_per_mass
    assert_allclose(heavier, textbook.load(robot, mass + 1.0, *motion), **tolerance)
    assert_allclose(dynamics.structure, structure, atol=1e-13)
    assert_allclose(dynamics.pulley_speed, speed, atol=1e-11)


# --- delay ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("periods", "weights"),
    [(0.0, [1, 0, 0]), (0.25, [0.75, 0.25, 0]), (1.0, [0, 1, 0]), (1.75, [0, 0.25, 0.75])],
)
def test_delayed_actions_count_by_the_time_in_which_they_act(periods, weights):
    assert_allclose(delayed_weights(np.array([periods * PERIOD]), PERIOD)[0], [weights])


def test_rates_of_the_weights_are_their_derivatives():
    delays = np.array([0.3, 0.9, 1.2, 1.7]) * PERIOD
    step = 1e-8
    later, _ = delayed_weights(delays + step, PERIOD)
    weights, rates = delayed_weights(delays, PERIOD)
    assert_allclose(rates, (later - weights) / step, atol=1e-3)


# --- estimates --------------------------------------------------------------------------------------------------------


def test_constant_wrench_is_found_and_its_deflection_cancelled():
    """With the paper's gains of feedback linearization alone it would stay 2 N / 400 N/m."""
    wrench = ExternalWrench(force_mean=(2.0, 0.0), correlation_time=0.5)
    uncertainty = Uncertainty(wrench=wrench)
    motion = {"name": "circle-planar"}
    estimates, _, errors = episodes(
        "CableBot-Planar-v0", uncertainty, np.zeros(1), 100, trajectory=motion
    )
    assert_allclose(estimates[-1].wrench, [[2.0, 0.0]], atol=0.1)
    assert errors[-1] < 1e-3


@pytest.mark.landing
def test_late_actions_are_for_the_reference_of_their_time():
    """At a jump of its acceleration, a Taylor series of the observed reference errs by 4 mm."""
    motion = {"name": "circle-planar"}
    _, _, errors = episodes(
        "CableBot-Planar-v0", Uncertainty(delay=2), np.zeros(1), 600, trajectory=motion
    )
    assert errors.max() < 1e-3


def test_held_robot_shows_its_mass_only_after_the_first_action_arrives():
    """Before it, the motors hold any payload: the robot at rest is no sign of a light one."""
    uncertainty = Uncertainty(delay=1)
    payload = np.array([0.0, 6.0])
    estimates, truth, _ = episodes("CableBot-Spatial-v0", uncertainty, payload, 4)
    first, second = estimates[0].mass, estimates[1].mass
    assert_allclose(second, first, rtol=1e-6)
    mass = truth["platform_mass"] + truth["payload"]
    assert_allclose(estimates[3].mass, mass, rtol=0.03)


@pytest.mark.parametrize("env_id", ["CableBot-Planar-v0", "CableBot-FlexPlanar-v0"])
def test_filter_has_the_same_bits_in_python(env_id, monkeypatch):
    """Excludes a sum or a square that Python rounds in another way than compiled code."""
    kind = type(filtering.correct)
    entries = [value for value in vars(filtering).values() if isinstance(value, kind)]
    names = compare_ways(monkeypatch, *entries)
    episodes(env_id, "hardware", np.array([0.0, 0.5]), 4)
    assert names == {entry.__name__ for entry in entries}
