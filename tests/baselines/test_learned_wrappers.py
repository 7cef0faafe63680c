"""Wrappers for training: limits, payload curriculum and steered law, single and in batches."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor
from cablebot_gym.robots import PLANAR, SPATIAL

pytest.importorskip("stable_baselines3")
from stable_baselines3 import PPO
from stable_baselines3.common import env_checker
from stable_baselines3.common.monitor import Monitor

from cablebot_baselines.learned.base import find_base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.steering import find_action_mapping
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

PLANAR_ID, SPATIAL_ID, FLEX_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"

OBSERVED = (
    *("pose", "velocity", "error", "actions", "time_since_start", "rbf_time", "time_to_go_decays", "model_payload"),
)
SHIFTED = (*OBSERVED, "shift", "shift_velocity")

# Under random actions some episodes fail, others last until a time limit that falls within an action.
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
        "steered": {"base": "fl", "steering": "residual", "features": OBSERVED},
    },
}
LIMIT = 56

each_case = pytest.mark.parametrize("case", list(CASES))


def wrappers_of(case):
    """Classes and arguments of the three wrappers."""
    chosen = CASES[case]
    return [(WithinLimits, {}), (PayloadCurriculum, {"heaviest": chosen["heaviest"]}), (Steered, chosen["steered"])]


def single(case, **keywords):
    env = gym.make(CASES[case]["env_id"], **keywords)
    for wrapper, arguments in wrappers_of(case):
        env = wrapper(env, **arguments)
    return env


def batch(case, count, **keywords) -> Any:
    return make_steered_vec(CASES[case]["env_id"], count, wrappers=wrappers_of(case), **keywords)


def plain_batch(count, env_id=PLANAR_ID, **keywords) -> Any:
    return gym.make_vec(env_id, num_envs=count, autoreset_mode=AutoresetMode.DISABLED, **keywords)


def random_actions(env, steps, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)


def check_same_info(batch_info, env_index, info):
    """The row of a batch's info equals the single environment's, whose scalars are Python objects."""
    assert batch_info.keys() == info.keys()
    for key, value in info.items():
        assert isinstance(value, (float, bool, str, np.ndarray))
        np.testing.assert_array_equal(batch_info[key][env_index], value, err_msg=key)


# --- single and vector forms ------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*imum value is -?infinity:UserWarning")
def test_single_form_passes_the_checkers_of_gymnasium_and_sb3():
    env = single("shift")
    check_env(env)
    env_checker.check_env(env, warn=True)
    assert env.observation_space.dtype == env.action_space.dtype == np.float32


@each_case
def test_each_row_of_a_batch_equals_the_single_environment_bit_for_bit(case):
    """Over several episodes, with masked resets and ends within an action."""
    count, seed, limit = 5, 3, {"max_episode_steps": LIMIT}
    env, singles = batch(case, count, **limit), [single(case, **limit) for _ in range(count)]
    assert env.single_observation_space == singles[0].observation_space
    assert env.single_action_space == singles[0].action_space
    observation, info = env.reset(seed=seed)
    for env_index, one in enumerate(singles):
        own, own_info = one.reset(seed=seed + env_index)
        np.testing.assert_array_equal(observation[env_index], own)
        check_same_info(info, env_index, own_info)
    ends = []
    for action in random_actions(env, 30):
        observation, reward, terminated, truncated, info = env.step(action)
        ended = terminated | truncated
        for env_index, one in enumerate(singles):
            own, own_reward, own_terminated, own_truncated, own_info = one.step(action[env_index])
            assert observation.dtype == own.dtype == np.float32
            assert (type(own_reward), type(own_terminated), type(own_truncated)) == (float, bool, bool)
            assert reward[env_index] == own_reward
            assert (terminated[env_index], truncated[env_index]) == (own_terminated, own_truncated)
            np.testing.assert_array_equal(observation[env_index], own)
            check_same_info(info, env_index, own_info)
            if ended[env_index]:
                periods = round(own_info["time"] / env.unwrapped.settings.period)
                ends.append((own_info["termination_reason"], periods % env.steering.periods))
        if ended.any():
            observation, info = env.reset(options={"reset_mask": ended})
            for env_index in np.flatnonzero(ended):
                own, own_info = singles[env_index].reset()
                np.testing.assert_array_equal(observation[env_index], own)
                check_same_info(info, env_index, own_info)
    assert len(ends) > 2 * count
    assert any(not reason and rest for reason, rest in ends)  # the time limit, within an action
    assert any(reason and rest for reason, rest in ends)  # a failure, within an action


def test_rewards_of_an_action_are_summed_up_to_the_end_of_the_episode():
    class Recorder(gym.Wrapper[Any, Any, Any, Any]):
        rewards: list[float]

        def step(self, action):
            result = super().step(action)
            self.rewards.append(result[1])
            return result

    recorder = Recorder(WithinLimits(gym.make(PLANAR_ID, payload=6.0)))
    env = Steered(recorder, **CASES["shift"]["steered"])
    env.reset(seed=0)
    terminated, lengths = False, []
    while not terminated:
        recorder.rewards = []
        _, reward, terminated, _, info = env.step(np.zeros(2))
        assert reward == sum(recorder.rewards)
        lengths.append(len(recorder.rewards))
    assert lengths[0] == env.steering.periods == 10
    assert lengths[-1] < 10
    assert info["time"] == pytest.approx(sum(lengths) / 500)


def test_result_of_an_ended_episode_is_its_last_control_period():
    """The plant of an ended environment moves on until the action of the others ends."""
    env = batch("residual", 2)
    plain = WithinLimits(gym.make(SPATIAL_ID))
    env.reset(seed=0, options={"payload": [30.0, 0.0]})
    law, observation = env.steering.law, plain.reset(options={"payload": 30.0})[0]
    ended = False
    while not ended:
        observation, _, ended, _, last = plain.step(law.predict(observation)[0])
    terminated = np.zeros(2, np.bool_)
    while not terminated.any():
        observed, _, terminated, _, info = env.step(np.zeros((2, 6)))
    assert terminated.tolist() == [True, False]
    check_same_info(info, 0, last)
    np.testing.assert_array_equal(observed[0][:6], observation[:6].astype(np.float32))
    assert round(last["time"] * 500) % env.steering.periods != 0


def test_law_is_not_evaluated_at_an_ended_plant(monkeypatch):
    """A law that inverts a matrix would raise there, for all environments."""
    steered = {"base": "fl", "steering": "residual", "features": ("error",)}
    env = make_steered_vec(
        SPATIAL_ID, 2, wrappers=[(WithinLimits, {}), (Steered, steered)], error_bounds={"position": 1e-4}
    )
    respond, largest = env.steering.law.respond, []

    def recorded(blocks, *others):
        largest.append(np.abs(blocks["pose"] - blocks["reference_pose"])[:, :3].max())
        return respond(blocks, *others)

    monkeypatch.setattr(env.steering.law, "respond", recorded)
    env.reset(options={"payload": [25.0, 0.0]})
    assert env.step(np.zeros((2, 6)))[2].tolist() == [True, False]
    assert len(largest) == 10
    assert max(largest[1:]) < 5e-4  # the ended platform falls by 2 mm


def test_arguments_are_json_data_in_the_spec():
    env = single("shift")
    recorded = [wrapper.kwargs for wrapper in env.spec.additional_wrappers]
    assert json.loads(json.dumps(recorded))[-1]["base"] == {"law": "fl", "estimates_payload": True}
    assert isinstance(gym.make(env.spec), Steered)


def test_info_of_other_wrappers_inside_passes_through():
    """RL-Zoo's make_vec_env puts Monitor inside the wrappers of its YAML files."""
    env = Steered(WithinLimits(Monitor(gym.make(PLANAR_ID, max_episode_steps=15))), **CASES["shift"]["steered"])
    env.reset(seed=0)
    assert not env.step(np.zeros(2))[3]
    *_, truncated, info = env.step(np.zeros(2))
    assert truncated
    assert info["episode"]["l"] == 15


