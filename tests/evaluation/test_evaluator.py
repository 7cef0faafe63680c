"""Payloads against hand-computed cases, the closed form, the paper's figures, and policies that
misbehave."""

import dataclasses
import json
import math
import pickle

import gymnasium as gym
import numpy as np
import pytest
from evaluation.conftest import Dropping, Law, play
from numpy.testing import assert_array_equal

import cablebot_gym
from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.bounds import exact_payload
from cablebot_gym.evaluation import DLCCMonitor, ErrorBounds, PolicyError, evaluate_dlcc
from cablebot_gym.evaluation.batch import noise_seed
from cablebot_gym.evaluation.motion_search import SCAN_POINTS
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.evaluation.timing import time_actions
from cablebot_gym.motions import find_trajectory
from cablebot_gym.robots import SPATIAL

SPATIAL_ID = "CableBot-Spatial-v0"
HANG = {"name": "dwell-spatial", "duration": 0.05}
STATIC = {"trajectory": HANG, "criterion": "paper", "initial_error": 0.0}
"""A short static hang in the symmetric pose. The usual start is lower, where the cables hold more."""


# --- the closed form --------------------------------------------------------------------------------------------------


@pytest.mark.landing
def test_paper_criterion_agrees_with_the_closed_form():
    circle = find_trajectory("paper-spatial", 6)
    exact = exact_payload(SPATIAL, circle, minimum_tension=5.0)
    keywords = {"criterion": "paper", "resolution": 0.01}
    result = evaluate_dlcc("fl", SPATIAL_ID, trajectory=circle, **keywords)
    assert result.total_mass == result.payload + SPATIAL.mass
    assert result.total_mass == pytest.approx(SPATIAL.mass + exact.payload, rel=0.02)
    assert (result.violation.kind, result.violation.index) == ("torque", exact.motor)
    assert result.violation.time == pytest.approx(exact.time, abs=0.005)


# --- by hand ----------------------------------------------------------------------------------------------------------


HANG_CAPACITY = 6 * 10.0 / 0.05 * 0.1 / math.hypot(0.47, 0.47 / 3**0.5 - 0.296 / 3**0.5, 0.1) / 9.81
"""Total mass that six cables hold at rest in the symmetric pose, each pulling with τ_s/r: Σ T
cos(angle) / g."""


def test_static_hang_is_the_vertical_capacity_of_the_cables():
    resolution = 1e-5
    result = evaluate_dlcc("fl", SPATIAL_ID, resolution=resolution, **STATIC)
    expected = HANG_CAPACITY - 10
    # At the exact payload every motor stalls; only rounding of the numbers is tolerated there.
    assert result.payload - 1e-9 <= expected <= result.payload + resolution + 1e-9
    assert (result.violation.kind, result.violation.time) == ("torque", 0.0)
    assert result.violation.excess < 10 * resolution / expected


# --- the search -------------------------------------------------------------------------------------------------------


def test_feasible_set_with_holes_is_reported_as_intervals():
    policy = Dropping(lambda payload: (payload > 1.02) & (payload < 1.58))
    motion = {"name": "dwell-spatial", "duration": 0.1}
    result = evaluate_dlcc(policy, SPATIAL_ID, payload_max=3.15, resolution=1e-4, trajectory=motion)
    assert 1.02 - 1e-4 <= result.payload <= 1.02
    below, (low, high) = result.details.feasible
    assert below == (0.0, result.payload)
    # 64 points of [0, 3.15] are at most 0.075 apart.
    assert 1.58 <= low <= 1.655
    assert high == 3.15


def test_policy_that_fails_unloaded_has_no_payload():
    policy = Dropping(lambda payload: np.abs(payload - 3.0) > 0.5)
    keywords = {"trajectory": {"name": "dwell-spatial", "duration": 0.1}}
    result = evaluate_dlcc(policy, SPATIAL_ID, payload_max=6.3, **keywords)
    assert (result.payload, result.total_mass, result.score) == (None, None, 0.0)
    assert (result.resolution, result.details.margins) == (0.0, {})
    assert result.violation == play(DLCCMonitor(gym.make(SPATIAL_ID, **keywords)), policy).violation
    assert result.rollout.arrays["time"][-1] == result.violation.time
    assert "fails unloaded: cable 1 falls below its tension bound of 1 N at t =" in str(result)
    assert json.loads(result.to_json())["payload"] is None


