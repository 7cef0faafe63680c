"""Wrappers that a learner trains through, their twins bit for bit, and that a policy does afterwards what it learnt."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common import env_checker

import cablebot_gym
from cablebot_baselines.classical import FeedbackLinearization
from cablebot_baselines.learned.base import find_base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.features import REFERENCE_FEATURES
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.steering import Shift, Steering, find_action_mapping
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import (
    PayloadCurriculum,
    PayloadCurriculumVector,
    Steered,
    SteeredVector,
    WithinLimits,
    WithinLimitsVector,
    make_steered_vec,
)
from cablebot_gym.evaluation import DLCCMonitor, evaluate_dlcc
from cablebot_gym.evaluation.constraints import Judge
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds

PLANAR_ID, SPATIAL_ID, FLEX_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"
DISABLED = AutoresetMode.DISABLED

SEEN = ("pose", "velocity", "error", "actions", "time_since_start", "rbf_time", "time_to_go_decays", "model_payload")
SHIFTED = (*SEEN, "shift", "shift_velocity")

# What a law does under random actions: some episodes fail, others last until a limit that falls within an action.
CASES: dict[str, dict[str, Any]] = {
    "shift": {
        "env_id": PLANAR_ID,
        "heaviest": 4.0,
        "steered": {
            "base": {"law": "fl", "estimates_payload": True},
            "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.5},
            "features": SHIFTED,
        },
    },
    "preview": {
        "env_id": FLEX_ID,
        "heaviest": 9.0,
        "steered": {
            "base": "composite",
            "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.3, "degree": 5, "preview": 0.05},
            "features": SHIFTED,
        },
    },
    "residual": {
        "env_id": SPATIAL_ID,
        "heaviest": 4.0,
        "steered": {"base": "fl", "steering": "residual", "features": SEEN},
    },
}
LIMIT = 56

each_case = pytest.mark.parametrize("case", list(CASES))


def stack(case):
    """Classes and arguments of the three wrappers."""
    chosen = CASES[case]
    curriculum = {"heaviest": chosen["heaviest"]}
    return [(WithinLimits, {}), (PayloadCurriculum, curriculum), (Steered, chosen["steered"])]


def single(case, **keywords):
    """Around one environment."""
    env = gym.make(CASES[case]["env_id"], **keywords)
    for made, arguments in stack(case):
        env = made(env, **arguments)
    return env


def many(case, count, **keywords) -> Any:
    """Around a batch."""
    return make_steered_vec(CASES[case]["env_id"], count, wrappers=stack(case), **keywords)


def actions_of(env, steps, seed=0, scale=1.0):
    """Random ones."""
    return np.random.default_rng(seed).uniform(-scale, scale, (steps, *env.action_space.shape)).astype(np.float32)


def check_same_lane(many_info, lane, info):
    """A lane's info is the single environment's to the last bit."""
    assert {key for key in many_info if not key.startswith(("_", "final"))} == set(info)
    for key, value in info.items():
        np.testing.assert_array_equal(many_info[key][lane], value, err_msg=key)


# ------------------------------------------------------------------------------------------ singles and their twins


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*imum value is -?infinity:UserWarning")
@pytest.mark.parametrize("case", ["shift", "preview"])
def test_checkers_find_nothing(case):
    env = single(case)
    check_env(env)
    env_checker.check_env(env, warn=True)
    assert env.observation_space.dtype == env.action_space.dtype == np.float32


@each_case
def test_every_lane_is_the_single_environment_to_the_last_bit_through_several_episodes(case):
    count, seed = 5, 3
    env = many(case, count, seed=None, max_episode_steps=LIMIT)
    singles = [single(case, max_episode_steps=LIMIT) for _ in range(count)]
    assert env.single_observation_space == singles[0].observation_space
    assert env.single_action_space == singles[0].action_space
    periods, duration = env.steering.periods, env.unwrapped.settings.period
    observation, info = env.reset(seed=seed)
    for lane, one in enumerate(singles):
        own, own_info = one.reset(seed=seed + lane)
        np.testing.assert_array_equal(observation[lane], own)
        check_same_lane(info, lane, own_info)
    ends: list[tuple[str, bool]] = []
    for action in actions_of(env, 30):
        observation, reward, terminated, truncated, info = env.step(action)
        assert observation.dtype == np.float32
        for lane, one in enumerate(singles):
            own, own_reward, own_terminated, own_truncated, own_info = one.step(action[lane])
            assert (reward[lane], terminated[lane], truncated[lane]) == (own_reward, own_terminated, own_truncated)
            if own_terminated or own_truncated:
                assert info["_final_obs"][lane]
                assert info["_final_info"][lane]
                np.testing.assert_array_equal(info["final_obs"][lane], own)
                assert info["final_obs"][lane].dtype == np.float32
                check_same_lane(info["final_info"], lane, own_info)
                assert all(info["final_info"][f"_{key}"][lane] for key in own_info)
                ends.append((own_info["termination_reason"], round(own_info["time"] / duration) % periods == 0))
                own, own_info = one.reset()
            elif "final_obs" in info:
                assert not info["_final_obs"][lane]
                assert info["final_obs"][lane] is None
            np.testing.assert_array_equal(observation[lane], own)
            check_same_lane(info, lane, own_info)
    assert len(ends) > 2 * count  # else nothing is said of several episodes,
    assert ("", False) in ends  # of the time limit within an action,
    assert any(reason and not whole for reason, whole in ends)  # and of failures there


def test_an_actions_rewards_are_summed_up_to_the_end_of_the_episode():
    class Noted(gym.Wrapper[Any, Any, Any, Any]):
        rewards: list[float]

        def step(self, action):
            result = super().step(action)
            self.rewards.append(result[1])
            return result

    noted = Noted(WithinLimits(gym.make(PLANAR_ID, payload=6.0)))
    env = Steered(noted, **CASES["shift"]["steered"])
    env.reset(seed=0)
    terminated, lengths = False, []
    while not terminated:
        noted.rewards = []
        _, reward, terminated, _, info = env.step(np.zeros(2))
        assert reward == sum(noted.rewards)
        lengths.append(len(noted.rewards))
    assert lengths[0] == env.steering.periods == 10
    assert lengths[-1] < 10
    assert info["time"] == pytest.approx(sum(lengths) / 500)


def test_what_is_returned_of_an_ended_episode_is_its_last_and_not_what_the_plant_does_afterwards():
    env = many("residual", 2, max_episode_steps=500)
    plain = WithinLimits(gym.make(SPATIAL_ID))
    env.reset(seed=0, options={"payload": [30.0, 0.0]})
    law, state, observation = env.steering.law, None, plain.reset(options={"payload": 30.0})[0]
    terminated = truncated = False
    while not (terminated or truncated):
        command, state = law.predict(observation, state)
        observation, _, terminated, truncated, last = plain.step(command)
    for _ in range(round(last["time"] * 500) // env.steering.periods + 1):
        _, _, ended, _, info = env.step(np.zeros((2, 6)))
    assert ended.tolist() == [True, False]
    check_same_lane(info["final_info"], 0, last | {"payload": 30.0})
    np.testing.assert_array_equal(info["final_obs"][0][:6], observation[:6].astype(np.float32))
    assert last["time"] * 500 % env.steering.periods != 0
    assert info["time"][0] == 0  # of the next episode


def test_lanes_are_not_disturbed_by_one_that_has_ended():
    env, twin = (many("shift", 4) for _ in range(2))
    payloads = np.array([0.3, 0.6, 8.0, 0.9])
    env.reset(seed=1, options={"payload": payloads})
    twin.reset(seed=1, options={"payload": np.where(payloads > 1, 0.1, payloads)})
    ended, others = 0, [0, 1, 3]
    for action in actions_of(env, 40, scale=0.2):
        one, other = env.step(action), twin.step(action)
        ended += one[2][2]
        for mine, its in zip(one[:4], other[:4], strict=True):
            np.testing.assert_array_equal(mine[others], its[others])
        for key, value in other[4].items():
            if not key.startswith(("_", "final")):
                np.testing.assert_array_equal(one[4][key][others], value[others], err_msg=key)
    assert ended > 0


def test_a_law_is_not_asked_about_a_plant_that_has_ended(monkeypatch):
    """It may be anywhere by then, where a law that inverts a matrix raises, for all lanes."""
    env = make_steered_vec(
        SPATIAL_ID,
        2,
        wrappers=[(WithinLimits, {}), (Steered, {"base": "fl", "steering": "residual", "features": ("error",)})],
        error_bounds={"position": 1e-4},
    )
    respond, largest = env.steering.law.respond, []

    def watched(blocks, *others):
        largest.append(np.abs(blocks["pose"] - blocks["reference_pose"])[:, :3].max())
        return respond(blocks, *others)

    monkeypatch.setattr(env.steering.law, "respond", watched)
    env.reset(options={"payload": [25.0, 0.0]})
    ended = env.step(np.zeros((2, 6)))[2]
    assert ended.tolist() == [True, False]
    assert len(largest) == 10
    assert max(largest[1:]) < 5e-4  # it falls by 2 mm


def test_all_arguments_are_plain_data_and_recorded_in_the_spec():
    env = single("shift")
    recorded = [wrapper.kwargs for wrapper in env.spec.additional_wrappers]
    assert json.loads(json.dumps(recorded))[-1]["base"] == {"law": "fl", "estimates_payload": True}
    assert [made.vector for made, _ in stack("shift")] == [WithinLimitsVector, PayloadCurriculumVector, SteeredVector]
    assert isinstance(gym.make(env.spec), Steered)


# --------------------------------------------------------------------------------------------------- with SB3


def test_sb3_trains_on_it_and_reads_how_episodes_ended():
    env = CableBotVecEnv(many("shift", 4, seed=0, max_episode_steps=LIMIT))
    env.reset()
    successes, failures = 0, 0
    for action in actions_of(env, 12, seed=4)[:, None].repeat(4, axis=1):
        observation, _, dones, infos = env.step(action)
        for lane in np.flatnonzero(dones):
            info = infos[lane]
            assert info["terminal_observation"].shape == observation[lane].shape
            assert info["TimeLimit.truncated"] is info["is_success"] is (info["termination_reason"] == "")
            successes, failures = successes + info["is_success"], failures + (not info["is_success"])
    assert successes > 0
    assert failures > 0
    assert env.get_attr("ceiling") == [4.0] * 4
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(32)
    assert model.num_timesteps == 32


# ---------------------------------------------------------------------------------------------- payload curriculum


def test_the_twin_draws_the_payloads_of_single_environments_seeded_upwards():
    env = PayloadCurriculumVector(gym.make_vec(PLANAR_ID, num_envs=3, autoreset_mode=DISABLED), heaviest=2.0, power=0.5)
    singles = [PayloadCurriculum(gym.make(PLANAR_ID), heaviest=2.0, power=0.5) for _ in range(3)]
    first = env.reset(seed=5)[1]["payload"]
    assert [one.reset(seed=5 + lane)[1]["payload"] for lane, one in enumerate(singles)] == first.tolist()
    masked = env.reset(options={"reset_mask": np.array([True, False, True])})[1]["payload"]
    assert masked.tolist() == [singles[0].reset()[1]["payload"], first[1], singles[2].reset()[1]["payload"]]
    second = env.reset()[1]["payload"]
    assert second.tolist() == [one.reset()[1]["payload"] for one in singles]
    assert len({*first, *masked, *second}) == 8  # one lane went on once
    np.testing.assert_array_equal(env.reset(seed=[9, 5, None])[1]["payload"][1], first[0])


def test_payloads_follow_the_power_and_are_the_environments_own_draws_for_power_one():
    env = PayloadCurriculum(gym.make(PLANAR_ID), heaviest=3.0, power=1.0)
    plain, heavy = gym.make(PLANAR_ID, payload_range=(0.0, 3.0)), PayloadCurriculum(gym.make(PLANAR_ID), heaviest=3.0)
    draws = np.array([[one.reset(seed=seed)[1]["payload"] for one in (env, plain, heavy)] for seed in range(50)])
    np.testing.assert_array_equal(draws[:, 0], draws[:, 1])
    np.testing.assert_allclose(draws[:, 2], 3.0 * (draws[:, 0] / 3.0) ** 0.6, rtol=1e-12)


def test_a_payload_of_the_callers_counts_instead_and_the_draws_go_on():
    env, twin = (PayloadCurriculum(gym.make(PLANAR_ID), heaviest=2.0) for _ in range(2))
    assert env.reset(seed=0, options={"payload": 0.25})[1]["payload"] == 0.25
    twin.reset(seed=0)
    for seed in (-1, 1.5):
        with pytest.raises(ValueError, match="seed"):
            env.reset(seed=seed)
    with pytest.raises(ValueError, match="paylaod"):
        env.reset(options={"paylaod": 1.0})
    assert env.reset()[1]["payload"] == twin.reset()[1]["payload"]


def test_a_refused_reset_of_the_twin_takes_no_draw():
    env, twin = (
        PayloadCurriculumVector(gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=DISABLED), heaviest=2.0)
        for _ in range(2)
    )
    for bad in ({"seed": [1]}, {"seed": "text"}, {"options": {"reset_mask": np.array([True])}}):
        with pytest.raises((ValueError, ResetNeeded)):
            env.reset(**bad)
    for one in (env, twin):
        one.reset(seed=4)
    for bad in ({"seed": [1]}, {"seed": -1}, {"options": {"reset_mask": np.array([1, 0])}}, {"options": {"a": 1}}):
        with pytest.raises(ValueError, match=r"seed|reset_mask|unknown option"):
            env.reset(**bad)
    np.testing.assert_array_equal(env.reset()[1]["payload"], twin.reset()[1]["payload"])


class Ended(gym.Wrapper[Any, Any, Any, Any]):
    """Ends each episode after one step, as it is told."""

    carried = True

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, not self.carried, self.carried, info


def test_the_ceiling_rises_after_enough_heavy_payloads_were_carried_and_by_no_other():
    ended = Ended(gym.make(PLANAR_ID))
    env = PayloadCurriculum(ended, heaviest=2.0, start=1.0, step=0.25, success=0.75, window=4)
    env.reset(seed=0)

    def play(carried, heavy, *, given=False):
        """One episode, of a payload in the ceiling's upper third or below."""
        ended.carried = carried
        payload = env.reset(options={"payload": env.ceiling} if given else None)[1]["payload"]
        while not given and (payload >= 2 / 3 * env.ceiling) is not heavy:
            payload = env.reset()[1]["payload"]  # abandoned, which counts for nothing
        env.step(np.full(3, 0.2))
        env.step(np.full(3, 0.2))  # past its end, which counts once

    for _ in range(8):
        play(True, False)
        play(True, True, given=True)
    assert env.ceiling == 1.0  # light ones and the caller's say nothing
    for carried in (True, True, False, False, True, True):
        play(carried, True)
        assert env.ceiling == 1.0  # too few, then half of four
    play(True, True)
    assert env.ceiling == 1.5  # three of the last four
    for _ in range(3):
        play(True, True)
        assert env.ceiling == 1.5  # a window of its own
    play(True, True)
    assert env.ceiling == 2.0
    for _ in range(8):
        play(True, True)
    assert env.ceiling == 2.0  # never above the heaviest