def test_sb3_trains_on_the_batch_and_reads_the_ends_of_episodes():
    env = CableBotVecEnv(batch("shift", 4, seed=0, max_episode_steps=LIMIT))
    env.reset()
    successes = failures = 0
    for action in random_actions(env, 12, seed=4)[:, None].repeat(4, axis=1):
        observation, _, dones, infos = env.step(action)
        for env_index in np.flatnonzero(dones):
            info = infos[env_index]
            assert info["terminal_observation"].shape == observation[env_index].shape
            assert info["TimeLimit.truncated"] is info["is_success"] is (info["termination_reason"] == "")
            successes, failures = successes + info["is_success"], failures + (not info["is_success"])
    assert successes > 0
    assert failures > 0
    assert env.get_attr("ceiling") == [4.0] * 4
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=1, seed=0, device="cpu")
    assert model.learn(32).num_timesteps == 32


# --- payload curriculum -----------------------------------------------------------------------------------------------


def test_batch_draws_the_payloads_of_single_environments_with_increasing_seeds():
    env = PayloadCurriculumVector(plain_batch(3), heaviest=2.0, power=0.5)
    singles = [PayloadCurriculum(gym.make(PLANAR_ID), heaviest=2.0, power=0.5) for _ in range(3)]
    first = env.reset(seed=5)[1]["payload"]
    assert [one.reset(seed=5 + env_index)[1]["payload"] for env_index, one in enumerate(singles)] == first.tolist()
    masked = env.reset(options={"reset_mask": np.array([True, False, True])})[1]["payload"]
    assert masked.tolist() == [singles[0].reset()[1]["payload"], first[1], singles[2].reset()[1]["payload"]]
    second = env.reset()[1]["payload"]
    assert second.tolist() == [one.reset()[1]["payload"] for one in singles]
    assert len({*first, *masked, *second}) == 8
    np.testing.assert_array_equal(env.reset(seed=[9, 5, None])[1]["payload"][1], first[0])


