"""The policy that plans a motion inside the tube and follows it."""

from __future__ import annotations

import logging
import sys

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.optimal import tube as module
from cablebot_baselines.optimal.tube import CLOSE, Style, Tube, close, safe
from cablebot_gym.bounds.best_known import best_found
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.comparison import compare_policies
from cablebot_gym.evaluation.constraints import DLCCMonitor
from cablebot_gym.planning import Infeasible
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import Limits
from cablebot_gym.trajectories import SmoothCircle

PLANAR_ID, SPATIAL_ID, FLEX_SPATIAL_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"


@pytest.fixture(scope="module")
def planar_best():
    found = best_found(PLANAR_ID)
    assert found.verified
    return found.payload


def told(share):
    """The policy is told this share of the true payload."""
    return {"parameters": {"payload": {"low": 1 / share - 1, "high": 1 / share - 1}}}


def carried(env_id, policy, payload, **keywords):
    """Whether one episode keeps the limits."""
    env = DLCCMonitor(gym.make(env_id, payload=payload, **keywords))
    observation, _ = env.reset(seed=0)
    policy.begin([env.unwrapped.task])
    state, start, over = None, np.array(True), False
    while not over:
        action, state = policy.predict(observation, state, start)
        observation, _, terminated, truncated, _ = env.step(action)
        start, over = np.array(False), terminated or truncated
    return env.verdict.carried


class TestPayload:
    """Excludes plans that are too timid, or that nobody can follow."""

    @pytest.mark.parametrize("known", [True, False])
    def test_planar_comes_within_three_percent_of_the_best_found(self, planar_best, known):
        result = evaluate_dlcc(close(PLANAR), PLANAR_ID, payload_known=known)
        assert 0.97 * planar_best <= result.payload <= planar_best

    @pytest.mark.parametrize("share", [0.9, 1.1])
    def test_a_wrong_payload_costs_little(self, planar_best, share):
        result = evaluate_dlcc(close(PLANAR), PLANAR_ID, uncertainty=told(share))
        feedback = evaluate_dlcc("fl", PLANAR_ID, uncertainty=told(share))
        assert result.score / share >= 0.85 * 0.97 * planar_best
        assert result.score > feedback.score

    @pytest.mark.parametrize("known", [True, False])
    @pytest.mark.parametrize("payload", [0.0, 3.5, 7.1])
    def test_spatial_ninety_six_percent(self, payload, known):
        assert carried(SPATIAL_ID, close(SPATIAL), payload, payload_known=known)

    @pytest.mark.parametrize("known", [True, False])
    def test_joint_springs_ninety_five_percent(self, known):
        policy = close(FLEX_SPATIAL)
        assert carried(FLEX_SPATIAL_ID, policy, 0.0, payload_known=known)
        assert carried(FLEX_SPATIAL_ID, policy, 7.5, payload_known=known)

    def test_safe_bears_noise_and_close_does_not(self):
        near, far = compare_policies(
            [close(SPATIAL), safe(SPATIAL)],
            SPATIAL_ID,
            names=["tube", "tube-safe"],
            payload=5.9,
            uncertainty="sensors",
            draws=40,
            payload_known=False,
        ).measured
        assert far.carried.sum() >= 38
        assert near.carried.sum() < 38


class TestFallbacks:
    """Excludes an exception in the middle of an episode, and a plan that silently is none."""

    def test_without_begin_it_follows_the_reference_and_says_so(self, caplog):
        env = gym.make(PLANAR_ID)
        observation, _ = env.reset(seed=0)
        policy = close(PLANAR)
        with caplog.at_level(logging.WARNING, "cablebot_gym"):
            action, state = policy.predict(observation)
            policy.predict(observation, state)
        assert policy.fallbacks == 1
        assert "begin() has not told" in caplog.text
        assert np.all(np.isfinite(action))

    def test_a_failing_solver_is_counted_and_the_payload_still_carried(self, monkeypatch, caplog):
        def fails(*_, **__):
            raise Infeasible("Restoration_Failed")

        monkeypatch.setattr(module, "planned", fails)
        policy = close(PLANAR)
        with caplog.at_level(logging.WARNING, "cablebot_gym"):
            assert carried(PLANAR_ID, policy, 1.5)
        assert policy.fallbacks == 1
        assert "no motion along 'paper-planar' inside the limits was found" in caplog.text

    def test_begin_counts_anew(self):
        env = gym.make(PLANAR_ID)
        observation, _ = env.reset(seed=0)
        policy = close(PLANAR)
        policy.predict(observation)
        policy.begin([env.unwrapped.task])
        assert policy.fallbacks == 0

    def test_an_impossible_plan_is_tried_once(self, monkeypatch):
        calls = []

        def fails(*arguments, **_):
            calls.append(arguments)
            raise Infeasible("no")

        monkeypatch.setattr(module, "planned", fails)
        policy, task = close(PLANAR), gym.make(PLANAR_ID).unwrapped.task
        policy.begin([task, task])
        policy.begin([task])
        assert len(calls) == 1
        assert policy.fallbacks == 1


class TestBatches:
    """Excludes plans that are followed by the wrong episode."""

    def test_each_lane_follows_its_own_task(self):
        motions = [SmoothCircle(radius=radius, center=(0.0, 0.0), duration=1.5) for radius in (0.1, 0.2)]
        singles = [gym.make(PLANAR_ID, trajectory=motion, payload=2.0) for motion in motions]
        seen = np.array([env.reset(seed=0)[0] for env in singles])
        tasks = [env.unwrapped.task for env in singles]
        many, state, states = close(PLANAR), None, [None, None]
        many.begin(tasks)
        alone = [close(PLANAR) for _ in tasks]
        for policy, task in zip(alone, tasks, strict=True):
            policy.begin([task])
        for step in range(20):
            start = np.full(2, step == 0)
            together, state = many.predict(seen, state, start)
            for lane in range(2):
                own, states[lane] = alone[lane].predict(seen[lane], states[lane], start[lane])
                np.testing.assert_allclose(together[lane], own, atol=1e-9)
                seen[lane] = singles[lane].step(own)[0]

    def test_a_new_episode_forgets_the_payload_before(self):
        env = gym.make(SPATIAL_ID, payload=6.0, payload_known=False)
        observation, _ = env.reset(seed=0)
        policy = close(SPATIAL)
        policy.begin([env.unwrapped.task])
        first, state = policy.predict(observation, None, np.array(True))
        seen = observation
        for _ in range(5):
            action, state = policy.predict(seen, state, np.array(False))
            seen = env.step(action)[0]
        again, _ = policy.predict(observation, state, np.array(True))
        np.testing.assert_allclose(again, first, atol=1e-9)


class TestBadInput:
    def test_another_robot(self):
        with pytest.raises(ValueError, match="6 cables in space"):
            close(PLANAR).begin([gym.make(SPATIAL_ID).unwrapped.task])

    def test_a_missing_extra_names_its_command(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "casadi", None)
        with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[optimal\]'"):
            Tube(PLANAR, CLOSE["rigid"])

    def test_margins_follow_the_limits(self):
        style = Style(share=0.1, demand=0.0, tension=1.0, gains=(400.0, 40.0), prior=1e-3)
        margins = style.margins(Limits(position=0.02, rotation=0.03))
        assert (margins.position, margins.rotation) == pytest.approx((0.002, 0.003))
