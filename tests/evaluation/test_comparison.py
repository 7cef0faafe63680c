"""Policies side by side: every number against single episodes, the intervals against SciPy's."""

import dataclasses
import math
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from evaluation.conftest import Law
from numpy.testing import assert_allclose
from scipy import stats

from cablebot_gym.evaluation import DLCCMonitor, compare_policies
from cablebot_gym.evaluation.batch import draw_seeds, noise_seed
from cablebot_gym.evaluation.comparison import QUANTITIES

SPATIAL_ID = "CableBot-Spatial-v0"
MOVE = {"name": "line-spatial", "duration": 0.4, "dwell": 0.0}


FALL = {"name": "dwell-spatial", "duration": 0.3}
UNKNOWN = {
    "parameters": {"platform_mass": {"low": -0.1, "high": 0.1}},
    "wrench": {"force_mean": 0.5, "force_std": 0.4},
    "sensors": {"position": 1e-4},
}


class Scaled(Law):
    """Its actions are a little too large or too small."""

    def __init__(self, factor):
        super().__init__()
        self.factor = factor

    def act(self, observation):
        return self.factor * super().act(observation)


def limp(observation):
    return np.zeros(6)


class LetsGo(Law):
    """Returns zero actions in the episodes whose measured x is positive at the third
    step."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action = self.act(observation)
        count, gone = state or (0, np.zeros(len(observation), bool))
        if count == 2:
            gone = observation[:, 0] > 0
        return np.where(gone[:, None], 0.0, action), (count + 1, gone)


@cache
def compared():
    """Two policies over five draws."""
    conditions = {"payload": 1.5, "uncertainty": UNKNOWN, "draws": 5, "seed": 3}
    conditions |= {"trajectory": MOVE, "error_bounds": {"position": 0.005}}
    pair = [Scaled(1.0), Scaled(0.9)]
    return compare_policies(pair, SPATIAL_ID, names=["plain", "weak"], **conditions)


def episode(policy, seed, *, payload=1.5, trajectory=MOVE, uncertainty=UNKNOWN, position=0.005):
    """One episode in a single environment, summed up by hand."""
    keywords = {"trajectory": trajectory, "uncertainty": uncertainty}
    keywords["error_bounds"] = {"position": position}
    env = DLCCMonitor(gym.make(SPATIAL_ID, payload=payload, **keywords))
    observation, start = env.reset(seed=seed, options={"noise_seed": noise_seed(seed, payload)})
    infos = []
    state = None
    terminated = False
    steps = round(500 * trajectory["duration"])
    while len(infos) < steps and not terminated:
        action, state = policy.predict(observation[None], state=state)
        observation, _, terminated, _, info = env.step(action[0])
        infos.append(info)
    series = {name: np.array([info[name] for info in infos]) for name in infos[0]}
    error = series["tracking_error"]
    lost = max(error[-1], 0.1)  # after an early end
    whole = np.append(error, np.full(steps - len(error), lost))
    peak = max(start["tracking_error_peak"], series["tracking_error_peak"].max())
    return {
        "mean_error": whole.mean(),
        "rms_error": math.sqrt((whole**2).mean()),
        "max_error": max(peak, lost) if terminated else peak,
        "max_rotation": max(start["rotation_error_peak"], series["rotation_error_peak"].max()),
        "rms_torque": math.sqrt((series["torques"] ** 2).mean()),
        "peak_torque": np.abs(series["torques"]).max(),
        "torque_margin": 1 - np.abs(series["commanded_action"]).max(),
        "least_tension": series["least_tensions"].min(),
        "largest_tension": series["largest_tensions"].max(),
        "carried": env.verdict.carried,
        "ended": bool(terminated),
        "error": error,
        "rotation": series["rotation_error"],
    }


# --- numbers ----------------------------------------------------------------------------------------------------------


def test_metrics_equal_those_of_single_episodes():
    measured = compared().metrics[1]
    for draw, seed in enumerate(draw_seeds(3, 5)):
        by_hand = episode(Scaled(0.9), seed)
        for name, value in by_hand.items():
            ours = getattr(measured, name)[..., draw]
            assert_allclose(ours, value, rtol=0, atol=1e-12, err_msg=name)
    assert np.all(np.ptp([getattr(measured, name) for name in QUANTITIES], axis=1) > 0)
    assert set(QUANTITIES) == set(by_hand) - {"carried", "ended", "error", "rotation"}


def test_error_counts_as_constant_after_an_early_termination():
    conditions = {"trajectory": FALL, "uncertainty": "sensors"}
    comparison = compare_policies([LetsGo()], SPATIAL_ID, draws=6, seed=2, **conditions)
    (measured,) = comparison.metrics
    assert 0 < measured.ended.sum() < 6
    for draw, seed in enumerate(draw_seeds(2, 6)):
        by_hand = episode(LetsGo(), seed, payload=0.0, position=0.01, **conditions)
        for name in (*QUANTITIES, "carried", "ended"):
            assert getattr(measured, name)[draw] == pytest.approx(by_hand[name], abs=1e-12), name
        is_lost = np.isnan(measured.error[:, draw])
        assert (is_lost == (np.arange(len(is_lost)) >= len(by_hand["error"]))).all()


def test_comparison_ends_with_the_last_episode():
    progress = []
    fallen, carried = compare_policies(
        [limp, Scaled(1.0)],
        SPATIAL_ID,
        names=["limp", "plain"],
        trajectory=FALL,
        progress=lambda *step: progress.append(step),
    ).metrics
    assert (fallen.ended.tolist(), carried.ended.tolist()) == ([True], [False])
    assert len(fallen.error) < 150 == len(carried.error)
    assert np.nanmax(fallen.error) < 0.11, "not the next episode, which starts where this one did"
    done, expected = zip(*progress, strict=True)
    assert list(done) == sorted(done)
    assert set(expected) == {done[-1]} == {300}


# --- intervals --------------------------------------------------------------------------------------------------------


def made(*mean_errors):
    """A comparison with given mean errors for each policy."""
    metrics = [
        dataclasses.replace(compared().metrics[0], mean_error=np.array(errors, float))
        for errors in mean_errors
    ]
    seeds = tuple(range(len(mean_errors[0])))
    return dataclasses.replace(compared(), metrics=tuple(metrics), draw_seeds=seeds)


def test_interval_of_a_mean_is_students():
    values = compared().metrics[1].mean_error
    low, high = stats.t.interval(0.95, 4, loc=values.mean(), scale=stats.sem(values))
    estimate = compared().metrics[1].estimate("mean_error")
    expected = pytest.approx((values.mean(), low, high), rel=1e-12)
    assert (estimate.mean, estimate.low, estimate.high) == expected


def test_interval_of_a_reduction_is_scipys_bootstrap():
    random = np.random.default_rng(0)
    base = random.uniform(1, 2, 40)
    better = base * random.uniform(0.3, 0.7, 40)
    comparison = made(base, 2 * base, better)
    fraction = comparison.reduction(2, "mean_error")
    assert fraction == comparison.reduction(2, "mean_error")
    assert fraction.mean == pytest.approx(1 - better.mean() / base.mean())
    reference = stats.bootstrap(
        (base, better),
        lambda base, better, axis: 1 - better.mean(axis=axis) / base.mean(axis=axis),
        paired=True,
        method="percentile",
        n_resamples=20000,
        rng=np.random.default_rng(1),
    ).confidence_interval
    near = 0.1 * (reference.high - reference.low)
    assert (fraction.low, fraction.high) == pytest.approx(tuple(reference), abs=near)
    one_draw = made((2,), (1,)).reduction(1, "mean_error")
    assert (one_draw.mean, one_draw.low, one_draw.high) == (0.5, 0.5, 0.5)


# --- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("policies", "payload", "message"),
    [
        ([], 0.0, "policies must be a list, such as"),
        (["fl", "fl"], 0.0, "policies need distinct names, not fl, fl"),
        (["fl"], math.nan, "payload must be a finite number at least 0"),
    ],
)
def test_bad_comparison_is_rejected(policies, payload, message):
    with pytest.raises(ValueError, match=message):
        compare_policies(policies, SPATIAL_ID, payload=payload)
