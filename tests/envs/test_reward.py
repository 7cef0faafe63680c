"""The reward, the limits that it rewards, and the order of returns: success before failure."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.envs import PAPER_ENV_IDS, TERMINATION_REASONS
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.settings import DEFAULT_WEIGHTS
from cablebot_gym.evaluation.constraints import Judge
from cablebot_gym.policies import load_policy, policy_entries
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.trajectories import held_out_seeds

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
each_kind = pytest.mark.parametrize("kind", list(ROBOTS))


def make(kind, **keywords):
    """An environment without wrappers, whose reference is at rest."""
    return gym.make(IDS[kind], **{"trajectory": f"dwell-{kind}", "initial_error": 0} | keywords).unwrapped


def run(env, actions, **reset):
    """Info of the reset, and rewards and infos of the steps by name."""
    _, start = env.reset(**reset)
    steps = [env.step(action) for action in actions]
    infos = [step[4] for step in steps]
    named = {name: np.array([info[name] for info in infos]) for name in infos[0]}
    return start, np.array([step[1] for step in steps]), named | {"terminated": np.array([step[2] for step in steps])}


def tremble(kind, steps, seed=0, low=-0.6, high=1.0):
    """Random actions, each repeated for five steps; many are beyond ±1, some beyond ±2."""
    rng = np.random.default_rng(seed)
    return 2.5 * np.repeat(rng.uniform(low, high, (-(-steps // 5), ROBOTS[kind].cables)), 5, axis=0)[:steps]


@pytest.mark.parametrize("weight", [1.0, -2.5])
@each_kind
def test_reward_is_the_sum_of_its_weighted_terms(kind, weight):
    weights = {term: weight * (1 + index) for index, term in enumerate(REWARD_TERMS)}
    bounds = {"position": 0.03, "rotation": 0.002}
    env = make(kind, trajectory=f"paper-{kind}", reward_weights=weights, error_bounds=bounds, slack_time=9.0)
    actions = tremble(kind, 30, low=0.1)
    start = np.append([0.0, 0.02], np.zeros(env.task.robot.coordinates - 2))
    _, rewards, info = run(env, actions, seed=0, options={"initial_error": start})
    assert np.any(info["tracking_error"] < info["tracking_error_peak"] - 1e-6)  # else the peak would do as well
    first = np.flatnonzero(info["violated"])[0]
    assert first > 0
    terms = {
        "inside": 1.0 - info["violated"],
        "position": 1 / (1 + info["tracking_error"] / bounds["position"]),
        "rotation": 1 / (1 + info["rotation_error"] / bounds["rotation"]) if kind == "spatial" else np.zeros(30),
        "saturation": -np.clip(np.abs(actions) - 1, 0, 1).mean(axis=1),
        "violation": -float(env.task.steps) * (np.arange(30) == first),
    }
    assert list(terms) == list(REWARD_TERMS)
    for name, value in terms.items():
        np.testing.assert_allclose(info[f"reward_{name}"], weights[name] * value, atol=1e-12)
    np.testing.assert_allclose(rewards, sum(info[f"reward_{name}"] for name in terms), atol=1e-12)


@pytest.mark.parametrize("name", ["position", "rotation"])
def test_error_terms_have_a_slope_at_ten_bounds(name):
    """A constant term beyond the bound would not lead a failed policy back."""
    env = make("spatial", termination_radius=9.0)
    terms = []
    for error in (0.099, 0.1, 0.101):
        start = np.zeros(6)
        start[0 if name == "position" else 4] = error
        terms.append(run(env, [np.full(6, 0.43)], options={"initial_error": start})[2][f"reward_{name}"][0])
    assert -np.diff(terms).max() > 1e-5
    assert terms[1] == pytest.approx(0.05 / 11, rel=0.02)


# -------------------------------------------------------------------------------------------------------- violation


def violated_in(env, actions, **reset):
    """Violated at the start, and the steps in which the violation term is not zero."""
    start, _, info = run(env, actions, **reset)
    assert np.all(np.diff(info["violated"].astype(int)) >= 0)
    return start["violated"], np.flatnonzero(info["reward_violation"]).tolist(), info


@each_kind
def test_start_error_beyond_its_bound_violates_at_the_start(kind):
    """The first step yields the violation term, once."""
    env, error = make(kind), np.zeros(ROBOTS[kind].coordinates)
    for coordinate in (0, -1):
        for size, expected in ((0.0101, (True, [0])), (0.0099, (False, []))):
            options = {"initial_error": np.where(np.arange(len(error)) == coordinate % len(error), size, 0.0)}
            actions = [np.full(env.action_space.shape, 0.43 if kind == "spatial" else 0.1)] * 2
            assert violated_in(env, actions, options=options)[:2] == expected


def test_tension_below_the_minimum_violates_without_slack():
    """T_min is that of the robot; bilateral cables only have to pull."""
    actions = np.full((3, 3), 0.1)
    actions[1] = 0.006  # 0.6 N in each cable
    for minimum, first in ((1.0, [1]), (0.5, [])):
        env = make("planar", robot=PLANAR.replace(minimum_tension=minimum))
        _, found, info = violated_in(env, actions)
        assert found == first
        assert info["cost"].tolist() == [0.0, float(bool(first)), 0.0]
        assert 0.5 < info["least_tensions"][1].min() < 1.0
        assert not info["slack"].any()
    pushed = make("planar", cable="bilateral")
    assert violated_in(pushed, actions)[1] == []
    actions[1] = -0.01
    assert violated_in(pushed, actions)[1] == [1]


@pytest.mark.parametrize("robot", [SPATIAL, FLEX_SPATIAL], ids=lambda robot: robot.name)
def test_payload_that_no_motor_holds_violates_at_the_start_of_a_motion_at_rest(robot):
    env = gym.make("CableBot-Spatial-v0" if robot is SPATIAL else "CableBot-FlexSpatial-v0").unwrapped
    for payload, held in ((4.0, True), (9.0, False)):
        start, found, info = violated_in(env, [np.ones(6)] * 2, options={"payload": payload})
        assert (start, found) == ((False, []) if held else (True, [0]))
        margin = env.reset(options={"payload": payload})[1]["torque_margin"]
        assert np.all(margin >= 0) == held
        assert info["reward_inside"].tolist() == [float(held)] * 2
        assert info["cost"].tolist() == [float(not held), 0.0]
    moving = {"payload": 9.0, "trajectory": "paper-spatial"}
    assert env.reset(options=moving)[1]["violated"] is False


def test_termination_violates():
    """The error bound is larger than the termination radius."""
    env = make("planar", error_bounds={"position": 1.0}, termination_radius=0.05)
    _, found, info = violated_in(env, [np.full(3, 0.1)], options={"initial_error": [0.06, 0.0]})
    assert (found, TERMINATION_REASONS[info["termination_reason"].item()]) == ([0], "tracking_error")


@each_kind
@pytest.mark.parametrize("cable", ["unilateral", "bilateral"])
def test_violated_agrees_with_the_judge(kind, cable):
    """Over random actions, payloads that cannot be held, and start errors, until the end of the motion."""
    count, rng = 96, np.random.default_rng(1)
    env = gym.make_vec(
        IDS[kind], count, cable=cable, trajectory={"name": f"line-{kind}", "duration": 0.1, "dwell": 0.02},
        payload_range=(0.0, 9.0), initial_error_range=[0.009] * ROBOTS[kind].coordinates,
        autoreset_mode="Disabled", termination_radius=0.02, error_bounds={"position": 0.011, "rotation": 0.011},
    ).unwrapped  # fmt: skip
    _, info = env.reset(seed=0)
    judge = Judge("task", ROBOTS[kind].cables, count)
    judge.reset(info, env.tasks[0])
    np.testing.assert_array_equal(info["violated"], judge.failed)
    alive, costs = [np.mean(~judge.failed)], np.zeros(count)
    centre = 0.55 if kind == "spatial" else 0.1
    for _ in range(env.tasks[0].steps):
        actions = centre * rng.uniform(0.5, 1.5, env.action_space.shape)
        _, _, terminated, _, info = env.step(actions)
        judge.observe(info, terminated)
        np.testing.assert_array_equal(info["violated"], judge.failed)
        costs += info["cost"]
        np.testing.assert_array_equal(costs > 0, judge.failed)
        alive.append(np.mean(~judge.failed))
    assert alive[0] > 0.2
    assert alive[-1] < alive[0] - 0.1


# ----------------------------------------------------------------------------------------------- termination option


@each_kind
def test_terminate_on_violation_ends_the_episode_at_its_first_violation(kind):
    """Nothing else changes; the reason has the lowest precedence."""
    actions = tremble(kind, 40, low=0.1)
    usual, ending = (make(kind, terminate_on_violation=option, termination_radius=0.015) for option in (False, True))
    (_, rewards, info), (_, same_rewards, same) = run(usual, actions), run(ending, actions)
    first = np.flatnonzero(info["violated"])[0]
    assert TERMINATION_REASONS[same["termination_reason"][first].item()] == "violation"
    np.testing.assert_array_equal(np.flatnonzero(same["terminated"])[0], first)
    np.testing.assert_array_equal(rewards[: first + 1], same_rewards[: first + 1])
    assert not info["terminated"][: first + 1].any()
    own = info["termination_reason"][info["terminated"]]
    assert own.size
    np.testing.assert_array_equal(same["termination_reason"][info["terminated"]], own)
    _, late, info = violated_in(make(kind, terminate_on_violation=True), actions[:1] * 0, options={"payload": 0.0})
    assert (late, TERMINATION_REASONS[info["termination_reason"].item()]) == (
        [0],
        "violation",
    )  # slack, for a short time


# -------------------------------------------------------------------------------------------------- order of returns


def test_default_weights_satisfy_the_proof():
    """The conditions that docs/your-own/reward.md names."""
    inside, position, rotation, saturation, violation = (DEFAULT_WEIGHTS[name] for name in REWARD_TERMS)
    assert inside == 1
    assert saturation < position / 2
    assert violation >= position + rotation


def check_order(env_id, trajectory, policies, payloads):
    """Returns of successes and failures, judged by the task criterion; every success must return more."""
    env = gym.make_vec(env_id, len(payloads), trajectory=trajectory, payload=payloads, autoreset_mode="Disabled")
    returns: dict[bool, list[float]] = {True: [], False: []}
    for name in policies:
        policy, state = load_policy(name, env.unwrapped.settings.robot), None
        observation, info = env.reset(seed=0)
        tasks = env.unwrapped.tasks
        if hasattr(policy, "reset"):
            policy.reset(tasks)
        judge = Judge("task", tasks[0].robot.cables, len(payloads))
        judge.reset(info, tasks[0])
        total, running = np.zeros(len(payloads)), np.ones(len(payloads), np.bool_)
        for step in range(tasks[0].steps):
            start = np.full(len(payloads), step == 0)
            actions, state = policy.predict(observation, state, start, deterministic=True)
            observation, reward, terminated, _, info = env.step(np.clip(actions, -9e5, 9e5))
            total += running * reward
            judge.observe(info, terminated)
            running &= ~terminated
        for carried, value in zip(judge.carried, total, strict=True):
            returns[bool(carried)].append(value)
    assert min(map(len, returns.values())) > 0, returns
    assert sum(map(len, returns.values())) >= 12
    assert min(returns[True]) > max(returns[False]) + 1, (env_id, trajectory)


def test_return_orders_success_before_failure():
    check_order(
        "CableBot-Planar-v0",
        {"name": "line-planar", "duration": 0.3, "dwell": 0.05},
        ["fl", "robust"],
        [0.0, 1.0, 3.0, 9.0, 20.0, 40.0],
    )


@pytest.mark.slow
@pytest.mark.parametrize("motion", [None, *held_out_seeds(2)], ids=["circle", "loop 1", "loop 2"])
@pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
def test_return_orders_success_before_failure_for_all_classical_policies(env_id, motion):
    """On the default motion and on held-out loops, for payloads from none to more than any policy carries."""
    kind = "planar" if "Planar" in env_id else "spatial"
    trajectory = f"circle-{kind}" if motion is None else {"name": f"loop-{kind}", "seed": motion}
    entries = policy_entries().values()
    policies = [entry.name for entry in entries if entry.kind == "classical" and env_id in entry.env_ids]
    assert len(policies) >= 3
    check_order(env_id, trajectory, policies, [0.0, 0.3, 0.6, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0])