def test_payloads_follow_the_power_law():
    """At power 1 they equal the environment's own uniform draws."""
    env = PayloadCurriculum(gym.make(PLANAR_ID), heaviest=3.0, power=1.0)
    plain, heavy = gym.make(PLANAR_ID, payload_range=(0.0, 3.0)), PayloadCurriculum(gym.make(PLANAR_ID), heaviest=3.0)
    draws = np.array([[one.reset(seed=seed)[1]["payload"] for one in (env, plain, heavy)] for seed in range(20)])
    np.testing.assert_array_equal(draws[:, 0], draws[:, 1])
    np.testing.assert_allclose(draws[:, 2], 3.0 * (draws[:, 0] / 3.0) ** 0.6, rtol=1e-12)


def test_given_payload_and_rejected_resets_leave_the_draws_unchanged():
    env, twin = (PayloadCurriculum(gym.make(PLANAR_ID), heaviest=2.0) for _ in range(2))
    assert env.reset(seed=0, options={"payload": 0.25})[1]["payload"] == 0.25
    twin.reset(seed=0)
    for bad in ({"seed": -1}, {"seed": 1.5}, {"options": {"paylaod": 1.0}}):
        with pytest.raises(ValueError, match=r"seed|paylaod"):
            env.reset(**bad)
    assert env.reset()[1]["payload"] == twin.reset()[1]["payload"]
    several = PayloadCurriculumVector(plain_batch(2), heaviest=2.0)
    first = several.reset(seed=4)[1]["payload"]
    for bad in ({"seed": [1]}, {"seed": "text"}, {"options": {"reset_mask": np.array([1, 0])}}):
        with pytest.raises(ValueError, match=r"seed|reset_mask"):
            several.reset(**bad)
    np.testing.assert_array_equal(several.reset(seed=4)[1]["payload"], first)


class Ended(gym.Wrapper[Any, Any, Any, Any]):
    """Ends each episode after one step."""

    succeeds = True

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, not self.succeeds, self.succeeds, info


