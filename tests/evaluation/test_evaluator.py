"""Payloads against hand-computed cases, the closed form, the paper's figures, and toy policies that misbehave."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cablebot_gym  # registers the ids
from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.bounds import exact_payload
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import DLCCMonitor, ErrorBounds, PolicyError, Task, evaluate_dlcc
from cablebot_gym.evaluation.evaluator import PAYLOAD_MAX, SCAN_POINTS
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.robots import PLANAR, SPATIAL, Motors
from cablebot_gym.trajectories import Dwell, find_trajectory

PLANAR_ID, SPATIAL_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0"
IDS = {"planar": PLANAR_ID, "spatial": SPATIAL_ID}
ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
HANG = {"name": "dwell-spatial", "duration": 0.05}
"""A static hang in the symmetric pose, as short as a hang can be judged."""


def fl(kind):
    return FeedbackLinearization(ROBOTS[kind])


@cache
def scored(kind, criterion, known=True, position=0.01, rotation=0.01):
    """FL on the paper's circle at 500 Hz; each case is needed by more than one test."""
    return evaluate_dlcc(
        fl(kind),
        IDS[kind],
        criterion=criterion,
        payload_known=known,
        error_bounds=ErrorBounds(position=position, rotation=rotation),
    )


# --- the figures ------------------------------------------------------------------------------------------------------


def test_spatial_fl_under_the_papers_criterion_is_not_off_from_independent_runs():
    result = scored("spatial", "paper")
    assert result.payload == pytest.approx(1.78, abs=0.03)
    assert result.total_mass == result.payload + 10
    assert (result.violation.kind, result.violation.index) == ("torque", 2)
    assert result.violation.time == pytest.approx(0.5, abs=0.005)
    assert result.violation.excess > 0


def test_spatial_fl_under_the_task_criterion_is_not_off_from_independent_runs():
    assert scored("spatial", "task").payload == pytest.approx(4.03, abs=0.1)


def test_payload_that_is_not_told_is_not_carried_as_if_it_were():
    result = scored("spatial", "task", known=False)
    assert result.payload == pytest.approx(0.39, abs=0.03)
    assert result.payload_known is False


def test_rotation_bound_is_not_without_effect():
    assert scored("spatial", "task").violation.kind == "rotation"
    alone = scored("spatial", "task", rotation=10.0)
    assert alone.payload == pytest.approx(4.59, abs=0.1)
    assert alone.violation.kind == "position"


@pytest.mark.parametrize(("criterion", "total", "tolerance"), [("paper", 2.05, 0.03), ("task", 2.90, 0.05)])
def test_planar_fl_is_not_off_from_independent_runs(criterion, total, tolerance):
    result = scored("planar", criterion)
    assert result.total_mass == pytest.approx(total, abs=tolerance)
    assert result.total_mass == result.payload + 1


@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_bisection_does_not_contradict_the_closed_form(kind):
    robot = ROBOTS[kind]
    exact = exact_payload(robot, find_trajectory(f"paper-{kind}", robot.coordinates), minimum_tension=5.0)
    result = scored(kind, "paper")
    assert result.total_mass == pytest.approx(exact.total_mass, rel=0.02)
    assert (result.violation.kind, result.violation.index) == (exact.kind, exact.motor)
    assert result.violation.time == pytest.approx(exact.time, abs=0.005)


# --- by hand ----------------------------------------------------------------------------------------------------------


def hang_capacity(stall):
    """Total mass that six cables hold at rest in the symmetric pose, each pulling with τ_s/r: Σ T cos(angle) / g."""
    a, b, depth = 0.47, 0.148, 0.1
    sideways = np.array([a, -a / math.sqrt(3)]) - np.array([0, -2 * b / math.sqrt(3)])  # A2 to P1; all six are alike
    cosine = depth / math.hypot(*sideways, depth)
    return 6 * stall / 0.05 * cosine / 9.81


@pytest.mark.parametrize("resolution", [1e-2, 1e-5])
def test_static_hang_is_not_off_from_the_vertical_capacity_of_the_cables(resolution):
    result = evaluate_dlcc(fl("spatial"), SPATIAL_ID, criterion="paper", trajectory=HANG, resolution=resolution)
    expected = hang_capacity(10.0) - 10
    assert 14 < expected < 15
    # At the exact payload every motor stalls; rounding of the numbers there is all that is forgiven.
    assert result.payload - 1e-9 <= expected <= result.payload + resolution + 1e-9
    assert (result.violation.kind, result.violation.time) == ("torque", 0.0)
    assert result.violation.index in range(1, 7)
    assert result.violation.excess < 10 * resolution / expected


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.7])
def test_stall_torque_is_not_without_proportional_effect_on_the_total_mass(factor):
    robot = SPATIAL.replace(motors=Motors(stall_torque=10 * factor, free_speed=SPATIAL.motors.free_speed))
    result = evaluate_dlcc(
        FeedbackLinearization(robot),
        SPATIAL_ID,
        criterion="paper",
        robot=robot,
        trajectory=HANG,
        payload_max=40.0,
        resolution=1e-4,
    )
    assert result.total_mass == pytest.approx(factor * hang_capacity(10.0), abs=2e-4)


