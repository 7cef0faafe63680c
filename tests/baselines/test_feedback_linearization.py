"""Feedback linearization against the paper's formulas written a second time, here in complex steps and an SVD."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablebot_baselines.classical import FL, FL_TUNED, FeedbackLinearization
from cablebot_gym.envs import RIGID_ENV_IDS
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Motors

IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
GAINS = {"planar": (2000.0, 10.0), "spatial": (30.0, 20.0)}
"""(K_P, K_D), Tables 2 and 4."""
STALL = {"planar": 5.0, "spatial": 10.0}
"""τ_s, Tables 7 and 8 [N·m]."""
RADIUS, INERTIA, FREE_SPEED = 0.05, 8e-4, 1000 * math.pi / 30
"""r [m], J [kg·m²] and ω_n [rad/s] of both robots."""
DAMPING = {"planar": 0.0, "spatial": 0.01}
"""c [N·m·s/rad]."""

each_kind = pytest.mark.parametrize("kind", list(ROBOTS))

SQUARE = PLANAR.replace(
    name="square", base_anchors=((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)), home_pose=(0.0, 0.0)
)
"""Four cables in the plane."""


# --- the formulas, for scalars of any kind ----------------------------------------------------------------------------


def rotation(psi, theta, phi):
    """Rz(φ) Ry(θ) Rx(ψ)."""
    cos, sin = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, cos(psi), -sin(psi)], [0, sin(psi), cos(psi)]])
    ry = np.array([[cos(theta), 0, sin(theta)], [0, 1, 0], [-sin(theta), 0, cos(theta)]])
    rz = np.array([[cos(phi), -sin(phi), 0], [sin(phi), cos(phi), 0], [0, 0, 1]])
    return rz @ ry @ rx


def rate_matrix(psi, theta):
    """The paper's P: what each Euler rate adds to ω in the platform's frame."""
    first = np.array([1, 0, 0])
    second = rotation(psi, 0, 0).T @ np.array([0, 1, 0])
    third = rotation(psi, 0, 0).T @ rotation(0, theta, 0).T @ np.array([0, 0, 1])
    return np.stack([first, second, third], axis=1)


STEP = 1e-30
"""A complex step has no cancellation, so that its derivatives are exact."""


def lengths(robot, pose):
    if len(pose) == 2:
        ends = np.broadcast_to(pose, (len(robot.base_anchors), 2))
    else:
        ends = pose[:3] + np.array(robot.platform_anchors) @ rotation(*pose[3:]).T
    return np.sqrt(np.sum((ends - np.array(robot.base_anchors)) ** 2, axis=1))


def structure(robot, pose):
    """S = ∂q/∂X, column by column."""
    return np.stack([lengths(robot, pose + 1j * STEP * e).imag / STEP for e in np.eye(len(pose))], axis=1)


def motion(pose, velocity, acceleration, time):
    return pose + velocity * time + acceleration * time**2 / 2


def length_rates(robot, pose, velocity, acceleration, time=0.0):
    """q̇ at a time on the parabola through the state, from l · l̇ / q; complex times allowed."""
    now, rates = motion(pose, velocity, acceleration, time), velocity + acceleration * time
    base = np.array(robot.base_anchors)
    if len(pose) == 2:
        vector, speed = now - base, np.broadcast_to(rates, base.shape)
    else:
        turn, arms = rotation(*now[3:]), np.array(robot.platform_anchors)
        omega = rate_matrix(*now[3:5]) @ rates[3:]
        vector, speed = now[:3] + arms @ turn.T - base, rates[:3] + np.cross(omega, arms) @ turn.T
    return np.sum(vector * speed, axis=1) / np.sqrt(np.sum(vector**2, axis=1))


def law(robot, kind, observation, minimum=5.0, gains=None):
    """Tensions, torques and actions of Eqs. 10–13 (planar) and 16–18 (spatial) for one observation."""
    blocks = {name: np.array(observation[at]) for name, at in observation_layout(robot).slices().items()}
    stiffness, damping = gains or GAINS[kind]
    pose, velocity = blocks["pose"], blocks["velocity"]
    v = (
        blocks["reference_acceleration"]
        + damping * (blocks["reference_velocity"] - velocity)
        + stiffness * (blocks["reference_pose"] - pose)
    )  # Eq. 18
    mass = {"planar": 1.0, "spatial": 10.0}[kind] + blocks["model_payload"][0]
    s = structure(robot, pose)
    if kind == "planar":
        tensions = planar_tensions(s, mass * v, minimum)
    else:
        p = rate_matrix(*pose[3:5])
        along = motion(pose, velocity, 0.0, 1j * STEP)
        p_rate = rate_matrix(*along[3:5]).imag / STEP
        moments = np.diag([0.58, 0.58, 1.16])
        omega = p @ velocity[3:]
        force = mass * (v[:3] - np.array([0, 0, 9.81]))
        moment = p.T @ (moments @ (p @ v[3:] + p_rate @ velocity[3:]) + np.cross(omega, moments @ omega))
        tensions = -np.linalg.solve(s.T, np.concatenate([force, moment]))  # Eq. 16
    beta_rate = -length_rates(robot, pose, velocity, v) / RADIUS
    beta_second = -length_rates(robot, pose, velocity, v, 1j * STEP).imag / STEP / RADIUS
    torques = RADIUS * tensions + INERTIA * beta_second + DAMPING[kind] * beta_rate  # Eqs. 1, 13 and 17
    commands = (torques + STALL[kind] / FREE_SPEED * beta_rate) / STALL[kind]
    return tensions, torques, commands


def planar_tensions(s, force, minimum):
    """T = T_p + α N (Eq. 11), N > 0 from the null space, α the least that keeps every tension at the minimum."""
    _, _, rows = np.linalg.svd(s.T)
    null = rows[-1] * np.sign(rows[-1][0])
    assert np.all(null > 0)
    particular = -np.linalg.pinv(s.T) @ force
    alpha = np.max((minimum - particular) / null)
    return particular + alpha * null


def motor_speed(robot, observation):
    """β̇ of one observation."""
    at = observation_layout(robot).slices()
    pose, velocity = observation[at["pose"]], observation[at["velocity"]]
    return -structure(robot, pose) @ velocity / RADIUS


def observations(kind, rng, count, model_payload=None):
    """Plausible observations, far enough off the reference for every term to matter."""
    layout, robot = observation_layout(ROBOTS[kind]), ROBOTS[kind]
    n = robot.coordinates
    pose = rng.uniform(-0.1, 0.1, (count, n))
    if kind == "spatial":
        pose[:, 2] += 0.25
    made = np.zeros((count, layout.size))
    at = layout.slices()
    made[:, at["pose"]] = pose
    made[:, at["reference_pose"]] = pose + rng.uniform(-0.02, 0.02, (count, n))
    made[:, at["velocity"]] = rng.uniform(-1, 1, (count, n))
    made[:, at["reference_velocity"]] = rng.uniform(-1, 1, (count, n))
    made[:, at["reference_acceleration"]] = rng.uniform(-8, 8, (count, n))
    made[:, at["model_payload"]] = rng.uniform(0, 5, (count, 1)) if model_payload is None else model_payload
    made[:, at["payload_known"]] = 1.0
    for name in ("time_to_go", "preview_20ms", "preview_50ms", "preview_100ms", "preview_200ms"):
        made[:, at[name]] = rng.uniform(0, 1, made[:, at[name]].shape)  # what the law has no use for
    return made


# --- the law ----------------------------------------------------------------------------------------------------------


@each_kind
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_law_is_not_another_than_the_papers(kind, seed):
    rng = np.random.default_rng(seed)
    observation = observations(kind, rng, 1)[0]
    _, _, expected = law(ROBOTS[kind], kind, observation)
    action, _ = FeedbackLinearization(ROBOTS[kind]).predict(observation)
    np.testing.assert_allclose(action, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@each_kind
def test_gains_are_not_ignored(kind):
    observation = observations(kind, np.random.default_rng(0), 1)[0]
    made = FeedbackLinearization(ROBOTS[kind], gains=(123.0, 4.5)).predict(observation)[0]
    np.testing.assert_allclose(made, law(ROBOTS[kind], kind, observation, gains=(123.0, 4.5))[2], rtol=1e-9)
    assert np.all(np.abs(made - FeedbackLinearization(ROBOTS[kind]).predict(observation)[0]) > 1e-6)


@pytest.mark.parametrize("minimum", [0.0, 2.0, 17.0])
def test_planar_tension_is_neither_below_nor_above_the_least_that_keeps_the_minimum(minimum):
    robot = PLANAR
    law_ = FeedbackLinearization(robot, minimum_tension=minimum)
    for observation in observations("planar", np.random.default_rng(3), 50):
        tensions, torques, _ = law(robot, "planar", observation, minimum=minimum)
        command = law_.predict(observation)[0]
        # Tensions back from the commands: nothing but T differs from the motor's own fraction of the torque.
        torque = command * STALL["planar"] - STALL["planar"] / FREE_SPEED * motor_speed(PLANAR, observation)
        commanded = tensions + (torque - torques) / RADIUS
        assert commanded.min() == pytest.approx(minimum, abs=1e-9)
        np.testing.assert_allclose(commanded, tensions, rtol=1e-9, atol=1e-9)


@each_kind
def test_one_observation_does_not_differ_from_its_row_of_a_batch(kind):
    batch = observations(kind, np.random.default_rng(1), 7)
    fl = FeedbackLinearization(ROBOTS[kind])
    together, _ = fl.predict(batch)
    assert together.shape == (7, ROBOTS[kind].cables)
    for row, observation in zip(together, batch, strict=True):
        alone, _ = fl.predict(observation)
        assert alone.shape == (ROBOTS[kind].cables,)
        np.testing.assert_allclose(alone, row, rtol=1e-12, atol=1e-12)


@each_kind
def test_state_is_not_lost_and_observation_is_not_changed(kind):
    observation = observations(kind, np.random.default_rng(2), 3)
    before, state = observation.copy(), object()
    _, after = FeedbackLinearization(ROBOTS[kind]).predict(
        observation, state=state, episode_start=np.ones(3, np.bool_), deterministic=True
    )
    assert after is state
    np.testing.assert_array_equal(observation, before)


@each_kind
def test_command_is_not_clipped_by_the_law(kind):
    observation = observations(kind, np.random.default_rng(4), 1, model_payload=100.0)[0]
    fl = FeedbackLinearization(ROBOTS[kind])
    assert fl.unsaturated_actions is True
    assert np.abs(fl.predict(observation)[0]).max() > 1.5


# --- payload model ----------------------------------------------------------------------------------------------------


@each_kind
def test_unknown_payload_does_not_reach_the_command(kind):
    commands = []
    for payload in (0.0, 1.5):
        env = gym.make(IDS[kind], payload=payload, payload_known=False)
        observation, info = env.reset(seed=0)
        assert info["payload"] == payload
        commands.append(FeedbackLinearization(ROBOTS[kind]).predict(observation)[0])
    known, _ = gym.make(IDS[kind], payload=0.0).reset(seed=0)
    np.testing.assert_array_equal(commands[0], commands[1])
    np.testing.assert_array_equal(commands[0], FeedbackLinearization(ROBOTS[kind]).predict(known)[0])


@each_kind
def test_model_payload_is_not_taken_for_the_total_mass(kind):
    env = gym.make(IDS[kind], payload=1.5)
    observation, _ = env.reset(seed=0)
    command = FeedbackLinearization(ROBOTS[kind]).predict(observation)[0]
    heavier = ROBOTS[kind].replace(mass=ROBOTS[kind].mass + 1.5)
    empty, _ = gym.make(IDS[kind], robot=heavier).reset(seed=0)
    np.testing.assert_allclose(command, FeedbackLinearization(heavier).predict(empty)[0], rtol=1e-12)


@each_kind
def test_law_does_not_run_on_other_parameters_than_its_nominal_robot(kind):
    observation = observations(kind, np.random.default_rng(5), 1)[0]
    nominal = ROBOTS[kind]
    strong = nominal.replace(motors=Motors(stall_torque=2 * STALL[kind], free_speed=1000 * RPM))
    assert strong.stall_torque[0] == 2 * STALL[kind]
    torque = [
        FeedbackLinearization(robot).predict(observation)[0] * robot.stall_torque
        - robot.speed_slope * motor_speed(nominal, observation)
        for robot in (nominal, strong)
    ]
    np.testing.assert_allclose(torque[0], torque[1], rtol=1e-9)


# --- arguments --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "other"), [("planar", "spatial"), ("spatial", "planar")])
def test_observation_of_another_robot_is_not_read_as_if_it_were_this_ones(kind, other):
    observation = observations(other, np.random.default_rng(6), 2)
    for wrong in (observation, observation[0]):
        with pytest.raises(
            ValueError,
            match=rf"a policy for robot '{kind}' reads observations of \d+ components, not .*build it for the env",
        ):
            FeedbackLinearization(ROBOTS[kind]).predict(wrong)


@pytest.mark.parametrize(
    "gains", [(0.0, 1.0), (1.0, 0.0), (-30.0, 20.0), (30.0, -1.0), (math.nan, 1.0), (1.0, math.nan), (math.inf, 1.0)]
)
def test_gain_that_is_not_positive_is_not_accepted(gains):
    with pytest.raises(ValueError, match="gains must be two positive numbers"):
        FeedbackLinearization(SPATIAL, gains=gains)


@pytest.mark.parametrize("minimum", [-1e-9, -5.0, math.nan, math.inf])
def test_negative_or_infinite_minimum_tension_is_not_accepted(minimum):
    with pytest.raises(ValueError, match="minimum_tension must be at least 0 N"):
        FeedbackLinearization(PLANAR, minimum_tension=minimum)


def test_entry_does_not_name_another_law():
    assert (FL.name, FL.kind, FL.env_ids) == ("fl", "classical", RIGID_ENV_IDS)
    assert isinstance(FL.factory(PLANAR), FeedbackLinearization)


@pytest.mark.parametrize(
    ("kind", "paper", "tuned"), [("planar", (1.92, 0.66), (1.94, 0.79)), ("spatial", (4.03, 0.39), (3.88, 4.15))]
)
def test_tuned_gains_are_not_the_papers(kind, paper, tuned):
    """Payload known and unknown [kg]: known, gains hardly matter."""
    for entry, payloads in ((FL, paper), (FL_TUNED, tuned)):
        for known, payload in zip((True, False), payloads, strict=True):
            law_ = entry.factory(ROBOTS[kind])
            result = evaluate_dlcc(law_, IDS[kind], payload_known=known, resolution=0.01)
            assert result.payload == pytest.approx(payload, abs=0.03)


# --- in the loop ------------------------------------------------------------------------------------------------------


def run(env, policy, seed=0):
    """Infos of a whole motion."""
    observation, _ = env.reset(seed=seed)
    infos = []
    for _ in range(env.unwrapped.task.steps):
        action, _ = policy.predict(observation)
        observation, _, terminated, _, info = env.step(action)
        infos.append(info)
        assert not terminated, info["termination_reason"]
    return infos


@each_kind
def test_closed_loop_does_not_leave_the_reference_by_a_millimetre(kind):
    infos = run(gym.make(IDS[kind], max_episode_steps=-1), FeedbackLinearization(ROBOTS[kind]))
    assert len(infos) == 500
    assert 0 < max(info["tracking_error_peak"] for info in infos) < 1e-3
    assert max(info["rotation_error_peak"] for info in infos) < 1e-3
    assert not any(info["slack"].any() for info in infos)


@pytest.mark.parametrize("minimum", [1.0, 5.0, 12.0])
def test_plant_does_not_give_other_tensions_than_the_law_commands(minimum):
    infos = run(gym.make(IDS["planar"]), FeedbackLinearization(PLANAR, minimum_tension=minimum))
    least = np.array([info["tensions"].min() for info in infos if np.all(np.abs(info["commanded_action"]) <= 1)])
    assert len(least) > 450
    np.testing.assert_allclose(least, minimum, rtol=1e-6)


def test_fourth_cable_is_not_in_the_way():
    env = gym.make(IDS["planar"], robot=SQUARE.to_dict(), max_episode_steps=-1)
    assert env.action_space.shape == (4,)
    infos = run(env, FeedbackLinearization(SQUARE, minimum_tension=3.0))
    assert max(info["tracking_error_peak"] for info in infos) < 1e-3
    tensions = np.array([info["tensions"] for info in infos])
    assert tensions.shape == (500, 4)
    np.testing.assert_allclose(tensions.min(axis=1), 3.0, rtol=1e-6)
    assert np.all(tensions.max(axis=0) > 5.0), "each cable has its turn"
