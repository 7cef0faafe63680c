"""How an episode fails and what it is paid: a constructed case for each reason, info column and reward term."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.envs.outcome import REWARD_TERMS, TERMINATION_REASONS
from cablebot_gym.envs.settings import DEFAULT_WEIGHTS
from cablebot_gym.kinematics import structure_jacobian
from cablebot_gym.robots import PLANAR, SPATIAL, Motors, Transmission

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
each_kind = pytest.mark.parametrize("kind", list(ROBOTS))


def make(kind, **keywords):
    """A bare environment that holds still unless told otherwise."""
    return gym.make(IDS[kind], **{"trajectory": f"dwell-{kind}"} | keywords).unwrapped


def displaced(kind, x):
    """A start error along x."""
    return [x] + [0.0] * (ROBOTS[kind].coordinates - 1)


def step(env, command):
    """One period under the same command for all motors: reward, flags, info."""
    return env.step(np.full(env.action_space.shape, command))[1:]


def last_step(env, command, steps, seed=None, **options):
    """Reward, flags and info of the first step that ends the episode, and its number; fails if none does."""
    env.reset(seed=seed, options=options)
    for number in range(1, steps + 1):
        reward, terminated, truncated, info = step(env, command)
        assert truncated is False  # a crash is not a time limit
        assert terminated == (info["termination_reason"] != "")
        if terminated:
            return number, reward, info
    raise AssertionError("no step ended the episode")


def test_a_step_after_the_end_does_not_pass_in_silence_and_one_after_a_reset_does():
    env = make("planar")
    last_step(env, 0.3, 1, initial_error=displaced("planar", 0.1001))
    with pytest.warns(UserWarning, match=r"after the episode was terminated.*reset\(\)"):
        step(env, 0.3)
    env.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        step(env, 0.3)


# ------------------------------------------------------------------------------------------------------- reasons


@each_kind
def test_leaving_the_termination_radius_is_named_tracking_error(kind):
    env = make(kind)
    number, _, info = last_step(env, 0.3, 1, initial_error=displaced(kind, 0.1001))
    assert (number, info["termination_reason"]) == (1, "tracking_error")
    assert info["tracking_error"] > 0.1
    env.reset(options={"initial_error": displaced(kind, 0.0995)})
    _, terminated, _, info = step(env, 0.3)
    assert (terminated, info["termination_reason"]) == (False, "")
    assert info["tracking_error"] < 0.1  # else the boundary is not where the keyword puts it


@each_kind
@pytest.mark.parametrize("radius", [0.01, 0.05])
def test_termination_radius_is_the_keywords_and_not_the_defaults(kind, radius):
    env = make(kind, termination_radius=radius)
    env.reset()
    pull = np.full(env.action_space.shape, 0.4)
    pull[:2] = 0.8
    errors, terminated = [], False
    while not terminated and len(errors) < 300:
        _, _, terminated, _, info = env.step(pull)
        errors.append(info["tracking_error"])
    assert info["termination_reason"] == "tracking_error"
    assert max(errors[:-1]) <= radius < errors[-1]


@each_kind
@pytest.mark.parametrize("slack_time", [0.0, 0.05, 0.1])
def test_cables_let_go_for_longer_than_slack_time_are_named_slack(kind, slack_time):
    env = make(kind, termination_radius=5.0, slack_time=slack_time)
    number, _, info = last_step(env, -0.2, 200)
    assert info["termination_reason"] == "slack"
    assert info["slack"].all()
    assert not info["tensions"].any()
    assert number == round(slack_time * 500) + 1  # longer than, by the first step that is
    assert info["time"] == pytest.approx(number / 500)


@each_kind
def test_slack_shorter_than_slack_time_does_not_end_and_is_not_added_up(kind):
    env = make(kind, termination_radius=5.0, slack_time=0.05)
    env.reset()
    slack = []
    for _ in range(5):
        for command in [-0.9] * 24 + [0.9] * 2:  # 48 ms slack, 4 ms taut
            _, terminated, _, info = step(env, command)
            assert terminated is False
            slack.append(info["slack"].any())
    assert sum(slack) == 5 * 24
    for number in range(1, 27):
        _, terminated, _, info = step(env, -0.9)
        assert terminated == (number == 26)
    assert info["termination_reason"] == "slack"


def test_one_slack_cable_is_enough():
    env = make("spatial", termination_radius=5.0)
    command = np.full(6, 0.9)
    command[3] = -0.9
    env.reset()
    for _ in range(60):
        _, _, terminated, _, info = env.step(command)
        if terminated:
            break
    assert info["termination_reason"] == "slack"
    assert info["slack"][3]
    assert not info["slack"].all()


@each_kind
def test_a_reset_forgets_the_slack_of_the_episode_before(kind):
    env = make(kind, termination_radius=5.0)
    for _ in range(3):
        env.reset()
        assert not any(step(env, -0.2)[1] for _ in range(40))  # 80 ms of 100


@each_kind
def test_leaving_the_workspace_is_named_workspace(kind):
    robot = ROBOTS[kind]
    env = make(kind, termination_radius=5.0)
    outside = np.zeros(robot.coordinates)
    outside[1] = robot.pose_bounds[1, 1] - robot.home[1] + 0.001  # through the upper bound of y
    number, _, info = last_step(env, 0.3, 1, initial_error=outside)
    assert (number, info["termination_reason"]) == (1, "workspace")
    inside = np.zeros(robot.coordinates)
    inside[1] = robot.pose_bounds[1, 1] - robot.home[1] - 0.01
    env.reset(options={"initial_error": inside})
    assert step(env, 0.3)[1] is False


@pytest.mark.parametrize("coordinate", range(6))
@pytest.mark.parametrize("side", [0, 1])
def test_the_workspace_has_two_sides_in_each_coordinate(coordinate, side):
    box = 0.03
    robot = SPATIAL.replace(workspace=tuple((home - box, home + box) for home in SPATIAL.home_pose))
    env = make("spatial", robot=robot)
    for distance, ends in ((0.032, True), (0.028, False)):
        error = np.zeros(6)
        error[coordinate] = distance * (2 * side - 1)
        env.reset(options={"initial_error": error})
        _, terminated, _, info = step(env, 0.3)
        assert (terminated, info["termination_reason"]) == (ends, "workspace" if ends else "")


def test_a_state_that_ceases_to_be_finite_is_named_non_finite_planar():
    env = make("planar", termination_radius=5.0)
    number, reward, info = last_step(env, 0.2, 1, initial_error=PLANAR.base[0])  # on an anchor: no direction to pull
    assert (number, info["termination_reason"]) == (1, "non_finite")
    assert reward < -0.9


def spatial_blow_up():
    """Far too long physics steps under commands that flip: reward and info of the first non-finite state."""
    env = make("spatial", trajectory="paper-spatial", control_frequency=20.0, substeps=1)
    rng = np.random.default_rng(0)
    env.reset()
    for _ in range(2000):
        _, reward, terminated, truncated, info = env.step(rng.choice([-5.0, 5.0], 6))
        if info["termination_reason"] == "non_finite":
            assert (terminated, truncated) == (True, False)
            return reward, info
    raise AssertionError("the state stayed finite")


def test_a_state_that_ceases_to_be_finite_is_named_non_finite_spatial():
    _, info = spatial_blow_up()
    assert info["tracking_error"] > 1e3
    assert info["reward_position"] < 1e-3


def test_a_state_that_is_not_finite_earns_nothing_for_its_rotation():
    _, info = spatial_blow_up()
    assert info["rotation_error"] > 1e3
    assert info["rotation_error_peak"] > 1e3
    assert info["reward_rotation"] < 1e-3


def test_all_reasons_have_a_case_here():
    assert set(TERMINATION_REASONS) == {"", "tracking_error", "slack", "workspace", "non_finite"}


@each_kind
def test_no_reason_is_left_over_from_the_episode_before(kind):
    env = make(kind)
    last_step(env, 0.3, 1, initial_error=displaced(kind, 0.11))
    assert env.reset()[1]["termination_reason"] == ""
    assert step(env, 0.3)[1] is False


def test_bilateral_cables_that_push_stay_in_the_plant():
    """Cables that can push hold tensions below zero, which are reported as they are."""
    env = make("spatial", cable="bilateral", slack_time=9.0)
    env.reset()
    _, _, _, info = step(env, -0.3)
    assert np.all(info["tensions"] < 0)
    assert info["slack"].all()  # needs a push: neither criterion of a payload accepts that


# ---------------------------------------------------------------------------------------------------- info columns


def random_run(kind, steps=150, scale=1.6, seed=0, **keywords):
    """Infos, rewards and observations under random commands, many beyond what the motors give."""
    env = make(kind, trajectory=f"paper-{kind}", termination_radius=5.0, slack_time=99.0, **keywords)
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    observations, rewards, infos, commands = [observation], [], [], []
    for number in range(steps):
        if number % 5 == 0:
            command = scale * rng.uniform(-0.6, 1.0, env.action_space.shape)
        observation, reward, _, _, info = env.step(command)
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
        commands.append(command)
    named = {name: np.array([info[name] for info in infos]) for name in infos[0]}
    return env, np.array(commands), np.array(observations), np.array(rewards), named


@each_kind
def test_drive_demand_is_the_raw_action_and_torques_are_what_the_line_leaves_of_it(kind):
    _, commands, _, _, info = random_run(kind)
    robot = ROBOTS[kind]
    np.testing.assert_array_equal(info["commanded_action"], commands)
    assert np.abs(commands).max() > 1.2  # beyond ±1, so that there is something to clip
    drop = robot.speed_slope * info["motor_speeds"]
    upper, lower = robot.stall_torque - drop, -robot.stall_torque - drop
    assert np.abs(drop).max() > 0.05  # else U± would be ±τ_s
    assert np.all(info["torques"] <= upper + 1e-12)
    assert np.all(info["torques"] >= lower - 1e-12)
    wanted = robot.stall_torque * np.clip(commands, -1, 1) - drop
    np.testing.assert_allclose(info["torques"], wanted, atol=1e-12)
    np.testing.assert_allclose(info["torque_margin"], robot.stall_torque * (1 - np.abs(commands)), atol=1e-12)


@each_kind
def test_cable_columns_belong_to_the_start_of_the_period_and_not_to_its_end(kind):
    env, _, observations, _, info = random_run(kind)
    part = env.layout.split(observations)
    np.testing.assert_allclose(info["action_time"], np.arange(150) / 500, atol=1e-12)
    np.testing.assert_allclose(info["time"], np.arange(1, 151) / 500, atol=1e-12)
    robot = ROBOTS[kind]
    for number in range(0, 150, 7):
        jacobian = structure_jacobian(robot.base, robot.platform, part["pose"][number])
        speeds = jacobian @ part["velocity"][number] / -robot.pulley_radius
        np.testing.assert_allclose(info["motor_speeds"][number], speeds, atol=1e-9)


@each_kind
def test_slack_flags_are_cables_without_tension_at_some_physics_step(kind):
    _, _, _, _, info = random_run(kind, substeps=1)
    loose = info["tensions"] == 0.0
    np.testing.assert_array_equal(info["slack"], loose)  # one physics step: its start is all there is
    assert 0.05 < loose.mean() < 0.95
    assert np.all(info["tensions"] >= 0)
    _, _, _, _, info = random_run(kind, scale=0.0, steps=1)
    assert not info["slack"][info["tensions"] > 0].any()


@each_kind
@pytest.mark.parametrize("substeps", [1, 4])
def test_peaks_are_at_least_the_errors_at_the_ends(kind, substeps):
    _, _, _, _, info = random_run(kind, substeps=substeps)
    for name in ("tracking_error", "rotation_error"):
        assert np.all(info[f"{name}_peak"] >= info[name])
        if substeps == 1:
            np.testing.assert_allclose(info[f"{name}_peak"], info[name], rtol=1e-9, atol=1e-12)


@each_kind
def test_peaks_and_slack_are_over_every_physics_step_and_not_one_off(kind):
    """A slow controller against a fast one that repeats its command.

    The motors' torque does not depend on their speed, so that both ask for the same; their bearings are so stiff that a
    cable which winds up faster and faster goes slack within a period.
    """
    own, planar = ROBOTS[kind], ROBOTS[kind].planar
    robot = own.replace(
        motors=Motors(stall_torque=own.motors.stall_torque, free_speed=1e12),
        transmission=Transmission(pulley_radius=0.05, pulley_inertia=1e-5 if planar else 8e-4, damping=0.3),
    )
    keywords = {"robot": robot, "trajectory": f"paper-{kind}", "termination_radius": 5.0, "slack_time": 99.0}
    slow = make(kind, control_frequency=25.0, substeps=40, **keywords)
    fast = make(kind, control_frequency=1000.0, substeps=1, **keywords)
    rng = np.random.default_rng(3)
    inner, late, early = 0, 0, 0
    for _ in range(20):
        start = {"initial_error": [-0.2165, 0.4] if planar else displaced(kind, 0.01)}
        slow.reset(options=start)
        fast.reset(options=start)
        for period in range(3):
            command = rng.uniform(-0.2, 0.5, robot.cables)
            if planar and period == 0:  # the second cable shortens the first, too
                command[:2] = 0.02, 0.6
            info = slow.step(command)[4]
            each = [fast.step(command)[4] for _ in range(40)]
            for name in ("tracking_error", "rotation_error"):
                errors = [one[name] for one in each]
                assert info[f"{name}_peak"] == pytest.approx(max(errors), abs=1e-9)
                assert info[name] == pytest.approx(errors[-1], abs=1e-9)
                inner += max(errors) > errors[-1] + 1e-6
            slack = np.array([one["slack"] for one in each])
            np.testing.assert_array_equal(info["slack"], slack.any(axis=0))
            late += np.sum(slack.any(axis=0) & ~slack[0])
            early += np.sum(slack.any(axis=0) & ~slack[-1])
            for name in ("tensions", "torques", "motor_speeds"):  # at the start of the period
                np.testing.assert_allclose(info[name], each[0][name], rtol=1e-6, atol=1e-9)
    assert inner > 0  # a peak between the ends was seen,
    assert late > 0  # a cable that went slack after the period's start,
    assert early > 0  # and one that was taut again at its end


# -------------------------------------------------------------------------------------------------------- reward


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    weights=st.fixed_dictionaries({term: st.floats(-3, 3) for term in REWARD_TERMS}),
    spatial=st.booleans(),
    error_bounds=st.fixed_dictionaries({"position": st.floats(1e-3, 0.1), "rotation": st.floats(1e-3, 0.1)}),
)
def test_reward_is_the_sum_of_its_weighted_terms(weights, spatial, error_bounds):
    kind = "spatial" if spatial else "planar"
    _, commands, _, rewards, info = random_run(kind, steps=20, reward_weights=weights, error_bounds=error_bounds)
    terms = {
        "position": 1 / (1 + info["tracking_error"] / error_bounds["position"]),
        "rotation": 1 / (1 + info["rotation_error"] / error_bounds["rotation"]) if spatial else np.zeros(20),
        "saturation": -np.maximum(np.abs(commands) - 1, 0).mean(axis=1),
        "slack": -info["slack"].mean(axis=1),
        "failure": -(info["termination_reason"] != "").astype(float),
    }
    assert list(terms) == list(REWARD_TERMS)
    for name, value in terms.items():
        np.testing.assert_allclose(info[f"reward_{name}"], weights[name] * value, atol=1e-12)
    np.testing.assert_allclose(rewards, sum(info[f"reward_{name}"] for name in terms), atol=1e-12)


@each_kind
def test_failing_costs_the_failure_weight_once_it_has_failed(kind):
    for weight in (1.0, 7.0):
        env = make(kind, reward_weights={"failure": weight})
        _, reward, info = last_step(env, 0.3, 1, initial_error=displaced(kind, 0.11))
        assert info["reward_failure"] == -weight
        assert reward == pytest.approx(sum(info[f"reward_{term}"] for term in REWARD_TERMS), abs=1e-12)
        env.reset()
        assert step(env, 0.3)[3]["reward_failure"] == 0.0


@each_kind
def test_saturation_counts_only_what_is_beyond_one(kind):
    env = make(kind, reward_weights={"saturation": 1.0})
    for command, expected in ((1.0, 0.0), (-1.0, 0.0), (1.5, -0.5), (-1.5, -0.5)):
        env.reset()
        assert step(env, command)[3]["reward_saturation"] == pytest.approx(expected, abs=1e-15)


@each_kind
def test_the_position_term_still_has_a_slope_at_ten_times_the_bound(kind):
    bound = 0.004
    env = make(kind, error_bounds={"position": bound})
    rewards = {}
    for multiple in (9.5, 10.5):
        env.reset(options={"initial_error": displaced(kind, multiple * bound)})
        _, _, _, info = step(env, 0.3)
        rewards[multiple] = info["reward_position"]
        assert info["tracking_error"] == pytest.approx(multiple * bound, rel=0.05)
    slope = rewards[9.5] - rewards[10.5]  # over one bound
    assert slope > 0.005
    assert slope == pytest.approx(1 / 11**2, rel=0.2)


@each_kind
def test_an_expert_earns_nearly_all_there_is_and_a_bystander_does_not(kind):
    earned = {}
    for name in ("expert", "bystander"):
        env = make(kind, trajectory=f"circle-{kind}")
        policy = FeedbackLinearization(ROBOTS[kind])
        observation, _ = env.reset()
        earned[name], terminated = 0.0, False
        for _ in range(500):
            action = policy.predict(observation)[0] if name == "expert" else np.full(env.action_space.shape, 0.2)
            observation, reward, terminated, _, _ = env.step(action)
            earned[name] += reward
            if terminated:
                break
        assert terminated == (name == "bystander")
    best = 500 * (DEFAULT_WEIGHTS["position"] + DEFAULT_WEIGHTS["rotation"] * (kind == "spatial"))
    assert 0.9 * best < earned["expert"] <= best
    assert earned["bystander"] < 0.5 * best


# ---------------------------------------------------------------------------------------------------- uncertainty


@each_kind
def test_noise_beyond_radius_and_workspace_ends_nothing_and_costs_nothing(kind):
    """The episode is judged on the true state."""
    noise = {"sensors": {"position": 0.5, "velocity": 5.0}}
    robot = ROBOTS[kind]
    noisy, clean = make(kind, uncertainty=noise), make(kind)
    policy = FeedbackLinearization(robot)
    noisy.reset(seed=0)
    observation, _ = clean.reset(seed=0)
    seen = []
    for _ in range(30):
        action, _ = policy.predict(observation)
        observation, reward, terminated, _, info = clean.step(action)
        measured, *ours = noisy.step(action)
        assert ours[:2] == [reward, terminated] == [reward, False]
        assert ours[3]["tracking_error"] == info["tracking_error"] < 1e-6
        seen.append(np.linalg.norm(noisy.layout.split(measured)["pose"][:2] - noisy.pose[:2]))
    assert max(seen) > noisy.settings.termination_radius  # else the noise was too small to say anything


@each_kind
def test_a_wrench_can_make_the_robot_fail(kind):
    env = make(kind, uncertainty={"wrench": {"force_mean": 200.0}})
    _, _, info = last_step(env, 0.3, 200)
    assert info["termination_reason"] in ("tracking_error", "slack", "workspace")