def test_the_ceiling_falls_where_too_few_heavy_payloads_are_carried_and_never_below_its_start():
    ended = Ended(gym.make(PLANAR_ID))
    env = PayloadCurriculum(ended, heaviest=2.0, start=1.5, step=0.25, success=0.75, window=4, setback=0.5, power=0.01)
    env.reset(seed=0)

    def play(carried):
        """Four episodes, all heavy at this power, of which so many are carried."""
        for episode in range(4):
            ended.carried = episode < carried
            env.reset()
            env.step(np.full(3, 0.2))
        return env.ceiling

    assert play(4) == 2.0
    assert play(2) == 2.0  # neither enough to rise nor too few
    assert play(1) == 1.5
    assert play(0) == 1.5
    with pytest.raises(ValueError, match="setback"):
        PayloadCurriculum(env.env, heaviest=2.0, success=0.5, setback=0.6)


def test_lanes_share_a_ceiling_that_does_not_rise_where_payloads_are_dropped():
    """What the twin counts is what WithinLimits says, and once only for a lane that is stepped past its end."""

    def run(error_bounds):
        curriculum = {"heaviest": 2.0, "start": 0.4, "step": 0.02, "window": 8, "power": 0.01}
        env = make_steered_vec(
            PLANAR_ID,
            16,
            wrappers=[(WithinLimits, {}), (PayloadCurriculum, curriculum), (Steered, CASES["shift"]["steered"])],
            seed=0,
            max_episode_steps=45,
            error_bounds=error_bounds,
        )
        ends = 0
        for _ in range(10):
            _, _, terminated, truncated, _ = env.step(np.zeros((16, 2)))
            ends += (terminated | truncated).sum()
        assert ends >= 32
        return env.env.ceiling

    assert run({"position": 1e-6}) == 0.4
    assert run({"position": 0.01}) == pytest.approx(0.4 + 4 * 0.04)  # 32 ends in windows of 8


