"""The policy that plans a motion within the error bounds and follows it."""

from __future__ import annotations

import logging
import sys

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.optimal import trajopt as module
from cablebot_baselines.optimal.trajopt import (
    TRAJOPT_SETTINGS,
    TrajOpt,
    TrajOptSettings,
    make_trajopt,
    make_trajopt_margin,
)
from cablebot_gym.bounds.best_known import find_best_known
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.comparison import compare_policies
from cablebot_gym.evaluation.constraints import DLCCMonitor
from cablebot_gym.planning import Infeasible
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import SmoothCircle

PLANAR_ID, SPATIAL_ID, FLEX_SPATIAL_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"


@pytest.fixture(scope="module")
def planar_best():
    best_known = find_best_known(PLANAR_ID)
    assert best_known.verified
    return best_known.payload


def model_error(fraction):
    """The model payload is this fraction of the true payload."""
    return {"parameters": {"payload": {"low": 1 / fraction - 1, "high": 1 / fraction - 1}}}


def carried(env_id, policy, payload, **keywords):
    """Whether one episode keeps the limits."""
    env = DLCCMonitor(gym.make(env_id, payload=payload, **keywords))
    observation, _ = env.reset(seed=0)
    policy.reset([env.unwrapped.task])
    state, start, over = None, np.array(True), False
    while not over:
        action, state = policy.predict(observation, state, start)
        observation, _, terminated, truncated, _ = env.step(action)
        start, over = np.array(False), terminated or truncated
    return env.verdict.carried


class TestPayload:
    """Excludes plans that are too timid, or that nobody can follow."""

    @pytest.mark.parametrize("known", [True, False])
    def test_planar_comes_within_three_percent_of_the_best_known(self, planar_best, known):
        result = evaluate_dlcc(make_trajopt(PLANAR), PLANAR_ID, payload_known=known)
        assert 0.97 * planar_best <= result.payload <= planar_best

    @pytest.mark.parametrize("fraction", [0.9, 1.1])
    def test_a_wrong_payload_costs_little(self, planar_best, fraction):
        result = evaluate_dlcc(make_trajopt(PLANAR), PLANAR_ID, uncertainty=model_error(fraction))
        feedback = evaluate_dlcc("fl", PLANAR_ID, uncertainty=model_error(fraction))
        assert result.score / fraction >= 0.85 * 0.97 * planar_best
        assert result.score > feedback.score

    @pytest.mark.parametrize("known", [True, False])
    @pytest.mark.parametrize("payload", [0.0, 3.5, 7.1])
    def test_spatial_ninety_six_percent(self, payload, known):
        assert carried(SPATIAL_ID, make_trajopt(SPATIAL), payload, payload_known=known)

    @pytest.mark.parametrize("known", [True, False])
    def test_joint_springs_ninety_five_percent(self, known):
        policy = make_trajopt(FLEX_SPATIAL)
        assert carried(FLEX_SPATIAL_ID, policy, 0.0, payload_known=known)
        assert carried(FLEX_SPATIAL_ID, policy, 7.5, payload_known=known)

    def test_safe_bears_noise_and_close_does_not(self):
        near, far = compare_policies(
            [make_trajopt(SPATIAL), make_trajopt_margin(SPATIAL)],
            SPATIAL_ID,
            names=["trajopt", "trajopt-margin"],
            payload=5.9,
            uncertainty="sensors",
            draws=40,
            payload_known=False,
        ).metrics
        assert far.carried.sum() >= 38
        assert near.carried.sum() < 38


class TestFallbacks:
    """Excludes an exception in the middle of an episode, and a plan that silently is none."""

    def test_without_reset_it_follows_the_reference_and_says_so(self, caplog):
        env = gym.make(PLANAR_ID)
        observation, _ = env.reset(seed=0)
        policy = make_trajopt(PLANAR)
        with caplog.at_level(logging.WARNING, "cablebot_gym"):
            action, state = policy.predict(observation)
            policy.predict(observation, state)
        assert policy.fallbacks == 1
        assert "call reset(tasks) before predict()" in caplog.text
        assert np.all(np.isfinite(action))

    def test_a_failing_solver_is_counted_and_the_payload_still_carried(self, monkeypatch, caplog):
        def fails(*_, **__):
            raise Infeasible("Restoration_Failed")

        monkeypatch.setattr(module, "plan_motion", fails)
        policy = make_trajopt(PLANAR)
        with caplog.at_level(logging.WARNING, "cablebot_gym"):
            assert carried(PLANAR_ID, policy, 1.5)
        assert policy.fallbacks == 1
        assert "trajectory 'paper-planar' has no feasible motion within the error bounds" in caplog.text

    def test_reset_counts_anew(self):
        env = gym.make(PLANAR_ID)
        observation, _ = env.reset(seed=0)
        policy = make_trajopt(PLANAR)
        policy.predict(observation)
        policy.reset([env.unwrapped.task])
        assert policy.fallbacks == 0

    def test_an_impossible_plan_is_tried_once(self, monkeypatch):
        calls = []

        def fails(*arguments, **_):
            calls.append(arguments)
            raise Infeasible("no")

        monkeypatch.setattr(module, "plan_motion", fails)
        policy, task = make_trajopt(PLANAR), gym.make(PLANAR_ID).unwrapped.task
        policy.reset([task, task])
        policy.reset([task])
        assert len(calls) == 1
        assert policy.fallbacks == 1


class TestBatches:
    """Excludes plans that are followed by the wrong episode."""

    def test_each_lane_follows_its_own_task(self):
        motions = [SmoothCircle(radius=radius, center=(0.0, 0.0), duration=1.5) for radius in (0.1, 0.2)]
        singles = [gym.make(PLANAR_ID, trajectory=motion, payload=2.0) for motion in motions]
        seen = np.array([env.reset(seed=0)[0] for env in singles])
        tasks = [env.unwrapped.task for env in singles]
        many, state, states = make_trajopt(PLANAR), None, [None, None]
        many.reset(tasks)
        alone = [make_trajopt(PLANAR) for _ in tasks]
        for policy, task in zip(alone, tasks, strict=True):
            policy.reset([task])
        for step in range(20):
            start = np.full(2, step == 0)
            together, state = many.predict(seen, state, start)
            for index in range(2):
                own, states[index] = alone[index].predict(seen[index], states[index], start[index])
                np.testing.assert_allclose(together[index], own, atol=1e-9)
                seen[index] = singles[index].step(own)[0]

    def test_a_new_episode_forgets_the_payload_before(self):
        env = gym.make(SPATIAL_ID, payload=6.0, payload_known=False)
        observation, _ = env.reset(seed=0)
        policy = make_trajopt(SPATIAL)
        policy.reset([env.unwrapped.task])
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
            make_trajopt(PLANAR).reset([gym.make(SPATIAL_ID).unwrapped.task])

    def test_a_missing_extra_names_its_command(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "casadi", None)
        with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[optimal\]'"):
            TrajOpt(PLANAR, TRAJOPT_SETTINGS["rigid"])

    def test_margins_follow_the_limits(self):
        settings = TrajOptSettings(
            error_margin=0.1,
            action_margin=0.0,
            minimum_tension=1.0,
            gains=(400.0, 40.0),
            estimator_prior_weight=1e-3,
        )
        margins = settings.margins(ErrorBounds(position=0.02, rotation=0.03))
        assert (margins.position, margins.rotation) == pytest.approx((0.002, 0.003))