def test_one_weak_motor_is_not_blamed_on_another():
    robot = SPATIAL.replace(motors=Motors(stall_torque=(10, 10, 10, 9, 10, 10), free_speed=SPATIAL.motors.free_speed))
    result = evaluate_dlcc(
        FeedbackLinearization(robot), SPATIAL_ID, criterion="paper", robot=robot, trajectory=HANG, resolution=1e-4
    )
    assert result.violation.index == 4
    assert result.total_mass == pytest.approx(0.9 * hang_capacity(10.0), abs=2e-4)


@pytest.mark.parametrize("frequency", [250.0, 1000.0])
def test_control_frequency_is_not_without_effect(frequency):
    steps = []
    result = evaluate_dlcc(
        lambda observation: steps.append(1) or np.full(3, 0.1),
        PLANAR_ID,
        trajectory={"name": "dwell-planar", "duration": 0.02},
        control_frequency=frequency,
    )
    assert result.environment["control_frequency"] == frequency
    assert len(steps) == 2 * SCAN_POINTS * round(0.02 * frequency), "one scan, and the episode that is drawn"
    assert len(result.history["action_time"]) == round(0.02 * frequency)


@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_tighter_position_bound_never_raises_the_score(kind):
    bounds = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)
    results = [scored(kind, "task", position=bound, rotation=10.0) for bound in bounds]
    scores = [result.score for result in results]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > scores[2] > scores[4], "or the bound has no effect at all"


def test_wide_tube_is_not_cut_short_by_the_termination_of_the_environment():
    def limp(_):
        return np.zeros(6)

    motion = {"name": "dwell-spatial", "duration": 0.2}
    wide = evaluate_dlcc(
        limp, SPATIAL_ID, trajectory=motion, error_bounds=ErrorBounds(position=0.3, rotation=1.0), payload_max=1.0
    )
    fallen = wide.history["tracking_error"].max()
    assert 0.1 < fallen < 0.3, "beyond the environment's own radius"
    assert (wide.payload, wide.violation, wide.scan_ended) == (1.0, None, True)
    narrow = evaluate_dlcc(
        limp,
        SPATIAL_ID,
        trajectory=motion,
        error_bounds=ErrorBounds(position=0.3, rotation=1.0),
        payload_max=1.0,
        termination_radius=0.05,
    )
    assert (narrow.payload, narrow.violation.kind) == (None, "terminated"), "a radius that was asked for holds"


# --- the search -------------------------------------------------------------------------------------------------------


def rerun(env_id, policy, payload, criterion, **keywords):
    """The verdict on one payload in a single environment."""
    env = DLCCMonitor(gym.make(env_id, payload=payload, max_episode_steps=-1, **keywords), criterion=criterion)
    observation, _ = env.reset(seed=0)
    if hasattr(policy, "reset"):
        policy.reset((env.get_wrapper_attr("task"),))
    terminated = False
    while not (env.verdict.complete or terminated):
        observation, _, terminated, _, _ = env.step(policy.predict(observation)[0])
    return env.verdict


@pytest.mark.parametrize("resolution", [0.05, 1e-3, 1e-6])
def test_resolution_is_not_ignored(resolution):
    result = evaluate_dlcc(fl("planar"), PLANAR_ID, criterion="paper", resolution=resolution)
    assert 0 < result.resolution <= resolution
    below = rerun(PLANAR_ID, fl("planar"), result.payload, "paper")
    above = rerun(PLANAR_ID, fl("planar"), result.payload + result.resolution, "paper")
    assert (below.carried, above.carried) == (True, False)
    assert above.violation.kind == result.violation.kind
    assert result.margins["torque"] == pytest.approx(1 - max(below.peak_action), abs=1e-12)
    assert result.margins["position"] == pytest.approx(1 - below.position_peak / 0.01, abs=1e-9)
    assert result.margins["tension"] == pytest.approx(below.least_tension)


def test_resolution_below_the_floats_does_not_search_for_ever():
    def stop(done, total):
        if done > 100 * 25:
            pytest.fail("a hundred rounds, and no end")

    result = evaluate_dlcc(
        fl("spatial"), SPATIAL_ID, criterion="paper", trajectory=HANG, resolution=1e-18, progress=stop
    )
    assert result.payload == pytest.approx(hang_capacity(10.0) - 10, abs=1e-9)