# ---------------------------------------------------------------------------------------------------- within limits


def test_an_episode_ends_where_the_evaluator_says_that_the_payload_fails():
    found = evaluate_dlcc("fl", SPATIAL_ID, resolution=0.01, payload_max=5.0)
    heavier = found.payload + found.resolution
    env = WithinLimits(gym.make(SPATIAL_ID))
    law = FeedbackLinearization(SPATIAL)
    for payload in (found.payload, heavier):
        observation, info = env.reset(seed=0, options={"payload": payload})
        assert info["is_success"] is False
        terminated = truncated = False
        while not (terminated or truncated):
            assert info["is_success"] is False
            observation, _, terminated, truncated, info = env.step(law.predict(observation)[0])
        assert terminated is (payload == heavier)
        assert info["is_success"] is (not terminated)
        assert info["termination_reason"] == ("rotation_error" if terminated else "")
    assert found.violation.kind == "rotation"
    assert info["time"] == found.violation.time


@pytest.mark.parametrize("env_id", [PLANAR_ID, SPATIAL_ID])
def test_every_kind_of_failure_is_the_judges_at_the_same_instant(env_id):
    """Lanes of all payloads under a law, and lanes whose cables are let go."""
    robot, count, steps = (PLANAR, 24, 300) if env_id == PLANAR_ID else (SPATIAL, 24, 300)
    heaviest = 6.0 if robot.planar else 16.0
    keywords = {
        "num_envs": count,
        "autoreset_mode": DISABLED,
        "max_episode_steps": steps,
        "error_bounds": {"rotation": 0.02},
    }
    plain, env = gym.make_vec(env_id, **keywords), WithinLimitsVector(gym.make_vec(env_id, **keywords))
    law, judge = FeedbackLinearization(robot), Judge("task", ErrorBounds(rotation=0.02), robot.cables, count)
    options = {"payload": np.linspace(0.0, heaviest, count)}
    observation, info = plain.reset(seed=0, options=options)
    judge.reset(info)
    _, info = env.reset(seed=0, options=options)
    assert not info["is_success"].any()
    first: dict[int, tuple[str, float]] = {}
    for step in range(steps):
        command = law.predict(observation)[0]
        command[::5] = -0.1 if step > 30 else command[::5]
        observation, _, failed, _, plain_info = plain.step(command, past_end=True)
        judge.observe(plain_info, failed)
        _, reward, terminated, truncated, info = env.step(command, past_end=True)
        saturated = np.maximum(np.abs(info["commanded_action"]) - 0.97, 0).mean(axis=1)
        np.testing.assert_allclose(reward, 0.02 - terminated - 0.02 * saturated, atol=1e-15)
        for lane in np.flatnonzero(terminated):
            first.setdefault(int(lane), (str(info["termination_reason"][lane]), info["time"][lane]))
    error_bounds = {lane: judge.verdict(lane, complete=True).violation for lane in range(count)}
    kinds = {"position": "tracking_error", "rotation": "rotation_error", "slack": "slack"}
    assert first == {
        lane: (kinds[violation.kind], violation.time) for lane, violation in error_bounds.items() if violation
    }
    assert {reason for reason, _ in first.values()} >= {"slack", "tracking_error"} | (
        set() if robot.planar else {"rotation_error"}
    )
    assert len(first) < count
    assert truncated.all()
    assert all(info["is_success"][lane] for lane in range(count) if lane not in first)