def test_ceiling_rises_after_enough_successes_with_heavy_payloads():
    """Light payloads, given payloads, abandoned episodes and steps after the end do not count."""
    ended = Ended(gym.make(PLANAR_ID))
    env = PayloadCurriculum(ended, heaviest=2.0, start=1.0, step=0.25, success=0.75, window=4)
    env.reset(seed=0)

    def play(succeeds, heavy, *, given=False):
        ended.succeeds = succeeds
        payload = env.reset(options={"payload": env.ceiling} if given else None)[1]["payload"]
        while not given and (payload >= 2 / 3 * env.ceiling) is not heavy:
            payload = env.reset()[1]["payload"]
        env.step(np.full(3, 0.2))
        env.step(np.full(3, 0.2))
        return env.ceiling

    for _ in range(8):
        assert play(True, False) == play(True, True, given=True) == 1.0
    assert [play(succeeds, True) for succeeds in (True, True, False, False, True, True)] == [1.0] * 6
    assert play(True, True) == 1.5  # three of the last four
    assert [play(True, True) for _ in range(4)] == [1.5, 1.5, 1.5, 2.0]
    assert [play(True, True) for _ in range(8)] == [2.0] * 8


def test_ceiling_falls_after_too_few_successes_but_not_below_its_start():
    ended = Ended(gym.make(PLANAR_ID))
    env = PayloadCurriculum(ended, heaviest=2.0, start=1.5, step=0.25, success=0.75, window=4, setback=0.5, power=0.01)
    env.reset(seed=0)

    def play(successes):
        for episode in range(4):
            ended.succeeds = episode < successes
            env.reset()
            env.step(np.full(3, 0.2))
        return env.ceiling

    assert [play(successes) for successes in (4, 2, 1, 0)] == [2.0, 2.0, 1.5, 1.5]


@pytest.mark.parametrize(("bound", "ceiling"), [(1e-6, 0.4), (0.01, 0.4 + 4 * 0.04)])
def test_environments_share_a_ceiling_that_depends_on_the_limits(bound, ceiling):
    curriculum = {"heaviest": 2.0, "start": 0.4, "step": 0.02, "window": 8, "power": 0.01}
    wrappers = [(WithinLimits, {}), (PayloadCurriculum, curriculum), (Steered, CASES["shift"]["steered"])]
    keywords = {"max_episode_steps": 45, "error_bounds": {"position": bound}}
    env = make_steered_vec(PLANAR_ID, 16, wrappers=wrappers, seed=0, **keywords)
    for _ in range(10):
        _, _, terminated, truncated, _ = env.step(np.zeros((16, 2)))
        if (terminated | truncated).any():
            env.reset(options={"reset_mask": terminated | truncated})
    assert env.env.ceiling == pytest.approx(ceiling)  # of 32 episodes in windows of 8


# --- within limits ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "payload", "action", "reason"),
    [
        (SPATIAL_ID, 3.5, None, ""),
        (SPATIAL_ID, 4.5, None, "rotation_error"),
        (PLANAR_ID, 2.5, None, "tracking_error"),
        (PLANAR_ID, 0.0, -0.1, "slack"),
    ],
)
def test_episode_ends_at_the_violation_of_the_dlcc_monitor(env_id, payload, action, reason):
    monitor = DLCCMonitor(gym.make(env_id, payload=payload))
    env, law = WithinLimits(monitor), FeedbackLinearization(SPATIAL if env_id == SPATIAL_ID else PLANAR)
    observation, info = env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        assert info["is_success"] is False
        command = law.predict(observation)[0] if action is None else np.full(3, action)
        observation, reward, terminated, truncated, info = env.step(command)
        excess = np.maximum(np.abs(info["commanded_action"]) - 0.97, 0).mean()
        assert reward == pytest.approx(0.02 - terminated - 0.02 * excess, abs=1e-15)
    assert info["termination_reason"] == reason
    assert info["is_success"] is info["dlcc_carried"] is (not reason)
    if reason:
        assert monitor.verdict.violation.kind == reason.removesuffix("_error").replace("tracking", "position")
        assert monitor.verdict.violation.time == info["time"]