@pytest.mark.parametrize("payload_max", [0.25, 1.0])
def test_scan_that_ends_before_the_limit_does_not_name_one(payload_max):
    result = evaluate_dlcc(fl("spatial"), SPATIAL_ID, trajectory=HANG, payload_max=payload_max)
    assert (result.payload, result.total_mass, result.payload_max) == (payload_max, 10 + payload_max, payload_max)
    assert (result.violation, result.scan_ended, result.violation_seed, result.resolution) == (None, True, None, 0.0)
    assert json.loads(result.to_json())["violation"] is None
    assert result.feasible == ((0.0, payload_max),)
    assert f"; limiting violation: none up to {payload_max:g} kg" in str(result)


@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_scan_leaves_out_neither_end(kind):
    spy = Spy(ROBOTS[kind])
    evaluate_dlcc(spy, IDS[kind], trajectory={"name": f"dwell-{kind}", "duration": 0.01}, payload_max=None)
    told = [task.model_payload for task in spy.begun[0]]
    np.testing.assert_allclose(told, np.linspace(0, PAYLOAD_MAX[kind], SCAN_POINTS), rtol=1e-15)
    assert PAYLOAD_MAX == {"planar": 10.0, "spatial": 20.0}


@settings(max_examples=15, deadline=None)
@given(threshold=st.floats(0.0, 4.9), resolution=st.sampled_from([0.3, 1e-2, 1e-4]))
def test_search_does_not_miss_a_threshold(threshold, resolution):
    result = evaluate_dlcc(
        Dropping(lambda told: told > threshold),
        SPATIAL_ID,
        trajectory={"name": "dwell-spatial", "duration": 0.1},
        payload_max=5.0,
        resolution=resolution,
    )
    assert result.payload <= threshold < result.payload + result.resolution
    assert result.resolution <= resolution
    assert result.feasible == ((0.0, result.payload),)


class Dropping(FeedbackLinearization):
    """FL that lets go where it is told certain payloads."""

    def __init__(self, lets_go):
        super().__init__(SPATIAL)
        self.lets_go = lets_go

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start, deterministic)
        told = np.asarray(observation)[..., observation_layout(SPATIAL).slices()["model_payload"]]
        return np.where(self.lets_go(told), 0.0, action), state


def test_feasible_set_with_a_hole_is_not_reported_as_one_interval():
    policy = Dropping(lambda told: (told > 1.02) & (told < 1.58) | (told > 2.22) & (told < 2.38))
    keywords = {"trajectory": {"name": "dwell-spatial", "duration": 0.1}}
    result = evaluate_dlcc(policy, SPATIAL_ID, payload_max=3.15, resolution=1e-4, **keywords)
    assert 1.02 - 1e-4 <= result.payload <= 1.02
    assert result.violation.kind == "position"
    # 64 points of [0, 3.15] are 0.05 apart.
    assert len(result.feasible) == 3
    assert result.feasible[0] == (0.0, result.payload)
    np.testing.assert_allclose(result.feasible[1:], [(1.6, 2.2), (2.4, 3.15)], atol=1e-9)