@pytest.mark.parametrize(("name", "bound"), [("tracking_error", "position"), ("rotation_error", "rotation")])
def test_an_error_between_two_control_instants_counts(name, bound):
    law, keywords = FeedbackLinearization(SPATIAL), {"control_frequency": 50.0, "trajectory": "dwell-spatial"}
    push = np.array([0.1, 0.02, 0.1, 0.0, 0.1, 0.0])  # once; it comes back

    def run(error_bounds):
        env = WithinLimits(
            gym.make(SPATIAL_ID, error_bounds={"position": 9.0, "rotation": 9.0} | error_bounds, **keywords)
        )
        observation, _ = env.reset()
        infos, terminated = [], False
        while len(infos) < 60 and not terminated:
            observation, _, terminated, _, info = env.step(law.predict(observation)[0] + push * (not infos))
            infos.append(info)
        return infos

    infos = run({})
    largest, at_instants = (max(info[key] for info in infos) for key in (f"{name}_peak", name))
    assert largest > at_instants + 1e-6
    assert run({bound: (largest + at_instants) / 2})[-1]["termination_reason"] == name


def test_what_happens_after_the_motion_is_not_judged_as_the_monitor_does_not():
    short = {"name": "dwell-planar", "duration": 0.1}
    env = WithinLimits(DLCCMonitor(gym.make(PLANAR_ID, trajectory=short, slack_time=9.0, termination_radius=9.0)))
    twin = WithinLimitsVector(
        gym.make_vec(PLANAR_ID, num_envs=1, autoreset_mode=DISABLED, slack_time=9.0, termination_radius=9.0)
    )
    law = FeedbackLinearization(PLANAR)
    observation, _ = env.reset(seed=0)
    twin.reset(seed=0, options={"trajectory": short})
    for step in range(80):
        command = law.predict(observation)[0] if step < 50 else np.full(3, -0.5)
        observation, _, terminated, _, info = env.step(command)
        its = twin.step(command[None])
        assert not terminated
        assert not its[2].any()
    assert info["slack"].all()
    assert its[4]["slack"].all()
    assert info["dlcc_carried"]


