"""The laws for joint springs reach the figures of independent runs, and are the equations that they say they are."""

from __future__ import annotations

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import expm

from cablebot_baselines.classical import ADAPTIVE_COMPOSITE, COMPOSITE, COMPOSITE_TUNED, Composite, FourthOrder, MotorPD
from cablebot_baselines.classical.flexible import Motion
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot

LAWS = {"composite": Composite, "motor-pd": MotorPD, "fl4": FourthOrder}
FLEX_SPATIAL_ID = "CableBot-FlexSpatial-v0"


def with_stiffness(stiffness: float, mass: float) -> Robot:
    transmission = dataclasses.replace(FLEX_SPATIAL.transmission, stiffness=stiffness)
    return FLEX_SPATIAL.replace(mass=mass, transmission=transmission)


@pytest.mark.parametrize(("law", "payload"), [("composite", 4.54), ("motor-pd", 4.10), ("fl4", 4.63)])
def test_payload_is_not_below_what_the_law_reached(law: str, payload: float) -> None:
    result = evaluate_dlcc(law, FLEX_SPATIAL_ID, resolution=0.01)
    assert result.payload == pytest.approx(payload, abs=0.03)
    assert result.violation.kind == "rotation"


@pytest.mark.parametrize("stiffness", [2.0, 3.0])
@pytest.mark.parametrize(("law", "bound"), [("composite", 6e-3), ("motor-pd", 3e-3), ("fl4", 6e-3)])
def test_error_on_the_papers_circle_at_eleven_kilograms_is_not_beyond_its_bound(
    law: str, bound: float, stiffness: float
) -> None:
    robot = with_stiffness(stiffness, 11.0)
    env = gym.make(FLEX_SPATIAL_ID, robot=robot)
    observation, info = env.reset(seed=0)
    policy, position, rotation = LAWS[law](robot), 0.0, 0.0
    for _ in range(500):
        observation, _, terminated, _, info = env.step(policy.predict(observation)[0])
        assert not terminated
        assert not info["slack"].any()
        position, rotation = max(position, info["tracking_error_peak"]), max(rotation, info["rotation_error_peak"])
    assert position < bound
    assert rotation < 2e-3


def test_fourth_order_error_does_not_follow_other_poles_than_asked_for() -> None:
    """On a dwell, an initial error decays as the fourth-order linear equation says, cable geometry cancelled."""
    poles = (-8.0, -9.0, -10.0, -11.0)
    error = np.array([2e-3, -1e-3, 1e-3, 2e-3, 1e-3, -2e-3])
    env = gym.make(FLEX_SPATIAL_ID, trajectory="dwell-spatial", initial_error=error, control_frequency=2000.0)
    observation, _ = env.reset(seed=0)
    law, steps = FourthOrder(FLEX_SPATIAL, poles=poles), 800
    for _ in range(steps):
        observation, *_ = env.step(law.predict(observation)[0])
    # From rest: e = Σ c_i exp(p_i t) with e(0) = 1 and three derivatives zero.
    coefficients = np.linalg.solve(np.vander(poles, increasing=True).T, [1.0, 0.0, 0.0, 0.0])
    expected = float(coefficients @ np.exp(np.array(poles) * steps / 2000.0))
    left = env.unwrapped.pose - env.unwrapped.task.trajectory(1.0).position
    assert 0.1 < expected < 0.5
    np.testing.assert_allclose(left / error, expected, atol=0.02)


def test_motor_pd_is_not_without_its_feed_forward() -> None:
    """Started on a motion to snap, the law needs no correction: the error stays far below what PD alone would leave."""
    env = gym.make(FLEX_SPATIAL_ID, trajectory="circle-spatial", control_frequency=2000.0, max_episode_steps=-1)
    observation, _ = env.reset(seed=0)
    law, peak = MotorPD(FLEX_SPATIAL), 0.0
    for _ in range(4000):
        observation, _, _, _, info = env.step(law.predict(observation)[0])
        peak = max(peak, info["tracking_error_peak"])
    assert peak < 2e-4


def test_taylor_motion_is_not_off_from_its_polynomial() -> None:
    rng = np.random.default_rng(0)
    names = ("position", "velocity", "acceleration", "jerk", "snap")
    values = rng.normal(size=(5, 3, 6))
    motion = Motion(**dict(zip(names, values, strict=True)))
    time = 0.3
    factors = time ** np.arange(5) / np.array([1, 1, 2, 6, 24])
    for order, computed in enumerate(motion.after(time)):
        np.testing.assert_allclose(computed, np.tensordot(factors[: 5 - order], values[order:], axes=1), rtol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_batch_does_not_differ_from_one_observation(law: str) -> None:
    envs = gym.make_vec(FLEX_SPATIAL_ID, num_envs=3, payload=[0.0, 1.0, 2.0])
    observations, _ = envs.reset(seed=0)
    policy = LAWS[law](FLEX_SPATIAL)
    batch, _ = policy.predict(observations)
    for observation, action in zip(observations, batch, strict=True):
        np.testing.assert_allclose(policy.predict(observation)[0], action, rtol=1e-9, atol=1e-9)
    assert np.ptp(batch, axis=0).max() > 0.01  # and the model payload is used


def test_unknown_payload_is_not_used() -> None:
    envs = gym.make_vec(FLEX_SPATIAL_ID, num_envs=2, payload=[0.0, 2.0], payload_known=False)
    observations, _ = envs.reset(seed=0)
    observations[1] = observations[0]
    action, _ = Composite(FLEX_SPATIAL).predict(observations)
    np.testing.assert_array_equal(action[0], action[1])


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: str(robot.name))
def test_rigid_robot_is_not_accepted(law: str, robot: Robot) -> None:
    with pytest.raises(ValueError, match="needs joint springs"):
        LAWS[law](robot)