class ToldWrong(FeedbackLinearization):
    """FL that believes in 3 kg of payload, whatever it is told."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        observation = np.array(observation)
        observation[..., observation_layout(SPATIAL).slices()["model_payload"]] = 3.0
        return super().predict(observation, state, episode_start, deterministic)


def test_failing_at_zero_is_not_zero_kilograms_in_silence():
    policy, keywords = ToldWrong(SPATIAL), {"trajectory": {"name": "dwell-spatial", "duration": 0.5}}
    result = evaluate_dlcc(policy, SPATIAL_ID, payload_max=6.3, **keywords)
    assert (result.payload, result.total_mass, result.score, result.resolution) == (None, None, 0.0, 0.0)
    assert result.violation == rerun(SPATIAL_ID, policy, 0.0, "task", **keywords).violation
    assert (result.violation.kind, result.margins) == ("position", {})
    assert len(result.history["action_time"]) > 10
    ((low, high),) = result.feasible
    assert 2.0 < low < 3.0 < high < 4.0
    step = 6.3 / (SCAN_POINTS - 1)
    for payload, carried in ((low, True), (high, True), (low - step, False), (high + step, False)):
        assert rerun(SPATIAL_ID, policy, payload, "task", **keywords).carried is carried
    text = str(result)
    assert "fails unloaded: position at t =" in text
    assert f"it carries {low:.3f} to {high:.3f} kg" in text
    assert json.loads(result.to_json())["payload"] is None


def test_policy_that_carries_nothing_at_all_is_not_said_to_carry_something():
    result = evaluate_dlcc(lambda _: np.zeros(6), SPATIAL_ID, trajectory={"name": "dwell-spatial", "duration": 0.3})
    assert (result.payload, result.feasible, result.score) == (None, (), 0.0)
    assert "it carries" not in str(result)


def test_seed_does_not_give_another_result_the_second_time():
    one, other = (evaluate_dlcc(fl("planar"), PLANAR_ID, seed=5, resolution=1e-2, payload_max=3.0) for _ in range(2))
    assert one.to_json() == other.to_json()
    for name, array in one.history.items():
        assert array.tobytes() == other.history[name].tobytes()


def test_start_errors_are_not_another_draw_for_each_payload():
    spy = Spy(SPATIAL)
    evaluate_dlcc(spy, SPATIAL_ID, trajectory=HANG, payload_max=1.0, initial_error_range=[0.002, 0.002, 0.002, 0, 0, 0])
    pose = spy.observations[0][:, observation_layout(SPATIAL).slices()["pose"]]
    assert np.ptp(pose, axis=0).max() == 0.0


def test_seed_is_not_computed_and_never_passed():
    starts = []
    for seed in (0, 0, 1):
        spy = Spy(SPATIAL)
        evaluate_dlcc(spy, SPATIAL_ID, trajectory=HANG, payload_max=1.0, seed=seed, initial_error_range=[0.002] * 6)
        # The scan and the episode that is drawn start alike.
        np.testing.assert_array_equal(spy.observations[0][0, :12], spy.observations[25][0, :12])
        starts.append(spy.observations[0][0, :12])
    np.testing.assert_array_equal(starts[0], starts[1])
    assert np.all(starts[0][:6] != starts[2][:6])


@pytest.mark.parametrize(
    "keywords",
    [{"payload_known": np.arange(SCAN_POINTS) < 10}, {"initial_error": np.zeros((SCAN_POINTS, 6))}],
    ids=lambda keywords: next(iter(keywords)),
)
def test_value_per_environment_is_not_dealt_out_among_the_payloads(keywords):
    with pytest.raises(ValueError, match=next(iter(keywords))):
        evaluate_dlcc(fl("spatial"), SPATIAL_ID, trajectory=HANG, payload_max=1.0, **keywords)


# --- what a policy is given -------------------------------------------------------------------------------------------


class Spy(FeedbackLinearization):
    """FL with a recurrent state, which writes down what it is given."""

    def __init__(self, robot):
        super().__init__(robot)
        self.begun, self.observations, self.states, self.starts = [], [], [], []

    def reset(self, tasks):
        self.begun.append(tasks)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert deterministic is True
        self.observations.append(np.array(observation))
        self.states.append(state)
        self.starts.append(np.array(episode_start))
        action, _ = super().predict(observation)
        return action, ("state", len(self.states))


def test_recurrent_state_is_neither_lost_nor_carried_into_the_next_episode():
    spy = Spy(SPATIAL)
    evaluate_dlcc(spy, SPATIAL_ID, trajectory=HANG, payload_max=1.0)
    steps = 25
    assert len(spy.states) == 2 * steps, "the scan, and the episode that is drawn"
    for first in (0, steps):
        assert spy.states[first] is None
        assert spy.starts[first].tolist() == [True] * SCAN_POINTS
        for step in range(first + 1, first + steps):
            assert spy.states[step] == ("state", step)
            assert spy.starts[step].tolist() == [False] * SCAN_POINTS
    assert {observation.shape for observation in spy.observations} == {(SCAN_POINTS, spy._layout.size)}


@pytest.mark.parametrize("known", [True, False])
def test_begin_does_not_tell_more_than_the_public_task(known):
    spy = Spy(SPATIAL)
    bounds = ErrorBounds(position=0.02, rotation=0.03)
    evaluate_dlcc(
        spy,
        SPATIAL_ID,
        trajectory=HANG,
        payload_max=6.3,
        payload_known=known,
        control_frequency=400.0,
        error_bounds=bounds,
        cable="bilateral",
    )
    tasks = spy.begun[0]
    payloads = np.linspace(0, 6.3, SCAN_POINTS)
    assert len(tasks) == SCAN_POINTS
    np.testing.assert_allclose([task.model_payload for task in tasks], payloads * known, atol=1e-12)
    fields = {field.name for field in dataclasses.fields(Task)}
    assert fields == {
        "robot",
        "trajectory",
        "error_bounds",
        "control_frequency",
        "cable",
        "model_payload",
        "payload_known",
    }
    for task in tasks:
        assert (task.payload_known, task.error_bounds, task.control_frequency, task.cable) == (
            known,
            bounds,
            400,
            "bilateral",
        )
        assert task.robot == SPATIAL, "nominal, without payload"
        assert task.trajectory.duration == 0.05
        assert set(vars(task)) == fields
    with pytest.raises(dataclasses.FrozenInstanceError):
        tasks[0].model_payload = 1.0


def test_begin_comes_before_the_first_step_of_each_batch():
    calls = []

    class Ordered(Spy):
        def reset(self, tasks):
            calls.append("reset")

        def predict(self, observation, **keywords):
            calls.append("predict")
            return super().predict(observation, **keywords)

    evaluate_dlcc(Ordered(SPATIAL), SPATIAL_ID, trajectory=HANG, payload_max=1.0)
    assert calls == (["reset"] + ["predict"] * 25) * 2


def test_callable_is_not_given_a_batch():
    shapes = set()

    def policy(observation):
        shapes.add(observation.shape)
        return fl("spatial").predict(observation)[0]

    one = evaluate_dlcc(policy, SPATIAL_ID, trajectory=HANG, resolution=0.1)
    assert shapes == {(observation_layout(SPATIAL).size,)}
    assert one.payload == evaluate_dlcc(fl("spatial"), SPATIAL_ID, trajectory=HANG, resolution=0.1).payload
    assert one.policy == "policy"


def test_action_of_the_policy_is_not_lost_on_its_way_to_the_plant():
    result = evaluate_dlcc(
        lambda _: np.array([0.11, 0.22, 0.33]),
        PLANAR_ID,
        trajectory={"name": "dwell-planar", "duration": 0.01},
        payload_max=1.0,
    )
    np.testing.assert_array_equal(result.history["commanded_action"], [[0.11, 0.22, 0.33]] * 5)


def test_name_of_the_policy_is_not_lost():
    keywords = {"trajectory": HANG, "payload_max": 0.1}
    assert evaluate_dlcc(fl("spatial"), SPATIAL_ID, **keywords).policy == "FeedbackLinearization"
    assert evaluate_dlcc("fl", SPATIAL_ID, **keywords).policy == "fl"
    assert evaluate_dlcc(fl("spatial"), SPATIAL_ID, name="mine", **keywords).policy == "mine"


def test_policy_by_name_is_not_built_for_another_robot():
    by_name = evaluate_dlcc("fl", SPATIAL_ID, trajectory=HANG, robot=SPATIAL.replace(mass=12.0), resolution=0.1)
    built = FeedbackLinearization(SPATIAL.replace(mass=12.0))
    given_ = evaluate_dlcc(built, SPATIAL_ID, trajectory=HANG, robot=SPATIAL.replace(mass=12.0), resolution=0.1)
    assert (by_name.payload, by_name.total_mass) == (given_.payload, given_.payload + 12)


def test_progress_does_not_run_backwards_or_beyond_its_end():
    seen = []
    result = evaluate_dlcc(
        fl("planar"),
        PLANAR_ID,
        criterion="paper",
        trajectory={"name": "paper-planar", "duration": 0.8},
        progress=lambda done, total: seen.append((done, total)),
    )
    assert result.payload is None or result.resolution <= 1e-3
    assert [done for done, _ in seen] == list(range(1, len(seen) + 1))
    assert all(done <= total for done, total in seen)


# --- errors -----------------------------------------------------------------------------------------------------------

FAILING_AT = 0.02
"""When the policies below fail [s]."""


class Failing(Spy):
    """FL that does something wrong for payloads beyond 1 kg, from the eleventh step on."""

    def __init__(self, wrong):
        super().__init__(SPATIAL)
        self.wrong = wrong

    def predict(self, observation, **keywords):
        action, state = super().predict(observation, **keywords)
        if len(self.states) > round(FAILING_AT * 500):
            action = self.wrong(action)
        return action, state


def nan_beyond(action):
    action[20, 3] = np.nan
    return action


def infinite_beyond(action):
    action[20, 3] = -np.inf
    return action


def raising(action):
    raise KeyError("lost")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (raising, r"raised KeyError at t = 0\.020 s with payloads of 0 to 6\.3 kg: 'lost'"),
        (lambda action: action[:, :5], r"returned shape \(64, 5\) at t = 0\.020 s with .*expected \(64, 6\)"),
        (lambda action: action[0], r"returned shape \(6,\) at t = 0\.020 s with payloads of 0 to 6\.3 kg"),
        (lambda action: [1, [2, 3]], r"returned list instead of real numbers: .* at t = 0\.020 s"),
        (lambda action: None, r"returned NoneType instead of real numbers at t = 0\.020 s"),
        (lambda action: action + 1j, r"returned complex instead of real numbers at t = 0\.020 s"),
        (lambda action: np.full(action.shape, "1"), r"returned ndarray instead of real numbers at t = 0\.020 s"),
        (nan_beyond, r"returned NaN or infinity at t = 0\.020 s with a payload of 2 kg"),
        (infinite_beyond, r"returned NaN or infinity at t = 0\.020 s with a payload of 2 kg"),
    ],
    ids=["raises", "one motor short", "one for all", "ragged", "none", "complex", "text", "nan", "inf"],
)
def test_error_of_a_policy_names_time_and_payload(wrong, message):
    with pytest.raises(PolicyError, match=message) as caught:
        evaluate_dlcc(Failing(wrong), SPATIAL_ID, trajectory=HANG, payload_max=6.3, name="toy")
    assert str(caught.value).startswith("policy 'toy' ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("returned", "what"),
    [(np.zeros((64, 6)), "ndarray"), (None, "NoneType"), ((1, 2, 3), "a tuple of length 3")],
    ids=["no state", "nothing", "three"],
)
def test_predict_without_a_state_is_not_taken_for_commands(returned, what):
    class Plain:
        def predict(self, observation, **keywords):
            return returned

    with pytest.raises(
        PolicyError, match=rf"returned {what} at t = 0\.000 s: predict\(\) must return \(actions, state\)"
    ):
        evaluate_dlcc(Plain(), SPATIAL_ID, trajectory=HANG, payload_max=6.3)


@pytest.mark.parametrize(
    ("fails", "message"),
    [
        (lambda action: 1 / 0, "it raised ZeroDivisionError: division by zero"),
        (lambda action: action[:2], r"it returned shape \(2,\) after \(6,\)"),
        (lambda action: "nonsense", "it returned str instead of real numbers"),
    ],
)
def test_error_of_a_callable_names_its_own_payload(fails, message):
    calls = []

    def policy(observation):
        calls.append(1)
        action = fl("spatial").predict(observation)[0]
        # The fourth of 64 observations, of the third step.
        return fails(action) if len(calls) == 2 * SCAN_POINTS + 4 else action

    with pytest.raises(PolicyError, match=rf"at t = 0\.004 s with a payload of 0\.3 kg: {message}"):
        evaluate_dlcc(policy, SPATIAL_ID, trajectory=HANG, payload_max=6.3)


def test_nan_for_a_payload_that_has_failed_already_does_not_stop_the_evaluation():
    class Blind(Dropping):
        """Returns NaN where it dropped the payload 0.1 s ago."""

        steps = 0

        def predict(self, observation, **keywords):
            action, state = super().predict(observation, **keywords)
            self.steps += 1
            told = observation[:, observation_layout(SPATIAL).slices()["model_payload"]]
            return np.where((told > 1) & (self.steps % 100 > 60), np.nan, action), state

    result = evaluate_dlcc(
        Blind(lambda told: told > 1),
        SPATIAL_ID,
        trajectory={"name": "dwell-spatial", "duration": 0.2},
        payload_max=2.0,
        resolution=1.0,
    )
    assert 0.9 < result.payload <= 1.0


def test_begin_that_raises_is_not_an_error_without_a_name():
    class Unplannable(FeedbackLinearization):
        def reset(self, tasks):
            raise RuntimeError("no plan")

    with pytest.raises(PolicyError, match="no plan"):
        evaluate_dlcc(Unplannable(SPATIAL), SPATIAL_ID, trajectory=HANG, name="toy")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"env_id": "CableBot-Spatial-v1"}, "unknown environment .*choose one of CableBot-Planar-v0, CableBot-Spatial"),
        ({"criterion": "both"}, "unknown criterion 'both'; choose one of task, paper"),
        ({"policy": "lqr"}, "unknown policy 'lqr'; choose one of .*fl"),
        ({"trajectory": "spiral"}, "unknown trajectory 'spiral'; choose one of paper-spatial"),
        ({"trajectory": "paper-planar"}, "paper-planar.*6.*; choose .*paper-spatial, circle-spatial"),
        ({"resolution": -1e-3}, "resolution must be greater than 0 kg, not -0.001"),
        ({"resolution": 0.0}, "resolution must be greater than 0 kg"),
        ({"resolution": math.nan}, "resolution must be greater than 0 kg"),
        ({"payload_max": 0}, "payload_max must be greater than 0 kg, not 0"),
        ({"payload_max": -3.0}, "payload_max must be greater than 0 kg"),
        ({"payload_max": math.nan}, "payload_max must be greater than 0 kg"),
        ({"payload_max": math.inf}, "payload_max must be greater than 0 kg"),
        ({"error_bounds": {"position": 0.0}}, "error_bounds: position must be a number greater than 0"),
        ({"error_bounds": {"position": 0.01, "torque": 1.0}}, "with the keys position, rotation"),
        ({"error_bounds": 0.01}, "error_bounds must be an ErrorBounds or a dict"),
        ({"payload": 1.0}, "payload is set by the evaluation: remove it from the keywords"),
        ({"payload_range": (0.0, 1.0)}, "payload_range is set by the evaluation: remove it from the keywords"),
        ({"num_envs": 3}, "num_envs is set by the evaluation: remove it from the keywords"),
        ({"max_episode_steps": 3}, "max_episode_steps is set by the evaluation: remove it from the keywords"),
        ({"autoreset_mode": "SameStep"}, "autoreset_mode is set by the evaluation: remove it from the keywords"),
        ({"payload_known": "yes"}, "payload_known must be True or False"),
        ({"control_frequency": 0.0}, "control_frequency must be a finite number greater than 0"),
        ({"seed": -1}, "a seed must be at least 0"),
    ],
)
def test_bad_argument_is_not_accepted(arguments, message):
    policy, env_id = arguments.pop("policy", "fl"), arguments.pop("env_id", SPATIAL_ID)
    calls = []
    with pytest.raises(ValueError, match=message) as caught:
        evaluate_dlcc(policy, env_id, progress=lambda *_: calls.append(1), **{"trajectory": HANG} | arguments)
    assert not calls, "found out before the work"
    assert "\n" not in str(caught.value)


def test_what_is_no_policy_is_not_accepted():
    with pytest.raises(TypeError, match=r"a policy must have predict\(\) or be a callable"):
        evaluate_dlcc(3, SPATIAL_ID)


def test_paper_criterion_does_not_pass_a_policy_that_may_clip_itself():
    with pytest.raises(
        ValueError, match=r"does not apply to policy 'clipped', because it does not declare unsaturated_actions"
    ):
        evaluate_dlcc(lambda observation: np.zeros(6), SPATIAL_ID, criterion="paper", name="clipped")


def test_callable_that_declares_unclipped_is_not_refused():
    def policy(observation):
        return fl("spatial").predict(observation)[0]

    policy.unsaturated_actions = True
    result = evaluate_dlcc(policy, SPATIAL_ID, criterion="paper", trajectory=HANG, resolution=0.1)
    assert result.payload == pytest.approx(hang_capacity(10.0) - 10, abs=0.1)


# --- Stable-Baselines3 ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model():
    sb3 = pytest.importorskip("stable_baselines3")
    return sb3.PPO("MlpPolicy", gym.make(PLANAR_ID), n_steps=8, batch_size=8, policy_kwargs={"net_arch": [4]}, seed=0)


def test_model_of_sb3_does_not_need_a_wrapper(model, tmp_path):
    path = tmp_path / "tiny.zip"
    model.save(path)
    keywords = {
        "trajectory": {"name": "dwell-planar", "duration": 0.05},
        "error_bounds": {"position": 0.5},
        "resolution": 0.1,
    }
    by_object = evaluate_dlcc(model, PLANAR_ID, **keywords)
    by_path = evaluate_dlcc(str(path), PLANAR_ID, **keywords)
    assert (by_object.policy, by_path.policy) == ("PPO", str(path))
    assert by_object.payload == by_path.payload
    assert by_object.violation == by_path.violation
    observation, _ = gym.make(PLANAR_ID, trajectory=keywords["trajectory"]).reset(seed=0)
    expected, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(by_object.history["commanded_action"][0], expected, rtol=1e-6)


def test_model_of_sb3_is_not_judged_by_the_papers_criterion(model):
    with pytest.raises(ValueError, match="because it does not declare unsaturated_actions"):
        evaluate_dlcc(model, PLANAR_ID, criterion="paper")


# --- the result -------------------------------------------------------------------------------------------------------

KEYS = {"env_id", "policy", "criterion", "payload", "total_mass", "resolution", "violation", "error_bounds", "versions"}
"""What the result file is promised to hold at least."""


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize("kind", ["planar", "spatial"])
@pytest.mark.parametrize("criterion", ["task", "paper"])
def test_json_is_neither_invalid_nor_short_of_a_key(kind, criterion):
    result = scored(kind, criterion)
    data = json.loads(result.to_json(), parse_constant=refuse)
    assert set(data) >= KEYS
    assert set(data["violation"]) >= {"kind", "index", "time"}
    assert (data["env_id"], data["policy"], data["criterion"]) == (IDS[kind], "FeedbackLinearization", criterion)
    assert (data["payload"], data["total_mass"], data["seed"]) == (result.payload, result.total_mass, 0)
    bounded = kind == "spatial" and criterion == "task"
    assert data["error_bounds"] == {"position": 0.01, "rotation": 0.01 if bounded else None}
    assert set(data["versions"]) >= {"python", "cablebot-gym", "gymnasium", "numpy", "numba"}
    assert data["versions"]["cablebot-gym"] == cablebot_gym.__version__
    assert data["environment"]["trajectory"]["name"] == f"paper-{kind}"
    assert data["environment"]["robot"]["mass"] == ROBOTS[kind].mass


def test_environment_in_the_json_does_not_make_another_evaluation():
    first = evaluate_dlcc(fl("spatial"), SPATIAL_ID, trajectory=HANG, resolution=0.01, control_frequency=400.0)
    data = json.loads(first.to_json())
    again = evaluate_dlcc(
        "fl",
        data["env_id"],
        criterion=data["criterion"],
        error_bounds=data["error_bounds"],
        payload_max=data["payload_max"],
        payload_known=data["payload_known"],
        resolution=0.01,
        **data["environment"],
    )
    assert again.payload == first.payload
    assert again.to_dict()["environment"] == first.to_dict()["environment"]


@pytest.mark.parametrize(
    "keywords",
    [
        {"seed": np.int64(3)},
        {"payload_max": np.float32(1.0)},
        {"error_bounds": {"position": np.float32(0.01)}},
        {"control_frequency": np.float32(500.0)},
        {"substeps": np.int64(2)},
    ],
    ids=lambda keywords: next(iter(keywords)),
)
def test_numpy_number_does_not_make_a_result_that_cannot_be_saved(keywords):
    result = evaluate_dlcc(fl("spatial"), SPATIAL_ID, **{"trajectory": HANG, "payload_max": 1.0} | keywords)
    assert json.loads(result.to_json(), parse_constant=refuse)["payload"] == 1.0


def test_motion_of_ones_own_does_not_make_a_result_that_cannot_be_saved():
    result = evaluate_dlcc(fl("spatial"), SPATIAL_ID, trajectory=OwnMotion(), payload_max=1.0)
    data = json.loads(result.to_json(), parse_constant=refuse)
    assert data["environment"]["trajectory"]["name"] == "own"
    assert data["environment"]["trajectory"]["duration"] == 0.05


class OwnMotion:
    """A motion that satisfies the protocol, and is neither a dataclass nor a child of the package's."""

    name, duration, coordinates = "own", 0.05, 6

    def __call__(self, times):
        return Dwell(pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), duration=0.05)(times)


