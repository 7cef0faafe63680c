"""Reward, limits, termination and info: a constructed case for each term, limit, reason and quantity."""

import itertools
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import FLEX_SPATIAL, PLANAR, ROBOTS, SPATIAL, make_vector, rigid_ids, rollout
from oracles.episodes import make as make_any

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.settings import DEFAULT_WEIGHTS
from cablebot_gym.evaluation.judge import Judge
from cablebot_gym.physics import textbook


def make(env_id, **keywords):
    """An environment whose reference is at rest."""
    dwell = {"trajectory": f"dwell-{ROBOTS[env_id].kind}", "initial_error": 0}
    return make_any(env_id, **dwell | keywords)


def tremble(env_id, steps):
    """Random actions, each repeated for five steps; many are beyond ±1, some beyond ±2."""
    rng = np.random.default_rng(0)
    held = rng.uniform(0.1, 1.0, (steps // 5, ROBOTS[env_id].cables))
    return 2.5 * np.repeat(held, 5, axis=0)


@rigid_ids
def test_reward_is_the_sum_of_its_weighted_terms(env_id):
    weights = {term: (-1) ** index * (1 + index) for index, term in enumerate(REWARD_TERMS)}
    bounds = {"position": 0.03, "rotation": 0.002}
    robot = ROBOTS[env_id]
    motion = f"paper-{robot.kind}"
    env = make(env_id, trajectory=motion, reward_weights=weights, error_bounds=bounds)
    actions = tremble(env_id, 30)
    start = 0.02 * np.eye(robot.coordinates)[1]
    episode = rollout(env, actions, seed=0, options={"initial_error": start})
    info = {name: values[1:] for name, values in episode.info.items()}
    error = info["tracking_error"]
    assert np.any(error < info["tracking_error_peak"] - 1e-6)  # else the peak would do as well
    violation = np.diff(episode.info["violated"].astype(float))
    assert violation[0] < violation.sum() == 1
    terms = {
        "inside": 1.0 - info["violated"],
        "position": 1 / (1 + error / bounds["position"]),
        "rotation": (env_id == SPATIAL) / (1 + info["rotation_error"] / bounds["rotation"]),
        "saturation": -np.clip(np.abs(actions) - 1, 0, 1).mean(axis=1),
        "violation": -env.task.steps * violation,
    }
    assert list(terms) == list(REWARD_TERMS)
    for name, value in terms.items():
        assert_allclose(info[f"reward_{name}"], weights[name] * value, atol=1e-12)
    total = sum(info[f"reward_{name}"] for name in terms)
    assert_allclose(episode.rewards, total, atol=1e-12)


# --- violation ----------------------------------------------------------------------------------------------------


def violations(env, actions, **options):
    """Whether the start violates, the steps in which the violation term is not zero, and the
    info."""
    info = rollout(env, actions, options=options).info
    assert np.all(np.diff(info["violated"].astype(int)) >= 0)
    return info["violated"][0], np.flatnonzero(info["reward_violation"][1:]).tolist(), info


@pytest.mark.parametrize(
    ("limits", "cable", "action", "steps"),
    [
        ({"minimum_tension": 1.0}, "unilateral", 0.006, [1]),  # 0.6 N in each cable
        ({"minimum_tension": 0.5}, "unilateral", 0.006, []),
        ({"minimum_tension": 1.0}, "bilateral", 0.006, []),  # such a cable only has to pull
        ({}, "bilateral", -0.01, [1]),
        ({"maximum_tension": 29.0}, "unilateral", 0.3, [1]),  # 30 N in each cable
        ({"maximum_tension": 29.0}, "bilateral", 0.3, [1]),
        ({"maximum_tension": 31.0}, "unilateral", 0.3, []),
    ],
)
def test_tension_beyond_a_limit_of_the_robot_violates(limits, cable, action, steps):
    """Without slack and without termination."""
    actions = np.full((3, 3), 0.1)
    actions[1] = action
    env = make(PLANAR, robot=ROBOTS[PLANAR].replace(**limits), cable=cable)
    _, violated, info = violations(env, actions)
    assert violated == steps
    assert np.flatnonzero(info["cost"][1:]).tolist() == steps
    assert not info["termination_reason"].any()


@pytest.mark.parametrize("env_id", [SPATIAL, FLEX_SPATIAL])
def test_payload_that_no_motor_holds_violates_at_the_start(env_id):
    env = make_any(env_id)
    for payload, held in ((4.0, True), (9.0, False)):
        start, violated, info = violations(env, [np.ones(6)] * 2, payload=payload)
        assert (start, violated) == (not held, [] if held else [0])
        assert np.all(info["torque_margin"][0] >= 0) == held
        assert info["cost"][1:].tolist() == [float(not held), 0.0]
    moving = {"payload": 9.0, "trajectory": "paper-spatial"}
    assert env.reset(options=moving)[1]["violated"] is False


@pytest.mark.parametrize(("env_id", "cable"), [(PLANAR, "unilateral"), (SPATIAL, "bilateral")])
def test_violated_agrees_with_the_judge(env_id, cable):
    """Over random actions, payloads that cannot be held, and start errors, until the end of the
    motion."""
    robot = ROBOTS[env_id]
    count = 96
    env = make_vector(
        env_id,
        count,
        cable=cable,
        trajectory={"name": f"line-{robot.kind}", "duration": 0.1, "dwell": 0.02},
        payload_range=(0.0, 9.0),
        initial_error_range=[0.009] * robot.coordinates,
        autoreset_mode="Disabled",
        error_bounds={"position": 0.011, "rotation": 0.011},
    )
    _, info = env.reset(seed=0)
    judge = Judge("task", robot.cables, count)
    judge.reset(info, env.tasks[0])
    at_start = np.mean(judge.failed)
    costs = np.zeros(count)
    rng = np.random.default_rng(1)
    centre = 0.55 if env_id == SPATIAL else 0.1
    for _ in range(env.tasks[0].steps):
        assert_array_equal(info["violated"], judge.failed)
        actions = centre * rng.uniform(0.5, 1.5, env.action_space.shape)
        _, _, terminated, _, info = env.step(actions)
        judge.observe(info, terminated)
        costs += info["cost"]
        assert_array_equal(costs > 0, judge.failed)
    assert at_start < 0.8
    assert np.mean(judge.failed) > at_start + 0.1


def test_terminate_on_violation_ends_the_episode_there():
    """Nothing else changes; the reason has the lowest precedence."""
    actions = tremble(PLANAR, 120)
    actions[:, 1:] *= 0.02  # the first cable pulls the platform out of the termination radius
    patient = rollout(make(PLANAR), actions)
    strict = rollout(make(PLANAR, terminate_on_violation=True), actions)
    step = np.flatnonzero(patient.info["violated"])[0]
    reasons = strict.info["termination_reason"]
    assert np.flatnonzero(strict.terminated)[0] == step - 1
    assert TERMINATION_REASONS[reasons[step]] == "violation"
    assert_array_equal(patient.rewards[:step], strict.rewards[:step])
    outside = patient.info["termination_reason"] == 1
    assert outside.any()
    assert np.all(reasons[outside] == 1)


def test_termination_violates():
    """The error bound of the episode is larger than the termination radius of the environment."""
    wide = {"error_bounds": {"position": 1.0}, "initial_error": [0.11, 0.0]}
    _, violated, info = violations(make(PLANAR), [np.full(3, 0.1)], **wide)
    assert violated == [0]
    assert TERMINATION_REASONS[info["termination_reason"][1]] == "tracking_error"


# --- order of returns ---------------------------------------------------------------------------------------------


def test_default_weights_satisfy_the_proof():
    """The conditions that docs/your-own/policy.md names."""
    inside, position, rotation, saturation, violation = (
        DEFAULT_WEIGHTS[name] for name in REWARD_TERMS
    )
    assert inside == 1
    assert saturation < position / 2
    assert violation >= position + rotation


def reason_after(env, action, **options):
    """Reason of the termination in the first step."""
    episode = rollout(env, action[None], options=options)
    assert not episode.truncated.any()  # a crash is not a time limit
    reason = TERMINATION_REASONS[episode.info["termination_reason"][-1]]
    assert episode.terminated[-1] == (reason != "")
    return reason


def test_step_after_termination_warns_until_reset():
    env = make(PLANAR)
    action = np.full(3, 0.3)
    env.reset(options={"initial_error": [0.1001, 0.0]})
    assert env.step(action)[2]
    with pytest.warns(UserWarning, match=r"after the episode was terminated.*reset\(\)"):
        env.step(action)
    assert env.reset()[1]["termination_reason"] == 0
    with warnings.catch_warnings(action="error"):
        assert env.step(action)[2] is False


@rigid_ids
def test_pose_outside_radius_or_workspace_terminates(env_id):
    """The sensors do not matter: noise of 0.5 m would end the episodes at once."""
    robot = ROBOTS[env_id]
    action = np.full(robot.cables, 0.3)
    workspace = tuple((home - 0.03, home + 0.03) for home in robot.home_pose)
    noise = {"sensors": {"position": 0.5}}
    narrow = make(env_id, robot=robot.replace(workspace=workspace), uncertainty=noise)
    for direction, side in itertools.product(np.eye(robot.coordinates), (-1, 1)):
        for distance, reason in ((0.032, "workspace"), (0.028, "")):
            error = distance * side * direction
            assert reason_after(narrow, action, initial_error=error) == reason
    wide = make(env_id)
    for distance, reason in ((0.1001, "tracking_error"), (0.0995, "")):
        error = distance * np.eye(robot.coordinates)[0]
        assert reason_after(wide, action, initial_error=error) == reason


# --- reasons ------------------------------------------------------------------------------------------------------


def test_slack_cable_terminates_after_the_slack_time():
    """The observation has the timer, which starts anew when the cable is taut."""
    env = make(SPATIAL, error_bounds={"position": 1.0})
    action = np.full(6, 0.9)
    action[3] = -0.9
    actions = np.tile(action, (100, 1))
    actions[8:10, 3] = 0.9
    episode = rollout(env, actions)
    slack = episode.info["slack"]
    assert not np.delete(slack, 3, axis=1).any()
    assert slack[8, 3] > slack[10, 3] < slack[20, 3]
    timer = np.zeros(101)
    for step in range(100):
        timer[step + 1] = (timer[step] + 0.002) * slack[step + 1, 3]
    end = np.flatnonzero(episode.terminated)[0] + 1
    observed = env.layout.split(episode.observations)["slack_time"][:, 0]
    assert_allclose(observed[: end + 1], timer[: end + 1], atol=1e-12)
    assert timer[end] == pytest.approx(0.102)
    assert TERMINATION_REASONS[episode.info["termination_reason"][end]] == "slack"


def test_non_finite_state_is_bounded_and_earns_nothing():
    """Physics steps that are far too long, under actions that alternate."""
    env = make(SPATIAL, trajectory="paper-spatial", control_frequency=20.0, substeps=1)
    rng = np.random.default_rng(0)
    env.reset()
    reason = ""
    while reason != "non_finite":
        observation, _, terminated, _, info = env.step(rng.choice([-5.0, 5.0], 6))
        reason = TERMINATION_REASONS[info["termination_reason"]]
    assert terminated
    assert observation in env.observation_space
    assert all(np.all(np.isfinite(value)) for value in info.values())
    for name in ("tracking_error", "rotation_error", "rotation_error_peak"):
        assert info[name] > 1e3
    assert max(info["reward_position"], info["reward_rotation"]) < 1e-3
    assert (info["violated"], info["reward_inside"]) == (True, 0.0)


# --- info columns -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", [PLANAR, SPATIAL, FLEX_SPATIAL])
def test_info_is_of_the_start_and_peaks_of_the_whole_period(env_id):
    """Errors are those of the end, where the observation has the true state. The actions are raw,
    many beyond ±1, and the torques clipped. Damped cables go slack within a period."""
    robot = ROBOTS[env_id]
    robot = robot.replace(transmission=robot.transmission.replace(damping=0.3))
    env = make(
        env_id,
        robot=robot,
        control_frequency=60.0,
        substeps=40,
        trajectory=f"paper-{robot.kind}",
        error_bounds={"position": 1.0},
    )
    rng = np.random.default_rng(0)
    actions = np.repeat(1.6 * rng.uniform(-0.6, 1.0, (20, robot.cables)), 5, axis=0)
    episode = rollout(env, actions, seed=0)
    info = {name: values[1:] for name, values in episode.info.items()}
    drop = robot.speed_slope * info["motor_speeds"]
    assert np.abs(drop).max() > 0.05
    after = env.layout.split(episode.observations)
    blocks = {name: values[:-1] for name, values in after.items()}
    speeds = textbook.pulley_speed(robot, blocks["pose"], blocks["velocity"])
    if robot.flexible:
        speeds = blocks["motor_speed"]
    error = (after["pose"] - after["reference_pose"])[1:]
    assert_array_equal(after["pose"][-1], env.pose)
    expected = {
        "commanded_action": actions,
        "torques": robot.stall_torque * np.clip(actions, -1, 1) - drop,
        "torque_margin": robot.stall_torque * (1 - np.abs(actions)),
        "action_time": np.arange(100) / 60,
        "time": np.arange(1, 101) / 60,
        "motor_speeds": speeds,
        "tracking_error": np.linalg.norm(error[:, :3], axis=1),
        "rotation_error": np.abs(error[:, 3:]).max(axis=1, initial=0),
        "slack": info["least_tensions"] == 0.0,
    }
    for name, values in expected.items():
        assert_allclose(info[name], values, atol=1e-9, err_msg=name)
    assert 0.05 < info["slack"].mean() < 0.95
    assert np.any(info["tracking_error_peak"] > info["tracking_error"] + 1e-6)
    if env_id == SPATIAL:
        assert np.any(info["slack"] & (info["tensions"] > 0))
        assert np.any(info["rotation_error_peak"] > info["rotation_error"] + 1e-6)