@pytest.mark.parametrize("gains", [(), (30.0,), (30.0, -1.0), ("a", 1.0)])
def test_composite_does_not_take_gains_that_fl_refuses(gains: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="gains must be two positive numbers"):
        Composite(FLEX_SPATIAL, gains=gains)


def test_damping_of_the_papers_springs_is_not_cut_at_500_hz() -> None:
    for stiffness in (2.0, 3.0):
        robot = with_stiffness(stiffness, 10.0)
        np.testing.assert_array_equal(Composite(robot).damping(1 / 500), np.sqrt(robot.stiffness * robot.motor_inertia))


@pytest.mark.parametrize("frequency", [100.0, 500.0, 2000.0])
@pytest.mark.parametrize("stiffness", [1.0, 30.0, 300.0, 800.0, 1000.0, 1500.0, 3000.0, 1e4])
def test_sampled_spring_does_not_swing_ever_further(stiffness: float, frequency: float) -> None:
    """A rotor on a spring whose other end hardly moves, its torque held; the outer loop's K_D counts."""
    robot = with_stiffness(stiffness, 10.0)
    inertia, rate = robot.motor_inertia[0], textbook.highest_frequency(robot)
    gain = Composite(robot).damping(1 / frequency)[0] / inertia - 20.0
    held = expm(np.array([[0.0, 1.0, 0.0], [-(rate**2), 0.0, -gain], [0.0, 0.0, 0.0]]) / frequency)
    loop = held[:2, :2] + np.outer(held[:2, 2], [0.0, 1.0])
    assert np.abs(np.linalg.eigvals(loop)).max() < 1 + 1e-9


@pytest.mark.parametrize("entry", [COMPOSITE, ADAPTIVE_COMPOSITE], ids=lambda entry: str(entry.name))
@pytest.mark.parametrize("stiffness", [700.0, 1000.0, 2000.0])
def test_stiff_springs_are_not_shaken_by_their_damping(entry: PolicyEntry, stiffness: float) -> None:
    """At 500 Hz the damping that suits soft springs drops the platform from K = 600 on; K → ∞ is the rigid robot."""
    robot = with_stiffness(stiffness, 10.0)
    run = record_rollout(entry.factory(robot), FLEX_SPATIAL_ID, payload=4.0, robot=robot)
    assert run.verdict.carried


def test_planar_robot_is_not_accepted_by_the_fourth_order_law() -> None:
    with pytest.raises(ValueError, match="as many cables as coordinates"):
        FourthOrder(FLEX_PLANAR)


@pytest.mark.parametrize("poles", [(-1, -2, -3), (-1, -2, -3, 4), (-1 + 1j, -2, -3, -4), (0, -1, -2, -3)])
def test_poles_that_are_not_four_stable_ones_are_not_accepted(poles: tuple[complex, ...]) -> None:
    with pytest.raises(ValueError, match="four stable poles"):
        FourthOrder(FLEX_SPATIAL, poles=poles)


def test_planar_motor_pd_does_not_let_go_of_the_minimum_tension() -> None:
    result = evaluate_dlcc("motor-pd", "CableBot-FlexPlanar-v0", resolution=0.01)
    assert result.payload == pytest.approx(1.93, abs=0.05)


@pytest.mark.parametrize(
    ("robot", "env_id", "known_payload", "unknown_payload"),
    [(FLEX_SPATIAL, FLEX_SPATIAL_ID, 4.58, 1.61), (FLEX_PLANAR, "CableBot-FlexPlanar-v0", 2.01, 0.25)],
    ids=lambda value: getattr(value, "name", None),
)
def test_tuned_composite_does_not_carry_less_than_it_reached(
    robot: Robot, env_id: str, known_payload: float, unknown_payload: float
) -> None:
    """The paper's gains: 4.54 and 0.39 kg on the spatial robot, nothing on the planar one."""
    for known, payload in ((True, known_payload), (False, unknown_payload)):
        result = evaluate_dlcc(COMPOSITE_TUNED.factory(robot), env_id, payload_known=known, resolution=0.01)
        assert result.payload == pytest.approx(payload, abs=0.04)


def test_rest_tensions_of_the_papers_robot_are_not_another_sum_than_its_weight() -> None:
    rest = np.zeros(6)
    wound = textbook.static_motor_angle(FLEX_SPATIAL, FLEX_SPATIAL.mass, FLEX_SPATIAL.home)
    tensions = FLEX_SPATIAL.stiffness * wound / FLEX_SPATIAL.pulley_radius
    np.testing.assert_allclose(
        tensions, textbook.required_tensions(FLEX_SPATIAL, FLEX_SPATIAL.mass, FLEX_SPATIAL.home, rest, rest)
    )