def test_limits_are_not_checked_after_the_motion():
    short, loose = {"name": "dwell-planar", "duration": 0.1}, {"slack_time": 9.0, "termination_radius": 9.0}
    env = WithinLimits(gym.make(PLANAR_ID, trajectory=short, **loose))
    twin = WithinLimitsVector(plain_batch(1, **loose))
    law = FeedbackLinearization(PLANAR)
    observation, _ = env.reset(seed=0)
    twin.reset(seed=0, options={"trajectory": short})
    for step in range(80):
        command = law.predict(observation)[0] if step < 50 else np.full(3, -0.5)
        observation, _, terminated, _, info = env.step(command)
        assert not terminated
        assert not twin.step(command[None])[2].any()
    assert info["slack"].all()


def test_error_bounds_in_the_options_apply_to_one_episode():
    env, twin = WithinLimits(gym.make(PLANAR_ID)), WithinLimitsVector(plain_batch(2))
    tight = {"error_bounds": {"position": 1e-9}}
    env.reset(seed=0, options=tight)
    assert env.step(np.full(3, 0.2))[4]["termination_reason"] == "tracking_error"
    env.reset()
    assert not env.step(np.full(3, 0.2))[2]
    twin.reset(seed=0)
    twin.reset(options=tight | {"reset_mask": np.array([False, True])})
    assert twin.step(np.full((2, 3), 0.2))[2].tolist() == [False, True]


def test_termination_by_the_environment_keeps_its_reason():
    env = WithinLimits(gym.make(PLANAR_ID, termination_radius=9.0, slack_time=9.0, error_bounds={"position": 9.0}))
    env.reset(options={"initial_error": [0.3, 0.0]})
    terminated = False
    while not terminated:
        _, reward, terminated, _, info = env.step([0.9, 0.1, 0.1])
    assert (info["termination_reason"], reward) == ("workspace", pytest.approx(-0.98))


# --- steered law ------------------------------------------------------------------------------------------------------


class SinglePrecision(Network):
    """Rounds its inputs to single precision, as a learner does."""

    def __call__(self, values):
        return super().__call__(np.asarray(values, np.float32).astype(float))


@each_case
def test_policy_on_the_plain_environment_repeats_the_training_bit_for_bit(case):
    env = single(case)
    chosen, rng = CASES[case], np.random.default_rng(0)
    size, outputs = env.observation_space.shape[0], env.action_space.shape[0]
    network = SinglePrecision(
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
    observed, _ = env.reset(seed=0, options={"payload": 0.4})
    observation, _ = plain.reset(seed=0, options={"payload": 0.4})
    policy.reset([plain.unwrapped.task])
    state = None
    for _ in range(6):
        observed, _, terminated, _, info = env.step(network(observed))
        assert not terminated
        for _ in range(env.steering.periods):
            action, state = policy.predict(observation, state)
            observation, _, _, _, plain_info = plain.step(action)
        np.testing.assert_array_equal(env.unwrapped.pose, plain.unwrapped.pose)
        for name in ("commanded_action", "tensions", "time"):
            np.testing.assert_array_equal(info[name], plain_info[name], err_msg=name)


def test_action_period_and_shift_follow_the_control_frequency_and_the_error_bounds():
    keywords = {"control_frequency": 100.0, "error_bounds": {"position": 0.02}, "trajectory": "dwell-planar"}
    env = Steered(gym.make(PLANAR_ID, **keywords), **CASES["shift"]["steered"])
    env.reset(seed=0)
    start = env.unwrapped.pose.copy()
    assert env.step([1.0, 0.0])[4]["time"] == 0.02
    for _ in range(200):
        env.step([1.0, 0.0])
    np.testing.assert_allclose(env.unwrapped.pose - start, [0.5 * 0.02, 0.0], atol=5e-4)


def test_effort_costs_the_mean_square_of_the_clipped_action():
    arguments, action, rewards = CASES["shift"]["steered"], np.array([[0.5, 7.0], [0.0, 0.0]]), []
    for effort in (0.0, 0.4):
        env = make_steered_vec(PLANAR_ID, 2, wrappers=[(Steered, {**arguments, "effort": effort})], seed=3)
        rewards.append(env.step(action)[1])
    assert rewards[0] - rewards[1] == pytest.approx([0.4 * 0.625, 0.0])


def test_step_before_a_reset_and_after_an_end_raises():
    env, several = single("shift", max_episode_steps=5), batch("shift", 2)
    for one, action in ((env, np.zeros(2)), (several, np.zeros((2, 2)))):
        one.unwrapped.reset(seed=0)
        with pytest.raises(ResetNeeded, match=r"reset\(\)"):
            one.step(action)
    env.reset()
    assert env.step(np.zeros(2))[3]
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros(2))
    several.reset()
    with pytest.raises(ValueError, match="give error_bounds when the environments are made"):
        several.reset(options={"error_bounds": {"position": 0.02}})