def test_result_cannot_be_changed():
    result = scored("planar", "task")
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.payload = 99.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.violation.kind = "torque"


def test_printed_result_does_not_keep_the_essentials_to_itself():
    text = str(scored("spatial", "paper"))
    for part in (
        "CableBot-Spatial-v0",
        "paper criterion",
        "payload known",
        "1.77",
        "total 11.77",
        "; limiting violation: motor 2 at t = 0.50",
    ):
        assert part in text
    assert "payload unknown" in str(scored("spatial", "task", known=False))


def test_history_is_not_that_of_another_payload():
    result = scored("planar", "paper")
    action = np.abs(result.history["commanded_action"])
    assert action.shape == (500, 3)
    assert 1 - action.max() == pytest.approx(result.margins["torque"], abs=1e-12)
    assert result.history["tensions"].min() == pytest.approx(result.margins["tension"], abs=1e-9)
    assert result.history["pose"].shape == (500, 2)
    np.testing.assert_allclose(result.history["action_time"], np.arange(500) / 500, atol=1e-12)


def test_policy_that_forgets_is_not_reported_as_if_it_had_carried():
    class Moody(FeedbackLinearization):
        rounds = 0

        def reset(self, tasks):
            self.rounds += 1

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            action, state = super().predict(observation, state)
            return action * (0.0 if self.rounds > 1 else 1.0), state

    with pytest.raises(
        PolicyError, match="not reproducible: it carried 1 kg in 1 of 1 episodes, and in 0 of the same episodes when"
    ):
        evaluate_dlcc(Moody(SPATIAL), SPATIAL_ID, trajectory=HANG, payload_max=1.0)


@pytest.mark.parametrize("run", [evaluate_dlcc, record_rollout])
def test_motion_without_a_single_command_is_not_carried(run):
    with pytest.raises(ValueError, match="shorter than a control period"):
        run(fl("spatial"), SPATIAL_ID, trajectory={"name": "dwell-spatial", "duration": 5e-4})


@pytest.mark.parametrize("run", [evaluate_dlcc, record_rollout])
def test_robot_of_another_kind_does_not_pass_under_the_id(run):
    with pytest.raises(ValueError, match=r"robot 'planar' does not fit CableBot-Spatial-v0: use CableBot-Planar-v0"):
        run("fl", SPATIAL_ID, robot=PLANAR)


def test_end_by_the_environment_is_not_left_without_its_reason():
    # The circle leaves it by less than the bound of the error, so that somebody could stay inside.
    narrow = PLANAR.replace(workspace=((-0.212, 0.212), (-0.212, 0.212)))
    result = evaluate_dlcc("fl", "CableBot-Planar-v0", robot=narrow)
    assert (result.payload, result.violation.kind, result.violation.reason) == (None, "terminated", "workspace")
    assert "workspace" in str(result)