def test_limits_given_as_an_option_hold_for_the_episode():
    env = WithinLimits(gym.make(PLANAR_ID))
    twin = WithinLimitsVector(gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=DISABLED))
    tight = {"error_bounds": {"position": 1e-9}}
    env.reset(seed=0, options=tight)
    assert env.step(np.full(3, 0.2))[4]["termination_reason"] == "tracking_error"
    env.reset()
    assert not env.step(np.full(3, 0.2))[2]
    twin.reset(seed=0)
    twin.reset(options=tight | {"reset_mask": np.array([False, True])})
    assert twin.step(np.full((2, 3), 0.2))[2].tolist() == [False, True]


def test_the_environments_own_end_is_an_end_and_keeps_its_name():
    env = WithinLimits(gym.make(PLANAR_ID, termination_radius=9.0, slack_time=9.0, error_bounds={"position": 9.0}))
    env.reset(options={"initial_error": [0.3, 0.0]})
    steps = [env.step([0.9, 0.1, 0.1]) for _ in range(300)]
    ends = [(info["termination_reason"], reward) for _, reward, terminated, _, info in steps if terminated]
    assert ends[0] == ("workspace", pytest.approx(-0.98))


def test_an_ended_lane_of_the_twin_wants_a_reset_and_another_keeps_its_own_end():
    env = WithinLimitsVector(gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=DISABLED))
    env.reset(seed=0)
    loose = np.full((2, 3), -0.5)
    _, _, terminated, _, info = env.step(loose)
    assert terminated.all()
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.step(loose)
    _, info = env.reset(options={"reset_mask": np.array([True, False])})
    assert info["termination_reason"].tolist() == ["", "slack"]
    with pytest.raises(ResetNeeded, match="reset_mask"):
        env.step(loose)