def test_seed_determines_the_result_and_reaches_the_environment():
    keywords = {"trajectory": HANG, "payload_max": 1.0, "initial_error_range": [0.002] * 6}
    results = [evaluate_dlcc("fl", SPATIAL_ID, seed=seed, **keywords) for seed in (5, 5, 6)]
    assert results[0].to_json() == results[1].to_json()
    starts = [result.rollout.start["true_pose"] for result in results]
    assert np.all(starts[0] == starts[1])
    assert np.all(starts[0] != starts[2])
    assert str(results[0]).endswith("(not assured: only 1 draw)")


# --- the policy protocol ----------------------------------------------------------------------------------------------


class Spy(FeedbackLinearization):
    """FL with a recurrent state that records its inputs."""

    def __init__(self, robot):
        super().__init__(robot)
        self.tasks = []
        self.states = []
        self.starts = []

    def reset(self, tasks):
        self.tasks.append(tasks)
        self.states.append("reset")

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert deterministic is True
        self.states.append(state)
        self.starts.append(episode_start.tolist())
        return super().predict(observation)[0], ("state", len(self.states))


def test_policy_gets_its_state_and_the_episode_starts():
    spy = Spy(SPATIAL)
    steps = 25
    evaluate_dlcc(spy, SPATIAL_ID, trajectory=HANG, payload_max=1.0)
    expected = []
    for size in (SCAN_POINTS, 2 * SCAN_POINTS, 6, 1):  # scan, checks, finer physics, recording
        assert spy.starts[:steps] == [[True] * size] + [[False] * size] * (steps - 1)
        del spy.starts[:steps]
        expected += ["reset", None]
        for _ in range(steps - 1):
            expected.append(("state", len(expected)))
    assert spy.states == expected


@pytest.mark.parametrize("known", [True, False])
def test_tasks_contain_public_knowledge_only(known):
    spy = Spy(SPATIAL)
    public = {"payload_known": known, "control_frequency": 400.0, "cable": "bilateral"}
    public["error_bounds"] = ErrorBounds(position=0.02, rotation=0.03)
    evaluate_dlcc(spy, SPATIAL_ID, trajectory=HANG, **public)
    tasks = spy.tasks[0]
    payloads = [task.model_payload for task in tasks]
    assert (len(tasks), min(payloads), max(payloads)) == (SCAN_POINTS, 0.0, 20.0 * known)
    names = {"robot", "trajectory", "model_payload", "measurement", *public}
    for task in tasks:
        assert set(vars(task)) == names
        assert public.items() <= vars(task).items()
        assert task.robot == SPATIAL, "nominal, without payload"


# --- errors -----------------------------------------------------------------------------------------------------------


class Failing(Law):
    """Does something wrong from the eleventh step on."""

    def __init__(self, wrong):
        super().__init__()
        self.wrong = wrong
        self.steps = 0

    def act(self, observation):
        action = super().act(observation)
        self.steps += 1
        if self.steps > 10:
            action = self.wrong(action)
        return action


def infinite(action):
    action[20, 3] = -np.inf
    return action


def raising(action):
    raise KeyError("lost")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (raising, r"payloads of 0 to 6\.3 kg: it raised KeyError: 'lost'"),
        (infinite, r"a payload of [\d.]+ kg: it returned NaN or infinity"),
        (
            lambda action: action - 1e7,
            r"a payload of 0 kg: it returned the action -1e\+07; actions must be",
        ),
    ],
)
def test_error_of_a_policy_names_time_and_payload(wrong, message):
    with pytest.raises(PolicyError, match=rf"^policy 'toy', at t = 0\.020 s with .*{message}"):
        evaluate_dlcc(Failing(wrong), SPATIAL_ID, trajectory=HANG, payload_max=6.3, name="toy")