@pytest.mark.parametrize("action", [np.zeros(1), np.zeros((3, 2)), np.array([0.0, np.nan]), ["a", "b"]])
def test_invalid_action_raises_and_changes_nothing(action):
    env, twin = single("shift"), single("shift")
    for one in (env, twin):
        one.reset(seed=0)
    with pytest.raises(ValueError, match="action must be"):
        env.step(action)
    np.testing.assert_array_equal(env.step([0.5, -0.5])[0], twin.step([0.5, -0.5])[0])


# --- making and invalid input -----------------------------------------------------------------------------------------

STEERED = {"base": "fl", "steering": "shift", "features": ["error"]}


@pytest.mark.parametrize(
    ("wrappers", "message"),
    [
        ([], "must be Steered"),
        ([(Steered, STEERED), (Steered, STEERED)], "order is WithinLimits"),
        ([(PayloadCurriculum, {"heaviest": 1.0}), (WithinLimits, {}), (Steered, STEERED)], "order is WithinLimits"),
        ([(Steered, STEERED | {"action_period": 1})], "Steered: .*unexpected keyword argument 'action_period'"),
        ([(PayloadCurriculum, {}), (Steered, STEERED)], "PayloadCurriculum: missing .*'heaviest'"),
        ([(DLCCMonitor, {}), (Steered, STEERED)], "DLCCMonitor has no vector form"),
        ([(PayloadCurriculum, {"heaviest": 1.0, "start": 2.0}), (Steered, STEERED)], "start must be .*at most 1 kg"),
        ([(PayloadCurriculum, {"heaviest": 1, "success": 0.5, "setback": 0.6}), (Steered, STEERED)], "setback"),
        ([(Steered, STEERED | {"base": "lqr"})], "unknown base law 'lqr'"),
        ([(Steered, STEERED | {"steering": "wheel"})], "unknown kind of steering 'wheel'"),
        ([(Steered, STEERED | {"steering": "residual", "features": ["shift"]})], "requires steering of kind shift"),
        (
            [(Steered, STEERED | {"steering": "residual", "base": {"law": "fl", "estimates_payload": True}})],
            "bias the payload estimate",
        ),
    ],
)
def test_invalid_wrappers_and_arguments_raise(wrappers, message):
    with pytest.raises(ValueError, match=message):
        make_steered_vec(PLANAR_ID, 2, wrappers=wrappers)


def test_seed_of_a_batch_repeats_its_draws():
    envs = [batch("shift", 3, seed=seed, payload_known=False) for seed in (3, 3, 9)]
    draws = [[*env.reset()[1]["payload"], *env.action_space.sample().ravel()] for env in envs]
    assert draws[0] == draws[1]
    assert not set(draws[0]) & set(draws[2])
    assert not envs[0].unwrapped.tasks[0].payload_known


def test_other_environments_and_autoreset_modes_raise():
    with pytest.raises(TypeError, match=r"gym\.make"):
        WithinLimits(gym.make("CartPole-v1"))
    with pytest.raises(TypeError, match=r"gym\.make_vec"):
        SteeredVector(gym.make(PLANAR_ID), **STEERED)
    with pytest.raises(ValueError, match="DISABLED"):
        WithinLimitsVector(gym.make_vec(PLANAR_ID, num_envs=2))
    with pytest.raises(ValueError, match="order is"):
        PayloadCurriculum(single("shift"), heaviest=1.0)