# ------------------------------------------------------------------------------------------------------- steered law


class Rounding(Network):
    """Reads its inputs in single precision, as a learner does."""

    def __call__(self, values):
        return super().__call__(np.asarray(values, np.float32).astype(float))


@pytest.mark.parametrize("case", ["shift", "preview", "residual"])
def test_a_policy_does_on_the_plain_environment_what_its_network_did_in_training(case):
    """To the last bit, with a network that reads what the learner reads, in single precision."""
    env = single(case)
    chosen, rng = CASES[case], np.random.default_rng(0)
    size, outputs = env.observation_space.shape[0], env.action_space.shape[0]
    network = Rounding(
        mean=np.zeros(size),
        scale=np.ones(size),
        weights=(rng.normal(0, 0.1, (8, size)), rng.normal(0, 0.2, (outputs, 8))),
        biases=(np.zeros(8), rng.normal(0, 0.05, outputs)),
    )
    steered = chosen["steered"]
    bundle = Bundle(
        env_id=chosen["env_id"],
        base=find_base(steered["base"]),
        action_mapping=find_action_mapping(steered["steering"]),
        features=tuple(steered["features"]),
        network=network,
    )
    plain = gym.make(chosen["env_id"])
    policy = LearnedPolicy(bundle, plain.unwrapped.settings.robot)
    options = {"payload": 0.4}
    seen, _ = env.reset(seed=0, options=options)
    observation, _ = plain.reset(seed=0, options=options)
    policy.reset([plain.unwrapped.task])
    state, holds = None, 0
    for _ in range(8):
        seen, _, terminated, truncated, info = env.step(network(seen))
        plain_info = {"time": 0.0}
        while plain_info["time"] < info["time"]:
            command, state = policy.predict(observation, state)
            observation, _, _, _, plain_info = plain.step(command)
        np.testing.assert_array_equal(env.unwrapped.pose, plain.unwrapped.pose)
        for name in ("commanded_action", "tensions", "time"):
            np.testing.assert_array_equal(info[name], plain_info[name], err_msg=name)
        if terminated or truncated:
            break
        holds += 1
    assert holds >= 6


@pytest.mark.parametrize("preview", [0.0, 0.05])
def test_the_shift_that_is_seen_is_the_one_that_the_law_gets_then(preview):
    steering = Steering(
        PLANAR,
        base=find_base("fl"),
        action_mapping=Shift(action_period=0.02, preview=preview),
        features=("shift", "shift_velocity", "error"),
    )
    env = gym.make(PLANAR_ID)
    blocks = steering.split(env.reset()[0])
    given: dict[str, Any] = {}

    def law(moved, *others):
        given.update(moved)
        return type(steering.law).respond(steering.law, moved, *others)

    steering.law.respond = law
    memory, differences = steering.reset_memory(blocks, None, None), []
    for step in range(60):
        seen = steering.observe(blocks, memory)
        action = actions_of(env, 6)[step // 10, :2]
        command, memory = steering.respond(blocks, action, memory)
        for order, bounds in (("pose", 0.0095), ("velocity", 0.0095 / 0.02)):
            shift = given[f"reference_{order}"] - blocks[f"reference_{order}"]
            differences.append(shift / bounds - seen[:2] if order == "pose" else shift / bounds - seen[2:4])
        differences.append(given["reference_pose"] - blocks["pose"] - seen[4:])
        blocks = steering.split(env.step(command)[0])
    assert np.abs(differences).max() < 1e-9


@pytest.mark.parametrize("made", ["single", "twin"])
def test_the_hold_and_the_tube_are_those_of_the_environments_frequency_and_limits(made):
    keywords = {"control_frequency": 100.0, "error_bounds": {"position": 0.02}, "trajectory": "dwell-planar"}
    steered = CASES["shift"]["steered"]
    if made == "single":
        env = Steered(gym.make(PLANAR_ID, **keywords), **steered)
    else:
        env = make_steered_vec(PLANAR_ID, 1, wrappers=[(Steered, steered)], **keywords)
    env.reset(seed=0)
    start, action = np.copy(env.unwrapped.pose), np.broadcast_to([1.0, 0.0], env.action_space.shape)
    assert env.step(action)[4]["time"] == 0.02
    for _ in range(200):
        env.step(action)
    np.testing.assert_allclose((env.unwrapped.pose - start).ravel(), [0.5 * 0.02, 0.0], atol=5e-4)


def test_a_step_before_a_reset_and_after_an_end_says_what_to_do():
    env, batch = single("shift", max_episode_steps=5), many("shift", 2)
    for one, action in ((env, np.zeros(2)), (batch, np.zeros((2, 2)))):
        one.unwrapped.reset(seed=0)
        with pytest.raises(ResetNeeded, match=r"reset\(\)"):
            one.step(action)
    env.reset()
    assert env.step(np.zeros(2))[3]
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros(2))
    batch.reset()
    with pytest.raises(ValueError, match=r"error_bounds.*when the environments are made"):
        batch.reset(options={"error_bounds": {"position": 0.02}})