def test_nan_after_the_violation_is_ignored():
    class Blind(Dropping):
        """Returns NaN 0.1 s after it dropped the payload."""

        steps = 0

        def act(self, observation):
            action = super().act(observation)
            self.steps += 1
            if self.steps % 100 > 60:
                action[self.split(observation)["model_payload"][:, 0] > 1] = np.nan
            return action

    motion = {"name": "dwell-spatial", "duration": 0.2}
    policy = Blind(lambda payload: payload > 1)
    result = evaluate_dlcc(policy, SPATIAL_ID, trajectory=motion, payload_max=2.0, resolution=1.0)
    assert 0.9 < result.payload <= 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"criterion": "both"}, "choose one of task, paper"),
        ({"trajectory": HANG | {"duration": 5e-4}}, "shorter than a control period"),
        ({"resolution": math.nan}, "resolution must be a finite number greater than 0"),
        ({"payload": 1.0}, "payload is set by the evaluation"),
        ({"seed": -1}, "seed must be an integer of at least 0"),
        ({"policy": lambda _: 0, "criterion": "paper", "name": "toy"}, "apply to policy 'toy'"),
        ({"draws": 2, "uncertainty": {"delay": 3}}, "would be equal: choose a random uncertainty"),
        ({"probability": 1.0}, "probability must be .* less than 1"),
    ],
)
def test_bad_argument_is_rejected_before_the_work(arguments, message):
    defaults = {"policy": "fl", "trajectory": HANG, "uncertainty": "table6", "draws": 3}
    defaults["progress"] = lambda *_: pytest.fail("work")
    with pytest.raises(ValueError, match=message):
        evaluate_dlcc(env_id=SPATIAL_ID, **defaults | arguments)


# --- the result -------------------------------------------------------------------------------------------------------


def test_environment_of_the_json_repeats_the_evaluation():
    keywords = {"seed": np.int64(3), "control_frequency": np.float32(400.0)}
    result = evaluate_dlcc("fl", SPATIAL_ID, trajectory=HANG, resolution=0.01, **keywords)
    result = pickle.loads(pickle.dumps(result))  # as worker processes return it
    data = json.loads(result.to_json(), parse_constant=pytest.fail)
    assert data["violation"] == dataclasses.asdict(result.violation)
    assert data["versions"]["cablebot-gym"] == cablebot_gym.__version__
    names = ("criterion", "error_bounds", "payload_max", "payload_known", "seed", "env_id")
    conditions = {name: data[name] for name in names} | data["environment"]
    again = evaluate_dlcc("fl", resolution=0.01, **conditions)
    assert again.payload == result.payload
    assert again.to_dict()["environment"] == result.to_dict()["environment"]


# --- recorded episodes ------------------------------------------------------------------------------------------------


def test_rollout_equals_an_episode_of_the_single_environment(tmp_path):
    motion = {"name": "line-spatial", "duration": 0.2, "dwell": 0.0}
    conditions = {"payload": 2.0, "trajectory": motion, "uncertainty": "table6"}
    env = gym.make(SPATIAL_ID, **conditions)
    policy = FeedbackLinearization(SPATIAL)
    rollout = record_rollout(policy, SPATIAL_ID, seed=4, **conditions)
    observation, info = env.reset(seed=4, options={"noise_seed": noise_seed(4, 2.0)})
    assert len(rollout) == 101
    for index in range(101):
        moment = rollout.moment(index)
        assert_array_equal(moment.pose, env.unwrapped.pose)
        for name in ("time", "payload", "tensions", "torques", "commanded_action", "slack"):
            assert_array_equal(getattr(moment, name), info[name])
        if index < 100:
            observation, reward, _, _, info = env.step(policy.predict(observation)[0])
            assert rollout.arrays["reward"][index] == reward
    rollout.save(str(tmp_path / "run.csv"))
    head, *lines = (tmp_path / "run.csv").read_text().splitlines()
    columns = dict(zip(head.split(","), np.loadtxt(lines, delimiter=",").T, strict=True))
    assert_array_equal(columns["tensions_6 [N]"], rollout.arrays["tensions"][:, 5])
    assert_array_equal(columns["true_pose_psi [rad]"], rollout.arrays["true_pose"][:, 3])
    reasons = "1=tracking_error 2=slack 3=workspace 4=non_finite 5=violation"
    assert f"termination_reason [{reasons}]" in columns


@pytest.mark.parametrize("function", [record_rollout, time_actions])
def test_number_of_draws_of_one_episode_is_refused_in_a_sentence(function):
    with pytest.raises(TypeError, match="'draws'"):
        function("fl", SPATIAL_ID, draws=3)