BAD_ACTIONS = {
    "too short": (np.zeros(1), "shape"),
    "too many": (np.zeros((3, 2)), "shape"),
    "NaN": (np.array([0.0, np.nan]), "finite"),
    "infinite": (np.array([0.0, np.inf]), "finite"),
    "text": (["a", "b"], "numbers"),
}


@pytest.mark.parametrize("name", list(BAD_ACTIONS))
def test_a_bad_action_is_refused_in_words_and_changes_nothing(name):
    action, words = BAD_ACTIONS[name]
    env, twin = single("shift"), single("shift")
    batch, other = many("shift", 1), many("shift", 1)
    for one in (env, twin, batch, other):
        one.reset(seed=0)
    with pytest.raises(ValueError, match=words):
        env.step(action)
    with pytest.raises(ValueError, match=words):
        batch.step(np.array([action]) if np.ndim(action) == 1 and words != "numbers" else action)
    good = np.array([0.5, -0.5])
    np.testing.assert_array_equal(env.step(good)[0], twin.step(good)[0])
    np.testing.assert_array_equal(batch.step(good[None])[0], other.step(good[None])[0])


# ------------------------------------------------------------------------------------------------- making, bad input

STEERED = {"base": "fl", "steering": "shift", "features": ["error"]}

BAD_STACKS: dict[str, tuple[Any, str]] = {
    "nothing": ([], "must be Steered, but wrappers is empty"),
    "Steered within": (
        [(Steered, STEERED), (WithinLimits, {})],
        "must be Steered, but wrappers is Steered, WithinLimits",
    ),
    "steered twice": (
        [(Steered, STEERED), (Steered, STEERED)],
        r"order is WithinLimits \(innermost\), PayloadCurriculum, Steered",
    ),
    "limits around the curriculum": (
        [(PayloadCurriculum, {"heaviest": 1.0}), (WithinLimits, {}), (Steered, STEERED)],
        "counts the episodes that it ends. The order is WithinLimits",
    ),
    "unknown argument": (
        [(Steered, STEERED | {"action_period": 1})],
        "Steered has no argument 'action_period'; it takes base, steering",
    ),
    "missing argument": ([(PayloadCurriculum, {}), (Steered, STEERED)], "PayloadCurriculum requires heaviest"),
    "no twin": (
        [(DLCCMonitor, {}), (Steered, STEERED)],
        "DLCCMonitor has no vector form.*WithinLimits, PayloadCurriculum",
    ),
    "negative reward": ([(WithinLimits, {"alive": -1.0}), (Steered, STEERED)], "alive must be a number of at least 0"),
    "endless failure": ([(WithinLimits, {"failure": np.inf}), (Steered, STEERED)], "failure must be a number"),
    "unknown law": ([(Steered, STEERED | {"base": "lqr"})], "unknown base law 'lqr'.*fl, composite"),
    "law for springs": ([(Steered, STEERED | {"base": "composite"})], "spring"),
    "unknown steering": ([(Steered, STEERED | {"steering": "wheel"})], "unknown kind 'wheel'.*shift, residual"),
    "unknown feature": ([(Steered, STEERED | {"features": ["mass"]})], "unknown feature 'mass'.*pose"),
    "a feature of the other way": (
        [(Steered, STEERED | {"steering": "residual", "features": ["shift"]})],
        "shift",
    ),
}


@pytest.mark.parametrize("name", list(BAD_STACKS))
def test_a_bad_stack_is_refused_in_words(name):
    wrappers, words = BAD_STACKS[name]
    with pytest.raises(ValueError, match=words):
        make_steered_vec(PLANAR_ID, 2, wrappers=wrappers)


BAD_RULES: dict[str, tuple[dict[str, Any], str]] = {
    "no payload": ({"heaviest": 0.0}, "heaviest must be a number greater than 0, not 0.0"),
    "text": ({"heaviest": "4"}, "heaviest must be a number.*'4'"),
    "no power": ({"heaviest": 1.0, "power": 0.0}, "power must be a number greater than 0"),
    "start too heavy": ({"heaviest": 1.0, "start": 2.0}, "start must be a number of at least 0 and at most 1"),
    "step too large": ({"heaviest": 1.0, "step": 2.0}, "step must be a number greater than 0 and at most 1"),
    "success too large": ({"heaviest": 1.0, "success": 1.1}, "success must be a number of at least 0 and at most 1"),
    "half an episode": ({"heaviest": 1.0, "window": 0.5}, "window must be a whole number"),
}


@pytest.mark.parametrize("name", list(BAD_RULES))
def test_a_bad_rule_is_refused_in_words(name):
    arguments, words = BAD_RULES[name]
    with pytest.raises(ValueError, match=words):
        PayloadCurriculum(gym.make(PLANAR_ID), **arguments)
    with pytest.raises(ValueError, match=words):
        PayloadCurriculumVector(gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=DISABLED), **arguments)


def test_foreign_environments_and_those_that_restart_on_their_own_are_refused():
    with pytest.raises(TypeError, match=r"gym\.make"):
        WithinLimits(gym.make("CartPole-v1"))
    with pytest.raises(TypeError, match=r"gym\.make_vec"):
        SteeredVector(gym.make(PLANAR_ID), **STEERED)
    with pytest.raises(TypeError, match=r"gym\.make_vec"):
        WithinLimitsVector(gym.make_vec("CartPole-v1", num_envs=2))
    for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
        with pytest.raises(ValueError, match=f"not {mode.name}.*DISABLED"):
            WithinLimitsVector(gym.make_vec(PLANAR_ID, num_envs=2, autoreset_mode=mode))
    with pytest.raises(ValueError, match="order is"):
        PayloadCurriculum(single("shift"), heaviest=1.0)


def test_a_seed_repeats_a_batch_and_keywords_reach_the_environment():
    def run(seed):
        env = many("residual", 3, seed=seed, payload_known=False)
        found = [env.action_space.sample(), env.reset()[1]["payload"]]
        for action in actions_of(env, 3):
            found += env.step(action)[:2]
        assert not env.unwrapped.tasks[0].payload_known
        return found

    first, again, other = run(3), run(3), run(4)
    assert all(np.array_equal(one, two) for one, two in zip(first, again, strict=True))
    assert not any(np.array_equal(one, two) for one, two in zip(first[:2], other[:2], strict=True))
    with pytest.raises(ValueError, match="unknown keyword 'paylaod'"):
        many("shift", 2, paylaod=1.0)


def test_twins_exist_for_every_id():
    for env_id in cablebot_gym.ENV_IDS:
        base = "composite" if "Flex" in env_id else "fl"
        steered = {"base": base, "steering": "shift", "features": REFERENCE_FEATURES}
        env = make_steered_vec(env_id, 2, wrappers=[(Steered, steered)], seed=0)
        observation, *_ = env.step(np.zeros(env.action_space.shape))
        assert env.observation_space.contains(observation)


def test_a_law_that_would_weigh_the_residual_for_payload_is_refused():
    with pytest.raises(ValueError, match="bias the payload estimate"):
        Steered(gym.make(SPATIAL_ID), base={"law": "fl", "estimates_payload": True}, steering="residual", features=SEEN)


def test_effort_costs_the_mean_square_of_what_counts_of_an_action_in_both_twins():
    arguments = CASES["shift"]["steered"]
    action = np.array([0.5, 7.0])  # cut to 1
    rewards = []
    for effort in (0.0, 0.4):
        one = Steered(gym.make(PLANAR_ID), **arguments, effort=effort)
        two = make_steered_vec(PLANAR_ID, 2, wrappers=[(Steered, {**arguments, "effort": effort})], seed=3)
        one.reset(seed=3)
        two.reset(seed=3)
        rewards.append((one.step(action)[1], two.step(np.stack([action, 0 * action]))[1]))
    (single, batch), (dear, dear_batch) = rewards
    assert single - dear == pytest.approx(0.4 * 0.625)
    assert batch - dear_batch == pytest.approx([0.4 * 0.625, 0.0])
    with pytest.raises(ValueError, match="effort must be a number of at least 0"):
        Steered(gym.make(PLANAR_ID), **arguments, effort=-1.0)
